"""Component speed_loop: from commanded to actual feed along the path, Pan & Zhang (paper 003) section 4.1.

    f_c = limited(u V_r)                 commanded feed: ratio u times nominal feed V_r, within the limits of the robot
    f   = G(s) exp(-T s) f_c             actual feed, DC gain 1

Eq. (1), the G that the authors identified, is lost; the candidates A, B and C of FACTS 2.2 agree with every number of the text:

    A  (1 - s/126) / ((1 + s/66.5)(1 + s/95.06))
    B  1 / ((1 + s/66.5)(1 + s/127.8))              default; its dead time of 9.83 ms is that of the connections around it
    C  (1 - s/221.4) / ((1 + s/66.5)(1 + 2 0.975 s/150 + s^2/150^2))

The discretisation is exact for a command that is held over a step, the dead time T included (docs/decisions/0040).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from robomill.models.maths.elementary import exp
from robomill.models.maths.filters import second_order_zoh
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity

QUEUE = 130
"""Places of the queue that realises the dead time: 0.5 s at 4 ms, one for the command itself, one for a broken step."""
CANDIDATES = 3
HIGHEST_RATIO = 1.5
"""Largest override that `path_interpolator` takes."""
WRONG_STEP, WRONG_DEAD_TIME, NOT_FINITE = 1, 2, 3


@dataclass(frozen=True)
class SpeedLoop:
    """Candidates for G(s), arrays in the order A, B, C."""

    slow_pole: FloatArray = field(metadata=quantity("rad/s", 0.0))
    zero: FloatArray = field(metadata=quantity("rad/s", 0.0))
    fast_pole: FloatArray = field(metadata=quantity("rad/s", 0.0))
    fast_damping: FloatArray = field(metadata=quantity("1", 0.0))
    nominal_feed: float = field(metadata=quantity("m/s", 0.0))
    feed_max: float = field(metadata=quantity("m/s", 0.0))


SPEED_LOOP = load(SpeedLoop, "control/speed_loop")


@kernel
def _split(s: Record) -> None:
    """Write G(s) as r/(1 + s/p) + (c0 + c1 s)/(1 + 2 D s/w + s^2/w^2): s.slow_share = r, s.direct = c0, s.rate_share = c1 [s].

    Two real poles are a second-order system with D > 1, then r = 0.
    """
    i = int(s.candidate) - 1
    p, fast, damping = s.slow_pole[i], s.fast_pole[i], s.fast_damping[i]
    lead = -1.0 / s.zero[i] if s.zero[i] > 0.0 else 0.0
    if damping == 0.0:
        s.frequency = math.sqrt(p * fast)
        s.damping = 0.5 * (p + fast) / s.frequency
        s.slow_share = 0.0
        s.direct = 1.0
        s.rate_share = lead
    else:
        s.frequency = fast
        s.damping = damping
        s.slow_share = (1.0 - lead * p) / (1.0 - 2.0 * damping * p / fast + p * p / (fast * fast))
        s.direct = 1.0 - s.slow_share
        s.rate_share = -s.slow_share * p / (fast * fast)


@kernel
def _move(s: Record, u: float, h: float) -> None:
    """States after h [s] with the delayed command u [m/s] held."""
    decay = exp(-s.slow_pole[int(s.candidate) - 1] * h)
    second_order_zoh(s.frequency, s.damping, h, s.phi, s.gamma)
    s.slow = decay * s.slow + (1.0 - decay) * u
    y = s.phi[0] * s.y + s.phi[1] * s.yd + s.gamma[0] * u
    s.yd = s.phi[2] * s.y + s.phi[3] * s.yd + s.gamma[1] * u
    s.y = y


@kernel
def _limited(s: Record, h: float) -> float:
    """Commanded feed [m/s] within the limits; s.command is that of the step before."""
    wanted: float = min(max(s.speed_ratio, 0.0) * s.nominal_feed, s.feed_max)
    if s.feed_rate > 0.0 and h > 0.0:
        wanted = min(max(wanted, s.command - s.feed_rate * h), s.command + s.feed_rate * h)
    return wanted


@kernel
def _put_out(s: Record) -> None:
    """Outputs from the states. The undershoot of a right half-plane zero does not drive the tool backwards."""
    s.feed = max(s.slow_share * s.slow + s.direct * s.y + s.rate_share * s.yd, 0.0)
    s.path_ratio = min(s.feed / s.nominal_feed, HIGHEST_RATIO)
    s.feed_command = s.command


def init(s: Record) -> int:
    """At the feed that is commanded at t = 0, for long."""
    if not abs(s.speed_ratio) < math.inf:
        return NOT_FINITE
    if s.dead_time + s.extra_lag > (QUEUE - 2) * s.sample_time:
        return WRONG_DEAD_TIME
    _split(s)
    s.command = _limited(s, 0.0)
    s.place = 0
    for k in range(QUEUE):
        s.queue[k] = s.command
    s.slow = s.command
    s.y = s.command
    s.yd = 0.0
    _put_out(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Feed at t + h for the ratio held over the step."""
    s.step_size = h
    if abs(h - s.sample_time) > 1e-9 * s.sample_time:
        return WRONG_STEP
    if not abs(s.speed_ratio) < math.inf:
        return NOT_FINITE
    s.command = _limited(s, h)
    s.place = (int(s.place) + 1) % QUEUE
    s.queue[int(s.place)] = s.command
    steps = (s.dead_time + s.extra_lag) / h
    # 0.008 / 0.004 may be 2.0000000000000004: whole steps are meant
    if abs(steps - math.floor(steps + 0.5)) < 1e-9:
        steps = float(math.floor(steps + 0.5))
    whole = math.floor(steps)
    broken = (steps - whole) * h
    newer = (int(s.place) + QUEUE - whole) % QUEUE
    if broken > 0.0:
        # the delayed command changes within the step
        _move(s, s.queue[(newer + QUEUE - 1) % QUEUE], broken)
        _move(s, s.queue[newer], h - broken)
    else:
        _move(s, s.queue[newer], h)
    _put_out(s)
    return 0


