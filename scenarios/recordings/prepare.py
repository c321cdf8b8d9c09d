"""What `robomill import` cannot read as it is published: `python scenarios/recordings/prepare.py FOLDER` writes

`fanuc_odd.csv`, `fanuc_even.csv`: the three tables of static loads side by side, every second load, counted by `load`.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

DATA = Path(__file__).parents[2] / "data"
FANUC = DATA / "fanuc_r2000ic"


def fanuc(folder: Path) -> None:
    """Every second load: joint angles [rad], force [N] and displacement [m] beside each other."""
    tables = []
    for name in ("joint_angles", "forces", "deltaX"):
        with (FANUC / f"{name}.csv").open(encoding="utf-8-sig", newline="") as file:
            tables.append(list(csv.reader(file)))
    rows = [[x for part in parts for x in part] for parts in zip(*tables, strict=True)]
    for name, begin in (("odd", 1), ("even", 2)):
        with (folder / f"fanuc_{name}.csv").open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([["load", *rows[0]], *([k, *row] for k, row in enumerate(rows[begin::2]))])


if __name__ == "__main__":
    to = Path(sys.argv[1])
    to.mkdir(parents=True, exist_ok=True)
    fanuc(to)
