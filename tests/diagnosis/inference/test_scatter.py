"""What differs from run to run: on repeats of which the scatter is known."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.noise import SPELL
from robomill.diagnosis.inference.scatter import Scattered, by_chance, excess, levels, spell, swing, with_chance
from robomill.diagnosis.inference.visibility import SHOWS
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis import axis
from tests.diagnosis.demo import changed
from tests.diagnosis.formula import candidate
from tests.tolerances import ROUNDOFF, chance

ROWS, STEP = 8 * SPELL, 0.01
CHANNELS = ("idle.w", "a.x[1]", "a.x[2]", "b.y", "c.z")
"""No effect changes the first one."""
ARRAYS = np.array([0, 0, 1, 2])
SIGNS = (1.0, -1.0, 0.0)
"""Three runs, two of them on both sides of their mean: the variance is the square of the deviation."""


def repeats(deviations: FloatArray) -> list[FloatArray]:
    """Runs [samples, channels] with these deviations [spells, channels] from their mean."""
    return [1.0 + sign * np.repeat(deviations, SPELL, axis=0) for sign in SIGNS]


def unsteady(
    times: float, channels: tuple[int, ...] = (0, 2), simulated: float = 0.0, runs: int = 3, independent: bool = False, judged: int = 4
) -> Any:
    """Repeats that scatter by 1 everywhere, and in the sixth spell by so much in some channels."""
    deviations, known = np.ones((8, 4)), np.zeros((8, 4))
    deviations[5, list(channels)] = times
    known[5] = simulated
    evidence = SimpleNamespace(
        space=SimpleNamespace(blocks={"there": slice(0, 1)}),
        active=np.arange(5) > 0,
        arrays=ARRAYS,
        nominals=[repeats(known)],
        discrepancy=np.zeros(4),
        judged=np.arange(4) < judged,
        there=[np.ones(4, dtype=np.bool_)],
        independent=[independent],
        decimation=1,
    )
    laboratory = SimpleNamespace(
        channels=CHANNELS, system=SimpleNamespace(step=STEP), conditions=[SimpleNamespace(grid=STEP * np.arange(ROWS))]
    )
    groups = [repeats(np.hstack([np.full((8, 1), 1e3), deviations]))[:runs]]
    return SimpleNamespace(evidence=evidence, groups=groups, simulator=SimpleNamespace(laboratory=laboratory))


def test_excess_is_over_usual_scatter_that_of_simulated_repeats_and_discrepancy() -> None:
    measured, known = np.ones((4, 1)), np.zeros((4, 1))
    measured[2], known[2] = 36.0, 4.0
    found = excess(measured, known, np.array([3.0]))
    assert found[:, 0] == pytest.approx([1 / 10, 1 / 10, 36 / (1 + 4 + 9), 1 / 10], rel=ROUNDOFF)


def test_what_scatters_in_two_arrays_for_a_while_is_found() -> None:
    found = spell(unsteady(2.0 * SHOWS))
    assert found is not None
    assert (found.channel, found.condition) == ("a.x[1]", "there")
    assert found.span == pytest.approx((5 * SPELL * STEP, 6 * SPELL * STEP), rel=ROUNDOFF)
    assert found.times == pytest.approx(2.0 * SHOWS, rel=ROUNDOFF)


@pytest.mark.parametrize(("times", "there"), [(0.99 * SHOWS, False), (1.01 * SHOWS, True)])
def test_it_shows_from_as_many_deviations_as_an_effect_does(times: float, there: bool) -> None:
    assert (spell(unsteady(times)) is not None) is there


def test_one_array_alone_is_the_noise_of_a_device() -> None:
    assert spell(unsteady(1e3, channels=(0, 1))) is None
    assert spell(unsteady(1e3, channels=(0, 3), judged=3)) is None  # what no tolerance changes is not judged


def test_what_simulated_repeats_scatter_too_is_no_finding() -> None:
    assert spell(unsteady(50.0, simulated=1.0)) is not None
    assert spell(unsteady(50.0, simulated=50.0)) is None


def test_of_two_runs_and_of_independent_samples_nothing_is_said() -> None:
    for runs in (1, 2):
        assert spell(unsteady(1e3, runs=runs)) is None
    assert spell(unsteady(1e3, independent=True)) is None


def test_the_scatter_of_an_effect_is_likelier_where_it_has_the_size_that_repeats_show() -> None:
    usual, effect = np.ones((8, 2)), np.zeros((8, 2))
    effect[5] = 20.0
    known = Scattered(5, usual + effect, 0.0 * usual, np.zeros(2))
    odds = known.log_odds([0.5 * effect, effect, 2.0 * effect])
    assert odds.argmax() == 1
    assert odds[1] == pytest.approx(2.5 * (21.0 - 1.0 - np.log(21.0)), rel=ROUNDOFF)  # one spell counts once, whatever the channels
    assert known.level(effect) == pytest.approx(1.0, rel=ROUNDOFF)
    assert known.level(0.0 * effect) == pytest.approx(28.0 / 8.0, rel=ROUNDOFF)


def test_repeats_of_a_good_machine_speak_against_an_effect_that_scatters() -> None:
    usual, effect = np.ones((8, 2)), np.zeros((8, 2))
    effect[5] = 20.0
    assert Scattered(5, usual, 0.0 * usual, np.zeros(2)).log_odds([effect])[0] < -3.0


def drawn(true: float) -> tuple[Any, Candidate]:
    """Five runs of a machine that loses packets in a third of the time: noise of 1 there is, and one of size `true` in that spell.

    A simulation with the effect scatters there by its size, and its mean shows nothing.
    """
    c = candidate("lost", "log-normal", 4.0, spread=1.0)

    def made(size: float, noise: float, seed: int) -> list[FloatArray]:
        rng = np.random.default_rng(seed)
        deviations = np.where(np.arange(ROWS) // SPELL == 5, size, 0.0)[:, None] * np.array([1.0, 0.0, 1.0, 0.0])
        return [deviations * rng.normal(size=(ROWS, 4)) + noise * rng.normal(size=(ROWS, 4)) for _ in range(6)]

    def idle(runs: list[FloatArray]) -> list[FloatArray]:
        return [np.hstack([np.zeros((ROWS, 1)), x]) for x in runs]

    def repeated(conditions: Any, changes: Any, count: int, what: str) -> list[list[FloatArray]]:
        return [idle(made(dict(changes).get(c.addresses[0], 0.0), 0.0, 3))]

    search = unsteady(1.0, runs=3)
    search.groups = [idle(made(true, 1.0, 7))]
    search.evidence.nominals = [made(0.0, 0.0, 5)]
    search.evidence.space = SimpleNamespace(blocks={"there": slice(0, 1)}, y=np.zeros(4), chi2=0.0, square=lambda v: float(v @ v))
    search.evidence.mean_signature = lambda group: np.zeros(4)
    search.simulator.repeated = repeated
    search.catalogue = SimpleNamespace(drawn=frozenset({c.effect}))
    search.candidates = (c,)
    return search, c


def test_an_effect_that_a_seed_draws_is_fitted_to_what_repeats_scatter() -> None:
    search, c = drawn(5.0)
    fit = by_chance(search, c)
    assert fit is not None
    value, deviation = fit.values[c.addresses[0]], fit.deviations[c.addresses[0]]
    assert fit.log_evidence > 20.0
    assert abs(value - 5.0) < chance(deviation)
    before, after = levels(search, fit)
    assert after < 1.5 < before
    nominal = Fit((), {}, {}, 0.0, 0.0)
    kept = with_chance(search, [nominal, replace(fit, log_evidence=0.0)])  # what its mean says gives way
    assert [f.log_evidence for f in kept] == [0.0, fit.log_evidence]
    assert levels(search, nominal) == (0.0, 0.0)


def test_repeats_that_scatter_as_usual_have_no_such_effect() -> None:
    search, c = drawn(0.0)
    fit = by_chance(search, c)
    assert fit is not None
    assert fit.log_evidence < 0.0
    search.groups = [search.groups[0][:2]]
    assert by_chance(search, c) is None


TOLERANCES = """
[[nuisance]]
component = "drive"
parameters = ["viscous"]
absolute = 1e-4
unit = "N.m.s/rad"
source = "made up"

