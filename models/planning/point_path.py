"""Read a tool path with orientations: a TOML list of points, for what a three-axis G-code program cannot say.

::

    orientation = "path"        # or "corner": see `PointPath`
    [[point]]
    position = [-50, 0, 0]      # mm in P
    orientation = [0, 0, 0]     # A, B, C in deg; 0, 0, 0 = tool axis along -z of P
    blend = 0                   # mm; radius around the point in which the corner is blended, 0 = exact stop
    feed = 25                   # mm/s on the way to this point
    speed = 13000               # rev/min on the way to this point

`orientation`, `blend`, `feed` and `speed` keep their value until a later point says otherwise.
"""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from robomill.models.model.units import to_si
from robomill.models.planning.gcode import Vector

Interpolation = Literal["corner", "path"]
_HEADER = re.compile(r"\s*\[\[\s*[\"']?point[\"']?\s*\]\]")
_POINT_KEYS = ("position", "orientation", "blend", "feed", "speed")


class PathError(ValueError):
    """A point file that cannot be read: names file, line at which the point begins, what was found and what is expected."""


@dataclass(frozen=True)
class PathPoint:
    """A point of the path in P, SI units."""

    position: Vector
    abc: Vector
    """A, B, C [rad] of T against its upright orientation: Rz(A) Ry(B) Rx(C) in tool axes; B turns about tool y, C about tool x."""
    blend: float
    feed: float
    spindle_speed: float


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


def parse_points(text: str, name: str = "path") -> PointPath:
    """Read the point list `text`; PathError (a ValueError) at the first thing that is not as in the module's example."""
    try:
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:  # the latter: nested too deep
        raise PathError(f"{name}: not valid TOML: {error}") from None
    unknown = sorted(set(table) - {"orientation", "point"})
    if unknown:
        raise PathError(f"{name}: unknown keys {unknown}; known: orientation, point")
    interpolation = table.get("orientation", "path")
    if interpolation not in ("corner", "path"):
        raise PathError(
            f"{name}: orientation = {interpolation!r}; expected 'corner' (change at the corners) or 'path' (over the whole way)"
        )
    entries = table.get("point", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries) or len(entries) < 2:
        found = len(entries) if isinstance(entries, list) else repr(entries)
        raise PathError(f"{name}: a path needs at least two [[point]] tables; found {found}")
    lines = [number for number, line in enumerate(text.splitlines(), start=1) if _HEADER.match(line)]
    points: list[PathPoint] = []
    current: dict[str, Any] = {"orientation": [0, 0, 0], "blend": 0}
    for i, entry in enumerate(entries, start=1):
        where = f"{name}:{lines[i - 1]}: point {i}" if len(lines) == len(entries) else f"{name}: point {i}"
        unknown = sorted(set(entry) - set(_POINT_KEYS))
        if unknown:
            raise PathError(f"{where}: unknown keys {unknown}; known: {', '.join(_POINT_KEYS)}")
        current = {**current, **entry}
        if "position" not in entry:
            raise PathError(f"{where}: position is missing; expected position = [x, y, z] in mm")
        if i > 1 and "feed" not in current:
            raise PathError(f"{where}: feed is missing; expected feed = <mm/s> here or at an earlier point")
        points.append(
            PathPoint(
                _vector(where, "position", current["position"], 1e-3),
                _vector(where, "orientation", current["orientation"], math.pi / 180.0),
                _number(where, "blend", current["blend"], "mm", 0.0),
                _number(where, "feed", current.get("feed", 1.0), "mm/s", 1e-3),
                _number(where, "speed", current.get("speed", 0.0), "rpm"),
            )
        )
    return PointPath(name, tuple(points), interpolation, tuple(f"point {i + 1}: {p.position}" for i, p in enumerate(points)))


def read_points(path: str | Path) -> PointPath:
    """Read the point file `path`. FileNotFoundError if there is none; else as `parse_points`."""
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"no path file {file}; expected a TOML file with [[point]] tables")
    return parse_points(file.read_text(encoding="utf-8"), file.name)


def _number(where: str, key: str, value: object, unit: str, minimum: float = -math.inf) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < minimum:
        bound = f", at least {minimum:g}" if minimum > -math.inf else ""
        raise PathError(f"{where}: {key} = {value!r}; expected a number in {unit}{bound}")
    return to_si(value, unit)


def _vector(where: str, key: str, value: object, factor: float) -> Vector:
    numbers = value if isinstance(value, list) else []
    if len(numbers) != 3 or any(isinstance(v, bool) or not isinstance(v, int | float) or not math.isfinite(v) for v in numbers):
        raise PathError(f"{where}: {key} = {value!r}; expected three numbers in {'mm' if key == 'position' else 'deg'}")
    x, y, z = (factor * v for v in numbers)
    return x, y, z
