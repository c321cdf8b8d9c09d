"""A law that is chosen in one element of a port is tried in the others."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.diagnosis.forms.library import Factor, Term
from robomill.diagnosis.forms.ports import Problem, Seen
from robomill.diagnosis.forms.selection import Products, Rows
from robomill.diagnosis.forms.siblings import law, together, with_siblings
from robomill.diagnosis.forms.signals import Host, Variable
from robomill.diagnosis.forms.solving import solve
from robomill.orchestration.slaves.protocol import FloatArray

N, PARTS = 1200, 6
NOISE = 0.3
KNOWN = 4.0 * NOISE / np.sqrt(N)
"""Four standard deviations of a coefficient whose term has a mean square of one or more."""
KINDS = {"square": lambda x: x * x, "signed_square": lambda x: x * np.abs(x), "value": lambda x: x}
TERMS = [(f"f[{i}]", Term((Factor(kind, Variable(f"f[{i}]", False, "N", 3)),))) for i in (1, 2, 3) for kind in KINDS]
AT = {(element, term.factors[0].kind): k for k, (element, term) in enumerate(TERMS)}


def products(noise: float) -> Products:
    """Squares in the first and the second of three elements; the second is below zero, but for a few samples."""
    rng = np.random.default_rng(3)
    f = [rng.normal(size=N), -np.abs(rng.normal(size=N)), rng.normal(size=N)]
    f[1][::100] *= -0.1
    X = np.zeros((3 * N, len(TERMS)))
    y: FloatArray = noise * rng.normal(size=3 * N)
    for (element, kind), k in AT.items():
        i = int(element[2]) - 1
        X[i * N : (i + 1) * N, k] = KINDS[kind](f[i])
    y += X[:, AT["f[1]", "square"]] + X[:, AT["f[2]", "square"]]
    series = np.repeat(np.arange(3), N)
    rows = Rows(y, X, series, np.zeros(3 * N, dtype=np.intp), np.tile((np.arange(N) + 0.5) / N, 3), 0.01)
    return rows.products(rows.spans(PARTS))


def test_laws_are_alike_that_differ_in_the_index_alone() -> None:
    assert law(*TERMS[AT["f[1]", "square"]]) == law(*TERMS[AT["f[3]", "square"]]) == ("f", "f[i]^2")
    assert law(*TERMS[AT["f[1]", "square"]]) != law(*TERMS[AT["f[1]", "value"]])


@pytest.mark.parametrize("chosen", [[("f[1]", "square")], [("f[1]", "square"), ("f[2]", "signed_square")]])
def test_it_is_the_law_of_the_other_element_where_that_is_there(chosen: list[tuple[str, str]]) -> None:
    """x^2 and -x |x| are nearly the same of the second element; in the third nothing is there, and nothing is put there."""
    kept = with_siblings(products(0.1), TERMS, [AT[c] for c in chosen])
    assert sorted(kept) == [AT["f[1]", "square"], AT["f[2]", "square"]]


def test_a_law_with_one_coefficient_in_all_elements_is_a_term() -> None:
    """In an element that is hardly ever above zero, x^2 and -x |x| are one; that of all three is found, with a coefficient for each."""
    rng = np.random.default_rng(4)
    f = [rng.normal(size=N), -np.abs(rng.normal(size=N)), rng.normal(size=N)]
    f[1][::400] *= -0.1
    known = {term.factors[0].variable: f[int(element[2]) - 1] for element, term in TERMS}
    gap = np.stack([c * x * x for c, x in zip((1.0, 0.9, 1.1), f, strict=True)], axis=1) + NOISE * rng.normal(size=(N, 3))
    effect = {f"f[{i}]": np.broadcast_to(np.eye(3)[i - 1], (N, 3)) for i in (1, 2, 3)}
    seen = Seen(Host("sensor", {}, {}, {}), "input", [known], [0.01 * np.arange(N, dtype=np.float64)])
    channels = ("sensor.f[1]", "sensor.f[2]", "sensor.f[3]")
    found = solve(Problem(seen, channels, list(TERMS), [gap], np.ones(3), [effect], 1, 0.01))
    assert sorted((e, t.factors[0].kind) for e, t in found.terms) == [(f"f[{i}]", "square") for i in (1, 2, 3)]
    values = {e: float(c) for (e, _), c in zip(found.terms, found.found.values, strict=True)}
    np.testing.assert_allclose([values[f"f[{i}]"] for i in (1, 2, 3)], [1.0, 0.9, 1.1], rtol=0.0, atol=KNOWN)


def test_a_law_that_one_element_has_is_in_no_group() -> None:
    groups = together(TERMS[:4])
    assert [[TERMS[i][0] for i in members] for members in groups] == [["f[1]", "f[2]"]]
