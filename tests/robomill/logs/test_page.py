"""Every example of docs/how_to/import.md runs, and every key of a mapping is in one of them."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from robomill.logs.importing import import_log
from robomill.logs.mapping import MappingKeys
from robomill.orchestration.runs.run import Run
from tests import ROOT
from tests.robomill.logs.test_bags import written
from tests.tolerances import ROUNDOFF

EXAMPLES = re.findall(
    r"^```toml\n# (\S+)\n(.*?)^```", (ROOT / "docs" / "how_to" / "import.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
)


def forces(file: Path) -> None:
    names = ["time", "fx", "fy", "fz", "RIst.A", "RIst.B", "RIst.C", "r11", "r12", "r21", "r22"]
    units = ["ms", "[N]", "(N)", "N", "deg", "deg", "deg", "-", "", "", ""]
    rows = [[f"{4 * k}", f"{k},5", "0", "2", "30", "20", "10", "1", "0", "0", "1"] for k in range(9)]
    file.write_text("\n".join(["log 3", "", *(";".join(row) for row in (names, units, *rows))]), encoding="cp1252")


def dated(file: Path) -> None:
    rows = [f"03.05.2024 10:15:0{k},250;{100 * k}" for k in range(9)]
    file.write_text("\n".join(["when;i", *rows]), encoding="utf-8")


def cycles(file: Path) -> None:
    rows = [f"{k / 10},{k},{5 * (k // 20 % 2)},{['cut', 'back'][k // 30 % 2]}" for k in range(150)]
    file.write_text("\n".join(["time,q,trigger,phase", *rows]), encoding="utf-8")


def counted(file: Path) -> None:
    np.savez(file, T=np.arange(12.0 * 6).reshape(12, 2, 3))


def motion(file: Path) -> None:
    file.write_text("\n".join(["time,q", *(f"{k / 100},{k}" for k in range(100))]), encoding="utf-8")


def loads(file: Path) -> None:
    file.write_text("\n".join(["load,dx,dy,dz", *(f"{k},{0.1 * k},0,1" for k in range(22))]), encoding="utf-8")


LOGS = {"motion.csv": motion, "forces.csv": forces, "dated.csv": dated, "cycles.csv": cycles, "counted.npz": counted, "loads.csv": loads}
RUNS = {
    "forces.csv": [("run", "sensor.f_S_raw", 8)],
    "counted.npz": [("run", "plate.T", 12)],
    "motion.csv": [("run", "motion.qd", 100)],
    "dated.csv": [("run", "motor.current", 3)],
    "loads.csv": [("run", "robot.d_T_B", 22)],
    "joints.mcap": [("run", "sensor.f", 61)],
    "cycles.csv period": [("run/repeat_3", "axis.q", 40)],
    "cycles.csv at": [("run/repeat_1", "axis.q", 35), ("run/repeat_3", "axis.q", 35)],
    "cycles.csv marker": [("run/repeat_1", "axis.q", 40), ("run/repeat_3", "axis.q", 40)],
    "cycles.csv while": [("run/repeat_1", "axis.q", 30), ("run/repeat_3", "axis.q", 30)],
}
"""Example -> runs, an array of theirs and their rows."""


@pytest.mark.parametrize(("name", "text"), EXAMPLES, ids=[f"{i} {n}" for i, (n, _) in enumerate(EXAMPLES)])
def test_an_example_of_the_page_runs(tmp_path: Path, name: str, text: str) -> None:
    log = tmp_path / name
    if name in LOGS:
        LOGS[name](log)
    else:
        log = next(written(tmp_path, "MCAP").glob("*.mcap"))
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    cut = tomllib.loads(text).get("cut", {})
    kind = next((f"{name} {key}" for key in ("while", "period", "at", "marker") if key in cut), name)
    import_log(tmp_path / "map.toml", log, tmp_path / "run")
    for folder, port, rows in RUNS[kind]:
        assert len(Run.load(tmp_path / folder)[port]) == rows


def test_the_page_says_what_becomes_of_a_matrix_and_of_dates(tmp_path: Path) -> None:
    by_name = dict(EXAMPLES)
    for name, port, expected in (("counted.npz", "plate.T[2,3]", 278.15), ("dated.csv", "motor.current", 0.1)):
        LOGS[name](tmp_path / name)
        (tmp_path / "map.toml").write_text(by_name[name], encoding="utf-8")
        import_log(tmp_path / "map.toml", tmp_path / name, tmp_path / "run" / name)
        assert abs(Run.load(tmp_path / "run" / name).columns[port][0] - expected) <= ROUNDOFF * expected


def test_every_key_is_in_an_example() -> None:
    given: dict[str, set[str]] = {}
    for _, text in EXAMPLES:
        for table, value in tomllib.loads(text).items():
            for item in value if isinstance(value, list) else [value]:
                given.setdefault(table, set()).update(item)
    assert MappingKeys.all().keys() == given.keys()
    for table in ("log", "clock", "cut", "signal"):
        assert MappingKeys.all()[table].kind.nested.all().keys() == given[table], f"[{table}]"
