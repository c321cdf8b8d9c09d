"""What passes for an effect that is not in the catalogue."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict

import pytest

from robomill.blind import withhold as module
from robomill.blind.page import page
from robomill.blind.results import Withheld
from robomill.blind.sealing import BenchmarkError, hashes
from robomill.blind.withhold import row, shares, withhold
from robomill.blind_command import CATALOGUE, lacking
from robomill.cli import main
from robomill.diagnosis.catalogue import Catalogue
from tests.blind.by_hand import GAIN, STIFF, benchmark, entry, truth
from tests.blind.test_page import score


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A scored benchmark: a clear gain, a faint stiffness and a null; every effect is isolable."""
    monkeypatch.setattr(module, "oracle_confusable", lambda *_: lambda number, i: [])
    (tmp_path / "sealed").mkdir()
    listed = (truth("single", GAIN), truth("single", STIFF, detectability=1.0), truth("null", detectability=0.0))
    for i, t in enumerate(listed, 1):
        (tmp_path / "cases" / f"{i:04d}").mkdir(parents=True)
        (tmp_path / "sealed" / f"{i:04d}.json").write_text(json.dumps(t))
    manifest = json.dumps(hashes(tmp_path / "sealed"))
    (tmp_path / "sealed" / "manifest.json").write_text(manifest)
    head = benchmark(seed=7, truth=hashlib.sha256(manifest.encode()).hexdigest())
    (tmp_path / "benchmark.json").write_text(json.dumps(head))
    (tmp_path / "predictions.json").write_text("{}")
    return tmp_path


def say_unknown(case, out, without):
    """A diagnosis that names nothing; it notes what it was not to know."""
    (out / "diagnosis.json").write_text(json.dumps({"verdict": "unknown", "without": without}))


def fail(case, out, without):
    raise RuntimeError("no idea")


def test_clear_singles_are_diagnosed_without_their_effect_once(folder):
    result = withhold(folder, say_unknown, workers=1)
    assert [(r.case, r.effect, r.verdict) for r in result.cases] == [("0001", "sensor.sensor_gain_error", "unknown")]
    assert json.loads((folder / "withheld" / "0001" / "diagnosis.json").read_text())["without"] == "sensor.sensor_gain_error"
    assert result.figures["unknown"].value == 1.0
    assert withhold(folder, fail, workers=1).failed == {}  # what is there is not done again


def test_one_that_cannot_be_diagnosed_is_reported_and_left_out(folder):
    result = withhold(folder, fail, workers=1)
    assert result.failed == {"0001": "RuntimeError: no idea"}
    assert (result.cases, result.figures["unknown"].value) == ([], None)


def test_a_sealed_benchmark_stays_sealed(folder, capsys):
    (folder / "predictions.json").unlink()
    with pytest.raises(
        BenchmarkError, match=r"is sealed \(no predictions\.json\): to withhold an effect it must be known; first: robomill blind score"
    ):
        withhold(folder, say_unknown)
    assert main(["blind", "withhold", str(folder)]) == 2
    assert "robomill blind score" in capsys.readouterr().err


def test_the_catalogue_lacks_that_effect_at_all_places_and_no_other():
    full = Catalogue.load(CATALOGUE)
    less = lacking(full, "sensor.sensor_gain_error_axis")
    assert len(full.candidates) - len(less.candidates) == 6
    assert set(full.effects) - set(less.effects) == {"sensor_gain_axis"}
    assert lacking(full, None).candidates == full.candidates


def test_the_page_shows_what_passed_for_what():
    named = {"verdict": "identified", "which": [entry("sensor", "cross_talk", 0.9)]}
    rows = [row("0001", "sensor.sensor_gain_error", {"verdict": "unknown"}), row("0002", "sensor.sensor_gain_error", named)]
    text = page([score("T1", withheld=asdict(Withheld("T1", 5, shares(rows), rows, {})))], "command")
    part = text[text.index("### Without the true effect in the catalogue (T1)") :]
    assert "| unknown | 0.5 | 0.0945 .. 0.905 | 2 |" in part
    assert "| sensor.sensor_gain_error | identified | sensor.cross_talk | 0.90 |" in part
    assert "Each of them came as `unknown`." in page(
        [score("T1", withheld=asdict(Withheld("T1", 5, shares(rows[:1]), rows[:1], {})))], "command"
    )
