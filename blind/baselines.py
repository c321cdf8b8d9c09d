"""Methods that the diagnosis must beat: each gets the repeats of the first condition and the nominal model, and names one effect or none.

All see the mean of the repeats minus the nominal run, whitened. None knows open sets, ambiguity or nuisance parameters; that is the point.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robomill.blind.case import Case
from robomill.blind.effects import EFFECTS
from robomill.blind.signatures import STRIDE, Library, floor, library
from robomill.blind.situation import Situation, nominal_run, situations
from robomill.blind.workers import Progress
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.runs.run import Run


@dataclass(frozen=True)
class Guess:
    """What a baseline says: `component.effect` and element, or None: no effect."""

    key: str | None
    index: int = 0

    @property
    def component(self) -> str | None:
        """The component of the effect."""
        return None if self.key is None else self.key.partition(".")[0]


Baseline = Callable[[Library, FloatArray], Guess]
"""(library, whitened mean residual) -> guess."""
NULL_LIMIT = 2.5
"""Whitened rms of the worst column below which there is no gap: twelve machines without effects stayed below it (`FLOOR`)."""
NO_ENERGY, NO_LENGTH = 1e-12, 1e-9
"""Whitened energy, and length, of a signature up to which it is round-off: such an effect changes nothing here, and nothing is divided
by it. Both are far below the energy of one sample of noise, 1."""


def _worst(lib: Library, r: FloatArray) -> float:
    return float(np.sqrt(np.mean(r.reshape(len(lib.columns), -1) ** 2, axis=1)).max())


def residual(folder: Path, s: Situation, names: Sequence[str]) -> FloatArray:
    """Whitened mean of the repeats of a situation of a case minus the nominal run, flattened like `Library.matrix`."""
    runs = [Run.load(f) for f in sorted((folder / "runs").glob(f"{s.name.replace(' ', '-')}-[0-9]*"))]
    reference = nominal_run(s)
    rows = slice(0, len(reference.t) // STRIDE * STRIDE, STRIDE)
    grid = reference.t[rows]
    parts = []
    for name in names:
        mean = np.mean([np.interp(grid, r.t, r.columns[name]) for r in runs], axis=0)
        nominal_values = reference.columns[name]
        parts.append((mean - nominal_values[rows]) / floor(name, nominal_values)[rows])
    return np.concatenate(parts)


def _guess(lib: Library, i: int) -> Guess:
    return Guess(lib.candidates[i].key, lib.candidates[i].index)


def largest_residual(lib: Library, r: FloatArray) -> Guess:
    """The component whose column deviates most, and the effect listed first for it."""
    rms = np.sqrt(np.mean(r.reshape(len(lib.columns), -1) ** 2, axis=1))
    if _worst(lib, r) < NULL_LIMIT:
        return Guess(None)
    component = lib.columns[int(rms.argmax())].partition(".")[0]
    effect = next(e for e in EFFECTS if e.component == component)
    return Guess(f"{effect.component}.{effect.name}", 1 if effect.size else 0)


def fit_all(lib: Library, r: FloatArray) -> Guess:
    """All effects at once by least squares; the largest in units of its usual size."""
    if _worst(lib, r) < NULL_LIMIT:
        return Guess(None)
    theta = np.linalg.lstsq(lib.matrix.T, r, rcond=1e-6)[0]
    best = int(np.abs(theta).argmax())
    return _guess(lib, best)


def _criterion(lib: Library, r: FloatArray, penalty: float) -> Guess:
    n = len(r)
    energy = np.einsum("ij,ij->i", lib.matrix, lib.matrix)
    gain = np.divide((lib.matrix @ r) ** 2, energy, out=np.zeros(len(energy)), where=energy > NO_ENERGY)
    best = int(gain.argmax())
    total = float(r @ r)
    score = n * np.log(max(total - float(gain[best]), 1e-300) / total) + penalty
    return _guess(lib, best) if score < 0.0 else Guess(None)


def aic(lib: Library, r: FloatArray) -> Guess:
    """Single effects by Akaike's criterion, unknown noise level, samples taken as independent."""
    return _criterion(lib, r, 2.0)


def bic(lib: Library, r: FloatArray) -> Guess:
    """Single effects by the Bayesian information criterion, unknown noise level, samples taken as independent."""
    return _criterion(lib, r, float(np.log(len(r))))


def lasso(lib: Library, r: FloatArray, share: float = 0.3, rounds: int = 100) -> Guess:
    """Sparse regression of the residual on the signatures (coordinate descent); penalty = `share` of the one that gives zero."""
    scale = np.sqrt(np.einsum("ij,ij->i", lib.matrix, lib.matrix))
    usable = scale > NO_LENGTH
    A = np.where(usable[:, None], lib.matrix / np.where(usable, scale, 1.0)[:, None], 0.0)
    gram, b = A @ A.T, A @ r
    if _worst(lib, r) < NULL_LIMIT:
        return Guess(None)
    penalty, x = share * float(np.abs(b).max()), np.zeros(len(b))
    for _ in range(rounds):
        for i in np.flatnonzero(usable):
            z = b[i] - gram[i] @ x + x[i]
            x[i] = np.sign(z) * max(abs(z) - penalty, 0.0)
    best = int(np.abs(x).argmax())
    return _guess(lib, best) if x[best] != 0.0 else Guess(None)


BASELINES: Mapping[str, Baseline] = {
    "largest_residual": largest_residual,
    "fit_all_parameters": fit_all,
    "aic": aic,
    "bic": bic,
    "lasso": lasso,
}


def baseline_guesses(folder: Path, cases: Sequence[Case], tier: str, progress: Progress | None = None) -> dict[str, dict[int, Guess]]:
    """Baseline -> number of the case -> what it says, from the runs and the signatures (kept in `oracle`) of a benchmark."""
    guesses: dict[str, dict[int, Guess]] = {name: {} for name in BASELINES}
    for i, c in enumerate(cases):
        if progress is not None:
            progress("baselines", i, len(cases))
        case = folder / "cases" / f"{c.number:04d}"
        first = situations(case)[0]
        lib = library(first, folder / "oracle").for_tier(tier)
        r = residual(case, first, lib.columns)
        for name, baseline in BASELINES.items():
            guesses[name][c.number] = baseline(lib, r)
    return guesses
