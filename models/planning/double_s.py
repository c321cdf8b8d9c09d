"""Double-S speed profiles: motion along a path with bounded speed, acceleration and jerk.

Englert (2011), section 4.1.2 and 4.2.2, uses the double-S profile of Biagiotti & Melchiorri, "Trajectory Planning for
Automatic Machines and Robots" (2008), section 3.4: seven phases of constant jerk. Here the acceleration is zero at both
ends of every zone of constant speed limit, and the speeds at the ends follow from looking ahead and back.
All numbers SI; for a turn in place the path coordinate is an angle in rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robomill.models.model.compiled import loaded_on_call
from robomill.models.model.declaration import FloatArray, kernel


@dataclass(frozen=True)
class Phase:
    """A time span of constant jerk; `time` and `path` count from the start of the profile."""

    time: float
    duration: float
    path: float
    speed: float
    acceleration: float
    jerk: float

    def at(self, t: float) -> tuple[float, float, float]:
        """Path [m], speed [m/s] and acceleration [m/s2] at `t` [s] after the start of the phase."""
        v = self.speed + t * (self.acceleration + t * self.jerk / 2.0)
        return self.path + t * (self.speed + t * (self.acceleration / 2.0 + t * self.jerk / 6.0)), v, self.acceleration + t * self.jerk

    def time_at(self, path: float) -> float:
        """Time [s] after the start of the phase at which `path` [m] is reached; 0 or `duration` beyond its ends."""
        return time_at(self.time, self.duration, self.path, self.speed, self.acceleration, self.jerk, path)


@kernel
def path_at(path: float, speed: float, acceleration: float, jerk: float, t: float) -> float:
    """Path [m] at `t` [s] after the start of a phase with these fields."""
    return path + t * (speed + t * (acceleration / 2.0 + t * jerk / 6.0))


@kernel
def time_at(time: float, duration: float, path: float, speed: float, acceleration: float, jerk: float, target: float) -> float:
    """`Phase.time_at` of the path `target` [m]: Newton's method, kept between bounds."""
    if target <= path:
        return 0.0
    if target >= path_at(path, speed, acceleration, jerk, duration):
        return duration
    low, high = 0.0, duration
    t = 0.5 * duration
    while True:
        s = path_at(path, speed, acceleration, jerk, t)
        v = speed + t * (acceleration + t * jerk / 2.0)
        if s < target:
            low = t
        else:
            high = t
        newton = t - (s - target) / v if v > 0.0 else low
        new = newton if low < newton < high else 0.5 * (low + high)
        if abs(new - t) <= 4e-16 * (time + duration) or not low < new < high:
            return new
        t = new


@kernel
def ramp_time(v0: float, v1: float, acceleration: float, jerk: float) -> float:
    """Shortest time [s] from speed v0 to v1 [m/s] with zero acceleration at both ends."""
    change = abs(v1 - v0)
    if change >= acceleration * acceleration / jerk:
        return change / acceleration + acceleration / jerk
    return 2.0 * math.sqrt(change / jerk)


@kernel
def ramp_length(v0: float, v1: float, acceleration: float, jerk: float) -> float:
    """Path [m] of that ramp: it is point-symmetric, so its mean speed is that of its ends."""
    return 0.5 * (v0 + v1) * ramp_time(v0, v1, acceleration, jerk)


@kernel
def reachable_speed(v0: float, v_max: float, length: float, acceleration: float, jerk: float) -> float:
    """Largest speed [m/s] in [v0, v_max] that a ramp from v0 reaches within `length` [m]."""
    if ramp_length(v0, v_max, acceleration, jerk) <= length:
        return v_max
    low, high = v0, v_max
    while True:  # to the last bit
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return low
        if ramp_length(v0, middle, acceleration, jerk) <= length:
            low = middle
        else:
            high = middle


@kernel
def peak_speed(length: float, v0: float, v1: float, v_max: float, acceleration: float, jerk: float) -> float:
    """Largest speed [m/s] up to v_max that ramps from v0 and to v1 reach within `length` [m]; at least the larger of both."""
    low, high = max(v0, v1), v_max
    if ramp_length(v0, high, acceleration, jerk) + ramp_length(high, v1, acceleration, jerk) <= length:
        return high
    if ramp_length(v0, low, acceleration, jerk) + ramp_length(low, v1, acceleration, jerk) >= length:
        return low
    while True:  # to the last bit
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return low
        if ramp_length(v0, middle, acceleration, jerk) + ramp_length(middle, v1, acceleration, jerk) <= length:
            low = middle
        else:
            high = middle


