"""robomill.blind.sealing: what was changed after it was sealed is refused or reported."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict

import pytest

from robomill.blind.case import Cases, load_cases
from robomill.blind.figures import figures
from robomill.blind.sealing import BenchmarkError, freeze_predictions, hashes, unseal
from robomill.blind.statistics import wilson
from tests.blind.by_hand import GAIN, benchmark, truth


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "cases" / "0001").mkdir(parents=True)
    (tmp_path / "cases" / "0001" / "system.toml").write_text("x = 1\n")
    (tmp_path / "sealed").mkdir()
    (tmp_path / "sealed" / "0001.json").write_text(json.dumps(truth("null", detectability=0.0)))
    manifest = json.dumps(hashes(tmp_path / "sealed"))
    (tmp_path / "sealed" / "manifest.json").write_text(manifest)
    head = benchmark(truth=hashlib.sha256(manifest.encode()).hexdigest(), files=hashes(tmp_path / "cases"))
    (tmp_path / "benchmark.json").write_text(json.dumps(head))
    (tmp_path / "predictions" / "0001").mkdir(parents=True)
    (tmp_path / "predictions" / "0001" / "diagnosis.json").write_text(json.dumps({"verdict": "none"}))
    return tmp_path


def test_predictions_are_hashed_before_the_truth_is_opened_and_later_changes_show(folder):
    frozen, first = freeze_predictions(folder)
    assert first
    assert frozen["0001/diagnosis.json"] == hashlib.sha256(b'{"verdict": "none"}').hexdigest()
    (folder / "predictions" / "0001" / "diagnosis.json").write_text(json.dumps({"verdict": "unknown"}))
    assert not freeze_predictions(folder)[1]


def test_what_an_interrupted_diagnosis_left_is_no_prediction(folder):
    (folder / "predictions" / ".0002.part").mkdir()
    (folder / "predictions" / ".0002.part" / "diagnosis.json").write_text("{}")
    assert list(freeze_predictions(folder)[0]) == ["0001/diagnosis.json"]


def test_a_truth_that_was_changed_is_refused(folder):
    assert load_cases(folder, unseal(folder)[1])[0].prediction.verdict == "none"
    (folder / "sealed" / "0001.json").write_text(json.dumps(truth("single", GAIN)))
    with pytest.raises(BenchmarkError, match=r"files differ from manifest\.json: the truth was changed"):
        unseal(folder)


def test_cases_that_were_changed_are_refused(folder):
    (folder / "cases" / "0001" / "system.toml").write_text("x = 2\n")
    with pytest.raises(BenchmarkError, match=r"changed since it was made: 0001/system\.toml"):
        unseal(folder)


def test_an_unreadable_prediction_is_missing(folder):
    (folder / "predictions" / "0001" / "diagnosis.json").write_text("{")
    assert load_cases(folder, unseal(folder)[1])[0].prediction.verdict == "missing"


def test_a_benchmark_with_other_keys_is_refused(folder):
    head = json.loads((folder / "benchmark.json").read_text())
    (folder / "benchmark.json").write_text(json.dumps(head | {"weather": "fair"}))
    with pytest.raises(BenchmarkError, match=r"other keys than this version writes: .*weather"):
        unseal(folder)


def test_no_benchmark_says_how_to_make_one(tmp_path):
    with pytest.raises(BenchmarkError, match="robomill blind make"):
        unseal(tmp_path)


def test_scores_are_plain_json(folder):
    scores = figures(Cases(load_cases(folder, unseal(folder)[1])))
    assert json.loads(json.dumps(asdict(scores["null_false_alarm"]), allow_nan=False)) == {
        "value": 0.0,
        "count": 1,
        "interval": list(wilson(0, 1)),
    }
