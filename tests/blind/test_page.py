"""The page of results."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from robomill.blind.acceptance import bound
from robomill.blind.figures import figures
from robomill.blind.page import page
from robomill.blind.results import Score
from robomill.blind.statistics import Figure
from robomill.blind.tables import confusion, per_effect, strata
from robomill.cli import main
from tests.blind.by_hand import GAIN, STIFF, cases, entry, said, truth


def score(tier, **more):
    right = said("identified", entry("sensor", "sensor_gain_error", 0.9))
    listed = cases((truth("single", GAIN), right), (truth("single", STIFF), right), (truth("null", detectability=0.0), said("none")))
    found = {
        "tier": tier,
        "seed": 5,
        "version": 2,
        "cases": 3,
        "predictions": 3,
        "predictions_as_first_unsealed": True,
        "isolability": True,
    }
    found |= {"date": "2026-01-02 03:04 UTC", "commit": "abc1234", "kinds": {"null": 1, "single": 2, "bad_log": 0}}
    found |= {"scores": figures(listed, tier), "strata": strata(listed), "per_effect": per_effect(listed), "confusion": confusion(listed)}
    baselines = {"lasso": {"effect_top1": Figure(0.25, 2, (0.1, 0.5))}}
    return json.loads(json.dumps(asdict(Score(schema="robomill-blind-score/1", baselines=baselines, **found)) | more))


def row(text, key):
    return next(line for line in text.splitlines() if line.startswith(f"| {key} |"))


def test_each_figure_has_count_interval_bound_and_baselines_beside_it():
    text = page([score("T1")], "command")
    # 1 of 2: Wilson 0.0945 .. 0.9055
    assert row(text, "effect_top1") == "| effect_top1 | 0.5 | 0.0945 .. 0.905 | 2 | at least 0.9 | **no** | 0.25 |"
    assert row(text, "null_false_alarm").split(" | ")[4:6] == ["at most 0.02", "yes"]
    assert row(text, "doubles_exact") == "| doubles_exact |  |  | 0 | at least 0.65 |  |  |"
    assert row(text, "compliance.stiffness_error").startswith("| compliance.stiffness_error | 1 | 1 | 1 | 1 | 0 |")
    assert "| compliance.stiffness_error | sensor.sensor_gain_error 1 |" in text
    assert "Points above the best of the baselines (15 are asked for): effect_top1 +25." in text
    assert "seed 5, generator version 2; 3 predictions, as they were when the truth was first opened." in text
    assert "Scored 2026-01-02 03:04 UTC, commit abc1234." in text


def test_two_tiers_stand_on_one_page_each_with_its_bounds():
    text = page([score("T1"), score("T0", predictions_as_first_unsealed=False)], "command")
    assert text.index("## Tier T1") < text.index("## Tier T0")
    assert str(bound("effect_top1", "T0")) == "at least 0.8"
    assert "| at least 0.8 |" in text[text.index("## Tier T0") :]
    assert "**changed after the truth was opened**" in text


def test_the_command_writes_it_and_refuses_what_has_not_been_scored(tmp_path, capsys):
    (tmp_path / "a").mkdir()
    assert main(["blind", "page", str(tmp_path / "a"), "--output", str(tmp_path / "page.md")]) == 2
    assert "has not been scored (no score.json); score it with: robomill blind score" in capsys.readouterr().err
    (tmp_path / "a" / "score.json").write_text(json.dumps(score("T1")))
    assert main(["blind", "page", str(tmp_path / "a"), "--output", str(tmp_path / "page.md")]) == 0
    assert (tmp_path / "page.md").read_text().startswith("# The blind benchmark: results")


@pytest.mark.parametrize(("value", "kept"), [(0.02, True), (0.021, False)])
def test_a_bound_holds_up_to_its_value(value, kept):
    assert bound("null_false_alarm", "T1").holds(value) is kept
