"""A network that loses, delays and doubles datagrams as it is told to, with a seed: what the partner is tested with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Faults:
    """Probabilities per datagram, and the largest extra delay of the sender [s]."""

    lost: float = 0.0
    late: float = 0.0
    """It comes a cycle later."""
    doubled: float = 0.0
    jitter: float = 0.0
    seed: int = 1

    def __post_init__(self) -> None:
        """ValueError for what is no probability or no time."""
        for name in ("lost", "late", "doubled"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} is {value:g}; expected a probability from 0 to 1")
        if self.lost + self.late + self.doubled > 1.0:
            raise ValueError(
                f"lost + late + doubled is {self.lost + self.late + self.doubled:g}; expected at most 1: a datagram has one fate"
            )
        if not 0.0 <= self.jitter < np.inf:
            raise ValueError(f"jitter is {self.jitter:g} s; expected a time of 0 or more")


class Direction:
    """One direction of the network."""

    def __init__(self, faults: Faults, stream: int) -> None:
        """`stream`: directions with other numbers have other fates."""
        self._faults = faults
        self._random = np.random.default_rng([faults.seed, stream])
        self._waiting: list[bytes] = []
        self.lost = self.late = self.doubled = 0

    def carry(self, datagram: bytes) -> list[bytes]:
        """Take in a datagram; what comes out in this cycle, late ones of the last cycle first."""
        f, chance = self._faults, self._random.random()
        out, self._waiting = self._waiting, []
        if chance < f.lost:
            self.lost += 1
        elif chance < f.lost + f.late:
            self.late += 1
            self._waiting = [datagram]
        elif chance < f.lost + f.late + f.doubled:
            self.doubled += 1
            out += [datagram, datagram]
        else:
            out += [datagram]
        return out

    def jitter(self) -> float:
        """Extra delay of this cycle [s]."""
        return float(self._faults.jitter * self._random.random()) if self._faults.jitter else 0.0
