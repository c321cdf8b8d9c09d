"""What is measured in a case: cuts and loads in several shapes, drawn anew for each seed.

A condition is complete knowledge of what was done, not of what happened: program, place, load, controller mode, time since
switching on. The nominal simulation of a run is the nominal system with these parameters: the milling cell for a cut, the cell with an
applied load for everything else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robomill.models.model.declaration import FloatArray
from robomill.models.planning.point_path import PathPoint, PointPath
from robomill.models.planning.trajectory import Placement, Plan, plan

SPINDLE = 10_000.0 * 2.0 * math.pi / 60.0
"""rad/s; three teeth pass in 6 ms, so a communication step of 2 or 4 ms holds whole tooth periods (1 or 2)."""
BLOCK = (0.080, 0.060, 0.030)
"""Size of the block [m]."""
POSITIONS = ((1.30, 0.0, 1.20), (1.45, 0.25, 1.05), (1.25, -0.35, 1.10), (1.55, -0.10, 1.25))
"""Centre of the block's top in B [m]."""
TURNS = (180.0, 90.0, 0.0, -90.0)
"""Rotation A of the block [deg]: turns the feed in B."""


CUTS, LOADS = ("slots", "zigzag", "ramp"), ("hold", "air", "poses")
"""Programs of the milling cell, and of the cell with an applied load."""
GRAVITY = 9.81
"""m/s2, as in the models."""
POSE = 6.0
"""Angle [deg] by which the tool is turned between poses: so little that no place brings the wrist through its singularity (A5 = 0)."""
GROWTH, HOLD = 0.25, 0.35
"""Seconds in which a push grows or falls, and for which it is held."""


@dataclass(frozen=True)
class Condition:
    """One way to measure. SI, but for degrees."""

    name: str
    """Name of the condition."""
    position: tuple[float, float, float]
    """Centre of the block's top in the robot base [m]."""
    turn: float
    """deg"""
    depth: float = 0.0
    """m"""
    feed: float = 0.04
    """m/s"""
    mirrored: bool = False
    """Program mirrored at the x axis of the block: other side cuts, other reversals."""
    reversals: bool = True
    """Whether the program begins with reversals in the air."""
    mode: int = 1
    """Mode of the compensation controller."""
    warm_up_time: float = 5400.0
    """s since switching on."""
    program: str = "slots"
    """One of CUTS or LOADS."""
    push: float = 0.0
    """Force on the tool [N] along +x, -x, +y, -y, +z, -z of B in turn."""
    weight: float = 0.0
    """Mass [kg] that hangs from the tool tip all the time."""
    held_out: bool = False
    """Whether it is held out."""

    @property
    def cuts(self) -> bool:
        """Whether there is a cut: the milling cell makes it."""
        return self.program in CUTS


class _Points:
    """Points of a program in the frame of the block, mm and degrees."""

    def __init__(self, c: Condition) -> None:
        self.side = -1.0 if c.mirrored else 1.0
        self.spindle = SPINDLE if c.cuts else 0.0
        self.points: list[PathPoint] = []

    def go(self, x: float, y: float, z: float, feed: float, abc: tuple[float, float, float] = (0.0, 0.0, 0.0), blend: float = 0.0) -> None:
        """To a point [mm] at a feed [m/s], turned by abc [deg] on the way."""
        turned = (math.radians(abc[0]), self.side * math.radians(abc[1]), self.side * math.radians(abc[2]))
        self.points.append(PathPoint((1e-3 * x, 1e-3 * self.side * y, 1e-3 * z), turned, 1e-3 * blend, feed, self.spindle))


def program(c: Condition) -> PointPath:
    """The program of a condition: reversals of position and orientation in the air, then what its name says."""
    p = _Points(c)
    if c.program == "hold":
        seconds = load_table(c)[-1, 0]
        p.go(0.0, 0.0, 0.0, 0.1)
        p.go(2.0, 0.0, 0.0, 2e-3 / seconds)  # so slow that every axis rests, but for its direction
    elif c.program == "poses":
        for a, b, g in ((-1, -1, -1), (-1, -1, 0), (-1, 0, 1), (0, 1, 1), (0, 1, 0), (1, 0, -1), (1, -1, -1), (0, 0, 0)):
            p.go(0.0, 0.0, 2.0 * (len(p.points) % 2), 4e-3, (POSE * a, POSE * b, POSE * g))
    else:
        _reversals(p, c)
        {"slots": _slots, "zigzag": _zigzag, "ramp": _ramp, "air": _air}[c.program](p, c)
    return PointPath(c.name, tuple(p.points), "path", tuple(f"point {i + 1}" for i in range(len(p.points))))


