"""Effect by effect: nested sets of the accepted effects, the last of which is the whole model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from robomill.diagnosis.candidates import Address
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.inference.estimation import Fit, Space
from robomill.diagnosis.outcome.closure import HowFar
from robomill.diagnosis.outcome.steps import Left, ranked, steps
from tests.diagnosis.demo import CATALOGUE, SYSTEM, measure, resolve
from tests.diagnosis.formula import candidate
from tests.tolerances import ROUNDOFF


def test_the_gap_shrinks_with_each_effect_and_ends_where_the_model_does(tmp_path: Path) -> None:
    (tmp_path / "catalogue.toml").write_text(CATALOGUE)
    both = {"masses": {"stiffness_error[2]": -0.08}, "sensors": {"gain_error[1]": 0.04}}
    held = measure(both, amplitude=1.5, repeats=2, seed=9)
    found = diagnose(SYSTEM, measure(both), Catalogue.load(tmp_path / "catalogue.toml"), held_out=held, resolver=resolve)
    answer = found.answer
    assert answer.steps is not None
    assert answer.steps.on == "held-out condition"
    assert sorted(s.effect for s in answer.steps.added) == ["gain @ sensor 1", "stiffness @ spring 2"]
    first, last = answer.steps.added
    for h in (h for h in answer.how_far if h.on == answer.steps.on):
        assert last.left[h.channel].after == pytest.approx(h.after, rel=ROUNDOFF)
        assert last.left[h.channel].closure == pytest.approx(h.closure, rel=ROUNDOFF)
    whole = "all channels, whitened"
    before = next(h.before for h in answer.how_far if h.on == answer.steps.on and h.channel == whole)
    assert before > 1.5 * first.left[whole].after > 1.5 * last.left[whole].after


def test_the_order_is_by_what_is_explained_of_what_is_left() -> None:
    """An effect that is like one before it explains little, however much it would explain alone."""
    one, twin, other = (candidate(name, scale=1.0) for name in ("a", "b", "c"))
    parts = np.array([[3.0, 0.0, 0.0], [2.4, 0.1, 0.0], [0.0, 0.0, 1.0]]).T
    y = parts.sum(axis=1)
    values = {c.addresses[0]: 1.0 for c in (other, twin, one)}
    fit = Fit((other, twin, one), values, {}, 0.0, 0.0, y, parts[:, ::-1])
    space = Space(y, {"run": slice(0, 3)}, np.zeros((3, 0)))
    assert [c.effect for c in ranked(fit, space)] == ["a", "b", "c"]
    assert np.array_equal(fit.signatures()[twin], parts[:, 1])
    alone = Space(np.array([3.0, 0.0, 1.0]), {"run": slice(0, 3)}, np.zeros((3, 0)))
    assert [c.effect for c in ranked(fit, alone)] == ["a", "c", "b"]


def test_an_effect_with_which_the_system_does_not_run_joins_the_next_one() -> None:
    """With the first one alone it runs away: of that no figure is left."""
    one, other = (candidate(name, scale=1.0) for name in ("a", "b"))
    y = np.array([3.0, 1.0])
    fit = Fit((one, other), {one.addresses[0]: 1.0, other.addresses[0]: 2.0}, {}, 0.0, 0.0, y, np.diag([3.0, 0.5]))
    figure = HowFar("force error rms", "c.f", "N", "held-out condition", 5.0, 0.5, 0.1, 0.99)

    class Runaway:
        hardest = "held-out condition"
        search = SimpleNamespace(evidence=SimpleNamespace(space=Space(y, {"run": slice(0, 2)}, np.zeros((2, 0)))))

        def of(self, changes: Mapping[Address, float], kinds: tuple[str, ...]) -> tuple[HowFar, ...]:
            assert kinds == (self.hardest,)
            return (figure,) if len(changes) > 1 else ()

    (step,) = steps(cast("Any", Runaway()), fit).added
    assert step.effect == f"{one.name} + {other.name}"
    assert step.left == {"c.f": Left(0.5, 0.99)}
