"""What each catalogue effect does to the measured columns of a training condition, to first order: for oracle and baselines."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from robomill.blind.conditions import Condition
from robomill.blind.effects import EFFECTS, Instance
from robomill.blind.world import MEASURED, STEP, TRACKER, nominal, simulate_nominal
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.runs.run import Run

STRIDE = 5
"""Every fifth row (20 ms) is looked at."""
ARRAYS = (*(a for a in MEASURED if not a.startswith("path.")), TRACKER)
FLOOR: Mapping[str, float] = {
    TRACKER: 10e-6,
    "drive.q_motor": 20e-6,
    "drive.torque_motor": 0.04,
    "sensor.f_S_raw": 1.8,
    "sensor.m_S_raw": 0.4,
    "sensor.f_T_T": 1.5,
    "sensor.m_T_T": 0.12,
    "controller.correction_B": 3e-6,
    "controller.correction_q": 5e-6,
    "milling.spindle_torque": 0.03,
}
"""Rms, by array, of the mean of six repeats of a machine without effects minus the nominal run: 90 % of the elements of twelve such
machines (two per training condition) are below.
`correction_q` is not sent in the training conditions; its value is that of 7 um at 1.4 m."""
CLOCK = 5e-5
"""Uncertainty of the timestamps [s] after averaging."""

LATEST = 0.12
"""Largest lag of a clock [s]."""


@dataclass(frozen=True)
class Library:
    """Whitened signatures of all candidates at one training condition."""

    candidates: tuple[Instance, ...]
    """Every effect at every element, at the middle (geometric) of its range."""
    matrix: FloatArray
    """float64[candidates, features]: change of the columns over `FLOOR`, flattened [columns, rows]."""
    columns: tuple[str, ...]
    """Element names, in the order of the features."""

    def for_tier(self, tier: str) -> Library:
        """Without the tracker at tier T0."""
        if tier != "T0":
            return self
        rows = self.matrix.shape[1] // len(self.columns)
        kept = [i for i, name in enumerate(self.columns) if name.partition("[")[0] != TRACKER]
        matrix = self.matrix.reshape(len(self.candidates), len(self.columns), rows)[:, kept].reshape(len(self.candidates), -1)
        return Library(self.candidates, matrix, tuple(self.columns[i] for i in kept))


def candidates() -> tuple[Instance, ...]:
    """Every effect at every element, at the geometric middle of its range, positive."""
    found: list[Instance] = []
    for e in EFFECTS:
        for index in range(1, e.size + 1) if e.size else (0,):
            found.append(Instance(e, index, e.factor(index) * float(np.sqrt(e.low * e.high))))
    return tuple(found)


def features(columns: Mapping[str, FloatArray], reference: Mapping[str, FloatArray], names: tuple[str, ...], rows: int) -> FloatArray:
    """Whitened difference, flattened [names, rows]; a run that is shorter keeps its last value."""
    parts = []
    for name in names:
        a, b = columns[name], reference[name]
        n = min(len(a), len(b))
        d = np.zeros(rows * STRIDE)
        d[: min(n, len(d))] = (a[:n] - b[:n])[: len(d)]
        parts.append(d[::STRIDE] / floor(name, b)[: len(d) : STRIDE])
    return np.concatenate(parts)


def floor(name: str, reference: FloatArray) -> FloatArray:
    """`FLOOR` and what an uncertain clock makes of a moving signal, by row of the nominal run."""
    rows: FloatArray = np.hypot(FLOOR[name.partition("[")[0]], CLOCK * np.gradient(reference) / STEP)
    return rows


def feature_names() -> tuple[str, ...]:
    """Measured elements but for those of the path."""
    some = nominal(_any_condition()).columns
    return tuple(n for a in ARRAYS for n in some if n.partition("[")[0] == a)


def _any_condition() -> Condition:
    from robomill.blind.conditions import _TRAINING

    return _TRAINING[0]


@lru_cache(maxsize=16)
def library(c: Condition, cache: Path | None = None, progress: Callable[[int, int], object] | None = None) -> Library:
    """The library of a condition (about 15 s); kept as a file in the folder `cache`, and in memory."""
    every, names = candidates(), feature_names()
    reference = nominal(c).columns
    rows = len(nominal(c).t) // STRIDE
    key = f"{c.turn:g}_{c.depth:g}_{c.feed:g}_{c.mirrored:d}_{'_'.join(f'{v:g}' for v in c.position)}"
    key += "_" + hashlib.sha256(repr((sorted(FLOOR.items()), CLOCK, EFFECTS)).encode()).hexdigest()[:8]
    file = None if cache is None else cache / f"signatures_{key}.npy"
    if file is not None and file.is_file():
        matrix = np.load(file).astype(np.float64)
    else:
        found = []
        for i, instance in enumerate(every):
            found.append(features(simulate_nominal(c, [instance]).columns, reference, names, rows))
            if progress is not None:
                progress(i + 1, len(every))
        matrix = np.array(found)
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            np.save(file, matrix.astype(np.float32))
    return Library(every, matrix, names)


def confusable(lib: Library, true: Instance, change: FloatArray, limit: float) -> list[str]:
    """Candidates (`component.parameter`) that explain the whitened change of the true effect but for `limit`: at their best strength

    the largest rms of what is left, over columns and windows of 0.5 s, stays below it. The true element itself is left out.
    """
    energy = np.einsum("ij,ij->i", lib.matrix, lib.matrix)
    scale = np.divide(lib.matrix @ change, energy, out=np.zeros(len(energy)), where=energy > 0.0)
    found = []
    for i, c in enumerate(lib.candidates):
        if (c.key, c.index) == (true.key, true.index):
            continue
        left = (change - scale[i] * lib.matrix[i]).reshape(len(lib.columns), -1)
        if _largest_window(left) < limit:
            found.append(f"{c.effect.component}.{c.parameter}")
    return found


def clocks(lib: Library, reference: Run, change: FloatArray, limit: float) -> list[str]:
    """Clocks of the log (`logging.lag COMPONENT`) that explain the whitened change but for `limit`, by a lag of up to `LATEST`."""
    of_change = change.reshape(len(lib.columns), -1)
    found = []
    for device in dict.fromkeys(name.partition(".")[0] for name in lib.columns):
        late = [i for i, name in enumerate(lib.columns) if name.partition(".")[0] == device]
        on_time = [i for i in range(len(lib.columns)) if i not in late]
        if on_time and _largest_window(of_change[on_time]) >= limit:
            continue
        if _largest_window(_without_lag(of_change[late], reference, [lib.columns[i] for i in late])) < limit:
            found.append(f"logging.lag {device}")
    return found


def _without_lag(change: FloatArray, reference: Run, names: Sequence[str]) -> FloatArray:
    """What the best lag leaves of a whitened change, [names, rows]."""
    rows = slice(0, change.shape[1] * STRIDE, STRIDE)
    logged = [reference.columns[name] for name in names]
    floors = [floor(name, y) for name, y in zip(names, logged, strict=True)]

    def left(lag: float) -> FloatArray:
        shifted = [((np.interp(reference.t - lag, reference.t, y) - y) / f)[rows] for y, f in zip(logged, floors, strict=True)]
        return change - np.array(shifted)

    def misfit(lag: float) -> float:
        return float(np.sum(left(lag) ** 2))

    near = min(np.arange(-LATEST, LATEST + STEP, STEP), key=misfit)
    return left(minimize_scalar(misfit, bounds=(near - STEP, near + STEP), method="bounded", options={"xatol": 1e-6}).x)


def _largest_window(values: FloatArray, rows: int = 25) -> float:
    n = max(values.shape[1] // rows, 1)
    squares = [np.mean(values[:, k * rows : (k + 1) * rows] ** 2, axis=1).max() for k in range(n)]
    return float(np.sqrt(max(squares)))