[[nuisance]]
component = "drive"
parameters = ["angle_offset"]
absolute = 1e-6
unit = "rad"
source = "made up"
"""


def swinging(times: float, columns: Sequence[str]) -> list[Run]:
    """Two runs of 10 s of a good axis; for a second something swings to and fro from step to step, by so many deviations of the noise."""

    def swings(t: FloatArray, x: FloatArray, size: float) -> FloatArray:
        return x + size * np.where((t > 4.0) & (t < 5.0), (-1.0) ** np.arange(len(t)), 0.0)

    runs = axis.measure(seconds=10.0, repeats=2)
    for column in columns:
        runs = changed(runs, column, lambda t, x, size=times * axis.NOISE[column]: swings(t, x, size))
    return runs


@pytest.mark.parametrize(
    ("times", "columns", "verdict"),
    [
        (3.0 * SHOWS, ("drive.torque", "drive.angle"), "unknown"),
        (0.3 * SHOWS, ("drive.torque", "drive.angle"), "none"),
        (3.0 * SHOWS, ("drive.torque",), "none"),
    ],
    ids=["in both arrays", "too little", "in one array"],
)
def test_what_swings_within_samples_is_seen_though_their_means_are_those_of_a_good_machine(
    tmp_path: Path, times: float, columns: Sequence[str], verdict: str
) -> None:
    found = axis.catalogue(tmp_path, more=TOLERANCES)
    result = diagnose(axis.system(), swinging(times, columns), found, resolver=axis.resolve).result
    assert result["verdict"] == verdict
    said = [f["text"] for f in result["gate"]["findings"] if f["kind"] == "swing"]
    if verdict == "none":
        assert not said
        return
    text = r"swings within samples of 8.0 ms: (\d+) times what good machines do, in another array, too \(size 1.0, 4\.\d to [45]\.\d s\)"
    (match,) = (re.fullmatch(text, t) for t in said)
    assert match is not None
    assert SHOWS < float(match[1]) <= 3.0 * SHOWS * math.sqrt(2.0)  # of two samples in a block the variance is twice the square
    assert result["unknown"]["component"] == "drive"


def test_where_a_sample_is_a_step_nothing_is_faster() -> None:
    assert swing(unsteady(1e3), Fit((), {}, {}, 0.0, 0.0)) is None
