"""Calibrated numbers that an answer needs farther off than their tolerances say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.diagnosis.candidates import Address, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.outcome.calibration import Pulled, farthest, pulled
from robomill.diagnosis.outcome.verdict import IDENTIFIED
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import SYSTEM, WELL, catalogue, measure, resolve
from tests.diagnosis.formula import Calculated, candidate

T = np.arange(600)
DOES = {("a", "first"): np.sin(0.11 * T), ("a", "number"): np.sin(0.19 * T), ("a", "other"): np.cos(0.31 * T)}


def made(number: float) -> tuple[Search, Fit]:
    """A machine with an effect of 3, whose number (4 kg, known to 0.5 kg) is off by so many deviations; another one is right."""

    def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
        return np.asarray(sum((v * DOES[a] for a, v in values.items()), np.zeros(len(T))))[:, None]

    rng = np.random.default_rng(1)
    clean = formula(0, {("a", "first"): 3.0, ("a", "number"): 0.5 * number})
    groups = [[clean + 0.02 * rng.normal(size=clean.shape) for _ in range(4)]]
    nuisances = [Nuisance(("a", "number"), 0.5, 4.0, unit="kg"), Nuisance(("a", "other"), 0.5, 1.0)]
    search = Search(Catalogue(Path("made up"), (candidate("first"),)), Simulator(Calculated(formula, len(T))), groups, nuisances)
    return search, max(search.run(), key=lambda f: f.log_evidence)


def test_a_number_that_is_far_off_is_said_with_its_value() -> None:
    for sign, way in ((-1.0, "below"), (1.0, "above")):
        search, best = made(5.0 * sign)
        assert [c.effect for c in best.model] == ["first"]
        (found,) = pulled(search, best, 0.02)
        assert (found.component, found.parameter, found.given, found.unit) == ("a", "number", 4.0, "kg")
        assert found.deviations == pytest.approx(5.0 * sign, rel=WELL)
        assert found.value == pytest.approx(4.0 + 2.5 * sign, rel=WELL)
        value = f"{found.value:.4g}"
        assert found.text == f"a.number is 5.0 times its tolerance {way} what is given: about {value} kg, not 4 kg"


def test_the_farthest_is_said_however_far_it_is() -> None:
    search, best = made(0.5)
    found = farthest(search, best)
    assert found is not None
    assert found.deviations == pytest.approx(0.5, rel=WELL)
    search.nuisances = []
    assert farthest(search, best) is None


@pytest.mark.parametrize(("false_alarm", "said"), [(0.02, False), (0.04, True)])
def test_what_is_far_depends_on_the_false_alarm_rate_and_on_how_many_there_are(false_alarm: float, said: bool) -> None:
    """Two numbers may be 2.58 deviations off at 2 %, 2.33 at 4 %; one may be 2.33 at 2 %."""
    search, best = made(2.45)
    assert bool(pulled(search, best, false_alarm)) is said
    search.nuisances = search.nuisances[:1]
    assert pulled(search, best, 0.02)


def test_a_damping_that_is_six_tolerances_off_is_a_number_of_the_model_beside_the_effect_that_is_there(tmp_path: Path) -> None:
    """2 N.s/m, known to 1 %."""
    for off, said in ((6.0, True), (0.5, False)):
        damping = 2.0 * (1.0 + 0.01 * off)
        runs = measure({"masses": {"damping": damping}, "sensors": {"gain_error[1]": 0.04}})
        answer = diagnose(SYSTEM, runs, catalogue(tmp_path), resolver=resolve).answer
        assert answer.which[0].effect == "gain"
        assert answer.which[0].probability > IDENTIFIED
        assert answer.calibrated == ()
        assert (answer.verdict, answer.number is not None) == (("unknown", True) if said else ("identified", False))
        if answer.number is not None:
            _, low, high = answer.number.becomes
            assert (answer.number.name, answer.number.beside) == ("masses.damping", ("gain @ sensor 1",))
            assert low < damping < high


@pytest.mark.parametrize(
    ("off", "said"),
    [
        (-5.0, "; it cannot be below 3 kg, so something else is wrong"),
        (5.0, "; it cannot be above 6 kg, so something else is wrong"),
        (2.0, "not 4 kg"),
    ],
)
def test_a_number_beyond_what_its_parameter_can_be_says_so(off: float, said: str) -> None:
    search, best = made(off)
    search.nuisances = [replace(search.nuisances[0], allowed=(3.0, 6.0)), *search.nuisances[1:]]
    found = farthest(search, best)
    assert found is not None
    assert found.text.endswith(said)


def test_numbers_that_differ_little_are_told_apart() -> None:
    near = Pulled("scale", "pitch", 0.0016, 0.00160004, 1.5, "m/rad")
    assert near.text == "scale.pitch is 1.5 times its tolerance above what is given: about 0.00160004 m/rad, not 0.0016 m/rad"
