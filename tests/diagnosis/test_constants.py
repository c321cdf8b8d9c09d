"""Constants: each name means one thing, and there are not too many; what lies just beyond one of gate, noise and phases is found, and would
not be if it were twice as large; priors, adequacy and verdict say something else if one of theirs is twice as large.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.candidates import COS, LOGGING, SIN, Candidate, Prior
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import Setting
from robomill.diagnosis.gate import checks as gate
from robomill.diagnosis.gate import phases
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.inference import adequacy, evidence, machines, priors, scatter, search, transfer
from robomill.diagnosis.inference.estimation import Fit, Space
from robomill.diagnosis.inference.noise import fast, own_noise
from robomill.diagnosis.outcome import verdict
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import measure
from tests.diagnosis.formula import candidate
from tests.diagnosis.inference.test_machines import Known
from tests.diagnosis.inference.test_scatter import unsteady
from tests.tolerances import ROUNDOFF

STEP = 0.01
CHANNEL = "sensors.y[1]"
T = STEP * np.arange(1000)
QUIET = np.array([1e-6])
ROOT = Path(__file__).parent.parent.parent
SHARED = {"LOGGING"}
"""What the benchmark has, too, with the meaning that it has in the diagnosis: one must not know the other."""


def test_the_name_of_a_constant_means_one_thing_in_diagnosis_and_benchmark() -> None:
    places: dict[str, list[str]] = {}
    second = ROOT / "blind" / "second"  # knows nothing of the first generator: what both call by one name is theirs
    for path in sorted({*(ROOT / "diagnosis").rglob("*.py"), *(ROOT / "blind").rglob("*.py")} - set(second.rglob("*.py"))):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
            for name in {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name) and n.id.isupper()}:
                places.setdefault(name, []).append(str(path.relative_to(ROOT)))
    assert len(places) > 100
    assert {name: files for name, files in places.items() if len(files) > 1 and name not in SHARED} == {}


AT_MOST = 124
"""Named constants of diagnosis/. Each one more is one more thing that somebody must set."""


def numbers(node: ast.expr | None) -> bool:
    """Whether a value is a number or a tuple of numbers, written out."""
    match node:
        case ast.Constant(value=int() | float() as value):
            return not isinstance(value, bool)
        case ast.UnaryOp(operand=operand):
            return numbers(operand)
        case ast.BinOp(left=left, right=right):
            return numbers(left) and numbers(right)
        case ast.Tuple(elts=elements) | ast.List(elts=elements):
            return bool(elements) and all(map(numbers, elements))
    return False


def constants(source: str) -> list[str]:
    """Names in capitals that a module gives to numbers."""
    found = []
    for node in ast.parse(source).body:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        for target in targets:
            pairs = [(target, node.value)]
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple) and len(target.elts) == len(node.value.elts):
                pairs = list(zip(target.elts, node.value.elts, strict=True))
            found += [x.id for x, value in pairs if isinstance(x, ast.Name) and x.id.isupper() and numbers(value)]
    return found


def test_what_counts_as_a_constant() -> None:
    source = "A, B = 1.0, -2\nC = 1 / 32, 1 / 4\nD: float = 2.0 * 3\nE = ('x', 1)\nF = True\ng = 3.0\nH = abs(-1)\n"
    assert constants(source) == ["A", "B", "C", "D"]


def test_there_are_no_more_constants_than_there_were() -> None:
    names = [name for path in sorted((ROOT / "diagnosis").rglob("*.py")) for name in constants(path.read_text(encoding="utf-8"))]
    assert {"DEPENDENCE", "MISFIT", "KEEPS", "UNLISTED"} <= set(names)
    assert len(names) <= AT_MOST


def recorded(x: FloatArray, t: FloatArray = T) -> Run:
    one = measure(repeats=1, seconds=STEP)[0]
    return replace(one, t=t, columns={CHANNEL: x}, ports={CHANNEL: one.ports[CHANNEL]})


def without(rows: int, of: int) -> list[tuple[str, bool]]:
    """What the gate says of a gap of so many steps in the middle of a run."""
    t = STEP * np.arange(of)
    t = np.delete(t, np.arange(of // 2, of // 2 + rows - 1))
    return [(f.kind, f.fatal) for f in gate.raw(recorded(np.sin(t), t), [CHANNEL], {}, STEP)]


class TestGate:
    def test_a_gap_is_noted_and_a_long_one_or_a_large_part_of_a_run_stops_the_log(self) -> None:
        assert without(11, of=10000) == []
        assert without(20, of=10000) == [("time", False)]  # BREAK
        assert without(100, of=10000) == [("time", True)]  # LONG_BREAK
        assert without(40, of=1000) == [("time", False)]
        assert without(58, of=1000) == [("time", True)]  # PART

    @pytest.mark.parametrize(("part", "kinds"), [(0.07, []), (0.15, ["constant"])])
    def test_a_channel_that_stands_still_for_a_part_of_a_run(self, part: float, kinds: list[str]) -> None:
        s = np.sin(T)
        n = int(part * len(T))
        x = s.copy()
        x[250 : 250 + n] = x[250]
        found = gate.standstill(recorded(x), x[:, None], s[:, None], [CHANNEL], STEP, QUIET)
        assert [f.kind for f in found] == kinds  # REST


class TestNoise:
    def test_the_motion_of_40_samples_is_slow_and_that_of_5_is_not(self) -> None:
        """FAST: a mean over twice as many samples would take a tenth of the slow one for noise."""
        n = np.arange(4000)
        share = [float(np.std(fast(np.sin(2.0 * np.pi * n / period)[:, None]))) * np.sqrt(2.0) for period in (40, 5)]
        assert share[0] < 0.05
        assert share[1] > 1.0

    def test_noise_is_guessed_five_times_at_most(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """GUESSES: where the best model is another one each time."""
        made: list[int] = []

        class Restless:
            def __init__(self, *_: Any) -> None:
                made.append(len(made))
                self.evidence = SimpleNamespace(whitening=SimpleNamespace(guessed=True), independent=[False])

            def run(self) -> list[Any]:
                return [SimpleNamespace(model=(len(made),), values={}, log_evidence=0.0)]

        monkeypatch.setattr(search, "Search", Restless)
        simulator: Any = SimpleNamespace(repeated=lambda *_: [[np.zeros((3, 1))]])
        search.searched(SimpleNamespace(), simulator, [[np.zeros((3, 1))]], [])  # type: ignore[arg-type]  # a Search that asks for nothing
        assert len(made) == 5

    def test_a_spell_that_scatters_more_than_chance_lets_it_is_noise_of_its_own(self) -> None:
        """RARE: three times the variance of white noise is, twice is not."""
        for size, more in ((1.3, False), (2.0, True)):
            rng = np.random.default_rng(3)
            runs = [rng.normal(size=1000) for _ in range(40)]
            for k, x in enumerate(runs):
                x[500:625] += (-1) ** k * size / np.sqrt(125)  # variance of the spell: 1 + size^2
            boxes = own_noise([runs], 1, 125)
            assert bool(np.any(np.count_nonzero(boxes, axis=0) == 125)) is more


class TestPhases:
    """An effect whose phase differs, in a laboratory that only adds waves."""

    WAVES = (np.sin(7.0 * T), np.cos(7.0 * T))
    RIPPLE = Candidate(
        "ripple",
        "drive",
        "axis",
        (f"ripple{COS}phase", f"ripple{SIN}phase"),
        minimum=0.01,
        maximum=5.0,
        prior=Prior("normal", 1.0),
        unit="N.m",
        both_signs=True,
        locations=1,
        phase_per_run=True,
    )

    def looked_at(self, amplitude: float) -> tuple[list[Finding], int]:
        """What is said of four runs, and how many simulations that took."""
        rng = np.random.default_rng(1)
        runs = [amplitude * np.sin(7.0 * T + phase) + 0.1 * rng.normal(size=len(T)) for phase in (0.3, 2.1, -1.6, 3.0)]
        asked = []

        def sampled(_: int, changes: Setting) -> FloatArray:
            asked.append(changes)
            waves = dict(zip(self.RIPPLE.addresses, self.WAVES, strict=True))
            return np.asarray(sum((v * waves[a] for a, v in changes), np.zeros(len(T))))[:, None]

        laboratory: Any = SimpleNamespace(
            conditions=[Condition("", {}, tuple(map(recorded, runs)), T)], channels=[CHANNEL], sampled=sampled, decimation=1
        )
        return phases.aligned(laboratory, [self.RIPPLE], 1), len(asked)

    def test_phases_differ_by_clear_evidence(self) -> None:
        """GROWTH_GAIN: evidence of 8 nats is too little, evidence of 18 is not."""
        assert self.looked_at(0.06)[0] == []
        ((found,), _) = self.looked_at(0.065)
        assert 12.0 < found.value < 24.0

    @pytest.mark.parametrize(("amplitude", "rounds"), [(1.0, 1), (3.0, 2)])
    def test_an_effect_is_simulated_until_its_amplitude_stays(self, amplitude: float, rounds: int) -> None:
        """From the prior scale of 1 on, within TRUST; in each round with either sign of two parts, and once nominally."""
        assert self.looked_at(amplitude)[1] == 1 + rounds * 2 * 2

    @pytest.mark.parametrize(("amplitude", "aligned"), [(4.5, 1), (5.5, 0)])
    def test_more_than_there_can_be_of_an_effect_is_something_else(self, amplitude: float, aligned: int) -> None:
        """Runs are not brought to the phase of a gap that another fault makes; `maximum` is 5."""
        assert len(self.looked_at(amplitude)[0]) == aligned


EFFECT, CLOCK = candidate("p"), replace(candidate("lag a.*"), component=LOGGING)
NOTHING_SEEN = Space(np.zeros(1), {"all": slice(0, 1)}, np.zeros((1, 0)))
AROUND_NOISE: Any = SimpleNamespace(
    candidates=(EFFECT,),
    evidence=SimpleNamespace(
        noise=1000.0,
        space=NOTHING_SEEN,
        level=lambda left: float(left[0]),
        levels=lambda left: np.array([[left[0]]]),
        guess=1.0,
    ),
    explainable=lambda left: 0.0,
    imitates=lambda *_: 0.0,
    numbers=lambda fit: ([], np.zeros(0), np.zeros((0, 0))),
)


def fitted(left: float, *model: Candidate) -> Fit:
    """A model that leaves so many times what noise does."""
    return Fit(model, {a: c.prior.scale for c in model for a in c.addresses}, {}, 0.0, 1000.0 * left, np.array([-left]))


def far_off() -> float:
    """Log Bayes factor for a model of ten calibrated numbers, one of which it has fifty tolerances off."""
    return adequacy.within_tolerances(50.0 * np.eye(10)[0], 0.01 * np.eye(10))


def form() -> float:
    """Length of what the law of an effect may miss that is 100 deviations long."""
    made: Any = SimpleNamespace(space=NOTHING_SEEN, arrays=np.array([0]))
    found = evidence.Evidence.form(made, (EFFECT,), np.array([100.0]), np.zeros((1, 1)), np.zeros(1))
    assert found is not None
    return float(found[0, 0])


def discrepancy() -> float:
    """That of an array which three deviations of a tolerance, simulated at once, change by 6."""
    a = EFFECT.addresses[0]
    return float(evidence._discrepancy({a: [np.full((10, 1), 6.0)]}, {a: 1.5}, {a: 0.5}, np.array([0]))[0])


def rank() -> float:
    """That of odds which no simulated machine has."""
    a = EFFECT.addresses[0]
    of = Known((EFFECT,), SimpleNamespace(space=NOTHING_SEEN, sensitivities={a: np.ones(1)}), {})
    return machines.p_none(of, math.inf)


def explainable() -> float:
    """What is explained by a candidate that explains 100 times what it explains of noise."""
    seen = SimpleNamespace(space=NOTHING_SEEN, sensitivities={EFFECT.addresses[0]: np.full(1, 10.0)}, guess=1.0, dispersion=1.0)
    of = Known((EFFECT,), seen, {})
    return search.Search.explainable(of, np.full(1, math.sqrt(101.0)))


def fits(before: float, after: float, *model: Candidate) -> float:
    return verdict.tested(AROUND_NOISE, fitted(before), fitted(after, *model), 0.0, 0.0, None, 0.02, (0.0, 0.0)).p_fit


def judged(before: float, probability: float, p_none: float) -> str:
    tests, moved = verdict.Tests(0.02, p_none, 0.99, 0.0), transfer.Transfer(before, 1.0, 0.0, 0.0)
    model = fitted(1.0, EFFECT)
    return verdict.judged(AROUND_NOISE, tests, fitted(1.0), model, lambda: None, {EFFECT: probability}, False, moved=moved)


NOTICED: list[tuple[Any, str, float, Callable[[], Any], Any, Any]] = [
    (priors, "NOTHING", 2.0, lambda: math.exp(priors.log_priors([()], (EFFECT,))[0]), 0.3, 0.6),
    # a probability that cannot be doubled: twice the odds
    (priors, "ANOTHER", 4 / 3, lambda: math.exp(priors.log_priors([(EFFECT,)], (EFFECT,))[0]), 0.7 * 0.25, 0.7 / 9.0),
    (adequacy, "LEVEL", 2.0, lambda: adequacy.unexplained(11.0, 4.0), 2.7 / 9.7, 1.4 / 8.4),
    (adequacy, "SPREAD", 2.0, lambda: adequacy.left_by(9.0, 2.3, 0.05) > 0.0, False, True),
    (search, "COHERENT", 2.0, explainable, 1.0 + 0.6 * 99.0, 1.0 + 1.2 * 99.0),
    (adequacy, "MISFIT", 2.0, lambda: adequacy.misfit(fitted(1.0, EFFECT)), 0.05, 0.1),
    (adequacy, "MISFIT", 2.0, lambda: fits(50.0, 6.0, EFFECT) > 0.5, False, True),
    (adequacy, "EXACT", 2.0, lambda: adequacy.misfit(fitted(1.0, CLOCK)), 0.005, 0.01),
    (adequacy, "EXACT", 2.0, lambda: fits(50.0, 2.7, CLOCK) > 0.5, False, True),
    (evidence, "DISCREPANCY", 2.0, discrepancy, 0.2, 0.4),
    (evidence, "FORM", 2.0, form, 4.0, 8.0),
    (machines, "MACHINES", 2, rank, 1.0 / 2001.0, 1.0 / 4001.0),
    (transfer, "KEEPS", 2.0, lambda: transfer.Transfer(5.0, 1.1, 1.0, 1.0, 0.0, 0.8, 0.1).promise > 0.0, False, True),
    (adequacy, "HOLDS", 0.5, lambda: round(adequacy.kept(50.0), 6), round(math.log(2.0), 6), round(math.log(4.0), 6)),
    (adequacy, "MISJUDGED", 2.0, lambda: far_off() < math.log(0.15), True, False),
    (verdict, "UNLISTED", 2.0, lambda: fits(1.0, 1.0, EFFECT) > 0.5, True, False),
    (scatter, "SHOWS", 2.0, lambda: scatter.spell(unsteady(7.0)) is not None, True, False),
    (verdict, "UNKNOWN", 2.0, lambda: judged(3.5, 0.9, 0.5), "unknown", "none"),
    (verdict, "IDENTIFIED", 1.2, lambda: judged(9.0, 0.9, 0.001), "identified", "ambiguous"),
]
"""Module, constant, times what, what depends on it, before and after."""


@pytest.mark.parametrize(("module", "name", "times", "figure", "before", "after"), NOTICED, ids=[n[1] for n in NOTICED])
def test_a_constant_of_the_tests_that_is_twice_as_large_is_noticed(
    module: Any, name: str, times: float, figure: Callable[[], Any], before: Any, after: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def same(found: Any, expected: Any) -> bool:
        return bool(found == (pytest.approx(expected, rel=1e2 * ROUNDOFF) if isinstance(expected, float) else expected))

    assert same(figure(), before)
    monkeypatch.setattr(module, name, times * getattr(module, name))
    assert same(figure(), after)
