"""Noise of machines that were measured once: what the best model leaves, not what the measured signal does."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from robomill import report
from robomill.diagnose_command import lines
from robomill.diagnosis.candidates import Address
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.intervals import Known, Problem
from robomill.diagnosis.inference.noise import fast, whitening
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.outcome import conclusion
from robomill.orchestration.runs.run import Run
from tests.diagnosis.axis import NOISE, catalogue, measure, resolve, system
from tests.tolerances import chance, of_variance

THREE = {"coulomb": 5.0, "viscous": 0.1, "inertia_error": 0.01}


@pytest.mark.parametrize("seed", [1, 2])
def test_three_terms_of_friction_and_inertia_are_found_in_one_run(tmp_path: Path, seed: int) -> None:
    """Coulomb friction jumps. Taken for noise, the jumps hide the two small terms, and close more than there is."""
    found = diagnose(system(), measure(THREE, seed=seed), catalogue(tmp_path), resolver=resolve)
    result = found.result
    assert result["verdict"] == "identified"
    values = {name: p for w in result["which"] if w["probability"] > 0.8 for name, p in w["parameters"].items()}
    assert values.keys() == THREE.keys()
    assert [w["location"] for w in result["where"]] == ["axis"]  # once, whatever the number of effects there
    for name, truth in THREE.items():
        low, high = values[name]["interval"]
        assert low < truth < high
    (torque,) = (h for h in result["how_far"] if h["channel"] == "drive.torque")
    # the standard deviation of the noise is known from a thousand samples
    assert torque["floor"] == pytest.approx(NOISE["drive.torque"], rel=chance(0.5 * of_variance(1000)))
    assert 0.99 < torque["closure"] <= 1.0


@pytest.mark.parametrize("part", [0.9, 1.0])
def test_an_effect_that_goes_to_its_bound_with_all_of_the_catalogue_beside_it_is_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: float
) -> None:
    def free(search: Search, fit: Fit) -> dict[str, Known]:
        return {c.name: Known(dict.fromkeys(c.addresses, part * c.maximum), dict.fromkeys(c.addresses, 0.1), 0.5) for c in fit.model}

    monkeypatch.setattr(conclusion, "by_least_squares", free)
    found = diagnose(system(), measure(THREE), catalogue(tmp_path), resolver=resolve)
    assert found.answer.verdict == ("unknown" if part == 1.0 else "identified")


@pytest.mark.parametrize("repeats", [1, 2])
def test_sets_and_values_by_least_squares_are_asked_only_where_noise_is_a_guess(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, repeats: int
) -> None:
    """Held-out repeats say what noise is: one recording is then searched as repeats are."""
    asked: list[Fit] = []
    original = Problem.of

    def of(search: Search, fit: Fit, values: Mapping[Address, float]) -> Problem | None:
        asked.append(fit)
        return original(search, fit, values)

    monkeypatch.setattr(Problem, "of", staticmethod(of))
    held = measure(THREE, repeats=repeats, seed=9)
    found = diagnose(system(), measure(THREE), catalogue(tmp_path), held_out=held, resolver=resolve)
    assert bool(asked) is (repeats == 1)
    assert found.answer.guessed is (repeats == 1)
    assert all(w.closes is None for w in found.answer.which) is (repeats == 2)


def test_the_answer_says_that_the_noise_is_a_guess(tmp_path: Path) -> None:
    for runs, guess in ((measure(THREE), True), (measure(THREE, repeats=2), False), (measure(), True)):
        found_in = catalogue(tmp_path)
        found = diagnose(system(), runs, found_in, resolver=resolve)
        sentence = report.subject.verdict_sentence(report.Subject(found, system(), runs, found_in))
        assert sentence.startswith("Nothing was repeated, so the noise is a guess: ") is guess
        assert ("the noise is a guess" in lines(found.answer)[0]) is guess


def test_the_fast_part_of_white_noise_is_as_large_as_it_and_whitens_to_it() -> None:
    noise = np.random.default_rng(1).normal(size=(20000, 2)) * [1.0, 3.0]
    slow = 50.0 * np.sin(np.arange(20000) / 2000.0)[:, None]
    assert np.std(fast(noise + slow), axis=0) == pytest.approx([1.0, 3.0], rel=chance(0.5 * of_variance(20000)))
    w = whitening([[slow]], np.zeros(2), left=[[noise + slow]])
    assert w.guessed
    assert np.abs(w.coefficients).max() < 0.03
    assert np.var(w.apply(noise)[100:]) == pytest.approx(1.0, rel=chance(of_variance(2 * 20000)))


def remembering(runs: Sequence[Run], seed: int, size: float = 3.0, seconds: float = 0.2) -> list[Run]:
    """The runs with noise that has a memory, `size` times as large as theirs, on each channel."""
    rng, made = np.random.default_rng(seed), []
    for r in runs:
        keeps = math.exp(-float(r.t[1]) / seconds)
        pushes = {c: size * math.sqrt(1.0 - keeps**2) * NOISE[c] * rng.normal(size=len(r.t)) for c in r.columns}
        made.append(replace(r, columns={c: x + lfilter([1.0], [1.0, -keeps], pushes[c]) for c, x in r.columns.items()}))
    return made


@pytest.mark.parametrize("held_out", [0, 2])
def test_noise_of_a_single_run_is_that_of_held_out_repeats(tmp_path: Path, held_out: int) -> None:
    """Slow noise, of which the fast part says little, is a gap where nothing was repeated."""
    runs = remembering(measure(repeats=1 + held_out), seed=1)
    found = diagnose(system(), runs[:1], catalogue(tmp_path), held_out=runs[1:], resolver=resolve)
    assert found.answer.guessed is (held_out == 0)
    assert (found.answer.verdict == "none") is (held_out > 0)


def test_held_out_repeats_with_an_effect_say_as_much_of_noise(tmp_path: Path) -> None:
    """A small effect may be lost beside strong ones, as with repeats; what is named is there, and its interval holds its value."""
    runs = measure(THREE, repeats=3)
    found = diagnose(system(), runs[:1], catalogue(tmp_path), held_out=runs[1:], resolver=resolve)
    assert found.answer.verdict == "identified"
    named = {name: p for w in found.answer.which if w.probability > 0.8 for name, p in w.parameters.items()}
    assert {"coulomb", "inertia_error"} <= named.keys() <= THREE.keys()
    assert all(p.interval[0] < THREE[name] < p.interval[1] for name, p in named.items())
