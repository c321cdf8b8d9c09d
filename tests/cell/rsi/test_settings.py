"""Link files: what is wrong is said with file, line and what is possible."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomill.cell.rsi.settings import LinkError, load_link
from tests import SCENARIOS

FILE = SCENARIOS / "rsi" / "link.toml"
TEXT = FILE.read_text(encoding="utf-8")
SYSTEM = """
name = "small"
step = "4 ms"
[components.drive]
source = "robot_drive"
[components.controller]
source = "compensation_controller"
[[connections]]
from = "drive.q_motor"
to = "controller.q_motor"
[[connections]]
from = "controller.correction_B"
to = "drive.correction_B"
delayed = true
"""
LINK = """
[link]
name = "small"
system = "small.toml"
partner = ["controller"]
ethernet = "ethernet.xml"
[robot]
planned = "drive.q_link"
[watchdog]
silence = "20 ms"
[[send]]
element = "AIPos"
port = "drive.q_motor"
unit = "deg"
[[receive]]
elements = ["RKorr.X", "RKorr.Y", "RKorr.Z"]
port = "controller.correction_B"
unit = "mm"
limit = "5 mm"
"""


def written(folder: Path, text: str = LINK) -> Path:
    (folder / "small.toml").write_text(SYSTEM)
    (folder / "ethernet.xml").write_text((SCENARIOS / "rsi" / "ethernet.xml").read_text())
    (folder / "link.toml").write_text(text)
    return folder / "link.toml"


def test_a_link_is_read(tmp_path: Path) -> None:
    link = load_link(written(tmp_path))
    assert [s.array for s in link.send] == ["drive.q_motor"]
    assert link.send[0].names == tuple(f"AIPos.A{i}" for i in range(1, 7))
    assert (link.receive[0].factor, link.receive[0].limit) == (1e-3, 5.0)
    assert (link.watch.silence, link.watch.ramp, link.watch.gap) == (0.02, 0.2, 10)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('system = "small.toml"\n', "", "link.toml:2: [link]: one of scenario (with variant) and system is needed, and not both"),
        ('"small.toml"', '"small.toml"\nvariant = "x"', "variant: goes with a scenario"),
        ('["controller"]', '["kontroller"]', "unknown component 'kontroller'; did you mean 'controller'?"),
        ('["controller"]', '["controller", "drive"]', "neither all nor none"),
        ('element = "AIPos"', 'element = "AIPoss"', "unknown element 'AIPoss'; did you mean 'AIPos' or 'ASPos'?"),
        ('element = "AIPos"', "", "one of element (a whole tag) and elements (a list) is needed, and not both"),
        ('"RKorr.Z"]', '"RKorr.Q"]', "unknown element 'RKorr.Q'"),
        ('"RKorr.Z"]', '"RKorr.Y"]', "RKorr.Y stands for two ports; an element is one value"),
        (', "RKorr.Z"]', "]", "2 elements of the telegram (RKorr.X, RKorr.Y), but controller.correction_B has 3"),
        ('port = "drive.q_motor"', 'port = "drive.motor"', "unknown output of 'drive': 'motor'"),
        ('port = "drive.q_motor"', 'port = "controller.r_B"', "unknown component of the robot's side 'controller'"),
        ('unit = "deg"', 'unit = "mm"', "'mm' does not measure what drive.q_motor is in: rad"),
        ('limit = "5 mm"', 'limit = "0 mm"', "expected a positive value in mm"),
        ('limit = "5 mm"', 'limit = "5 deg"', "5 deg cannot be expressed in mm"),
        ('silence = "20 ms"', 'silence = "1 s"', "end (0.4 s) must be longer than silence (1 s)"),
        ('silence = "20 ms"', "gap = 0", "expected a whole number, at least 1; found 0"),
        ('name = "small"', 'name = "small"\ndecimals = 13', "expected 0 to 12; found 13"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in LINK
    file = written(tmp_path, LINK.replace(old, new, 1))
    with pytest.raises(LinkError) as caught:
        load_link(file)
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"{file}:")


def test_a_robot_that_takes_no_answers_is_refused(tmp_path: Path) -> None:
    file = written(tmp_path)
    xml = tmp_path / "ethernet.xml"
    xml.write_text(xml.read_text().replace(">FALSE<", ">TRUE<"))
    with pytest.raises(LinkError, match="ONLYSEND is TRUE: the robot takes no answers; set it to FALSE"):
        load_link(file)


def test_no_link_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no link file"):
        load_link(tmp_path / "link.toml")
