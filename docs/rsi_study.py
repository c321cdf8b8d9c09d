"""The picture of docs/how_to/rsi.md: what is sent when a packet, the robot controller or the sensor fails.

    python docs/rsi_study.py

writes docs/pictures/rsi_failures.png. A partner on a virtual clock gets packets that are made here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np

from robomill.cell.palette import BLUE, GREEN, ORANGE, PURPLE, RED
from robomill.cell.rsi.partner import Partner, rob_telegram
from robomill.cell.rsi.settings import load_link
from robomill.models.model.declaration import FloatArray

mpl.use("Agg")
import matplotlib.pyplot as plt  # after the backend is chosen

ROOT = Path(__file__).parent.parent
CYCLE = 4_000_000  # ns
CYCLES, FAILS = 150, 50
AXES = (0.0, -80.0, 100.0, 5.0, 60.0, 0.0)  # deg
FORCE = 300.0  # N

link = load_link(ROOT / "scenarios" / "rsi" / "link.toml")
system = link.system.with_parameters("controller", {"mode": 1, "pilot": False})
rob = rob_telegram(link)


def packet(k: int, force: float = FORCE, ipoc: int | None = None) -> bytes:
    """A packet of cycle k."""
    for i, q in enumerate(AXES):
        rob.values[rob.index[f"AIPos.A{i + 1}"]] = q
    rob.values[rob.index["Force.X"]] = force
    rob.values[rob.index["Force.Y"]] = 1e-3 * k
    rob.values[rob.index["Feed.Y"]] = 25.0
    rob.ipoc = 4 * k if ipoc is None else ipoc
    return bytes(rob.view(rob.write()))


def sent(text: Callable[[int], bytes | None]) -> FloatArray:
    """Size of the correction [mm] in each cycle, for a partner that gets `text(k)`; what was sent last holds without an answer (HOLDON)."""
    partner = Partner(link, system, CYCLES + 1)
    sizes = np.zeros(CYCLES)
    for k in range(CYCLES):
        given = text(k)
        if given is None:
            partner.watchdog.silent(k * CYCLE)
        else:
            n = partner.answer(partner.rob.put(given), k * CYCLE)
            if n:
                partner.sent(k * CYCLE)
                sizes[k:] = np.linalg.norm(partner.sen.values[:3])
    partner.close()
    return sizes


FAILURES: dict[str, Callable[[int], bytes | None]] = {
    "no failure": packet,
    "4 packets lost": lambda k: None if FAILS <= k < FAILS + 4 else packet(k),
    "sensor shows 5 kN": lambda k: packet(k, 5000.0 if k == FAILS else FORCE),
    "IPOC jumps": lambda k: packet(k, ipoc=4 * k + (100_000 if k >= FAILS else 0)),
    "8 packets malformed": lambda k: b"<Rob" if FAILS <= k < FAILS + 8 else packet(k),
    "robot silent for 48 ms": lambda k: None if FAILS <= k < FAILS + 12 else packet(k),
}

figure, view = plt.subplots(figsize=(8.0, 3.6), layout="constrained")
t = 4.0 * (np.arange(CYCLES) - FAILS)
for (name, text), (colour, style) in zip(
    FAILURES.items(), (("k", "-"), (BLUE, "--"), (ORANGE, "-"), (GREEN, "--"), (RED, "-."), (PURPLE, "-")), strict=True
):
    view.step(t, sent(text), color=colour, ls=style, where="post", label=name)
view.set_xlim(-100.0, 400.0)
view.set_ylim(bottom=0.0)
view.set_xlabel("time after the failure, ms")
view.set_ylabel("correction at the robot, mm")
view.grid(alpha=0.3)
view.legend(loc="center right")
figure.savefig(ROOT / "docs" / "pictures" / "rsi_failures.png", dpi=110)
