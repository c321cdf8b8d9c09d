"""The search: where fits start, which models are looked at again, which are worth their effects."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from robomill.diagnosis.candidates import Address, Candidate, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.measured import sort_by_condition
from robomill.diagnosis.experiment.simulation import Laboratory, Simulator
from robomill.diagnosis.inference import fitting
from robomill.diagnosis.inference import search as search_module
from robomill.diagnosis.inference.adequacy import COHERENT, LEVEL, UNKNOWN, by_chance
from robomill.diagnosis.inference.calibrated_instead import calibrated_instead, without_effect
from robomill.diagnosis.inference.estimation import Fit, Space
from robomill.diagnosis.inference.priors import probabilities
from robomill.diagnosis.inference.search import FAULT, SUBSTANTIAL, Search, searched
from robomill.diagnosis.inference.sensitivities import Start
from robomill.diagnosis.inference.single_number import single
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from robomill.orchestration.system.definition import Component, System
from tests.diagnosis.demo import SYSTEM, WELL, Part, catalogue, changed, measure, real, resolve
from tests.diagnosis.formula import Calculated, candidate
from tests.diagnosis.inference.test_machines import Known
from tests.tolerances import ROUNDOFF, chance

GAIN, RUBBING, CLOCK = ("sensors", "gain_error[1]"), ("masses", "friction[1]"), ("logging", "lag sensors.*")


@contextmanager
def search(folder: Path, runs: Sequence[Run], clock: float = 1e-4) -> Iterator[Search]:
    """`clock`: the smallest lateness that is a finding [s]."""
    full = catalogue(folder)
    full = replace(full, candidates=tuple(replace(c, minimum=clock) if c.effect == "clock" else c for c in full.candidates))
    conditions = sort_by_condition(runs, SYSTEM)
    channels = ["sensors.y[1]", "sensors.y[2]"]
    with Simulator(Laboratory(SYSTEM, conditions, channels, resolve), 1) as simulator:
        yield Search(full, simulator, [[c.matrix(r, channels) for r in c.runs] for c in conditions], [])


def model(of: Search, *addresses: Address) -> tuple[Candidate, ...]:
    return tuple(next(c for c in of.candidates if c.addresses == (a,)) for a in addresses)


def fit(of: Search, values: Mapping[Address, float], sensitivities: FloatArray | None = None, left: float = 0.0) -> Fit:
    """At these values; what is left is noise and so many times what noise leaves."""
    chi2 = (1.0 + left) * float(of.evidence.expected.sum())
    return Fit(
        model(of, *values), dict(values), {a: 0.1 * abs(v) + 1e-6 for a, v in values.items()}, 0.0, chi2, sensitivities=sensitivities
    )


def test_an_effect_far_below_its_usual_size_is_simulated_at_sizes_in_between(tmp_path: Path) -> None:
    """Dry friction of the usual size holds a mass; a tenth of it slows it down, which is not a tenth of holding."""
    truth = {"masses": {"friction[1]": 0.005}}
    with search(tmp_path, measure(truth)) as tiny:
        assert 0.05 < tiny.starts[RUBBING].x < 0.2  # prior scales, of 0.05 N
    with search(tmp_path, measure({"masses": {"friction[1]": 0.05}})) as usual:
        assert RUBBING not in usual.starts
    result = diagnose(SYSTEM, measure(truth), catalogue(tmp_path), resolver=resolve).result
    assert (result["verdict"], result["which"][0]["location"]) == ("identified", "mass 1")
    assert result["which"][0]["parameters"]["friction[1]"]["value"] == pytest.approx(0.005, rel=WELL)


def test_what_is_left_of_a_model_when_an_effect_has_become_too_small_is_fitted_by_itself(tmp_path: Path) -> None:
    with search(tmp_path, measure({"sensors": {"gain_error[1]": 0.04}})) as s:
        sensitivities = np.stack([s.evidence.sensitivities[RUBBING], s.evidence.sensitivities[GAIN]], axis=1)
        pair = fit(s, {RUBBING: 2e-4, GAIN: 0.03}, sensitivities)
        assert not pair.large_enough()
        (found,) = s._smaller([pair], [])
        assert [c.addresses for c in found.model] == [(GAIN,)]
        assert found.values[GAIN] == pytest.approx(0.04, rel=WELL)
        assert s._smaller([pair], [found]) == []  # nothing that is known already, as good or better
        both = fit(s, {RUBBING: 2e-2, GAIN: 0.03}, sensitivities)
        assert s._smaller([both], []) == []


def test_a_model_that_could_not_be_simulated_at_any_size_is_left_out(tmp_path: Path) -> None:
    with search(tmp_path, measure({"sensors": {"gain_error[1]": 0.04}})) as s:
        never = fit(s, {GAIN: 0.03})
        ran = replace(never, signature=0.6 * s.evidence.sensitivities[GAIN], sensitivities=s.evidence.sensitivities[GAIN][:, None])
        (kept,) = s.polish([never, ran], [never, ran])
        assert kept.signature is not None


def test_a_fault_of_the_log_must_explain_most_of_what_is_left_and_an_effect_a_part(tmp_path: Path) -> None:
    with search(tmp_path, measure({"sensors": {"gain_error[1]": 0.04}})) as s:
        alone = fit(s, {GAIN: 0.04}, left=1.0)
        for partner, share in ((CLOCK, FAULT), (RUBBING, SUBSTANTIAL)):
            values = {GAIN: 0.04, partner: 0.02}
            assert s._worth(fit(s, values, left=1.0 - share - 0.01), [alone], alone)
            assert not s._worth(fit(s, values, left=1.0 - share + 0.01), [alone], alone)
        # beside a clock that is there already, an effect is asked for its part only
        late, both = fit(s, {CLOCK: 0.02}, left=1.0), fit(s, {GAIN: 0.04, CLOCK: 0.02}, left=0.9)
        assert s._worth(both, [late], alone)
        # of the clock itself two thirds are asked, unless the best base has it
        for base, worth in ((alone, False), (late, True)):
            assert s._worth(both, [alone, late], base) is worth


def test_a_fault_of_the_log_that_explains_too_little_takes_no_place_from_an_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect leaves a clock 60 % and another effect 40 % of what it leaves. The clock comes first by evidence, and last by FAULT."""
    monkeypatch.setattr(search_module, "BASES", 1)
    monkeypatch.setattr(search_module, "EXTENSIONS", 1)
    monkeypatch.setattr(search_module, "SINGLES", 1)
    t = np.arange(600)
    signals = {("a", "first"): np.sin(0.05 * t), ("a", "second"): np.sin(0.11 * t), ("logging", "lag a.*"): np.sin(0.19 * t)}

    def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
        return np.asarray(sum((v * signals[a] for a, v in values.items()), np.zeros(len(t))))[:, None]

    truth = {("a", "first"): 4.0, ("a", "second"): math.sqrt(0.4), ("logging", "lag a.*"): math.sqrt(0.6)}
    rng = np.random.default_rng(1)
    groups = [[formula(0, truth) + 0.01 * rng.normal(size=(len(t), 1)) for _ in range(4)]]
    clock = replace(candidate("lag a.*"), component="logging", effect="clock")
    entries = (candidate("first"), candidate("second"), clock)
    found = Search(Catalogue(Path("made up"), entries), Simulator(Calculated(formula, len(t))), groups, ()).run()
    best = max(found, key=lambda f: f.log_evidence)
    assert [c.effect for c in best.model] == ["first", "second", "clock"]


