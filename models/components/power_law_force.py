"""Component power_law_force: process force as a power law of depth, width and feed, Pan & Zhang (paper 003) Eqs. (2)-(6).

    Q   = w d f                                                          Eq. (2), removal rate
    F_0 = g K (d/mm)^(alpha + e) (f/(mm/s))^beta (w/mm)^gamma            Eqs. (3), (4), static
    F   = F_0 / (tau_m s + 1),  tau_m = 0.63 * 60/n                      full chip load after one revolution of the spindle

with F = 23 d^0.9 f^0.5 as default, Eq. (6): gamma = 0, the width is part of K. Depth and width stand in a profile over the way along
the path (or over time), or come from a workpiece of dexels: depth and removal rate of `milling_force`, and Eq. (2) gives the width.
It has the force ports of `milling_force`, so that it stands in for it, and the scalar force that the rate controller works with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from robomill.models.maths.elementary import TWO_PI, cos, exp, power
from robomill.models.maths.frames import cross
from robomill.models.maths.noise import normal_pair
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity
from robomill.models.model.table_access import cell, row_at

COLUMNS = 3
MM = 1e3
"""mm per m: the law is written in mm and mm/s."""
STANDS = 1e-9
"""A spindle below this speed [rad/s], a tool below this feed [m/s]: it stands."""
FORCE_CHANNEL, SKIN_CHANNEL = 0, 1
"""Channels of the random numbers."""
NOT_FINITE, NOT_INCREASING, SPINDLE_STANDS, NEGATIVE_CUT, BAD_STEP = 1, 2, 3, 4, 5


@dataclass(frozen=True)
class PowerLaw:
    """The law of a tool and a workpiece, from a file in models/data/process."""

    gain: float = field(metadata=quantity("N", 0.0))
    depth_exponent: float = field(metadata=quantity("1", 0.0, 2.0))
    feed_exponent: float = field(metadata=quantity("1", 0.0, 2.0))
    width_exponent: float = field(metadata=quantity("1", 0.0, 2.0))
    lag_share: float = field(metadata=quantity("1", 0.0))
    spindle_speed: float = field(metadata=quantity("rad/s", 0.0))
    skin_length: float = field(metadata=quantity("m", 1e-6))


POWER_LAW = load(PowerLaw, "process/power_law")
ONE_MM = np.array([[0.0, 1e-3, 0.05]])
"""Profile until a table is loaded: 1 mm deep, 50 mm wide, everywhere."""


@kernel
def _profile(s: Record, row: int, column: int) -> float:
    """A number of the profile."""
    return cell(s.profile_at, s.profile_rows, COLUMNS, row, column)


@kernel
def _skin(s: Record) -> float:
    """Deviation of the surface [m] at s.distance: standard deviation s.skin_noise, a fixed function of the way and the seed.

    Between normal numbers every `skin_length` it goes over with cos and sin as weights, so that the variance is the same everywhere.
    """
    place = s.distance / s.skin_length
    k = math.floor(place)
    share = 0.25 * TWO_PI * (place - k)
    here, _ = normal_pair(int(s.seed), int(k), SKIN_CHANNEL)
    next_one, _ = normal_pair(int(s.seed), int(k) + 1, SKIN_CHANNEL)
    deviation: float = s.skin_noise * (cos(share) * here + cos(0.25 * TWO_PI - share) * next_one)
    return deviation


@kernel
def _engage(s: Record, t: float) -> None:
    """Set s.depth and s.width [m] at time t [s]: profile, lines between its rows, plus skin; what the dexels say on top."""
    s.depth = 0.0
    s.width = 0.0
    s.finished = 0
    last = int(s.profile_rows) - 1
    if last >= 0:
        x = t if s.over_time != 0 else s.distance
        row = row_at(s.profile_at, s.profile_rows, COLUMNS, x, int(s.row))
        s.row = row
        s.depth = _profile(s, row, 1)
        s.width = _profile(s, row, 2)
        if row < last and x > _profile(s, row, 0):
            share = (x - _profile(s, row, 0)) / (_profile(s, row + 1, 0) - _profile(s, row, 0))
            s.depth += share * (_profile(s, row + 1, 1) - s.depth)
            s.width += share * (_profile(s, row + 1, 2) - s.width)
        if last > 0 and x >= _profile(s, last, 0):
            s.finished = 1
        if s.skin_noise > 0.0 and s.depth > 0.0:
            s.depth = max(s.depth + _skin(s), 0.0)
    s.depth += s.dexel_depth
    if s.dexel_removal_rate > 0.0 and s.depth > 0.0 and s.feed > STANDS:
        s.width = s.dexel_removal_rate / (s.depth * s.feed)


@kernel
def _static_force(s: Record) -> float:
    """F_0 [N] for s.depth, s.width and s.feed."""
    if s.depth <= 0.0 or s.feed <= STANDS:
        return 0.0
    alpha = s.depth_exponent
    if s.depth_exponent_error != 0.0:
        alpha = s.depth_exponent + s.depth_exponent_error
    force: float = s.process_gain * s.gain * power(MM * s.depth, alpha) * power(MM * s.feed, s.feed_exponent)
    if s.width_exponent > 0.0:
        force *= power(MM * s.width, s.width_exponent) if s.width > 0.0 else 0.0
    return force


@kernel
def _put_out(s: Record) -> None:
    """Outputs from s.force: as a vector, and as a sensor shows it."""
    speed = 0.0
    for i in range(3):
        speed += s.v_BT_B[i] * s.v_BT_B[i]
    speed = math.sqrt(speed)
    if speed > STANDS:
        for i in range(3):
            s.feed_B[i] = s.v_BT_B[i] / speed
    # x of T is the tool axis out of the spindle: up is against it
    s.up_B[0] = -(1.0 - 2.0 * (s.quat_BT[2] * s.quat_BT[2] + s.quat_BT[3] * s.quat_BT[3]))
    s.up_B[1] = -2.0 * (s.quat_BT[1] * s.quat_BT[2] + s.quat_BT[0] * s.quat_BT[3])
    s.up_B[2] = -2.0 * (s.quat_BT[1] * s.quat_BT[3] - s.quat_BT[0] * s.quat_BT[2])
    cross(s.up_B, s.feed_B, s.left_B)
    for i in range(3):
        s.f_T_B[i] = s.force * (s.shares[1] * s.left_B[i] + s.shares[2] * s.up_B[i] - s.shares[0] * s.feed_B[i])
        s.m_T_B[i] = s.force * s.torque_arm * s.up_B[i]  # brakes the spindle, which turns clockwise seen from above (M3)
    noise, _ = normal_pair(int(s.seed), int(s.counter), FORCE_CHANNEL)
    s.force_measured = s.force_filtered + s.force_noise * noise
    s.removal_rate = s.width * s.depth * s.feed
    s.feed_cut = s.feed


@kernel
def _check(s: Record) -> int:
    """Status of the inputs."""
    finite = abs(s.feed) < math.inf and abs(s.spindle_speed) < math.inf
    finite = finite and abs(s.dexel_depth) < math.inf and abs(s.dexel_removal_rate) < math.inf
    for i in range(3):
        finite = finite and abs(s.v_BT_B[i]) < math.inf
    for i in range(4):
        finite = finite and abs(s.quat_BT[i]) < math.inf
    if not finite:
        return NOT_FINITE
    if s.feed < 0.0 or s.dexel_depth < 0.0 or s.dexel_removal_rate < 0.0:
        return NEGATIVE_CUT
    return 0


def init(s: Record) -> int:
    """At the beginning of the path, in the steady state of the force there."""
    for row in range(int(s.profile_rows) - 1):
        if _profile(s, row + 1, 0) <= _profile(s, row, 0):
            s.row = row
            return NOT_INCREASING
    status = _check(s)
    if status != 0:
        return status
    s.row = 0
    s.counter = 0
    s.distance = 0.0
    s.feed_before = s.feed
    for i in range(3):
        s.feed_B[i] = 1.0 if i == 0 else 0.0
    _engage(s, 0.0)
    s.force = _static_force(s)
    s.force_filtered = s.force
    _put_out(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Way and force at t + h; the feed goes straight from the last value to the given one, the lag is exact for a held static force."""
    if not h > 0.0:
        return BAD_STEP
    status = _check(s)
    if status != 0:
        return status
    s.counter += 1
    s.distance += 0.5 * h * (s.feed_before + s.feed)
    s.feed_before = s.feed
    _engage(s, t + h)
    static = _static_force(s)
    if static > 0.0 and s.spindle_speed < STANDS:
        return SPINDLE_STANDS
    if s.lag_share > 0.0 and s.spindle_speed >= STANDS:
        s.force = static + (s.force - static) * exp(-h * s.spindle_speed / (s.lag_share * TWO_PI))
    else:
        s.force = static
    s.force_filtered = s.force if s.force_filter <= 0.0 else s.force + (s.force_filtered - s.force) * exp(-h / s.force_filter)
    _put_out(s)
    return 0


