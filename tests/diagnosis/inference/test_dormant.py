"""Effects that do nothing by themselves are found beside what wakes them, and cost nothing but two simulations where they are not there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.diagnosis.candidates import Address
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.diagnosis.inference.dormant import Beside, searched_beside
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.intervals import by_least_squares
from robomill.diagnosis.inference.search import Search, searched
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.formula import Calculated, candidate
from tests.tolerances import chance

ROWS, NOISE = 40, 0.02
"""Loads, and the noise of a displacement."""
DRAWN = np.random.default_rng(7)
LOAD, ANGLE, OTHER = DRAWN.uniform(0.5, 1.5, ROWS), DRAWN.uniform(-1.0, 1.0, ROWS), DRAWN.uniform(-1.0, 1.0, ROWS)
CATALOGUE = Catalogue(Path("made up"), tuple(candidate(p) for p in ("gives", "leans", "base", "coupled")))


def displaced(_: int, values: Mapping[Address, float]) -> FloatArray:
    """A joint `gives` way in the direction of its angle, which may be `coupled` to another; two more compliances in other directions."""
    gives, leans, base, coupled = (values.get(("a", p), 0.0) for p in ("gives", "leans", "base", "coupled"))
    angle = ANGLE + coupled * OTHER
    x = LOAD * (gives * np.cos(angle) + leans * np.sin(angle) + base)
    y = LOAD * (gives * np.sin(angle) + leans * np.cos(angle))
    return np.stack([x, y], axis=1)


def laboratory() -> Calculated:
    made = Calculated(displaced, ROWS, ("a.x", "a.y"))
    made.conditions = [replace(c, independent=True) for c in made.conditions]
    return made


def measured(seed: int = 1, **truth: float) -> list[list[FloatArray]]:
    clean = displaced(0, {("a", p): v for p, v in truth.items()})
    return [[clean + NOISE * np.random.default_rng(seed).normal(size=clean.shape)]]


def best(fits: Sequence[Fit]) -> Fit:
    return max(fits, key=lambda f: f.log_evidence)


def test_a_coupling_that_moves_nothing_alone_is_found_beside_the_joint_that_gives() -> None:
    groups = measured(gives=1.0, coupled=0.8)
    with Simulator(laboratory()) as simulator:
        _, before = searched(CATALOGUE, simulator, groups, [])
        search, fits = searched_beside(CATALOGUE, simulator, groups, [])
    assert all(c.name != "coupled @ place" for f in before for c in f.model)
    found = best(fits)
    assert {c.effect for c in found.model} == {"gives", "coupled"}
    assert found.values["a", "coupled"] == pytest.approx(0.8, abs=chance(found.deviations["a", "coupled"]))
    assert found.values["a", "gives"] == pytest.approx(1.0, abs=chance(found.deviations["a", "gives"]))
    assert found.chi2 < 2.0 * search.evidence.expected.sum()
    assert [c.effect for c in search.candidates].count("coupled") == 1
    assert ("a", "coupled") in search.alone[0]  # with its slope beside the best model
    without = [f for f in fits[1:] if ("a", "coupled") not in f.values]
    assert all(f.log_evidence < found.log_evidence for f in without)
    assert without  # the best model without it is among those that are compared


def test_one_that_is_not_there_costs_a_simulation_of_each_sign_and_changes_nothing() -> None:
    groups = measured(gives=1.0)
    plain, beside = laboratory(), laboratory()
    with Simulator(plain) as one, Simulator(beside) as other:
        _, expected = searched(CATALOGUE, one, groups, [])
        search, fits = searched_beside(CATALOGUE, other, groups, [])
    assert [(f.name, f.values, f.log_evidence) for f in fits] == [(f.name, f.values, f.log_evidence) for f in expected]
    assert all(c.effect != "coupled" for c in search.candidates)
    assert len(beside.asked) - len(plain.asked) <= 3  # both signs, and the model that they stand beside


def test_what_is_always_there_gives_way_to_what_a_setting_says() -> None:
    inner = laboratory()
    with Simulator(inner) as simulator:
        Beside(simulator, {("a", "base"): 2.0}).many([(0, ((("a", "gives"), 1.0),)), (0, ((("a", "base"), 3.0),))])
    assert inner.asked == [((("a", "base"), 2.0), (("a", "gives"), 1.0)), ((("a", "base"), 3.0),)]


def test_values_by_least_squares_do_not_depend_on_where_they_begin() -> None:
    """Twice the compliance with half of the coupling is no solution of the linear problem there."""
    groups = measured(gives=1.0, coupled=0.8)
    with Simulator(laboratory()) as simulator:
        search: Search
        search, fits = searched_beside(CATALOGUE, simulator, groups, [])
        there = best(fits)
        far = replace(there, values={a: 0.3 if a[1] == "coupled" else 2.0 for a in there.values})
        near, other = by_least_squares(search, there), by_least_squares(search, far)
    for name, known in near.items():
        for a, value in known.values.items():
            assert abs(other[name].values[a] - value) < known.deviations[a]
            assert abs(value - (0.8 if a[1] == "coupled" else 1.0)) < 3.0 * known.deviations[a]
