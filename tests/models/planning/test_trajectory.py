"""Planning: double-S profiles, shapes, blends, plans, point paths, pilot table."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from robomill.cell.points import PathError, parse_points, read_points
from robomill.models.model.declaration import FloatArray
from robomill.models.planning.blend import arc_length, arc_length_pieces, bezier_control, bezier_derivatives, blend
from robomill.models.planning.double_s import Phase, profile, ramp_length, reachable_speed
from robomill.models.planning.gcode import Setup, parse, read
from robomill.models.planning.path_geometry import Polynomial, helix, line
from robomill.models.planning.point_path import Interpolation
from robomill.models.planning.segment_table import ACCELERATION, JERK, LINE, SPEED, TAU, TOOL
from robomill.models.planning.trajectory import LIMITS, PathLimits, Placement, Plan, PlanError, pilot_table, plan
from tests import SCENARIOS
from tests.tolerances import ROUNDOFF, discretisation, physics

HERE = Placement((1.595, -0.018, 1.099))
"""Validation position 4 of FACTS 1.7."""
FLAT = Placement((1.0, 0.0, 0.0))
"""P parallel to B: positions in B are those in P plus (1, 0, 0)."""
START = "G21 G90 G17 G0 X0 Y0 Z0\nF1500 S13000 M3\n"
FEED = 0.025
SPEED_BAND = 1e-4
"""Relative: what the order asks of the feed through blends (the planner aims at 1e-5)."""


def planned(text: str, placement: Placement = FLAT, limits: PathLimits = LIMITS, tolerance: float = 2e-4) -> Plan:
    return plan(parse(START + text, "part.ngc", Setup(tolerance=tolerance)), placement, limits)


def speed(p: Plan, tau: FloatArray) -> FloatArray:
    return np.linalg.norm(p.velocity(tau), axis=1)


def in_block(p: Plan, number: int, n: int = 400) -> FloatArray:
    """Path times at which the tool is in a block (START has lines 1 and 2)."""
    tau = np.linspace(0.0, p.duration, 40_001)
    inside = tau[p.block(tau) == number]
    return np.linspace(inside[0], inside[-1], n)


def one_sided(p: Plan, row: int) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """Position, velocity, acceleration, quaternion at the start of a row: from the row before it, and from the row itself."""
    tau = np.array([p.table[row, TAU]])

    def state(q: Plan) -> tuple[FloatArray, ...]:
        return q.position(tau)[0], q.velocity(tau)[0], q.acceleration(tau)[0], q.rotation(tau).as_matrix()[0]

    return state(dataclasses.replace(p, table=p.table[:row])), state(dataclasses.replace(p, table=p.table[: row + 1]))


class TestDoubleS:
    """Bounded speed, acceleration and jerk; durations against closed formulas."""

    @pytest.mark.parametrize(
        ("length", "v", "a", "j", "expected"),
        [
            # speed and acceleration reached: L/v + v/a + a/j
            (1.0, 0.5, 1.0, 10.0, 1.0 / 0.5 + 0.5 / 1.0 + 1.0 / 10.0),
            # speed reached, acceleration not: L/v + 2 sqrt(v/j)
            (0.1, 0.025, 1.0, 10.0, 0.1 / 0.025 + 2.0 * math.sqrt(0.025 / 10.0)),
            # acceleration reached, speed not: v_p^2/a + v_p a/j = L -> T = a/j + sqrt((a/j)^2 + 4 L/a)
            (0.1, 10.0, 1.0, 10.0, 0.1 + math.sqrt(0.01 + 4.0 * 0.1)),
            # neither: four phases of equal duration (L/(2 j))^(1/3)
            (1e-4, 10.0, 1.0, 10.0, 4.0 * (1e-4 / 20.0) ** (1.0 / 3.0)),
        ],
    )
    def test_duration_from_rest_to_rest(self, length: float, v: float, a: float, j: float, expected: float) -> None:
        last = profile([(length, v)], a, j)[-1]
        assert last.time + last.duration == pytest.approx(expected, rel=ROUNDOFF)

    def test_slower_zone_in_the_middle_costs_what_its_ramps_cost(self) -> None:
        """100, 25, 100 mm/s over 1 m each: every ramp takes 2 sqrt(dv/j) (dv < a^2/j) and its path the mean speed times that."""
        fast, slow, j = 0.1, 0.025, 10.0
        outer, inner = 2.0 * math.sqrt(fast / j), 2.0 * math.sqrt((fast - slow) / j)
        cruise = (1.0 - 0.5 * fast * outer - 0.5 * (fast + slow) * inner) / fast
        last = profile([(1.0, fast), (1.0, slow), (1.0, fast)], 1.0, j)[-1]
        assert last.time + last.duration == pytest.approx(2.0 * (outer + inner + cruise) + 1.0 / slow, rel=ROUNDOFF)

    def test_seven_phases(self) -> None:
        assert [math.copysign(1.0, p.jerk) * (p.jerk != 0.0) for p in profile([(1.0, 0.5)], 1.0, 10.0)] == [1, 0, -1, 0, -1, 0, 1]

    def test_limits_and_continuity_over_random_zones(self) -> None:
        """100 seeded zone lists, lengths and limits over four and three decades: nothing exceeded, nothing jumps, the path is complete."""
        rng = np.random.default_rng(11)
        for _ in range(100):
            zones = [(float(10 ** rng.uniform(-5, -1)), float(10 ** rng.uniform(-3, 0))) for _ in range(rng.integers(1, 9))]
            a, j = float(10 ** rng.uniform(-1, 1)), float(10 ** rng.uniform(0, 2))
            phases = profile(zones, a, j)
            edges = np.cumsum([0.0] + [length for length, _ in zones])
            assert phases[-1].at(phases[-1].duration)[0] == pytest.approx(edges[-1], rel=ROUNDOFF)
            assert phases[-1].at(phases[-1].duration)[1] == pytest.approx(0.0, abs=ROUNDOFF)
            for p, q in itertools.pairwise(phases):
                np.testing.assert_allclose(p.at(p.duration), (q.path, q.speed, q.acceleration), atol=10 * ROUNDOFF, rtol=0.0)
            for p in phases:
                assert abs(p.jerk) <= j
                for t in np.linspace(0.0, p.duration, 7):
                    s, v, acceleration = p.at(float(t))
                    here = [
                        limit for (_, limit), x, y in zip(zones, edges[:-1], edges[1:], strict=True) if x - ROUNDOFF <= s <= y + ROUNDOFF
                    ]
                    assert -ROUNDOFF <= v <= max(here) * (1.0 + ROUNDOFF)
                    assert abs(acceleration) <= a * (1.0 + ROUNDOFF)

    def test_reachable_speed_uses_the_whole_length(self) -> None:
        rng = np.random.default_rng(3)
        for _ in range(100):
            v0, length = float(rng.uniform(0.0, 0.1)), float(10 ** rng.uniform(-5, -2))
            v = reachable_speed(v0, 10.0, length, 1.0, 10.0)
            assert ramp_length(v0, v, 1.0, 10.0) == pytest.approx(length, rel=ROUNDOFF)

    def test_time_at_inverts_the_path(self) -> None:
        phase = Phase(1.0, 0.4, 0.2, 0.01, 0.5, -2.0)
        for t in np.linspace(0.01, 0.4, 50):
            assert phase.time_at(phase.at(float(t))[0]) == pytest.approx(t, rel=100 * ROUNDOFF)  # divided by v = 0.01..0.05 m/s

    def test_refuses_nonsense(self) -> None:
        with pytest.raises(ValueError, match=r"must be positive; got acceleration 1\.0, jerk 10\.0, zones"):
            profile([(0.1, 0.0)], 1.0, 10.0)


def corner(angle: float, length: float = 0.01) -> tuple[Polynomial, Polynomial]:
    """Two lines of `length` [m] that meet at the origin; the second is turned by `angle` [rad]."""
    direction = np.array([math.cos(angle), math.sin(angle), 0.0])
    return line(np.array([-length, 0.0, 0.0]), np.zeros(3)), line(np.zeros(3), length * direction)


class TestShapes:
    """Lines, helices, blend pieces as functions of their arc length."""

    def test_helix_has_the_length_of_its_unrolled_triangle(self) -> None:
        shape = helix(np.array([0.006, 0, 0]), np.zeros(3), np.array([0, 0, 1.0]), -2 * math.pi, -0.003)
        assert shape.length == pytest.approx(math.sqrt((2 * math.pi * 0.006) ** 2 + 0.003**2), rel=ROUNDOFF)
        np.testing.assert_allclose(shape.at(shape.length)[0], (0.006, 0.0, -0.003), atol=ROUNDOFF, rtol=0.0)

    def test_derivatives_by_finite_differences(self) -> None:
        """100 seeded points on a helix and a blend piece; central differences with h = 1e-6 of the length (error ~ h^2 + roundoff/h)."""
        rng = np.random.default_rng(2)
        axis = np.array([1.0, 2.0, 2.0]) / 3.0
        arc = helix(np.array([0.02, 0.0, 0.0]), np.array([0.0, 0.01, 0.0]), axis, 2.5, 0.004)
        piece = arc_length_pieces(bezier_control(*corner(1.0), 0.002))[0]
        for shape in (arc, piece):
            for s in rng.uniform(0.1, 0.9, 50) * shape.length:
                h = 1e-4 * shape.length
                (p0, d0, _), (p1, d1, _) = shape.at(s - h), shape.at(s + h)
                _, d, k = shape.at(float(s))
                np.testing.assert_allclose((p1 - p0) / (2 * h), d, atol=discretisation(1.0, 1e-4, 2) + 1e-3 * ROUNDOFF / h, rtol=0.0)
                np.testing.assert_allclose((d1 - d0) / (2 * h), k, atol=discretisation(1.0, 1e-4, 2) * 1e5 * shape.length, rtol=0.0)
                assert np.linalg.norm(d) == pytest.approx(1.0, rel=SPEED_BAND)

    def test_part_is_the_same_curve(self) -> None:
        arc = helix(np.array([0.02, 0.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, 1.0]), 2.5, 0.004)
        piece = arc_length_pieces(bezier_control(*corner(1.0), 0.002))[0]
        for shape in (arc, piece):
            cut = shape.part(0.3 * shape.length, 0.8 * shape.length)
            for x, y in zip(cut.at(0.2 * shape.length), shape.at(0.5 * shape.length), strict=True):
                np.testing.assert_allclose(x, y, rtol=100 * ROUNDOFF, atol=ROUNDOFF)


class TestBlend:
    """Quintic Bezier curve between two shapes (Englert 2011, Eqs. 4.7-4.8)."""

    @pytest.mark.parametrize("degrees", [1.0, 30.0, 90.0, 150.0, 174.0])
    def test_control_points_of_a_corner_between_lines(self, degrees: float) -> None:
        """Equal speed alpha at ends and middle, 256 alpha^2 = |30 D - 7 alpha (t0 + t1)|^2, solved by hand.

        With D = d (t0 + t1) and r = |t0 + t1|: 30 d r = alpha (16 + 7 r).
        """
        angle, d = math.radians(degrees), 1e-3
        root = math.sqrt(2.0 * (1.0 + math.cos(angle)))
        alpha = 30.0 * d * root / (16.0 + 7.0 * root)
        control = bezier_control(*corner(angle), d)
        t0, t1 = np.array([1.0, 0.0, 0.0]), np.array([math.cos(angle), math.sin(angle), 0.0])
        np.testing.assert_allclose(bezier_derivatives(control, 0.0)[1], alpha * t0, rtol=10 * ROUNDOFF, atol=ROUNDOFF)
        np.testing.assert_allclose(bezier_derivatives(control, 1.0)[1], alpha * t1, rtol=10 * ROUNDOFF, atol=ROUNDOFF)
        for u in (0.0, 1.0):
            np.testing.assert_allclose(bezier_derivatives(control, u)[2], 0.0, atol=ROUNDOFF, rtol=0.0)
        assert np.linalg.norm(bezier_derivatives(control, 0.5)[1]) == pytest.approx(alpha, rel=10 * ROUNDOFF)

    def test_meets_arcs_with_their_curvature(self) -> None:
        """S-bend of arcs of 10 and 14 mm with a kink of 20 deg: speed at ends and middle; position, tangent, curvature."""
        up = np.array([0.0, 0.0, 1.0])
        before = helix(np.array([-0.010, 0.010, 0.0]), np.array([0.0, 0.010, 0.0]), up, math.pi / 2, 0.0)
        kink = math.radians(20.0)
        after = helix(np.zeros(3), 0.014 * np.array([math.sin(kink), -math.cos(kink), 0.0]), up, -1.0, 0.001)
        control = bezier_control(before, after, 0.002)
        alpha = float(np.linalg.norm(bezier_derivatives(control, 0.0)[1]))
        for u in (0.5, 1.0):
            assert np.linalg.norm(bezier_derivatives(control, u)[1]) == pytest.approx(alpha, rel=10 * ROUNDOFF)
        pieces = arc_length_pieces(control)
        for x, y in zip(pieces[0].at(0.0), before.at(before.length - 0.002), strict=True):
            np.testing.assert_allclose(x, y, rtol=100 * ROUNDOFF, atol=100 * ROUNDOFF)
        for x, y in zip(pieces[-1].at(pieces[-1].length), after.at(0.002), strict=True):
            np.testing.assert_allclose(x, y, rtol=100 * ROUNDOFF, atol=100 * ROUNDOFF)

    @pytest.mark.parametrize("degrees", [5.0, 45.0, 90.0, 135.0, 170.0])
    def test_pieces_have_the_length_of_the_curve_and_lie_on_it(self, degrees: float) -> None:
        control = bezier_control(*corner(math.radians(degrees)), 1e-3)
        pieces = arc_length_pieces(control)
        length = quad(lambda u: float(np.linalg.norm(bezier_derivatives(control, u)[1])), 0.0, 1.0, epsabs=1e-15, epsrel=1e-13)[0]
        assert sum(p.length for p in pieces) == pytest.approx(length, rel=10 * ROUNDOFF)
        for p in pieces:
            for x in np.linspace(0.05, 0.95, 5):
                point = p.at(x * p.length)[0]
                best = minimize_scalar(
                    lambda u, point=point: float(np.linalg.norm(bezier_derivatives(control, u)[0] - point)),
                    bounds=(0.0, 1.0),
                    method="bounded",
                )
                # a speed error of 1e-5 over pieces shorter than 1 mm
                assert best.fun < physics(1e-3, relative=1e-5)

    @pytest.mark.parametrize("degrees", [5.0, 45.0, 90.0, 135.0, 170.0])
    def test_pieces_run_at_unit_speed_and_join_twice_differentiable(self, degrees: float) -> None:
        pieces = arc_length_pieces(bezier_control(*corner(math.radians(degrees)), 1e-3))
        for p in pieces:
            for x in np.linspace(0.0, 1.0, 101):
                assert np.linalg.norm(p.at(x * p.length)[1]) == pytest.approx(1.0, rel=SPEED_BAND)
        for p, q in itertools.pairwise(pieces):
            for order, (x, y) in enumerate(zip(p.at(p.length), q.at(0.0), strict=True)):
                # the second derivative is of the order of 1/d = 1e3 to 1e4 1/m
                np.testing.assert_allclose(x, y, atol=ROUNDOFF * (1.0, 10.0, 1e6)[order], rtol=0.0)

    @pytest.mark.parametrize("degrees", [10.0, 90.0, 160.0])
    def test_tolerance_is_used_and_kept(self, degrees: float) -> None:
        """The largest deviation is at the corner: its distance from the middle of the curve."""
        before, after = corner(math.radians(degrees), 0.1)
        found = blend(before, after, 0.05, 1e-4)
        assert found is not None
        control = bezier_control(before, after, found[0])
        assert np.linalg.norm(bezier_derivatives(control, 0.5)[0]) == pytest.approx(1e-4, rel=1e3 * ROUNDOFF)

    def test_short_neighbours_limit_it(self) -> None:
        found = blend(*corner(1.0, 1e-3), 0.5e-3, 1e-2)
        assert found is not None
        assert found[0] == 0.5e-3

    def test_arc_length_of_a_straight_curve(self) -> None:
        control = bezier_control(*corner(0.0), 1e-3)
        assert arc_length(control, 0.0, 1.0) == pytest.approx(2e-3, rel=ROUNDOFF)


class TestPlan:
    """A program becomes a trajectory."""

    def test_single_line(self) -> None:
        """L/v + 2 sqrt(v/j), v < a^2/j."""
        p = planned("G1 X100")
        assert p.length == pytest.approx(0.1, rel=ROUNDOFF)
        assert p.duration == pytest.approx(0.1 / FEED + 2.0 * math.sqrt(FEED / LIMITS.jerk), rel=ROUNDOFF)
        np.testing.assert_allclose(
            p.position(np.array([0.0, p.duration, p.duration + 1.0])), [[1, 0, 0], [1.1, 0, 0], [1.1, 0, 0]], rtol=ROUNDOFF
        )

    def test_derivatives_by_finite_differences(self) -> None:
        """100 seeded times of the test part: h = 10 us, central differences; acceleration piecewise smooth with jerk < 1e3 m/s3."""
        p = plan(read(SCENARIOS / "test_part.ngc"), HERE)
        tau = np.random.default_rng(7).uniform(0.01, p.duration - 0.01, 100)
        h = 1e-5
        np.testing.assert_allclose(
            (p.position(tau + h) - p.position(tau - h)) / (2 * h),
            p.velocity(tau),
            atol=discretisation(1e3, h, 2) + 1e-3 * ROUNDOFF / h,
            rtol=0.0,
        )
        np.testing.assert_allclose(
            (p.velocity(tau + h) - p.velocity(tau - h)) / (2 * h), p.acceleration(tau), atol=discretisation(1e3, h, 1), rtol=0.0
        )

    @pytest.mark.parametrize("name", ["test_part.ngc", "groove.ngc", "parts/squares_circle.ngc"])
    def test_position_velocity_and_acceleration_do_not_jump(self, name: str) -> None:
        """C2 along the path at constant speed, and zero acceleration steps in the ramps: nothing jumps from row to row."""
        p = plan(read(SCENARIOS / name), HERE)
        for row in range(1, len(p.table)):
            before, after = one_sided(p, row)
            # m, m/s, m/s2: speeds of 0.25 m/s and curvatures up to 1e4 1/m magnify roundoff
            for x, y, magnification in zip(before, after, (1.0, 10.0, 1e4, 1.0), strict=True):
                np.testing.assert_allclose(
                    x, y, rtol=0.0, atol=10 * ROUNDOFF * magnification, err_msg=f"row {row}, line {p.table[row, LINE]}"
                )

    def test_feed_is_constant_through_blends(self) -> None:
        """Between the ramps of the first and last move of a closed square, corners of 90 deg."""
        p = planned("G1 X40\nY40\nX0\nY0")
        ramp = 2.0 * math.sqrt(FEED / LIMITS.jerk)
        tau = np.linspace(ramp + 1e-9, p.duration - ramp - 1e-9, 20_001)
        np.testing.assert_allclose(speed(p, tau), FEED, rtol=SPEED_BAND)
        assert p.reduced == ()

    def test_feed_is_constant_in_all_cuts_of_the_test_part(self) -> None:
        p = plan(read(SCENARIOS / "test_part.ngc"), HERE)
        for block in (140, 230, 280, 330, 340, 350, 440, 450, 460, 470, 480, 490, 500):
            np.testing.assert_allclose(speed(p, in_block(p, block)), FEED, rtol=SPEED_BAND, err_msg=f"N{block}")
        assert p.reduced == ()
        assert 40.0 <= p.duration <= 90.0

    def test_part_of_englert_at_constant_100_mm_per_s(self) -> None:
        """Three squares and a circle in two depths at 0.1 m/s (Englert 2011, section 4.2.3): no reduction anywhere on the contours."""
        p = plan(read(SCENARIOS / "parts/squares_circle.ngc"), HERE)
        assert p.reduced == ()
        for block in (150, 160, 170):
            np.testing.assert_allclose(speed(p, in_block(p, block)), 0.1, rtol=SPEED_BAND)

    def test_deviation_from_the_program_is_the_tolerance(self) -> None:
        """Corner of 90 deg: the path passes the corner at the blend tolerance, where it is nearest: a sample beside that is farther."""
        p = planned("G1 X40\nY40")
        tau = np.linspace(0.0, p.duration, 200_001)
        assert np.min(np.linalg.norm(p.position(tau) - [1.04, 0.0, 0.0], axis=1)) == pytest.approx(
            2e-4, rel=discretisation(1.0, p.length / 200_000 / 2e-4, 2)
        )

    def test_line_to_arc_is_blended_to_continuous_curvature(self) -> None:
        """Tangential line and arc, R 10 mm: without blend the lateral acceleration would jump by v^2/R = 62.5 mm/s2."""
        p = planned("G1 X20\nG3 X30 Y10 J10\nG1 Y30")
        tau = np.linspace(0.2, p.duration - 0.2, 100_001)
        jumps = np.abs(np.diff(p.acceleration(tau), axis=0)).max()
        assert jumps < FEED**2 / 0.010 / 100

    @pytest.mark.parametrize(
        ("text", "point"),
        [
            ("G61 G1 X20\nY20", (1.02, 0.0, 0.0)),  # blending off
            ("G1 X20\nX0", (1.02, 0.0, 0.0)),  # reversal
            ("G1 X20\nG4 P0.5\nX40", (1.02, 0.0, 0.0)),  # dwell
            ("G1 X20\nM5\nX40", (1.02, 0.0, 0.0)),  # spindle
        ],
    )
    def test_exact_stop(self, text: str, point: tuple[float, float, float]) -> None:
        p = planned(text)
        stops = [row for row in p.table[1:-1] if row[SPEED] == 0.0 and row[ACCELERATION] == 0.0]
        assert stops
        np.testing.assert_allclose(p.position(np.array([stops[0][TAU]]))[0], point, rtol=ROUNDOFF, atol=ROUNDOFF)

    def test_tangential_arc_is_run_through_in_exact_mode(self) -> None:
        p = planned("G61 G1 X20\nG3 X30 Y10 J10")
        inner = np.linspace(0.2, p.duration - 0.2, 1000)
        np.testing.assert_allclose(speed(p, inner), FEED, rtol=ROUNDOFF * 10)
        np.testing.assert_allclose(p.position(np.array([p.duration]))[0], (1.03, 0.01, 0.0), rtol=ROUNDOFF)

    def test_dwell_holds_the_position_and_its_block(self) -> None:
        p = planned("G1 X20\nN77 G4 P0.5\nX40")
        tau = np.linspace(0.0, p.duration, 100_001)
        waiting = tau[p.block(tau) == 77]
        assert waiting[-1] - waiting[0] == pytest.approx(0.5, abs=2 * tau[1])
        np.testing.assert_allclose(p.position(waiting), np.tile([1.02, 0.0, 0.0], (len(waiting), 1)), rtol=ROUNDOFF, atol=ROUNDOFF)

    def test_dwell_before_the_first_move(self) -> None:
        p = planned("G4 P0.5\nG1 X20")
        np.testing.assert_allclose(p.position(np.array([0.0, 0.5])), [[1, 0, 0], [1, 0, 0]], rtol=ROUNDOFF)
        assert p.duration == pytest.approx(0.5 + planned("G1 X20").duration, rel=ROUNDOFF)

    def test_full_circle(self) -> None:
        p = planned("G3 I10")
        tau = np.linspace(0.0, p.duration, 1001)
        assert p.length == pytest.approx(2 * math.pi * 0.010, rel=ROUNDOFF)
        np.testing.assert_allclose(np.linalg.norm(p.position(tau) - [1.010, 0.0, 0.0], axis=1), 0.010, rtol=ROUNDOFF)

    def test_feed_change_on_a_straight_line(self) -> None:
        """Each block keeps its own feed; the change is made in the faster one, so the slower one is held from end to end."""
        p = planned("G1 X50\nN50 X100 F600\nX150 F1500")
        np.testing.assert_allclose(speed(p, in_block(p, 50)), 0.010, rtol=ROUNDOFF * 10)
        assert np.max(p.table[:, ACCELERATION]) <= LIMITS.acceleration
        assert np.max(np.abs(p.table[:, JERK])) <= LIMITS.jerk

    def test_rapid_at_its_own_speed(self) -> None:
        p = planned("G0 X1000")
        assert np.max(speed(p, np.linspace(0.0, p.duration, 1001))) == pytest.approx(LIMITS.rapid_speed, rel=ROUNDOFF)

    def test_too_tight_a_curve_reduces_the_speed_and_says_so(self) -> None:
        """R 1 mm at 100 mm/s: v = sqrt(a R)."""
        p = planned("G61 F6000 G1 X30\nN7 G3 X30 Y2 J1\nG1 X0")
        assert speed(p, in_block(p, 7)) == pytest.approx(math.sqrt(LIMITS.lateral_acceleration * 1e-3), rel=10 * ROUNDOFF)
        assert p.notes == ("line 4 (block 7): 100 mm/s reduced to 47.96 mm/s where the path curves or turns too tightly",)

    def test_a_thousand_slow_blocks_are_one_note_that_names_the_slowest(self) -> None:
        zigzag = "".join(f"G1 X{k} Y{5 if k == 500 else 0.5 * (k % 2)}\n" for k in range(1, 1000))
        p = planned(f"G64 P0.05 F6000\n{zigzag}")
        assert len(p.reduced) > 500
        (note,) = p.notes
        assert note.startswith("line 50")
        assert note.endswith(f"; {len(p.reduced)} blocks are slowed, this one most")

    def test_the_tool_is_changed_before_the_dwell_that_follows(self) -> None:
        p = planned("T1 M6\nG1 X20\nT2 M6\nG4 P1\nG1 X40")
        rows, *_ = p.rows(np.linspace(0.0, p.duration, 4001))
        still = rows[:, LINE] == 6
        assert np.count_nonzero(still) > 0
        assert set(rows[still, TOOL]) == {2.0}

    def test_spindle_speed_follows_the_program(self) -> None:
        p = planned("N1 G1 X20\nS6500\nN2 X40\nM30")
        rpm = np.array([p.spindle_speed(in_block(p, n, 3)[1:2])[0] for n in (1, 2)]) * 30 / math.pi
        np.testing.assert_allclose(rpm, [13000, 6500], rtol=ROUNDOFF)
        assert p.spindle_speed(np.array([p.duration]))[0] == 0.0

    def test_evaluation_says_where_in_the_program(self) -> None:
        assert planned("G1 X20").where(0.3) == "part.ngc line 3 (G1 X20)"

    def test_nothing_to_move(self) -> None:
        with pytest.raises(ValueError, match=r"part\.ngc line 3: no move in 'G4 P1'"):
            planned("G4 P1")
        path = parse_points("[[point]]\nposition = [0, 0, 0]\n[[point]]\nposition = [0, 0, 0]\nfeed = 1\n", "still")
        with pytest.raises(PlanError, match="still: nothing to move"):
            plan(path, Placement((1.3, 0.0, 1.2)))

    def test_there_is_no_limit_on_the_length_of_a_program(self) -> None:
        text = "G61\n" + "\n".join(f"G1 X{i % 2} Y{i}" for i in range(700))
        p = planned(text)
        assert len(p.table) > 2048
        np.testing.assert_allclose(p.position(np.array([p.duration]))[0], (1.001, 0.699, 0.0), rtol=ROUNDOFF)


class TestPlacement:
    """P in B, and the orientation of the tool."""

    def test_upright_tool_at_position_4(self) -> None:
        """Tool axis (x) down, z of T horizontal and away from the robot: R0 of FACTS 1.7 (check_facts.py, mean_dev)."""
        azimuth = math.atan2(-0.018, 1.595)
        expected = np.column_stack([[0, 0, -1], [-math.sin(azimuth), math.cos(azimuth), 0], [math.cos(azimuth), math.sin(azimuth), 0]])
        np.testing.assert_allclose(HERE.R_BT, expected, atol=ROUNDOFF, rtol=0.0)
        np.testing.assert_allclose(
            planned("G1 X20", HERE).rotation(np.array([0.0, 0.5])).as_matrix(), [expected, expected], atol=ROUNDOFF, rtol=0.0
        )

    def test_random_placements(self) -> None:
        """100 seeded: points move with the frame, the tool axis is -z of P, the rotation is proper, the angle turns about the tool axis."""
        rng = np.random.default_rng(4)
        for _ in range(100):
            abc, angle = rng.uniform(-0.5, 0.5, 3), float(rng.uniform(-3, 3))
            placement = Placement((1.6, 0.1, 1.1), tuple(abc), angle)
            R_BP = Rotation.from_rotvec([0, 0, abc[0]]) * Rotation.from_rotvec([0, abc[1], 0]) * Rotation.from_rotvec([abc[2], 0, 0])
            point = rng.uniform(-0.1, 0.1, 3)
            np.testing.assert_allclose(placement.to_base(point), np.array([1.6, 0.1, 1.1]) + R_BP.apply(point), rtol=ROUNDOFF)
            R = placement.R_BT
            np.testing.assert_allclose(R[:, 0], -R_BP.apply([0, 0, 1]), atol=ROUNDOFF, rtol=0.0)
            np.testing.assert_allclose(R.T @ R, np.eye(3), atol=ROUNDOFF, rtol=0.0)
            assert np.linalg.det(R) == pytest.approx(1.0, rel=ROUNDOFF)
            z0 = dataclasses.replace(placement, tool_angle=0.0).R_BT[:, 2]
            assert z0 @ [1.6, 0.1, 0.0] > 0.0
            assert math.atan2(np.cross(z0, R[:, 2]) @ R[:, 0], z0 @ R[:, 2]) == pytest.approx(angle, rel=100 * ROUNDOFF)

    def test_tool_along_the_radius_has_no_outward_direction(self) -> None:
        with pytest.raises(PlanError, match="points along the radial direction"):
            _ = Placement((1.6, 0.0, 1.1), (0.0, -math.pi / 2, 0.0)).R_BT


class TestPointPath:
    """Orientation along the path: two interpolations (Englert 2011, sections 4.1.1 and 4.2.1)."""

    def rates(self, p: Plan, n: int = 20_001) -> tuple[FloatArray, FloatArray]:
        """Times and angular velocity in B [rad/s] by differences."""
        tau = np.linspace(0.0, p.duration, n)
        R = p.rotation(tau)
        return 0.5 * (tau[1:] + tau[:-1]), (R[1:] * R[:-1].inv()).as_rotvec() / tau[1]

    def targets(self, placement: Placement) -> list[Rotation]:
        path = read_points(SCENARIOS / "parts/tilted_square.toml")
        return [Rotation.from_matrix(placement.R_BT) * Rotation.from_euler("ZYX", point.abc) for point in path.points]

    def plan(self, interpolation: Interpolation) -> Plan:
        path = read_points(SCENARIOS / "parts/tilted_square.toml")
        return plan(dataclasses.replace(path, interpolation=interpolation), HERE)

    def test_whole_path_turns_evenly_on_the_lines(self) -> None:
        """10 deg over 80 mm at 25 mm/s: 3.125 deg/s on the middle of the first side."""
        p = self.plan("path")
        tau, w = self.rates(p)
        middle = (tau > 1.0) & (tau < 2.0)
        np.testing.assert_allclose(
            np.linalg.norm(w[middle], axis=1), math.radians(10.0) / 0.080 * FEED, rtol=1e3 * ROUNDOFF
        )  # differences of 0.6 ms
        assert self.difference(p, 0.0, self.targets(HERE)[0]) < ROUNDOFF
        assert self.difference(p, p.duration, self.targets(HERE)[-1]) < ROUNDOFF

    def difference(self, p: Plan, tau: float, target: Rotation) -> float:
        return float((p.rotation(np.array([tau]))[0].inv() * target).magnitude())

    @pytest.mark.parametrize("interpolation", ["path", "corner"])
    def test_rotation_is_twice_differentiable(self, interpolation: Interpolation) -> None:
        """Angular velocity and acceleration do not jump: their differences shrink with the sampling step."""
        p = self.plan(interpolation)
        steps = []
        for n in (20_001, 40_001):
            _, w = self.rates(p, n)
            acceleration = np.diff(w, axis=0) / (p.duration / (n - 1))
            steps.append(np.max(np.abs(np.diff(acceleration, axis=0))))
        assert steps[1] < 0.6 * steps[0]

    def test_corner_keeps_the_orientation_on_the_lines(self) -> None:
        """On the middle of side k the orientation is that of point k; all sides are 80 mm long."""
        p = self.plan("corner")
        tau = np.linspace(0.0, p.duration, 20_001)
        where = p.position(tau) - np.asarray(HERE.p_BP_B)
        for k, middle in enumerate([(0.0, -0.04), (0.04, 0.0), (0.0, 0.04), (-0.04, 0.0)]):
            nearest = tau[np.argmin(np.linalg.norm(where[:, :2] - middle, axis=1))]
            assert self.difference(p, float(nearest), self.targets(HERE)[k]) < 10 * ROUNDOFF

    def test_corner_turns_in_place_at_the_last_point(self) -> None:
        """10 deg from rest to rest at most 5 rad/s2: acceleration reached, speed not; T = a/j + sqrt((a/j)^2 + 4 phi/a)."""
        p = self.plan("corner")
        assert self.difference(p, p.duration, self.targets(HERE)[-1]) < 10 * ROUNDOFF
        ratio = LIMITS.angular_acceleration / LIMITS.angular_jerk
        phi = (self.targets(HERE)[3].inv() * self.targets(HERE)[4]).magnitude()
        turning = ratio + math.sqrt(ratio**2 + 4.0 * phi / LIMITS.angular_acceleration)
        still = p.duration - turning
        np.testing.assert_allclose(
            p.position(np.linspace(still, p.duration, 9)), np.tile(p.position(np.array([p.duration])), (9, 1)), rtol=ROUNDOFF
        )
        assert self.difference(p, still, self.targets(HERE)[3]) < 1e3 * ROUNDOFF

    def test_limits_of_the_rotation_hold(self) -> None:
        p = self.plan("corner")
        _, w = self.rates(p)
        acceleration = np.diff(w, axis=0) / (p.duration / 20_000)
        assert np.max(np.linalg.norm(w, axis=1)) <= LIMITS.angular_speed
        # differences over 0.7 ms of a smooth function
        assert np.max(np.linalg.norm(acceleration, axis=1)) <= LIMITS.angular_acceleration * (1.0 + 1e-4)
        assert len(p.reduced) == 4

    def test_blend_keeps_its_distance(self) -> None:
        """6 mm around each corner: there, and not before, the path leaves the programmed line."""
        p = self.plan("path")
        tau = np.linspace(0.0, p.duration, 200_001)
        where = p.position(tau) - np.asarray(HERE.p_BP_B)
        left = where[(where[:, 1] > -0.040 + 1e-12)][0]
        # as the cube of the way, over 6 mm; and half as much as that for the sample
        assert left[0] == pytest.approx(0.040 - 0.006, abs=discretisation(1.5 * 0.006, (1e-12 / 0.006) ** (1 / 3), 1))

    def test_stop_with_a_turn_where_there_is_no_blend(self) -> None:
        text = "[[point]]\nposition = [0, 0, 0]\n[[point]]\nposition = [50, 0, 0]\norientation = [0, 0, 5]\nfeed = 25\n"
        p = plan(parse_points('orientation = "corner"\n' + text + "[[point]]\nposition = [50, 50, 0]\n"), FLAT)
        resting = [row for row in p.table[1:-1] if row[SPEED] == 0.0]
        assert len(resting) == 2  # before the turn and after it
        tilt = Rotation.from_matrix(FLAT.R_BT) * Rotation.from_rotvec([math.radians(5.0), 0, 0])
        assert self.difference(p, float(resting[1][TAU]), tilt) < ROUNDOFF

    def test_values_and_units(self) -> None:
        path = parse_points(
            "[[point]]\nposition = [1, 2, 3]\n[[point]]\nposition = [4, 5, 6]\norientation = [90, 0, 0]\nblend = 2\nfeed = 25\nspeed = 60"
        )
        point = path.points[1]
        assert path.interpolation == "path"
        np.testing.assert_allclose(point.position, (4e-3, 5e-3, 6e-3), rtol=ROUNDOFF)
        np.testing.assert_allclose(point.abc, (math.pi / 2, 0.0, 0.0), rtol=ROUNDOFF)
        np.testing.assert_allclose((point.blend, point.feed, point.spindle_speed), (2e-3, 0.025, 2 * math.pi), rtol=ROUNDOFF)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("[[point]", "path: not valid TOML"),
            ("speed = 5", "path:1: speed: unknown key 'speed'; available: orientation, point"),
            ("orientation = 'edge'", "path:1: orientation: unknown orientation 'edge'; available: corner, path"),
            ("[[point]]\nposition = [1, 2, 3]", r"at least two \[\[point\]\] tables; found 1"),
            ("point = [1, 2]", r"path:1: point 1: expected a table; found 1"),
            ("[[point]]\nfeed = 1\n[[point]]\n", "path:1: point 1: missing: position; known keys: blend, feed,"),
            ("[[point]]\nposition = [1, 2]\n[[point]]\n", r"path:2: point 1: position: expected three numbers in mm; found \[1, 2\]"),
            (
                "[[point]]\nposition = [1, 2, true]\n[[point]]\n",
                "path:2: point 1: position.2: expected a number in mm; found True",
            ),
            (
                "[[point]]\nposition = [1, 2, 3]\nspin = 4\n[[point]]\n",
                "path:3: point 1: spin: unknown key 'spin'; available: blend",
            ),
            ("[[point]]\nposition = [1, 2, 3]\n[[point]]\nposition = [4, 5, 6]", "path:3: point 2: feed is missing"),
            (
                "[[point]]\nposition = [1, 2, 3]\nblend = -1\n[[point]]\n",
                "path:3: point 1: blend: expected a number in mm, at least 0; found -1",
            ),
        ],
    )
    def test_errors(self, text: str, message: str) -> None:
        with pytest.raises(PathError, match=message):
            parse_points(text)


class TestPilotTable:
    """Reduction of an offline force record (Ramer-Douglas-Peucker)."""

    def record(self) -> tuple[FloatArray, FloatArray]:
        """An entry, a slot with seeded ripple, an exit: 6 s at 4 ms."""
        tau = np.arange(0.0, 6.0, 0.004)
        level = np.interp(tau, [0.5, 1.1, 5.0, 5.3], [0.0, 500.0, 500.0, 0.0])
        ripple = np.random.default_rng(1).normal(0.0, 1.0, (len(tau), 3))
        return tau, level[:, None] * [0.3, -0.9, 0.1] + ripple

    def test_error_stays_below_the_tolerance_with_few_rows(self) -> None:
        tau, forces = self.record()
        table = pilot_table(tau, forces)
        back = np.column_stack([np.interp(tau, table[:, 0], table[:, i]) for i in (1, 2, 3)])
        assert np.max(np.linalg.norm(back - forces, axis=1)) <= 10.0
        assert len(table) < 20
        np.testing.assert_array_equal(table[[0, -1], 0], tau[[0, -1]])

    def test_a_straight_record_needs_two_rows(self) -> None:
        tau = np.linspace(0.0, 1.0, 11)
        assert len(pilot_table(tau, np.outer(tau, [100.0, 0.0, -50.0]))) == 2

    def test_zero_tolerance_keeps_every_corner(self) -> None:
        tau, forces = self.record()
        assert len(pilot_table(tau, forces, 0.0)) == len(tau)

    def test_refuses_what_is_not_a_record(self) -> None:
        with pytest.raises(ValueError, match=r"expected path times \(n,\) and forces \(n, 3\)"):
            pilot_table(np.zeros(3), np.zeros((3, 2)))
        with pytest.raises(ValueError, match="path times must increase"):
            pilot_table(np.zeros(3), np.zeros((3, 3)))
