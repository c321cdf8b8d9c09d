"""Adopted effects as an SSP parameter set, and what `robomill run --adopt` makes of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from robomill.cli import main
from robomill.diagnosis.outcome import adopt
from robomill.orchestration.errors import SystemFileError

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
    assert found == {
        "drive": {"backlash[2]": {"value": 0.1 + 0.2, "unit": None}},
        "sensor": {"cross_talk": {"value": -1e-17, "unit": None}},
    }


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("<ssv:Parameters>", "", "not valid XML"),
        ("drive.backlash", "backlash", "parameter 'backlash'; expected component.parameter"),
        ("0.5", "half", "parameter 'drive.backlash' = 'half' is not of type Real"),
        ("0.5", "nan", "'nan' is not of type Real"),
        ("0.5", "1_0", "'1_0' is not of type Real"),
        ("ssv:Real", "ssv:Binary", "parameter 'drive.backlash' is of type Binary; expected a value of type Real"),
        (
            "</ssv:Parameters>",
            '<ssv:Parameter name="drive.backlash"><ssv:Real value="1"/></ssv:Parameter></ssv:Parameters>',
            "parameter 'drive.backlash' is there twice",
        ),
        ("<ssv:ParameterSet", "<!DOCTYPE a><ssv:ParameterSet", "has a document type declaration or entities"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, text: str) -> None:
    file = adopt.write({("drive", "backlash"): 0.5}, tmp_path / "adopt.ssv")
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(SystemFileError, match=text):
        adopt.read(file)


def test_a_run_takes_the_adopted_values(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.toml").write_text(SYSTEM)
    file = adopt.write({("compliance", "thermal_growth"): 1e-4}, tmp_path / "adopt.ssv")
    assert main(["run", str(tmp_path / "s.toml"), "--adopt", str(file), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rows"] == 3
    assert '"thermal_growth" = 0.0001' in (tmp_path / "out" / "run.toml").read_text().replace("thermal_growth =", '"thermal_growth" =')


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('value="0.0001"', 'value="0.1" unit="mm"', ""),
        (
            'value="0.0001"',
            'value="0.1" unit="N"',
            "adopt.ssv: component 'compliance': parameter 'thermal_growth': 0.1 N cannot be expressed in m",
        ),
        (
            'value="0.0001"',
            'value="0.1" unit="furlong"',
            "adopt.ssv: component 'compliance': parameter 'thermal_growth': unknown unit 'furlong'; units that fit: mm",
        ),
        (
            "thermal_growth",
            "thermal_groth",
            "adopt.ssv: component 'compliance': unknown parameter 'thermal_groth'; did you mean 'thermal_growth'",
        ),
        (
            "compliance.",
            "complience.",
            "adopt.ssv: parameter 'complience.thermal_growth': unknown component 'complience'; did you mean 'compliance'",
        ),
    ],
)
def test_units_are_converted_and_what_does_not_fit_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, text: str
) -> None:
    (tmp_path / "s.toml").write_text(SYSTEM)
    file = adopt.write({("compliance", "thermal_growth"): 1e-4}, tmp_path / "adopt.ssv")
    file.write_text(file.read_text().replace(old, new, 1))
    status = main(["run", str(tmp_path / "s.toml"), "--adopt", str(file), "--out", str(tmp_path / "out")])
    if text:
        assert (status, text in capsys.readouterr().err) == (2, True)
    else:
        assert status == 0
        assert "thermal_growth = 0.0001" in (tmp_path / "out" / "run.toml").read_text()


def test_a_scenario_that_would_ignore_it_refuses_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = adopt.write({("drive", "backlash"): 1e-4}, tmp_path / "adopt.ssv")
    for scenario, kind in (("static_loads.toml", "static_loads"), ("experiments/tap_test.toml", "experiment")):
        assert main(["run", f"scenarios/{scenario}", "--adopt", str(file), "--resume", "--out", str(tmp_path / "out")]) == 2
        assert (
            f"--adopt, --resume: only with milling scenarios, system files and packages; scenarios/{scenario} is of the kind {kind}"
            in capsys.readouterr().err
        )


def test_effects_that_the_system_does_not_have_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.toml").write_text(SYSTEM)
    file = adopt.write({("drive", "backlash"): 1e-4}, tmp_path / "adopt.ssv")
    assert main(["run", str(tmp_path / "s.toml"), "--adopt", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "drive" in capsys.readouterr().err
