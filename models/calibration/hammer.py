"""Frequency responses of a structure from blows with an impact hammer.

Englert 2011 (paper 004), section 3.2: a hammer strikes the tool along x, y, z of B in turn, a three-axis accelerometer on it answers.
Inertance H1 = S_fa/S_ff over several blows, coherence |S_fa|^2/(S_ff S_aa). The force is cut out around the blow (force window), so that
the noise of the sensor beside it does not count; the answer is not weighted, as that would add damping: record until it has died away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import signal

from robomill.models.model.declaration import FloatArray
from robomill.models.robot.elastic_modes import TipModes

ComplexArray = npt.NDArray[np.complex128]

BLOW = 0.3
"""Part of the largest force from which on a rise is a blow: bounces and noise stay below."""
PULSE = 0.02
"""Part of its peak down to which a blow lasts."""
BEFORE = 0.05
"""Record before a blow [s]: what the zero of both sensors is taken from."""
JITTER = 0.01
"""Part of the sampling interval by which it may vary."""
ALONG = 0.7
"""Part of the force that is along the axis of the blow, at least: a hammer is held by hand."""
FAST = 200.0
"""Modes above [Hz] are no part of a simulated blow: one of 10 ms does not reach them."""
FINE = 16
"""Steps per sample of a simulated blow."""


@dataclass(frozen=True)
class Response:
    """Inertance of three directions to blows along one of them."""

    direction: int
    """Axis of the blows: x, y, z of B = 0, 1, 2."""
    frequency: FloatArray
    """[nf] Hz, from the first line above zero."""
    inertance: ComplexArray
    """[nf, 3] acceleration along x, y, z per force, m/s2/N."""
    coherence: FloatArray
    """[nf, 3] 0..1: part of the acceleration that is linear in the force."""
    blows: int
    peak: float
    """Mean largest force, N."""

    @property
    def error(self) -> FloatArray:
        """[nf, 3] standard error of the magnitude of the inertance, m/s2/N (random error of H1)."""
        c = np.clip(self.coherence, 1e-6, 1.0 - 1e-9)
        return np.asarray(np.abs(self.inertance) * np.sqrt((1.0 - c) / (2.0 * self.blows * c)))

    def within(self, low: float, high: float) -> Response:
        """It from `low` to `high` Hz."""
        k = (self.frequency >= low) & (self.frequency <= high)
        return Response(self.direction, self.frequency[k], self.inertance[k], self.coherence[k], self.blows, self.peak)


def frequency_response(time: FloatArray, force: FloatArray, acceleration: FloatArray, duration: float) -> Response:
    """Inertance and coherence from a record with several blows along one axis.

    Parameters: `time` [n] s, `force` [n, 3] N, `acceleration` [n, 3] m/s2, both at the tool in B; `duration` s of the record of each
    blow, its inverse the distance of the lines. Errors: ValueError for gaps in the record, values that are not finite, fewer than two
    blows, blows closer than `duration`, and blows of no clear direction.
    """
    step = _sampling(time, force, acceleration)
    axis = int(np.argmax(np.abs(force).max(axis=0)))
    struck = np.abs(force[:, axis])
    largest = float(struck.max())
    if not largest > 0.0:
        raise ValueError("hammer: the force is zero in all of the record; check the column and the trigger")
    rows, lead = round(duration / step), round(BEFORE / step)
    starts = _blows(struck, BLOW * largest, rows - lead, step, time)
    starts = [i for i in starts if i - lead >= 0 and i - lead + rows <= len(time)]
    if len(starts) < 2:
        raise ValueError(
            f"hammer: {len(starts)} blows with {duration:g} s of record each in {len(time) * step:.4g} s, expected at least 2 (usually 5): "
            "record more blows, or take a shorter duration"
        )
    forces, answers = np.zeros((len(starts), rows)), np.zeros((len(starts), rows, 3))
    for n, i in enumerate(starts):
        part = slice(i - lead, i - lead + rows)
        across = np.linalg.norm(np.delete(force[part], axis, axis=1), axis=1).max()
        if struck[part].max() < ALONG * np.hypot(struck[part].max(), across):
            raise ValueError(
                f"hammer: the blow at t = {time[i]:.4g} s has no clear direction ({force[i].round(1).tolist()} N); strike along x, y or z"
            )
        f = force[part, axis] - force[i - lead : max(i - 2, i - lead + 1), axis].mean()
        forces[n] = f * _pulse(np.abs(f))
        answers[n] = acceleration[part] - acceleration[i - lead : max(i - 2, i - lead + 1)].mean(axis=0)
    F, A = np.fft.rfft(forces)[:, 1:], np.fft.rfft(answers, axis=1)[:, 1:]
    ff, aa = np.mean(np.abs(F) ** 2, axis=0)[:, None], np.mean(np.abs(A) ** 2, axis=0)
    fa = np.mean(np.conj(F)[:, :, None] * A, axis=0)
    coherence = np.abs(fa) ** 2 / np.maximum(ff * aa, np.finfo(float).tiny)
    peaks = np.abs(forces).max(axis=1)
    return Response(
        axis, np.asarray(np.fft.rfftfreq(rows, step)[1:], dtype=np.float64), fa / ff, coherence, len(starts), float(peaks.mean())
    )


def _sampling(time: FloatArray, force: FloatArray, acceleration: FloatArray) -> float:
    """Sampling interval [s] of a record without gaps."""
    steps = np.diff(time)
    step = float(np.median(steps)) if len(steps) else 0.0
    if not step > 0.0:
        raise ValueError(f"hammer: {len(time)} samples at no increasing time; expected a record of blows")
    if wrong := np.flatnonzero(np.abs(steps - step) > JITTER * step).tolist():
        k = wrong[0]
        raise ValueError(
            f"hammer: the record has a gap: {1e3 * steps[k]:.4g} ms after t = {time[k]:.6g} s, elsewhere {1e3 * step:.4g} ms "
            f"({len(wrong)} such places); a frequency response needs even samples: cut the blows with gaps out, or record again"
        )
    for name, values in (("force", force), ("acceleration", acceleration)):
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(bad):
            raise ValueError(
                f"hammer: the record has a gap: {name} at t = {time[bad[0]]:.6g} s is {values[bad[0]].tolist()}, expected finite numbers "
                f"({len(bad)} such samples); cut the blows with gaps out, or record again"
            )
    return step


def _blows(struck: FloatArray, threshold: float, rows: int, step: float, time: FloatArray) -> list[int]:
    """Samples at which blows begin. ValueError for two within the record of one."""
    above = struck > threshold
    rises = np.flatnonzero(above & ~np.r_[False, above[:-1]])
    starts: list[int] = []
    for i in rises:
        if starts and i - starts[-1] < rows:
            raise ValueError(
                f"hammer: blows at t = {time[starts[-1]]:.4g} and {time[i]:.4g} s are within one record of {rows * step:.4g} s; a double "
                "blow has to be cut out, or take a shorter duration"
            )
        starts.append(int(i))
    return starts


def _pulse(size: FloatArray) -> FloatArray:
    """Force window [rows]: 1 while the blow lasts, with as much on either side, cosine to 0 beyond."""
    top = int(np.argmax(size))
    held = size > PULSE * size[top]
    first, last = top, top
    while first > 0 and held[first - 1]:
        first -= 1
    while last < len(size) - 1 and held[last + 1]:
        last += 1
    wide = max(last - first, 2)
    away = np.maximum(first - np.arange(len(size)), np.arange(len(size)) - last) / wide
    return np.asarray(np.where(away <= 0.5, 1.0, np.where(away < 1.5, 0.5 + 0.5 * np.cos(np.pi * (away - 0.5)), 0.0)))


def simulated_blows(
    modes: TipModes,
    direction: int,
    *,
    peak: float = 1500.0,
    width: float = 0.010,
    blows: int = 5,
    duration: float = 8.0,
    rate: float = 512.0,
    noise: float = 0.03,
    force_noise: float = 1.0,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time [n] s, force [n, 3] N and acceleration [n, 3] m/s2 at T in B of blows on an elastic robot, half sines along one axis.

    Modes below `FAST` Hz, each exact for a force that is constant over a sixteenth of a sample; white noise of both sensors. Peaks vary
    by a tenth, as by hand. `width` s of the half sine, `duration` s between blows, `rate` Hz, `noise` m/s2, `force_noise` N rms.
    """
    rng = np.random.default_rng(seed)
    n, h = round(blows * duration * rate) + round(rate), 1.0 / (rate * FINE)
    force = np.zeros(n * FINE)
    for b in range(blows):
        start = round((0.5 + b * duration) / h) + int(rng.integers(0, FINE))
        count = round(width / h)
        force[start : start + count] += peak * rng.uniform(0.9, 1.1) * np.sin(np.pi * (np.arange(count) + 0.5) / count)
    acceleration = np.zeros((n, 3))
    for k in np.flatnonzero(modes.frequency < FAST):
        w, zeta = 2.0 * np.pi * modes.frequency[k], modes.damping[k]
        system = ([1.0, 0.0, 0.0], [1.0, 2.0 * zeta * w, w * w])
        top, bottom, _ = signal.cont2discrete(system, h, "zoh")
        answer = signal.lfilter(top[0], bottom, modes.shape[direction, k] * force)[::FINE]
        acceleration += answer[:, None] * modes.shape[:3, k]
    shown = np.zeros((n, 3))
    shown[:, direction] = force[::FINE]
    shown += force_noise * rng.normal(size=shown.shape)
    return np.arange(n) / rate, shown, acceleration + noise * rng.normal(size=acceleration.shape)
