"""What there is to explain at a port."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.experiment.component_replay import KNOWN
from robomill.diagnosis.forms.library import Factor, Term
from robomill.diagnosis.forms.ports import Seen, _push, _rms, _Screened
from robomill.diagnosis.forms.signals import Host, Variable
from robomill.orchestration.slaves.protocol import PortData
from tests.tolerances import ROUNDOFF


@pytest.mark.parametrize(("size", "there"), [(1e-9, False), (1e-7, True)])
def test_a_gap_that_is_roundoff_of_what_was_measured_is_none(size: float, there: bool) -> None:
    replay: Any = SimpleNamespace(mean=np.stack([np.ones(100), np.full(100, 1e6)], axis=1))
    gap = [np.full((100, 1), size)]
    assert _rms([replay], gap, [0]) == pytest.approx(size if there else 0.0, rel=ROUNDOFF)
    assert _rms([replay], gap, [1]) == 0.0


@pytest.mark.parametrize(
    ("unit", "dependencies", "shown"),
    [("mm", None, True), ("m", ("q",), True), ("m", (), False), ("m", ("other",), False), ("V", None, False)],
)
def test_what_goes_into_an_input_is_not_explained_by_an_output_that_shows_it(
    unit: str, dependencies: tuple[str, ...] | None, shown: bool
) -> None:
    """An encoder: put in place of its input, what it showed explains all of the gap, and nothing."""
    ports = [PortData("q", "input", unit="m"), PortData("shown", "output", unit=unit, dependencies=dependencies)]
    host = Host("encoder", {p.name: p for p in ports}, {"q": 0, "shown": 0}, {"q": ("axis.q", False)})
    known = {Variable("q", False, "m", 0): np.sin(np.arange(100.0)), Variable("shown", False, unit, 0): np.cos(np.arange(100.0))}

    def read(side: Any, element: str) -> set[str]:
        terms = Seen(host, side, [known], [np.arange(100.0)]).library(element, alone=True)
        return {f.variable.name for t in terms for f in t.factors}

    assert read("input", "q") == ({"q"} if shown else {"q", "shown"})
    assert read("output", "shown") == {"q", "shown"}
    assert not host.shows("q", "q")
    assert not host.shows("t", "q")


@pytest.mark.parametrize(("usual", "term", "push"), [(4.0, 2.0, 2.0 * KNOWN), (0.0, 2.0, 0.5 * KNOWN), (4.0, 0.0, 4.0 * KNOWN)])
def test_a_term_is_tried_at_a_part_of_what_passes_also_where_nothing_does(usual: float, term: float, push: float) -> None:
    assert _push(usual, np.full(10, term)) == pytest.approx(push, rel=ROUNDOFF)


def test_of_more_terms_than_rows_can_tell_apart_those_stay_that_do_most_of_the_gap() -> None:
    rng = np.random.default_rng(1)
    gap = rng.normal(size=(40, 1))
    terms = [(f"f[{k}]", Term((Factor("value", Variable(f"f[{k}]", False, "N", 99)),))) for k in range(60)]
    columns = [(t, [rng.normal(size=(40, 1))]) for t in terms]
    columns[50] = terms[50], [3.0 * gap]
    columns[7] = terms[7], [np.zeros((40, 1))]
    screened = _Screened(len(gap))
    for term, does in columns:
        screened.add(term, does, [gap])
    kept = list(screened.columns())
    assert len(kept) == len(gap)
    assert terms[50] in kept
    assert terms[7] not in kept
    assert kept == sorted(kept, key=terms.index)
