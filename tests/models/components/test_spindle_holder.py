"""spindle_holder: bridges, measurement matrix, dead channels, and the accuracy that paper 001 found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from robomill.models.components.sensor_chain import CONFERENCE_MATRIX
from robomill.models.components.sensor_chain import MODEL as SENSOR_CHAIN
from robomill.models.components.spindle_holder import BRIDGES, HOLDER, MODEL
from robomill.models.model.declaration import record
from robomill.models.model.parameters import DATA, load
from tests.tolerances import EXACT, ROUNDOFF, chance, of_variance, physics

H = 0.002
SCALE = 1e3
"""N: size of the numbers that are added and cancelled; ROUNDOFF is relative to it, the matrix in its file to 15 digits."""
DIGITS = 100 * ROUNDOFF * SCALE
POSE = np.deg2rad([10.0, -80.0, 85.0, 15.0, 20.0, -30.0])
FORCE, MOMENT = np.array([120.0, -300.0, 80.0]), np.array([2.0, -1.0, 3.0])
QUIET = {"amplifier_noise": 0.0, "resolution": 0.0}
MV = 1e-3
"""mV/V."""
EFFECTS = {
    "bridge_gain_error": [0.02, -0.03, 0.05, 0.01, 0.04, -0.05],
    "temperature_zero": [2e-7, -1e-7, 3e-7, 1e-7, -2e-7, 4e-7],
    "noise_error": 0.5,
    "cross_talk": 0.02,
    "dead_channel": [0.0, 0.3, 0.0, 0.0, 0.0, 0.0],
    "attack_point": [0.01, 0.002, -0.003],
}


class Holder:
    """One instance, with parameters set and initialised under a constant load."""

    def __init__(self, compiled: bool = False, force: Any = 0.0, moment: Any = 0.0, q: Any = POSE, **parameters: Any) -> None:
        self.data = MODEL.new()
        self.s = record(self.data)
        self.init, self.step = MODEL.compiled() if compiled else MODEL.plain()
        for name, value in {"sample_time": H, "filter_window": 5, **parameters}.items():
            self.data[name] = value
        self.put(force, moment, q)
        self.k = 0
        self.status = self.init(self.s)

    def put(self, force: Any = 0.0, moment: Any = 0.0, q: Any = POSE) -> None:
        """Set the inputs: force N, moment N m in B, axis angles rad."""
        self.data["f_T_B"], self.data["m_T_B"], self.data["q"] = force, moment, q

    def put_in_tool(self, force: Any, moment: Any = (0.0, 0.0, 0.0)) -> None:
        """Set force and moment in the axes of the tool, after `init`."""
        self.data["f_T_B"], self.data["m_T_B"] = self.R_BT @ np.asarray(force), self.R_BT @ np.asarray(moment)

    def run(self, steps: int) -> np.ndarray:
        """f_T_T, f_S_raw and bridges after each of some steps [steps, 12]."""
        rows = np.zeros((steps, 12))
        for row in rows:
            assert self.step(self.s, self.k * H, H) == 0, self.message(1)
            self.k += 1
            row[:] = [*self.s.f_T_T, *self.s.f_S_raw, *self.s.bridge]
        return rows

    def message(self, status: int) -> str:
        return MODEL.message(status, self.s, self.k * H)

    @property
    def R_BT(self) -> np.ndarray:
        """Orientation of the tool in B."""
        return np.array(self.s.link_R[6])


def poses(n: int, seed: int = 0) -> np.ndarray:
    low, high = np.array([-1.0, -2.0, 0.5, -3.0, -2.0, -3.0]), np.array([1.0, -1.0, 2.0, 3.0, 2.0, 3.0])
    return np.random.default_rng(seed).uniform(low, high, (n, 6))


class TestNominal:
    def test_ports_are_those_of_sensor_chain_and_more(self) -> None:
        mine = {(v.name, v.causality, v.unit, v.shape) for v in MODEL.variables}
        assert {(v.name, v.causality, v.unit, v.shape) for v in SENSOR_CHAIN.variables if v.causality in ("input", "output")} <= mine

    def test_the_force_comes_back_as_it_went_in(self) -> None:
        """Statically, in 100 poses: weight of the spindle removed, f_T_T = R_BT^T f_T_B; the holder shows no moment."""
        for q, f in zip(poses(100), np.random.default_rng(1).uniform(-500.0, 500.0, (100, 3)), strict=True):
            holder = Holder(force=f, q=q, **QUIET)
            assert np.abs(holder.s.f_T_T - holder.R_BT.T @ f).max() < DIGITS
            assert np.abs(holder.s.m_T_T).max() == EXACT
            assert abs(holder.s.parity) < ROUNDOFF

    def test_bridge_of_300_n(self) -> None:
        """FACTS10 10.6: 0.100 mV/V lateral, 0.024 mV/V axial at the best gauge; by hand 2.05/4 (2 + 0.6) 0.25e-6 300 = 1.0e-4."""
        weightless = {**QUIET, "spindle_mass": 0.0, "spindle_weight_B": 0.0}
        best = []
        for along in ([0.0, 0.0, -300.0], [300.0, 0.0, 0.0]):
            holder = Holder(**weightless)
            holder.put_in_tool(along)
            holder.run(1)
            best.append(np.abs(holder.s.bridge).max() / MV)
        assert np.abs(np.array(best) - [0.0999375, 0.02398500]).max() < physics(0.0, absolute=1e-9)

    def test_the_matrix_on_file_is_the_pseudo_inverse_of_the_strains_on_file(self) -> None:
        found = HOLDER.measurement_matrix @ HOLDER.bridge_force
        assert np.abs(found - np.eye(3)).max() < 100 * ROUNDOFF
        assert np.abs(HOLDER.measurement_matrix - np.linalg.pinv(HOLDER.bridge_force)).max() < 1e-8  # N per V/V, of 4e6

    def test_axes_of_the_holder(self) -> None:
        """z_H = x_T out of the spindle, y_H = y_T, x_H = -z_T."""
        holder = Holder(**QUIET, spindle_mass=0.0, spindle_weight_B=0.0)
        holder.put_in_tool([1.0, 2.0, 3.0])
        assert np.abs(holder.run(1)[0, 3:6] - [-3.0, 2.0, 1.0]).max() < DIGITS

    def test_filters_against_scipy(self) -> None:
        """Low-pass with the coefficients in the record, then the mean of five: those of sensor_chain."""
        holder = Holder(**QUIET, filter_cutoff=20.0)
        start = holder.s.f_T_T.copy()
        holder.put_in_tool([0.0, 100.0, 0.0])
        rows = holder.run(60)
        expected = lfilter(holder.s.filter_b, [1.0, *holder.s.filter_a], np.full(60, 100.0))
        expected = lfilter(np.full(5, 0.2), [1.0], expected)
        assert np.abs(start).max() < DIGITS
        assert np.abs(rows[:, 1] - expected).max() < DIGITS

    def test_noise_gain(self) -> None:
        """FACTS10 10.6: 2 uV/V rms give +-6.2, 9.2, 27.3 N (2 sigma) at the holder, feed, radial and axial."""
        holder = Holder(compiled=True, resolution=0.0)
        n = 4000
        sd = np.std(holder.run(n)[:, 3:6], axis=0)
        assert np.abs(sd / (0.5 * np.array([6.2, 9.2, 27.3])) - 1.0).max() < physics(0.0, absolute=0.02) + chance(0.5 * of_variance(n))

    def test_steps_of_the_reading(self) -> None:
        holder = Holder(amplifier_noise=0.0, resolution=1e-5)
        rows = holder.run(3)[:, 6:] / 1e-5
        assert np.abs(rows - np.round(rows)).max() < ROUNDOFF * SCALE

    def test_the_moment_of_a_force_beside_the_point_is_felt(self) -> None:
        """A force 10 mm further out, given as a moment about T, is read 10/120 too large; FACTS10 10.6: 8 % for 10 mm."""
        holder = Holder(**QUIET)
        holder.put_in_tool([0.0, 120.0, 0.0], np.cross([0.01, 0.0, 0.0], [0.0, 120.0, 0.0]))
        holder.run(200)
        assert np.abs(holder.s.f_T_T - [0.0, 130.0, 0.0]).max() < physics(0.0, absolute=1e-3)  # the filters settle to 1e-5

    @pytest.mark.parametrize("compiled", [True])
    def test_plain_and_compiled_agree_bit_for_bit(self, compiled: bool) -> None:
        one, other = Holder(force=FORCE, moment=MOMENT, **EFFECTS), Holder(compiled, force=FORCE, moment=MOMENT, **EFFECTS)
        assert np.array_equal(one.run(100), other.run(100))


class TestOverload:
    def test_a_force_beyond_its_range_is_shown_as_the_range(self) -> None:
        """Paper 001, sec. 3: cutting forces of up to 1000 N."""
        for force, overload in ((990.0, 0), (1010.0, 1)):
            holder = Holder(**QUIET)
            holder.put_in_tool([0.0, force, 0.0])
            holder.run(300)
            assert holder.s.overload == overload
            assert abs(holder.s.f_T_T[1] - min(force, 1000.0)) < physics(0.0, absolute=1e-3)
            assert holder.s.fault == 0

    def test_a_bridge_beyond_its_range(self) -> None:
        holder = Holder(**QUIET, bridge_range=5e-5)
        holder.put_in_tool([0.0, 0.0, 300.0])
        holder.run(1)
        assert holder.s.overload == 1
        assert np.abs(holder.s.bridge).max() == 5e-5


class TestDeadChannel:
    @pytest.mark.parametrize("channel", range(BRIDGES))
    def test_is_found_and_the_force_goes_to_zero(self, channel: int) -> None:
        """With noise, 300 N in the direction that the bridge feels most: found after 20 ms, out within 200 ms more."""
        dead = np.zeros(BRIDGES)
        dead[channel] = 1.0
        force = 300.0 * HOLDER.strain_force[channel] / np.linalg.norm(HOLDER.strain_force[channel])
        holder = Holder(dead_channel=dead)
        holder.put_in_tool([force[2], force[1], -force[0]])
        holder.run(9)
        assert holder.s.fault == 0
        holder.run(1)
        assert holder.s.fault == channel + 1
        holder.run(100)
        assert np.abs(holder.s.f_T_T).max() == EXACT
        assert holder.s.trust == EXACT

    def test_reports_only(self) -> None:
        holder = Holder(dead_channel=[1.0, 0, 0, 0, 0, 0], fault_response=0)
        holder.put_in_tool([0.0, 0.0, 300.0])
        holder.run(200)
        assert holder.s.fault == 1
        assert holder.s.trust == 1.0
        assert abs(holder.s.f_T_T[2]) > 100.0

    def test_stops_with_one_clear_error(self) -> None:
        holder = Holder(dead_channel=[0, 0, 0, 0, 1.0, 0], fault_response=2, **QUIET, spindle_mass=0.0, spindle_weight_B=0.0)
        holder.put_in_tool([0.0, 0.0, 300.0])
        holder.run(9)
        status = holder.step(holder.s, 9 * H, H)
        assert (
            holder.message(status)
            == "spindle_holder: bridge 5 contradicts the others at t = 0.018 s: parity 6.16269e-05 V/V, limit 2e-05 V/V; check its wiring "
            "and gauges, or set fault_response = 1 to go on without force measurement"
        )

    def test_a_short_contradiction_is_none(self) -> None:
        holder = Holder(**QUIET)
        holder.put_in_tool([0.0, 0.0, 300.0])
        for _ in range(5):
            holder.data["dead_channel"] = [1.0, 0, 0, 0, 0, 0]
            holder.run(9)
            holder.data["dead_channel"] = 0.0
            holder.run(1)
        assert holder.s.fault == 0

    def test_healthy_bridges_are_left_alone(self) -> None:
        """10 s with the noise of the data sheet, 500 N, gain errors of 2 % and cross-talk of 1 %."""
        holder = Holder(compiled=True, bridge_gain_error=[0.02, -0.02, 0.02, -0.02, 0.02, -0.02], cross_talk=0.01)
        holder.put_in_tool([0.0, 300.0, 400.0])
        holder.run(5000)
        assert holder.s.fault == 0


class TestEffects:
    @pytest.mark.parametrize("effect", EFFECTS)
    def test_each_is_there_and_off(self, effect: str) -> None:
        variable = MODEL.variable(effect)
        assert variable.effect
        assert np.all(variable.start_values == 0.0)
        with_it = Holder(force=FORCE, **{effect: EFFECTS[effect]}).run(3)
        assert np.abs(with_it[:, 6:] - Holder(force=FORCE).run(3)[:, 6:]).max() > 1e-7

    def test_bridge_gain_error(self) -> None:
        gain = np.array(EFFECTS["bridge_gain_error"])
        nominal, other = Holder(force=FORCE, **QUIET), Holder(force=FORCE, **QUIET, bridge_gain_error=gain)
        assert np.abs(other.s.bridge - (1.0 + gain) * nominal.s.bridge).max() < ROUNDOFF
        assert np.abs(other.s.f_S_raw - HOLDER.measurement_matrix @ other.s.bridge).max() < DIGITS

    def test_temperature_zero(self) -> None:
        """10 K with 1200 s, 600 s after taring: 10 (1 - exp(-1/2)) K; the axial force suffers most (FACTS10 10.6)."""
        drift = np.array(EFFECTS["temperature_zero"])
        values = {**QUIET, "zero_age": 600.0}
        nominal, other = Holder(**values), Holder(**values, temperature_zero=drift)
        assert np.abs(other.s.bridge - nominal.s.bridge - 10.0 * (1.0 - np.exp(-0.5)) * drift).max() < ROUNDOFF
        common = Holder(**values, temperature_zero=2e-7)
        wrong = np.abs(common.s.f_S_raw - nominal.s.f_S_raw)
        assert wrong[2] > 2.5 * wrong[:2].max()

    def test_noise_error(self) -> None:
        n = 2000
        plain = np.std(Holder(compiled=True, resolution=0.0).run(n)[:, 6:], axis=0)
        more = np.std(Holder(compiled=True, resolution=0.0, noise_error=0.5).run(n)[:, 6:], axis=0)
        assert np.abs(more / plain - 1.5).max() < ROUNDOFF * SCALE  # the same random numbers, larger

    def test_cross_talk(self) -> None:
        nominal, other = Holder(force=FORCE, **QUIET), Holder(force=FORCE, **QUIET, cross_talk=0.02)
        expected = (np.eye(6) + 0.02 * CONFERENCE_MATRIX) @ nominal.s.bridge
        assert np.abs(other.s.bridge - expected).max() < ROUNDOFF

    def test_dead_channel(self) -> None:
        nominal, other = Holder(force=FORCE, **QUIET), Holder(force=FORCE, **QUIET, dead_channel=[0, 0.4, 0, 0, 1.0, 0])
        assert np.abs(other.s.bridge - np.array([1, 0.6, 1, 1, 0, 1]) * nominal.s.bridge).max() < ROUNDOFF

    def test_attack_point_along_the_tool(self) -> None:
        """A tool 10 mm longer than calibrated: lateral force 10/120 too large, axial force right."""
        holder = Holder(**QUIET, attack_point=[0.01, 0.0, 0.0])
        holder.put_in_tool([50.0, 120.0, -60.0])
        holder.run(300)
        assert np.abs(holder.s.f_T_T - [50.0, 130.0, -65.0]).max() < physics(0.0, absolute=1e-3)

    def test_attack_point_across_the_tool(self) -> None:
        """An axial force of 60 N 12 mm off the axis along y of T bends like a lateral one of 6 N."""
        holder = Holder(**QUIET, attack_point=[0.0, 0.012, 0.0])
        holder.put_in_tool([60.0, 0.0, 0.0])
        holder.run(300)
        assert np.abs(holder.s.f_T_T - [60.0, -6.0, 0.0]).max() < physics(0.0, absolute=1e-3)

    def test_the_weight_follows_the_pose_with_another_centre_of_gravity(self) -> None:
        """Truth and model apart: 2 kg that nobody knows of show as their weight, axially."""
        down = np.deg2rad([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
        holder = Holder(q=down, **QUIET, spindle_mass=32.0, spindle_cog=0.0, spindle_weight_cog=0.0)
        assert abs(holder.R_BT[2, 0] + 1.0) < ROUNDOFF  # tool axis down
        assert np.abs(holder.s.f_T_T - [2.0 * 9.81, 0.0, 0.0]).max() < DIGITS


class TestErrors:
    @pytest.mark.parametrize(
        ("values", "text"),
        [
            ({"filter_cutoff": 300.0}, "the low-pass cannot have its cut-off at 300 Hz when sampled every 0.002 s"),
            ({"filter_window": 0}, "filter_window is 0, expected 1 to 250 samples"),
            ({"measurement_matrix": 0.0}, "measurement_matrix is singular: its three rows do not tell three forces apart"),
            ({"measurement_matrix": np.ones((3, 6))}, "measurement_matrix is singular"),
            ({"fault_response": 3}, "fault_response is 3, expected 0 (report), 1 (the force goes to zero) or 2 (error)"),
            ({"lever": 0.0}, "lever is 0.0 m, expected a positive distance"),
        ],
    )
    def test_bad_parameters(self, values: dict[str, Any], text: str) -> None:
        holder = Holder(**values)
        assert holder.status > 0
        assert text in holder.message(holder.status)

    def test_two_rows_that_say_the_same(self) -> None:
        twice = HOLDER.measurement_matrix.copy()
        twice[2] = twice[1] + 2.0 * twice[0]
        holder = Holder(measurement_matrix=twice)
        assert "measurement_matrix is singular" in holder.message(holder.status)

    @pytest.mark.parametrize(("name", "place"), [("f_T_B", 1), ("m_T_B", 0), ("q", 5)])
    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_inputs_that_are_no_numbers(self, name: str, place: int, value: float) -> None:
        holder = Holder()
        holder.data[name][0, place] = value
        status = holder.step(holder.s, 0.0, H)
        assert "expected finite numbers below 1e7; check the component that feeds it" in holder.message(status)

    def test_another_step(self) -> None:
        holder = Holder()
        assert "the step size is 0.004 s at t = 0 s" in holder.message(holder.step(holder.s, 0.0, 0.004))

    def test_a_file_with_arrays_of_another_shape(self) -> None:
        text = (DATA / "sensors" / "spindle_holder.toml").read_text(encoding="utf-8")
        assert "value = [1000.0, 1000.0, 1000.0]" in text
        with pytest.raises(ValueError, match=r"force_range has shape \(2,\), expected \(3,\)"):
            _loaded(text.replace("value = [1000.0, 1000.0, 1000.0]", "value = [1000.0, 1000.0]"))


def _loaded(text: str) -> Any:
    import tempfile
    from pathlib import Path

    from robomill.models.components.spindle_holder import SpindleHolder

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "holder.toml"
        file.write_text(text, encoding="utf-8")
        return load(SpindleHolder, file)