class Swing(Part):
    """Swings late by its delay, and the more the later."""

    def __init__(self, name: str) -> None:
        super().__init__(name, [real("delay", "parameter", "s"), real("y", "output", "m", dependencies=())])

    def advance(self, t: float, h: float) -> None:
        delay = self.p["delay"]
        self.y[0] = math.sin(60.0 * (t - delay)) * math.exp(40.0 * delay)


PART_OF_A_PERIOD = 2e-3 * 2.0 * math.pi / 60.0
"""s: the next swing that fits is a whole period away, and of the noise are left 1e-9 s: this is how well the fit is to end."""
SWING = System("swing", 0.004, (Component("swing", "swing"),), ())
DELAY = """
[[effect]]
name = "delay"
component = "swing"
description = "late"
source = "made up"
unit = "s"
minimum = 0.002
maximum = 0.19
sign = "positive"
prior = {kind = "log-normal", scale = 0.05, spread = 0.7}
locations = [{name = "swing", parameters = ["delay"]}]
"""


def test_a_delay_of_what_swings_is_found_though_it_must_be_right_to_a_part_of_the_period(tmp_path: Path) -> None:
    """The period is 105 ms: among sizes a quarter apart, the best is another swing."""
    clean = run(SWING.with_parameters("swing", {"delay": 0.1337}), None, stop=4.0, resolver=lambda *_: Swing("swing"))
    noise = np.random.default_rng(4)
    made = []
    for repeat in range(4):
        columns = {"swing.y": clean["swing.y"] + 1e-3 * noise.normal(size=len(clean.t))}
        made.append(Run(Path(f"run{repeat}"), clean.t, columns, clean.ports, {"labels": {"condition": "one", "repeat": repeat}}))
    (tmp_path / "delay.toml").write_text(DELAY)
    result = diagnose(SWING, made, Catalogue.load(tmp_path / "delay.toml"), resolver=lambda *_: Swing("swing")).result
    assert result["verdict"] == "identified"
    assert result["which"][0]["parameters"]["delay"]["value"] == pytest.approx(0.1337, abs=PART_OF_A_PERIOD)


def test_an_effect_that_a_tolerance_hides_is_looked_at_by_what_it_leaves_without_that(tmp_path: Path) -> None:
    """Sensors that are late by 6 ms, which is no finding yet: to be 2 ms late at random is a tolerance, which leaves less than a signature
    that is not quite right.
    """
    late = changed(measure(), "sensors.y[1]", lambda t, y: np.interp(t - 0.006, t, y))
    late = changed(late, "sensors.y[2]", lambda t, y: np.interp(t - 0.006, t, y))
    with search(tmp_path, late, clock=0.01) as s:
        noise, space = float(s.evidence.expected.sum()), s.evidence.space
        without = space.without([CLOCK]).chi2 / noise
        assert without > 10.0 * space.chi2 / noise  # of noise
        assert s._hidden(fit(s, {CLOCK: 0.006}, left=0.75 * without), s.nominal())
        assert not s._hidden(fit(s, {CLOCK: 0.006}, left=0.85 * without), s.nominal())
        assert not s._hidden(fit(s, {GAIN: 0.01}), s.nominal())
        gain, clock = fit(s, {GAIN: 0.01}), fit(s, {CLOCK: 0.006})
        gain.signature = 0.01 / s.scales[GAIN] * s.evidence.sensitivities[GAIN]
        clock.signature = 0.006 / s.scales[CLOCK] * s.evidence.sensitivities[CLOCK]
        assert s._hidden(fit(s, {GAIN: 0.01, CLOCK: 0.006}, left=0.05 * without), gain)
        assert not s._hidden(fit(s, {CLOCK: 0.006, GAIN: 0.01}, left=0.05 * without), clock)  # no tolerance is like a gain


