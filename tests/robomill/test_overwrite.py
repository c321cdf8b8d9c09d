"""What an earlier command has written is replaced only where somebody asks for it: refused before anything is computed."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomill.cli import main
from tests import ROOT, SCENARIOS

GROOVE = str(SCENARIOS / "groove.toml")
COMMANDS: dict[str, tuple[list[str], str]] = {
    "plan, table": (["plan", GROOVE, "--out", "OUT/t.npy"], "t.npy"),
    "plan, program": (["plan", GROOVE, "--write", "OUT/p.src"], "p.src"),
    "stability": (["stability", str(SCENARIOS / "robots" / "kr210_2.toml"), "--out", "OUT"], "stability.json"),
    "place": (["place", str(SCENARIOS / "kr210" / "offline.toml"), "--out", "OUT"], "place.json"),
    "diagnose": (["diagnose", str(SCENARIOS / "milling_cell.toml"), "a", "--out", "OUT"], "diagnosis.json"),
    "identify": (["identify", "stiffness", str(ROOT / "data" / "fanuc_r2000ic" / "loads.toml"), "--out", "OUT/s.toml"], "s.toml"),
    "identify, folder": (["identify", "cubes", str(ROOT / "data" / "kr300_cubes" / "cubes.toml"), "--out", "OUT"], "report.json"),
    "blind score": (["blind", "score", "OUT"], "score.json"),
    "blind page": (["blind", "page", "OUT", "--output", "OUT/page.md"], "page.md"),
    "rsi": (["rsi", str(SCENARIOS / "rsi" / "link.toml"), "--config", "OUT/link.xml"], "link.xml"),
    "static loads": (["run", str(SCENARIOS / "static_loads.toml"), "--out", "OUT"], "summary.json"),
}
"""Command, and the file that it would replace."""


@pytest.mark.parametrize("name", COMMANDS)
def test_a_result_that_is_there_stays(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command, file = COMMANDS[name]
    (tmp_path / file).write_text("of an earlier run")
    assert main([part.replace("OUT", str(tmp_path)) for part in command]) == 2
    said = capsys.readouterr().err
    assert file in said
    assert "already" in said
    assert "--overwrite" in said
    assert (tmp_path / file).read_text() == "of an earlier run"
    assert [f.name for f in tmp_path.iterdir() if f.name != "run.lock"] == [file]


def test_it_is_replaced_where_somebody_says_so(tmp_path: Path) -> None:
    (tmp_path / "t.npy").write_text("of an earlier run")
    assert main(["plan", GROOVE, "--out", str(tmp_path / "t.npy"), "--overwrite"]) == 0
    assert (tmp_path / "t.npy").read_bytes().startswith(b"\x93NUMPY")
