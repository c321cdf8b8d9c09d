"""Mistakes of a first day: each text says what is wrong, the value, what is expected or there, and what helps."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from robomill.cli import REMEDIES, main
from robomill.example_command import copy

AXIS = "servo_axis"
NOTHING_OVERRIDES_RIGHTS = ["setpriv", "--bounding-set", "-dac_override,-dac_read_search", "--inh-caps", "-dac_override,-dac_read_search"]
"""Root, too, may then not write where nobody may."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with the servo axis in `axis` and the groove in `mill`; commands are given in it."""
    monkeypatch.chdir(tmp_path)
    copy(AXIS, Path("axis"))
    copy("groove", Path("mill"))
    yield tmp_path
    sys.modules.pop(AXIS, None)  # this copy of it: another test has one of its own


def alone(command: str, *before: str) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own: two modules of one name, as two copies of an example have, do not fit in one."""
    return subprocess.run([*before, sys.executable, "-m", "robomill", *command.split()], capture_output=True, text=True, check=False)


def refused(command: Sequence[str], capsys: pytest.CaptureFixture[str]) -> str:
    """What a command that cannot run says."""
    capsys.readouterr()
    try:
        status = main(command)
    except SystemExit as end:
        status = int(end.code or 0)
    assert status == 2
    return capsys.readouterr().err.strip().splitlines()[-1]


WRONG_FILES = {
    "a folder": (
        "run mill",
        "robomill run: mill is a folder; expected a scenario; TOML files in that folder: catalogue.toml, groove.toml, milling_cell.toml",
    ),
    "nothing": ("run nothing.toml", "robomill run: no scenario nothing.toml; TOML files in that folder: none; correct the path"),
    "a program": (
        "run mill/groove.ngc",
        "robomill run: mill/groove.ngc is a program, expected a scenario: `robomill plan mill/groove.ngc` looks at the program; "
        "a scenario that names it mills it: `robomill example groove` copies one",
    ),
    "a catalogue": (
        "run axis/map.toml",
        "robomill run: axis/map.toml is neither a scenario (no table scenario) nor a system (no step, no connections); "
        "it has log, clock, components, labels, parameters, signal; name another file, or see what `robomill example` copies",
    ),
    "a scenario as a system": (
        "diagnose mill/groove.toml runs --out d",
        "robomill diagnose: groove.toml:1: [scenario]: this file is a scenario; expected a system file, such as the one that its "
        "[scenario] names as system",
    ),
    "a log that is not there": ("import axis/map.toml nothing.csv --out r", "robomill import: no log file nothing.csv; correct the path"),
    "a log as a mapping": (
        "import nothing.csv axis/map.toml --out r",
        "robomill import: nothing.csv is no mapping; give the mapping first, then the log: axis/map.toml nothing.csv",
    ),
    "a log as a run": (
        "diagnose axis/system.toml axis/map.toml --out d",
        "robomill diagnose: no run folder axis/map.toml; give a folder that `robomill run` or `robomill import` has written",
    ),
}


@pytest.mark.parametrize("name", WRONG_FILES)
def test_a_wrong_file(name: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command, text = WRONG_FILES[name]
    assert refused(command.split(), capsys) == text


def test_an_option_that_is_not_there(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(["run", "mill/groove.toml", "--variants", "cartesian"], capsys)
    assert said.startswith("robomill run: error: unknown option '--variants'; did you mean '--variant'? available: --help, --json, ")
    said = refused(["run", "mill/groove.toml", "deeper.toml"], capsys)
    assert said.startswith("robomill run: error: unexpected argument 'deeper.toml'; leave it out")


def test_no_command_at_all_is_answered_with_the_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "list the examples that come with robomill" in capsys.readouterr().out


@pytest.mark.parametrize(("mark", "encoding"), [("\r\n", "utf-8"), ("\n", "utf-8-sig")])
def test_files_from_windows_are_read(mark: str, encoding: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Line ends, and the byte order mark with which some editors begin a file."""
    for name in ("system.toml", "map.toml"):
        file = Path("axis", name)
        file.write_bytes(file.read_text(encoding="utf-8").replace("\n", mark).encode(encoding))
    done = alone("run axis/system.toml --stop 0.01 --out r")
    assert done.returncode == 0, done.stderr
    groove = Path("mill/groove.toml")
    groove.write_bytes(groove.read_text(encoding="utf-8").replace("\n", mark).encode(encoding))
    assert main(["plan", "mill/groove.toml"]) == 0
    said = refused(["run", "mill/groove.toml", "--variant", "cartesain"], capsys)
    assert said.endswith("no variant cartesain; variants: uncompensated, cartesian, axis, cartesian_pilot")


