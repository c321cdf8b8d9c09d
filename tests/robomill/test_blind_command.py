"""`robomill blind` on the command line."""

from __future__ import annotations

import hashlib
import json

import pytest

from robomill.blind.sealing import hashes
from robomill.blind_command import CATALOGUE, lacking, withheld
from robomill.cli import main
from robomill.diagnosis.catalogue import Catalogue
from tests.blind.by_hand import benchmark


@pytest.fixture
def unsealed(tmp_path):
    """A benchmark of one null case, with the right answer, written by hand."""
    for part in ("cases/0001", "sealed", "predictions/0001"):
        (tmp_path / part).mkdir(parents=True)
    (tmp_path / "sealed" / "0001.json").write_text(json.dumps({"kind": "null", "effects": [], "detectability": 0.0, "conditions": []}))
    manifest = json.dumps(hashes(tmp_path / "sealed"))
    (tmp_path / "sealed" / "manifest.json").write_text(manifest)
    truth = hashlib.sha256(manifest.encode()).hexdigest()
    (tmp_path / "benchmark.json").write_text(json.dumps(benchmark(truth=truth)))
    (tmp_path / "predictions" / "0001" / "diagnosis.json").write_text(json.dumps({"verdict": "none"}))
    return tmp_path


def test_score_prints_all_keys_as_json_and_keeps_them(unsealed, capsys):
    assert main(["blind", "score", str(unsealed), "--no-baselines", "--no-isolability", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["scores"]["all"]["null_false_alarm"]["value"] == 0.0
    wanted = (
        "null_false_alarm bad_log_stopped detection component_top1 location_top1 effect_top1 effect_top3 ambiguity_holds_truth "
        "ambiguity_median_size unknown_recall false_unknown confident_wrong_on_unknown doubles_exact parameter_error_median "
        "interval_coverage closure_over_ceiling_median claimed_closure_error_median ece"
    )
    assert set(wanted.split()) <= set(result["scores"]["all"]) == set(result["scores"]["first"])
    assert all(set(figure) == {"value", "count", "interval"} for figure in result["scores"]["all"].values())
    assert json.loads((unsealed / "score.json").read_text()) == result


def test_score_prints_a_table(unsealed, capsys):
    assert main(["blind", "score", str(unsealed), "--no-baselines", "--no-isolability"]) == 0
    text = capsys.readouterr().out
    assert "set mixed, tier T1, 1 cases, 1 predictions" in text
    assert "null_false_alarm" in text


def test_no_benchmark_is_status_2_with_the_command_that_makes_one(tmp_path, capsys):
    assert main(["blind", "run", str(tmp_path)]) == 2
    assert "robomill blind make" in capsys.readouterr().err


def test_a_wrong_number_of_cases_or_set_is_refused(tmp_path, capsys):
    assert main(["blind", "make", str(tmp_path / "b"), "--cases", "0"]) == 2
    assert "--cases 0: expected at least 1" in capsys.readouterr().err
    assert main(["blind", "make", str(tmp_path / "b"), "--set", "best"]) == 2
    assert "--set best: expected one of withheld, null" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


def test_the_catalogue_of_a_case_lacks_what_is_withheld_at_all_places_and_no_other(tmp_path):
    full = Catalogue.load(CATALOGUE)
    assert lacking(full, withheld(tmp_path)).candidates == full.candidates
    (tmp_path / "withheld.toml").write_text('effects = ["sensor.sensor_gain_error_axis", "milling.runout"]\n')
    less = lacking(full, withheld(tmp_path))
    assert len(full.candidates) - len(less.candidates) == 7
    assert set(full.effects) - set(less.effects) == {"sensor_gain_axis", "runout"}


@pytest.mark.slow
def test_a_small_benchmark_from_making_to_its_page_with_the_real_diagnosis(tmp_path, capsys):
    folder, page = tmp_path / "b", tmp_path / "page.md"
    assert main(["blind", "make", str(folder), "--cases", "1", "--seed", "164", "--set", "withheld"]) == 0
    assert main(["blind", "run", str(folder)]) == 0
    prediction = json.loads((folder / "predictions" / "0001" / "diagnosis.json").read_text())
    assert prediction["schema"] == "robomill-diagnosis/1"
    assert prediction["verdict"] in ("none", "identified", "ambiguous", "unknown", "bad_log")
    assert prediction["time"]["cpu"] > 0.0
    capsys.readouterr()
    assert main(["blind", "score", str(folder), "--no-baselines", "--no-isolability", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["tier"], result["cases"], result["predictions"]) == ("T1", 1, 1)
    assert {kind: n for kind, n in result["kinds"].items() if n} == {"withheld": 1}
    assert result["scores"]["all"]["cpu_time_median"]["count"] == 1
    assert main(["blind", "page", str(folder), "--output", str(page)]) == 0
    assert "1 cases (1 withheld), generator first, seed 164" in page.read_text()
