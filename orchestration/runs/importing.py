"""Writes a run folder from arrays in memory: what `Recorder` does for simulated runs, for measured ones."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from robomill.orchestration.errors import ResultsError
from robomill.orchestration.runs.files import CSV, LIVE, RUN, SIGNALS
from robomill.orchestration.runs.recorder import SCHEMA, frame_of
from robomill.orchestration.slaves.protocol import FloatArray, PortData
from robomill.orchestration.system.toml_text import dump

_FILES = (RUN, SIGNALS, LIVE, CSV)


def refuse_taken(folder: Path) -> None:
    """ResultsError for a folder that holds a run."""
    if present := [n for n in _FILES if (folder / n).exists()]:
        raise ResultsError(f"{folder} already holds a run ({', '.join(present)}); choose another folder, or allow overwriting")


def remove_run(folder: Path) -> None:
    """Remove the files of a run, and its folder if nothing else is in it."""
    for name in _FILES:
        (folder / name).unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()


def write_run(
    folder: Path,
    t: FloatArray,
    columns: Mapping[str, FloatArray],
    ports: Mapping[str, PortData],
    info: Mapping[str, Any],
    overwrite: bool = False,
) -> None:
    """Write `run.toml` and `signals.parquet` into `folder`.

    `t` [n] s, increasing; `columns` [n] each by `component.port` element in the unit of its port; `info` goes into
    run.toml (program, robot, labels, parameters, ...). A measured signal depends on no input of the simulation.
    ResultsError for a folder that holds a run already, arrays of unequal length, time that does not increase, values
    that are not finite; nothing is written then.
    """
    if not overwrite:
        refuse_taken(folder)
    if len(t) == 0 or not np.all(np.isfinite(t)) or not np.all(np.diff(t) > 0.0):
        raise ResultsError(
            f"{folder}: time must be finite and increase from row to row; there are {len(t)} rows; "
            "sort them, and remove those without a time"
        )
    for name, values in columns.items():
        if values.shape != t.shape:
            raise ResultsError(f"{folder}: column {name!r} has shape {values.shape}, time has {t.shape}; give one value per row")
        if not np.all(np.isfinite(values)):
            raise ResultsError(
                f"{folder}: column {name!r} is not finite at t = {t[~np.isfinite(values)][0]:.9g} s; cut the run there, or fill the gap"
            )
    step = round(float(np.median(np.diff(t))), 9) if len(t) > 1 else 0.0
    described = {
        name: {"port": name, "unit": ports[name].unit or "", "frame": frame_of(ports[name].name), "type": "real"} for name in columns
    }
    promoted = {k: str(info.get(k, "")) for k in ("program", "robot", "tool", "workpiece")}
    about = {
        "schema": SCHEMA,
        "outcome": "finished",
        "message": "",
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "kind": "measured",
        **promoted,
        **{k: v for k, v in info.items() if k not in promoted},
        "clock": {"column": "t", "unit": "s", "step": step, "every": 1},
        "columns": described,
    }
    text = dump(about)
    fields = [pa.field("t", pa.float64(), metadata={"unit": "s", "description": "time"})]
    for name in columns:
        component, _, port = name.partition(".")
        metadata = {
            "component": component,
            "port": port,
            "type": "real",
            "unit": ports[name].unit or "",
            "frame": frame_of(port),
            "description": ports[name].description,
            "dependencies": "",
        }
        fields.append(pa.field(name, pa.float64(), metadata=metadata))
    schema = pa.schema(fields, metadata={"robomill": text})
    folder.mkdir(parents=True, exist_ok=True)
    for stale in (LIVE, CSV):
        (folder / stale).unlink(missing_ok=True)
    part = folder / (SIGNALS + ".part")
    pyarrow.parquet.write_table(pa.table([t, *columns.values()], schema=schema), part, compression="zstd")
    part.replace(folder / SIGNALS)
    run_part = folder / (RUN + ".part")
    run_part.write_text(text, encoding="utf-8")
    run_part.replace(folder / RUN)
