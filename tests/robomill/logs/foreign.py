"""A small log and its mapping, and what becomes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robomill.logs.importing import import_log
from robomill.logs.log import LogError
from robomill.orchestration.runs.run import Run

T = 0.01 * np.arange(40)
FX, FY, FZ = 100.0 * np.sin(9.0 * T), 50.0 + T, 700.0 * T
CLOCK = '[clock]\ncolumn = "time"\nunit = "s"\n'
FORCE = '[[signal]]\nport = "sensor.f_S_raw"\ncolumns = ["fx", "fy", "fz"]\nunit = "kN"\n'
MAP = CLOCK + FORCE


def csv(folder: Path, text: str | None = None) -> Path:
    """A log with time [s] and forces [kN], or the given text."""
    file = folder / "log.csv"
    rows = [f"{float(t)!r},{float(x) / 1e3!r},{float(y) / 1e3!r},{float(z) / 1e3!r}" for t, x, y, z in zip(T, FX, FY, FZ, strict=True)]
    file.write_text("\n".join(["time,fx,fy,fz", *rows, ""]) if text is None else text, encoding="utf-8")
    return file


def bring(folder: Path, mapping: str = MAP, log: Path | None = None, run: str = "run") -> Run:
    """The run, or one of the repeats, `run/repeat_1`, ..., that the import makes."""
    (folder / "map.toml").write_text(mapping, encoding="utf-8")
    import_log(folder / "map.toml", log or csv(folder), folder / "run", overwrite=True)
    return Run.load(folder / run)


def refused(folder: Path, mapping: str = MAP, log: Path | None = None) -> str:
    with pytest.raises(LogError) as caught:
        bring(folder, mapping, log)
    assert not (folder / "run").exists(), "a log that is refused leaves nothing behind"
    return str(caught.value)
