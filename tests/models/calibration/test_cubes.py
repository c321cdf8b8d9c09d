"""Cubes on the robot: motions against closed forms and the twin's own tip, springs found again, FACTS10 10.7, errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robomill.identify_cubes import read_set
from robomill.models.calibration.cubes import (
    CHAIN,
    LEVER,
    ROTATION,
    Cube,
    CubeFit,
    CubeLoads,
    Setup,
    Spots,
    Triangulation,
    identify_cubes,
    simulate,
    three_two_one,
)
from robomill.models.robot.kinematics import load_robot
from robomill.models.robot.virtual_joints import SENSOR, TABLE_1, displacement
from tests import SCENARIOS
from tests.tolerances import ROUNDOFF, chance, of_mean, of_variance, physics

MEASURED = read_set(SCENARIOS / "cubes" / "kr300.toml")
SETUP = MEASURED.setup
FINITE = 1e-4
"""Relative: turns are finite. To first order springs come out up to 4 % off; one correction leaves the square of that at most."""
BLURRED = 0.15
"""Relative: FACTS10 has its rotations from other poses, which the paper does not give; loads differ by that."""


def fit(setup: Setup = SETUP, seed: int | None = None, change: np.ndarray | None = None) -> CubeFit:
    loads = simulate(setup, TABLE_1, MEASURED.force, MEASURED.moment, seed)
    return identify_cubes(setup, loads if change is None else replace(loads, change=change), TABLE_1, (SENSOR,))


def truth(found: CubeFit) -> np.ndarray:
    return np.array([1.0 / TABLE_1.stiffness[s.row, s.column] for s in found.springs])


def relative(found: CubeFit, name: str, way: int) -> float:
    return float(found.relative_deviation[way, [s.name for s in found.springs].index(name)])


def test_motion_of_the_last_cube_is_that_of_the_tool_tip() -> None:
    """Against `displacement`, which sums the chain in another way: readings of a cube in the place of the tool."""
    loads = simulate(SETUP, TABLE_1, MEASURED.force, MEASURED.moment)
    design = SETUP.spots.design(np.eye(3))
    rigid = replace(TABLE_1, stiffness=np.where(np.arange(11)[:, None] > SENSOR, 9.9e96, TABLE_1.stiffness))
    s = SETUP.frames(rigid)
    d, theta = np.zeros(3), np.zeros(3)
    for f, m, change in zip(MEASURED.force, MEASURED.moment, loads.change[:, -1], strict=True):
        displacement(s, SETUP.q, f, m, d, theta)
        motion = np.linalg.solve(design, change)
        # beams meet the turned faces 50 mm beside the centre: to first order in turns of 3 mrad
        assert np.abs(motion[:3] - d).max() < physics(float(np.linalg.norm(d)), relative=0.01)
        assert np.abs(motion[3:] - theta).max() < physics(float(np.linalg.norm(theta)), relative=0.01)


def test_six_readings_give_the_motion_of_a_cube() -> None:
    """Closed form: a turn about z is the difference of the two readings of the face y over 80 mm, and so on."""
    motion = np.array([3e-5, -2e-5, 1e-5, 1e-4, 2e-4, -3e-4])
    change = three_two_one().design(np.eye(3)) @ motion
    assert abs((change[4] - change[3]) / 0.08 - motion[5]) < ROUNDOFF
    assert abs((change[2] - change[0]) / 0.08 - motion[3]) < ROUNDOFF
    assert abs((change[0] - change[1]) / 0.08 - motion[4]) < ROUNDOFF
    assert abs(change[5] - motion[0]) < ROUNDOFF


def test_springs_are_found_again_without_noise() -> None:
    found = fit()
    told = found.relative_deviation < 1.0
    error = np.abs(found.compliance / truth(found) - 1.0)
    assert error[CHAIN].max() < FINITE
    assert error[ROTATION].max() < FINITE
    assert error[LEVER][told[LEVER]].max() < FINITE
    assert not told[LEVER].all()  # the lever along an axis tells nothing about a turn about it


@pytest.mark.slow
def test_noise_gives_the_stated_deviations() -> None:
    """50 seeded measurements: scatter of every spring and way against its standard deviation; none is off on average."""
    draws, found = 50, fit()
    every = np.array([fit(seed=seed).compliance for seed in range(draws)])
    told = found.relative_deviation < 1.0
    spread, mean = every.std(axis=0, ddof=1)[told], every.mean(axis=0)[told]
    # 69 of them: five standard errors are exceeded once in 25 000 times
    assert np.abs(spread / found.deviation[told] - 1.0).max() < chance(0.5 * of_variance(draws), 5.0)
    assert np.abs((mean - np.broadcast_to(truth(found), told.shape)[told]) / spread).max() < chance(of_mean(draws), 5.0)


@pytest.mark.paper
def test_noise_of_rotation_and_displacement() -> None:
    """FACTS10 10.7: 125 urad per reading, 15 urad averaged; ours is loaded minus unloaded, so the averaged noise counts twice."""
    single, averaged = Triangulation(averages=2, systematic=0.0), Triangulation()
    per_turn = 2.0 / 0.08  # two cubes, two readings each
    assert abs(per_turn * single.deviation - 125e-6) <= physics(125e-6, relative=0.01)
    assert abs(per_turn * averaged.deviation - 15e-6) <= physics(15e-6, relative=0.13)
    found = fit()
    axis_1 = found.deviation[ROTATION, 2] * 750.0 * SETUP.cubes[-1].position[0]
    # the force along y turns axis 1; the bar about z adds 375 N.m
    both = np.hypot(750.0 * SETUP.cubes[-1].position[0], 375.0) / (750.0 * SETUP.cubes[-1].position[0])
    assert abs(axis_1 * both - per_turn * averaged.deviation) < physics(axis_1, relative=0.01)


@pytest.mark.paper
@pytest.mark.parametrize(
    ("name", "published"),
    [
        ("axis 1 x", 0.21),
        ("axis 1 y", 0.11),
        ("axis 1 z", 0.07),
        ("axis 2 x", 0.09),
        ("linked arm z", 0.11),
        ("linked arm x", 0.18),
        ("axis 3 y", 0.24),
        ("arm y", 0.31),
        ("arm x", 0.12),
        ("arm z", 0.12),
        ("axis 4 z", 0.036),
        ("axis 6 z", 0.019),
    ],
)
def test_uncertainty_by_rotation(name: str, published: float) -> None:
    """FACTS10 10.7. Tolerance: twice averaged noise is 13 % more, several loads less, and the pose is another one (`BLURRED`)."""
    assert abs(relative(fit(), name, ROTATION) - published) <= physics(published, relative=0.13 + BLURRED)


@pytest.mark.paper
def test_which_springs_cannot_be_had() -> None:
    """FACTS10 10.7: arm y to 31 %; displacement over lever helps A1, A2, A3, not torsion; with 2 um systematic three times that."""
    found = fit()
    best = np.min(found.relative_deviation[[ROTATION, LEVER]], axis=0)
    vague = {s.name for s, v in zip(found.springs, best, strict=True) if v > 0.18}
    assert vague == {"arm y", "linked arm x"}
    for name in ("axis 1 x", "axis 1 y", "axis 1 z", "axis 2 y", "axis 3 x", "axis 3 y", "axis 3 z"):
        assert relative(found, name, LEVER) < relative(found, name, ROTATION)
    coarse = fit(replace(SETUP, sensors=replace(SETUP.sensors, systematic=2e-6)))
    assert abs(coarse.expected / found.expected - 3.0) <= physics(3.0, relative=0.1)


def test_springs_elsewhere_mislead_the_chain_but_not_the_rotation_of_joints() -> None:
    """Springs of linked arm and arm a tenth off: joints by rotation stay, by the chain some are wrong by more than a tenth."""
    elsewhere = replace(TABLE_1, link_arm_position=0.4, arm_position=0.6)
    found = fit(change=simulate(SETUP, elsewhere, MEASURED.force, MEASURED.moment).change)
    joints = np.array([s.name.startswith("axis") for s in found.springs])
    error = np.abs(found.compliance / truth(found) - 1.0)[:, joints]
    assert error[ROTATION].max() < FINITE
    assert error[CHAIN].max() > 0.1
    assert found.scatter > 0.5e-6  # the readings themselves say that the model does not fit


def test_a_seventh_spot_stands_in_for_an_occluded_one() -> None:
    more = three_two_one()
    spots = Spots(np.vstack([more.points, [[0.04, 0.04, 0.05]]]), np.vstack([more.directions, [[0.0, 0.0, 1.0]]]))
    setup = replace(SETUP, spots=spots)
    change = simulate(setup, TABLE_1, MEASURED.force, MEASURED.moment).change
    change[1, 3, 0] = np.nan
    found = fit(setup, change=change)
    assert np.abs(found.compliance[ROTATION] / truth(found) - 1.0).max() < FINITE


def spoilt(**changes: object) -> CubeLoads:
    return replace(simulate(SETUP, TABLE_1, MEASURED.force, MEASURED.moment), **changes)  # type: ignore[arg-type]


def test_what_cannot_be_is_refused() -> None:
    change = simulate(SETUP, TABLE_1, MEASURED.force, MEASURED.moment).change
    occluded = change.copy()
    occluded[2, 4, 5] = np.nan
    none = np.zeros((6, 3))
    for loads, text in (
        (spoilt(change=occluded), "load 3: cube arm rear has 5 of 6 readings, which tell 5 of its six motions: occluded"),
        (spoilt(change=1e3 * change), "check the unit, and that readings are differences, loaded minus unloaded"),
        (spoilt(force=none, moment=none), "all loads are zero"),
        (spoilt(change=change[:, 1:]), "expected (6, 9, 6): loads, cubes, spots"),
    ):
        with pytest.raises(ValueError, match=text.replace("(", r"\(").replace(")", r"\)")):
            identify_cubes(SETUP, loads, TABLE_1, (SENSOR,))
    with pytest.raises(ValueError, match="between wrist 5 and flange there are axis 6, sensor; expected one joint"):
        identify_cubes(SETUP, spoilt())
    with pytest.raises(ValueError, match="no joint with unknown springs between the cubes"):
        identify_cubes(SETUP, spoilt(), TABLE_1, tuple(range(9)))
    with pytest.raises(ValueError, match="expected two or more, from the base to the flange"):
        replace(SETUP, cubes=SETUP.cubes[::-1])
    with pytest.raises(ValueError, match="use robomill identify stiffness"):
        replace(SETUP, robot=load_robot("irb6400r_25_150"))
    with pytest.raises(ValueError, match="5 spots do not give the six motions of a cube"):
        Spots(SETUP.spots.points[:5], SETUP.spots.directions[:5])


def test_two_cubes_on_one_member_are_one() -> None:
    """Nothing yields between them: the springs are those of before."""
    cubes = list(SETUP.cubes)
    cubes.insert(2, Cube("carousel again", 1, cubes[1].position + 0.1, np.eye(3)))
    setup = replace(SETUP, cubes=tuple(cubes))
    assert np.abs(fit(setup).compliance[CHAIN] / truth(fit()) - 1.0).max() < FINITE
