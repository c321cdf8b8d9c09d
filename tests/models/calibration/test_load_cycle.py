"""Load cycles: slopes, width and gap of known loops, of the twin's axis 6, and of what is no cycle."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from robomill.models.calibration.load_cycle import CONFIDENCE, fit_cycle, fit_gap, half_cycles
from tests.models.components.test_robot_compliance import DRIVES, Twist
from tests.tolerances import ROUNDOFF, chance, physics

K, FRICTION, GAP = 3.14e5, 60.0, 6e-5
"""Axis 6 of the KR 210-2 (FACTS10 10.5): spring N.m/rad, friction N.m, gap rad."""
LARGE, SMALL = 450.0, 50.0
"""Torques of the cycles, N.m."""
TORQUE_NOISE, ANGLE_NOISE = 0.5, 2e-6
"""N.m and rad rms: half a micrometre at 0.3 m."""


def cycles(amplitude: float, n: int = 3, per: int = 200) -> np.ndarray:
    """Torque from zero to the amplitude, then n times to its negative and back."""
    loop = np.r_[np.linspace(1.0, -1.0, per)[1:], np.linspace(-1.0, 1.0, per)[1:]]
    return amplitude * np.concatenate([np.linspace(0.0, 1.0, per // 2)] + [loop] * n)


@cache
def axis_6(amplitude: float) -> tuple[np.ndarray, np.ndarray]:
    """Torque and elastic angle of axis 6 of the twin: friction beside the spring, and the gap as lost motion of half a newton metre."""
    sixth = np.eye(6)[5]
    twist = Twist(5, gear_friction=FRICTION * sixth, gear_hysteresis=0.5 * GAP * sixth, hysteresis_torque=0.5)
    twist.s.stiffness[DRIVES[5], 2] = K
    torque = cycles(amplitude, 1, 121)
    angle = np.array([twist(float(m)) for m in torque])
    return tuple(np.r_[x[:60], np.tile(x[60:], 3)] for x in (torque, angle))  # type: ignore[return-value]  # the loop is closed


def spring(seed: int, gap: float = GAP) -> tuple[np.ndarray, np.ndarray]:
    """Spring and gap alone, with noise."""
    rng, torque = np.random.default_rng(seed), cycles(SMALL)
    angle = torque / K + 0.5 * gap * np.sign(torque) + ANGLE_NOISE * rng.normal(size=len(torque))
    return torque, angle


@pytest.mark.paper
def test_slopes_of_axis_6() -> None:
    """FACTS10 10.5: line 3.30e5, end of loading 3.12e5, start of unloading 4.9e5, 430 urad; 3 %, as its elements are not printed."""
    fit = fit_cycle(*axis_6(LARGE))
    for found, printed in (
        (fit.whole.value, 3.30e5),
        (fit.loading_end.value, 3.12e5),
        (fit.unloading_start.value, 4.9e5),
        (fit.width, 430e-6),
    ):
        assert abs(found - printed) < physics(printed, relative=0.03)
    assert abs(fit.amplitude - LARGE) < ROUNDOFF * LARGE
    assert len(fit.half_cycles) == 6


@pytest.mark.paper
def test_the_gap_shows_in_a_small_cycle_only() -> None:
    """60 urad in +-50 N.m; in +-450 N.m friction slips and the step is twice as large: said to be not determined."""
    small, large = fit_gap(*axis_6(SMALL)), fit_gap(*axis_6(LARGE))
    assert small.finding == "determined"
    assert abs(small.gap - GAP) < physics(GAP, relative=1e-6)  # exact data
    assert large.finding.startswith("not determined: without it the loop is still ")
    assert large.finding.endswith("urad wide at zero torque, so friction slips; measure a smaller cycle")
    assert large.interval[0] > 1.5 * GAP


def test_the_loop_of_known_elements() -> None:
    """Slipping friction beside a spring: 2 M_f/k and the gap wide, work as of its corners; friction found is below the true one."""
    fit = fit_cycle(*axis_6(LARGE))
    assert abs(fit.width - (2.0 * FRICTION / K + GAP)) < physics(fit.width, relative=0.02)  # a line through a bent branch
    assert abs(fit.work - 4.0 * FRICTION * ((LARGE - FRICTION) / K - 0.5 * _slip())) < physics(fit.work, relative=0.02)  # trapezoids
    assert 0.5 * FRICTION < fit.friction < FRICTION


def _slip() -> float:
    """Mean angle at which the friction elements slip, twice: what a reversal loses of the parallelogram."""
    stick = 0.56 * K * np.array([1 / 2, 1 / 3, 1 / 4, 1 / 5]) / (77 / 60)
    return float(np.mean(2.0 * 15.0 / stick))


def test_the_interval_holds_the_gap_as_often_as_it_says() -> None:
    """Or more often: 99 %, as a branch counts as no surer than its residuals."""
    trials = 200
    held = sum(low < GAP < high for low, high in (fit_gap(*spring(seed)).interval for seed in range(trials)))
    assert held / trials > CONFIDENCE - chance(np.sqrt(CONFIDENCE * (1.0 - CONFIDENCE) / trials))


def test_no_gap_is_not_found() -> None:
    fit = fit_gap(*spring(3, gap=0.0))
    assert fit.finding == "not determined: the interval holds zero"
    assert abs(fit.slope - K) < physics(K, relative=0.02)  # noise of 2 urad in 160


def test_noise_moves_the_slopes_by_its_standard_error() -> None:
    rng, (torque, angle) = np.random.default_rng(0), axis_6(LARGE)
    exact = fit_cycle(torque, angle)
    noisy = fit_cycle(torque + TORQUE_NOISE * rng.normal(size=len(torque)), angle + ANGLE_NOISE * rng.normal(size=len(torque)))
    for a, b in ((exact.loading_end, noisy.loading_end), (exact.unloading_start, noisy.unloading_start)):
        assert abs(a.value - b.value) < chance(b.error) + physics(a.value, relative=2e-3)  # and what noise in the angle takes off a slope


def test_a_first_loading_and_a_break_are_no_half_cycles() -> None:
    torque = np.concatenate([np.linspace(0, 100, 50), np.linspace(100, 30, 40), np.linspace(30, 100, 40), cycles(-100.0, 1)[100:]])
    assert all(abs(torque[a]) > 80.0 and abs(torque[b]) > 80.0 for a, b in half_cycles(torque))


@pytest.mark.parametrize(
    ("torque", "angle", "text"),
    [
        (np.linspace(0, 100, 50), np.zeros(50), "0 complete branches in 50 samples, torque from 0 to 100 N.m; expected at least two"),
        (cycles(10.0), np.full(len(cycles(10.0)), np.nan), "angle of sample 1 is nan, expected finite numbers"),
        (cycles(10.0), np.zeros(4), "expected two columns of the same length"),
        (cycles(10.0), -cycles(10.0), "the angle does not grow with the torque at the end of loading of a branch; check the signs"),
        (cycles(10.0, per=12), cycles(10.0, per=12), "samples at the end of loading of a branch, expected 5; sample faster"),
    ],
)
def test_errors(torque: np.ndarray, angle: np.ndarray, text: str) -> None:
    with pytest.raises(ValueError, match=text.replace(".", r"\.")):
        fit_cycle(torque, angle)
