"""Columns by condition: every operation is that of the whole matrix, with what is zero in it."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.diagnosis.inference.columns import Columns
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import ROUNDOFF

BLOCKS = {"one": slice(0, 7), "two": slice(7, 12)}
RANDOM = np.random.default_rng(3)
EVERYWHERE, ONE, TWO, MORE = (RANDOM.normal(size=shape) for shape in ((12, 2), (7, 3), (5, 1), (12, 2)))


def whole() -> FloatArray:
    """Two columns of all conditions, three of the first, one of the second."""
    B = np.zeros((12, 6))
    B[:, :2], B[:7, 2:5], B[7:, 5:] = EVERYWHERE, ONE, TWO
    return B


def made() -> Columns:
    return Columns.joined([(None, EVERYWHERE), ("one", ONE), ("two", TWO)], BLOCKS)


def test_columns_of_conditions_lie_one_after_the_other() -> None:
    assert np.array_equal(made().toarray(), whole())
    assert [len(piece.numbers) for _, piece in made().pieces] == [5, 3]


@pytest.mark.parametrize("blocks", [BLOCKS, {}])
def test_a_matrix_is_taken_apart_without_what_is_zero(blocks: dict[str, slice]) -> None:
    found = Columns.of(whole(), blocks)
    assert np.array_equal(found.toarray(), whole())
    assert found.products() == pytest.approx(whole().T @ whole(), rel=ROUNDOFF, abs=ROUNDOFF)


@pytest.mark.parametrize("x", [RANDOM.normal(size=12), RANDOM.normal(size=(12, 4)), RANDOM.normal(size=(4, 12)).T])
def test_products_with_vectors_and_matrices_are_those_of_the_whole_matrix(x: FloatArray) -> None:
    assert made().across(x) == pytest.approx(whole().T @ x, rel=ROUNDOFF, abs=ROUNDOFF)
    assert made().products() == pytest.approx(whole().T @ whole(), rel=ROUNDOFF, abs=ROUNDOFF)
    v = np.arange(6.0)
    assert made().along(v) == pytest.approx(whole() @ v, rel=ROUNDOFF, abs=ROUNDOFF)


def test_columns_that_come_later_lie_beside_the_others() -> None:
    """One of them is of the second condition alone; the products of the new ones need none of the old."""
    more = MORE.copy()
    more[:7, 1] = 0.0
    both, together = made().beside(more), np.hstack([whole(), more])
    assert both.shape == (12, 8)
    assert np.array_equal(both.toarray(), together)
    assert both.products() == pytest.approx(together.T @ together, rel=ROUNDOFF, abs=ROUNDOFF)
    x, v = RANDOM.normal(size=(12, 3)), np.arange(8.0)
    assert both.across(x) == pytest.approx(together.T @ x, rel=ROUNDOFF, abs=ROUNDOFF)
    assert both.across(x, 6)[6:] == pytest.approx(more.T @ x, rel=ROUNDOFF, abs=ROUNDOFF)
    assert both.along(v) == pytest.approx(together @ v, rel=ROUNDOFF, abs=ROUNDOFF)


def test_some_columns_and_some_rows_keep_their_products() -> None:
    more = made().beside(MORE)
    together = np.hstack([whole(), MORE])
    few = more.chosen([1, 4, 7])
    assert np.array_equal(few.toarray(), together[:, [1, 4, 7]])
    assert few.products() == pytest.approx(together[:, [1, 4, 7]].T @ together[:, [1, 4, 7]], rel=ROUNDOFF, abs=ROUNDOFF)
    turned = more.restricted([BLOCKS["two"], BLOCKS["one"]])
    rows = np.r_[7:12, 0:7]
    assert np.array_equal(turned.toarray(), together[rows])
    alone = more.restricted([BLOCKS["two"]])
    assert alone.products() == pytest.approx(together[7:].T @ together[7:], rel=ROUNDOFF, abs=ROUNDOFF)
    assert alone.across(MORE[7:]) == pytest.approx(together[7:].T @ MORE[7:], rel=ROUNDOFF, abs=ROUNDOFF)
