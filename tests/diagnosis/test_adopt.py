"""Adopted effects as an SSP parameter set, and what `robomill run --adopt` makes of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from diagnosis import adopt
from diagnosis.adopt import AdoptError
from robomill.cli import main

SYSTEM = """
name = "static"
step = "4 ms"
stop = "8 ms"
[components.compliance]
source = "robot_compliance"
"""


def test_what_is_written_is_read_to_the_last_bit_without_the_log(tmp_path: Path) -> None:
    values = {("drive", "backlash[2]"): 0.1 + 0.2, ("sensor", "cross_talk"): -1e-17, ("logging", "lag x.*"): 0.01}
    found = adopt.read(adopt.write(values, tmp_path / "adopt.ssv"))
    assert found == {"drive": {"backlash[2]": 0.1 + 0.2}, "sensor": {"cross_talk": -1e-17}}


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("<ssv:Parameters>", "", "not valid XML"),
        ("SSP1/System", "SSP2/System", "expected an SSP 1.0 ParameterSet"),
        ("drive.backlash", "backlash", "expected a Real called component.parameter"),
        ("0.5", "half", "'half' is not a number"),
        ("<ssv:ParameterSet", "<!DOCTYPE a><ssv:ParameterSet", "document types and entities are not read"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, text: str) -> None:
    file = adopt.write({("drive", "backlash"): 0.5}, tmp_path / "adopt.ssv")
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(AdoptError, match=text):
        adopt.read(file)


def test_a_run_takes_the_adopted_values(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.toml").write_text(SYSTEM)
    file = adopt.write({("compliance", "thermal_growth"): 1e-4}, tmp_path / "adopt.ssv")
    assert main(["run", str(tmp_path / "s.toml"), "--adopt", str(file), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rows"] == 3
    assert '"thermal_growth" = 0.0001' in (tmp_path / "out" / "run.toml").read_text().replace("thermal_growth =", '"thermal_growth" =')


def test_effects_that_the_system_does_not_have_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.toml").write_text(SYSTEM)
    file = adopt.write({("drive", "backlash"): 1e-4}, tmp_path / "adopt.ssv")
    assert main(["run", str(tmp_path / "s.toml"), "--adopt", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "drive" in capsys.readouterr().err