def test_the_law_of_a_strong_effect_may_be_off_in_every_fit_of_it(tmp_path: Path) -> None:
    """Simulations here have no noise of their own: nothing is said again as a mean, and the form counts all the same."""
    with search(tmp_path, measure({"sensors": {"gain_error[1]": 0.04}})) as s:
        best = max(s.run(), key=lambda f: f.log_evidence)
        assert [c.addresses for c in best.model] == [(GAIN,)]
        assert best.signature is not None
        assert best.sensitivities is not None
        form = s.evidence.form(best.model, best.signature, best.sensitivities, np.array([best.values[GAIN] / 0.05]))
        assert form is not None
        assert best.form is not None
        assert best.form == pytest.approx(form, rel=WELL, abs=WELL)


class TestExplainable:
    """What all candidates together explain of what a model leaves; the catalogue has three effects, and one of them starts elsewhere."""

    N, DRAWS = 400, 200
    ENTRIES = tuple(candidate(name) for name in "abc")

    @pytest.fixture(autouse=True)
    def _all_counts(self, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
        if "a_part_counts" not in request.node.name:
            monkeypatch.setattr(search_module, "COHERENT", 1.0)

    def test_of_what_is_beyond_noise_a_part_counts(self, monkeypatch: pytest.MonkeyPatch) -> None:
        of, does, _ = self.made(0.1)
        counted = Search.explainable(of, 5.0 * does[:, 0])
        monkeypatch.setattr(search_module, "COHERENT", 1.0)
        whole = Search.explainable(of, 5.0 * does[:, 0])
        assert counted - 1.0 == pytest.approx(COHERENT * (whole - 1.0), rel=1e2 * ROUNDOFF)

    def made(self, size: float, guess: float = 1.0) -> tuple[Any, FloatArray, FloatArray]:
        """All that is asked of a search; what its candidates do, [n, 3]; the covariance of noise and nuisances."""
        rng = np.random.default_rng(7)
        does, nuisances = size * rng.normal(size=(self.N, 3)), rng.normal(size=(self.N, 2)) * [0.3, 2.0]
        does[:, 1] += does[:, 0]  # two that look alike
        sensitivities = dict(zip((a for c in self.ENTRIES for a in c.addresses), does.T, strict=True))
        (turns,) = self.ENTRIES[2].addresses
        starts = {turns: Start(0.2, 0.2 * sensitivities[turns], np.zeros(self.N))}
        sensitivities[turns] = rng.normal(size=self.N)
        space = Space(np.zeros(self.N), {"all": slice(0, self.N)}, nuisances)
        evidence = SimpleNamespace(space=space, sensitivities=sensitivities, guess=guess, dispersion=1.0)
        return Known(self.ENTRIES, evidence, starts), does, np.eye(self.N) + nuisances @ nuisances.T

    def smoother(self, does: FloatArray, covariance: FloatArray) -> FloatArray:
        """By the covariance of data that have all effects: C^-1 - (C + V V')^-1, of which the trace is that of the smoother times C^-1."""
        return np.asarray(np.linalg.inv(covariance) - np.linalg.inv(covariance + does @ does.T))

    @pytest.mark.parametrize("guess", [1.0, 3.0])
    def test_it_is_what_a_fit_with_priors_explains_over_the_trace_of_its_smoother(self, guess: float) -> None:
        of, does, covariance = self.made(0.1, guess)
        left = np.random.default_rng(1).normal(size=self.N)
        smoother = self.smoother(does, covariance)
        freedom = float(np.trace(smoother @ covariance))
        assert 1.0 < freedom < 3.0
        expected = float(left @ smoother @ left) / freedom / guess
        assert Search.explainable(of, left) == pytest.approx(expected, rel=1e4 * ROUNDOFF)

    def test_of_noise_it_is_one_and_of_less_than_one_degree_of_freedom_less(self) -> None:
        """In the mean over draws, noise and nuisances within their deviations: variance of a quadratic form x' A x is 2 tr (A C)^2."""
        for size in (0.1, 0.01):
            of, does, covariance = self.made(size)
            draws = np.linalg.cholesky(covariance) @ np.random.default_rng(2).normal(size=(self.N, self.DRAWS))
            product = self.smoother(does, covariance) @ covariance
            freedom = float(np.trace(product))
            assert (freedom > 1.0) is (size == 0.1)
            mean = float(np.mean([Search.explainable(of, x) for x in draws.T]))
            scatter = math.sqrt(2.0 * float(np.trace(product @ product)) / self.DRAWS)
            assert mean == pytest.approx(min(freedom, 1.0), abs=chance(scatter / max(freedom, 1.0)))

    @pytest.mark.parametrize("i", [0, 1, 2])
    def test_it_is_large_where_a_model_leaves_what_another_candidate_does(self, i: int) -> None:
        """Five prior scales of it beside noise, in the mean over draws: with s what it does, s' A s more."""
        of, does, covariance = self.made(0.1)
        smoother = self.smoother(does, covariance)
        draws = np.linalg.cholesky(covariance) @ np.random.default_rng(3).normal(size=(self.N, self.DRAWS))
        added = 5.0 * does[:, i]
        more = float(added @ smoother @ added) / float(np.trace(smoother @ covariance))
        assert more > 10.0
        found = [Search.explainable(of, x + added) for x in draws.T]
        product = smoother @ covariance
        variance = 2.0 * float(np.trace(product @ product)) + 4.0 * float(added @ smoother @ covariance @ smoother @ added)
        assert float(np.mean(found)) == pytest.approx(1.0 + more, abs=chance(math.sqrt(variance / self.DRAWS) / float(np.trace(product))))
        assert min(found) > UNKNOWN


class TestDispersion:
    """What is there besides an effect: none of it is in the catalogue, and it is much larger than the noise."""

    ROWS, NOISE = 600, 1e-3
    TOLERANCE_AND_FORM = 0.5
    """Relative: a tolerance and the form of the effect are in the deviation, too, and do not grow."""

    def made(self, besides: float) -> tuple[Catalogue, Simulator, list[list[FloatArray]], list[Nuisance]]:
        """A signal of ten deviations, and a slower one of `besides`; a second candidate is a little like the latter."""
        t = np.arange(self.ROWS)
        slow = np.sin(0.031 * t)
        signals = {("a", "first"): np.sin(0.11 * t), ("a", "second"): np.sin(0.19 * t) + 0.3 * slow, ("a", "number"): np.cos(0.11 * t)}

        def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
            return np.asarray(sum((v * signals[a] for a, v in values.items()), np.zeros(self.ROWS)))[:, None]

        rng = np.random.default_rng(1)
        clean = formula(0, {("a", "first"): 10.0})[:, 0] + besides * slow
        groups = [[(clean + self.NOISE * rng.normal(size=self.ROWS))[:, None] for _ in range(4)]]
        entries = (candidate("first"), candidate("second"))
        simulator = Simulator(Calculated(formula, self.ROWS))
        return Catalogue(Path("made up"), entries), simulator, groups, [Nuisance(("a", "number"), 0.01, 1.0)]

    def best(self, fits: Sequence[Fit]) -> list[str]:
        return [c.effect for c in max(fits, key=lambda f: f.log_evidence).model]

    def test_of_a_model_that_leaves_noise_there_is_none(self) -> None:
        search, fits = searched(*self.made(0.0))
        assert (search.evidence.dispersion, self.best(fits)) == (1.0, ["first"])

    def test_what_a_model_leaves_that_may_be_right_takes_part_in_every_difference(self) -> None:
        plain = Search(*self.made(1.0))
        named = plain.run()
        assert self.best(named) == ["first", "second"]  # which closes a part of it, as sure as the noise is small
        search, fits = searched(*self.made(1.0))
        assert self.best(fits) == ["first"]
        best = max(named, key=lambda f: f.log_evidence)
        assert best.signature is not None
        left = plain.evidence.level(plain.evidence.space.y - best.signature)
        assert search.evidence.dispersion == pytest.approx(left / LEVEL, rel=WELL)
        first, before = (next(f for f in some if [c.effect for c in f.model] == ["first"]) for some in (fits, named))
        wider = first.deviations["a", "first"] / before.deviations["a", "first"]
        assert wider == pytest.approx(math.sqrt(search.evidence.dispersion), rel=self.TOLERANCE_AND_FORM)

    def test_of_a_model_that_leaves_too_much_nothing_is_known(self) -> None:
        search, _ = searched(*self.made(5.0))
        assert search.evidence.dispersion == 1.0


class TestCalibrated:
    """A calibrated number, and an effect that does the same: beyond 1.2 of its deviations down, a limit bends what both do."""

    ROWS, NOISE = 600, 0.02
    T = np.arange(ROWS)
    PROPORTIONAL, BENT, OTHER = np.sin(0.11 * T), np.sin(0.19 * T), np.cos(0.05 * T)

    def made(self, number: float, second: float = 0.0) -> tuple[Catalogue, Simulator, list[list[FloatArray]], list[Nuisance]]:
        """A machine whose number is off by so many deviations; and so much of an effect that has nothing to do with that."""

        def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
            off = sum(v for a, v in values.items() if a in (("a", "number"), ("a", "first")))
            other = values.get(("a", "second"), 0.0) * self.OTHER
            return np.asarray(off * self.PROPORTIONAL + max(-off - 1.2, 0.0) * self.BENT + other)[:, None]

        rng = np.random.default_rng(1)
        clean = formula(0, {("a", "number"): number, ("a", "second"): second})
        groups = [[clean + self.NOISE * rng.normal(size=clean.shape) for _ in range(4)]]
        catalogue = Catalogue(Path("made up"), (candidate("first", scale=3.0), candidate("second")))
        return catalogue, Simulator(Calculated(formula, self.ROWS)), groups, [Nuisance(("a", "number"), 1.0, 1.0)]

    def test_what_a_number_does_within_its_tolerance_beyond_its_slope_is_no_effect(self) -> None:
        s = Search(*self.made(-2.0))
        plain, found = s.nominal(), s.run()
        best = max(found, key=lambda f: f.log_evidence)
        assert best.model == ()
        assert best.calibrated == {("a", "number"): pytest.approx(-2.0, rel=WELL)}
        # what it costs to have it there, and noise: chi2 of one degree of freedom for each
        assert best.chi2 == pytest.approx(4.0 + float(s.evidence.expected.sum()), rel=WELL)
        assert best.log_evidence == pytest.approx(0.5 * (plain.chi2 - best.chi2), rel=WELL)

    def test_a_number_that_is_farther_off_than_a_tolerance_is_an_effect(self) -> None:
        """Six deviations: one machine in 500 million."""
        s = Search(*self.made(-6.0))
        found = s.run()
        best = max(found, key=lambda f: f.log_evidence)
        assert found[0].calibrated == {}
        assert [c.effect for c in best.model] == ["first"]
        assert best.values["a", "first"] == pytest.approx(-6.0, rel=WELL)

    @pytest.mark.parametrize(("times", "moves"), [(1.0, True), (2.0, False)])
    def test_how_far_off_a_number_may_be_depends_on_the_false_alarm_rate(
        self, times: float, moves: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """One number may be 2.33 deviations off at 2 %, 2.05 at 4 %."""
        monkeypatch.setattr(fitting, "FALSE_ALARM", times * fitting.FALSE_ALARM)
        s = Search(*self.made(-2.2))
        assert bool(s.calibrate(s.nominal()).calibrated) is moves

    def test_beside_an_effect_numbers_are_those_of_the_model_that_has_it(self) -> None:
        s = Search(*self.made(-2.0, 0.5))
        assert s.calibrate(s.nominal()).calibrated == {("a", "number"): pytest.approx(-2.0, rel=WELL)}
        best = max(s.run(), key=lambda f: f.log_evidence)
        assert [c.effect for c in best.model] == ["second"]
        assert best.values["a", "second"] == pytest.approx(0.5, rel=WELL)
        assert best.calibrated == {("a", "number"): pytest.approx(-2.0, rel=WELL)}


class TestReplaced:
    """A stand-in and a helper do what a right effect does. The slope of that was taken elsewhere, and does not fit."""

    ROWS, NOISE = 600, 0.02
    T = np.arange(ROWS)
    PARTNER, ONE, TWO = np.sin(0.05 * T), np.sin(0.11 * T), np.sin(0.19 * T)

    def made(self) -> Search:
        """Partner of 4, and the right effect of 0.4: a wave of 1, and 0.4 of another one."""

        def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
            partner, wrong, helper, right = (values.get(("a", n), 0.0) for n in ("partner", "wrong", "helper", "right"))
            turned = 2.5 * right * self.ONE + 10.0 * right * (right - 0.3) * self.TWO
            return np.asarray(partner * self.PARTNER + wrong * self.ONE + helper * self.TWO + turned)[:, None]

        rng = np.random.default_rng(1)
        clean = formula(0, {("a", "partner"): 4.0, ("a", "right"): 0.4})
        groups = [[clean + self.NOISE * rng.normal(size=clean.shape) for _ in range(4)]]
        entries = tuple(candidate(n) for n in ("partner", "wrong", "helper", "right"))
        s = Search(Catalogue(Path("made up"), entries), Simulator(Calculated(formula, self.ROWS)), groups, ())
        s.starts.pop(("a", "right"), None)
        s.evidence.sensitivities["a", "right"] = s.evidence.sensitivities["a", "helper"] + 0.1 * s.evidence.sensitivities["a", "wrong"]
        return s

    def fitted(self, s: Search, **values: float) -> Fit:
        """The model with these values."""
        at = {("a", n): v for n, v in values.items()}
        found = s.fitted(model(s, *at), at, dict.fromkeys(at, 0.01))
        assert found is not None
        return found

    def test_what_is_unlikely_by_slopes_is_found_in_place_of_a_stand_in_and_what_that_needed_goes(self) -> None:
        s = self.made()
        best = self.fitted(s, partner=4.0, wrong=1.0, helper=0.4)
        right = {"partner", "right"}
        fewer = [without_effect(best, c) for c in best.model]
        by_slopes = {frozenset(c.effect for c in f.model): f.log_evidence for f in s.linear_fits(fewer)}
        assert by_slopes[frozenset(right | {"helper"})] < best.log_evidence - s.growth
        found = max(s._exchanged(best, [best]), key=lambda f: f.log_evidence)
        assert {c.effect for c in found.model} == right
        assert found.log_evidence > best.log_evidence
        assert found.values["a", "right"] == pytest.approx(0.4, rel=WELL)

    def test_a_model_that_was_fitted_twice_counts_once(self) -> None:
        s = self.made()
        one, other = self.fitted(s, partner=4.0, wrong=1.0), self.fitted(s, partner=4.0)
        again = replace(one, log_evidence=one.log_evidence + 1.0)
        nominal = s.nominal()
        assert [id(f) for f in search_module._distinct([nominal, one, other, again])] == [id(nominal), id(other), id(again)]


class TestTurned:
    """A loop whose pace an effect changes: what another one does then has another pace, too. A third one has that pace anyhow, nearly."""

    ROWS, NOISE = 400, 0.02
    T = np.arange(ROWS)
    PACE, LOAD = ("a", "pace"), ("a", "load")

    def formula(self, _: int, values: Mapping[Address, float]) -> FloatArray:
        pace, load, other = (values.get(("a", n), 0.0) for n in ("pace", "load", "other"))
        faster = (1.0 + pace) * self.T
        return np.asarray(np.sin(0.02 * faster) + load * np.sin(0.1 * faster) + other * np.sin(0.155 * self.T))[:, None]

    def made(self) -> Search:
        rng = np.random.default_rng(1)
        clean = self.formula(0, {self.PACE: 0.5, self.LOAD: 0.5})
        groups = [[clean + self.NOISE * rng.normal(size=clean.shape) for _ in range(4)]]
        entries = tuple(candidate(n) for n in ("pace", "load", "other"))
        return Search(Catalogue(Path("made up"), entries), Simulator(Calculated(self.formula, self.ROWS)), groups, ())

    def base(self, s: Search, *, rough: bool = True) -> Fit:
        """The model of the pace alone, where it was put."""
        found = s.fitted(model(s, self.PACE), {self.PACE: 0.5}, {self.PACE: 0.01})
        assert found is not None
        return found if rough else replace(found, chi2=float(s.evidence.expected.sum()))

    def test_slopes_have_turned_where_they_point_elsewhere_than_alone_and_much_is_left(self) -> None:
        s = self.made()
        assert s.turned(self.base(s))
        assert not s.turned(self.base(s, rough=False))
        assert not s.turned(s.nominal())
        straight = s.fitted(model(s, self.LOAD), {self.LOAD: 0.5}, {self.LOAD: 0.01})
        assert straight is not None
        assert s.rough(straight)
        assert not s.turned(straight)

    def test_slopes_beside_a_model_are_those_of_simulations_with_it(self) -> None:
        s = self.made()
        base = self.base(s)
        addresses, columns, gram = s.beside(base)
        base_values = {a: float(v) for a, v in base.values.items()}
        for name in ("load", "other"):
            there = [np.asarray(self.formula(0, {**base_values, ("a", name): x})) for x in (0.0, 1.0)]
            expected = s.evidence.signature([there[1]]), s.evidence.signature([there[0]])
            assert expected[0] is not None
            assert expected[1] is not None
            found = columns[:, addresses.index(("a", name))]
            assert found == pytest.approx(expected[0] - expected[1], rel=1e4 * ROUNDOFF, abs=1e4 * ROUNDOFF)
        assert gram.plain == pytest.approx(columns.T @ columns, rel=1e4 * ROUNDOFF, abs=1e2 * ROUNDOFF)

    def test_beside_it_another_effect_is_found_that_by_its_slope_alone_is_of_no_use(self) -> None:
        s = self.made()
        base = self.base(s)
        found, alone = ({frozenset(c.effect for c in f.model): f for f in s.linear_fits([base], at)} for at in (base, None))
        right, wrong = found[frozenset(("pace", "load"))], found[frozenset(("pace", "other"))]
        assert right.log_evidence > wrong.log_evidence + s.growth
        assert alone[frozenset(("pace", "load"))].log_evidence < wrong.log_evidence - s.growth
        (fitted,) = s.refine([right])
        assert fitted.values[self.LOAD] == pytest.approx(0.5, rel=WELL)
        assert fitted.values[self.PACE] == pytest.approx(0.5, rel=WELL)

    def test_the_search_looks_so_beside_one_model(self) -> None:
        s = self.made()
        base = self.base(s)
        best = max(s._exchanged(base, [base]), key=lambda f: f.log_evidence)
        assert {c.effect for c in best.model} == {"pace", "load"}
        assert not s.turned(base)  # once is enough
        assert {c.effect for c in max(self.made().run(), key=lambda f: f.log_evidence).model} == {"pace", "load"}

    def test_what_cannot_run_beside_it_keeps_the_slope_that_it_has_alone(self) -> None:
        s = self.made()
        base = self.base(s)
        plain = s.simulator.laboratory
        assert isinstance(plain, Calculated)
        formula = plain.formula
        plain.formula = lambda i, values: None if ("a", "other") in values else formula(i, values)
        addresses, columns, _ = s.beside(base)
        at = addresses.index(("a", "other"))
        assert columns[:, at] == pytest.approx(s.alone[1][:, at], rel=ROUNDOFF)


class TestVariety:
    """In how many directions effects differ, and what of one the others can do."""

    ONE, TWO, THREE = 9.0 * np.eye(5)[:3]
    RIDGE = 1e-8
    """The ridge with which correlations are inverted (1e-9), times the number of effects."""

    def of(self, *columns: FloatArray) -> tuple[float, float]:
        """What a catalogue has whose effects do this."""
        entries = tuple(candidate(f"e{k}") for k in range(len(columns)))
        n = len(columns[0])
        evidence = SimpleNamespace(
            space=Space(np.zeros(n), {"all": slice(0, n)}, np.zeros((n, 0))),
            sensitivities={c.addresses[0]: x for c, x in zip(entries, columns, strict=True)},
        )
        return Search.variety.func(Known(entries, evidence, {}))

    def test_effects_that_have_nothing_in_common_have_one_direction_each_and_twins_one_together(self) -> None:
        one, two, three = self.ONE, self.TWO, self.THREE
        assert self.of(one, two, three) == pytest.approx((3.0, 0.0), rel=WELL, abs=self.RIDGE)
        assert self.of(one, 5.0 * two, three) == pytest.approx((3.0, 0.0), rel=WELL, abs=self.RIDGE)
        assert self.of(one, 2.0 * one, -one) == pytest.approx((1.0, 1.0), rel=WELL)
        # two thirds and a third: the entropy of that; two of three can be done by another one
        assert self.of(one, 2.0 * one, two) == pytest.approx((math.exp(math.log(3.0) - math.log(2.0) * 2.0 / 3.0), 2.0 / 3.0), rel=WELL)

    def test_of_an_effect_its_regression_on_the_others_says_what_they_can_do(self) -> None:
        """With the cosine c of two, each does c^2 of the other."""
        assert self.of(self.ONE, 0.6 * self.ONE + 0.8 * self.TWO)[1] == pytest.approx(0.36, rel=WELL)

    def test_effects_that_do_not_show_have_none(self) -> None:
        assert self.of(self.ONE, self.TWO, 0.1 * self.THREE)[0] == pytest.approx(2.0, rel=WELL)
        assert self.of(0.01 * self.ONE) == (1.0, 0.0)

    def test_a_model_imitates_by_the_numbers_that_it_has_and_signs_halve_the_chance(self) -> None:
        of = cast(Any, SimpleNamespace(variety=(2.5, 0.6)))
        both, one = candidate("e0"), candidate("e1", "log-normal")
        assert Search.imitates(of, Fit((both,), {("a", "e0"): 1.0}, {}, 0.0, 0.0)) == 0.6 * by_chance(1.5)
        two = Fit((both, one), {("a", "e0"): 1.0, ("a", "e1"): 2.0}, {}, 0.0, 0.0)
        assert Search.imitates(of, two, 2) == 0.3 * by_chance(0.5, 2)


class TestCalibratedInstead:
    """A number does one thing alone, and another beside a strong effect: its slope there is not that of the nominal system."""

    ROWS = 400
    STRONG, TWIN, NUMBER = ("a", "strong"), ("a", "twin"), ("a", "number")
    TOLERANCE = 0.02

    def made(self, off: float) -> Search:
        t = np.linspace(0.0, 1.0, self.ROWS)
        alone, strong, together = np.cos(2.0 * np.pi * t), np.sin(6.0 * np.pi * t), np.cos(10.0 * np.pi * t)

        def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
            e, x = values.get(self.TWIN, 0.0) + values.get(self.NUMBER, 0.0), values.get(self.STRONG, 0.0)
            return np.asarray(e * alone + x * strong + 30.0 * x * e * together)[:, None]

        noise = np.random.default_rng(3)
        y = formula(0, {self.STRONG: 3.0, self.NUMBER: off})
        groups = [[y + 1e-2 * noise.standard_normal(y.shape) for _ in range(4)]]
        entries = (candidate("strong", scale=2.0), candidate("twin", scale=0.1, largest=1.0))
        nuisances = [Nuisance(self.NUMBER, self.TOLERANCE)]
        return Search(Catalogue(Path("made up"), entries), Simulator(Calculated(formula, self.ROWS)), groups, nuisances)

    @pytest.mark.parametrize(("times", "instead"), [(1.5, True), (15.0, False)])
    def test_a_number_within_its_tolerance_is_likelier_than_an_effect_that_does_the_same(self, times: float, instead: bool) -> None:
        off = times * self.TOLERANCE
        search = self.made(off)
        both = search.fitted(search.candidates, {self.STRONG: 3.0, self.TWIN: off}, {self.STRONG: 0.01, self.TWIN: 0.001})
        assert both is not None
        best = max(calibrated_instead(search, both), key=lambda f: f.log_evidence)
        assert [c.effect for c in best.model] == ["strong"]
        assert best.calibrated == {self.NUMBER: pytest.approx(off, rel=WELL)}
        assert best.values[self.STRONG] == pytest.approx(3.0, rel=WELL)
        assert (probabilities([both, best], search.candidates)[1] > 0.5) is np.bool_(instead)

    @pytest.mark.parametrize(("times", "there"), [(1.5, True), (15.0, False)])
    def test_a_number_that_is_like_an_effect_only_beside_another_one_is_fitted_in_its_place(self, times: float, there: bool) -> None:
        """Alone it does next to nothing that the effect does. No tolerance is as wide as the larger one is off."""
        other, off = ("a", "other"), times * self.TOLERANCE
        t = np.linspace(0.0, 1.0, self.ROWS)
        alone, strong, together = np.cos(2.0 * np.pi * t), np.sin(6.0 * np.pi * t), np.cos(10.0 * np.pi * t)

        def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
            n, x = values.get(self.NUMBER, 0.0), values.get(self.STRONG, 0.0)
            return np.asarray(n * alone + x * strong + (10.0 * x * n + values.get(other, 0.0)) * together)[:, None]

        y = formula(0, {self.STRONG: 3.0, self.NUMBER: off})
        groups = [[y + 0.3 * np.random.default_rng(k).standard_normal(y.shape) for k in range(4)]]
        entries = (candidate("strong", scale=2.0), candidate("other", scale=1.0, largest=100.0))
        nuisances = [Nuisance(self.NUMBER, self.TOLERANCE)]
        search = Search(Catalogue(Path("made up"), entries), Simulator(Calculated(formula, self.ROWS)), groups, nuisances)
        both = search.fitted(search.candidates, {self.STRONG: 3.0, other: 30.0 * off}, {self.STRONG: 0.01, other: 0.01})
        assert both is not None
        assert not search.evidence.space.alike[other]
        instead = [f for f in calibrated_instead(search, both) if [c.effect for c in f.model] == ["strong"]]
        assert bool(instead) is there
        for f in instead:
            assert abs(f.calibrated[self.NUMBER] - off) < 0.1 * self.TOLERANCE
            assert f.values[self.STRONG] == pytest.approx(3.0, rel=WELL)
            assert f.log_evidence > both.log_evidence

    def test_a_single_effect_and_one_without_a_number_like_it_have_nothing_instead(self) -> None:
        search = self.made(self.TOLERANCE)
        twin, strong = (next(c for c in search.candidates if c.effect == name) for name in ("twin", "strong"))
        for c in (twin, strong):
            alone = search.fitted((c,), {c.addresses[0]: 0.02}, {c.addresses[0]: 0.001})
            assert alone is not None
            assert calibrated_instead(search, alone) == []


@pytest.mark.parametrize(("component", "found"), [("a", False), ("b", True)])
def test_a_number_that_does_what_an_effect_of_its_component_does_has_been_asked(component: str, found: bool) -> None:
    """One of another component, such as a filter beside a late clock, may be right where the effect is not quite."""
    t = np.linspace(0.0, 1.0, 400)
    wave, noise = np.sin(6.0 * np.pi * t), np.random.default_rng(5)

    def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
        return np.asarray(sum(values.values()) * wave)[:, None]

    groups = [[formula(0, {("a", "first"): 0.5}) + 1e-2 * noise.standard_normal((len(t), 1)) for _ in range(4)]]
    search = Search(Catalogue(Path("made up"), (candidate("first"),)), Simulator(Calculated(formula, len(t))), groups, ())
    number = replace(candidate("number", largest=10.0), component=component, parameters=("k",))
    fit = single(search, [number], [])
    assert (fit is not None) is found
    if fit is not None:
        assert fit.values[component, "k"] == pytest.approx(0.5, rel=WELL)
    assert single(search, [], []) is None


@pytest.mark.parametrize(("shows", "found"), [(0.0, False), (0.5, True)])
def test_a_number_that_changes_a_signal_which_is_as_it_should_be_is_none(shows: float, found: bool) -> None:
    """No effect changes the second signal, so that the search does not look at it."""
    t = np.linspace(0.0, 1.0, 400)
    wave = np.sin(6.0 * np.pi * t)

    def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
        k = values.get(("b", "k"), 0.0)
        return np.stack([(values.get(("a", "first"), 0.0) + k) * wave, 1.0 + k * wave], axis=1)

    measured = np.stack([0.5 * wave, 1.0 + shows * wave], axis=1)
    noise = np.array([1e-2, 0.0])
    groups = [[measured + noise * np.random.default_rng(k).standard_normal(measured.shape) for k in range(4)]]
    simulator = Simulator(Calculated(formula, len(t), ("a.x", "b.x")))
    search = Search(Catalogue(Path("made up"), (candidate("first"),)), simulator, groups, ())
    assert list(search.evidence.active) == [True, False]
    number = replace(candidate("number", largest=10.0), component="b", parameters=("k",))
    assert (single(search, [number], []) is not None) is found


def test_a_number_that_does_what_a_known_model_of_its_component_does_has_been_asked() -> None:
    """The slopes of a frequency at two sizes are two signals; what it does at the value that fits is one."""
    t = np.linspace(0.0, 1.0, 400)

    def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
        return np.asarray(np.sin((60.0 + 3.0 * values.get(("a", "error"), 0.0) + values.get(("a", "k"), 0.0)) * t))[:, None]

    groups = [[formula(0, {("a", "error"): 0.5}) + 1e-2 * np.random.default_rng(k).standard_normal((len(t), 1)) for k in range(4)]]
    search = Search(Catalogue(Path("made up"), (candidate("error"),)), Simulator(Calculated(formula, len(t))), groups, ())
    number = replace(candidate("number", scale=6.0), parameters=("k",))
    known = search.run()
    assert any(f.values.get(("a", "error")) == pytest.approx(0.5, rel=WELL) for f in known)
    assert single(search, [number], []) is not None
    assert single(search, [number], known) is None


def test_an_effect_that_is_like_a_number_far_off_is_looked_at() -> None:
    """By its slope at the nominal system an effect that bends explains no more than the calibrated number that is like it."""
    t = np.linspace(0.0, 1.0, 400)
    one, other = np.sin(6.0 * np.pi * t), np.cos(10.0 * np.pi * t)

    def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
        loss = (1.0 + values.get(("a", "loss"), 0.0) / 10.0) * (1.0 + values.get(("a", "loss_error"), 0.0))
        return np.asarray(values.get(("a", "slow"), 0.0) * one + other / loss**2)[:, None]

    truth = {("a", "slow"): 5.0, ("a", "loss_error"): -0.12}
    groups = [[formula(0, truth) + 0.2 * np.random.default_rng(k).standard_normal((len(t), 1)) for k in range(4)]]
    effects = candidate("slow", scale=3.0), candidate("loss_error", scale=0.2, largest=0.9)
    nuisance = Nuisance(("a", "loss"), 0.2)
    search = Search(Catalogue(Path("made up"), effects), Simulator(Calculated(formula, len(t))), groups, (nuisance,))
    best = max(search.run(), key=lambda f: f.log_evidence)
    assert {c.effect for c in best.model} == {"slow", "loss_error"}
    alone = search.fitted((effects[0],), {("a", "slow"): 5.0}, {("a", "slow"): 0.1})
    assert alone is not None
    assert search.far_off(alone) == {("a", "loss")}
    assert search.far_off(best) == frozenset()
    (larger,) = search.linear_fits([alone])
    assert search._hidden(larger, alone, search.far_off(alone))
    assert not search._hidden(larger, alone)  # the gap is not so large that no slope is exact enough
