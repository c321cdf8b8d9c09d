"""Stand-ins: an effect whose law is not that of the machine is beaten in its place, one whose law is that of the machine is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.forms.instead import LITTLE, Exchanged, Instead, Laws, Port, better, everywhere, shared
from robomill.diagnosis.forms.library import Term
from robomill.diagnosis.forms.ports import Problem
from robomill.diagnosis.forms.selection import Rows
from robomill.diagnosis.inference.adequacy import FALSE_ALARM
from robomill.diagnosis.inference.machines import MACHINES
from robomill.diagnosis.outcome.verdict import IDENTIFIED
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis import axis
from tests.diagnosis.forms.test_selection import NAMES, T, noise, rows, terms
from tests.diagnosis.formula import candidate
from tests.tolerances import ROUNDOFF

V, SIGN = NAMES.index("v"), NAMES.index("sgn v")


def port(law: FloatArray, X: FloatArray, true: FloatArray, rest: FloatArray, name: str = "a.y") -> Port:
    """An output whose gap is `true` + `rest`, with a model that has `law` [n] at its best size; the terms of the library are X."""
    gap = true + rest
    fitted = law * float(law @ gap) / float(law @ law)
    named = [("y", cast(Term, SimpleNamespace(text=n, pattern=lambda index, n=n: n))) for n in NAMES]
    made: Rows = rows(gap - fitted, X)
    return Port(name, cast(Problem, SimpleNamespace(terms=named)), made, {candidate("rubbing"): fitted})


@pytest.mark.parametrize("memory", [0.0, 0.05])
def test_a_stand_in_is_beaten_by_the_law_of_the_machine(memory: float) -> None:
    rng = np.random.default_rng(1)
    X = terms(rng)
    (found,) = better(Exchanged(port(X[:, V], X, X[:, SIGN], 0.2 * noise(rng, memory)), False), 1)
    assert (found.effect, found.ports, found.law) == (candidate("rubbing").name, ("a.y",), "sgn v")
    assert found.gain > LITTLE
    assert found.p == 1.0 / (1 + MACHINES)


@pytest.mark.parametrize("memory", [0.0, 0.05])
def test_the_right_law_is_not(memory: float) -> None:
    """Not even where it leaves much, and is not quite that of the library."""
    alarms = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        X = terms(rng)
        smooth = np.tanh(X[:, V] / 0.05)
        alarms += any(x.p <= FALSE_ALARM for x in better(Exchanged(port(smooth, X, smooth, 0.7 * noise(rng, memory)), False), 1))
    assert alarms <= 1  # FALSE_ALARM of ten, and what chance does to them


def test_the_more_tries_the_less_a_rank_says() -> None:
    rng = np.random.default_rng(1)
    X = terms(rng)
    made = Exchanged(port(X[:, V], X, X[:, SIGN], 0.2 * noise(rng, 0.0)), True)
    one, many = (better(made, tries)[0].p for tries in (1, 20))
    assert many == pytest.approx(20.0 * one, rel=ROUNDOFF)
    assert better(made, 10 * MACHINES)[0].p == 1.0


def test_what_does_better_by_little_says_nothing() -> None:
    rng = np.random.default_rng(1)
    X = terms(rng)
    nearly = X[:, SIGN] + 0.02 * X[:, V]
    assert better(Exchanged(port(X[:, SIGN], X, nearly, 0.02 * noise(rng, 0.0)), True), 1) == []


def test_what_is_there_in_one_block_of_time_only_is_no_rival() -> None:
    """Something that dies away at the beginning; the other blocks have a little of it left, and foretell it by that."""
    rng = np.random.default_rng(1)
    X = terms(rng)
    X[:, NAMES.index("t")] = np.exp(-T)  # three quarters of its squares are in the first sixth of the time
    right, dies = 0.2 * X[:, SIGN], np.exp(-T)
    assert better(Exchanged(port(right, X, right, 2.0 * dies), True), 1) == []
    X[:, NAMES.index("t")] = np.exp(-T / 20.0)  # what goes on is one
    assert [x.law for x in better(Exchanged(port(right, X, right, 2.0 * np.exp(-T / 20.0)), True), 1)] == ["t"]


def joints(seed: int, law: int, true: int, count: int = 4) -> list[Exchanged]:
    """Outputs of several joints, whose gaps are nearly lost in noise with a memory; in the model of each is the same `law`."""
    made = []
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        X = terms(rng)
        made.append(Exchanged(port(X[:, law], X, X[:, true], 2.5 * noise(rng, 0.05), f"a.y[{i + 1}]"), False))
    return made


def test_what_chance_does_in_one_joint_it_does_not_do_in_all() -> None:
    """The stand-in is beaten in all of the joints together more often than in any single one."""
    alone = together = 0
    for seed in range(5):
        tried = joints(seed, V, SIGN)
        alone += any(x.p <= FALSE_ALARM for t in tried for x in better(t, len(tried) + 1))
        ((kind, places),) = shared(tried).items()
        found = [x for x in everywhere(kind, places, len(tried) + 1) if x.p <= FALSE_ALARM]
        together += bool(found)
        assert all((x.effect, x.law, len(x.ports)) == ("rubbing", "sgn v", 4) for x in found)
    assert alone < together


def test_the_right_law_is_not_beaten_in_all_joints() -> None:
    for seed in range(5):
        tried = joints(seed, SIGN, SIGN)
        ((kind, places),) = shared(tried).items()
        assert everywhere(kind, places, 1) == []


def test_a_kind_in_one_output_is_not_shared() -> None:
    assert shared(joints(0, V, SIGN, count=1)) == {}


def test_doubt_is_that_of_the_port_and_of_the_kind() -> None:
    beaten, beside, elsewhere, other = (replace(candidate(e), location=p) for e, p in (("a", "1"), ("b", "1"), ("a", "2"), ("b", "2")))
    empty = cast(Any, None)
    ports = [Port(f"x.y[{i + 1}]", empty, empty, dict.fromkeys(of, empty)) for i, of in enumerate(((beaten, beside), (elsewhere, other)))]
    found = Laws.of([Instead(beaten.name, ("x.y[1]",), "v", 0.1, 0.01)], ports)
    assert [found.belief(c) for c in (beaten, beside, elsewhere, other)] == [0.01, 0.01, 0.01, 1.0]
    assert Laws().belief(beaten) == 1.0
    everywhere_ = Laws.of([Instead("a", ("x.y[1]", "x.y[2]"), "v", 0.1, 0.01)], ports)
    assert [everywhere_.belief(c) for c in (beaten, beside, elsewhere, other)] == [0.01] * 4


def answer(folder: Path, truth: dict[str, float], without: str = "") -> dict[str, Any]:
    known = axis.catalogue(folder)
    known = replace(known, candidates=tuple(c for c in known.candidates if c.effect not in (without, "clock")))
    return diagnose(axis.system(), axis.measure(truth, repeats=1), known, resolver=axis.resolve).result


def test_an_axis_without_its_friction_in_the_catalogue_is_unknown(tmp_path: Path) -> None:
    truth = {"coulomb": 1.0, "angle_offset": 0.0}
    whole, rest = answer(tmp_path, truth), answer(tmp_path, truth, "coulomb")
    assert whole["verdict"] == "identified"
    assert whole["which"][0]["effect"] == "coulomb"
    assert rest["verdict"] == "unknown"
    assert max(w["probability"] for w in rest["which"]) < IDENTIFIED