def _reversals(p: _Points, c: Condition) -> None:
    p.go(-62.0, 0.0, 22.0, 0.15)
    if c.reversals:
        p.go(-62.0, 30.0, 22.0, 0.15)
        p.go(-62.0, -20.0, 40.0, 0.15)
        p.go(-35.0, -20.0, 20.0, 0.15, (5.0, 6.0, -5.0))
        p.go(-62.0, 10.0, 30.0, 0.15, (-5.0, -3.0, 5.0))


def _slots(p: _Points, c: Condition) -> None:
    """A slot along x and one along y that leaves the block."""
    z = -1e3 * c.depth
    p.go(-58.0, -14.0, 6.0, 0.15)
    p.go(-58.0, -14.0, z, 0.10)
    p.go(10.0, -14.0, z, c.feed, blend=1.0)
    p.go(10.0, 44.0, z, c.feed)
    p.go(10.0, 44.0, 12.0, 0.10)


def _zigzag(p: _Points, c: Condition) -> None:
    """To and fro along y with other engagements: full, and three quarters of the diameter."""
    z = -1e3 * c.depth
    p.go(-20.0, -44.0, 6.0, 0.15)
    p.go(-20.0, -44.0, z, 0.10)
    p.go(-20.0, 22.0, z, c.feed, blend=1.0)
    p.go(-8.0, 22.0, z, c.feed, blend=1.0)
    p.go(-8.0, -44.0, z, c.feed)
    p.go(-8.0, -44.0, 12.0, 0.10)


def _ramp(p: _Points, c: Condition) -> None:
    """A slot along x that grows from 1 mm to its full depth, and out along y."""
    p.go(-58.0, 8.0, 6.0, 0.15)
    p.go(-58.0, 8.0, -1.0, 0.10)
    p.go(14.0, 8.0, -1e3 * c.depth, c.feed, blend=1.0)
    p.go(14.0, 44.0, -1e3 * c.depth, c.feed)
    p.go(14.0, 44.0, 12.0, 0.10)


def _air(p: _Points, c: Condition) -> None:
    """A square in the air, to and fro."""
    for x, y in ((-40.0, 40.0), (40.0, 40.0), (40.0, -40.0), (-40.0, -40.0), (40.0, -40.0)):
        p.go(x, y, 30.0, 2.0 * c.feed)


def load_table(c: Condition) -> FloatArray:
    """The applied load: rows of time [s], force [N], moment [N m] on the tool in B, float64[n, 7]."""
    t, rows = 0.3, [[0.0, 0.0, 0.0, 0.0]]
    for axis in range(3) if c.push else ():
        for sense in (1.0, -1.0):
            force = [sense * c.push * (axis == i) for i in range(3)]
            rows += [[t, *rows[-1][1:]], [t + GROWTH, *force], [t + GROWTH + HOLD, *force]]
            t += GROWTH + HOLD
        rows.append([t + GROWTH, 0.0, 0.0, 0.0])
        t += 2.0 * GROWTH
    table = np.zeros((len(rows), 7))
    table[:, :4] = rows
    keep = np.concatenate([[True], np.diff(table[:, 0]) > 0.0])
    table[:, 3] -= c.weight * GRAVITY
    kept: FloatArray = table[keep]
    return kept


@lru_cache(maxsize=64)
def planned(c: Condition) -> Plan:
    """The planned program in B."""
    return plan(program(replace(c, name="program")), Placement(c.position, (math.radians(c.turn), 0.0, 0.0)))


SPACING = 2e-4
"""Distance of the dexels of a block [m]."""


def known(c: Condition, segments: str, profile: str = "profile.npy") -> dict[str, dict[str, Any]]:
    """What the experimenter sets, component -> parameter -> value (SI); the files are those of the planned program and of the load."""
    found: dict[str, dict[str, Any]] = {
        "path": {"segments": segments},
        "controller": {"mode": c.mode},
        "compliance": {"warm_up_time": c.warm_up_time},
    }
    if not c.cuts:
        return {**found, "load": {"profile": profile}}
    quaternion: FloatArray = np.roll(Rotation.from_euler("ZYX", (math.radians(c.turn), 0.0, 0.0)).as_quat(canonical=True), 1)
    block = {"p_BP_B": [float(v) for v in c.position], "quat_BP": [float(v) for v in quaternion], "block_size": list(BLOCK)}
    return {**found, "milling": {**block, "spacing": SPACING}}


