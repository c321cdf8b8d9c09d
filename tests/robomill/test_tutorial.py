"""The way of docs/tutorials/diagnose_a_log.md, with a mapping that has a sign wrong: from the machine's CSV to a report that says so."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from robomill.cli import main

TUTORIAL = Path("scenarios/tutorial")


@pytest.mark.slow
def test_a_log_with_a_wrong_sign_ends_in_a_report_that_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine, logs, runs, out = (tmp_path / name for name in ("machine", "logs", "runs", "diagnosis"))
    assert main(["run", str(TUTORIAL / "machine.toml"), "--variant", "slot", "--out", str(machine)]) == 0
    subprocess.run([sys.executable, str(TUTORIAL / "logs.py"), str(machine), str(logs)], check=True)
    program = "scenarios/experiments/programs/slots.ngc"
    assert main(["plan", program, "--at", "1300", "0", "1200", "--turn", "180", "--out", str(tmp_path / "slot.npy")]) == 0
    assert (tmp_path / "slot.npy").read_bytes() == (machine / "slot-1" / "segments.npy").read_bytes()
    mapping = (TUTORIAL / "map.toml").read_text(encoding="utf-8")
    (tmp_path / "map.toml").write_text(mapping.replace('columns = ["Fx", "Fy", "Fz"]', 'columns = ["Fx", "Fy", "Fz"]\nsign = [-1, 1, 1]'))
    for i in range(1, 5):
        assert main(["import", str(tmp_path / "map.toml"), str(logs / f"slot-{i}.csv"), "--out", str(runs / f"slot-{i}")]) == 0
    shutil.rmtree(machine)  # nothing is read of it any more
    assert main(["diagnose", "scenarios/milling_cell.toml", *map(str, sorted(runs.iterdir())), "--out", str(out)]) == 1
    result = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert [(f["channel"], f["kind"]) for f in result["gate"]["findings"] if f["fatal"]] == [("sensor.f_S_raw[1]", "sign")]
    assert "sensor.f_S_raw[1] has the wrong sign" in (out / "report.html").read_text(encoding="utf-8")
    assert f"report: {out / 'report.html'}" in capsys.readouterr().out.replace("\n", "")
