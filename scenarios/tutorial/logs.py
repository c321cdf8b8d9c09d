"""Writes the runs of machine.toml as the CSV files that a logger might write: mm, degrees, decimal commas, tracker noise of 10 um."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from robomill.orchestration.runs.run import Run

TRACKER, ENCODER, TORQUE = 0.010, 2e-5, 0.02
"""Standard deviations of the noise: mm, degrees, N m."""


def write(run: Run, file: Path, seed: int) -> None:
    """One run as one file; the noise follows from the seed."""
    rng = np.random.default_rng(seed)
    sensors = {
        "A": np.rad2deg(run["drive.q_motor"]) + ENCODER * rng.normal(size=(len(run), 6)),
        "M": run["drive.torque_motor"] + TORQUE * rng.normal(size=(len(run), 6)),
        "F": run["sensor.f_S_raw"],
        "X": 1e3 * run["compliance.p_BT_B"] + TRACKER * rng.normal(size=(len(run), 3)),
    }
    names = ["time", *(f"A{i}" for i in range(1, 7)), *(f"M{i}" for i in range(1, 7)), "Fx", "Fy", "Fz", "X", "Y", "Z"]
    table = np.column_stack([1e3 * run.t, *sensors.values()])
    formats = ["%.1f", *["%.5f"] * 6, *["%.3f"] * 6, *["%.2f"] * 3, *["%.4f"] * 3]
    rows = [";".join(f % x for f, x in zip(formats, row, strict=True)).replace(".", ",") for row in table]
    file.write_text("cell logger 1.2\n" + "\n".join([";".join(names), *rows]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    source, target = map(Path, sys.argv[1:])
    target.mkdir(parents=True, exist_ok=True)
    for i, folder in enumerate(sorted(p for p in source.iterdir() if p.is_dir())):
        write(Run.load(folder), target / f"{folder.name}.csv", seed=i)
        print(target / f"{folder.name}.csv")
