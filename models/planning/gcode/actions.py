"""What a program comes to: moves, dwells, and the program that holds them. Workpiece frame P, SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Vector = tuple[float, float, float]


class GCodeError(ValueError):
    """A program that cannot be read: names file, line, what was found and what is supported."""

    def __init__(self, name: str, line: int, text: str, found: str, supported: str) -> None:
        super().__init__(f"{name} line {line}: {found} in {text.strip()!r}; {supported}")
        self.line = line


@dataclass(frozen=True)
class Move:
    """A straight move in P, from `start` to `end` [m]."""

    line: int
    """Line of the file, from 1."""
    block: int
    """N number; the line where there is none."""
    start: Vector
    end: Vector
    feed: float | None
    """Feed in m/s; None = rapid (G0)."""
    spindle_speed: float
    """rad/s; positive for M3 (clockwise seen from the spindle), negative for M4, 0 for M5."""
    tolerance: float
    """Largest deviation in m when the corner at the end is blended (G64 P); 0 = exact (G61)."""
    tool: int = field(default=0, kw_only=True)
    """T number of the tool in the spindle (M6); 0 = none named."""


@dataclass(frozen=True)
class Arc(Move):
    """A circular or helical move in P about the axis through `centre` [m] along the unit vector `axis`."""

    centre: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    angle: float = 0.0
    """Angle travelled in rad, right-handed about `axis`: positive for G3, negative for G2; more than a turn with P."""


@dataclass(frozen=True)
class Dwell:
    """Standstill for `duration` [s] (G4); of 0 s where the path only comes to rest (M0, M6)."""

    line: int
    block: int
    duration: float
    spindle_speed: float
    tool: int = 0
    """T number of the tool in the spindle, 0 where none is named."""


@dataclass(frozen=True)
class Program:
    """A program that was read: its actions in order, in workpiece coordinates P, SI."""

    name: str
    actions: tuple[Move | Dwell, ...]
    source: tuple[str, ...]
    """The lines of the file, for messages."""
    tool: int
    """T number at the end, 0 where none is named."""
    final_spindle_speed: float
    """rad/s after the last action (0 after M30)."""
    notes: tuple[str, ...] = ()
    """What was skipped or taken in a way that the program does not say, one text each."""
    named_diameters: Mapping[int, float] = field(default_factory=dict)
    """T number -> diameter [m] that a comment of the program gives it; 0 for a comment without T."""

    @property
    def tools(self) -> tuple[int, ...]:
        """T numbers of the tools that move, in the order of first use."""
        return tuple(dict.fromkeys(a.tool for a in self.actions if isinstance(a, Move)))
