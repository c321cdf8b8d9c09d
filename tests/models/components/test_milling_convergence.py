"""milling_force against independent oracles: order of convergence in the step, teeth and discs summed by brute force, closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robomill.models.components.milling_force import MODEL
from robomill.models.process.cutting import CuttingCoefficients, mean_force, slot_force
from tests.models.components.test_milling_force import FEED, GROOVE, K, Mill
from tests.models.components.test_milling_force import H as CYCLE
from tests.tolerances import ROUNDOFF, discretisation

STEPS = (0.004, 0.002, 0.001, 0.0005)
FINEST = 0.00025
"""s; one tooth period of the runs below, so that every step holds whole tooth periods and the ripple of the teeth drops out."""
WINDOW = 0.024
DURATION = 0.48
ONSET = 5e-6
"""m: feed per tooth at which the edge forces are fully there (parameter `edge_onset`)."""
CUTTERS: tuple[dict[str, Any], ...] = (
    {"teeth": 3},
    {"teeth": 2, "diameter": 0.006, "helix": 0.7},
    {"teeth": 4, "diameter": 0.020, "helix": 0.0},
)
Path = Callable[[float], tuple[np.ndarray, np.ndarray]]


def smooth(t: float, length: float) -> tuple[float, float]:
    """Way [m] and speed [m/s] from rest to rest within DURATION: speed 1 - cos."""
    u = t / DURATION
    return length * (u - math.sin(2 * math.pi * u) / (2 * math.pi)), length / DURATION * (1.0 - math.cos(2 * math.pi * u))


def ramp(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Down at a slope of 1:5, across the dexels."""
    s, v = smooth(t, 0.012)
    way = np.array([math.cos(0.3), math.sin(0.3), -0.2])
    return np.array([-0.006, 0.002, -0.002]) + s * way, v * way


def plunge(t: float) -> tuple[np.ndarray, np.ndarray]:
    """3 mm straight down within the block."""
    s, v = smooth(t, 0.003)
    return np.array([0.001, 0.002, -0.001 - s]), np.array([0.0, 0.0, -v])


def arc(t: float) -> tuple[np.ndarray, np.ndarray]:
    """A helix of 12 mm radius, slope 1:10."""
    s, v = smooth(t, 0.012)
    a = s / 0.012
    return np.array([0.012 * math.cos(a), 0.012 * math.sin(a), -0.003 - 0.1 * s]), v * np.array([-math.sin(a), math.cos(a), -0.1])


def onto(t: float) -> tuple[np.ndarray, np.ndarray]:
    """From above onto the block and into it, at constant feed."""
    return np.array([0.0, 0.0, 0.0006 - 0.005 * t]), np.array([0.0, 0.0, -0.005])


def through(x: float) -> Path:
    """Straight along x at the feed of the groove, 4 mm deep."""
    return lambda t: (np.array([x + FEED * t, 0.003, -0.004]), np.array([FEED, 0.0, 0.0]))


def windows(path: Path, h: float, **parameters: Any) -> np.ndarray:
    """Mean forces in B over windows of 24 ms [N], (20, 3), of a run in steps of h [s]."""
    position, velocity = path(0.0)
    mill = Mill(position, velocity=velocity, spindle=2 * math.pi / (parameters["teeth"] * FINEST), **parameters)
    forces = []
    for k in range(round(DURATION / h)):
        mill.place(*path((k + 1) * h))
        status = mill.step(mill.s, k * h, h)
        assert status == 0, MODEL.message(status, mill.s, k * h)
        forces.append(mill.data["f_T_B"][0].copy())
    each = round(WINDOW / h)
    return np.array(forces).reshape(-1, each, 3).mean(axis=1)


def errors(path: Path, **parameters: Any) -> tuple[np.ndarray, float]:
    """Root mean square of the error [N] at STEPS against the finest step, and the largest force [N]."""
    reference = windows(path, FINEST, **parameters)
    return np.array([np.sqrt(np.mean((windows(path, h, **parameters) - reference) ** 2)) for h in STEPS]), float(np.abs(reference).max())


# ---------------------------------------------------------------- order of convergence
@pytest.mark.parametrize("cutter", CUTTERS, ids=lambda c: f"D{1e3 * c.get('diameter', 0.016):g}")
@pytest.mark.parametrize("path", [ramp, plunge, arc, onto])
def test_mean_force_converges_with_second_order(path: Path, cutter: dict[str, Any]) -> None:
    """Position from the middle of the step (h^2/24), velocity from both ends (h^2/12): h^2/6 of F'' = F (2 pi/T)^2 bounds both."""
    found, force = errors(path, **cutter)
    # on the inner side of an arc the field that lags is not clear of the tool: edges read cells that are cut in part, up to places of steps
    blurred = discretisation(4e-4 * force, 1.0, 1) if path is arc else 0.0
    for error, h in zip(found, STEPS, strict=True):
        assert error <= discretisation(force * (2 * math.pi / DURATION) ** 2 / 6, h, 2) + blurred
    assert path is arc or np.all(np.log2(found[:-1] / found[1:]) > 1.5)


