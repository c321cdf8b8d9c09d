"""What a plan asks of the axes, against the played axis angles; double-S profiles against Ruckig."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ruckig

from robomill.cell.points import read_points
from robomill.models.components.path_interpolator import MODEL
from robomill.models.model.declaration import FloatArray, record
from robomill.models.planning.double_s import profile, ramp_time
from robomill.models.planning.gcode import read
from robomill.models.planning.reachability import AXIS_LIMITS, CLOCK, plan_within, survey
from robomill.models.planning.trajectory import Placement, Plan, plan
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS
from tests import SCENARIOS
from tests.tolerances import ROUNDOFF

HERE = Placement((1.595, -0.018, 1.099))
CLOSE = 1e-6
"""Relative: third differences of angles of 1 rad lose 1e-16/4e-3^3 = 2e-9 rad/s3 of some 1e1."""
OF_RUCKIG = 1e-9
"""Relative: Ruckig finds durations as roots of polynomials, to about 1e-11."""


def played(p: Plan) -> FloatArray:
    """Axis angles of the path interpolator at every tick (n, 6), rest before and after included."""
    data = MODEL.new()
    MODEL.load_table(data, "segments", p.table)
    s = record(data)
    init, step = MODEL.compiled()
    assert init(s) == 0
    rows = [np.array(s.q_ref)] * 4
    for k in range(math.ceil(p.duration / CLOCK) + 3):
        assert step(s, k * CLOCK, CLOCK) == 0
        rows.append(np.array(s.q_ref))
    return np.array(rows)


@pytest.mark.parametrize("name", ["parts/squares_circle.ngc", "parts/tilted_square.toml"])
def test_peaks_are_those_of_the_played_angles(name: str) -> None:
    """Accelerations and jerks are differences over the clock; speeds by Eq. (4.5) differ from theirs by the bend within two ticks."""
    path = SCENARIOS / name
    p = plan(read(path) if path.suffix == ".ngc" else read_points(path), HERE)
    reach, q = survey(p), played(p)
    for k in (1, 2):
        peaks = np.max(np.abs(np.diff(q, k + 1, axis=0)), axis=0) / CLOCK ** (k + 1)
        np.testing.assert_allclose(reach.peaks[k], peaks, rtol=CLOSE)
    slopes = np.max(np.abs(q[2:] - q[:-2]), axis=0) / (2.0 * CLOCK)
    np.testing.assert_allclose(reach.speed, slopes, rtol=0.0, atol=np.max(reach.peaks[2]) * CLOCK**2)
    margins = np.minimum(q - KR300.q_min, KR300.q_max - q)
    np.testing.assert_allclose(reach.margin, np.min(margins, axis=0), rtol=CLOSE)
    for axis, nearest in enumerate(reach.margin_where):
        assert margins[3 + math.ceil(nearest.tau / CLOCK - CLOSE), axis] == pytest.approx(reach.margin[axis], rel=CLOSE)
    np.testing.assert_allclose(reach.share * AXIS_LIMITS.of(KR300), reach.peaks, rtol=ROUNDOFF)
    for quantity, places in enumerate(reach.where):
        for axis, worst in enumerate(places):
            assert worst.value == reach.share[quantity, axis] <= reach.line_shares[worst.line, quantity]


def test_singular_poses_are_zeros_of_the_determinant() -> None:
    """The product of the three measures is |det J| up to one constant of the arm: sin A5, sin of the elbow, distance of the wrist."""
    from robomill.models.planning.reachability import _jacobians, _nearness
    from robomill.models.robot.kinematics import robot_variables

    data = MODEL.new()
    for v in robot_variables(KR300, SPINDLE_ACROSS):
        if v.causality == "parameter":
            data[v.name] = v.start_values
    q = np.random.default_rng(5).uniform(KR300.q_min, KR300.q_max, (50, 6))
    J, wrist = np.zeros((50, 6, 6)), np.zeros(50)
    _jacobians(data, q, J, wrist)
    ratio = np.abs(np.linalg.det(J)) / np.prod(_nearness(KR300, q, wrist), axis=0)
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e4 * ROUNDOFF)  # one over the smallest factor


@pytest.mark.parametrize("within", ["acceleration", "jerk"])
def test_feed_is_lowered_until_the_axes_keep_their_limits(within: str) -> None:
    program = read(SCENARIOS / "parts/squares_circle.ngc")
    nominal = survey(plan(program, HERE))
    p, reach = plan_within(program, HERE, KR300, SPINDLE_ACROSS, KR300.q_home, within)  # type: ignore[arg-type]  # one of the three
    k = {"acceleration": 1, "jerk": 2}[within]
    assert np.max(nominal.share[1]) > 1.0
    assert 0.9 < np.max(reach.share[1]) <= 1.0
    assert np.max(reach.share[k]) <= 1.0
    assert p.within_axes


class TestAgainstRuckig:
    """Ruckig (Berscheid & Kroeger 2021) finds time-optimal motions under the same limits."""

    def test_rest_to_rest(self) -> None:
        """50 seeded lengths and limits over three decades: the same duration."""
        rng = np.random.default_rng(8)
        for _ in range(50):
            length, v, a, j = (float(10 ** rng.uniform(low, low + 3)) for low in (-4, -2, -1, 0))
            last = profile([(length, v)], a, j)[-1]
            assert last.time + last.duration == pytest.approx(self.position(length, v, a, j), rel=OF_RUCKIG)

    def test_change_of_speed(self) -> None:
        """The ramp between two speeds with zero acceleration at both ends."""
        rng = np.random.default_rng(9)
        for _ in range(50):
            v0, v1, a, j = (float(10 ** rng.uniform(low, low + 2)) for low in (-3, -3, -1, 0))
            given = ruckig.InputParameter(1)
            given.control_interface = ruckig.ControlInterface.Velocity
            given.current_position, given.current_velocity, given.current_acceleration = [0.0], [v0], [0.0]
            given.target_velocity, given.target_acceleration = [v1], [0.0]
            given.max_acceleration, given.max_jerk = [a], [j]
            assert ramp_time(v0, v1, a, j) == pytest.approx(self.duration(given), rel=OF_RUCKIG)

    def position(self, length: float, v: float, a: float, j: float) -> float:
        given = ruckig.InputParameter(1)
        given.current_position, given.target_position = [0.0], [length]
        given.max_velocity, given.max_acceleration, given.max_jerk = [v], [a], [j]
        return self.duration(given)

    def duration(self, given: ruckig.InputParameter) -> float:
        found = ruckig.Trajectory(1)
        assert ruckig.Ruckig(1).calculate(given, found) == ruckig.Result.Working
        return float(found.duration)
