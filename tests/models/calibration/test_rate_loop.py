"""Design of the rate control: figures of paper 003 and FACTS10 10.2, closed forms, the frequency response as a second way."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from scipy.optimize import brentq

from robomill.models.calibration.rate_loop import (
    B_UNDELAYED,
    CANDIDATES,
    CYCLE,
    DEAD_TIME_B,
    LOOP_GAIN,
    SLOW_POLE,
    ZERO_TIME,
    A,
    continuous_loop,
    critical_gain,
    damping,
    loop_gain,
    oscillation,
    pade,
    pi,
    sampled_loop,
    sampled_pi,
)
from tests.tolerances import ROUNDOFF, physics

PRINTED = 0.005
"""Half of the last digit of a damping given with two decimals."""
PRINTED_THREE = 0.001
"""A damping given with three decimals, the PI zero at 66.5 there and at 1/0.015 here."""
SOLVED = 1e-8
"""Relative: where brentq stops on roots of polynomials."""


@pytest.mark.paper
@pytest.mark.parametrize("name", CANDIDATES)
def test_every_candidate_has_the_damping_and_the_limit_of_the_paper(name: str) -> None:
    """Damping 0.70 at 28.84 (sec. 4.3.3, two digits), unstable beyond 1.89 = 0.015 times 126 (three digits)."""
    dynamics = CANDIDATES[name]
    assert damping(continuous_loop(dynamics, LOOP_GAIN)) == pytest.approx(0.70, rel=0, abs=physics(0.7, absolute=PRINTED))
    assert ZERO_TIME * critical_gain(dynamics) == pytest.approx(1.89, rel=0, abs=physics(1.89, absolute=0.005))
    assert float(np.real(dynamics(0.0))) == pytest.approx(1.0, rel=ROUNDOFF, abs=0.0)
    assert np.abs(dynamics.poles() + SLOW_POLE).min() < ROUNDOFF * SLOW_POLE
    assert dynamics.zeros().real.max() > 0.0


DAMPINGS = {"A": (0.700, 0.10, -0.22), "B": (0.700, 0.085, -0.17), "C": (0.700, 0.08, -0.16)}
"""At 1, 2, 3 mm, gains tuned at 1 mm (FACTS 2.2)."""


@pytest.mark.paper
@pytest.mark.parametrize("name", CANDIDATES)
def test_fixed_gains_are_fine_at_1_mm_vibrate_at_2_and_are_unstable_at_3(name: str) -> None:
    """Sec. 4.4: vibrates but still stable, then unstable; values of FACTS 2.2, two decimals."""
    found = [damping(continuous_loop(CANDIDATES[name], loop_gain(d))) for d in (1, 2, 3)]
    for one, expected in zip(found, DAMPINGS[name], strict=True):
        assert one == pytest.approx(expected, rel=0, abs=physics(expected, absolute=PRINTED))
    assert found[0] > 0.6
    assert 0.0 < found[1] < 0.15
    assert found[2] < 0.0


def test_candidate_a_has_the_damping_of_its_closed_form() -> None:
    """With the PI zero on the slow pole: zeta = (1 - K/126) sqrt(95.06/K)/2."""
    for gain in (LOOP_GAIN, 60.0, 100.0, 150.0):
        exact = control.tf([1.0 / SLOW_POLE, 1.0], [1.0, 0.0]) * gain * A
        expected = 0.5 * (1.0 - gain / 126.0) * math.sqrt(95.06 / gain)
        assert damping(control.minreal(exact, verbose=False)) == pytest.approx(expected, rel=0, abs=SOLVED)


SAMPLED = [
    # dynamics, delayed steps, critical gain, dampings at 1, 2, 3 mm
    (A, 0, 100.5, (0.653, 0.000, -0.31)),
    (A, 1, 76.0, (0.521, -0.119, None)),
    (A, 3, 53.0, (0.32, None, None)),
    (A, 5, 41.3, (0.18, None, None)),
    (B_UNDELAYED, 1, 181.0, (0.82, 0.21, -0.04)),
    (B_UNDELAYED, 2, 114.1, (0.691, 0.049, -0.199)),
    (B_UNDELAYED, 3, 85.0, (0.56, -0.06, -0.29)),
]
"""FACTS10 10.2: 4 ms, zero-order hold. B without its dead time and with two delayed steps is the default of the twin."""


@pytest.mark.paper
@pytest.mark.parametrize(("dynamics", "delays", "critical", "dampings"), SAMPLED, ids=["A0", "A1", "A3", "A5", "B1", "B2", "B3"])
def test_the_sampled_loop_with_its_delays(dynamics: object, delays: int, critical: float, dampings: tuple[float | None, ...]) -> None:
    """Critical gain to the last digit printed; dampings to two or three decimals."""
    assert critical_gain(dynamics, delays) == pytest.approx(critical, rel=0, abs=physics(critical, relative=0.005))
    for depth, expected in zip((1, 2, 3), dampings, strict=True):
        if expected is not None:
            assert damping(sampled_loop(dynamics, loop_gain(depth), delays)) == pytest.approx(
                expected, rel=0, abs=physics(expected, absolute=PRINTED)
            )


@pytest.mark.paper
def test_two_delayed_steps_and_the_hold_are_the_dead_time_of_candidate_b() -> None:
    """10 ms against 9.83 ms; the published experiment: damped at 1 mm, just stable at 2 mm with 14-18 Hz, unstable at 3 mm."""
    assert pytest.approx(DEAD_TIME_B, rel=0, abs=physics(DEAD_TIME_B, relative=0.02)) == 2.5 * CYCLE
    one, two, three = (oscillation(sampled_loop(B_UNDELAYED, loop_gain(d), 2)) for d in (1, 2, 3))
    assert [one[0], two[0], three[0]] == pytest.approx([0.691, 0.049, -0.199], rel=0, abs=physics(0.691, absolute=PRINTED_THREE))
    assert 14.0 < two[1] < 18.0


@pytest.mark.paper
def test_the_sensor_filter_of_50_ms_does_not_belong_into_the_loop() -> None:
    """Twelve more steps: the critical gain falls to 24 (two digits), below the 28.84 of the paper: unstable at 1 mm already."""
    assert critical_gain(A, 12) == pytest.approx(24.0, rel=0, abs=physics(24.0, absolute=0.5))
    assert damping(sampled_loop(A, LOOP_GAIN, 12)) < 0.0


def test_even_a_light_filter_must_be_counted() -> None:
    """First order, 10 ms, on top of the loop of the twin: docs/explanation/rate_control.md, two digits."""
    filtered = B_UNDELAYED * control.tf([1.0], [0.010, 1.0])
    assert critical_gain(filtered, 2) == pytest.approx(77.0, rel=0, abs=physics(77.0, absolute=0.5))
    assert damping(sampled_loop(filtered, LOOP_GAIN, 2)) == pytest.approx(0.44, rel=0, abs=physics(0.44, absolute=PRINTED))


@pytest.mark.parametrize(("dynamics", "delays"), [(A, 0), (A, 3), (B_UNDELAYED, 2), (A, 12)])
def test_the_critical_gain_is_the_gain_margin_of_the_frequency_response(dynamics: control.TransferFunction, delays: int) -> None:
    """Bode and Nyquist instead of poles: gain where the phase of L(exp(j w h)) passes -180 deg."""
    loop = sampled_loop(dynamics, 1.0, delays)

    def response(w: float) -> complex:
        return complex(loop(np.exp(1j * w * CYCLE)))

    w = np.linspace(1.0, 0.9 * math.pi / CYCLE, 4000)
    phase = np.unwrap(np.angle([response(x) for x in w]))
    i = int(np.argmax(phase < -math.pi))
    crossing = brentq(lambda x: response(x).imag, w[i - 1], w[i])
    assert critical_gain(dynamics, delays) == pytest.approx(1.0 / abs(response(crossing)), rel=SOLVED, abs=0.0)


def test_a_shorter_cycle_comes_to_the_continuous_loop() -> None:
    """The hold is a delay of half a cycle: the error of the critical gain is of first order."""
    gap = [critical_gain(A) - critical_gain(A, 0, cycle) for cycle in (0.001, 0.0005, 0.00025)]
    assert gap[0] / gap[1] == pytest.approx(2.0, rel=0, abs=0.1 if gap[0] > 0.0 else 0.0)
    assert gap[1] / gap[2] == pytest.approx(2.0, rel=0, abs=0.05 if gap[0] > 0.0 else 0.0)


def test_the_sampled_pi_is_the_sum_of_its_parts() -> None:
    """K (0.015 + h z/(z - 1)) at a few places of the plane; the dead time of B is Pade's all-pass."""
    for z in (0.3 + 0.4j, 1.5 - 0.2j, -0.7 + 0.0j):
        assert complex(sampled_pi(LOOP_GAIN)(z)) == pytest.approx(LOOP_GAIN * (ZERO_TIME + CYCLE * z / (z - 1.0)), rel=ROUNDOFF, abs=0.0)
    assert complex(pi(2.0)(3.0j)) == pytest.approx(2.0 * (ZERO_TIME + 1.0 / 3.0j), rel=ROUNDOFF, abs=0.0)
    assert abs(complex(pade(0.01)(50.0j))) == pytest.approx(1.0, rel=ROUNDOFF, abs=0.0)


def test_nothing_oscillates_at_a_small_gain() -> None:
    assert oscillation(continuous_loop(A, 1.0)) == (1.0, 0.0)
    assert oscillation(sampled_loop(B_UNDELAYED, 1.0, 0)) == (1.0, 0.0)


@pytest.mark.parametrize(("believed", "least", "most"), [(0.3, 0.35, 0.45), (0.9, 0.88, 1.0)])
def test_a_wrong_exponent_within_its_bounds_leaves_the_loop_damped(believed: float, least: float, most: float) -> None:
    """The estimate of k follows the force: only the slope of F' over f is wrong, so the loop gain by beta over its estimate."""
    gain = LOOP_GAIN * 0.5 / believed
    assert least < damping(sampled_loop(B_UNDELAYED, gain, 2)) < most
