"""Terms of a problem: chosen, pruned, fitted, and what they leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.forms.library import Term
from robomill.diagnosis.forms.periods import with_periods
from robomill.diagnosis.forms.ports import Problem
from robomill.diagnosis.forms.selection import Chosen, Products, Rows, Values, choose, chosen_in, pruned, values
from robomill.diagnosis.forms.siblings import together, with_siblings
from robomill.diagnosis.inference.ceiling import FOLDS
from robomill.diagnosis.outcome.closure import BLOCKS
from robomill.orchestration.slaves.protocol import FloatArray


@dataclass(frozen=True)
class Solved:
    """A problem with its terms."""

    problem: Problem
    terms: list[tuple[str, Term]]
    found: Values
    closure: float
    """1 - squares left / squares of the gap, in parts that choice and fit have not seen."""
    left: Mapping[str, FloatArray]
    """Channel -> squares left in each of BLOCKS blocks of time of each condition, [conditions * BLOCKS], in samples of the laboratory."""
    gap: Mapping[str, FloatArray]
    """Channel -> squares of the gap, as `left`."""


def solve(problem: Problem) -> Solved:
    """Choose and fit the terms of a problem.

    Calibrated numbers take what they may beside a first choice, which is made in one way only, and in the end once more beside the terms.
    """
    if problem.doubts:
        rows, groups = _with_groups(problem.beside([]))
        first = _apart(chosen_in(rows, (), Rows.spans).terms, groups, len(problem.terms))
        problem = problem.beside([problem.terms[i] for i in first])
    problem, terms, closure, chosen = _chosen(problem)
    problem = problem.beside(terms)
    rows = problem.rows(terms)
    folds = chosen.divided(rows, FOLDS)
    order = rows.products(folds).path(len(terms))  # that which predicts most comes first
    terms = [terms[i] for i in dict.fromkeys([*order, *range(len(terms))])]
    rows = problem.rows(terms)
    left = _squares(problem, rows, rows.left_out(folds))
    gap = _squares(problem, rows, rows.y)
    whole = (1.0 - closure) * sum(float(x.sum()) for x in gap.values()) / max(sum(float(x.sum()) for x in left.values()), 1e-300)
    found = values(rows, list(range(len(terms))))
    return Solved(problem, terms, found, closure, {c: whole * x for c, x in left.items()}, gap)


def _chosen(problem: Problem) -> tuple[Problem, list[tuple[str, Term]], float, Chosen]:
    """The problem averaged to its band, its terms and their closure, and how they were chosen."""
    rows, groups = _with_groups(problem)
    chosen = choose(rows, [i for i, (_, t) in enumerate(problem.terms) if not t.factors])
    problem = replace(problem, decimation=problem.decimation * 2**chosen.pairs)
    # of closures below zero, what is white is predicted better, but not what is there
    at, closure = (chosen.terms, chosen.closure) if chosen.closure > 0.0 else ([], 0.0)
    if at and groups:
        folds = chosen.divided(chosen.rows, FOLDS)
        alone = _apart(at, groups, len(problem.terms))
        others = with_siblings(chosen.rows.products(folds, chosen.rho), problem.terms, alone)
        if others != at:
            at, closure = others, _closure(chosen.rows.products(folds), others)
    terms = [problem.terms[i] for i in at]
    places = [(e, v) for e in dict.fromkeys(e for e, _ in problem.terms) for v in problem.seen.angles(e)] if problem.effect else []
    longer = with_periods(problem, terms, chosen.rho, places, chosen.divided)
    if len(longer) > len(terms):
        rows = problem.rows(longer)
        folds = chosen.divided(rows, FOLDS)
        kept = pruned(rows.products(folds, chosen.rho), list(range(len(longer))))
        terms, closure = [longer[i] for i in kept], _closure(rows.products(folds), kept)
    return problem, terms, closure, chosen


def _with_groups(problem: Problem) -> tuple[Rows, list[list[int]]]:
    """Rows of the terms, and behind them those of each law that several elements have together; and the members of these laws."""
    groups = together(problem.terms)
    return problem.rows(None, groups), groups


def _apart(chosen: Sequence[int], groups: Sequence[Sequence[int]], count: int) -> list[int]:
    """Terms of a choice among `count` terms and the groups behind them, each group by its members."""
    return list(dict.fromkeys(i for c in chosen for i in ([c] if c < count else groups[c - count])))


def _closure(plain: Products, terms: list[int]) -> float:
    """1 - squares left / squares, in folds that are left out of the fit."""
    return 1.0 - float(plain.errors(terms).sum()) / max(float(plain.square.sum()), 1e-300)


def _squares(problem: Problem, rows: Rows, series: FloatArray) -> dict[str, FloatArray]:
    """Squares of series of rows [n] by channel and block, as `Solved.left`."""
    size = problem.scale * np.sqrt(problem.decimation / problem.base)
    blocks, channel = rows.blocks(), rows.series % len(problem.channels)
    of = [np.bincount(blocks, np.where(channel == k, series**2, 0.0), len(problem.gap) * BLOCKS) for k in range(len(problem.channels))]
    return {c: x * one**2 for c, x, one in zip(problem.channels, of, size, strict=True)}
