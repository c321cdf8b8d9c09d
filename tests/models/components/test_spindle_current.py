"""spindle_current: the current of the spindle motor as force feedback."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robomill.models.components.spindle_current import MODEL, MOTOR
from robomill.models.model.declaration import FloatArray, record
from tests.tolerances import EXACT, ROUNDOFF, chance, of_mean, of_variance

H = 0.004
SPEED, TORQUE, RADIUS = 377.0, 11.25, 37.5e-3
"""The end milling test of paper 003: 3600 rpm, 300 N at the edges of a D75 cutter."""
SILENT = {"noise": 0.0, "resolution": 0.0}


class Signal:
    """One instance with its inputs."""

    def __init__(self, compiled: bool = False, torque: float = 0.0, speed: float = SPEED, **parameters: Any) -> None:
        self.data = MODEL.new()
        self.s = record(self.data)
        self.init, self.step = MODEL.compiled() if compiled else MODEL.plain()
        for name, value in parameters.items():
            self.data[name] = value
        self.put(torque, speed)
        self.k = 0
        self.status = int(self.init(self.s))

    def put(self, torque: float, speed: float = SPEED) -> None:
        self.data["spindle_torque"], self.data["spindle_speed"] = torque, speed

    def advance(self, steps: int = 1) -> FloatArray:
        """Current [A] and force [N] of so many steps (steps, 2)."""
        out = []
        for _ in range(steps):
            self.k += 1
            assert self.step(self.s, (self.k - 1) * H, H) == 0
            out.append([float(self.s.current), float(self.s.force)])
        return np.array(out)


def settled(torque: float, speed: float = SPEED, **parameters: Any) -> tuple[float, float]:
    signal = Signal(torque=torque, speed=speed, **{**SILENT, **parameters})
    assert signal.status == 0
    return float(signal.s.current), float(signal.s.force)


def test_the_motor_drives_the_cut_and_its_friction():
    current, force = settled(TORQUE)
    friction = MOTOR.coulomb_friction + MOTOR.viscous_friction * SPEED
    assert current == pytest.approx((TORQUE + friction) / MOTOR.torque_constant, rel=ROUNDOFF)
    assert force == pytest.approx(TORQUE / RADIUS, rel=ROUNDOFF)
    assert force == pytest.approx(300.0, rel=ROUNDOFF)


@pytest.mark.paper
def test_a_gain_and_an_offset_make_a_force_of_the_current():
    """Paper 003, sec. 4.5: "after a linear conversion (a gain and an offset), spindle current is equivalent to machining force signal".

    Without noise the conversion is exact; with that of practice what is left is the noise times k_T / R.
    """
    torques = np.linspace(0.0, 12.0, 25)
    currents = np.array([settled(t)[0] for t in torques])
    gain, offset = np.polyfit(currents, torques / RADIUS, 1)
    assert gain * currents + offset == pytest.approx(torques / RADIUS, rel=1e2 * ROUNDOFF, abs=1e3 * ROUNDOFF)
    assert gain == pytest.approx(MOTOR.torque_constant / RADIUS, rel=1e2 * ROUNDOFF)
    n = 4000
    force = Signal(torque=TORQUE).advance(n)[:, 1]
    sigma = math.hypot(MOTOR.noise, MOTOR.resolution / math.sqrt(12.0)) * MOTOR.torque_constant / RADIUS
    assert float(np.mean(force)) == pytest.approx(300.0, abs=chance(sigma * of_mean(n)))
    assert float(np.var(force)) == pytest.approx(sigma**2, abs=chance(sigma**2 * of_variance(n)))


def test_a_spindle_that_stands_has_no_friction_torque():
    assert settled(0.0, 0.0) == (EXACT, EXACT)


def test_the_analog_output_lags_by_its_time_constant():
    signal = Signal(**SILENT)
    idle = float(signal.s.current)
    signal.put(TORQUE)
    n = 12
    rise = signal.advance(n)[-1, 0] - idle
    assert rise == pytest.approx((1.0 - math.exp(-n * H / MOTOR.filter_time)) * TORQUE / MOTOR.torque_constant, rel=1e2 * ROUNDOFF)


def test_a_gain_of_speed_takes_the_torque_of_the_rotor():
    signal = Signal(**SILENT, filter_time=0.0, viscous_friction=0.0)
    idle = float(signal.s.current)
    signal.put(0.0, SPEED + 4.0)
    assert signal.advance()[0, 0] - idle == pytest.approx(MOTOR.rotor_inertia * 4.0 / H / MOTOR.torque_constant, rel=1e2 * ROUNDOFF)


def test_resolution_and_range():
    current, _ = settled(TORQUE, resolution=0.5)
    assert current == round(2.0 * current) / 2.0
    assert settled(1000.0)[0] == MOTOR.range


def test_each_effect_changes_what_it_says():
    current, force = settled(TORQUE)
    assert settled(TORQUE, current_gain_error=0.1)[0] == pytest.approx(1.1 * current, rel=ROUNDOFF)
    assert settled(TORQUE, current_offset=0.5)[0] == pytest.approx(current + 0.5, rel=ROUNDOFF)
    friction = MOTOR.coulomb_friction + MOTOR.viscous_friction * SPEED
    assert settled(TORQUE, friction_error=0.5)[1] == pytest.approx(force + 0.5 * friction / RADIUS, rel=ROUNDOFF)
    assert all(v.start == 0.0 for v in MODEL.variables if v.effect)


def test_another_seed_is_another_repeat_of_the_same_run():
    first, again, other = (Signal(torque=TORQUE, seed=seed).advance(50) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_compiled_and_plain_have_the_same_bits():
    found = []
    for compiled in (False, True):
        signal = Signal(compiled, current_gain_error=0.1)
        signal.put(TORQUE, SPEED - 1.0)
        found.append(signal.advance(50))
    assert np.array_equal(found[0], found[1])


def test_errors():
    signal = Signal(cutter_radius=0.0)
    assert signal.status == 1
    assert "must be positive; correct the parameter" in MODEL.message(1, signal.s, 0.0)
    signal = Signal(torque=math.inf)
    assert signal.status == 2
    assert "spindle_torque is inf N.m" in MODEL.message(2, signal.s, 0.0)
    signal = Signal()
    assert signal.step(signal.s, 0.0, 0.0) == 3
    assert MODEL.message(3, signal.s, 0.0) == f"{MODEL.name}: the step size must be positive"
