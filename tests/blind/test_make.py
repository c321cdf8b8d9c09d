"""Making, diagnosing and scoring a benchmark: what is in its folders, and that it is the same again."""

from __future__ import annotations

import json
import tomllib
from collections import Counter
from dataclasses import replace

import pytest

from robomill.blind import make as module
from robomill.blind.case import DETECTABLE
from robomill.blind.make import Request, campaign_conditions, make, make_case
from robomill.blind.run import run_cases
from robomill.blind.score import score
from robomill.blind.sealing import BenchmarkError, hashes, unseal
from robomill.blind.sets import Plan
from robomill.blind.signatures import apart
from robomill.blind.situation import situations
from robomill.blind.truth import Truth
from robomill.orchestration.errors import RunError
from robomill.orchestration.runs.run import Run


def test_a_machine_that_cannot_run_is_drawn_five_times(monkeypatch, tmp_path):
    """ATTEMPTS"""
    tried = []

    def fails(folder, plan, seed, tier, attempt):
        tried.append(attempt)
        raise RunError("out of reach", "drive", 0.0)

    monkeypatch.setitem(module.WRITERS, "first", fails)
    with pytest.raises(RunError, match="out of reach"):
        make_case(tmp_path, Plan(1, "null"), 1, "T1")
    assert tried == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("kind", "ratios", "kept"), [("withheld", (1.0, 2.0, 5.0), 5.0), ("single", (1.0,), 1.0), ("withheld", (1.0,) * 5, 1.0)]
)
def test_a_withheld_effect_is_drawn_until_it_is_clear(monkeypatch, tmp_path, kind, ratios, kept):
    left = list(ratios)
    monkeypatch.setitem(module.WRITERS, "first", lambda *_: Truth(kind, detectability=left.pop(0)))
    monkeypatch.setattr(module, "write_head", lambda *_: None)
    (tmp_path / "sealed").mkdir()
    make_case(tmp_path, Plan(1, kind), 1, "T1")
    assert json.loads((tmp_path / "sealed" / "0001.json").read_text())["detectability"] == kept
    assert left == []
    assert DETECTABLE == 3.0


def test_a_folder_of_another_benchmark_and_what_there_is_not_are_refused(tmp_path):
    (tmp_path / "request.json").write_text(json.dumps({"seed": 1}))
    with pytest.raises(ValueError, match="holds another benchmark"):
        make(tmp_path, Request(2, 1))
    with pytest.raises(ValueError, match="--tier T2: expected one of T0, T1"):
        make(tmp_path, Request(2, 1, "T2"))
    with pytest.raises(ValueError, match="--set best: expected one of"):
        make(tmp_path, Request(2, 1, set="best"))
    (tmp_path / "request.json").unlink()
    (tmp_path / "other").touch()
    with pytest.raises(ValueError, match="is not empty and holds no benchmark; choose another folder"):
        make(tmp_path, Request(2, 1))


def test_a_generator_that_is_not_there_is_named(monkeypatch, tmp_path):
    monkeypatch.delitem(module.WRITERS, "second", raising=False)
    with pytest.raises(ValueError, match="--generator both: no second generator; there is: first"):
        make(tmp_path / "b", Request(2, 1, generator="both"))


def test_a_campaign_file_has_each_condition_once_with_its_system_and_role():
    def info(condition, held):
        return {"labels": {"condition": condition, "held_out": held}}

    runs = {"cut-1": info("cut", False), "cut-held-1": info("cut", True), "push-1": info("push", False), "other-1": info("other", True)}
    found = {c["name"]: c for c in campaign_conditions(runs, {"push-1"})}
    assert found["cut"] == {"name": "cut", "system": "system.toml", "runs": ["runs/cut-1", "runs/cut-held-1"], "role": "diagnose"}
    assert found["push"]["system"] == "loaded_cell.toml"
    assert found["other"]["role"] == "held_out"


