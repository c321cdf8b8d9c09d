"""Damping of the springs of an elastic robot from the damping ratios of its modes, tied in groups.

Englert 2011 (paper 004), section 3.2: the same damping in all axes first, then varied until the peaks between 0 and 50 Hz fit. Here
D = sum_g beta_g K_g with a time beta_g for each group of springs, as six damping ratios cannot give eighteen dampings (rank 6). The start
is the thesis' heuristic, one beta for all; an optimiser goes on from there. The model's ratios are those of the complex eigenvalues of
M x.. + D x. + K x = 0, not of the first order only.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from robomill.models.calibration.modal_fit import Mode
from robomill.models.model.declaration import FloatArray
from robomill.models.robot.elastic_modes import TipModes

NEAR = 0.1
"""Relative distance of the frequencies of a measured mode and one of the model, up to which they may be the same."""
BETA = (1e-6, 1e-1)
"""Bounds of beta [s]: beyond them a group has no damping that the modes show."""
KNOWN = 0.25
"""Relative standard error up to which the damping of a group is determined."""
LEAST_ERROR = 0.03
"""Relative error of a measured damping ratio at least: what the rational fit reaches on hammer tests (FACTS10 10.5)."""
GROUPS = {
    3: ("drives A1-A3", "drives A4-A6", "tilts and links"),
    4: ("drives A1-A3", "drives A4-A6", "tilts A1-A3", "tilts A4-A6"),
    6: ("A1", "A2", "A3", "A4", "A5", "A6"),
}
"""Groups that springs can be tied in, by their number."""


@dataclass(frozen=True)
class DampingFit:
    """Damping of the groups, with what the modes say of it."""

    groups: tuple[str, ...]
    beta: FloatArray
    """[groups] s, D = beta K."""
    relative_error: FloatArray
    """[groups] standard error over beta; infinite where the modes do not show it."""
    heuristic: float
    """The one beta for all that it starts from, s."""
    pairs: tuple[tuple[int, int], ...]
    """Measured mode and mode of the model."""
    model_damping: FloatArray
    """[pairs] damping ratio of the model with these dampings."""
    heuristic_damping: FloatArray
    """[pairs] and with the heuristic."""
    condition: float
    """Condition number of the sensitivities of the damping ratios to the groups."""

    def finding(self, g: int) -> str:
        """`determined`, or `not determined: why`."""
        if self.beta[g] < 2.0 * BETA[0] or self.beta[g] > 0.5 * BETA[1]:
            return "not determined: ends on a bound"
        if not self.relative_error[g] <= KNOWN:
            return f"not determined: known to {100 * self.relative_error[g]:.0f} % only, the modes share it with other groups"
        return "determined"


def group_of(coordinate: str, count: int) -> int:
    """Group of an elastic coordinate by its name ("A1 drive", "A3 tilt x", "holder y") for so many groups; what is no axis is with A6."""
    if count not in GROUPS:
        raise ValueError(f"tied damping: {count} groups, expected one of {', '.join(map(str, GROUPS))}")
    number = re.match(r"A(\d) (drive)?", coordinate)
    axis, drive = (int(number[1]), number[2] is not None) if number else (6, False)
    if count == 6:
        return axis - 1
    if drive:
        return 0 if axis <= 3 else 1
    return 2 if count == 3 or axis <= 3 else 3


def pair(measured: Sequence[Mode], modes: TipModes) -> tuple[tuple[int, int], ...]:
    """Measured modes and those of the model, each once: nearest in frequency first, and where two are as near, alike in direction."""
    distance = []
    for i, m in enumerate(measured):
        for j, f in enumerate(modes.frequency):
            apart = abs(np.log(m.frequency / f))
            if apart < NEAR:
                struck = m.peak.max(axis=0) > 0.0
                shape = np.abs(np.outer(modes.shape[:3, j], modes.shape[:3, j]))[:, struck]
                peak = m.peak[:, struck]
                alike = float(np.sum(shape * peak) / (np.linalg.norm(shape) * np.linalg.norm(peak)))
                distance.append((apart + NEAR * (1.0 - alike), i, j))
    pairs: list[tuple[int, int]] = []
    for _, i, j in sorted(distance):
        if all(i != a and j != b for a, b in pairs):
            pairs.append((i, j))
    return tuple(sorted(pairs))


def damping_ratios(modes: TipModes, D: FloatArray) -> FloatArray:
    """[n] damping ratios of M x.. + D x. + K x = 0 for diagonal dampings D [m] N.m.s/rad, in the order of the modes without damping."""
    w = 2.0 * np.pi * modes.frequency
    n = len(w)
    between = modes.coordinate_shape.T @ (np.asarray(D)[:, None] * modes.coordinate_shape)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(w**2), -between]])
    values, vectors = np.linalg.eig(state)
    found = np.zeros(n)
    for k in range(n):
        mine = int(np.argmax(np.abs(vectors[k]) ** 2 / np.sum(np.abs(vectors[:n]) ** 2, axis=0)))
        found[k] = -values[mine].real / abs(values[mine])
    return found


def fit_damping(measured: Sequence[Mode], modes: TipModes, groups: int = 3) -> DampingFit:
    """Dampings of the groups that give the damping ratios of the measured modes.

    Errors: ValueError for a number of groups that there is not, and for fewer modes in common with the model than groups.
    """
    member = np.array([group_of(name, groups) for name in modes.coordinates])
    pairs = pair(measured, modes)
    used = np.unique(member)
    if len(pairs) < len(used):
        raise ValueError(
            f"tied damping: {len(pairs)} measured modes are within {100 * NEAR:.0f} % of one of the model, for {len(used)} groups; tie the "
            "springs in fewer groups, correct the stiffness first, or strike along more axes"
        )
    target = np.array([measured[i].damping for i, _ in pairs])
    error = np.hypot(LEAST_ERROR, np.array([measured[i].damping_error for i, _ in pairs]) / target)
    lines = [j for _, j in pairs]

    def ratios(beta: FloatArray) -> FloatArray:
        return np.asarray(damping_ratios(modes, beta[member] * modes.stiffness)[lines])

    w = 2.0 * np.pi * modes.frequency[lines]
    heuristic = float(np.exp(np.mean(np.log(2.0 * target / w))))  # one beta: zeta = beta w/2

    def rest(x: FloatArray) -> FloatArray:
        beta = np.full(len(GROUPS[groups]), heuristic)
        beta[used] = np.exp(x)
        return np.asarray(np.log(np.maximum(ratios(beta), 1e-9) / target) / error)

    bounds = (np.full(len(used), np.log(BETA[0])), np.full(len(used), np.log(BETA[1])))
    found = least_squares(rest, np.full(len(used), np.log(heuristic)), bounds=bounds)
    beta, relative = np.full(len(GROUPS[groups]), np.nan), np.full(len(GROUPS[groups]), np.inf)
    beta[used] = np.exp(found.x)
    _, singular, Vt = np.linalg.svd(found.jac, full_matrices=False)
    sharp = np.maximum(singular, 1e-12 * singular[0])
    relative[used] = np.sqrt(np.sum((Vt.T / sharp) ** 2, axis=1)) * max(1.0, np.sqrt(2.0 * found.cost / max(len(pairs) - len(used), 1)))
    return DampingFit(
        GROUPS[groups],
        beta,
        relative,
        heuristic,
        pairs,
        ratios(np.where(np.isfinite(beta), beta, heuristic)),
        ratios(np.full(len(GROUPS[groups]), heuristic)),
        float(singular[0] / max(singular[-1], 1e-300)),
    )