SHALLOW, MIDDLE_DEPTH, DEEP = (2e-3, 6e-3), 4e-3, (8e-3, 10e-3)
"""Depths [m]: of usual cuts from and to; where the other cut is not deeper but shallower; of deep slots from and to."""
FEEDS = (0.025, 0.045)
"""Feeds [m/s] from and to."""
PUSHES, WEIGHTS = (400.0, 750.0), (20.0, 40.0)
"""Force [N] of a push and mass [kg] of a hanging weight, from and to."""


def cut(random: np.random.Generator, name: str, deep: bool = False) -> Condition:
    """A cut at a random place: program, depth, feed, side and turn."""
    depth = random.uniform(*(DEEP if deep else SHALLOW))
    return Condition(
        name,
        POSITIONS[int(random.integers(len(POSITIONS)))],
        TURNS[int(random.integers(len(TURNS)))],
        round(float(depth), 4),
        round(float(random.uniform(*FEEDS)) / (1.5 if deep else 1.0), 4),
        mirrored=bool(random.integers(2)),
        program="slots" if deep else CUTS[int(random.integers(len(CUTS)))],
    )


def other_cut(random: np.random.Generator, c: Condition) -> Condition:
    """A held-out cut at the same place: other depth, feed, side, turn and program."""
    return replace(
        c,
        name="other cut",
        depth=round(c.depth + (1e-3 if c.depth < MIDDLE_DEPTH else -1e-3), 4),
        feed=round(sum(FEEDS) - c.feed if c.depth <= SHALLOW[1] else c.feed, 4),
        turn=TURNS[(TURNS.index(c.turn) + 1) % len(TURNS)],
        mirrored=not c.mirrored,
        program=CUTS[int(random.integers(len(CUTS)))] if c.depth <= SHALLOW[1] else "slots",
        held_out=True,
    )


def _elsewhere(random: np.random.Generator, c: Condition) -> tuple[float, float, float]:
    """Another place than that of a condition."""
    return POSITIONS[(POSITIONS.index(c.position) + int(random.integers(1, len(POSITIONS)))) % len(POSITIONS)]


def pushes(random: np.random.Generator, name: str, place: int) -> Condition:
    """Static pushes in three directions, no compensation."""
    turn = TURNS[int(random.integers(len(TURNS)))]
    return Condition(name, POSITIONS[place], turn, mode=0, program="hold", push=round(float(random.uniform(*PUSHES))))


def hanging(random: np.random.Generator, place: int) -> Condition:
    """A weight that hangs while the robot turns it."""
    return Condition("hanging weight", POSITIONS[place], 180.0, mode=0, program="poses", weight=round(float(random.uniform(*WEIGHTS))))


def _two_cuts(random: np.random.Generator) -> tuple[Condition, ...]:
    main = cut(random, "training")
    second = replace(cut(random, "second"), position=_elsewhere(random, main))
    third = replace(main, name="other place", position=_elsewhere(random, main), mode=0, warm_up_time=1800.0, held_out=True)
    return main, second, other_cut(random, main), third


def _cut_and_loads(random: np.random.Generator) -> tuple[Condition, ...]:
    main = cut(random, "training", deep=bool(random.integers(2)))
    places = [int(i) for i in random.permutation(len(POSITIONS))]
    held = replace(pushes(random, "other pushes", places[2]), held_out=True)
    return main, pushes(random, "pushes", places[0]), hanging(random, places[1]), other_cut(random, main), held


def _campaign(random: np.random.Generator) -> tuple[Condition, ...]:
    places = [int(i) for i in random.permutation(len(POSITIONS))]
    static = [replace(pushes(random, f"pushes {i + 1}", places[i]), push=PUSHES[1]) for i in range(3)]
    air = Condition("air cut", POSITIONS[places[0]], 180.0, program="air", feed=FEEDS[0])
    poses = Condition("tracker poses", POSITIONS[places[1]], 180.0, mode=0, program="poses")
    slot = cut(random, "deep slot", deep=True)
    held = replace(pushes(random, "other pushes", places[3]), held_out=True)
    return *static, hanging(random, places[0]), air, slot, poses, other_cut(random, slot), held


SHAPES: Mapping[str, Any] = {"cuts": _two_cuts, "loads": _cut_and_loads, "campaign": _campaign}
"""What the cases of a benchmark are measured with: two cuts; a cut, pushes and a weight; all kinds of runs. Held-out ones last."""
POOL = 6
"""Draws of each shape in a benchmark. Few on purpose: nominal runs and signatures of one serve many cases."""


def draw(seed: int, shape: str, number: int) -> tuple[Condition, ...]:
    """The conditions of a case: one of the POOL draws of its shape that belong to the seed of the benchmark."""
    member = number % POOL
    found: tuple[Condition, ...] = SHAPES[shape](np.random.default_rng([seed, list(SHAPES).index(shape), member]))
    return found
