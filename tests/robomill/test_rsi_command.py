"""`robomill rsi` and `robomill krc`."""

from __future__ import annotations

import json
import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from robomill.cli import main
from robomill.orchestration.runs.run import Run
from robomill.rsi_command import part_told
from tests import SCENARIOS
from tests.cell.rsi.test_settings import LINK, SYSTEM, written

LAST_DIGIT = np.deg2rad(5e-5)
"""Half of the last of four decimals of a degree, which is what the wire leaves."""
PATIENT = LINK.replace('silence = "20 ms"', 'silence = "700 ms"\nend = "800 ms"')
"""No test may fail because the machine was busy for a moment."""


def link_file(folder: Path) -> Path:
    file = written(folder, PATIENT)
    (folder / "small.toml").write_text(SYSTEM.replace('step = "4 ms"', 'step = "4 ms"\nstop = "0.2 s"'))
    return file


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def test_the_configuration_for_the_robot_controller_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rsi", str(link_file(tmp_path)), "--config", str(tmp_path / "out.xml")]) == 0
    assert (tmp_path / "out.xml").read_text() == (SCENARIOS / "rsi" / "ethernet.xml").read_text()
    assert "copy it to the robot controller" in capsys.readouterr().out


def test_a_session_that_cut_nothing_is_told_so() -> None:
    figures = {"max_deviation_m": None, "rms_deviation_m": None, "peak_force_n": None}
    assert part_told(figures) == "nothing was cut: the session ended before the tool met the block"
    cut = {"max_deviation_m": 2e-4, "rms_deviation_m": 1e-4, "peak_force_n": 300.4}
    assert part_told(cut) == "largest deviation of the part 0.20 mm, peak force 300 N"


def test_a_session_of_both_commands_is_two_runs(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file, there = link_file(tmp_path), f"127.0.0.1:{free_port()}"
    status: list[int] = []
    options = ["--listen", there, "--out", str(tmp_path / "session"), "--label", "condition=rest", "--json"]
    partner = threading.Thread(target=lambda: status.append(main(["rsi", str(file), *options])))
    partner.start()
    said = ""
    until = time.monotonic() + 60.0
    while "listening at" not in said and time.monotonic() < until:
        time.sleep(0.05)
        said += capfd.readouterr().err
    assert "without any safety function" in said
    assert main(["krc", str(file), "--to", there, "--out", str(tmp_path / "robot"), "--in-step"]) == 0
    partner.join(60.0)
    assert status == [0]
    session, robot = Run.load(tmp_path / "session"), Run.load(tmp_path / "robot")
    assert (session.outcome, session.info["labels"]["condition"]) == ("finished", "rest")
    assert len(session) == len(robot) == 51
    np.testing.assert_allclose(session["drive.q_motor"], robot["drive.q_motor"], atol=LAST_DIGIT, rtol=0)
    out = capfd.readouterr().out
    result = json.loads(next(line for line in out.splitlines() if line.startswith("{")))
    assert result["ended"].startswith("the robot controller stopped sending after IPOC")
    assert "stopped at t = 0.200 s; 51 cycles, 0 without their answer" in out
    assert main(["rsi", str(file), "--listen", there, "--out", str(tmp_path / "session")]) == 2
    assert "already holds a run" in capfd.readouterr().err


def test_a_robot_without_partner_ends_with_a_timeout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = SYSTEM.replace('step = "4 ms"', 'step = "4 ms"\nstop = "10 s"')
    file = link_file(tmp_path)
    (tmp_path / "small.toml").write_text(text)
    assert main(["krc", str(file), "--to", f"127.0.0.1:{free_port()}", "--out", str(tmp_path / "robot"), "--in-step"]) == 1
    assert "100 answers in a row were late: RSI ends with a timeout" in capsys.readouterr().out


def test_an_address_that_is_taken_or_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = link_file(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        there = f"127.0.0.1:{s.getsockname()[1]}"
        assert main(["rsi", str(file), "--listen", there, "--out", str(tmp_path / "a")]) == 2
        assert f"cannot listen at {there}: Address already in use; name an address of this machine" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["rsi", str(file), "--listen", "here"])
    assert "'here': expected IP:PORT, such as 127.0.0.1:49152" in capsys.readouterr().err
