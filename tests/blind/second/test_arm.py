"""The second generator's arm against what is published: poses, deflections, counterbalance; its friction never gives energy."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from robomill.blind.second import arm, flexure, machine
from robomill.blind.second.motion import GEAR
from robomill.blind.second.torque import friction, torques
from tests.tolerances import ROUNDOFF, discretisation, physics

STEP = 1e-5
"""rad: of the differences of the energy."""
PLACE = machine.Place((1.3, 0.0, 1.2), 180.0, (0.08, 0.06, 0.03), 0, 5400.0)
POSES = {
    (0, 0, 0, 0, 0, 0): (2740.0, 0.0, 634.0),
    (0, -90, 90, 0, 0, 0): (1590.0, 0.0, 1784.0),
    (0, -90, 90, 0, 90, 0): (1350.0, 0.0, 1544.0),
    (10, 10, 10, 10, 10, 10): (2575.2578, -461.435958, -24.647983),
}
"""FACTS 1.3: axis angles [deg] -> flange [mm]."""
DIGITS = 1e-4
"""mm: the last printed digit."""
PUSHED = {
    (2.66, -77.64, 77.44, 0, 0.20, 0): (0.942, 0.082, 0.413),
    (-22.59, -118.99, 90.57, 0, 28.42, 0): (1.267, -0.380, 0.315),
    (21.92, -104.68, 129.22, 0, -24.54, 0): (1.059, 0.387, 0.723),
    (0.65, -96.07, 122.56, 0, -26.49, 0): (0.912, 0.014, 0.773),
}
"""FACTS 1.7: deflection [mm] under 750 N in +x, sensor as printed."""
PRINTED = 2e-6
"""m: half of the last printed digit, and 1 um between the first-order sum and the full chain at 1 mm."""


@pytest.mark.parametrize("angles", POSES)
def test_published_poses_of_the_flange(angles):
    p, _ = arm.tip(np.radians(np.array(angles, dtype=float)), np.zeros(3))
    assert p * 1e3 == pytest.approx(POSES[angles], abs=DIGITS)


CONDITION = 1e4
"""Roundoff grows by the condition of the wrist, 1/sin A5, and of the elbow, and there are some tens of operations."""


def test_the_inverse_finds_the_axes_of_a_pose():
    random, p_FT = np.random.default_rng(1), np.array([0.237, 0.0, 0.25])
    for _ in range(20):
        q = np.radians(np.array([20.0, -90.0, 100.0, 30.0, -40.0, 20.0]) + 10.0 * random.standard_normal(6))
        p, R = arm.tip(q, p_FT)
        assert arm.inverse(p, R, p_FT, q + 0.1) == pytest.approx(q, abs=CONDITION * ROUNDOFF)


@pytest.mark.parametrize("angles", PUSHED)
def test_published_deflections_under_750_newton(angles):
    cell = machine.nominal(PLACE)
    d, _ = arm.deflection(np.radians(np.array(angles)), cell.flexure.p_FT, cell.control.stiffness, np.array([750.0, 0, 0]), np.zeros(3))
    assert d == pytest.approx(np.array(PUSHED[angles]) * 1e-3, abs=PRINTED)


def test_compliance_of_the_drives_alone_is_jacobian_over_stiffness():
    cell, q = machine.nominal(PLACE), np.radians([10.0, -95.0, 110.0, 20.0, -30.0, 15.0])
    rigid = np.full((10, 3), 1e30)
    rigid[arm.DRIVES, 2] = cell.flexure.stiffness[arm.DRIVES, 2]
    f, m = np.array([300.0, -200.0, 400.0]), np.array([20.0, 5.0, -10.0])
    J = arm.jacobian(q, cell.flexure.p_FT)
    expected = J @ ((J.T @ np.concatenate([f, m])) / rigid[arm.DRIVES, 2])
    d, theta = arm.deflection(q, cell.flexure.p_FT, rigid, f, m)
    assert np.concatenate([d, theta]) == pytest.approx(expected, rel=CONDITION * ROUNDOFF)


def test_the_yielding_arm_without_effects_is_the_linear_one():
    cell, q = machine.nominal(PLACE), np.radians([10.0, -95.0, 110.0, 20.0, -30.0, 15.0])
    f, m = np.array([300.0, -200.0, 400.0]), np.array([20.0, 5.0, -10.0])
    d, theta, _ = flexure.yielding(cell.flexure, flexure.at_rest(), 0.0, 1e-3, q, f, m)
    linear, turned = arm.deflection(q, cell.flexure.p_FT, cell.flexure.stiffness, f, m)
    assert d == pytest.approx(linear, rel=CONDITION * ROUNDOFF)
    assert theta == pytest.approx(turned, rel=CONDITION * ROUNDOFF)


@pytest.mark.parametrize(("degrees", "published"), [(-140, -5235), (-120, -3074), (-95, 0), (-60, 4197), (-40, 6179), (-5, 8652)])
def test_published_torque_of_the_counterbalance(degrees, published):
    assert flexure.gas_spring(math.radians(degrees)) == pytest.approx(published, abs=physics(1.0, absolute=1.0))


def test_torque_at_rest_is_the_gradient_of_the_height_of_the_masses():
    dynamics, q = machine.nominal(PLACE).dynamics, np.radians([10.0, -95.0, 110.0, 20.0, -30.0, 15.0])

    def energy(x):
        R, o = arm.links(x, arm.A, arm.D)
        hung = dynamics.payload * (o[5] + R[5] @ dynamics.payload_com)[2]
        return flexure.GRAVITY * (hung + sum(dynamics.mass[i] * (o[i] + R[i] @ dynamics.com[i])[2] for i in range(6)))

    still = torques(dynamics._replace(gas=0.0), np.array([q, q, q]), np.zeros((3, 6)), np.zeros((3, 6)), 0.004)[2]
    for i in range(6):
        step = np.eye(6)[i] * STEP
        gradient = (energy(q + step) - energy(q - step)) / (2.0 * STEP)
        assert still[i] * GEAR[i] == pytest.approx(
            gradient, abs=discretisation(1e4, STEP, 2) + physics(1e4 / STEP, relative=ROUNDOFF)
        )  # energies of 10 kJ


SMOOTH = 0.15
"""The rounded saturation of the hysteresis stands between 1 and 2^(1/6) = 1.12 of its size."""


class TestLaws:
    def test_a_cycle_of_friction_costs_energy_and_no_less_than_coulomb_at_large_strokes(self):
        base = machine.nominal(PLACE).dynamics
        c = base._replace(coulomb=np.full(6, 100.0), stribeck=np.full(6, 50.0), viscous=np.full(6, 10.0))
        q = 0.01 * np.sin(np.linspace(0.0, 4.0 * math.pi, 4001))
        work, bristle = 0.0, 0.0
        for before, after in itertools.pairwise(q):
            bristle, torque = friction(c, 0, bristle, after - before, 1e-3)
            work += torque * (after - before)
        assert work > 100.0 * np.abs(np.diff(q)).sum() * 0.95

    def test_small_strokes_of_friction_never_give_energy(self):
        c = machine.nominal(PLACE).dynamics._replace(coulomb=np.full(6, 100.0))
        work, bristle, lowest = 0.0, 0.0, 0.0
        random = np.random.default_rng(3)
        for step in np.diff(np.cumsum(random.standard_normal(5000)) * 2e-6):
            bristle, torque = friction(c, 0, bristle, step, 1e-3)
            work += torque * step
            lowest = min(lowest, work)
        assert lowest > -100.0 * c.presliding  # no more than what the bristle can hold

    def loop(self, c, torque):
        state, twist = flexure.at_rest(), []
        for M in torque:
            twist.append(flexure.drive_twist(c, state, 0, M, 0.0, 1e-3))
        return np.array(twist)

    @pytest.mark.parametrize("effect", ["hysteresis", "friction"])
    def test_loops_of_hysteresis_cost_energy(self, effect):
        size = 100e-6 if effect == "hysteresis" else 50.0
        c = machine.nominal(PLACE).flexure._replace(**{effect: np.full(6, size)})
        torque = 600.0 * np.sin(np.linspace(0.0, 4.0 * math.pi, 2001))
        twist = self.loop(c, torque)
        cycle = slice(1000, 2001)
        assert np.trapezoid(torque[cycle], twist[cycle]) > 0.0

    def test_lost_motion_at_zero_torque_is_the_size_of_the_hysteresis(self):
        c = machine.nominal(PLACE).flexure._replace(hysteresis=np.full(6, 80e-6))
        up = np.concatenate([np.linspace(0, 800, 400), np.linspace(800, 0, 400), np.linspace(0, -800, 400), np.linspace(-800, 0, 400)])
        twist = self.loop(c, up)
        assert twist[799] == pytest.approx(80e-6, rel=SMOOTH)
        assert twist[-1] == pytest.approx(-80e-6, rel=SMOOTH)

    def test_hardening_and_error_have_their_size_at_the_reference_torque(self):
        base = machine.nominal(PLACE).flexure
        M = float(base.reference[0])
        straight = self.loop(base, [M])[0]
        assert self.loop(base._replace(hardening=np.full(6, 0.5), hardening_power=1.3), [M])[0] == pytest.approx(
            straight / 1.5, rel=ROUNDOFF
        )
        assert self.loop(base._replace(error=np.full(6, 0.25)), [M])[0] == pytest.approx(straight / 1.25, rel=ROUNDOFF)
