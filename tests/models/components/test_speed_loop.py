"""speed_loop: the speed dynamics against python-control, and the loop of the published experiment."""

from __future__ import annotations

import math
from typing import Any

import control
import numpy as np
import pytest
from scipy.optimize import brentq

from robomill.models.components.speed_loop import MODEL, QUEUE, SPEED_LOOP
from robomill.models.model.declaration import record
from tests.tolerances import EXACT, ROUNDOFF, physics

H = 0.004
FEED = 0.03
DEAD_TIME = 0.00983
"""Dead time of candidate B in continuous time [s] (FACTS 2.2)."""
CANDIDATES = {
    1: control.tf([-1 / 126.0, 1], np.polymul([1 / 66.5, 1], [1 / 95.06, 1])),
    2: control.tf([1.0], np.polymul([1 / 66.5, 1], [1 / 127.8, 1])),
    3: control.tf([-1 / 221.4, 1], np.polymul([1 / 66.5, 1], [1 / 150.0**2, 2 * 0.975 / 150.0, 1])),
}
SOLVED = 1e-9
"""Relative: python-control discretises by the exponential of a matrix and finds poles of polynomials, each good to some 1e-11 here."""
DESIGN = 28.84
"""Gain of the open loop at 1 mm [1/s], Eq. (13)."""


class Loop:
    """One instance under a ratio that each step holds."""

    def __init__(self, compiled: bool = False, ratio: float = 0.0, **parameters: Any) -> None:
        self.data = MODEL.new()
        self.s = record(self.data)
        self.init, self.step = MODEL.compiled() if compiled else MODEL.plain()
        for name, value in {"feed_max": 1.0, **parameters}.items():
            self.data[name] = value
        self.data["speed_ratio"] = ratio
        self.h = float(self.s.sample_time)
        self.k = 0
        assert self.init(self.s) == 0

    def run(self, ratios: np.ndarray) -> np.ndarray:
        """Feed [m/s] at the end of each step."""
        feed = np.zeros(len(ratios))
        for i, ratio in enumerate(ratios):
            self.data["speed_ratio"] = ratio
            assert self.step(self.s, self.k * self.h, self.h) == 0
            self.k += 1
            feed[i] = self.s.feed
        return feed


def sampled_loop(gain: float, candidate: int, delays: int, h: float = H) -> control.TransferFunction:
    """Open loop of Eq. (14) and G(s) at `h`: K_p = 0.015 K, K_i = K, the sum of the PI with its newest term, `delays` extra steps."""
    z = control.tf([1, 0], [1], h)
    pi = gain * (0.015 + h * z / (z - 1))
    return pi * control.sample_system(CANDIDATES[candidate], h, "zoh") * control.tf([1], [1] + [0] * delays, h)


def closed_poles(gain: float, candidate: int, delays: int) -> np.ndarray:
    """Poles of the closed sampled loop."""
    poles: np.ndarray = control.poles(control.feedback(sampled_loop(gain, candidate, delays), 1))
    return poles


def damping(gain: float, candidate: int, delays: int) -> float:
    """Damping ratio of the slowest decaying pair of the closed sampled loop, as a continuous pole."""
    poles = closed_poles(gain, candidate, delays)
    pairs = poles[np.abs(poles.imag) > SOLVED]
    s = np.log(pairs[np.argmax(np.abs(pairs))]) / H
    return float(-s.real / abs(s))


def critical_gain(candidate: int, delays: int) -> float:
    """Gain at which a pole of the closed sampled loop gets onto the unit circle."""
    return float(brentq(lambda gain: np.abs(closed_poles(gain, candidate, delays)).max() - 1.0, 1.0, 399.0))


# ------------------------------------------------------------------------------------------- dynamics


@pytest.mark.parametrize("candidate", CANDIDATES)
@pytest.mark.parametrize("h", [0.001, 0.004, 0.02])
def test_discretisation_is_the_zero_order_hold_of_python_control(candidate: int, h: float) -> None:
    rng = np.random.default_rng(5)
    ratios = rng.uniform(0.6, 1.0, 200)  # so that no undershoot of the zero gets below a standstill
    ours = Loop(compiled=True, candidate=candidate, sample_time=h, ratio=0.8).run(ratios)
    sampled = control.sample_system(control.ss(CANDIDATES[candidate]), h, "zoh")
    t = h * np.arange(201)
    theirs = control.forced_response(sampled, t, FEED * (np.append(ratios, 0.0) - 0.8)).outputs[1:] + 0.8 * FEED
    assert np.abs(ours - theirs).max() < SOLVED * FEED


