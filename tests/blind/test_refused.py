"""Data that the diagnosis refuses are a log that was stopped, with the error as the reason."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from robomill.blind.make import make_case
from robomill.blind.prediction import Prediction
from robomill.blind.sets import Plan
from robomill.blind_command import diagnose_case


@pytest.mark.slow
def test_a_repeat_that_is_there_twice_is_a_stopped_log(tmp_path: Path) -> None:
    (tmp_path / "sealed").mkdir()
    make_case(tmp_path, Plan(1, "null", ()), seed=7, tier="T1")
    case = tmp_path / "cases" / "0001"
    shutil.copytree(case / "runs" / "training-1", case / "runs" / "training-again")
    diagnose_case(case, tmp_path)
    result = json.loads((tmp_path / "diagnosis.json").read_text())
    assert "training-again has the same signals but for rounding" in result["refused"]
    assert "a repeat has noise of its own" in result["refused"]
    assert Prediction.read(result).stopped
