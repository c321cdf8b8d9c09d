"""Double-S speed profiles: motion along a path with bounded speed, acceleration and jerk.

Englert (2011), section 4.1.2 and 4.2.2, uses the double-S profile of Biagiotti & Melchiorri, "Trajectory Planning for
Automatic Machines and Robots" (2008), section 3.4: seven phases of constant jerk. Here the acceleration is zero at both
ends of every zone of constant speed limit, and the speeds at the ends follow from looking ahead and back.
All numbers SI; for a turn in place the path coordinate is an angle in rad.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass


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
        if path <= self.path:
            return 0.0
        if path >= self.at(self.duration)[0]:
            return self.duration
        low, high = 0.0, self.duration
        t = 0.5 * self.duration
        while True:
            s, v, _ = self.at(t)
            low, high = (t, high) if s < path else (low, t)
            newton = t - (s - path) / v if v > 0.0 else low
            new = newton if low < newton < high else 0.5 * (low + high)
            if abs(new - t) <= 4e-16 * (self.time + self.duration) or not low < new < high:
                return new
            t = new


def ramp_time(v0: float, v1: float, acceleration: float, jerk: float) -> float:
    """Shortest time [s] from speed v0 to v1 [m/s] with zero acceleration at both ends."""
    change = abs(v1 - v0)
    if change >= acceleration * acceleration / jerk:
        return change / acceleration + acceleration / jerk
    return 2.0 * math.sqrt(change / jerk)


def ramp_length(v0: float, v1: float, acceleration: float, jerk: float) -> float:
    """Path [m] of that ramp: it is point-symmetric, so its mean speed is that of its ends."""
    return 0.5 * (v0 + v1) * ramp_time(v0, v1, acceleration, jerk)


def reachable_speed(v0: float, v_max: float, length: float, acceleration: float, jerk: float) -> float:
    """Largest speed [m/s] in [v0, v_max] that a ramp from v0 reaches within `length` [m]."""
    if ramp_length(v0, v_max, acceleration, jerk) <= length:
        return v_max
    return _bisect(lambda v: ramp_length(v0, v, acceleration, jerk), length, v0, v_max)


def zone_phases(length: float, v0: float, v1: float, v_max: float, acceleration: float, jerk: float) -> list[tuple[float, ...]]:
    """From v0 over at most v_max to v1 [m/s] within `length` [m]: up to seven phases.

    Each is (duration [s], jerk [m/s3], speed [m/s] and acceleration [m/s2] at its beginning).
    """

    def ramps(v: float) -> float:
        return ramp_length(v0, v, acceleration, jerk) + ramp_length(v, v1, acceleration, jerk)

    lowest = max(v0, v1)
    if ramps(v_max) <= length:
        peak = v_max
    elif ramps(lowest) >= length:
        peak = lowest
    else:
        peak = _bisect(ramps, length, lowest, v_max)
    cruise = max(length - ramps(peak), 0.0) / peak
    phases = [*_ramp_phases(v0, peak, acceleration, jerk), (cruise, 0.0, peak, 0.0), *_ramp_phases(peak, v1, acceleration, jerk)]
    return [p for p in phases if p[0] > 0.0]


def profile(zones: Sequence[tuple[float, float]], acceleration: float, jerk: float) -> list[Phase]:
    """Fastest profile from rest to rest over zones of (length [m], speed limit [m/s]), acceleration zero where they meet.

    Every zone keeps its limit: a slower zone is reached at its speed, a faster one accelerates behind its border.
    ValueError if a length, limit, acceleration or jerk is not positive.
    """
    if acceleration <= 0.0 or jerk <= 0.0 or any(length <= 0.0 or limit <= 0.0 for length, limit in zones):
        raise ValueError(
            f"double-S profile: lengths and limits must be positive; got acceleration {acceleration}, jerk {jerk}, zones {list(zones)}"
        )
    limits = [limit for _, limit in zones]
    borders = [0.0, *(min(a, b) for a, b in itertools.pairwise(limits)), 0.0]
    for i in range(len(zones) - 1, 0, -1):
        borders[i] = reachable_speed(min(borders[i + 1], borders[i]), borders[i], zones[i][0], acceleration, jerk)
    for i in range(1, len(zones)):
        borders[i] = reachable_speed(min(borders[i - 1], borders[i]), borders[i], zones[i - 1][0], acceleration, jerk)
    phases: list[Phase] = []
    time, start = 0.0, 0.0
    for i, (length, limit) in enumerate(zones):
        path = start
        for duration, j, speed, a in zone_phases(length, borders[i], borders[i + 1], limit, acceleration, jerk):
            phases.append(Phase(time, duration, path, speed, a, j))
            path = phases[-1].at(duration)[0]
            time += duration
        start += length
    return phases


def _ramp_phases(v0: float, v1: float, acceleration: float, jerk: float) -> list[tuple[float, ...]]:
    """Phases (duration, jerk, speed, acceleration) of the shortest ramp from v0 to v1: rise, hold and fall of the acceleration."""
    change, sign = abs(v1 - v0), math.copysign(1.0, v1 - v0)
    rise = min(acceleration / jerk, math.sqrt(change / jerk))
    hold = max(change / acceleration - acceleration / jerk, 0.0)
    top = sign * jerk * rise
    gained = 0.5 * top * rise
    return [(rise, sign * jerk, v0, 0.0), (hold, 0.0, v0 + gained, top), (rise, -sign * jerk, v1 - gained, top)]


def _bisect(function: Callable[[float], float], value: float, low: float, high: float) -> float:
    """Largest v in [low, high) with function(v) <= value, to the last bit, for an increasing function."""
    while True:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return low
        if function(middle) <= value:
            low = middle
        else:
            high = middle