def test_a_toml_file_in_another_encoding(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = Path("axis/system.toml")
    file.write_text(file.read_text(encoding="utf-8"), encoding="utf-16")
    said = refused(["run", str(file)], capsys)
    assert said.startswith("robomill run: system.toml: not valid TOML: not UTF-8: ")
    assert said.endswith("; save it in the encoding UTF-8")


LOG = "logger 3\nt;a\n0;1,5\n1;2,5\n2;1,0\n"
MAP = """[log]
delimiter = ";"
decimal = ","
skip_rows = 1
[clock]
column = "t"
unit = "ms"
[[signal]]
port = "arm.q"
column = "a"
unit = "A"
"""
WRONG_LOGS = {
    "decimal comma": (
        'decimal = ","\n',
        "",
        "log.csv: row 3, column 'a': '1,5' is no number; is the decimal sign '.', or is there",
    ),
    "rows above the names": (
        "skip_rows = 1\n",
        "",
        "log.csv: row 2 has 2 fields, the row of names has 1; is the delimiter ';', and are the names in the row after log.skip_rows = 0?",
    ),
    "a column that is missing": ('column = "a"', 'column = "b"', "log.csv: unknown column 'b'; available: t, a"),
    "a unit that is none": (
        'unit = "A"',
        'unit = "furlong"',
        "unit: unknown unit 'furlong'; expected a product of powers of SI units",
    ),
}


@pytest.mark.parametrize("name", WRONG_LOGS)
def test_a_mapping_that_does_not_fit_the_log(name: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    right, wrong, text = WRONG_LOGS[name]
    Path("log.csv").write_text(LOG, encoding="utf-8")
    Path("map.toml").write_text(MAP.replace(right, wrong), encoding="utf-8")
    assert text in refused(["import", "map.toml", "log.csv", "--out", "r"], capsys)


def test_an_fmu_that_is_no_archive(here: Path) -> None:
    Path("axis/own.fmu").write_text("hello\n", encoding="utf-8")
    system = Path("axis/system.toml")
    system.write_text(system.read_text(encoding="utf-8").replace("python:servo_axis.py:AXIS", "own.fmu"), encoding="utf-8")
    assert (
        alone("run axis/system.toml")
        .stderr.strip()
        .endswith("own.fmu: not a zip archive, so not an FMU (6 bytes, begins with b'hello\\n'); get the file anew from whoever made it")
    )


def test_a_place_that_is_a_file(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(["run", "mill/groove.toml", "--out", "mill/groove.ngc/r"], capsys)
    assert said == (
        "robomill run: mill/groove.ngc/r: not a directory; a part of this path is a file where a folder is expected; name another path"
    )


@pytest.mark.parametrize("command", ["example groove no/mill", "run axis/system.toml --out no/r", "run axis/system.toml --out no"])
def test_a_folder_that_may_not_be_written(command: str, here: Path) -> None:
    Path("no").mkdir(mode=0o555)
    done = alone(command, *NOTHING_OVERRIDES_RIGHTS)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(": permission denied; name a place where you may read and write")
    assert " no" in done.stderr


def test_every_refusal_of_the_operating_system_has_a_remedy() -> None:
    assert all(REMEDIES.values())
