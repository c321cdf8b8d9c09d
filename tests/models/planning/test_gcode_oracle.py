"""Our reader beside another interpreter (pygcode): end points, feeds, speeds, arcs and drilling cycles of seeded programs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pygcode
import pytest
from pygcode.transform import ArcLinearizeInside, linearize_arc, simplify_canned_cycle

from robomill.models.planning.gcode import Arc, Move, parse
from tests.tolerances import ROUNDOFF, physics

PLANES = {17: ("X", "Y", "I", "J"), 18: ("Z", "X", "K", "I"), 19: ("Y", "Z", "J", "K")}
CHORD = 1e-3
"""Largest distance [mm] of the other's chords from an arc."""
DIGIT = physics(0.0, absolute=5e-9)
"""m: half a unit of the last digit that the programs are written with (1e-5 mm), where it matters."""
UNIT = {21: 1e-3, 20: 0.0254}


def program(seed: int, blocks: int = 120) -> str:
    """A random program of lines, arcs and modal changes as CAM systems write them; G20 or G21 throughout."""
    rng = np.random.default_rng(seed)
    lines = [f"G{rng.choice([20, 21])} G17 G40 G49 G80 G90 G94", "G54", "T1 M6", "S8000 M3", "G0 X0 Y0 Z5", "F600"]
    for number in range(10, 10 * blocks, 10):
        kind = rng.integers(0, 10)
        words = " ".join(f"{axis}{v:.5f}" for axis, v in zip("XYZ", rng.uniform(-40, 40, 3), strict=True) if rng.random() < 0.7) or "X1.5"
        if kind < 3:
            lines.append(f"N{number} G1 {words}" + (f" F{rng.uniform(50, 3000):.1f}" if rng.random() < 0.3 else ""))
        elif kind < 5:
            lines.append(f"N{number} G0 {words}")
        elif kind < 6:
            lines.append(f"N{number} G{rng.choice([90, 91])}")
        elif kind < 7:
            lines.append(f"N{number} S{rng.integers(1000, 20000)} M{rng.choice([3, 4])}")
        elif kind < 8:
            lines.append(f"N{number} G{rng.choice([17, 18, 19])}")
        else:
            lines.append(f"N{number} {arc(rng)}")
    return "\n".join([*lines, "M30"])


def arc(rng: np.random.Generator) -> str:
    """An incremental arc in a plane of its own, by centre or by radius; G90 and G17 again behind it."""
    plane = int(rng.choice([17, 18, 19]))
    a, b, i, j = PLANES[plane]
    code, radius, begin = int(rng.choice([2, 3])), rng.uniform(1, 30), rng.uniform(0, 2 * math.pi)
    turn = rng.uniform(0.2, 1.9 * math.pi) * (1 if code == 3 else -1)
    centre = -radius * np.array([math.cos(begin), math.sin(begin)])
    end = centre + radius * np.array([math.cos(begin + turn), math.sin(begin + turn)])
    where = f"G91 G{plane} G{code} {a}{end[0]:.9f} {b}{end[1]:.9f}"
    if rng.random() < 0.5:
        return f"{where} R{math.copysign(radius, math.pi - abs(turn)):.9f}"
    return f"{where} {i}{centre[0]:.9f} {j}{centre[1]:.9f}"


def others(text: str) -> tuple[list[dict[str, Any]], float]:
    """What pygcode makes of the program: one entry per block that moves."""
    machine = pygcode.Machine()
    found = []
    unit = UNIT[20] if "G20" in text else UNIT[21]
    for line in text.splitlines()[1:]:
        block = pygcode.Line(line).block
        start = dict(machine.pos.values)
        machine.process_block(block)
        end = dict(machine.pos.values)
        motion = next((g for g in block.gcodes if isinstance(g, pygcode.gcodes.GCodeMotion)), None)
        if motion is None:
            continue
        chords = None
        if isinstance(motion, pygcode.gcodes.GCodeArcMove):
            mode = machine.mode
            position = pygcode.machine.Position(axes="XYZ", **start)
            steps = linearize_arc(motion, position, mode.plane_selection, ArcLinearizeInside, mode.distance, None, CHORD, 9)
            chords = [{**s.get_param_dict("XYZ")} for s in steps]
        speed = machine.mode.spindle_speed.word.value * {"M03": 1, "M04": -1}[str(machine.mode.spindle)[:3]]
        found.append(
            {
                "start": start,
                "end": end,
                "feed": None if isinstance(motion, pygcode.gcodes.GCodeRapidMove) else machine.mode.feed_rate.word.value,
                "speed": speed,
                "chords": chords,
                "incremental": isinstance(machine.mode.distance, pygcode.gcodes.GCodeIncrementalDistanceMode),
            }
        )
    return found, unit


