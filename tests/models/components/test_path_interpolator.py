"""path_interpolator: plays a planned path. Read as its specification.

Planning itself (blends, double-S, orientation) is specified in tests/models/planning/test_trajectory.py.
"""

from __future__ import annotations

import dataclasses
import math
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.cell.points import read_points
from robomill.fmus.interface import interface_of
from robomill.models.components.path_interpolator import MODEL, default_segments
from robomill.models.model.declaration import FloatArray, Record, record
from robomill.models.planning.gcode import parse, read
from robomill.models.planning.reachability import check_reachable
from robomill.models.planning.segment_table import COLUMNS, TAU, TOOL
from robomill.models.planning.trajectory import Placement, Plan, PlanError, pilot_table, plan
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS, load_robot
from tests import SCENARIOS
from tests.tolerances import EXACT, ROUNDOFF, discretisation, physics

H = 0.004
DEG = math.pi / 180.0
HERE = Placement((1.595, -0.018, 1.099))
"""Validation position 4 of Haehn & Weigold 2020, Fig. 9."""
POSITION_4 = np.array([0.65, -96.07, 122.56, 0.0, -26.49, 0.0])
"""Its axis angles [deg] with the upright tool (FACTS 1.7, two decimals)."""
RESIDUAL = 1e-9
"""m: what the order asks of the inverse kinematics."""
plain_init, plain_step = MODEL.plain()
PROGRAMS = ("test_part.ngc", "groove.ngc", "parts/tilted_square.toml")


@cache
def planned(name: str) -> Plan:
    path = SCENARIOS / name
    return plan(read(path) if path.suffix == ".ngc" else read_points(path), HERE)


def line_plan(text: str, placement: Placement = HERE) -> Plan:
    return plan(parse("G21 G90 G17 G0 X0 Y0 Z0\nF1500 S13000 M3\n" + text, "part.ngc"), placement)


def instance(segments: FloatArray | None = None, pilot: FloatArray | None = None, **values: Any) -> Record:
    """A fresh record with the named tables and fields."""
    data = MODEL.new()
    if segments is not None:
        MODEL.load_table(data, "segments", segments)
    if pilot is not None:
        MODEL.load_table(data, "pilot", pilot)
    s = record(data)
    for name, value in values.items():
        if np.ndim(getattr(s, name)):
            getattr(s, name)[...] = value
        else:
            setattr(s, name, value)
    return s


def run(s: Record, steps: int, h: float = H, compiled: bool = True) -> dict[str, FloatArray]:
    """Initialise and step; every output after init (row 0) and after each step."""
    init, step = MODEL.compiled() if compiled else MODEL.plain()
    names = [v.name for v in MODEL.variables if v.causality == "output"]
    assert init(s) == 0, MODEL.message(init(s), s, 0.0)
    trace: dict[str, list[Any]] = {name: [np.copy(getattr(s, name))] for name in names}
    for k in range(steps):
        status = step(s, k * h, h)
        assert status == 0, MODEL.message(status, s, k * h)
        for name in names:
            trace[name].append(np.copy(getattr(s, name)))
    return {name: np.array(values) for name, values in trace.items()}


def words(s: Record) -> bytes:
    """Every byte of the record but those that say where its tables are."""
    return bytes(s.tobytes()[: interface_of(MODEL).tables_at])


@cache
def whole(name: str) -> dict[str, FloatArray]:
    """The whole program at 4 ms and ten steps more."""
    p = planned(name)
    return run(instance(p.table), int(p.duration / H) + 11)


