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
from pathlib import Path

from robomill.models.model.units import to_si
from robomill.models.planning.gcode import Vector
from robomill.models.planning.point_path import INTERPOLATIONS, PathPoint, PointPath
from robomill.orchestration.system.entries import Entry


class PathError(ValueError):
    """A point file that cannot be read: names file, line, point and key, what was found and what is expected."""


def parse_points(text: str, name: str = "path") -> PointPath:
    """Read the point list `text`; PathError (a ValueError) at the first thing that is not as in the module's example."""
    return _path(Entry.read(text, name, Path(), PathError))


def read_points(path: str | Path) -> PointPath:
    """Read the point file `path`. FileNotFoundError if there is none; else as `parse_points`."""
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"no path file {file}; expected a TOML file with [[point]] tables")
    return _path(Entry.load(file, PathError, name=file.name))


def _path(top: Entry) -> PointPath:
    top.keys((), {"orientation", "point"})
    interpolation = top.get("orientation", "path").choice(INTERPOLATIONS)
    entries = top.get("point", []).each()
    if not entries[1:]:
        raise top.fail(f"a path needs at least two [[point]] tables; found {len(entries)}")
    points: list[PathPoint] = []
    start = {"orientation": [0, 0, 0], "blend": 0.0, "feed": 1.0, "speed": 0.0}
    current = {key: Entry(top.content, value) for key, value in start.items()}
    for entry in entries:
        current |= entry.keys({"position"}, start).items()
        if points and not current["feed"].key:
            raise entry.fail("feed is missing; expected feed = <mm/s> here or at an earlier point")
        points.append(
            PathPoint(
                _vector(current["position"], "mm", 1e-3),
                _vector(current["orientation"], "deg", math.pi / 180.0),
                _number(current["blend"], "mm", 0.0),
                _number(current["feed"], "mm/s", 1e-3),
                _number(current["speed"], "rpm"),
            )
        )
    return PointPath(top.content.name, tuple(points), interpolation, tuple(f"point {i}: {p.position}" for i, p in enumerate(points, 1)))


def _number(entry: Entry, unit: str, least: float = -math.inf) -> float:
    what = f"a number in {unit}" + (f", at least {least:g}" if least > -math.inf else "")
    if entry.number(what) < least:
        raise entry.expected(what)
    return to_si(entry.number(), unit)


def _vector(entry: Entry, unit: str, factor: float) -> Vector:
    x, y, z = (factor * element.number(f"a number in {unit}") for element in entry.triple(f"three numbers in {unit}"))
    return x, y, z
