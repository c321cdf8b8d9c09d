"""A telegram of fixed structure: where its values stand, read from bytes and written to bytes that are there once and for all.

Nothing is allocated per telegram but small integers: values go to `Telegram.values` and `Telegram.wholes`, text to `Telegram.buffer`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from robomill.cell.rsi import telegram_kernels as kernels
from robomill.cell.rsi.telegram_kernels import WHOLE
from robomill.models.model.compiled import compiled

LONGEST = 4096
"""Bytes of the buffers; a telegram that fills one may be cut off and is refused."""
IPOC = "IPOC"
"""Counter of the robot controller, ms; every answer brings it back."""
_TEXTS = {
    kernels.NO_ROOT: "it does not begin with <{root}",
    kernels.STRUCTURE: "the XML is broken at byte {at}",
    kernels.FORBIDDEN: "a declaration, comment, entity or stray < at byte {at}; only elements with attributes or text are read",
    kernels.NOT_A_NUMBER: "the value at byte {at} is not a decimal number of at most 18 digits",
    kernels.TWICE: "the value at byte {at} is there twice",
    kernels.MISSING: "{place} is missing",
}


class TelegramError(ValueError):
    """A telegram that cannot be what it should be."""


@dataclass(frozen=True)
class Place:
    """A value of a telegram: `AIPos.A1` is an attribute, `FTC` the text of an element."""

    name: str
    decimals: int = 4
    """Decimals that are written; WHOLE for a whole number."""

    @property
    def tag(self) -> str:
        """Element."""
        return self.name.partition(".")[0]

    @property
    def attribute(self) -> str:
        """Attribute, "" for the text."""
        return self.name.partition(".")[2]


class Telegram:
    """One kind of telegram: root element, its attribute, places in their order, IPOC last.

    `values` float64[places] in the units of the wire, `wholes` int64[places] for whole numbers, IPOC is wholes[-1].
    """

    def __init__(self, root: str, kind: str, places: Sequence[Place]) -> None:
        """`kind`: the attribute of the root with its name, such as `TYPE="KUKA"`."""
        self.root = root
        self.places = (*places, Place(IPOC, WHOLE))
        names = [p.name for p in self.places]
        if len(set(names)) < len(names):
            raise TelegramError(
                f"<{root}>: {', '.join(sorted({n for n in names if names.count(n) > 1}))} twice; a name is one value"
                "; leave one of them out of the configuration file"
            )
        self.index = {name: i for i, name in enumerate(names)}
        self.buffer = bytearray(LONGEST)
        self.values = np.zeros(len(names))
        self.wholes = np.zeros(len(names), np.int64)
        self._bytes = np.frombuffer(self.buffer, np.uint8)
        self._seen = np.zeros(len(names), np.int64)
        self._report = np.zeros(1, np.int64)
        self._root = np.frombuffer(root.encode(), np.uint8)
        self._decimals = np.array([p.decimals for p in self.places])
        longest = max(len(part) for p in self.places for part in (p.tag, p.attribute))
        self._names = np.zeros((len(names), 2, longest), np.uint8)
        self._lengths = np.zeros((len(names), 2), np.int64)
        for i, p in enumerate(self.places):
            for j, part in enumerate((p.tag, p.attribute)):
                self._names[i, j, : len(part)] = np.frombuffer(part.encode(), np.uint8)
                self._lengths[i, j] = len(part)
        pieces = _pieces(root, kind, self.places)
        self._pieces = np.frombuffer("".join(pieces).encode(), np.uint8)
        self._starts = np.cumsum([0, *(len(p) for p in pieces)])
        self._scan, self._write = compiled(kernels.scan), compiled(kernels.write)
        views = memoryview(self.buffer)
        self._views = [views[:n] for n in range(LONGEST + 1)]
        self.read(self.write())  # compiled or loaded here, not by the first packet

    @property
    def ipoc(self) -> int:
        """IPOC of the telegram that was read last, or is to be written."""
        return int(self.wholes[-1])

    @ipoc.setter
    def ipoc(self, value: int) -> None:
        self.wholes[-1] = value

    def read(self, length: int) -> int:
        """Read the first `length` bytes of `buffer` into `values` and `wholes`; 0, or a status that `explain` puts into words."""
        if not 0 < length < LONGEST:
            self._report[0] = length
            return kernels.STRUCTURE
        return int(
            self._scan(
                self._bytes,
                length,
                self._root,
                self._names,
                self._lengths,
                self._decimals,
                self.values,
                self.wholes,
                self._seen,
                self._report,
            )
        )

    def explain(self, status: int) -> str:
        """Why the last telegram was refused."""
        at = int(self._report[0])
        place = self.places[at].name if status == kernels.MISSING else ""
        return _TEXTS[status].format(root=self.root, at=at, place=place)

    def write(self) -> int:
        """Write `values` and `wholes` into `buffer`; its length. TelegramError if a value is not finite or has more than 18 digits."""
        length = int(self._write(self._bytes, self._pieces, self._starts, self._decimals, self.values, self.wholes))
        if length < 0:
            given = ", ".join(f"{p.name} = {v:g}" for p, v in zip(self.places, self.values, strict=True))
            raise TelegramError(
                f"<{self.root}> cannot be written: {given}; expected finite numbers of at most 18 digits, {LONGEST} bytes in all"
            )
        return length

    def view(self, length: int) -> memoryview:
        """The first bytes of `buffer`; made in advance for every length."""
        return self._views[length]

    def put(self, text: bytes) -> int:
        """Copy the bytes of a telegram into `buffer`; their number, at most LONGEST."""
        length = min(len(text), LONGEST)
        self.buffer[:length] = text[:length]
        return length


def _pieces(root: str, kind: str, places: Sequence[Place]) -> list[str]:
    """Fixed text before each place, and after the last."""
    pieces, before = [], f"<{root} {kind}>"
    for tag, group in groupby(places, key=lambda p: p.tag):
        members = list(group)
        if not members[0].attribute:
            pieces.append(f"{before}<{tag}>")
            before = f"</{tag}>"
            continue
        before += f"<{tag}"
        for p in members:
            pieces.append(f'{before} {p.attribute}="')
            before = '"'
        before += " />"
    return [*pieces, f"{before}</{root}>"]