@kernel
def put_ramp(phases: FloatArray, count: int, v0: float, v1: float, acceleration: float, jerk: float) -> int:
    """Write the shortest ramp from v0 to v1 behind `count` rows: rise, hold and fall of the acceleration; the new count."""
    change, sign = abs(v1 - v0), math.copysign(1.0, v1 - v0)
    rise = min(acceleration / jerk, math.sqrt(change / jerk))
    hold = max(change / acceleration - acceleration / jerk, 0.0)
    top = sign * jerk * rise
    gained = 0.5 * top * rise
    count = put_phase(phases, count, rise, v0, 0.0, sign * jerk)
    count = put_phase(phases, count, hold, v0 + gained, top, 0.0)
    return put_phase(phases, count, rise, v1 - gained, top, -sign * jerk)


@kernel
def put_phase(phases: FloatArray, count: int, duration: float, speed: float, acceleration: float, jerk: float) -> int:
    """Write a phase behind `count` rows, where the path and the time are in row `count`; the new count."""
    if duration <= 0.0:
        return count
    row, following = phases[count], phases[count + 1]
    row[1], row[3], row[4], row[5] = duration, speed, acceleration, jerk
    following[0] = row[0] + duration
    following[2] = path_at(row[2], speed, acceleration, jerk, duration)
    return count + 1


@loaded_on_call
def zones_to_phases(
    lengths: FloatArray, limits: FloatArray, acceleration: float, jerk: float, phases: FloatArray, borders: FloatArray
) -> int:
    """Fill the rows of `phases`, as the fields of `Phase`, for zones (n,); 7 n + 1 rows are enough. Returns how many are filled.

    `borders` (n + 1,) are zeros, for scratch.
    """
    n = len(lengths)
    for i in range(1, n):
        borders[i] = min(limits[i - 1], limits[i])
    for i in range(n - 1, 0, -1):
        borders[i] = reachable_speed(min(borders[i + 1], borders[i]), borders[i], lengths[i], acceleration, jerk)
    for i in range(1, n):
        borders[i] = reachable_speed(min(borders[i - 1], borders[i]), borders[i], lengths[i - 1], acceleration, jerk)
    count = 0
    start = 0.0
    for i in range(n):
        phases[count, 2] = start
        v0, v1 = borders[i], borders[i + 1]
        peak = peak_speed(lengths[i], v0, v1, limits[i], acceleration, jerk)
        ramps = ramp_length(v0, peak, acceleration, jerk) + ramp_length(peak, v1, acceleration, jerk)
        count = put_ramp(phases, count, v0, peak, acceleration, jerk)
        count = put_phase(phases, count, max(lengths[i] - ramps, 0.0) / peak, peak, 0.0, 0.0)
        count = put_ramp(phases, count, peak, v1, acceleration, jerk)
        start += lengths[i]
    return count


def profile(zones: Sequence[tuple[float, float]], acceleration: float, jerk: float) -> list[Phase]:
    """`phases` as objects."""
    return [Phase(*row) for row in phases(zones, acceleration, jerk).tolist()]


def phases(zones: Sequence[tuple[float, float]], acceleration: float, jerk: float) -> FloatArray:
    """Fastest profile from rest to rest over zones of (length [m], speed limit [m/s]), acceleration zero where they meet.

    Every zone keeps its limit: a slower zone is reached at its speed, a faster one accelerates behind its border. Rows
    are the fields of `Phase`. ValueError if a length, limit, acceleration or jerk is not positive.
    """
    if acceleration <= 0.0 or jerk <= 0.0 or any(length <= 0.0 or limit <= 0.0 for length, limit in zones):
        raise ValueError(
            f"double-S profile: lengths and limits must be positive; got acceleration {acceleration}, jerk {jerk}, zones {list(zones)}"
        )
    lengths, limits = np.array(zones, dtype=np.float64).T.copy()
    rows = np.zeros((7 * len(zones) + 1, 6))
    return rows[: zones_to_phases(lengths, limits, float(acceleration), float(jerk), rows, np.zeros(len(zones) + 1))]