def vector(place: dict[str, float], unit: float) -> np.ndarray:
    return np.array([place[a] for a in "XYZ"]) * unit


@pytest.mark.parametrize("seed", range(6))
def test_random_programs(seed: int) -> None:
    text = program(seed)
    theirs, unit = others(text)
    # what does not move is no move of ours
    theirs = [t for t in theirs if t["chords"] or not np.array_equal(vector(t["start"], unit), vector(t["end"], unit))][1:]
    ours = [a for a in parse(text).actions if isinstance(a, Move)]
    assert len(ours) == len(theirs)
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine.start, vector(other["start"], unit), rtol=0.0, atol=1e3 * ROUNDOFF)
        np.testing.assert_allclose(mine.end, vector(other["end"], unit), rtol=0.0, atol=1e3 * ROUNDOFF)
        assert mine.feed == (None if other["feed"] is None else pytest.approx(other["feed"] * unit / 60.0, rel=ROUNDOFF))
        assert mine.spindle_speed == pytest.approx(other["speed"] * math.pi / 30.0, rel=ROUNDOFF)
        assert isinstance(mine, Arc) == bool(other["chords"])
        if isinstance(mine, Arc) and mine.axis[2] == 1.0:  # pygcode 0.2.1 turns some arcs of G18 and G19 the wrong way round
            compare_arc(mine, other, unit)


def compare_arc(mine: Arc, other: dict[str, Any], unit: float) -> None:
    """The other's chords begin and end on our arc, lie on its circle, and turn by its angle."""
    points = [vector(other["start"], unit)]
    for step in other["chords"]:
        last = points[-1] / unit
        here = {a: step.get(a, 0.0 if other["incremental"] else last[k]) for k, a in enumerate("XYZ")}
        points.append(vector(here, unit) + (points[-1] if other["incremental"] else 0.0))
    out = np.array(points) - mine.centre
    axis = np.array(mine.axis)
    out -= np.outer(out @ axis, axis)
    radius = np.linalg.norm(out, axis=1)
    np.testing.assert_allclose(radius, radius[0], rtol=0.0, atol=unit * CHORD + DIGIT)
    turns = np.arctan2(np.cross(out[:-1], out[1:]) @ axis, np.sum(out[:-1] * out[1:], axis=1))
    assert float(np.sum(turns)) == pytest.approx(mine.angle, abs=2.0 * (unit * CHORD + DIGIT) / radius[0])


CYCLES = [
    ("G81 X1 Y2 Z-3 R1", "G98"),
    ("G81 X1 Y2 Z-3 R1", "G99"),
    ("G81 X-4 Y2 Z-3.5 R0.5", "G98"),
    ("G81 X1 Y0 Z-3 R6", "G99"),
]
"""What pygcode writes out as the standard has it; its dwells and pecks are its own."""


@pytest.mark.parametrize(("cycle", "retract"), CYCLES)
@pytest.mark.parametrize("mode", ["G90", "G91"])
def test_drilling_cycles(cycle: str, retract: str, mode: str) -> None:
    """Corners of the path of one hole from Z5; G91 with R and Z as increments."""
    if mode == "G91":
        cycle = cycle.replace("R", "R-") if "R6" not in cycle else cycle
    text = f"G21 G90 G17\nF100 S1000 M3\nG0 X0.5 Y0 Z5\n{mode} {retract} {cycle}\nM30"
    ours = [a for a in parse(text).actions if isinstance(a, Move)]
    start = pygcode.machine.Position(axes="XYZ", X=0.5, Y=0.0, Z=5.0)
    (code,) = [g for g in pygcode.Line(cycle).block.gcodes if isinstance(g, pygcode.gcodes.GCodeCannedCycle)]
    incremental = pygcode.gcodes.GCodeIncrementalDistanceMode() if mode == "G91" else pygcode.gcodes.GCodeAbsoluteDistanceMode()
    back = pygcode.gcodes.GCodeCannedCycleReturnPrevLevel() if retract == "G98" else pygcode.gcodes.GCodeCannedCycleReturnToR()
    points, place = [], {"X": 0.5, "Y": 0.0, "Z": 5.0}
    for step in simplify_canned_cycle(code, start, None, incremental, back):
        given = step.get_param_dict("XYZ")
        if given:
            place = {a: (place[a] + given.get(a, 0.0) if mode == "G91" else given.get(a, place[a])) for a in "XYZ"}
            points.append(tuple(vector(place, 1e-3)))
    np.testing.assert_allclose([m.end for m in ours], points, rtol=0.0, atol=1e3 * ROUNDOFF)