def test_candidates_have_the_damping_and_the_limit_of_the_paper_in_continuous_time() -> None:
    """FACTS 2.2: damping 0.70 at 28.84 and stable up to 126 with each, B with its dead time as a Pade approximation."""
    pade = control.tf([-DEAD_TIME / 2, 1], [DEAD_TIME / 2, 1])
    for g in (CANDIDATES[1], CANDIDATES[2] * pade, CANDIDATES[3]):
        loop = g * control.tf([1 / 66.5, 1], [1, 0])
        poles = control.poles(control.feedback(DESIGN * control.minreal(loop, tol=SOLVED, verbose=False), 1))
        pair = poles[np.argmax(poles.real)]
        assert abs(-pair.real / abs(pair) - 0.70) <= physics(0.70, absolute=0.005)
        assert abs(control.margin(loop)[0] - 126.0) <= physics(126.0, relative=0.01)


@pytest.mark.parametrize("dead_time", [0.004, 0.008, DEAD_TIME, 0.0501])
def test_dead_time_is_exact_for_whole_and_for_broken_steps(dead_time: float) -> None:
    """A step response, late by the dead time, against the closed form of two real poles."""
    feed = Loop(compiled=True, dead_time=dead_time).run(np.ones(100))
    p, q = 66.5, 127.8
    t = np.maximum(H * np.arange(1, 101) - dead_time, 0.0)
    expected = FEED * (1.0 - (q * np.exp(-p * t) - p * np.exp(-q * t)) / (q - p))
    assert np.abs(feed - expected).max() < 100 * ROUNDOFF * FEED


def test_feed_is_limited_in_size_and_in_rate() -> None:
    loop = Loop(feed_max=0.02)
    loop.run(np.ones(100))
    assert abs(loop.s.feed - 0.02) < ROUNDOFF
    slow = Loop(feed_rate=0.5)
    commands = []
    for _ in range(20):
        slow.run(np.ones(1))
        commands.append(float(slow.s.feed_command))
    assert np.abs(np.array(commands) - np.minimum(0.5 * H * np.arange(1, 21), FEED)).max() < ROUNDOFF
    assert Loop(candidate=1).run(np.ones(1))[0] == EXACT  # undershoot of the zero: the tool stands
    back = Loop()
    back.run(np.full(50, -1.0))
    assert back.s.feed == EXACT


def test_path_ratio_is_the_override_of_the_path_within_its_range() -> None:
    loop = Loop(ratio=0.7)
    assert abs(loop.s.path_ratio - 0.7) < ROUNDOFF
    fast = Loop(ratio=3.0)
    assert fast.s.path_ratio == 1.5
    assert abs(fast.s.feed - 0.09) < ROUNDOFF


# ------------------------------------------------------------------------------- the loop of the paper


@pytest.mark.paper
@pytest.mark.parametrize(("depth", "expected"), [(1, 0.691), (2, 0.049), (3, -0.199)])
def test_published_experiment_fine_vibrating_unstable(depth: int, expected: float) -> None:
    """B with two delayed connections: 'fine', 'started to vibrate, but still stable', 'unstable' at 1, 2, 3 mm.

    The loop gain goes with the depth to the power 0.9/0.5. Tolerance: figures of FACTS10 10.2 are given to 0.001.
    """
    assert abs(damping(DESIGN * depth**1.8, 2, 2) - expected) <= physics(expected, absolute=0.001)


@pytest.mark.paper
@pytest.mark.parametrize(
    ("candidate", "delays", "critical", "dampings"),
    [
        (1, 0, 100.5, (0.653, 0.000, -0.31)),
        (1, 1, 76.0, (0.52, -0.119, None)),
        (1, 3, 53.0, (0.32, None, None)),
        (1, 5, 41.0, (0.18, None, None)),
        (2, 1, 181.0, (0.82, 0.21, -0.04)),
        (2, 2, 114.1, (0.691, 0.049, -0.199)),
        (2, 3, 85.0, (0.56, -0.06, -0.29)),
    ],
)
def test_table_of_sampled_loops(candidate: int, delays: int, critical: float, dampings: tuple[float | None, ...]) -> None:
    """FACTS10 10.2, which gives critical gains to 0.5 % and dampings to 0.005."""
    assert abs(critical_gain(candidate, delays) - critical) <= physics(critical, relative=0.01)
    for depth, expected in enumerate(dampings, 1):
        if expected is not None:
            assert abs(damping(DESIGN * depth**1.8, candidate, delays) - expected) <= physics(expected, absolute=0.006)


