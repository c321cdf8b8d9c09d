"""Faults of the log as models: what is believed, what is left to the search, and what they do to a simulation."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.diagnosis.experiment.observation import observe
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.gate.log_faults import FACTORS, FAHRENHEIT, ICE, TOLERANCE, judged, made_in, together, undone
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import ROUNDOFF

T = 0.01 * np.arange(1000)
SINE, COSINE, OTHER = np.sin(2.0 * np.pi * T), np.cos(2.0 * np.pi * T), np.sin(6.0 * np.pi * T)
"""Over ten whole periods: orthogonal, mean square 1/2."""
VECTOR = np.stack([SINE, 2.0 * COSINE, 0.5 * OTHER], axis=1)
NAMES = ["a.f[1]", "a.f[2]", "a.f[3]"]
ANY = [None] * len(NAMES)
"""Units that nobody knows."""


def kinds(x: FloatArray, s: FloatArray, noise: float = 1e-9) -> list[tuple[str, str]]:
    """Channel and kind of what is believed."""
    return [(f.channel, f.kind) for f in judged(x, s, NAMES[: x.shape[1]], ANY[: x.shape[1]], np.full(x.shape[1], noise))]


CENTI, MINUTES = "centimetres for metres", "per minute for per second"


class TestJudged:
    @pytest.mark.parametrize("gain", [1.0, 0.5, 1.6, -0.1, 2.2])
    def test_a_gain_is_left_to_the_search(self, gain: float) -> None:
        assert kinds(gain * VECTOR, VECTOR) == []

    @pytest.mark.parametrize("factor", list(dict.fromkeys(factor for factor, _, _ in FACTORS)))
    def test_each_usual_mistake_is_found_with_a_gain_of_a_tenth_besides(self, factor: float) -> None:
        for gain in (0.9, 1.0, 1.1):
            (finding,) = judged(gain * factor * VECTOR[:, :1], VECTOR[:, :1], NAMES[:1], ANY[:1], np.array([1e-9]))
            assert (finding.kind, finding.fatal) == ("unit", True)
            assert finding.value in {f for f, _, _ in FACTORS}  # two of them may be nearer to each other than a gain allows to tell
            assert abs(gain * factor / finding.value - 1.0) <= TOLERANCE
            assert finding.text.endswith("; give the unit that it is logged in")

    @pytest.mark.parametrize(
        ("unit", "tried"),
        [
            ("rad/s", {"degrees for radians", "rpm for rad/s"}),
            ("deg", {"degrees for radians"}),
            ("mm/s2", {"millimetres for inches", CENTI, MINUTES, "newtons (m/s2) for kilogram-force (g)"}),
            ("bar", {"pounds per square inch for bar"}),
            ("mm/s", {"millimetres for inches", CENTI, MINUTES}),
            ("l/s", {MINUTES, "litres per minute for m3/s"}),
            ("kg/s", {MINUTES}),
            ("N", {"newtons (m/s2) for kilogram-force (g)", "newtons for pound-force"}),
            ("N.m/s", {"newtons (m/s2) for kilogram-force (g)", "newtons for pound-force"}),
            ("kg", set()),
            ("V", set()),
            ("1", {"per cent for parts of one"}),
        ],
    )
    def test_a_mistake_is_one_that_can_be_made_in_the_unit_of_the_channel(self, unit: str, tried: set[str]) -> None:
        """Beside the prefixes, which are there in every unit."""
        larger = {mistake: where for factor, mistake, where in FACTORS if factor > 1.0}
        smaller = {mistake: where for factor, mistake, where in FACTORS if factor < 1.0}
        prefixes = {"milli- for units", "micro- for units"}
        assert {mistake for mistake, where in larger.items() if made_in(unit, where)} == tried | prefixes
        back = {" for ".join(mistake.split(" for ")[::-1]) for mistake, where in smaller.items() if made_in(unit, where)}
        assert back == tried | prefixes
        for unknown in (None, "furlong"):
            assert all(made_in(unknown, where) for _, _, where in FACTORS)

    def test_no_speed_is_in_pounds(self) -> None:
        """0.2344 of a simulation whose friction is too low (HSM150): in newtons that is a unit, in rad/s it is an effect."""

        def found(unit: str) -> list[str]:
            s = VECTOR[:, :1]
            return [f.text for f in judged(0.2344 * s, s, NAMES[:1], [unit], np.array([1e-9]))]

        assert found("rad/s") == []
        assert found("N") == ["is 0.2248 times what it should be (pound-force for newtons); give the unit that it is logged in"]
        logged = 0.2344 * VECTOR
        faults = judged(logged, VECTOR, NAMES, ["N"] * 3, np.full(3, 1e-9))
        np.testing.assert_array_equal(undone(faults, logged, VECTOR, NAMES, ["rad/s"] * 3), logged)

    @pytest.mark.parametrize("factor", [85.6, 41.2, 19.8, 13.6, 7.96, 5.31])
    def test_an_effect_that_makes_a_small_signal_large_by_another_factor_is_no_unit(self, factor: float) -> None:
        """TOLERANCE: a weight on the sensor where the simulation has hardly a moment; none of the usual factors is so near."""
        assert judged(factor * VECTOR[:, :1], VECTOR[:, :1], NAMES[:1], ["N.m"], np.array([1e-9])) == []

    def test_the_text_names_the_mistake_that_is_nearest(self) -> None:
        (finding,) = judged(1.05e-3 * VECTOR[:, :1], VECTOR[:, :1], NAMES[:1], ANY[:1], np.array([1e-9]))
        assert finding.text == "is 0.001 times what it should be (units for milli-); give the unit that it is logged in"

    @pytest.mark.parametrize("factor", list(dict.fromkeys(factor for factor, _, _ in FACTORS)))
    def test_a_unit_of_a_whole_array_is_found(self, factor: float) -> None:
        even = np.stack([SINE, COSINE, OTHER], axis=1)
        assert sorted(kinds(factor * even, even)) == [(name, "unit") for name in NAMES]

    @pytest.mark.parametrize(("part", "found"), [(1.0, True), (1e-3, False)])
    def test_an_element_that_hardly_moves_beside_its_array_has_neither_unit_nor_sign(self, part: float, found: bool) -> None:
        """A thousandth of the others: a pose that is off by three degrees makes it 57 times as large, or turns its sign."""
        s = VECTOR * [1.0, 1.0, part]
        for factor, kind in ((180.0 / np.pi, "unit"), (-1.0, "sign")):
            assert kinds(s * [1.0, 1.0, factor], s) == [(NAMES[2], kind)] * found

    @pytest.mark.parametrize("i", [0, 1, 2])
    def test_a_wrong_sign_is_found_with_an_effect_besides(self, i: int) -> None:
        x = 0.8 * VECTOR + 0.1 * np.cos(10.0 * np.pi * T)[:, None]
        x[:, i] *= -1.0
        assert kinds(x, VECTOR) == [(NAMES[i], "sign")]

    def test_what_is_much_larger_than_the_simulation_has_no_sign(self) -> None:
        """An effect ten times as large as the nominal signal, of whatever sign: more than noise and tolerances is left either way."""
        assert kinds(-4.0 * SINE[:, None] + 10.0 * COSINE[:, None], SINE[:, None]) == []

    @pytest.mark.parametrize(("noise", "found"), [(0.05, [(NAMES[0], "sign")]), (1.0, [])])
    def test_what_drowns_in_noise_has_no_sign(self, noise: float, found: list[tuple[str, str]]) -> None:
        x = -SINE[:, None] + noise * np.random.default_rng(1).standard_normal((len(T), 1))
        assert kinds(x, SINE[:, None], noise) == found

    def test_interchanged_axes_are_found_whatever_their_signs_are(self) -> None:
        for signs in ((1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (-1.0, -1.0, 1.0)):
            assert kinds(VECTOR[:, [1, 0, 2]] * signs, VECTOR) == [(NAMES[0], "axes")]

    @pytest.mark.parametrize("units", [["N", "N"], ["N", "m"]])
    def test_two_scalars_that_are_interchanged_are_found(self, units: list[str]) -> None:
        s = np.stack([3.0 * SINE, COSINE], axis=1)
        told = judged(s[:, ::-1], s, ["a.warm", "b.cold"], units, np.array([0.05, 0.05]))
        assert [(f.channel, f.kind) for f in told if f.kind == "axes"] == [("a.warm", "axes")]
        assert [f for f in judged(s, s, ["a.warm", "b.cold"], units, np.array([0.05, 0.05])) if f.kind == "axes"] == []

    def test_axes_that_are_nearly_alike_are_not_interchanged(self) -> None:
        alike = np.stack([SINE + 0.05 * COSINE, SINE - 0.05 * COSINE], axis=1)
        assert kinds(alike[:, ::-1], alike) == []

    @pytest.mark.parametrize(("angle", "found"), [(6.0, []), (15.0, []), (45.0, [("a.f", "rotation")])])
    def test_a_turn_that_a_pose_may_be_off_is_left_to_the_search(self, angle: float, found: list[tuple[str, str]]) -> None:
        x = VECTOR.copy()
        observe(x, T, NAMES, "rotate_3 a.f", np.deg2rad(angle))
        assert kinds(x, VECTOR) == found

    def test_what_is_right_or_zero_is_no_fault(self) -> None:
        assert kinds(VECTOR, VECTOR) == []
        assert kinds(VECTOR, np.zeros_like(VECTOR)) == []
        assert kinds(np.zeros_like(VECTOR), np.zeros_like(VECTOR)) == []

    @pytest.mark.parametrize("late", [0.04, 0.08])
    def test_a_dead_time_of_a_sensor_is_left_to_the_search(self, late: float) -> None:
        x = VECTOR.copy()
        observe(x, T, NAMES, "lag a.f", late)
        assert kinds(x, VECTOR) == []

    def test_a_channel_that_is_wrong_anyway_is_not_judged(self) -> None:
        x = VECTOR * [-1.0, 1.0, 1.0]
        assert judged(x, VECTOR, NAMES, ANY, np.full(3, 1e-9), frozenset({0})) == []


class TestObserved:
    def seen(self, parameter: str, value: float) -> FloatArray:
        full = VECTOR.copy()
        observe(full, T, NAMES, parameter, value)
        return full

    def test_discrete_faults(self) -> None:
        assert np.array_equal(self.seen("sign a.f[2]", 1.0), VECTOR * [1.0, -1.0, 1.0])
        assert np.array_equal(self.seen("unit a.f", 1e3), 1e3 * VECTOR)
        both = [VECTOR[:, 0], VECTOR[:, 1]]
        full = np.stack(both, axis=1)
        observe(full, T, NAMES[:2], "swap a.f", 1.0)
        assert np.array_equal(full, np.stack(both[::-1], axis=1))

    @pytest.mark.parametrize("axis", [1, 2, 3])
    def test_a_turn_about_an_axis_is_a_rotation(self, axis: int) -> None:
        turned = self.seen(f"rotate_{axis} a.f", 0.3)
        assert np.linalg.norm(turned, axis=1) == pytest.approx(np.linalg.norm(VECTOR, axis=1), rel=ROUNDOFF)
        assert np.array_equal(turned[:, axis - 1], VECTOR[:, axis - 1])
        e = np.eye(3)
        k, j = axis % 3, (axis + 1) % 3
        one = e[[k]].copy()
        observe(one, T[:1], NAMES, f"rotate_{axis} a.f", 0.3)  # right-handed
        assert one[0] @ e[j] == pytest.approx(np.sin(0.3), rel=ROUNDOFF)

    def test_a_pattern_that_selects_too_many_is_refused(self) -> None:
        with pytest.raises(ValueError, match=r"'swap a\.f' of the log selects 3 channels; expected 2: give a pattern that selects these"):
            self.seen("swap a.f", 1.0)


class TestUndone:
    @pytest.mark.parametrize(
        ("kind", "matrix"),
        [
            ("sign", np.diag([-1.0, 1.0, 1.0])),
            ("unit", np.diag([1e3, 1.0, 1.0])),
            ("axes", np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])),
            ("rotation", np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])),
        ],
    )
    def test_what_is_undone_is_as_it_was(self, kind: str, matrix: FloatArray) -> None:
        true = VECTOR + 1e-3 * np.cos(10.0 * np.pi * T)[:, None]
        logged = true @ matrix
        found = judged(logged, VECTOR, NAMES, ANY, np.full(3, 1e-9))
        assert {f.kind for f in found} == {kind}
        # a turn is fitted to the simulation, of which the log is off by 1e-3; the others are exact
        np.testing.assert_allclose(undone(found, logged, VECTOR, NAMES, ANY), true, rtol=0.0, atol=1e-3 if kind == "rotation" else ROUNDOFF)

    @pytest.mark.parametrize(("mistaken", "whole"), [(2, True), (1, False)])
    def test_a_unit_of_most_of_an_array_is_that_of_what_hardly_moves_in_it(self, mistaken: int, whole: bool) -> None:
        true = VECTOR * np.array([1.0, 1.0, 1e-3])  # the gate has no finding for the last one
        logged = true * np.array([*[1e3] * mistaken, *[1.0] * (2 - mistaken), 1e3 if whole else 1.0])
        found = judged(logged, true, NAMES, ANY, np.full(3, 1e-9))
        assert {(f.channel, f.kind) for f in found} == {(name, "unit") for name in NAMES[:mistaken]}
        np.testing.assert_allclose(undone(found, logged, true, NAMES, ANY), true, rtol=ROUNDOFF, atol=ROUNDOFF)

    def test_what_has_no_fault_stays(self) -> None:
        np.testing.assert_array_equal(undone([], VECTOR, VECTOR, NAMES, ANY), VECTOR)


def test_faults_are_tried_all_together_and_array_by_array() -> None:
    """Interchanged axes of a tracker make the force look as if it had another unit: undone together nothing is explained."""
    tracker, force, moment = (Finding(name, "sign", -1.0, "1", "") for name in ("tracker.p[1]", "sensor.f[1]", "sensor.f[3]"))
    assert together([tracker, force, moment]) == [[tracker, force, moment], [tracker], [force, moment]]
    assert together([force, moment]) == [[force, moment]]
    assert together([]) == []


KELVIN = 273.15 + 40.0 + 30.0 * np.sin(0.01 * np.arange(600.0))[:, None]
"""A temperature between 10 and 70 degC [K]."""


@pytest.mark.parametrize(
    ("logged", "kind", "said"),
    [
        (273.15 + 1e3 * (KELVIN - 273.15), "unit", "is 1000 times what it should be (milli- for units)"),
        (273.15 + 1e-3 * (KELVIN - 273.15), "unit", "is 0.001 times what it should be (units for milli-)"),
        (1e3 * KELVIN, "unit", "is 1000 times what it should be (milli- for units)"),
        (273.15 - (KELVIN - 273.15), "sign", "has the wrong sign"),
        (273.15 + 1.8 * (KELVIN - 273.15) + 32.0, "unit", "is 1.8 times what it should be (degF for degC)"),
        (273.15 + (KELVIN - 273.15 - 32.0) / 1.8, "unit", "is 0.5556 times what it should be (degC for degF)"),
        (1.8 * (KELVIN - 273.15) + 32.0, "unit", "is 1.8 times what it should be (degF for K)"),
        (KELVIN - 273.15, "unit", "is 273.15 K too small (degC)"),
        (KELVIN + 273.15, "unit", "is 273.15 K too large (kelvin for degC)"),
    ],
)
def test_temperatures_have_a_zero_of_their_own(logged: FloatArray, kind: str, said: str) -> None:
    (finding,) = judged(logged, KELVIN, ["probe.shown"], ["K"], np.array([0.05]))
    assert finding.kind == kind
    assert finding.text.startswith(said)
    np.testing.assert_allclose(undone([finding], logged, KELVIN, ["probe.shown"], ["K"]), KELVIN, rtol=1e3 * ROUNDOFF)


@pytest.mark.parametrize("about", [ICE, ICE - 40.0])
def test_only_temperatures_have_another_zero(about: float) -> None:
    for factor in (-1.0, 1e3, FAHRENHEIT):
        assert judged(about + factor * (KELVIN - about), KELVIN, ["probe.shown"], ["N"], np.array([0.05])) == []


@pytest.mark.parametrize("other", [KELVIN + 5.0, 273.15 + 1.1 * (KELVIN - 273.15), 300.0 + 0.9 * (KELVIN - 300.0)])
def test_a_temperature_that_is_a_little_off_has_no_other_unit(other: FloatArray) -> None:
    assert judged(other, KELVIN, ["probe.shown"], ["K"], np.array([0.05])) == []
