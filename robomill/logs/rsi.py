"""Recorded KUKA RSI messages."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from robomill.logs.log import Log, LogError

_PACKET = re.compile(rb"<(Rob|Sen)\b[^>]*>.*?</\1\s*>", re.DOTALL)
_RSI_UNITS = {
    **dict.fromkeys(("RIst.X", "RIst.Y", "RIst.Z", "RSol.X", "RSol.Y", "RSol.Z"), "mm"),
    **dict.fromkeys(("RIst.A", "RIst.B", "RIst.C", "RSol.A", "RSol.B", "RSol.C"), "deg"),
    **{f"{tag}.A{i}": "deg" for tag in ("AIPos", "ASPos", "Sen.AK", "Sen.AKorr") for i in range(1, 7)},
    **dict.fromkeys(("Sen.RKorr.X", "Sen.RKorr.Y", "Sen.RKorr.Z"), "mm"),
    **dict.fromkeys(("Sen.RKorr.A", "Sen.RKorr.B", "Sen.RKorr.C"), "deg"),
}


def read_rsi(file: Path) -> Log:
    """Packets `<Rob ...>` of the robot, one row each, in the order of the file; `<Sen ...>` answers join the row with their IPOC."""
    rows: list[dict[str, float]] = []
    by_ipoc: dict[float, dict[str, float]] = {}
    answers: list[dict[str, float]] = []
    content = file.read_bytes()
    for match in _PACKET.finditer(content):
        try:
            packet = ElementTree.fromstring(match[0])
        except ElementTree.ParseError as error:
            line = content.count(b"\n", 0, match.start()) + 1
            raise LogError(f"{file}: line {line}: a packet is not well-formed XML: {error}; correct or leave out that line") from None
        values = _numbers(packet)
        if packet.tag == "Rob":
            rows.append(values)
            if "IPOC" in values:
                by_ipoc[values["IPOC"]] = values
        else:
            answers.append(values)
    for values in answers:
        row = by_ipoc.get(values.get("IPOC", np.nan))
        if row is not None:
            row.update({f"Sen.{k}": v for k, v in values.items() if k != "IPOC"})
    if not rows:
        raise LogError(f"{file}: there is no packet <Rob ...>...</Rob> in it; expected a recording of RSI messages")
    names = tuple(dict.fromkeys(name for row in rows for name in row))
    units = {n: _RSI_UNITS[n] for n in names if n in _RSI_UNITS}
    return Log(file, names, lambda name: np.array([row.get(name, np.nan) for row in rows]), units)


def _numbers(packet: ElementTree.Element) -> dict[str, float]:
    """`Tag.Attribute` and `Tag` of every number below a packet."""
    found: dict[str, float] = {}
    for child in packet.iter():
        if child is packet:
            continue
        for key, text in (*((f"{child.tag}.{a}", v) for a, v in child.attrib.items()), (child.tag, child.text or "")):
            try:
                found[key] = float(text)
            except ValueError:
                continue  # texts such as TYPE are no signals
    return found