def test_two_and_only_two_delays_show_the_experiment() -> None:
    """With one delayed step 3 mm hardly vibrates, with three 2 mm is unstable already: the count is not free."""
    signs = {n: [damping(DESIGN * d**1.8, 2, n) > 0.0 for d in (1, 2, 3)] for n in (2, 3)}
    assert signs == {2: [True, True, False], 3: [True, False, False]}
    assert damping(DESIGN * 2**1.8, 2, 1) > 4 * damping(DESIGN * 2**1.8, 2, 2)


@pytest.mark.parametrize("delays", [0, 1, 2])
def test_closed_loop_of_the_component_is_that_of_python_control(delays: int) -> None:
    """PI on a linear process F' = k f around the component, at the gain of 2 mm: the sampled model is what runs."""
    gain = DESIGN * 2**1.8
    loop = Loop(compiled=True, ratio=0.5)
    integral, late, feeds = 0.5, [0.5] * delays, []
    for _ in range(250):
        error = 0.55 - float(loop.s.feed) / FEED
        integral += gain * H * error
        late.append(integral + 0.015 * gain * error)
        feeds.append(loop.run(np.array([late.pop(0)]))[0])
    closed = control.feedback(control.ss(sampled_loop(gain, 2, delays)), 1)
    t = H * np.arange(251)
    expected = FEED * (0.5 + control.forced_response(closed, t, np.full(251, 0.05)).outputs[1:])
    assert np.abs(np.array(feeds) - expected).max() < SOLVED


# ------------------------------------------------------------------------------------- effect, parity


def test_extra_lag_is_a_dead_time_and_nothing_at_zero() -> None:
    ratios = np.where(np.arange(100) < 50, 1.0, 0.3)
    assert np.abs(Loop(extra_lag=0.006).run(ratios) - Loop(dead_time=0.006).run(ratios)).max() == EXACT
    assert np.abs(Loop(extra_lag=0.006).run(ratios) - Loop().run(ratios)).max() > 1e-3
    assert {v.name for v in MODEL.variables if v.effect} == {"extra_lag"}


def test_extra_lag_of_one_step_makes_2_mm_unstable() -> None:
    assert damping(DESIGN * 2**1.8, 2, 3) < 0.0 < damping(DESIGN * 2**1.8, 2, 2)


@pytest.mark.parametrize(
    "parameters", [{}, {"candidate": 1}, {"candidate": 3, "dead_time": DEAD_TIME, "feed_rate": 2.0, "extra_lag": 0.003}]
)
def test_plain_and_compiled_are_the_same_bits(parameters: dict[str, Any]) -> None:
    plain, compiled = Loop(**parameters), Loop(compiled=True, **parameters)
    for k in range(100):
        ratio = np.array([0.5 + 0.5 * math.sin(0.3 * k)])
        assert plain.run(ratio) == compiled.run(ratio)
        assert plain.data.tobytes() == compiled.data.tobytes(), f"step {k}"


def test_init_holds_the_steady_state() -> None:
    for candidate in CANDIDATES:
        loop = Loop(ratio=0.8, candidate=candidate)
        assert np.abs(loop.run(np.full(50, 0.8)) - 0.8 * FEED).max() < ROUNDOFF
    assert SPEED_LOOP.nominal_feed == FEED


# --------------------------------------------------------------------------------------------- errors


def message(step: bool = False, h: float = H, **values: Any) -> str:
    data = MODEL.new()
    for name, value in values.items():
        data[name] = value
    s = record(data)
    status = MODEL.init(s)
    if step and status == 0:
        status = MODEL.step(s, 0.0, h)
    assert status != 0
    return MODEL.message(status, s, 0.0)


def test_errors_say_what_is_wrong() -> None:
    assert "speed_ratio is nan at t = 0.0 s; expected a finite number, 0 to 1.5; check the rate controller" in message(speed_ratio=math.nan)
    text = "dead_time 0.4 s and extra_lag 0.2 s are longer together than the queue of 128 steps of sample_time = 0.004 s; shorten them"
    assert text in message(dead_time=0.4, extra_lag=0.2)
    assert QUEUE - 2 == 128
    assert "the step size is 0.001 s at t = 0.0 s; expected sample_time = 0.004 s" in message(step=True, h=0.001)
