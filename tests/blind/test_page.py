"""The page of results."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from robomill.blind.acceptance import bound
from robomill.blind.figures import figures
from robomill.blind.page import page, read_reasons
from robomill.blind.results import ALL, Score
from robomill.blind.sealing import BenchmarkError
from robomill.blind.set_figures import claims
from robomill.blind.statistics import Figure
from robomill.blind.tables import by_component, confusion, per_effect, strata
from robomill.cli import main
from tests.blind.by_hand import GAIN, STIFF, cases, entry, said, truth

RIGHT = said("identified", entry("sensor", "sensor_gain_error", 0.9))
SINGLES = (
    (truth("single", GAIN), RIGHT),
    (truth("single", STIFF, generator="second"), RIGHT),
    (truth("null", detectability=0.0), said("none")),
)
WITHHELD = ((truth("withheld", GAIN), said("unknown")), (truth("withheld", STIFF), RIGHT))
MACHINE = ((truth("machine", STIFF, GAIN), RIGHT),)


def score(name, pairs, tier="T1", **more):
    listed = cases(*pairs)
    parts = {ALL: listed, **{m: listed.of_generator(m) for m in ("first", "second")}}
    found = {
        "set": name,
        "tier": tier,
        "generator": "both",
        "seed": 5,
        "version": 3,
        "cases": len(pairs),
        "predictions": len(pairs),
        "predictions_as_first_unsealed": True,
        "isolability": True,
        "date": "2026-01-02 03:04 UTC",
        "commit": "abc1234",
        "kinds": {"null": 1, "single": 2, "bad_log": 0},
        "scores": {m: figures(part, tier) for m, part in parts.items()},
        "strata": strata(listed),
        "per_effect": per_effect(listed),
        "confusion": confusion(listed),
        "components": by_component(confusion(listed)),
        "claims": claims(listed, lambda _: (), lambda _: False),
        "wall": 30.0,
        "cpu": 24.0,
        "baselines": {"lasso": {"effect_top1": Figure(0.25, 2, (0.1, 0.5))}} if name == "single" else {},
    }
    return json.loads(json.dumps(asdict(Score(schema="robomill-blind-score/2", **found)) | more))


def row(text, *cells):
    start = f"| {' | '.join(cells)} |"
    return next(line for line in text.splitlines() if line.startswith(start))


def test_the_first_row_of_the_first_table_is_the_withheld_figure():
    text = page([score("single", SINGLES), score("withheld", WITHHELD)], "command")
    first = [line for line in text.splitlines() if line.startswith("|")]
    assert first[2] == (
        "| withheld_unknown_or_equivalent | withheld | T1 | 0.5 | 0.0945 .. 0.905 | 2 | 0.5 (2) |  | at least 0.85 | **no** |"
    )


def test_each_figure_has_count_interval_bound_and_generators_beside_it():
    text = page([score("single", SINGLES)], "command")
    # 1 of 2: Wilson 0.0945 .. 0.9055
    assert (
        row(text, "effect_top1", "single")
        == "| effect_top1 | single | T1 | 0.5 | 0.0945 .. 0.905 | 2 | 1 (1) | 0 (1) | at least 0.9 | **no** |"
    )
    assert row(text, "ambiguity_holds_truth", "single").endswith("|  |  | 0 |  |  | at least 0.95 |  |")
    assert "generator both, seed 5, version 3; 3 predictions, as they were when the truth was first opened." in text
    assert "Scored 2026-01-02 03:04 UTC, commit abc1234." in text
    assert "Points above the best of the baselines (15 are asked for): effect_top1 +25." in text
    assert row(text, "single", "T1") == "| single | T1 | 30.0 | 24.0 | 240 |"
    assert row(text, "effect_top1", "0.5") == "| effect_top1 | 0.5 | 0.0945 .. 0.905 | 2 | 1 | 0.207 .. 1 | 1 | 0 | 0 .. 0.793 | 1 |"


def test_the_calibration_counts_over_all_sets():
    text = page([score("single", SINGLES), score("withheld", WITHHELD), score("machine", MACHINE)], "command")
    # claimed with 0.9 four times, right twice: |0.9 - 0.5|
    assert row(text, "ece", "all sets", "T1", "0.4").split(" | ")[5:8] == ["4", "0.233 (3)", "0.9 (1)"]


def test_what_was_said_is_a_matrix_by_component_over_all_sets_and_a_list_by_effect():
    text = page([score("single", SINGLES), score("machine", MACHINE)], "command")
    assert "| true component | none | not named | sensor |" in text
    assert row(text, "compliance") == "| compliance |  | 1 | 1 |"
    assert row(text, "sensor") == "| sensor |  |  | 2 |"
    assert "| compliance.stiffness_error | sensor.sensor_gain_error 1, not named 1 |" in text


def test_two_tiers_stand_on_one_page_each_with_its_bounds():
    text = page([score("single", SINGLES, "T0", predictions_as_first_unsealed=False), score("single", SINGLES)], "command")
    assert text.index("## single, tier T1") < text.index("## single, tier T0")
    assert str(bound("effect_top1", "T0")) == "at least 0.8"
    assert "| at least 0.8 |" in row(text, "effect_top1", "single", "T0")
    assert "**changed after the truth was opened**" in text


def test_missed_bounds_have_their_reasons_from_the_file_beside_the_page(tmp_path):
    file = tmp_path / "reasons.toml"
    file.write_text('[[missed]]\nset = "single"\ntier = "T1"\nfigure = "effect_top1"\nreason = "Too few."\ntried = "More."\n')
    text = page([score("single", SINGLES)], "command", read_reasons(file))
    assert "- **effect_top1** (single, T1): 0.5, at least 0.9 is asked for. Too few. Tried: More." in text
    assert "- **component_top1** (single, T1): 0.5, at least 0.9 is asked for. No reason is given in reasons.toml." in text
    assert read_reasons(tmp_path / "none.toml") == {}
    file.write_text('[[missed]]\nset = "single"\n')
    with pytest.raises(BenchmarkError, match="entry 1 has the keys set; expected figure, reason, set, tier, tried"):
        read_reasons(file)
    file.write_text("[[missed]")
    with pytest.raises(BenchmarkError, match="not valid TOML"):
        read_reasons(file)


def test_what_is_scored_by_another_version_or_of_no_set_is_refused():
    with pytest.raises(BenchmarkError, match=r"score\.json has other keys than this version writes"):
        page([{"schema": "robomill-blind-score/1"}], "command")
    with pytest.raises(BenchmarkError, match=r"score\.json of the set best: expected one of withheld, null"):
        page([score("single", SINGLES, set="best")], "command")


def test_the_command_writes_it_and_refuses_what_has_not_been_scored(tmp_path, capsys):
    (tmp_path / "a").mkdir()
    assert main(["blind", "page", str(tmp_path / "a"), "--output", str(tmp_path / "page.md")]) == 2
    assert "has not been scored (no score.json); score it with: robomill blind score" in capsys.readouterr().err
    (tmp_path / "a" / "score.json").write_text(json.dumps(score("single", SINGLES)))
    assert main(["blind", "page", str(tmp_path / "a"), "--output", str(tmp_path / "page.md")]) == 0
    assert (tmp_path / "page.md").read_text().startswith("# The blind benchmark: results")


@pytest.mark.parametrize(("value", "kept"), [(0.02, True), (0.021, False)])
def test_a_bound_holds_up_to_its_value(value, kept):
    assert bound("null_false_alarm", "T1").holds(value) is kept
