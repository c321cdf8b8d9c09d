"""Families: probabilities of effects that count as one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robomill.diagnosis.candidates import Candidate, Prior
from robomill.diagnosis.inference.estimation import Fit, Space
from robomill.diagnosis.outcome.families import families
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import ROUNDOFF

N = 400
SPACE = Space(np.zeros(N), {"a": slice(0, N)}, np.zeros((N, 1)))


def effect(name: str, place: str = "joint 1", family: str = "") -> Candidate:
    prior = Prior("normal", 2.0)
    made = Candidate(name, "a", place, (f"{name} {place}",), 0.1, 9.0, prior, "1", both_signs=True, locations=1)
    return replace(made, family=family or name)


def along(*directions: float) -> FloatArray:
    """A vector in the first coordinates."""
    made = np.zeros(N)
    made[: len(directions)] = directions
    return made


def fit(*parts: tuple[Candidate, FloatArray]) -> Fit:
    """A model of effects of size 1, of which each does this."""
    values = {c.addresses[0]: 2.0 for c, _ in parts}
    columns = np.stack([v for _, v in parts], axis=1) if parts else np.zeros((N, 0))
    return Fit(tuple(c for c, _ in parts), values, {}, 0.0, 0.0, columns.sum(axis=1), columns)


ERROR, ASYMMETRY = (effect(n, family="compliance joint 1") for n in ("error", "asymmetry"))
FRICTION = effect("friction")


def test_the_probability_of_declared_twins_is_that_of_any_of_them() -> None:
    fits = [fit(), fit((ERROR, along(1.0))), fit((ASYMMETRY, along(0.0, 1.0))), fit((ERROR, along(1.0)), (ASYMMETRY, along(0.0, 1.0)))]
    (found,) = families(fits, [0.1, 0.3, 0.4, 0.2], SPACE, [ERROR, ASYMMETRY])
    assert found.name == "compliance joint 1"
    assert found.probability == pytest.approx(0.9, abs=ROUNDOFF)
    assert list(found.members) == ["asymmetry @ joint 1", "error @ joint 1"]
    assert list(found.members.values()) == pytest.approx([0.6, 0.5], abs=ROUNDOFF)


@pytest.mark.parametrize(("cosine", "together"), [(0.96, True), (-0.96, True), (0.94, False)])
def test_effects_with_signatures_that_correlate_are_found(cosine: float, together: bool) -> None:
    fits = [fit((ERROR, along(1.0))), fit((FRICTION, along(cosine, (1.0 - cosine**2) ** 0.5)))]
    found = families(fits, [0.45, 0.55], SPACE, [ERROR, FRICTION])
    assert [f.name for f in found] == (["like friction @ joint 1"] if together else [])
    if together:
        assert found[0].probability == pytest.approx(1.0, abs=ROUNDOFF)
        assert list(found[0].members) == ["friction @ joint 1", "error @ joint 1"]


def test_effects_of_one_kind_share_a_family_and_the_likeliest_comes_first() -> None:
    places = [effect("friction", f"joint {i}") for i in (1, 2)]
    fits = [fit(), *(fit((c, along(*[0.0] * i, 1.0))) for i, c in enumerate([*places, ERROR, ASYMMETRY]))]
    found = families(fits, [0.0, 0.1, 0.2, 0.3, 0.4], SPACE, [*places, ERROR, ASYMMETRY])
    assert [(f.name, pytest.approx(f.probability, abs=ROUNDOFF)) for f in found] == [("compliance joint 1", 0.7), ("friction", 0.3)]


def test_what_correlates_within_a_declared_family_is_said_once() -> None:
    fits = [fit((ERROR, along(1.0))), fit((ASYMMETRY, along(1.0, 0.1)))]
    assert [f.name for f in families(fits, [0.5, 0.5], SPACE, [ERROR, ASYMMETRY])] == ["compliance joint 1"]


def test_what_a_tolerance_explains_is_not_compared() -> None:
    """Two effects that do the same but for a small part, where a tolerance does the same, too: what is left of them is different."""
    tolerance = 1e3 * along(1.0)[:, None]
    space = Space(np.zeros(N), {"a": slice(0, N)}, tolerance)
    fits = [fit((ERROR, along(1.0, 0.1))), fit((FRICTION, along(1.0, 0.0, 0.1)))]
    assert families(fits, [0.5, 0.5], space, [ERROR, FRICTION]) == []
    assert len(families(fits, [0.5, 0.5], SPACE, [ERROR, FRICTION])) == 1


def test_variants_of_one_effect_are_one_member() -> None:
    variant = replace(ERROR, parameters=("error joint 1 at n=2.0",), fixed=((("a", "n"), 2.0),))
    assert families([fit((ERROR, along(1.0))), fit((variant, along(1.0)))], [0.5, 0.5], SPACE, [ERROR, variant]) == []
