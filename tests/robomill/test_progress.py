"""Progress on a terminal, and where standard error is none."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from rich.progress import Progress

from robomill import progress
from robomill.cli import main
from robomill.files import FILES
from robomill.progress import INTERVAL, PREPARING, progress_bar


def test_a_log_has_a_line_each_interval_and_none_of_what_is_short(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    with progress_bar(quiet=False) as report:
        for step in range(1, 101):
            clock[0] = step * INTERVAL / 40.0
            report("Cartesian", step, 100)
    assert capsys.readouterr().err == "Cartesian: 40 %, 40 of 100\nCartesian: 80 %, 80 of 100\n"


def test_a_log_says_what_takes_long_before_the_first_report(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "INTERVAL", 0.05)
    with progress_bar(quiet=False):
        time.sleep(0.5)
    assert capsys.readouterr().err == f"{PREPARING}\n"
    with progress_bar(quiet=False) as report:
        report("Cartesian", 1, 100)
        time.sleep(0.5)
    with progress_bar(quiet=False):
        pass
    time.sleep(0.5)
    assert capsys.readouterr().err == ""


def test_with_json_nothing_is_said(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "INTERVAL", 0.0)
    with progress_bar(quiet=True) as report:
        report("Cartesian", 1, 100)
    assert capsys.readouterr().err == ""


def test_a_bar_takes_the_number_that_is_expected_now(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[Progress] = []

    class Seen(Progress):
        def __init__(self, *columns: object, **options: object) -> None:
            super().__init__(*columns, **options)  # type: ignore[arg-type]
            shown.append(self)

    monkeypatch.setattr("rich.progress.Progress", Seen)
    monkeypatch.setattr(progress.sys.stderr, "isatty", lambda: True)
    with progress_bar(quiet=False) as report:
        (waiting,) = shown[0].tasks
        assert (waiting.description, waiting.visible) == (PREPARING, True)
        for done, total in ((0, 0), (1, 10), (2, 30)):
            report("diagnosis", done, total)
            waiting, task = shown[0].tasks
            assert not waiting.visible
            assert (task.completed, task.total) == (done, total or None)


def test_pictures_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "INTERVAL", 0.0)
    assert main(["run", str(FILES / "scenarios" / "groove.toml"), "--variant", "cartesian", "--out", str(tmp_path / "out")]) == 0
    assert "pictures: 0 %, 0 of 1" in capsys.readouterr().err
