"""The link of the groove, loaded once, and packets for its partner made by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from robomill.cell.rsi.partner import Partner, rob_telegram
from robomill.cell.rsi.settings import Link, load_link
from tests import SCENARIOS

MS = 1_000_000
Q = np.array([0.0, -80.0, 100.0, 5.0, 60.0, 0.0])
"""Axis angles, deg."""


@pytest.fixture(scope="session")
def link() -> Link:
    """With Cartesian compensation and no pilot: what is sent follows from what is measured."""
    loaded = load_link(SCENARIOS / "rsi" / "link.toml")
    return replace(loaded, system=loaded.system.with_parameters("controller", {"mode": 1, "pilot": False}))


Packet = Callable[..., bytes]


@pytest.fixture(scope="session")
def packet(link: Link) -> Packet:
    """`packet(k, force)`: of cycle k, with a force on the tool in N."""
    return partial(_packet, link)


def _packet(link: Link, k: int, force: float = 300.0, ipoc: int | None = None) -> bytes:
    t = rob_telegram(link)
    for i, q in enumerate(Q):
        t.values[t.index[f"AIPos.A{i + 1}"]] = q
    t.values[t.index["Force.X"]] = force
    t.values[t.index["Force.Y"]] = 1e-3 * k  # a sensor that lives
    t.values[t.index["Feed.Y"]] = 25.0
    t.ipoc = 5000 + 4 * k if ipoc is None else ipoc
    return bytes(t.view(t.write()))


class Bench:
    """A partner, its virtual clock, and what it answered."""

    def __init__(self, link: Link, rows: int = 1000) -> None:
        self.partner = Partner(link, link.system, rows)
        self.now = 0

    def ask(self, text: bytes, after: int = 4 * MS) -> bytes:
        """The answer to a packet that comes `after` ns later than the last; empty if there is none."""
        self.now += after
        n = self.partner.answer(self.partner.rob.put(text), self.now)
        answer = bytes(self.partner.sen.view(n))
        if n:
            self.partner.sent(self.now)
        return answer

    def sent(self, text: bytes, after: int = 4 * MS) -> np.ndarray:
        """Correction that is sent [mm]; it needs an answer."""
        assert self.ask(text, after)
        return self.partner._sent.copy()


@pytest.fixture
def bench(link: Link) -> Bench:
    return Bench(link)