@pytest.mark.parametrize("x", [-0.0585, 0.0425], ids=["entry", "exit"])
@pytest.mark.parametrize("cutter", CUTTERS, ids=lambda c: f"D{1e3 * c.get('diameter', 0.016):g}")
def test_entry_and_exit_converge_with_first_order(x: float, cutter: dict[str, Any]) -> None:
    """At a side face the material is that at the start of the step: F' h, the force changing within a millimetre of feed (40 ms)."""
    found, force = errors(through(x), **cutter)
    for error, h in zip(found, STEPS, strict=True):
        assert error <= discretisation(force / 0.04, h, 1)
    assert np.all(np.log2(found[:-1] / found[1:]) > 0.75)


def test_fast_ramp_has_the_same_axial_force_at_every_step() -> None:
    """400 mm/s down a slope of 1:3: at 4 ms the depth at the end of the step is 0.24 mm more than its mean. Whole means over 96 ms."""
    velocity = 0.4 * np.array([1.0, 0.0, -0.3])

    def path(t: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([-0.02, 0.0, -0.001]) + velocity * t, velocity

    means = []
    for h in STEPS:
        mill = Mill(path(0.0)[0], velocity=velocity, spindle=2 * math.pi / (3 * 0.0005), contact_time=0.0)
        forces = []
        for k in range(round(0.096 / h)):
            mill.place(*path((k + 1) * h))
            assert mill.step(mill.s, 0.0, h) == 0
            forces.append(float(mill.data["f_T_B"][0, 2]))
        means.append(np.mean(forces))
    # engagement is linear in time here, so the middle of the step is its mean; what is left is the roundoff of the heights
    assert means == pytest.approx([means[-1]] * len(STEPS), rel=1e6 * ROUNDOFF)


# ---------------------------------------------------------------- teeth and discs by brute force
def brute_force(
    depth: Callable[[np.ndarray], np.ndarray],
    chip: float,
    start: float,
    speed: float,
    duration: float,
    teeth: int,
    diameter: float,
    helix: float,
    exit_: float = math.pi,
    k: CuttingCoefficients = K,
) -> np.ndarray:
    """Mean (feed, left, up) [N] over `duration`: every tooth cut into discs, at many instants, forces of each disc added up.

    Tooth 1 starts at the angle `start`, clockwise from the left of the feed; material stands `depth(t)` [m] high before
    the edges from 0 to `exit_`.
    """
    instants, discs = 2000, 200
    t = (np.arange(instants) + 0.5) * duration / instants
    height = depth(t)[:, None] * (np.arange(discs) + 0.5) / discs
    total = np.zeros(3)
    for j in range(teeth):
        phi = (start + speed * t)[:, None] - 2 * math.pi * j / teeth - 2 * math.tan(helix) / diameter * height
        phi = np.mod(phi, 2 * math.pi)
        cuts = (phi < exit_) * depth(t)[:, None] / discs
        h = chip * np.sin(phi)
        ft, fr, fa = k.Ktc * h + k.Kte, k.Krc * h + k.Kre, k.Kac * h + k.Kae
        total += [
            np.sum(cuts * (-ft * np.cos(phi) - fr * np.sin(phi))),
            np.sum(cuts * (ft * np.sin(phi) - fr * np.cos(phi))),
            -np.sum(cuts * fa),
        ]
    return total / instants


@pytest.mark.parametrize("cutter", [{"teeth": 3, "diameter": 0.016, "helix": 0.5}, *CUTTERS[1:]], ids=["D16", "D6", "D20"])
def test_slot_step_by_step_is_the_sum_of_teeth_and_discs(cutter: dict[str, Any]) -> None:
    """Steps of 0.87 of a revolution, a start angle of 1 rad: every single step, not only the mean."""
    mill = Mill([0, 0, -0.006], velocity=[FEED, 0, 0], spindle=GROOVE, spindle_start_angle=1.0, cutting_length=0.02, **cutter)
    found = mill.line([0, 0, -0.006], [FEED, 0, 0], 5)[:, :3]
    chip = 2 * math.pi * FEED / (cutter["teeth"] * GROOVE)
    for i in range(5):
        start = 1.0 + i * GROOVE * CYCLE
        expected = brute_force(lambda t: np.full_like(t, 0.006), chip, start, GROOVE, CYCLE, **cutter)
        # an edge that enters or leaves between two instants is counted whole or not at all
        assert found[i] == pytest.approx(expected, abs=discretisation(np.abs(expected).max(), 1 / 2000, 1) * 2 * cutter["teeth"])


@pytest.mark.parametrize("h", STEPS)
def test_ramp_is_the_sum_of_teeth_and_discs_and_the_thrust_of_its_end_face(h: float) -> None:
    """Slope 1:10 at 25 mm/s, 13 000 rpm, over 60 ms (13 revolutions): the depth grows; the thrust from the descent per tooth."""
    velocity = FEED * np.array([1.0, 0.0, -0.1])
    mill = Mill([-0.02, 0, -0.003], velocity=velocity, spindle=GROOVE, contact_time=0.0)
    forces = []
    for i in range(round(0.06 / h)):
        mill.place(np.array([-0.02, 0, -0.003]) + velocity * (i + 1) * h, velocity)
        assert mill.step(mill.s, 0.0, h) == 0
        forces.append(mill.data["f_T_B"][0].copy())
    chip = 2 * math.pi * FEED / (3 * GROOVE)
    sides = brute_force(lambda t: 0.003 + 0.1 * FEED * t, chip, 0.0, GROOVE, 0.06, 3, 0.016, math.radians(30))
    thrust = 3 * 0.008 * (K.Krc * 0.1 * chip + K.Kre * min(1.0, 0.1 * chip / ONSET))
    expected = sides + np.array([0.0, 0.0, thrust])
    # the instants of the sum are 2.3 deg of rotation apart; three teeth come in and go out
    assert np.mean(forces, axis=0) == pytest.approx(expected, abs=discretisation(np.abs(sides).max(), 2 * math.pi * 13 / 2000, 1))


@pytest.mark.parametrize("diameter", [0.006, 0.016])
def test_half_immersion_is_the_closed_form(diameter: float) -> None:
    """The axis runs along the side face of the block, material on the left: up milling from 0 to 90 deg; its bound half a cell wide."""
    y = -0.03
    mill = Mill([-0.02, y, -0.005], velocity=[FEED, 0, 0], diameter=diameter)
    found = mill.line([-0.02, y, -0.005], [FEED, 0, 0], 100)[50:, :3].mean(axis=0)
    chip = FEED / 750
    fx, fy, fa = mean_force(K, 3, 0.005, chip, 0.0, math.pi / 2)
    wider = np.array(mean_force(K, 3, 0.005, chip, 0.0, math.acos(-1e-4 / (0.5 * diameter))))
    assert found == pytest.approx([fx, fy, -fa], abs=np.abs(wider - [fx, fy, fa]).max())


# ---------------------------------------------------------------- chip thickness by the actual feed
def test_actual_feed_is_the_commanded_one_on_a_straight_path() -> None:
    """The way within a step over its duration: positions of 1.6 m are known to 2e-16 of it, the way of 0.1 mm to 4e-12."""
    velocity = FEED * np.array([0.8, 0.6, -0.1])
    runs = []
    for option in (0, 1):
        mill = Mill([-0.01, 0, -0.004], velocity=velocity, spindle=GROOVE, actual_feed=option)
        runs.append(mill.line([-0.01, 0, -0.004], velocity, 60))
    assert runs[1] == pytest.approx(runs[0], rel=1e5 * ROUNDOFF, abs=1e5 * ROUNDOFF)
    assert np.abs(runs[0][:, :3]).max() > 100.0


@pytest.mark.parametrize("path", [ramp, plunge, arc])
def test_actual_feed_differs_from_the_commanded_one_by_second_order_where_the_path_is_followed(path: Path) -> None:
    differences = []
    for h in STEPS:
        commanded, actual = (windows(path, h, teeth=3, actual_feed=option) for option in (0, 1))
        differences.append(np.sqrt(np.mean((commanded - actual) ** 2)))
        assert differences[-1] <= discretisation(np.abs(commanded).max() * (2 * math.pi / DURATION) ** 2 / 6, h, 2)
    assert np.all(np.log2(np.array(differences[:-1]) / differences[1:]) > 1.5)


def test_actual_feed_follows_the_tool_and_the_workpiece_not_the_command() -> None:
    """A tool at 20 mm/s that is told 25 mm/s has the force of 20 mm/s."""
    for option, feed in ((0, FEED), (1, 0.02)):
        mill = Mill([0, 0, -0.01], velocity=[FEED, 0, 0], actual_feed=option)
        for i in range(20):
            mill.go([0.02 * CYCLE * (i + 1), 0, -0.01], [FEED, 0, 0])
        fx, fy, fa = slot_force(K, 3, 0.01, feed / 750)
        assert mill.data["f_T_B"][0] == pytest.approx([fx, fy, -fa], rel=1e5 * ROUNDOFF)


@pytest.mark.parametrize(("compliance", "stable"), [(2e-7, True), (1e-6, False)])
def test_actual_feed_with_a_delay_of_one_step_needs_a_stiff_machine(compliance: float, stable: bool) -> None:
    """Gain of the delayed loop C D/h, D = a N Ktc c/(4 v) = 8.65 kN s/m: 0.43 settles at the force of the command, 2.2 does not."""
    mill = Mill([-0.03, 0, -0.01], velocity=[FEED, 0, 0], spindle=GROOVE, actual_feed=1)
    force, forces = 0.0, []
    for i in range(150):
        mill.place([-0.03 + FEED * CYCLE * (i + 1), compliance * force, -0.01], [FEED, 0, 0])
        if mill.step(mill.s, 0.0, CYCLE) != 0:
            break
        force = float(mill.data["f_T_B"][0, 1])
        forces.append(force)
    # 15 steps are 13 revolutions
    settled = len(forces) == 150 and abs(np.mean(forces[-15:]) / slot_force(K, 3, 0.01, 2 * math.pi * FEED / (3 * GROOVE))[1] - 1.0) < 0.01
    assert settled == stable
