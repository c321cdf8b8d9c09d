"""The configuration file of KUKA's RSI object ETHERNET: address, name of the partner, elements in both directions.

Both sides of the link take the structure of their telegrams from it. `DEF_...` elements are filled by the robot controller itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from robomill.orchestration.errors import SlaveError, available, unknown
from robomill.orchestration.slaves.archive import check_xml

AXES = tuple(f"A{i}" for i in range(1, 7))
POSE = ("X", "Y", "Z", "A", "B", "C")
INTERNAL = {
    "DEF_RIst": POSE,
    "DEF_RSol": POSE,
    "DEF_AIPos": AXES,
    "DEF_ASPos": AXES,
    "DEF_EIPos": tuple(f"E{i}" for i in range(1, 7)),
    "DEF_ESPos": tuple(f"E{i}" for i in range(1, 7)),
    "DEF_MACur": AXES,
    "DEF_MECur": tuple(f"E{i}" for i in range(1, 7)),
    "DEF_Delay": ("D",),
}
"""What the robot controller sends of its own, and the attributes of these elements."""
TYPES = ("BOOL", "STRING", "LONG", "DOUBLE")
NUMBERS = ("BOOL", "LONG", "DOUBLE")
MOST_CHANNELS = 64
"""Inputs or outputs of the RSI object."""
PORT = 49152
_LAST_PORT = 65535
_HOLDON = ("0", "1")


class EthernetError(ValueError):
    """A configuration file that cannot be used."""


@dataclass(frozen=True)
class Element:
    """One ELEMENT: the tag `AK.A1`, its type, the channel of the RSI object (INTERNAL for what the controller fills)."""

    tag: str
    type: str = "DOUBLE"
    index: str = "INTERNAL"
    holdon: bool = True
    """RECEIVE only: the last value is repeated where an answer is late; else 0 is taken."""

    @property
    def names(self) -> tuple[str, ...]:
        """The values of the element as they stand in a telegram: `AIPos.A1`, ...; nothing for an internal one that is not known."""
        if self.index != "INTERNAL":
            return (self.tag,)
        return tuple(f"{self.tag.removeprefix('DEF_')}.{attribute}" for attribute in INTERNAL.get(self.tag, ()))


@dataclass(frozen=True)
class Ethernet:
    """A configuration file."""

    send: tuple[Element, ...]
    """From the robot controller."""
    receive: tuple[Element, ...]
    """To it."""
    address: str = "127.0.0.1"
    """Where the partner listens."""
    port: int = PORT
    sentype: str = "ImFree"
    """Type in `<Sen Type="...">`."""
    only_send: bool = False

    def sent(self) -> dict[str, str]:
        """Type of each value that the controller sends, by its name in the telegram; texts are left out."""
        return {name: e.type for e in self.send if e.type in NUMBERS for name in e.names}

    def received(self) -> dict[str, Element]:
        """Element of each value that it receives."""
        return {name: e for e in self.receive for name in e.names}


def read(file: Path) -> Ethernet:
    """Read a configuration file. EthernetError names element, what was found and what is expected.

    Entities and document types are refused.
    """
    if not file.is_file():
        raise FileNotFoundError(f"no RSI configuration {file}; `robomill rsi LINK.toml --config {file.name}` writes one")
    try:
        check_xml(file, file)
    except SlaveError as error:
        raise EthernetError(str(error)) from None
    root = ElementTree.parse(file).getroot()
    if root.tag != "ROOT":
        raise EthernetError(f"{file}: the root is <{root.tag}>; expected <ROOT> with CONFIG, SEND and RECEIVE")
    only_send = _text(file, root, "CONFIG/ONLYSEND", "FALSE").upper()
    if only_send not in ("TRUE", "FALSE"):
        raise EthernetError(f"{file}: ONLYSEND is {only_send!r}; expected TRUE or FALSE")
    protocol = _text(file, root, "CONFIG/PROTOCOL", "UDP").upper()
    if protocol != "UDP":
        raise EthernetError(f"{file}: PROTOCOL is {protocol!r}; only UDP is supported; set it to UDP")
    port = _text(file, root, "CONFIG/PORT")
    if not port.isdecimal() or not 0 < int(port) <= _LAST_PORT:
        raise EthernetError(f"{file}: PORT is {port!r}; expected a whole number from 1 to {_LAST_PORT}")
    made = Ethernet(
        send=_elements(file, root, "SEND"),
        receive=_elements(file, root, "RECEIVE"),
        address=_text(file, root, "CONFIG/IP_NUMBER"),
        port=int(port),
        sentype=_text(file, root, "CONFIG/SENTYPE"),
        only_send=only_send == "TRUE",
    )
    names = [name for e in (*made.send, *made.receive) for name in e.names]
    if twice := sorted({n for n in names if names.count(n) > 1}):
        raise EthernetError(f"{file}: {available(twice)} twice; an element is there once; leave one of them out")
    return made


def _text(file: Path, root: ElementTree.Element, path: str, default: str | None = None) -> str:
    text = (root.findtext(path) or "").strip()
    if not text and default is None:
        raise EthernetError(
            f"{file}: <{path.replace('/', '><')}> is missing or empty; add it: `robomill rsi LINK --config FILE` writes such a file"
        )
    return text or (default or "")


def _elements(file: Path, root: ElementTree.Element, side: str) -> tuple[Element, ...]:
    found: list[Element] = []
    for e in root.iterfind(f"{side}/ELEMENTS/ELEMENT"):
        tag, kind, index = (e.get(key, "").strip() for key in ("TAG", "TYPE", "INDX"))
        where = f"{file}: {side} element {tag!r}"
        if not tag or tag.count(".") > 1 or not all(_is_name(part) for part in tag.split(".")):
            raise EthernetError(f"{where}: expected a TAG such as AK.A1 or FTC")
        if kind not in TYPES:
            raise EthernetError(f"{where}: {unknown('TYPE', kind, TYPES)}")
        if not (index == "INTERNAL" and side == "SEND") and not (index.isdecimal() and 0 < int(index) <= MOST_CHANNELS):
            raise EthernetError(f"{where}: INDX is {index!r}; expected {'INTERNAL or ' * (side == 'SEND')}1 to {MOST_CHANNELS}")
        holdon = e.get("HOLDON", "0" if side == "RECEIVE" else "1")
        if holdon not in _HOLDON:
            raise EthernetError(f"{where}: HOLDON is {holdon!r}; expected 0 or 1")
        found.append(Element(tag, kind, index, holdon == "1"))
    if not found:
        raise EthernetError(f"{file}: {side} has no ELEMENT; expected at least one in <{side}><ELEMENTS>")
    return tuple(found)


def _is_name(text: str) -> bool:
    return text.isascii() and text.replace("_", "a").replace("-", "a").isalnum() and not text[0].isdigit()


def write(config: Ethernet, file: Path) -> None:
    """Write a configuration file; `read` gives it back."""
    root = ElementTree.Element("ROOT")
    head = ElementTree.SubElement(root, "CONFIG")
    for key, text in (
        ("IP_NUMBER", config.address),
        ("PORT", str(config.port)),
        ("SENTYPE", config.sentype),
        ("ONLYSEND", str(config.only_send).upper()),
    ):
        ElementTree.SubElement(head, key).text = text
    sides: Sequence[tuple[str, Sequence[Element]]] = (("SEND", config.send), ("RECEIVE", config.receive))
    for side, elements in sides:
        listed = ElementTree.SubElement(ElementTree.SubElement(root, side), "ELEMENTS")
        for e in elements:
            attributes = {"TAG": e.tag, "TYPE": e.type, "INDX": e.index}
            if side == "RECEIVE":
                attributes["HOLDON"] = str(int(e.holdon))
            ElementTree.SubElement(listed, "ELEMENT", attributes)
    ElementTree.indent(root, "  ")
    ElementTree.ElementTree(root).write(file, encoding="unicode")
    file.write_text(file.read_text(encoding="utf-8") + "\n", encoding="utf-8")
