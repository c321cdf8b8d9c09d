"""Progress where standard error is no terminal."""

from __future__ import annotations

import pytest

from robomill import progress
from robomill.progress import INTERVAL, progress_bar


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


def test_with_json_nothing_is_said(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "INTERVAL", 0.0)
    with progress_bar(quiet=True) as report:
        report("Cartesian", 1, 100)
    assert capsys.readouterr().err == ""
