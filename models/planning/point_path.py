"""A tool path with orientations, given by points: what a three-axis G-code program cannot say. See cell/points.py for its file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from robomill.models.planning.gcode import Vector

Interpolation = Literal["corner", "path"]
INTERPOLATIONS: tuple[Interpolation, ...] = get_args(Interpolation)


@dataclass(frozen=True)
class PathPoint:
    """A point of the path in P, SI units."""

    position: Vector
    abc: Vector
    """A, B, C [rad] of T against its upright orientation: Rz(A) Ry(B) Rx(C) in tool axes; B turns about tool y, C about tool x."""
    blend: float
    feed: float
    spindle_speed: float
    quat: tuple[float, float, float, float] | None = None
    """Orientation of T in P (w, x, y, z) where the program says it; then `abc` has no meaning."""
    line: int = 0
    """Line of the file; 0 = the number of the point."""
    tool: int = 0
    """T number of the tool in the spindle on the way to the point; 0 = none named."""
    dwell: float = 0.0
    """Standstill at the point [s]."""
    rapid: bool = False
    """Whether the way to the point is one through air."""


@dataclass(frozen=True)
class PointPath:
    """Points that were read, and how the orientation runs between them (Englert 2011, sections 4.1.1 and 4.2.1).

    ``corner``: only within the blend around a point; from there on the orientation is that of the point (where no
    blend is, the tool turns in place). ``path``: evenly over the whole way from point to point, with blends smoothing the change of rate.
    """

    name: str
    points: tuple[PathPoint, ...]
    interpolation: Interpolation
    source: tuple[str, ...]
    notes: tuple[str, ...] = ()
    """What was taken in a way that the file does not say, one text each."""
