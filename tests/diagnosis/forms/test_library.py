"""Terms: units, texts, and what is left out because it is the same as another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robomill.diagnosis.forms.library import SLIDES, Factor, Term, library
from robomill.diagnosis.forms.signals import Variable
from tests.tolerances import ROUNDOFF

SPEED = Variable("qd[1]", False, "rad/s", 2)
OTHER = Variable("qd[2]", False, "rad/s", 2)
TURN = Variable("q[1]", True, "rad/s", 2)
MOVED = Variable("q[2]", False, "rad", 2, since_start=True)
LOAD = Variable("load", False, "N", 0)
TIME = Variable("t", False, "s", 0)


@pytest.mark.parametrize(
    ("term", "text", "unit"),
    [
        (Term(), "1", "N.m"),
        (Term((Factor("value", SPEED),)), "qd[1]", "N.m.s/rad"),
        (Term((Factor("sign", TURN, 0.02),)), "sgn(d(q[1])/dt)", "N.m"),
        (Term((Factor("square", TURN),)), "(d(q[1])/dt)^2", "N.m.s2/rad2"),
        (Term((Factor("square", SPEED),)), "qd[1]^2", "N.m.s2/rad2"),
        (Term((Factor("root", SPEED, 2.0),)), "sgn(qd[1]) sqrt(|qd[1]|/(2 rad/s))", "N.m"),
        (Term((Factor("sign", SPEED, 0.1), Factor("size", LOAD))), "sgn(qd[1]) |load|", "m"),
        (Term((Factor("sine", SPEED, 12.0),)), "sin(12 qd[1])", "N.m"),
        (Term((Factor("decay", TIME, 3.0),)), "exp(-t/(3 s))", "N.m"),
        (Term((Factor("value", MOVED),)), "(q[2] - q[2] at t = 0)", "N.m/rad"),
    ],
)
def test_a_term_has_a_text_and_its_coefficient_a_unit(term: Term, text: str, unit: str) -> None:
    assert term.text == text
    assert term.unit("N.m") == unit


def test_the_library_of_a_joint_has_its_own_products_and_simple_terms_of_the_others() -> None:
    t = np.linspace(0.0, 4.0, 400)
    known = {SPEED: np.sin(3.0 * t), OTHER: np.cos(2.0 * t), LOAD: 5.0 + np.sin(t), TIME: t}
    found = {term.text: term for term in library([known], "1", 4.0, ("value",))}
    assert {"1", "qd[1]", "sgn(qd[1])", "qd[2]", "sgn(qd[1]) |load|", "qd[1] load", "t", "qd[1] t", "exp(-t/(1 s))"} <= set(found)
    assert not {"sgn(qd[2])", "qd[1] qd[2]"} & set(found)
    assert not {"sgn(load)", "|load|"} & set(found)  # never negative: the same as 1, and as the load
    made = found["sgn(qd[1]) |load|"].values(known, len(t))
    np.testing.assert_allclose(made, np.clip(known[SPEED] / (SLIDES * np.abs(known[SPEED]).max()), -1.0, 1.0) * known[LOAD], rtol=ROUNDOFF)


def test_what_changed_since_the_start_is_a_term_of_a_port_of_its_unit() -> None:
    t = np.linspace(0.0, 4.0, 400)
    known = {SPEED: np.sin(3.0 * t), MOVED: np.cos(2.0 * t) - 1.0, TIME: t}
    with_it = {term.text for term in library([known], "1", 4.0, unit="rad")}
    without = {term.text for term in library([known], "1", 4.0, unit="N.m")}
    assert with_it - without == {"(q[2] - q[2] at t = 0)"}
    assert without < with_it


def test_a_law_in_all_joints_has_the_index_of_each() -> None:
    """It is one law, whatever the scale of a root; a term of one certain joint is not the same in each, and decays keep their time."""
    root = Term((Factor("root", SPEED, 0.4),))
    assert root.pattern("1") == "sgn(qd[i]) sqrt(|qd[i]|)"
    assert root.pattern("1") == Term((Factor("root", replace(SPEED, name="qd[2]"), 0.7),)).pattern("2")
    assert Term((Factor("sign", SPEED, 0.1), Factor("size", LOAD))).pattern("1") == "sgn(qd[i]) |load|"
    assert Term((Factor("value", OTHER),)).pattern("1") == "qd[2]"
    assert Term((Factor("decay", TIME, 3.0),)).pattern("1") == "exp(-t/(3 s))"
    assert Term().pattern("1") == "1"
