"""What is measured in a case: short programs in the workpiece frame, poses of the workpiece, and what the experimenter sets.

A condition is complete knowledge of what was done, not of what happened: program, place of the block, controller mode, time since
switching on. The nominal simulation of a run is the nominal system with these parameters.
"""

from __future__ import annotations

import math
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


@dataclass(frozen=True)
class Condition:
    """One way to measure."""

    name: str
    position: tuple[float, float, float]
    turn: float
    """deg"""
    depth: float
    """m"""
    feed: float
    """m/s"""
    mirrored: bool = False
    """Program mirrored at the x axis of the block: other side cuts, other reversals."""
    reversals: bool = True
    """Whether the program begins with reversals in the air."""
    mode: int = 1
    warm_up_time: float = 5400.0
    """s since switching on."""


def program(c: Condition) -> PointPath:
    """Reversals of position and orientation in the air, then a slot along x and one along y that leaves the block."""
    side = -1.0 if c.mirrored else 1.0
    points: list[PathPoint] = []

    def go(x: float, y: float, z: float, feed: float, abc: tuple[float, float, float] = (0.0, 0.0, 0.0), blend: float = 0.0) -> None:
        degrees = math.pi / 180.0
        turned = (abc[0] * degrees, side * abc[1] * degrees, side * abc[2] * degrees)
        points.append(PathPoint((1e-3 * x, 1e-3 * side * y, 1e-3 * z), turned, 1e-3 * blend, feed, SPINDLE))

    go(-62.0, 0.0, 22.0, 0.15)
    if c.reversals:
        go(-62.0, 30.0, 22.0, 0.15)
        go(-62.0, -20.0, 40.0, 0.15)
        go(-35.0, -20.0, 20.0, 0.15, (5.0, 6.0, -5.0))
        go(-62.0, 10.0, 30.0, 0.15, (-5.0, -3.0, 5.0))
    z = -1e3 * c.depth
    go(-58.0, -14.0, 6.0, 0.15)
    go(-58.0, -14.0, z, 0.10)
    go(10.0, -14.0, z, c.feed, blend=1.0)
    go(10.0, 44.0, z, c.feed)
    go(10.0, 44.0, 12.0, 0.10)
    return PointPath(c.name, tuple(points), "path", tuple(f"point {i + 1}" for i in range(len(points))))


@lru_cache(maxsize=64)
def planned(c: Condition) -> Plan:
    """The planned program in B."""
    return plan(program(replace(c, name="program")), Placement(c.position, (math.radians(c.turn), 0.0, 0.0)))


def known(c: Condition, segments: str) -> dict[str, dict[str, Any]]:
    """What the experimenter sets, component -> parameter -> value (SI); `segments` is the file of the planned program."""
    quaternion: FloatArray = np.roll(Rotation.from_euler("ZYX", (math.radians(c.turn), 0.0, 0.0)).as_quat(canonical=True), 1)
    return {
        "path": {"segments": segments},
        "milling": {
            "p_BP_B": [float(v) for v in c.position],
            "quat_BP": [float(v) for v in quaternion],
            "block_size": list(BLOCK),
            "spacing": 0.0005,
        },
        "controller": {"mode": c.mode},
        "compliance": {"warm_up_time": c.warm_up_time},
    }


_TRAINING = (
    Condition("training", POSITIONS[0], 180.0, 4e-3, 0.04),
    Condition("training", POSITIONS[0], 0.0, 3e-3, 0.03, mirrored=True),
    Condition("training", POSITIONS[1], 90.0, 4e-3, 0.03),
    Condition("training", POSITIONS[1], -90.0, 5e-3, 0.04, mirrored=True),
    Condition("training", POSITIONS[2], 180.0, 5e-3, 0.03, mirrored=True),
    Condition("training", POSITIONS[3], 0.0, 3e-3, 0.04),
)
"""Few on purpose: nominal runs and signatures of one serve many cases."""
MIDDLE_DEPTH = 4e-3
"""Depth [m] in the middle of those of the training: a cut up to it is made 1 mm deeper in the other condition, one beyond it 1 mm
shallower, so that all are between the shallowest and the deepest of the training."""


def draw(random: np.random.Generator) -> tuple[Condition, Condition, Condition]:
    """Training condition and two held-out ones: another depth, feed, side and turn at the same place; another place, uncompensated."""
    number = int(random.integers(len(_TRAINING)))
    main = _TRAINING[number]
    other_cut = replace(
        main,
        name="other cut",
        depth=main.depth - 1e-3 if main.depth > MIDDLE_DEPTH else main.depth + 1e-3,
        feed=0.07 - main.feed,
        turn=TURNS[(TURNS.index(main.turn) + 1) % len(TURNS)],
        mirrored=not main.mirrored,
    )
    place = POSITIONS[(POSITIONS.index(main.position) + 1 + number % 3) % len(POSITIONS)]
    other_place = replace(main, name="other place", position=place, mode=0, warm_up_time=1800.0)
    return main, other_cut, other_place
