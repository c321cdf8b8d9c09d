"""Read a tool path with orientations: a TOML list of points, for what a three-axis G-code program cannot say.

Keys are declared below (`PathKeys`), with an example in docs/reference/formats/points.md. A key of a point keeps its value until a later
point says otherwise.
"""

from __future__ import annotations

import math
from pathlib import Path

from robomill.models.model.units import to_si
from robomill.models.planning.gcode import Vector
from robomill.models.planning.point_path import INTERPOLATIONS, PathPoint, PointPath
from robomill.orchestration.system import keys
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, Kind, default, optional, required

_FIRST = 1e-3
"""Feed [m/s] to a first point that names none: nothing is on the way to it."""


class PathError(ValueError):
    """A point file that cannot be read: names file, line, point and key, what was found and what is expected."""


def _number(entry: Entry, unit: str, least: float = -math.inf) -> float:
    what = f"a number in {unit}" + (f", at least {least:g}" if least > -math.inf else "")
    if entry.number(what) < least:
        raise entry.expected(what)
    return to_si(entry.number(), unit)


def _vector(entry: Entry, unit: str, factor: float) -> Vector:
    x, y, z = (factor * element.number(f"a number in {unit}") for element in entry.triple(f"three numbers in {unit}"))
    return x, y, z


class PointKeys(Keys):
    """A point of the path; a key that is missing keeps its value from the point before."""

    position = required(
        Kind(lambda e: _vector(e, "mm", 1e-3), "three numbers in mm"), "where the tool tip is, in the frame of the workpiece"
    )
    orientation = default(
        [0, 0, 0], Kind(lambda e: _vector(e, "deg", math.pi / 180.0), "three numbers in deg"), "A, B, C; 0, 0, 0: tool axis along -z"
    )
    blend = default(
        0.0, Kind(lambda e: _number(e, "mm", 0.0), "number in mm from 0"), "radius in which the corner is blended; 0: exact stop"
    )
    feed = optional(
        Kind(lambda e: _number(e, "mm/s", 1e-3), "number in mm/s from 0.001"), "feed on the way to the point; the first two need it"
    )
    speed = default(0.0, Kind(lambda e: _number(e, "rpm"), "number in rpm"), "spindle speed on the way to the point")


class PathKeys(Keys):
    """A tool path with orientations, which a three-axis program cannot say."""

    orientation = default("path", keys.choice(INTERPOLATIONS), "where the tool turns: over the way between points, or in the corners only")
    point = default([], keys.each(PointKeys), "the points, at least two")


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
    interpolation = PathKeys.orientation.of(PathKeys.of(top))
    entries = PathKeys.point.entry(top).each()
    if not entries[1:]:
        raise top.fail(f"expected at least two [[point]] tables; found {len(entries)}")
    points: list[PathPoint] = []
    k, current = PointKeys, top
    for entry in entries:
        k.of(entry)
        last = {} if current is top else current.value
        current = Entry(top.content, {**last, **entry.value}, entry.key)
        feed = k.feed.of(current)
        if points and feed is None:
            raise entry.fail("feed is missing; expected feed = <mm/s> here or at an earlier point")
        points.append(
            PathPoint(
                k.position.of(current),
                k.orientation.of(current),
                k.blend.of(current),
                _FIRST if feed is None else feed,
                k.speed.of(current),
            )
        )
    return PointPath(top.content.name, tuple(points), interpolation, tuple(f"point {i}: {p.position}" for i, p in enumerate(points, 1)))
