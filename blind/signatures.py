"""What each catalogue effect does to the measured columns of a situation, to first order: for the oracle."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from robomill.blind.effects import EFFECTS, Instance
from robomill.blind.prediction import ComponentValues
from robomill.blind.situation import Situation, nominal_run
from robomill.blind.world import MEASURED, STEP, TRACKER, nominal_system
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
machines, cutting slots of 3 to 5 mm, are below.
`correction_q` is not sent there; its value is that of 7 um at 1.4 m."""
CLOCK = 5e-5
"""Uncertainty of the timestamps [s] after averaging."""

LATEST = 0.12
"""Largest lag of a clock [s]."""


@dataclass(frozen=True)
class Library:
    """Whitened signatures of all candidates in one situation; zero where it does not have their component."""

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


@lru_cache(maxsize=16)
def library(s: Situation, cache: Path | None = None) -> Library:
    """The library of a situation (about 5 s); kept as a file in the folder `cache`, and in memory."""
    every, reference = candidates(), nominal_run(s).columns
    names = tuple(n for a in ARRAYS for n in reference if n.partition("[")[0] == a)
    rows = len(nominal_run(s).t) // STRIDE
    key = hashlib.sha256(repr((s.key, sorted(FLOOR.items()), CLOCK, EFFECTS)).encode()).hexdigest()[:16]
    file = None if cache is None else cache / f"signatures_{key}.npy"
    if file is not None and file.is_file():
        return Library(every, np.load(file).astype(np.float64), names)
    matrix = np.zeros((len(every), len(names) * rows))
    present = {c.name for c in nominal_system(s.system).components}
    for i, e in enumerate(every):
        if e.effect.component in present:
            columns = s.simulate({e.effect.component: {e.parameter: e.value}}).columns
            matrix[i] = features(columns, reference, names, rows)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_name(f".{file.stem}-{os.getpid()}.npy")
        np.save(part, matrix.astype(np.float32))
        part.replace(file)
    return Library(every, matrix, names)


def make_library(s: Situation, cache: Path) -> None:
    """Have the file of a library in `cache`; for processes of their own."""
    library(s, cache)


def apart(s: Situation, tier: str, one: ComponentValues, other: ComponentValues) -> float:
    """Largest rms, over columns and windows of 0.5 s, between what two sets of parameters do in a situation; over `FLOOR`."""
    reference = nominal_run(s).columns
    names = tuple(n for a in ARRAYS if tier != "T0" or a != TRACKER for n in reference if n.partition("[")[0] == a)
    rows = len(nominal_run(s).t) // STRIDE
    does = [features(s.simulate(values).columns, reference, names, rows) for values in (one, other)]
    return _largest_window((does[0] - does[1]).reshape(len(names), -1))


@dataclass(frozen=True)
class Change:
    """What a true effect changes in one situation."""

    library: Library
    reference: Run
    whitened: FloatArray
    """float64[features], as a row of the matrix of the library."""


def confusable(changes: Sequence[Change], true: Instance, limit: float) -> list[str]:
    """Candidates (`component.parameter`) that explain the changes in all situations together but for `limit`: at their best strength

    the largest rms of what is left, over columns and windows of 0.5 s, stays below it. The true element itself is left out.
    """
    energy = np.sum([np.einsum("ij,ij->i", c.library.matrix, c.library.matrix) for c in changes], axis=0)
    along = np.sum([c.library.matrix @ c.whitened for c in changes], axis=0)
    scale = np.divide(along, energy, out=np.zeros(len(energy)), where=energy > 0.0)
    found = []
    for i, rival in enumerate(changes[0].library.candidates):
        if (rival.key, rival.index) == (true.key, true.index):
            continue
        left = [(c.whitened - scale[i] * c.library.matrix[i]).reshape(len(c.library.columns), -1) for c in changes]
        if max(map(_largest_window, left)) < limit:
            found.append(f"{rival.effect.component}.{rival.parameter}")
    return found


def clocks(changes: Sequence[Change], limit: float) -> list[str]:
    """Clocks of the log (`logging.lag COMPONENT`) that explain the changes but for `limit`, by one lag of up to `LATEST` everywhere."""
    found = []
    for device in dict.fromkeys(name.partition(".")[0] for c in changes for name in c.library.columns):
        parts, others = [], []
        for c in changes:
            late = np.array([name.partition(".")[0] == device for name in c.library.columns])
            rows = c.whitened.reshape(len(late), -1)
            parts.append((rows[late], c.reference, [n for n, on in zip(c.library.columns, late, strict=True) if on]))
            others.append(rows[~late])
        if all(_largest_window(o) < limit for o in others) and max(map(_largest_window, _without_lag(parts))) < limit:
            found.append(f"logging.lag {device}")
    return found


def _without_lag(parts: Sequence[tuple[FloatArray, Run, Sequence[str]]]) -> list[FloatArray]:
    """What the best lag leaves of whitened changes, [names, rows] each."""

    def left(lag: float) -> list[FloatArray]:
        found = []
        for change, reference, names in parts:
            rows = slice(0, change.shape[1] * STRIDE, STRIDE)
            logged = [reference.columns[name] for name in names]
            late = [((np.interp(reference.t - lag, reference.t, y) - y) / floor(n, y))[rows] for n, y in zip(names, logged, strict=True)]
            found.append(change - np.array(late).reshape(change.shape))
        return found

    def misfit(lag: float) -> float:
        return float(sum(np.sum(x**2) for x in left(lag)))

    near = min(np.arange(-LATEST, LATEST + STEP, STEP), key=misfit)
    return left(minimize_scalar(misfit, bounds=(near - STEP, near + STEP), method="bounded", options={"xatol": 1e-6}).x)


def _largest_window(values: FloatArray, rows: int = 25) -> float:
    if not values.size:
        return 0.0
    n = max(values.shape[1] // rows, 1)
    squares = [np.mean(values[:, k * rows : (k + 1) * rows] ** 2, axis=1).max() for k in range(n)]
    return float(np.sqrt(max(squares)))