def forward(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (n, 3) and orientations (n, 3, 3) of T: 4x4 products of the modified DH table of FACTS 1.2, written out here anew."""
    n = len(q)
    X = np.tile(np.eye(4), (n, 1, 1))
    for i in range(6):
        theta = KR300.axis_sign[i] * q[:, i] + KR300.dh_offset[i]
        twist, place, turn, rise = (np.tile(np.eye(4), (n, 1, 1)) for _ in range(4))
        twist[:, :3, :3] = Rotation.from_rotvec([KR300.dh_alpha[i], 0, 0]).as_matrix()
        place[:, 0, 3] = KR300.dh_a[i]
        turn[:, :3, :3] = Rotation.from_rotvec(np.outer(theta, [0, 0, 1])).as_matrix()
        rise[:, 2, 3] = KR300.dh_d[i]
        X = X @ twist @ place @ turn @ rise
    tool = np.eye(4)
    tool[:3, 3] = SPINDLE_ACROSS.p_FT_F
    X = X @ tool
    return X[:, :3, 3], X[:, :3, :3]


class TestPhysics:
    """Pose, axis angles, feed, pilot force along a path."""

    def test_bare_component_moves_100_mm_along_x(self) -> None:
        """Built-in program: L/v + 2 sqrt(v/j) = 4.1 s at 25 mm/s and 10 m/s3, around position 4, tool down."""
        trace = run(instance(), 1030)
        np.testing.assert_allclose(trace["p_BT_B"][0], (1.545, -0.018, 1.099), rtol=ROUNDOFF)
        np.testing.assert_allclose(trace["p_BT_B"][-1], (1.645, -0.018, 1.099), rtol=ROUNDOFF)
        np.testing.assert_allclose(trace["v_BT_B"][500], (0.025, 0.0, 0.0), rtol=ROUNDOFF, atol=EXACT)
        assert trace["path_time"][-1] == pytest.approx(0.1 / 0.025 + 2.0 * math.sqrt(0.025 / 10.0), rel=ROUNDOFF)
        assert trace["spindle_speed"][0] == pytest.approx(13000 * math.pi / 30, rel=ROUNDOFF)
        np.testing.assert_allclose(
            Rotation.from_quat(np.roll(trace["quat_BT"][0], -1)).apply([1, 0, 0]), (0, 0, -1), rtol=0.0, atol=ROUNDOFF
        )

    def test_published_axis_angles_at_position_4(self) -> None:
        """FACTS 1.7; its tool is rounded to 1 mm, and half a mm turns A5 by 0.035 deg."""
        s = instance(line_plan("G1 X10").table)
        assert plain_init(s) == 0
        np.testing.assert_allclose(s.q_ref / DEG, POSITION_4, rtol=0.0, atol=physics(0.0, absolute=0.035 + 0.005))

    @pytest.mark.parametrize("name", PROGRAMS)
    def test_axis_angles_put_the_tool_where_the_plan_wants_it(self, name: str) -> None:
        """Whole program: an independent forward kinematics of q_ref against the plan's own numpy evaluation."""
        p, trace = planned(name), whole(name)
        tau = np.minimum(np.arange(len(trace["q_ref"])) * H, p.duration)
        position, orientation = forward(trace["q_ref"])
        np.testing.assert_allclose(position, p.position(tau), rtol=0.0, atol=RESIDUAL)
        np.testing.assert_allclose(orientation, p.rotation(tau).as_matrix(), rtol=0.0, atol=RESIDUAL)
        np.testing.assert_allclose(trace["p_BT_B"], p.position(tau), rtol=ROUNDOFF, atol=ROUNDOFF)

    @pytest.mark.parametrize("name", PROGRAMS)
    def test_no_branch_jumps(self, name: str) -> None:
        """No axis ever moves faster than its limit: a change of branch would be a jump of many degrees in 4 ms."""
        assert np.all(np.abs(np.diff(whole(name)["q_ref"], axis=0)) < KR300.speed_max * H)

    def test_velocity_is_the_derivative_of_the_position(self) -> None:
        """Central differences at 4 ms in the test part, away from the steps in jerk; third derivative bounded by 1e2 m/s3."""
        trace = whole("test_part.ngc")
        difference = (trace["p_BT_B"][2:] - trace["p_BT_B"][:-2]) / (2.0 * H)
        np.testing.assert_allclose(trace["v_BT_B"][1:-1], difference, rtol=0.0, atol=discretisation(1e2, H, 2))

    @pytest.mark.parametrize("ratio", [0.0, 0.3, 1.0, 1.5])
    def test_speed_ratio_scales_path_time_and_velocity(self, ratio: float) -> None:
        trace = run(instance(speed_ratio=ratio), 300)
        np.testing.assert_allclose(trace["path_time"], np.arange(301) * H * ratio, rtol=ROUNDOFF, atol=EXACT)
        assert trace["v_BT_B"][-1, 0] == pytest.approx(0.025 * ratio, rel=ROUNDOFF)

    @pytest.mark.parametrize("ratio", [0.3, 1.0])
    def test_override_error_is_another_speed_ratio_and_nothing_at_zero(self, ratio: float) -> None:
        """Effect: the machine runs at 1 + e times the ratio: path time and velocity as with that ratio, on the same path."""
        chosen = ((ratio, 0.1), (ratio * 1.1, 0.0), (ratio, 0.0))
        off, right, programmed = (run(instance(speed_ratio=r, override_error=e), 300) for r, e in chosen)
        for name in ("path_time", "p_BT_B", "v_BT_B", "q_ref", "f_pilot_B"):
            np.testing.assert_array_equal(off[name], right[name])
        assert off["path_time"][-1] == pytest.approx(1.1 * programmed["path_time"][-1], rel=ROUNDOFF)
        assert {v.name for v in MODEL.variables if v.effect} == {"override_error"}

    def test_changing_speed_ratio_does_not_leave_the_path(self) -> None:
        """A pocket at a seeded random override: at every path time the position is that of the plan."""
        p = planned("test_part.ngc")
        s = instance(p.table)
        init, step = MODEL.compiled()
        init(s)
        for k, ratio in enumerate(np.random.default_rng(6).uniform(0.0, 1.5, 3000)):
            s.speed_ratio = ratio
            assert step(s, k * H, H) == 0
            if k % 100 == 0:
                np.testing.assert_allclose(s.p_BT_B, p.position(np.array([s.path_time]))[0], rtol=ROUNDOFF)

    def test_rests_at_the_end_and_says_so(self) -> None:
        p, trace = planned("groove.ngc"), whole("groove.ngc")
        first = int(np.argmax(trace["finished"]))
        assert (first - 1) * H < p.duration <= first * H
        assert np.all(trace["finished"][first:] == 1)
        assert np.all(trace["path_time"][first:] == p.duration)
        assert np.all(np.abs(trace["v_BT_B"][first:]) == 0.0)
        assert np.all(trace["spindle_speed"][first:] == 0.0)  # M5, M30

    def test_block_numbers_follow_the_program(self) -> None:
        blocks = whole("groove.ngc")["block"]
        assert list(dict.fromkeys(blocks.tolist())) == [90, 100, 110, 120]

    def test_quaternion_is_of_unit_length_with_positive_scalar(self) -> None:
        quat = whole("parts/tilted_square.toml")["quat_BT"]
        np.testing.assert_allclose(np.linalg.norm(quat, axis=1), 1.0, rtol=ROUNDOFF)
        assert np.all(quat[:, 0] >= 0.0)


class TestPilotForce:
    """The offline force, ahead of the path by the lead time."""

    TABLE = np.array([[0.5, 0.0, 0.0, 0.0], [1.0, 100.0, -200.0, 50.0], [2.0, 100.0, -200.0, 50.0], [2.3, 0.0, 0.0, 0.0]])

    def test_leads_by_40_ms_and_is_linear_between_rows(self) -> None:
        """40 ms lead: Haehn & Weigold 2020, Fig. 3."""
        trace = run(instance(pilot=self.TABLE), 600)
        t = trace["path_time"] + 0.040
        for i in range(3):
            expected = np.interp(t, self.TABLE[:, 0], self.TABLE[:, 1 + i])
            np.testing.assert_allclose(trace["f_pilot_B"][:, i], expected, rtol=ROUNDOFF, atol=100 * ROUNDOFF)

    def test_lead_is_on_the_path_not_in_time(self) -> None:
        trace = run(instance(pilot=self.TABLE, speed_ratio=0.5, lead_time=0.1), 600)
        expected = np.interp(trace["path_time"] + 0.1, self.TABLE[:, 0], self.TABLE[:, 1])
        np.testing.assert_allclose(trace["f_pilot_B"][:, 0], expected, rtol=ROUNDOFF, atol=100 * ROUNDOFF)

    def test_without_a_table_there_is_none(self) -> None:
        assert np.all(run(instance(), 100)["f_pilot_B"] == 0.0)

    def test_single_row_is_constant(self) -> None:
        assert np.all(run(instance(pilot=self.TABLE[1:2]), 100)["f_pilot_B"] == [100.0, -200.0, 50.0])

    def test_reduced_record_is_played_within_its_tolerance(self) -> None:
        tau = np.arange(0.0, 4.0, 0.004)
        forces = np.outer(np.sin(3.0 * tau), [300.0, -200.0, 100.0])
        trace = run(instance(pilot=pilot_table(tau, forces, 10.0), lead_time=0.0), 900)
        assert np.max(np.linalg.norm(trace["f_pilot_B"] - forces[: len(trace["f_pilot_B"])], axis=1)) <= 10.0


class TestNumerics:
    """What the step size and the lookup do: nothing."""

    def test_half_step_gives_the_same_positions(self) -> None:
        """Path time is summed with compensation: after 10 000 steps it is still within one unit in the last place."""
        p = planned("test_part.ngc")
        n = 10_000
        coarse, fine = run(instance(p.table), n), run(instance(p.table), 2 * n, H / 2)
        np.testing.assert_array_max_ulp(coarse["path_time"], np.arange(n + 1) * H, maxulp=1)
        np.testing.assert_array_max_ulp(fine["path_time"][::2], coarse["path_time"], maxulp=1)
        np.testing.assert_allclose(fine["p_BT_B"][::2], coarse["p_BT_B"], rtol=ROUNDOFF, atol=EXACT)
        np.testing.assert_allclose(fine["q_ref"][::2], coarse["q_ref"], rtol=0.0, atol=10 * ROUNDOFF)

    def test_outputs_at_100_seeded_times_equal_the_plan(self) -> None:
        """One step of arbitrary size to each time: rows are found over any distance; orientation and velocity as planned."""
        p = planned("parts/tilted_square.toml")
        for tau in np.random.default_rng(9).uniform(0.0, p.duration, 100):
            s = instance(p.table)
            plain_init(s)
            assert plain_step(s, 0.0, float(tau)) == 0
            at = np.array([tau])
            np.testing.assert_allclose(s.p_BT_B, p.position(at)[0], rtol=ROUNDOFF)
            np.testing.assert_allclose(s.v_BT_B, p.velocity(at)[0], rtol=0.0, atol=ROUNDOFF)
            difference = Rotation.from_quat(np.roll(s.quat_BT, -1)).inv() * p.rotation(at)[0]
            assert difference.magnitude() < ROUNDOFF

    def test_init_may_be_repeated_and_forgets_the_run(self) -> None:
        fresh, used = instance(planned("groove.ngc").table), instance(planned("groove.ngc").table)
        plain_init(fresh)
        for _ in range(2):
            run(used, 50)
        plain_init(used)
        scratch = {v.name for v in MODEL.variables if v.description.startswith("Scratch")}
        for name in MODEL.dtype.names or ():
            if name not in scratch:
                np.testing.assert_array_equal(getattr(used, name), getattr(fresh, name), err_msg=name)


class TestParity:
    """Plain Python and compiled code give the same bits."""

    @pytest.mark.parametrize(("name", "start"), [("test_part.ngc", 26.6), ("parts/tilted_square.toml", 2.8)])
    def test_plain_equals_compiled(self, name: str, start: float) -> None:
        """Through the helical entry of the pocket, and through a corner with changing orientation; every byte of the record."""
        pilot = TestPilotForce.TABLE + np.array([start, 0.0, 0.0, 0.0])
        plain, compiled = instance(planned(name).table, pilot), instance(planned(name).table, pilot)
        init, step = MODEL.compiled()
        assert plain_init(plain) == init(compiled) == 0
        assert plain_step(plain, 0.0, start) == step(compiled, 0.0, start) == 0
        for k in range(300):
            assert plain_step(plain, k * H, H) == step(compiled, k * H, H) == 0
            assert words(plain) == words(compiled), f"step {k}"


class TestTool:
    """The number of the tool in the spindle follows the program; a change is a stop."""

    def test_the_path_stops_where_the_tool_changes_and_the_number_is_that_of_the_move(self) -> None:
        program = parse("G21 G90 G17 G0 X0 Y0 Z0\nF1500 S13000 M3\nG1 X10\nG1 X20\nG1 X30\n", "part.ngc")
        tools = (3, 3, 7)
        changed = dataclasses.replace(
            program, actions=tuple(dataclasses.replace(a, tool=n) for a, n in zip(program.actions, tools, strict=True))
        )
        p = plan(changed, HERE)
        trace = run(instance(p.table), int(p.duration / H) + 11)
        x, tool = trace["p_BT_B"][:, 0] - trace["p_BT_B"][0, 0], trace["tool"]
        assert set(tool[x < 0.020 - ROUNDOFF]) == {3}
        assert set(tool[x > 0.020 + ROUNDOFF]) == {7}
        moving = p.velocity(np.array([p.table[p.table[:, TOOL] == 7][0, TAU]]))
        np.testing.assert_allclose(moving, 0.0, rtol=0.0, atol=ROUNDOFF)
        assert set(run(instance(plan(program, HERE).table), 10)["tool"]) == {0}


class TestErrors:
    """One clear message each."""

    def test_empty_table(self) -> None:
        s = instance(np.zeros((0, COLUMNS)))
        status = plain_init(s)
        assert MODEL.message(status, s, 0.0) == (
            "path_interpolator: the segment table is empty; expected at least one row; "
            "plan a program and name its table as parameter 'segments'"
        )
        assert plain_step(s, 0.0, H) == status

    def test_out_of_reach(self) -> None:
        """Wrist reach of the KR 300 is 2.15 m from axis 2 (FACTS 1.3): 4 m away nothing is reachable."""
        s = instance(line_plan("N20 G1 X10", Placement((4.0, 0.0, 1.0))).table)
        message = MODEL.message(plain_init(s), s, 0.0)
        assert message == (
            "path_interpolator: path time 0.000 s, block 20 (line 3): the tool tip cannot reach (4.0000, 0.0000, 1.0000) m in B "
            "with quaternion (0.7071, 0.0000, 0.7071, 0.0000); move the workpiece closer or turn the tool"
        )

    def test_beyond_an_axis_limit(self) -> None:
        """A5 not below -20 deg, no turning over of wrist or base: at position 4 it is at -26.5 deg. The limits survive the explanation."""
        q_min, q_max = np.array(KR300.q_min), np.array(KR300.q_max)
        q_min[[0, 3, 4]], q_max[[0, 3]] = np.array([-90.0, -100.0, -20.0]) * DEG, np.array([90.0, 100.0]) * DEG
        s = instance(line_plan("N20 G1 X10").table, q_min=q_min, q_max=q_max)
        message = MODEL.message(plain_init(s), s, 0.0)
        assert message == (
            "path_interpolator: path time 0.000 s, block 20 (line 3): axis A5 would be at -26.48 deg, its limits are -20.0 .. 122.5 deg, "
            "for the tool tip at (1.5950, -0.0180, 1.0990) m in B; move the workpiece, turn the tool about its axis, "
            "or start in another posture (q_start)"
        )
        np.testing.assert_array_equal(s.q_min, q_min)
        np.testing.assert_array_equal(s.q_max, q_max)

    def test_no_jump_to_another_branch_at_a_limit(self) -> None:
        """On the line, A5 falls from -26.5 below -26.7 deg; the wrist turned over (A4, A6 by 180 deg) is inside all limits, but far."""
        p = line_plan("N20 G1 X100")
        free = run(instance(p.table), 900)["q_ref"]
        assert free[0, 4] > -26.7 * DEG > free[-1, 4]
        q_min = np.array(KR300.q_min)
        q_min[4] = -26.7 * DEG
        s = instance(p.table, q_min=q_min)
        assert plain_init(s) == 0
        message = MODEL.message(plain_step(s, 0.0, 899 * H), s, 899 * H)
        assert f"axis A5 would be at {free[899, 4] / DEG:.2f} deg, its limits are -26.7 .. 122.5 deg" in message
        over = instance(p.table, q_min=q_min, q_start=np.array([*POSITION_4[:3] * DEG, math.pi, -POSITION_4[4] * DEG, math.pi]))
        assert plain_init(over) == 0
        assert plain_step(over, 0.0, 899 * H) == 0

    @pytest.mark.parametrize("ratio", [-0.1, 1.6, math.nan])
    def test_speed_ratio_out_of_range(self, ratio: float) -> None:
        s = instance()
        plain_init(s)
        s.speed_ratio = ratio
        assert MODEL.message(plain_step(s, 0.0, H), s, 0.0) == f"path_interpolator: speed_ratio is {ratio}, expected 0 .. 1.5"

    def test_tables_whose_times_do_not_increase(self) -> None:
        table = np.array(default_segments())
        table[2, TAU] = table[1, TAU]
        s = instance(table)
        assert MODEL.message(plain_init(s), s, 0.0).startswith(
            "path_interpolator: table 'segments', row 2 (counted from 0): its path time, "
        )
        pilot = instance()
        MODEL.load_table(pilot, "pilot", np.array([[0.0, 1.0, 1.0, 1.0], [2.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]]))
        assert "table 'pilot', row 2 (counted from 0): its path time, 1 s, is not after" in MODEL.message(plain_init(pilot), pilot, 0.0)

    def test_table_that_does_not_fit(self) -> None:
        with pytest.raises(ValueError, match=r"table 'segments' of 'path_interpolator': has shape \(3, 49\), expected rows of 50 columns"):
            MODEL.load_table(MODEL.new(), "segments", np.zeros((3, COLUMNS - 1)))


class TestReachability:
    """The whole plan is checked before the run."""

    @pytest.mark.parametrize("name", PROGRAMS)
    def test_example_programs_can_be_run(self, name: str) -> None:
        reach = check_reachable(planned(name))
        assert np.all(reach.margin > 0.0)
        assert np.all(reach.speed < KR300.speed_max)

    def test_axis_speeds_are_the_derivatives_of_the_axis_angles(self) -> None:
        """Englert (2011), Eq. (4.5), against central differences of the played angles (4 ms; A4, A6 bend most, up to 1e2 rad/s3)."""
        trace, reach = whole("parts/tilted_square.toml")["q_ref"], check_reachable(planned("parts/tilted_square.toml"))
        played = np.max(np.abs(trace[2:] - trace[:-2]), axis=0) / (2.0 * H)
        np.testing.assert_allclose(reach.speed, played, rtol=0.0, atol=discretisation(1e2, H, 2))

    def test_kr_210_of_englert_keeps_its_limits_at_50_mm_per_s(self) -> None:
        """Englert (2011), section 4.2.1: at 0.05 m/s no joint limit is exceeded. KR 210-2: FACTS 1.2 (DH, limits and speeds)."""
        kr210 = load_robot("kr210_2")
        slow = (SCENARIOS / "parts/squares_circle.ngc").read_text().replace("F6000.", "F3000.")
        reach = check_reachable(plan(parse(slow), HERE), kr210)
        assert np.all(reach.margin > 0.0)
        assert np.all(reach.speed < kr210.speed_max)

    def test_out_of_reach_names_the_line(self) -> None:
        with pytest.raises(PlanError, match=r"part\.ngc line 3 \(G1 X10\): path time 0\.000 s, .* the tool tip cannot reach \(.*\) m in B"):
            check_reachable(line_plan("G1 X10", Placement((4.0, 0.0, 1.0))))

    def test_axis_limit_names_line_axis_value_and_limits(self) -> None:
        """Link arm stretched forward: A2 ends at -5 deg (FACTS 1.2). Found at the first tick behind it, 0.006 deg later."""
        with pytest.raises(PlanError) as caught:
            check_reachable(line_plan("G1 X10\nZ-1500"))
        message = str(caught.value)
        assert message.startswith("part.ngc line 4 (Z-1500): path time ")
        found = re.search(r"axis A2 would be at (-\d\.\d\d) deg, its limits are -140\.0 \.\. -5\.0 deg", message)
        assert found is not None
        assert -5.0 <= float(found.group(1)) < -4.98

    def test_too_fast_an_axis_names_line_axis_and_speeds(self) -> None:
        lame = dataclasses.replace(KR300, speed_max=KR300.speed_max * 0.01)
        with pytest.raises(
            PlanError, match=r"part\.ngc line \d \(.*\): path time .* s: axis A\d would turn at \d+\.\d deg/s, it can do \d\.\d deg/s"
        ):
            check_reachable(line_plan("G1 X10\nG0 Y200"), lame)
