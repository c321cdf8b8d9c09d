"""Stability of the force control, against python-control: with its dead time, and sampled."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from robomill.models.calibration.force_loop import MARGIN, ForceLoop, followed_slope
from robomill.models.components.robot_drive import second_order_zoh
from tests.tolerances import physics

DRIVES = [(4.5, 22.9), (8.0, 30.6), (15.0, 40.4)]
"""Drive Hz, critical g k 1/s of FACTS10 10.4."""
PUBLISHED = physics(1.0, relative=0.0025)
"""Half a unit of the third figure."""
CROSSING = physics(1.0, relative=1e-6)
"""How well python-control finds the crossing of -180 deg, by iteration."""
PADE = 8
"""Order of the approximation of the dead time; at the crossing (w T < 0.5) its error is below roundoff of the margin."""


def loop(frequency: float) -> ForceLoop:
    return ForceLoop(2.0 * math.pi * frequency)


def transfer(force_loop: ForceLoop) -> control.TransferFunction:
    """L of one per second, the dead time by Pade."""
    s = control.tf("s")
    w, z = force_loop.drive_frequency, force_loop.drive_damping
    dead = control.tf(*control.pade(force_loop.dead_time, PADE))
    return 1 / s / (1 + s / force_loop.filter_frequency) * dead * w**2 / (s**2 + 2 * z * w * s + w**2)


@pytest.mark.paper
@pytest.mark.parametrize(("frequency", "published"), DRIVES)
def test_critical_gains_are_the_published_ones(frequency: float, published: float) -> None:
    assert loop(frequency).critical == pytest.approx(published, abs=published * PUBLISHED)


@pytest.mark.parametrize("frequency", [4.5, 8.0, 15.0])
def test_critical_gains_are_the_gain_margins_of_python_control(frequency: float) -> None:
    margin, _, crossing, _ = control.margin(transfer(loop(frequency)))
    assert loop(frequency).critical == pytest.approx(margin, abs=margin * CROSSING)
    assert loop(frequency).phase(crossing) == pytest.approx(-math.pi, abs=CROSSING)


@pytest.mark.parametrize("frequency", [4.5, 8.0, 15.0])
def test_the_gain_that_is_used_leaves_three_and_is_damped(frequency: float) -> None:
    force_loop = loop(frequency)
    closed = control.feedback(force_loop.critical / MARGIN * transfer(force_loop), 1)
    slow = [p for p in closed.poles() if abs(p) < force_loop.filter_frequency]
    assert control.margin(force_loop.critical / MARGIN * transfer(force_loop))[0] == pytest.approx(MARGIN, abs=MARGIN * CROSSING)
    assert min(-p.real / abs(p) for p in slow) > 0.45


def sampled(force_loop: ForceLoop, gain: float) -> np.ndarray:
    """Poles of the loop as it runs: filter, integrator and transport as in path_learning, the drive's exact steps as in robot_drive."""
    h, n = force_loop.step, round(force_loop.transport_steps)
    phi, gamma = np.zeros(4), np.zeros(2)
    second_order_zoh(force_loop.drive_frequency, force_loop.drive_damping, h, phi, gamma)
    drive = control.ss(phi.reshape(2, 2), gamma.reshape(2, 1), [[1, 0]], 0, h)
    z = control.tf("z")
    z.dt = h
    a = math.exp(-force_loop.filter_frequency * h)
    law = control.tf([1 - a, 0], [1, -a], h) * control.tf([gain * h, 0], [1, -1], h) * control.tf([1], [1, *([0] * n)], h)
    return np.asarray(control.feedback(control.ss(law) * drive, 1).poles())


@pytest.mark.parametrize("frequency", [4.5, 8.0, 15.0])
def test_the_sampled_loop_has_the_same_limit(frequency: float) -> None:
    """Filter and integrator by backward differences are half a step each early, so the limit lies 0..15 % above that of the formula."""
    force_loop = loop(frequency)
    low, high = sampled(force_loop, force_loop.critical), sampled(force_loop, 1.15 * force_loop.critical)
    assert np.abs(low).max() < 1.0 < np.abs(high).max()


@pytest.mark.paper
def test_gains_and_slopes_are_the_published_ones() -> None:
    """Gains .076 and .015 mm/s/N, retreat 1.5 and .30 mm/s (20 N), hand guiding up to 1.5 N/mm, 66 000 N s/m: two figures are printed."""
    force_loop = ForceLoop()
    two = physics(1.0, relative=0.05)
    assert force_loop.gain(1e5) == pytest.approx(7.6e-5, abs=7.6e-5 * two)
    assert force_loop.gain(5e5) == pytest.approx(1.5e-5, abs=1.5e-5 * two)
    assert 0.005 * followed_slope(force_loop.gain(1e5), 20.0, 0.005) == pytest.approx(1.5e-3, abs=1.5e-3 * two)
    assert 0.005 * followed_slope(force_loop.gain(5e5), 20.0, 0.005) == pytest.approx(0.30e-3, abs=0.30e-3 * two)
    assert force_loop.stiffest(200.0) == pytest.approx(1.52e3, abs=1.52e3 * two)
    assert force_loop.contact_damping(5e5) == pytest.approx(66e3, abs=66e3 * two)
