"""Where inside a component: direction, joint, and what the residual of its replay depends on.

A residual that is a vector (a tool-tip error) is projected on directions that are given from outside, for robots the columns of the
Jacobian: the engine knows no robots. Dependence on a variable is tested against noise, all variables together: of those that are found a
part of FALSE_ALARM may be found by chance (Benjamini & Hochberg 1995).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2, false_discovery_control

from robomill.diagnosis.experiment.component_replay import KNOWN
from robomill.diagnosis.inference.adequacy import FALSE_ALARM
from robomill.orchestration.slaves.protocol import FloatArray

BANDS = ((0.0, 0.004), (0.004, 0.02), (0.02, 0.06), (0.06, np.inf))
"""Parts of the sampling frequency: 1, 5 and 15 Hz of 250 Hz."""
PRESENT = 0.1
"""Part of its largest size from which a load, or what is left, is there."""


@dataclass(frozen=True)
class Projection:
    """How a residual comes about by small displacements of named coordinates (joints)."""

    names: tuple[str, ...]
    """Names of the coordinates: `joint 1`, ..."""
    jacobian: Callable[[Mapping[str, FloatArray]], FloatArray] = field(repr=False)
    """Measured columns by name, float64[n] each -> float64[n, elements of the residual, coordinates]; KeyError if one is not measured."""


def alignment(residual: FloatArray, jacobian: FloatArray, noise: FloatArray | None = None) -> FloatArray:
    """Part of the squared residual [n, d] along the directions of each coordinate alone, `jacobian` [n, d, k]; float64[k] in 0..1.

    For coordinate k: sum_n (r_n . j_nk / |j_nk|)^2 / sum_n r_n . r_n; 1 = all of it could come from this coordinate.
    `noise`: variance per element of the residual, taken off above and below.
    """
    length = np.sqrt((jacobian**2).sum(axis=1)) + 1e-300
    unit = jacobian / length[:, None, :]
    along = np.einsum("nd,ndk->nk", residual, unit) ** 2
    total = float((residual**2).sum())
    below = np.zeros(jacobian.shape[2])
    if noise is not None:
        below = (unit**2 * noise[None, :, None]).sum(axis=(0, 1))
        total -= float(noise.sum()) * len(residual)
    if total <= 0.0:
        return np.zeros(jacobian.shape[2])
    out: FloatArray = np.clip((along.sum(axis=0) - below) / total, 0.0, 1.0)
    return out


def variables(inputs: Mapping[str, FloatArray], units: Mapping[str, str], t: FloatArray) -> dict[str, list[FloatArray]]:
    """What a residual may depend on, name -> one or more series [n]: value of each input array, sense of its motion, load, time.

    `inputs` column -> values; `units` column -> unit: what is measured in N or N.m is a load, the rest has a sense of motion.
    """
    found: dict[str, list[FloatArray]] = {"time since start": [t - t.mean()]}
    loads = []
    for name, values in inputs.items():
        array = name.partition("[")[0]
        if np.ptp(values) <= 1e-12 * np.abs(values).max():
            continue
        if units.get(name, "") in ("N", "N.m"):
            loads.append(np.abs(values) / np.abs(values).max())
            found.setdefault(f"load {array}", []).append(values)
            continue
        found.setdefault(f"value of {array}", []).append(values - values.mean())
        rate = np.gradient(values)
        found.setdefault(f"sense of {array}", []).append(np.where(np.abs(rate) > KNOWN * np.abs(rate).max(), np.sign(rate), 0.0))
    if loads:
        found["engagement"] = [(np.max(loads, axis=0) > PRESENT).astype(np.float64)]
    return found


@dataclass(frozen=True)
class Dependence:
    """How a residual depends on a variable; or what of it is in a band of frequency."""

    variable: str
    """What the residual depends on, or a band of frequency."""
    share: float
    """Part of the squared residual that it explains by itself, linearly."""
    p: float | None
    """Probability of as much by noise; None where that was not tested."""


def dependences(
    residual: FloatArray, candidates: Mapping[str, Sequence[FloatArray]], filtered: Callable[[FloatArray], FloatArray], temperature: float
) -> list[Dependence]:
    """The variables that a white residual [n, d] (variance `temperature`) depends on beyond noise, strongest first.

    `filtered` makes of a series [n] what the whitening makes of it for each of the d channels, [n, d].
    """
    tested, chances = [], []
    total = float((residual**2).sum())
    for name, series in candidates.items():
        explained, freedom = 0.0, 0
        stacked = np.stack([filtered(s) for s in series], axis=2)
        for k in range(residual.shape[1]):
            basis = stacked[:, k]
            u, sizes, _ = np.linalg.svd(basis, full_matrices=False)
            u = u[:, sizes > 1e-6 * sizes.max(initial=1e-300)]
            explained += float(((u.T @ residual[:, k]) ** 2).sum())
            freedom += u.shape[1]
        chances.append(float(chi2.sf(explained / temperature, freedom)))
        tested.append(Dependence(name, explained / (total + 1e-300), chances[-1]))
    found = [d for d, p in zip(tested, false_discovery_control(chances), strict=True) if p <= FALSE_ALARM]
    return sorted(found, key=lambda d: -d.share)


def bands(residual: FloatArray, step: float) -> list[tuple[tuple[float, float], float]]:
    """Part of the squared residual [n, d], sampled every `step` [s], in each of the BANDS [Hz]."""
    spectrum = (np.abs(np.fft.rfft(residual, axis=0)) ** 2).sum(axis=1)
    spectrum[1 : len(spectrum) - (len(residual) % 2 == 0)] *= 2.0
    frequency = np.fft.rfftfreq(len(residual))
    shares = [float(spectrum[(frequency >= a) & (frequency < b)].sum() / (spectrum.sum() + 1e-300)) for a, b in BANDS]
    return [((a / step, b / step), share) for (a, b), share in zip(BANDS, shares, strict=True)]
