"""What `robomill import` cannot read as it is published: `python scenarios/recordings/prepare.py FOLDER` writes

- `ur10_first_half.npz`, `ur10_second_half.npz`: the messages of the rosbag2 file (SQLite, CDR) as arrays,
- `fanuc_odd.csv`, `fanuc_even.csv`: the three tables of static loads side by side, every second load, counted by `load`.
"""

from __future__ import annotations

import csv
import sqlite3
import struct
import sys
from contextlib import closing
from pathlib import Path

import numpy as np

DATA = Path(__file__).parents[2] / "data"
UR10, FANUC = DATA / "ur10_exciting_trajectory" / "ur10_exciting_trajectory.db3", DATA / "fanuc_r2000ic"
HEADER = 4
"""Bytes before the content of a CDR message: alignment counts from behind them."""


def joint_state(message: bytes) -> tuple[list[str], list[tuple[float, ...]]]:
    """Names of the joints, and position [rad], velocity [rad/s], effort [N m] of a sensor_msgs/JointState, little endian."""
    at = HEADER + 8  # behind the time stamp

    def count() -> int:
        nonlocal at
        at += -(at - HEADER) % 4
        (n,) = struct.unpack_from("<I", message, at)
        at += 4
        return int(n)

    n = count()  # frame_id
    at += n
    names = []
    for _ in range(count()):
        n = count()
        names.append(message[at : at + n - 1].decode())
        at += n
    arrays = []
    for _ in range(3):
        n = count()
        at += -(at - HEADER) % 8
        arrays.append(struct.unpack_from(f"<{n}d", message, at))
        at += 8 * n
    return names, arrays


def ur10(folder: Path) -> None:
    """Both halves of the trajectory: t [s] from the beginning of the half, position, velocity and effort [6, n]."""
    with closing(sqlite3.connect(f"file:{UR10}?mode=ro", uri=True)) as bag:
        rows = bag.execute("select timestamp, data from messages order by timestamp").fetchall()
    t = 1e-9 * np.array([stamp for stamp, _ in rows], dtype=np.float64)
    messages = [joint_state(data) for _, data in rows]
    order = messages[0][0]
    if any(names != order for names, _ in messages):
        raise ValueError(f"{UR10}: the order of the joints changes")
    values = np.array([arrays for _, arrays in messages])
    half = len(t) // 2
    for name, part in (("first", slice(None, half)), ("second", slice(half, None))):
        position, velocity, effort = values[part].transpose(1, 2, 0)
        np.savez(folder / f"ur10_{name}_half.npz", t=t[part] - t[part][0], position=position, velocity=velocity, effort=effort)


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
    ur10(to)
    fanuc(to)