_RATIO = ("speed_ratio",)


def _candidates(name: str, description: str, unit: str, values: FloatArray) -> Variable:
    """A figure of G(s), one value per candidate A, B, C."""
    return Variable(name, "parameter", f"{description}, for A, B, C", unit, (CANDIDATES,), values, 0.0)


MODEL = Model(
    name="speed_loop",
    description="Speed dynamics of the robot along the path: from commanded to actual feed",
    variables=(
        Variable("speed_ratio", "input", "Commanded feed over the nominal feed", "1", start=1.0),
        Variable("feed", "output", "Actual feed along the path", "m/s", display_unit="mm/s", depends_on=_RATIO),
        Variable("path_ratio", "output", "Actual feed over the nominal feed: speed_ratio of path_interpolator", "1", depends_on=_RATIO),
        Variable("feed_command", "output", "Commanded feed within the limits", "m/s", display_unit="mm/s", depends_on=_RATIO),
        Variable("candidate", "parameter", "Form of G(s): 1 = A, 2 = B without its dead time, 3 = C", "1", (), 2, 1, CANDIDATES, "integer"),
        _candidates("slow_pole", "Slow pole", "rad/s", SPEED_LOOP.slow_pole),
        _candidates("zero", "Zero in the right half-plane (0 = none)", "rad/s", SPEED_LOOP.zero),
        _candidates("fast_pole", "Fast pole, or natural frequency of the fast pair", "rad/s", SPEED_LOOP.fast_pole),
        _candidates("fast_damping", "Damping ratio of the fast pair (0 = one real pole)", "1", SPEED_LOOP.fast_damping),
        Variable("dead_time", "parameter", "Dead time that the connections around it do not have", "s", (), 0.0, 0.0, display_unit="ms"),
        Variable("nominal_feed", "parameter", "Nominal feed V_r", "m/s", (), SPEED_LOOP.nominal_feed, 1e-6, display_unit="mm/s"),
        Variable("feed_max", "parameter", "Largest feed that is commanded", "m/s", (), SPEED_LOOP.feed_max, 0.0, display_unit="mm/s"),
        Variable("feed_rate", "parameter", "Largest rate of the commanded feed; 0: no limit", "m/s2", (), 0.0, 0.0),
        Variable("sample_time", "parameter", "Communication step", "s", (), 0.004, 1e-5, 1.0, display_unit="ms"),
        Variable("extra_lag", "parameter", "Effect: additional dead time of the speed loop", "s", (), 0.0, 0.0, 0.5, effect=True),
        Variable("slow_share", "state", "Share of the slow pole in the partial fractions of G(s)", "1"),
        Variable("direct", "state", "Share of the second-order part", "1"),
        Variable("rate_share", "state", "Share of its rate", "s"),
        Variable("frequency", "state", "Natural frequency of the second-order part", "rad/s"),
        Variable("damping", "state", "Its damping ratio", "1"),
        Variable("command", "state", "Commanded feed within the limits", "m/s"),
        Variable("slow", "state", "State of the slow pole", "m/s"),
        Variable("y", "state", "Output of the second-order part", "m/s"),
        Variable("yd", "state", "Its rate", "m/s2"),
        Variable("queue", "state", "Commands on their way", "m/s", (QUEUE,)),
        Variable("place", "state", "Place of the last command in the queue", kind="integer"),
        Variable("phi", "state", "Scratch: transition matrix of the second-order part", "1", (4,)),
        Variable("gamma", "state", "Scratch: its input matrix", "1", (2,)),
        Variable("step_size", "state", "Step size of the last call", "s"),
    ),
    init=init,
    step=step,
    errors=(
        "",
        "the step size is {step_size} s at t = {t} s; expected sample_time = {sample_time} s, in whose steps the dead time is counted; "
        "set the step of the run or the parameter sample_time",
        "dead_time {dead_time} s and extra_lag {extra_lag} s are longer together than the queue of 128 steps of sample_time = "
        "{sample_time} s; shorten them, or take a longer step",
        "speed_ratio is {speed_ratio} at t = {t} s; expected a finite number, 0 to 1.5; check the rate controller that gives it",
    ),
)
