"""A laboratory whose simulations are a formula: what an effect does is known, and costs nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from robomill.diagnosis.candidates import Address, Candidate, Prior
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import Laboratory, Setting
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import STEP, SYSTEM

Formula = Callable[[int, Mapping[Address, float]], FloatArray | None]
"""Number of the condition and what is changed -> the channels, [samples, channels]; None where that cannot run."""


class Calculated(Laboratory):
    """Steps of 10 ms; conditions are called `condition 0` and so on."""

    def __init__(
        self,
        formula: Formula,
        rows: int,
        channels: Sequence[str] = ("a.x",),
        conditions: int = 1,
        decimation: int = 1,
        seeds: Sequence[Address] = (),
    ) -> None:
        made = [Condition(f"condition {i}", {}, (), STEP * np.arange(rows * decimation)) for i in range(conditions)]
        super().__init__(SYSTEM, made, list(channels), decimation=decimation, seeds=seeds)
        self.formula = formula
        self.asked: list[Setting] = []

    def simulate(self, index: int, changes: Setting) -> FloatArray | None:
        """The formula."""
        self.asked.append(changes)
        return self.formula(index, dict(changes))


def candidate(parameter: str, kind: str = "normal", scale: float = 1.0, largest: float = 100.0, spread: float = 0.8) -> Candidate:
    """An effect of component `a`."""
    return Candidate(parameter, "a", "place", (parameter,), 1e-3 * scale, largest, Prior(kind, scale, spread), "1", kind == "normal", 1)
