"""Stiffness at stations: against the compliance matrix of the component, the nine points of paper 004, and bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robomill.models.calibration.stations import stations, table_springs, tip_stiffness
from robomill.models.calibration.stiffness import Loads
from robomill.models.model.declaration import Model, record
from robomill.models.model.parameters import load
from robomill.models.robot.kinematics import SPINDLE_ACROSS, Robot, Tool, inverse, load_robot, load_tool, robot_variables
from robomill.models.robot.numeric_inverse import kinematics
from robomill.models.robot.virtual_joints import Compliance, compliance_matrix, compliance_variables, load_compliance
from tests import SCENARIOS
from tests.tolerances import ROUNDOFF, physics

KR210 = load_robot("kr210_2")
TABLE_3_1 = load(Compliance, SCENARIOS / "kr210" / "table_3_1.toml")
IN_LINE = load_tool("spindle_in_line_300")
DOWN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Orientation of T with the tool axis, its x, down."""
FORWARD = np.eye(3)
POINTS = tuple((x, y, 0.9) for x in (1.4, 1.65, 1.9) for y in (-0.4, 0.0, 0.4))
"""FACTS10 10.5, m."""
PRINTED = 0.01
"""Two digits of FACTS10."""
UNLIMITED = replace(KR210, q_min=np.full(6, -2.0 * np.pi), q_max=np.full(6, 2.0 * np.pi))


def poses(tool: Tool, R: np.ndarray, robot: Robot = KR210) -> np.ndarray:
    s, found = kinematics(robot, tool), []
    for p in POINTS:
        q = np.zeros(6)
        assert inverse(s, np.array(p), R, robot.q_home.copy(), q) == 0
        found.append(q)
    return np.array(found)


def share(tool: Tool, q: np.ndarray) -> np.ndarray:
    """[3] mean stiffness with tilt over that of the drives alone."""
    ratio = tip_stiffness(KR210, tool, TABLE_3_1, q) / tip_stiffness(KR210, tool, TABLE_3_1, q, drives_only=True)
    return np.asarray(ratio.mean(axis=0))


@pytest.mark.paper
@pytest.mark.parametrize(
    ("length", "R", "expected"), [(0.3, DOWN, (0.68, 0.30, 0.71)), (0.1, FORWARD, (0.87, 0.32, 0.64))], ids=["in line", "flange forward"]
)
def test_tilt_takes_two_thirds_of_the_stiffness_in_y(length: float, R: np.ndarray, expected: tuple[float, ...]) -> None:
    """Thesis, 3.3: in y "about a third"; FACTS10 10.5 the three directions, to its last digit."""
    tool = replace(IN_LINE, p_FT_F=np.array([0.0, 0.0, length]))
    assert np.abs(share(tool, poses(tool, R)) - expected).max() < physics(0.0, absolute=PRINTED)


@pytest.mark.paper
def test_spindle_across_with_the_flange_towards_the_base_and_forward() -> None:
    """FACTS10's 0.45 in y is of a pose beyond the limit of A5; with the flange forward, which can be reached, it is 0.25."""
    backward = poses(SPINDLE_ACROSS, DOWN @ np.diag([1.0, -1.0, -1.0]), UNLIMITED)
    assert np.abs(backward[:, 4]).min() > KR210.q_max[4]
    assert np.abs(share(SPINDLE_ACROSS, backward) - (0.74, 0.45, 0.56)).max() < physics(0.0, absolute=PRINTED)
    reached = poses(SPINDLE_ACROSS, DOWN)
    assert np.all(np.abs(reached[:, 4]) < KR210.q_max[4])
    assert abs(share(SPINDLE_ACROSS, reached)[1] - 0.25) < physics(0.0, absolute=PRINTED)


@pytest.mark.paper
def test_stiffness_falls_with_the_distance_and_middle_points_are_stiffer_in_x_and_z() -> None:
    """Thesis, 3.3; in y the middle points are softer (FACTS10 10.5)."""
    k = tip_stiffness(KR210, IN_LINE, TABLE_3_1, poses(IN_LINE, DOWN)).reshape(3, 3, 3)
    assert np.all(np.diff(k[:, :, 2], axis=0) < 0.0)
    assert np.all(np.diff(k[:, :, 1], axis=0) < 0.0)
    for outer in (0, 2):
        assert np.all(k[:, 1, (0, 2)] > k[:, outer][:, (0, 2)])
        assert np.all(k[:, 1, 1] < k[:, outer, 1])


def test_all_springs_are_those_of_the_compliance_matrix() -> None:
    """Sensor and holder of a file, too."""

    def unused(*_: object) -> int:
        return 0

    table = replace(load_compliance("kr300_r2500_ultra"), sensor_stiffness_scale=0.1)
    s = record(Model("springs", "", (*robot_variables(KR210, IN_LINE), *compliance_variables(table, IN_LINE)), unused, unused).new())
    q, C = poses(IN_LINE, DOWN), np.zeros((6, 6))
    found = tip_stiffness(KR210, IN_LINE, table, q)
    for n, angles in enumerate(q):
        compliance_matrix(s, angles, C)
        assert np.abs(found[n] * np.diag(C)[:3] - 1.0).max() < 1e3 * ROUNDOFF
    assert len(table_springs(TABLE_3_1)[0]) == 18


def pushes(q: np.ndarray) -> Loads:
    """Pushes of 300 and 600 N along x, y, z at each station, answered by the springs, and a little noise before them."""
    forces = np.concatenate([size * np.eye(3) for size in (300.0, 600.0)] + [0.01 * np.eye(3)])
    k = tip_stiffness(KR210, IN_LINE, TABLE_3_1, q)
    rows = [(a, f, f / stiff) for a, stiff in zip(q, k, strict=True) for f in forces]
    columns = [np.array([r[i] for r in rows]) for i in range(3)]
    columns[2][6::9] += 1.0  # noise where there is no force
    return Loads(columns[0], columns[1], np.zeros_like(columns[1]), columns[2])


def test_pushes_give_the_stiffness_of_each_station() -> None:
    q = poses(IN_LINE, DOWN)
    found = stations(KR210, IN_LINE, TABLE_3_1, pushes(q))
    assert np.abs(found.q - q).max() < ROUNDOFF
    assert np.abs(found.error).max() < 1e3 * ROUNDOFF


def test_a_direction_without_a_push_is_left_open() -> None:
    loads = pushes(poses(IN_LINE, DOWN)[:1])
    rows = loads.f_T_B[:, 1] == 0.0
    found = stations(KR210, IN_LINE, TABLE_3_1, loads.only(rows))
    assert np.isnan(found.measured[0]).tolist() == [False, True, False]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"f_T_B": 0.0}, "all forces are zero, expected pushes along x, y and z"),
        ({"d_T_B": -1.0}, r"at station 1 the tool moves [\d.]+ um/N against the force along x; expected along it"),
    ],
)
def test_errors(change: dict[str, float], text: str) -> None:
    loads = pushes(poses(IN_LINE, DOWN)[:1])
    with pytest.raises(ValueError, match=text):
        stations(KR210, IN_LINE, TABLE_3_1, replace(loads, **{name: factor * getattr(loads, name) for name, factor in change.items()}))


def test_oblique_pushes_are_no_stations() -> None:
    loads = pushes(poses(IN_LINE, DOWN)[:1])
    with pytest.raises(ValueError, match="no force of 9 rows is along x, y or z of B to 5 %; push along the base axes"):
        stations(KR210, IN_LINE, TABLE_3_1, replace(loads, f_T_B=np.full((9, 3), 100.0)))
