"""Filters of sampled signals: second-order Butterworth low-pass, moving average, delay line, second-order system.

The kernels work on arrays that the caller declares as states, several channels at a time:
`z` (channels, 2), `ring` (channels, capacity). Each filter has a `*_rest` that puts one channel into
the steady state of a constant input, so that nothing rings at the start.
The chain of Haehn & Weigold 2020, sec. 2.2, is a low-pass followed by a moving average; the paper
gives no constants, those used here are derived in docs/components/sensor_chain.md.
"""

from __future__ import annotations

import math
from typing import Any

from robomill.models.maths.elementary import PI, exp, sincos, tan
from robomill.models.model.declaration import kernel


@kernel
def butterworth(cutoff: float, sample_time: float, b: Any, a: Any) -> None:
    """Coefficients of the second-order Butterworth low-pass, bilinear transform, pre-warped.

    H(z) = (b[0] + b[1]/z + b[2]/z^2) / (1 + a[0]/z + a[1]/z^2), DC gain 1, -3.01 dB at `cutoff` [Hz], which must
    lie below half the sampling rate 1/`sample_time` [s]. `cutoff` = 0 gives H = 1 (filter off).
    """
    if cutoff <= 0.0:
        b[0] = 1.0
        b[1] = b[2] = a[0] = a[1] = 0.0
        return
    k = tan(PI * cutoff * sample_time)
    scale = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
    b[0] = k * k * scale
    b[1] = 2.0 * b[0]
    b[2] = b[0]
    a[0] = 2.0 * (k * k - 1.0) * scale
    a[1] = (1.0 - math.sqrt(2.0) * k + k * k) * scale


@kernel
def biquad_rest(b: Any, a: Any, z: Any, channel: int, u: float) -> None:
    """Steady state of `channel` for the constant input `u` (DC gain 1)."""
    z[channel, 0] = (1.0 - b[0]) * u
    z[channel, 1] = (b[2] - a[1]) * u


@kernel
def biquad(b: Any, a: Any, z: Any, channel: int, u: float) -> float:
    """One sample through the second-order section (transposed direct form II): returns the output for input `u`."""
    y: float = b[0] * u + z[channel, 0]
    z[channel, 0] = b[1] * u - a[0] * y + z[channel, 1]
    z[channel, 1] = b[2] * u - a[1] * y
    return y


@kernel
def average_rest(ring: Any, window: int, channel: int, u: float) -> None:
    """Fill the window of `channel` with the constant input `u`."""
    for k in range(window):
        ring[channel, k] = u


@kernel
def average(ring: Any, window: int, position: int, channel: int, u: float) -> float:
    """Mean of the last `window` samples including `u`, which goes to `position` (0 .. window - 1, advanced by the caller).

    The sum is formed anew each time: a running sum would be faster for long windows but collects rounding errors for ever.
    """
    ring[channel, position] = u
    total = 0.0
    for k in range(window):
        total += ring[channel, k]
    return total / window


@kernel
def delay_rest(ring: Any, capacity: int, channel: int, u: float) -> None:
    """Fill the delay line of `channel` with the constant input `u`."""
    for k in range(capacity):
        ring[channel, k] = u


@kernel
def delay(ring: Any, capacity: int, position: int, samples: float, channel: int, u: float) -> float:
    """The input of `samples` ago, with linear interpolation between samples; 0 <= samples <= capacity - 2.

    `u` goes to `position` (0 .. capacity - 1, advanced by the caller). `samples` = 0 returns `u` itself.
    """
    ring[channel, position] = u
    if samples <= 0.0:
        return u
    whole = math.floor(samples)
    part = samples - float(whole)
    newer = position - int(whole)
    if newer < 0:
        newer += capacity
    recent: float = ring[channel, newer]
    if part == 0.0:
        return recent
    older = newer - 1
    if older < 0:
        older += capacity
    between: float = recent + part * (ring[channel, older] - recent)
    return between


