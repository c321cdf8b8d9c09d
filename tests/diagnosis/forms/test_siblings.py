"""A law that is chosen in one element of a port is tried in the others."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.diagnosis.forms.library import Factor, Term
from robomill.diagnosis.forms.selection import Products, Rows
from robomill.diagnosis.forms.siblings import law, with_siblings
from robomill.diagnosis.forms.signals import Variable
from robomill.orchestration.slaves.protocol import FloatArray

N, PARTS = 1200, 6
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
    return Products(rows, rows.spans(PARTS))


def test_laws_are_alike_that_differ_in_the_index_alone() -> None:
    assert law(*TERMS[AT["f[1]", "square"]]) == law(*TERMS[AT["f[3]", "square"]]) == ("f", "f[i]^2")
    assert law(*TERMS[AT["f[1]", "square"]]) != law(*TERMS[AT["f[1]", "value"]])


@pytest.mark.parametrize("chosen", [[("f[1]", "square")], [("f[1]", "square"), ("f[2]", "signed_square")]])
def test_it_is_the_law_of_the_other_element_where_that_is_there(chosen: list[tuple[str, str]]) -> None:
    """x^2 and -x |x| are nearly the same of the second element; in the third nothing is there, and nothing is put there."""
    kept = with_siblings(products(0.1), TERMS, [AT[c] for c in chosen])
    assert sorted(kept) == [AT["f[1]", "square"], AT["f[2]", "square"]]