_CUT = ("feed", "spindle_speed", "dexel_depth", "dexel_removal_rate")
_VECTOR = (*_CUT, "v_BT_B", "quat_BT")

MODEL = Model(
    name="power_law_force",
    description="Process force as a power law of depth, width and feed, with the lag of the chip load",
    variables=(
        Variable("feed", "input", "Actual feed along the path", "m/s", (), 0.03, 0.0, display_unit="mm/s"),
        Variable("spindle_speed", "input", "Spindle speed", "rad/s", (), POWER_LAW.spindle_speed, 0.0, display_unit="rpm"),
        Variable("v_BT_B", "input", "Feed velocity of T in B: gives the direction of the force; x of B until it moves", "m/s", (3,)),
        Variable(
            "quat_BT",
            "input",
            "Orientation of T in B (x of T = tool axis out of the spindle), scalar first",
            "1",
            (4,),
            (math.sqrt(0.5), 0, math.sqrt(0.5), 0),
        ),
        Variable(
            "dexel_depth", "input", "Depth of cut in a workpiece of dexels, on top of the profile (milling_force.depth)", "m", minimum=0.0
        ),
        Variable(
            "dexel_removal_rate",
            "input",
            "Removal rate there; above 0 it gives the width (milling_force.removal_rate)",
            "m3/s",
            minimum=0.0,
        ),
        Variable("f_T_B", "output", "Process force on the tool at T in B", "N", (3,), depends_on=_VECTOR),
        Variable(
            "m_T_B",
            "output",
            "Process moment on the tool about T in B: the torque of the spindle",
            "N.m",
            (3,),
            depends_on=(*_CUT, "quat_BT"),
        ),
        Variable("force", "output", "Process force", "N", depends_on=_CUT),
        Variable("force_measured", "output", "Process force through the low-pass of a sensor, with its noise", "N", depends_on=_CUT),
        Variable("removal_rate", "output", "Removal rate w d f", "m3/s", display_unit="cm3/min", depends_on=_CUT),
        Variable("depth", "output", "Depth of cut", "m", display_unit="mm", depends_on=("feed", "dexel_depth")),
        Variable("width", "output", "Width of cut", "m", display_unit="mm", depends_on=("feed", "dexel_depth", "dexel_removal_rate")),
        Variable("distance", "output", "Way along the path", "m", display_unit="mm", depends_on=("feed",)),
        Variable("feed_cut", "output", "Feed that the force belongs to", "m/s", display_unit="mm/s", depends_on=("feed",)),
        Variable("finished", "output", "Behind the last row of a profile of several rows", kind="boolean", depends_on=("feed",)),
        Variable(
            "profile",
            "parameter",
            "Rows: way along the path [m] or time [s], depth of cut [m], width of cut [m]; lines between them, held before and after",
            "1",
            (COLUMNS,),
            kind="table",
        ),
        Variable("over_time", "parameter", "The profile is one over time, not over the way", kind="boolean"),
        Variable("gain", "parameter", "Force K at 1 mm and 1 mm/s (with gamma > 0: and 1 mm of width)", "N", (), POWER_LAW.gain, 0.0),
        Variable("process_gain", "parameter", "Factor on the gain: the process as it is against the law", "1", (), 1.0, 0.0, tunable=True),
        Variable("depth_exponent", "parameter", "Exponent alpha of the depth", "1", (), POWER_LAW.depth_exponent, 0.0, 2.0),
        Variable("feed_exponent", "parameter", "Exponent beta of the feed", "1", (), POWER_LAW.feed_exponent, 0.0, 2.0),
        Variable("width_exponent", "parameter", "Exponent gamma of the width; 0: in the gain", "1", (), POWER_LAW.width_exponent, 0.0, 2.0),
        Variable("lag_share", "parameter", "tau_m over the time of a revolution; 0: no lag", "1", (), POWER_LAW.lag_share, 0.0, 10.0),
        Variable(
            "shares", "parameter", "Force against the feed, to its left (seen from the spindle), and up, over F", "1", (3,), (1, 0, 0)
        ),
        Variable("torque_arm", "parameter", "Torque about the tool axis over F", "m", (), 0.0, display_unit="mm"),
        Variable("force_filter", "parameter", "Time constant of the low-pass of the measured force", "s", (), 0.0, 0.0, display_unit="ms"),
        Variable("force_noise", "parameter", "Standard deviation of the noise of each measured force", "N", (), 0.0, 0.0),
        Variable(
            "skin_noise", "parameter", "Standard deviation of the depth by the skin of a casting", "m", (), 0.0, 0.0, display_unit="mm"
        ),
        Variable("skin_length", "parameter", "Way over which the skin changes", "m", (), POWER_LAW.skin_length, 1e-6, display_unit="mm"),
        Variable("seed", "parameter", "Seed of noise and skin: another seed is another repeat", "1", (), 1, 0, 2147483647, "integer"),
        Variable("depth_exponent_error", "parameter", "Effect: alpha is more than the law says", "1", (), 0.0, -0.5, 0.5, effect=True),
        Variable("row", "state", "Row of the profile that the tool is behind", kind="integer"),
        Variable("counter", "state", "Steps made", kind="integer"),
        Variable("force_filtered", "state", "Process force through the low-pass of the sensor", "N"),
        Variable("feed_before", "state", "Feed at the beginning of the step", "m/s"),
        Variable("feed_B", "state", "Direction of the feed in B", "1", (3,)),
        Variable("up_B", "state", "Against the tool axis, in B", "1", (3,)),
        Variable("left_B", "state", "To the left of the feed, in B", "1", (3,)),
    ),
    init=init,
    step=step,
    errors=(
        "",
        "at t = {t} s an input is not finite: feed {feed} m/s, spindle_speed {spindle_speed} rad/s, v_BT_B {v_BT_B} m/s, "
        "quat_BT {quat_BT}, dexel_depth {dexel_depth} m, dexel_removal_rate {dexel_removal_rate} m3/s; check the component that feeds it",
        "the first column of the profile does not increase from row {row} (counted from zero) to the next; "
        "a step of the depth needs two rows a little apart, such as 1 um",
        "at t = {t} s the tool is {depth} m deep in material and fed with {feed} m/s, but spindle_speed is {spindle_speed} rad/s; "
        "expected more than 0: start the spindle before it engages",
        "at t = {t} s feed {feed} m/s, dexel_depth {dexel_depth} m or dexel_removal_rate {dexel_removal_rate} m3/s is negative; "
        "expected 0 or more; check the component that feeds it",
        "the step size must be positive",
    ),
    default_tables={"profile": ONE_MM},
)