@kernel
def first_order(y: float, before: float, u: float, time_constant: float, h: float) -> float:
    """Output after h [s] of a first-order lag that was at `y`, for an input that runs straight from `before` to `u`; exact.

    On a ramp it ends `time_constant` [s] late, as a dead time of that length does. A time constant of 0 returns `u`.
    """
    if time_constant <= 0.0:
        return u
    behind = time_constant * (u - before) / h
    return u - behind + exp(-h / time_constant) * (y - before + behind)


@kernel
def second_order_zoh(frequency: float, damping: float, h: float, phi: Any, gamma: Any) -> None:
    """Exact discretisation of y'' + 2 D w y' + w^2 y = w^2 u for u held over h.

    `frequency` w [rad/s] > 0, `damping` D [1] > 0, `h` [s]. Sets `phi` [4] (row-major 2 x 2 for
    the state (y, y')) and `gamma` [2].
    """
    decay = exp(-damping * frequency * h)
    discriminant = damping * damping - 1.0
    if discriminant < 0.0:
        wd = frequency * math.sqrt(-discriminant)
        s, c = sincos(wd * h)
        s = s / wd
    elif discriminant > 0.0:
        wd = frequency * math.sqrt(discriminant)
        up, down = exp(wd * h), exp(-wd * h)
        s, c = 0.5 * (up - down) / wd, 0.5 * (up + down)
    else:
        s, c = h, 1.0
    phi[0] = decay * (c + damping * frequency * s)
    phi[1] = decay * s
    phi[2] = -decay * frequency * frequency * s
    phi[3] = decay * (c - damping * frequency * s)
    gamma[0] = 1.0 - phi[0]
    gamma[1] = -phi[2]


def aliased_frequency(frequency: float, sample_rate: float) -> float:
    """Frequency [Hz], 0 .. sample_rate/2, at which a line at `frequency` [Hz] appears when sampled at `sample_rate` [Hz]."""
    return abs(frequency - sample_rate * math.floor(frequency / sample_rate + 0.5))


def moving_average_window(spindle_hz: float, sample_hz: float, longest: int = 25) -> int:
    """Length of the moving average that removes the once-per-revolution line of the spindle, as sampled.

    A window of N samples has zeros at the multiples of sample_hz/N, hence N = m * sample_hz / f_alias with m = 1, 2, ...
    Of all m with N <= `longest` the one whose rounding to whole samples leaves least of the line is taken,
    the shortest where several remove it alike. The mean delay is (N - 1)/2 samples, which is why `longest` matters.

    Parameters: `spindle_hz` [Hz] spindle frequency n/60, `sample_hz` [Hz]. 13 000 rpm at 250 Hz: alias 33.3 Hz, N = 15.
    Errors: ValueError for frequencies that are not positive, a line that folds to (nearly) zero, or is too slow for `longest`.
    """
    if not (spindle_hz > 0.0 and sample_hz > 0.0):
        raise ValueError(f"moving_average_window: spindle {spindle_hz} Hz and sampling {sample_hz} Hz must both be positive")
    line = aliased_frequency(spindle_hz, sample_hz)
    if line * (longest + 0.5) <= sample_hz:
        raise ValueError(
            f"moving_average_window: the spindle line at {spindle_hz:g} Hz appears at {line:g} Hz when sampled at {sample_hz:g} Hz; "
            f"a window of at most {longest} samples removes lines above {sample_hz / longest:g} Hz. "
            "Change the spindle speed or the sampling rate, or allow a longer window."
        )
    best, least = 1, math.inf
    m = 1
    while (window := math.floor(m * sample_hz / line + 0.5)) <= longest:
        left = abs(math.sin(math.pi * line * window / sample_hz) / (window * math.sin(math.pi * line / sample_hz)))
        if left < least - 1e-9:
            best, least = window, left
        m += 1
    return best
