"""diagnosis.json: which keys there are and in which order, whatever the records are called."""

from __future__ import annotations

import json
from dataclasses import replace

from robomill.diagnosis.inference.transfer import Transfer
from robomill.diagnosis.localisation.localise import Dependence
from robomill.diagnosis.localisation.swap import Share
from robomill.diagnosis.localisation.where import Replayed, Where
from robomill.diagnosis.outcome import verdict
from robomill.diagnosis.outcome.answer import Answer, Estimate, Gap, Unknown, Which, as_json, to_json
from robomill.diagnosis.outcome.closure import HowFar

FIRST = ["schema", "verdict", "gate", "where", "which", "families", "how_far", "next_run"]
GAP = Gap(1.0, 0.1, 0.0, 0.1, 0.02, noise_is_a_guess=False)
FITTED = Where("drive", 0.9, [0.8, 1.0], "joint 3", "B.y", "compliance.p_BT_B[2]", [[0.0, 1.0]])
REPLAYED = Replayed("drive", 0.9, None, "", "B.y", "compliance.p_BT_B[2]", [], 20.0, ("sensor",), ("drive.q",), None, {}, [])


def test_sections_that_an_answer_does_not_have_are_not_there() -> None:
    refused, fitted = to_json(Answer("bad_log")), to_json(Answer("ambiguous", gap=GAP))
    assert list(refused) == [*FIRST, "skipped", "effort"]
    assert list(fitted) == [*FIRST, "gap", "effort", "skipped"]
    assert (refused["gate"]["usable"], fitted["gate"]["usable"]) == (False, True)
    assert refused["next_run"] is None


def test_what_replay_adds_to_a_component_is_not_there_without_it() -> None:
    plain = ["component", "share", "interval", "location", "direction", "channel", "regime"]
    told = {"log_odds": 20.0, "alternatives": (), "outputs": ("drive.q",), "shares": {}, "dependence": []}
    where = to_json(Answer("identified", where=(FITTED, replace(FITTED, **told), REPLAYED)))["where"]
    assert [list(w) for w in where[:2]] == [plain, [*plain, *told]]
    first = ["component", "share", "interval", "log_odds", "alternatives", "outputs", "location", "nearest"]
    assert list(where[2]) == [*first, "direction", "channel", "regime", "shares", "dependence"]
    assert (where[2]["nearest"], where[2]["interval"]) == (None, None)


def test_numbers_that_there_are_none_of_are_null() -> None:
    shares = {"sensor.f": Share("sensor.f", "drive", 0.5, None)}
    answer = Answer(
        "unknown",
        where=(replace(REPLAYED, shares=shares, dependence=[Dependence("frequency 1 .. 2 Hz", 0.5, None)]),),
        which=(Which("backlash", "drive", "joint 3", 0.9, {"backlash[3]": Estimate(8e-5, [7e-5, 9e-5], "rad")}, []),),
        how_far=(HowFar("all", "all", "1", "diagnosed runs", 1.0, 0.9, 0.1, measurable=False, why_no_ceiling="small"),),
        transfer=(moved := Transfer(4.0, 1.0, 100.0, 100.0, 0.1, 0.9, 0.05)),
        tests=verdict.Tests(0.02, 0.0005, 0.97, 0.001),
        unknown=Unknown({"drive.q": 0.7, "sensor.f": 0.3}, "drive", "drive.q", [], "nominal"),
    )
    data = json.loads(as_json(to_json(answer)))
    assert data["where"][0]["shares"] == {"sensor.f": {"share": 0.5, "interval": None}}
    assert data["where"][0]["dependence"] == [{"variable": "frequency 1 .. 2 Hz", "share": 0.5, "p": None}]
    assert data["which"][0]["parameters"] == {"backlash[3]": {"value": 8e-5, "interval": [7e-5, 9e-5], "unit": "rad"}}
    nothing = dict.fromkeys(["closure", "interval", "ceiling", "ceiling_by", "ratio"])
    assert data["how_far"][0].items() >= (nothing | {"measurable": False, "why_no_ceiling": "small"}).items()
    assert list(data["transfer"]) == [
        "before",
        "after",
        "gain",
        "expected_gain",
        "doubt",
        "amplitude",
        "deviation",
        "misfit",
        "conditions",
        "worse",
        "promise",
        "worth",
    ]
    assert (data["transfer"]["promise"], data["transfer"]["worth"]) == (moved.promise, moved.worth)
    assert data["tests"] == {"false_alarm": 0.02, "p_none": 0.0005, "p_fit": 0.97, "nothing": 0.001}
    assert data["unknown"]["channels"] == [{"channel": "drive.q", "share": 0.7}, {"channel": "sensor.f", "share": 0.3}]
    assert "changes" not in data["unknown"]
