"""The gap between the rigid-body model and the recorded KR 300: estimation by least squares on whitened residuals.

The component `inverse_dynamics` is fed the measured motor angles; its torques and link angles are compared with the measured
ones. Effects of the catalogue are added one at a time, the one with the largest evidence first; each fit is Gauss-Newton with
complete reruns of the component. `study` runs this on the two recordings.

Both sides of a comparison go through the same zero-phase low-pass and are thinned to 25 Hz (parallel filtering). The noise is that of the
residual: per axis a white part and an Ornstein-Uhlenbeck part, found by maximum likelihood. Torques at standstill, where static
friction may be anything up to breakaway, are left out of the fits (and counted in the figures that say so).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.signal import butter, sosfiltfilt

from robomill.diagnosis.catalogue import Candidate
from robomill.models.components.inverse_dynamics import MODEL
from robomill.orchestration.runs.run import Run

FloatArray = npt.NDArray[np.float64]
Values = Mapping[str, float]
"""Effect parameters by element name, such as ``friction_viscous[2]``."""

H = 0.004
"""Cycle of the recordings [s]."""
MOTION_BAND = 15.0
"""Corner [Hz] of the zero-phase low-pass of the motor angles, before they are differentiated."""
BAND = 8.0
"""Corner [Hz] of the zero-phase low-pass of residuals."""
THIN = 10
"""Every so many samples are kept of the filtered residuals: 25 Hz."""
MARGIN = 50
"""Samples left out at either end, where the zero-phase filters have no neighbours."""
STANDSTILL = math.radians(0.3)
"""Axis speed [rad/s] below which an axis counts as standing: friction is not determined there."""
WORTH_A_FIT = 0.5
"""Log evidence that a candidate must promise by its linear estimate, with the noise of the model so far, to be fitted (judgement: well
below `threshold` of `select`, as the estimate is rough)."""


@dataclass(frozen=True)
class Recording:
    """A measured run, ready for the comparison."""

    name: str
    t: FloatArray
    q_raw: FloatArray
    """Motor angles over gear ratios as measured [n,6] rad."""
    torque: FloatArray
    """Motor torques [n,6] N m."""
    q_link: FloatArray
    """Encoders behind the gears of A1..A3 [n,3] rad."""
    q_ref: FloatArray
    parameters: Mapping[str, Any]
    """Nominal parameters of the component."""

    @staticmethod
    def of(run: Run, name: str) -> Recording:
        """From a run folder that `robomill import` wrote with the mapping of the recordings."""
        return Recording(
            name,
            run.t,
            run["robot.q"],
            run["robot.torque_motor"],
            run["robot.q_link"],
            run["motion.q_ref"],
            run.info["parameters"]["robot"],
        )

    @cached_property
    def q(self) -> FloatArray:
        """Motor angles without what no robot does: zero-phase low-pass."""
        return np.asarray(self.q_raw[0] + low_pass(self.q_raw - self.q_raw[0], MOTION_BAND))

    @cached_property
    def qd(self) -> FloatArray:
        """Axis speeds [n,6] rad/s, central differences."""
        return np.asarray(np.gradient(self.q, H, axis=0))

    @cached_property
    def qdd(self) -> FloatArray:
        """Axis accelerations [n,6] rad/s2."""
        return np.gradient(self.qd, H, axis=0)

    @cached_property
    def standing(self) -> npt.NDArray[np.bool_]:
        """Where an axis stands [n,6]."""
        return np.abs(self.qd) < STANDSTILL

    @cached_property
    def moving(self) -> npt.NDArray[np.bool_]:
        """Kept samples of `thin` at which an axis moves [m,6]."""
        return ~self.standing[MARGIN:-MARGIN:THIN]


def low_pass(x: FloatArray, corner: float) -> FloatArray:
    """Zero-phase Butterworth low-pass of 4th order [Hz] over axis 0; applied twice, so -6 dB at the corner."""
    return np.asarray(sosfiltfilt(butter(4, corner, fs=1.0 / H, output="sos"), x, axis=0))


def thin(x: FloatArray) -> FloatArray:
    """Low-pass, cut the ends, keep every `THIN`-th sample."""
    return np.asarray(low_pass(x, BAND)[MARGIN:-MARGIN:THIN])


def simulate(recording: Recording, values: Values, **parameters: Any) -> dict[str, FloatArray]:
    """Outputs of the component over the recording [n,6]; `parameters` go before the nominal ones of the recording."""
    init, step = MODEL.compiled_for_data()
    data = MODEL.new()
    for name, value in {**recording.parameters, **parameters}.items():
        data[name] = value
    for name, number in values.items():
        base, _, index = name.partition("[")
        if index:
            data[base][0, int(index[:-1]) - 1] = number
        else:
            data[base] = number
    n = len(recording.t)
    torque, gear, link = np.empty((n, 6)), np.empty((n, 6)), np.empty((n, 6))
    inputs = [(data[name][0], array) for name, array in (("q", recording.q), ("qd", recording.qd), ("qdd", recording.qdd))]
    outputs = [(data[name][0], array) for name, array in (("torque_motor", torque), ("torque_gear", gear), ("q_link", link))]
    for k in range(n):
        for slot, array in inputs:
            slot[:] = array[k]
        status = step(data, k * H, H) if k else init(data)
        if status:
            raise ValueError(MODEL.message(status, data.view(np.recarray)[0], k * H))
        for slot, array in outputs:
            array[k] = slot
    return {"torque_motor": torque, "torque_gear": gear, "q_link": link}


# ------------------------------------------------------------------------------------------- noise


TIMES = (0.08, 0.2, 0.5, 1.2)
"""Correlation times [s] that are tried for the slow part of the noise."""
SHARES = (0.03, 0.2, 0.6)
"""Shares of the variance that are tried for its white part."""


@dataclass(frozen=True)
class Noise:
    """Covariance of the residual of one axis where it moves: white + Ornstein-Uhlenbeck."""

    sigma: float
    """Standard deviation."""
    time: float
    """Correlation time of the slow part [s]."""
    share: float
    """Share of the white part in the variance."""


# ------------------------------------------------------------------------------------- estimation


@functools.lru_cache(maxsize=32)
def _factors(used: bytes) -> dict[tuple[float, float], FloatArray]:
    """Lower Cholesky factors of the correlation matrices that are tried, for the samples marked in `used` (booleans)."""
    at = np.flatnonzero(np.frombuffer(used, dtype=bool)) * (H * THIN)
    lags = np.abs(np.subtract.outer(at, at))
    return {(t, w): np.linalg.cholesky((1.0 - w) * np.exp(-lags / t) + w * np.eye(len(at))) for t in TIMES for w in SHARES}


@dataclass(frozen=True)
class Problem:
    """What is fitted: a channel of a recording, thinned, and the uncertainty of standing axes."""

    recording: Recording
    channel: str
    fixed: Values = field(default_factory=dict)
    """Effects that are already adopted and stay."""
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def axes(self) -> int:
        """Measured axes of the channel."""
        return 6 if self.channel == "torque_motor" else 3

    @property
    def floor(self) -> float:
        """Least noise believed: resolution of the channel."""
        return 0.02 if self.channel == "torque_motor" else 2e-6

    @cached_property
    def measured(self) -> FloatArray:
        """Thinned measurement [m, axes]."""
        return thin(self.recording.torque if self.channel == "torque_motor" else self.recording.q_link)

    @cached_property
    def used(self) -> npt.NDArray[np.bool_]:
        """Samples that count [m, axes]: for torques those of moving axes."""
        return self.recording.moving if self.channel == "torque_motor" else np.ones_like(self.measured, dtype=bool)

    @cached_property
    def factors(self) -> tuple[dict[tuple[float, float], FloatArray], ...]:
        """Per axis the lower Cholesky factors of the correlation matrices that are tried."""
        return tuple(_factors(self.used[:, i].tobytes()) for i in range(self.axes))

    def whiten(self, x: FloatArray, noise: Sequence[Noise]) -> list[FloatArray]:
        """Whitened samples that count, per axis; `x` [m, axes, ...]."""
        return [
            np.asarray(solve_triangular(self.factors[i][n.time, n.share], x[self.used[:, i], i], lower=True)) / n.sigma
            for i, n in enumerate(noise)
        ]

    def log_determinant(self, noise: Sequence[Noise]) -> float:
        """Log of the determinant of the covariance, with the factors 2 pi."""
        total = 0.0
        for i, n in enumerate(noise):
            L = self.factors[i][n.time, n.share]
            total += 2.0 * float(np.sum(np.log(np.diag(L)))) + len(L) * math.log(2.0 * math.pi * n.sigma**2)
        return total

    def model(self, values: Values) -> FloatArray:
        """Thinned prediction [m, axes]."""
        return thin(simulate(self.recording, {**self.fixed, **values}, **self.parameters)[self.channel][:, : self.axes])

    def residual(self, values: Values) -> FloatArray:
        """Measured minus predicted [m, axes]."""
        return self.measured - self.model(values)


@dataclass(frozen=True)
class Fit:
    """Values of the effects of a model, their covariance and how good they are."""

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    log_evidence: float
    log_likelihood: float
    noise: tuple[Noise, ...]
    residual: FloatArray = field(repr=False)

    @property
    def by_name(self) -> dict[str, float]:
        """Values by parameter."""
        return dict(zip(self.names, map(float, self.values), strict=True))

    @property
    def bic(self) -> float:
        """Schwarz: k ln(n) - 2 ln L."""
        return len(self.names) * math.log(self.residual.size) - 2.0 * self.log_likelihood

    def interval(self, name: str) -> tuple[float, float]:
        """90 % interval."""
        i = self.names.index(name)
        half = 1.645 * math.sqrt(self.covariance[i, i])
        return float(self.values[i]) - half, float(self.values[i]) + half


def noises(problem: Problem, residual: FloatArray) -> tuple[Noise, ...]:
    """Noise of largest likelihood of each axis for a residual [m, axes]."""
    found = []
    for i, factors in enumerate(problem.factors):
        r = residual[problem.used[:, i], i]
        best: tuple[float, Noise] | None = None
        for (time, share), L in factors.items():
            w = solve_triangular(L, r, lower=True)
            sigma = max(math.sqrt(float(w @ w) / len(r)), problem.floor)
            likelihood = -0.5 * float(w @ w) / sigma**2 - len(r) * math.log(sigma) - float(np.sum(np.log(np.diag(L))))
            if best is None or likelihood > best[0]:
                best = likelihood, Noise(sigma, time, share)
        assert best is not None  # TIMES and SHARES are not empty
        found.append(best[1])
    return tuple(found)


def jacobian(problem: Problem, names: Sequence[str], at: Values, scales: Values) -> FloatArray:
    """Change of the prediction per parameter [m, axes, k], by a rerun of the component with each moved by a hundredth of its scale."""
    base = problem.model(at)
    columns = []
    for name in names:
        delta = 0.01 * scales[name]
        columns.append((problem.model({**at, name: at.get(name, 0.0) + delta}) - base) / delta)
    return np.stack(columns, axis=-1) if columns else np.empty((*base.shape, 0))


def solve(
    problem: Problem, residual: FloatArray, J: FloatArray, at: FloatArray, sd: FloatArray, noise: Sequence[Noise]
) -> tuple[FloatArray, FloatArray, float, float]:
    """Linear Gaussian update about `at` [k] with a prior N(0, sd^2): values, covariance, log evidence, log likelihood there."""
    k = len(at)
    wy = np.concatenate(problem.whiten(residual, noise))
    log_det = problem.log_determinant(noise)
    if k == 0:
        value = -0.5 * (float(wy @ wy) + log_det)
        return at, np.empty((0, 0)), value, value
    wJ = np.concatenate(problem.whiten(J, noise))
    wy = wy + wJ @ at
    c = cho_factor(np.diag(1.0 / sd**2) + wJ.T @ wJ, lower=True)
    mean = cho_solve(c, wJ.T @ wy)
    chi = float(np.sum((wy - wJ @ mean) ** 2))
    occam = 2.0 * float(np.sum(np.log(np.diag(c[0])))) + 2.0 * float(np.sum(np.log(sd)))
    evidence = -0.5 * (chi + float(np.sum((mean / sd) ** 2)) + occam + log_det)
    return mean, cho_solve(c, np.eye(k)), evidence, -0.5 * (chi + log_det)


def fit(problem: Problem, candidates: Sequence[Candidate], start: Values | None = None, rounds: int = 3) -> Fit:
    """Gauss-Newton fit of all parameters of `candidates`, noise and values in turn; values stay within their bounds."""
    names = tuple(p for c in candidates for p in c.parameters)
    bounds = {p: c.bounds for c in candidates for p in c.parameters}
    scales = {p: c.prior.scale for c in candidates for p in c.parameters}
    sd = np.array([scales[n] for n in names])
    at = np.array([(start or {}).get(n, 0.0) for n in names])
    covariance, evidence, likelihood = np.empty((0, 0)), 0.0, 0.0
    noise: tuple[Noise, ...] = ()
    residual = problem.residual(dict(zip(names, at, strict=True)))
    for _ in range(rounds if names else 1):
        noise = noises(problem, residual)
        J = jacobian(problem, names, dict(zip(names, at, strict=True)), scales)
        at, covariance, evidence, likelihood = solve(problem, residual, J, at, sd, noise)
        at = np.array([min(max(v, bounds[n][0]), bounds[n][1]) for n, v in zip(names, at, strict=True)])
        residual = problem.residual(dict(zip(names, at, strict=True)))
    return Fit(names, at, covariance, evidence, likelihood, noise, residual)


@dataclass(frozen=True)
class Step:
    """One step of the selection: what was added (or taken away) and what that gained."""

    candidate: Candidate
    gain: float
    """Log evidence gained."""
    bic: float
    """BIC afterwards."""


def select(
    problem: Problem,
    candidates: Sequence[Candidate],
    threshold: float = 3.0,
    report: Callable[[str], None] = lambda _: None,
    begin: Sequence[Candidate] = (),
) -> tuple[list[Candidate], Fit, list[Step]]:
    """Add the candidate with the largest evidence until none gains `threshold` (a factor of 20), then drop what is no longer needed.

    Candidates are tried with the noise of the model so far and, the best three, with their own.
    """
    chosen = list(begin)
    current = fit(problem, chosen)
    steps: list[Step] = []
    scales = {p: c.prior.scale for c in candidates for p in c.parameters}
    while True:
        rest = [c for c in candidates if c not in chosen]
        if not rest:
            break
        gains = screen(problem, chosen, rest, current, scales)
        best: tuple[float, Candidate, Fit] | None = None
        for index in np.argsort(gains)[::-1][:3]:
            if gains[index] < WORTH_A_FIT:
                continue
            candidate = rest[int(index)]
            trial = fit(problem, [*chosen, candidate], current.by_name, rounds=2)
            bounded = all(abs(trial.by_name[p]) > candidate.minimum * 1e-3 for p in candidate.parameters)
            gain = trial.log_evidence - current.log_evidence
            if bounded and (best is None or gain > best[0]):
                best = gain, candidate, trial
        if best is None or best[0] < threshold:
            break
        gain, candidate, current = best
        chosen.append(candidate)
        steps.append(Step(candidate, gain, current.bic))
        report(f"+ {candidate.name}: ln evidence +{gain:.1f}")
    while True:
        trials = [(fit(problem, [c for c in chosen if c is not d], current.by_name, rounds=2), d) for d in chosen if d not in begin]
        if not trials:
            break
        simpler, dropped = max(trials, key=lambda x: x[0].log_evidence)
        if simpler.log_evidence < current.log_evidence - threshold / 2.0:
            break
        steps.append(Step(dropped, simpler.log_evidence - current.log_evidence, simpler.bic))
        chosen.remove(dropped)
        report(f"- {dropped.name}: ln evidence {simpler.log_evidence - current.log_evidence:+.1f}")
        current = simpler
    return chosen, fit(problem, chosen, current.by_name), steps


def screen(problem: Problem, chosen: Sequence[Candidate], rest: Sequence[Candidate], current: Fit, scales: Values) -> FloatArray:
    """Log evidence that each of `rest` would gain, linearised about the current fit with its noise."""
    names = [p for c in chosen for p in c.parameters] + [p for c in rest for p in c.parameters]
    at = np.array([current.by_name.get(n, 0.0) for n in names])
    J = jacobian(problem, names, current.by_name, scales)
    sd = np.array([scales[n] for n in names])
    k = len(current.names)
    base = solve(problem, current.residual, J[..., :k], at[:k], sd[:k], current.noise)[2]
    gains = []
    for c in rest:
        columns = [*range(k), *(names.index(p) for p in c.parameters)]
        gains.append(solve(problem, current.residual, J[..., columns], at[columns], sd[columns], current.noise)[2] - base)
    return np.array(gains)