def say_none(case, out):
    """A diagnosis that never finds anything."""
    assert (case / "system.toml").is_file()
    (out / "diagnosis.json").write_text(json.dumps({"verdict": "none", "which": []}))


def fail(case, out):
    """A diagnosis that raises."""
    raise RuntimeError("no idea")


def test_a_diagnosis_that_fails_is_reported_and_tried_again(tmp_path):
    (tmp_path / "cases" / "0001").mkdir(parents=True)
    (tmp_path / "benchmark.json").write_text("{}")
    for _ in range(2):
        report = run_cases(tmp_path, fail, workers=1)
        assert report["failed"] == {"0001": "RuntimeError: no idea"}
        assert "Traceback" in (tmp_path / "predictions" / "0001" / "error.txt").read_text()


@pytest.mark.slow
def test_a_benchmark_from_making_to_score_and_the_same_bits_again(tmp_path):
    first, again = tmp_path / "a", tmp_path / "b"
    request = Request(2, 11, set="null")
    made = make(first, request)
    (again / "sealed").mkdir(parents=True)
    for plan in request.plans():
        make_case(again, plan, 11, "T1")
    assert hashes(again / "cases") == made.files
    assert hashes(again / "sealed") == json.loads((first / "sealed" / "manifest.json").read_text())
    report = run_cases(first, say_none, workers=1)
    assert (report["done"], report["failed"]) == (2, {})
    assert run_cases(first, say_none, workers=1)["before"] == 2
    result = score(first, isolability=False, baselines=False)
    assert result.predictions_as_first_unsealed
    assert (result.cases, result.set) == (2, "null")
    assert result.scores["all"]["null_false_alarm"].value == result.scores["first"]["null_false_alarm"].value == 0.0
    with pytest.raises(BenchmarkError, match="has been unsealed"):
        run_cases(first, say_none)


@pytest.mark.slow
def test_a_withheld_case_with_loads_has_a_campaign_and_says_what_is_withheld(tmp_path):
    request = Request(2, 12, set="withheld")
    make(tmp_path / "w", request)
    plan = next(p for p in request.plans() if p.shape == "loads")
    case = tmp_path / "w" / "cases" / f"{plan.number:04d}"
    runs = [Run.load(f) for f in sorted((case / "runs").iterdir())]
    assert Counter((r.info["labels"]["condition"], r.info["labels"]["held_out"]) for r in runs) == {
        ("training", False): 6,
        ("training", True): 2,
        ("pushes", False): 6,
        ("hanging weight", False): 6,
        ("other cut", True): 2,
        ("other pushes", True): 2,
    }
    assert tomllib.loads((case / "withheld.toml").read_text()) == {"effects": list(plan.subject)}
    listed = tomllib.loads((case / "campaign.toml").read_text())["condition"]
    assert {c["name"]: c["system"] for c in listed}["pushes"] == "loaded_cell.toml"
    assert not any("sealed" in f.name or "effect" in f.read_text() for f in (case / "runs").rglob("*.toml"))

    given = situations(case)
    assert [s.held_out for s in given] == [False] * 3 + [True] * 2
    other = situations(tmp_path / "w" / "cases" / f"{3 - plan.number:04d}")
    assert {s.key for s in given}.isdisjoint(s.key for s in other)
    assert replace(given[0], name="x") == given[0]
    _, truths = unseal(tmp_path / "w")
    assert truths[plan.number].kind == "withheld"
    assert set(truths[plan.number].ceiling) == {"other cut", "other pushes"}

    gain = {"sensor": {"sensor_gain_error": 0.1}}
    of_axes = {"sensor": {f"sensor_gain_error_axis[{i}]": 0.1 for i in range(1, 7)}}
    assert apart(given[0], "T1", gain, of_axes) < 0.1
    assert apart(given[0], "T1", gain, {}) > DETECTABLE
    assert apart(given[0], "T0", gain, {}) <= apart(given[0], "T1", gain, {})
