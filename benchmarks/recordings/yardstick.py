"""Ordinary least squares on the same signals: how far the listed effects close the gap when nothing has to be found out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear
from scipy.signal import butter, sosfiltfilt

from benchmarks.recordings.cases import Case
from robomill.cell.binding import convert, resolve
from robomill.diagnosis.candidates import Address, Candidate, physical
from robomill.diagnosis.experiment.measured import driven, known_parameters
from robomill.orchestration.assembly import run as simulated
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray, base_name
from robomill.orchestration.system.definition import System

BoolArray = npt.NDArray[np.bool_]
ROUNDS = 8
"""Gauss-Newton rounds: most effects are proportional to their sizes; an error of the geometry shows only beside compliances."""
BLOCKS, DRAWS = 20, 300
"""Blocks of time that the bootstrap draws anew, and how often."""


@dataclass(frozen=True)
class View:
    """One run beside the simulation of it, in the band and at the samples that count."""

    case: Case
    run: Run
    system: System

    @cached_property
    def driven(self) -> System:
        """The nominal system with the parameters of the run, on its motion."""
        system = driven(self.system, self.run)
        for component, values in known_parameters(self.run, system).items():
            system = system.with_parameters(component, values)
        return system

    @cached_property
    def channels(self) -> list[str]:
        """Measured outputs of components that are simulated."""
        played = {c.name for c in self.system.components if c.source == "measured"}
        return [c for c in self.run.columns if c.partition(".")[0] not in played]

    @cached_property
    def counts(self) -> BoolArray:
        """Which samples count, [n, channels]."""
        on = np.ones((len(self.run.t), len(self.channels)), dtype=bool)
        if (rest := self.case.standing) is not None:
            for i, c in enumerate(self.channels):
                if base_name(c) == rest.channels:
                    on[:, i] = np.abs(self.run.columns[rest.speed + c.removeprefix(rest.channels)]) >= rest.below
        return on

    @cached_property
    def measured(self) -> FloatArray:
        """[n, channels]"""
        return self.shown(np.stack([self.run.columns[c] for c in self.channels], axis=1))

    def model(self, values: Mapping[Address, float]) -> FloatArray:
        """The simulation with effects of these sizes [unit] beside what the nominal system has, [n, channels]."""
        system = self.driven
        for (component, name), value in physical(dict(values)).items():
            given = system.component(component).parameters
            system = system.with_parameters(component, {name: value + float(given.get(name, 0.0))})
        result = simulated(system, None, stop=float(self.run.t[-1]), resolver=resolve, convert=convert)
        return self.shown(np.stack([np.interp(self.run.t, result.t, result.columns[c]) for c in self.channels], axis=1))

    def shown(self, x: FloatArray) -> FloatArray:
        """Signals [n, channels] in the band that counts."""
        if not self.case.band:
            return x
        step = float(np.median(np.diff(self.run.t)))
        return np.asarray(x[0] + sosfiltfilt(butter(4, self.case.band, fs=1.0 / step, output="sos"), x - x[0], axis=0))


@dataclass(frozen=True)
class Fitted:
    """Values [unit] by least squares, their 90 % intervals by block bootstrap."""

    values: dict[Address, float]
    intervals: dict[Address, tuple[float, float]]


def fit(views: Sequence[View], candidates: Sequence[Candidate]) -> Fitted:
    """Bounded least squares of all parameters of these candidates together, each array of channels over the rms of its gap."""
    addresses = [a for c in candidates for a in c.addresses]
    scales = np.array([c.prior.scale for c in candidates for _ in c.addresses])
    low, high = (np.array([c.bounds[i] for c in candidates for _ in c.addresses]) / scales for i in (0, 1))
    nominal = [v.model({}) for v in views]
    weights = _weights(views, nominal)
    x = np.zeros(len(addresses))
    columns: list[FloatArray] = []
    targets: list[FloatArray] = []
    for k in range(ROUNDS):
        at = dict(zip(addresses, x * scales, strict=True))
        bases = [v.model(at) for v in views] if k else nominal
        steps = np.where(x == 0.0, 0.3, 0.05 * np.abs(x) + 0.01)
        columns, targets = [], []
        for v, base, w in zip(views, bases, weights, strict=True):
            moved = [v.model({**at, a: at[a] + s * step}) - base for a, s, step in zip(addresses, scales, steps, strict=True)]
            J = np.stack([m / step for m, step in zip(moved, steps, strict=True)], axis=-1) * w[:, :, None]
            columns.append(J)
            targets.append((v.measured - base) * w + J @ x)
        x = _solved(columns, targets, low, high)
    draws = _bootstrap(columns, targets, low, high) * scales
    ends = np.percentile(draws, [5, 95], axis=0)
    intervals = {a: (float(ends[0, i]), float(ends[1, i])) for i, a in enumerate(addresses)}
    return Fitted(dict(zip(addresses, map(float, x * scales), strict=True)), intervals)


def _weights(views: Sequence[View], nominal: Sequence[FloatArray]) -> list[FloatArray]:
    """1 / rms of the gap of each channel over all views, zero at samples that do not count, [n, channels] each."""
    squares = sum((((v.measured - m) * v.counts) ** 2).sum(axis=0) for v, m in zip(views, nominal, strict=True))
    count = sum(v.counts.sum(axis=0) for v in views)
    rms = np.sqrt(squares / np.maximum(count, 1))
    return [v.counts / np.where(rms > 0.0, rms, 1.0) for v in views]


def _solved(columns: Sequence[FloatArray], targets: Sequence[FloatArray], low: FloatArray, high: FloatArray) -> FloatArray:
    k = columns[0].shape[-1]
    gram = sum(J.reshape(-1, k).T @ J.reshape(-1, k) for J in columns)
    product = sum(J.reshape(-1, k).T @ y.ravel() for J, y in zip(columns, targets, strict=True))
    return _normal(np.asarray(gram), np.asarray(product), low, high)


def _normal(gram: FloatArray, product: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """The x within its bounds that minimises x'Gx - 2 p'x; a trace of the diagonal keeps what nothing says anything of at zero."""
    size = np.sqrt(np.diag(gram))
    size[size == 0.0] = 1.0
    factor = np.linalg.cholesky(gram / np.outer(size, size) + 1e-9 * np.eye(len(gram)))
    found = lsq_linear(factor.T, np.linalg.solve(factor, product / size), (low * size, high * size))
    return np.asarray(found.x / size)


def _bootstrap(columns: Sequence[FloatArray], targets: Sequence[FloatArray], low: FloatArray, high: FloatArray) -> FloatArray:
    """Fits to blocks of time drawn anew, [DRAWS, k]."""
    grams, products = [], []
    for J, y in zip(columns, targets, strict=True):
        k = J.shape[-1]
        for rows in np.array_split(np.arange(len(J)), min(BLOCKS, len(J))):
            part = J[rows].reshape(-1, k)
            grams.append(part.T @ part)
            products.append(part.T @ y[rows].ravel())
    G, p = np.array(grams), np.array(products)
    rng = np.random.default_rng(1)
    drawn = [rng.integers(0, len(G), len(G)) for _ in range(DRAWS)]
    return np.array([_normal(G[d].sum(axis=0), p[d].sum(axis=0), low, high) for d in drawn])


def closures(views: Sequence[View], values: Mapping[Address, float]) -> dict[str, tuple[float, float, float]]:
    """Rms before and after [unit of the channel] and 1 - the ratio of their squares, by channel; over all samples that count."""
    found = {}
    gaps = [(v, v.measured - v.model({}), v.measured - v.model(values)) for v in views]
    for i, name in enumerate(views[0].channels):
        before, after = (np.concatenate([gap[v.counts[:, i], i] for v, *both in gaps for gap in [both[k]]]) for k in (0, 1))
        b, a = float(np.mean(before**2)), float(np.mean(after**2))
        found[name] = (b**0.5, a**0.5, 1.0 - a / b if b > 0.0 else 0.0)
    return found


def left_one_out(views: Sequence[View], candidates: Sequence[Candidate]) -> tuple[float, float, float]:
    """Rms [unit of the channels] of the length of the gap of a sample: nominal, fitted to all samples, each predicted from the others.

    For samples that do not depend on each other, and channels of one unit; the effects are taken as proportional to their sizes.
    """
    addresses = [a for c in candidates for a in c.addresses]
    scales = np.array([c.prior.scale for c in candidates for _ in c.addresses])
    low, high = (np.array([c.bounds[i] for c in candidates for _ in c.addresses]) / scales for i in (0, 1))
    bases = [v.model({}) for v in views]
    J = np.concatenate(
        [
            np.stack([v.model({a: s}) - b for a, s in zip(addresses, scales, strict=True)], axis=-1)
            for v, b in zip(views, bases, strict=True)
        ]
    )
    y = np.concatenate([v.measured - b for v, b in zip(views, bases, strict=True)])

    def fitted(rows: BoolArray) -> FloatArray:
        size = float(np.sqrt(np.mean(y**2)))
        return _solved([J[rows] / size], [y[rows] / size], low, high)

    every = np.ones(len(y), dtype=bool)
    predicted = np.array([y[k] - J[k] @ fitted(np.arange(len(y)) != k) for k in range(len(y))])
    return _length(y), _length(y - J @ fitted(every)), _length(predicted)


def _length(left: FloatArray) -> float:
    """Rms over the samples of the length of rows [n, channels]."""
    return float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
