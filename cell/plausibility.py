"""What is unusual, and often a slip of a unit: told before a run, with what is usual and why. Nothing here stops a run.

The ranges and their sources are data: `models/data/process/usual.toml`.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import DATA, load, quantity
from robomill.models.model.units import from_si
from robomill.models.planning.gcode import Move
from robomill.models.process.cutting import EndMill
from robomill.orchestration.assembly import Assembly
from robomill.orchestration.slaves.protocol import base_name

_FILE = "process/usual"
_PARAMETERS = {"diameter": "diameter", "block_size": "block_size", "Ktc": "cutting_coefficient", "stiffness": "stiffness"}
"""Parameter of a component -> its range."""
_RIGID = 1e90
"""N.m/rad from which a spring stands for none: Table 1 of the paper prints 9.9e99 N.mm/rad."""
_GEOMETRY = re.compile(r"(p|quat|abc)_[A-Z]{2}(_[A-Z])?|dh_\w+|axis_sign|tool_length|sensor_position|holder_position")
"""Names of parameters that are the same piece of the machine wherever they stand (docs/nomenclature.md)."""
_SAME = 1e-9
"""Part of the largest element by which geometry may differ: what a conversion of units rounds."""


@dataclass(frozen=True)
class Usual:
    """[least, most] of each quantity, SI."""

    diameter: FloatArray = field(metadata=quantity("m", 0.0))
    spindle_speed: FloatArray = field(metadata=quantity("rad/s", 0.0))
    cutting_speed: FloatArray = field(metadata=quantity("m/s", 0.0))
    feed_per_tooth: FloatArray = field(metadata=quantity("m", 0.0))
    depth_over_diameter: FloatArray = field(metadata=quantity("1", 0.0))
    block_size: FloatArray = field(metadata=quantity("m", 0.0))
    cutting_coefficient: FloatArray = field(metadata=quantity("Pa", 0.0))
    stiffness: FloatArray = field(metadata=quantity("N.m/rad", 0.0))


@cache
def usual() -> Usual:
    """The ranges."""
    return load(Usual, _FILE)


@cache
def _entries() -> dict[str, dict[str, Any]]:
    return tomllib.loads((DATA / f"{_FILE}.toml").read_text(encoding="utf-8"))


def unusual(name: str, value: float, what: str) -> str | None:
    """A sentence if the quantity `name` (SI) is outside of its range; `what` says whose it is."""
    low, high = getattr(usual(), name)
    if low <= value <= high:
        return None
    entry = _entries()[name]
    unit = entry["unit"]
    least, most = (f"{from_si(v, unit):.6g}" for v in (low, high))
    shown = f"{from_si(value, unit):.6g}{'' if unit == '1' else f' {unit}'}"
    return f"{what} is {shown}; usual is {least} to {most}{'' if unit == '1' else f' {unit}'} ({entry['source']})"


def unusual_cuts(moves: Sequence[Move], depth: Sequence[float], tools: Mapping[int, EndMill]) -> list[str]:
    """What is unusual about the moves that cut (`depth` [m] into the material): of each kind and tool the extremes."""
    found = []
    for number, mill in sorted(tools.items()):
        name = f"tool T{number}" if number else "the tool"
        found.append(unusual("diameter", mill.diameter, f"{name}: diameter"))
        mine = [
            (m.line, quantities)
            for m, d in zip(moves, depth, strict=True)
            if m.tool == number and (quantities := _quantities(m, d, mill)) is not None
        ]
        for kind in mine[0][1] if mine else ():
            values = [quantities[kind] for _, quantities in mine]
            for extreme in (min(values), max(values)):
                line = mine[values.index(extreme)][0]
                found.append(unusual(kind, extreme, f"{name}: {kind.replace('_', ' ')} at line {line}"))
    return list(dict.fromkeys(text for text in found if text is not None))


def _quantities(move: Move, depth: float, mill: EndMill) -> dict[str, float] | None:
    """What a cut is judged by, SI; None for a rapid, or while the spindle stands."""
    n = move.spindle_speed
    if n <= 0.0 or move.feed is None:
        return None
    return {
        "spindle_speed": n,
        "cutting_speed": 0.5 * mill.diameter * n,
        "feed_per_tooth": 2.0 * math.pi * move.feed / (mill.teeth * n),
        "depth_over_diameter": depth / mill.diameter,
    }


def unusual_values(assembly: Assembly) -> list[str]:
    """What is unusual about the parameters that a system sets, and geometry that its components do not have in common."""
    found = []
    for component, values in assembly.parameters.items():
        for name, value in values.items():
            kind = _PARAMETERS.get(name.partition("[")[0])
            if kind is not None and isinstance(value, int | float) and not (kind == "stiffness" and value > _RIGID):
                found.append(unusual(kind, float(value), f"{component}.{name}"))
    return [*(text for text in found if text is not None), *_differing_geometry(assembly)]


@cache
def _is_geometry(parameter: str) -> bool:
    return _GEOMETRY.fullmatch(parameter) is not None


def _differing_geometry(assembly: Assembly) -> list[str]:
    """Equally named geometry with other values."""
    values: dict[str, dict[str, FloatArray]] = {}
    units: dict[str, str] = {}
    for component, slave in assembly.slaves.items():
        given = assembly.parameters.get(component, {})
        arrays: dict[str, list[float]] = {}
        for p in slave.ports:
            base = base_name(p.name)
            value = given.get(p.name, p.start)
            if p.causality == "parameter" and _is_geometry(base) and isinstance(value, int | float):
                arrays.setdefault(base, []).append(float(value))
                units[base] = p.unit or "1"
        for base, listed in arrays.items():
            values.setdefault(base, {})[component] = np.array(listed)
    texts = []
    for base, by_component in values.items():
        groups: list[tuple[FloatArray, list[str]]] = []
        for component, array in by_component.items():
            for other, members in groups:
                if array.shape == other.shape and np.all(np.abs(array - other) <= _SAME * np.abs(other).max(initial=1e-12)):
                    members.append(component)
                    break
            else:
                groups.append((array, [component]))
        if len(groups) > 1:
            unit = "" if units[base] == "1" else f" {units[base]}"
            said = " and ".join(f"{_listed(array)}{unit} in {', '.join(members)}" for array, members in groups)
            texts.append(f"{base} is {said}: one machine has one; give it to all of them, or know why it differs")
    return texts


def _listed(array: FloatArray) -> str:
    return f"{array[0]:.9g}" if len(array) == 1 else f"[{', '.join(f'{v:.9g}' for v in array)}]"
