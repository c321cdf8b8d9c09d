"""Component rate_controller: controlled material removal rate (CMRR), from the measured force to the feed.

Zhang, Pan et al., "Robotic machining with force control" (paper 003), sec. 4.3. The path stays, the speed along it changes:
speed_ratio is the commanded feed over the nominal feed V_r. Variants: 0 off (full speed), 1 PI with fixed gains (Eqs. 8-14),
2 the same PI tuned by recursive least squares (Eq. 15), 3 fuzzy rules over stages of speed (sec. 4.3.4).

PI: the force F = K_f f^beta is made linear, F' = F^(1/beta) = k f, and F' follows F_r' = F_r^(1/beta):

    u = K_p e + K_i sum(e h),   e = F_r' - F',   K_i = loop_gain/(V_r k),   K_p = zero_time K_i

between eps/V_r and 1 (Eq. 12), the sum standing still while it would push into a limit. Feeds count in mm/s inside the powers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from robomill.models.maths.elementary import exp, log, power
from robomill.models.maths.fuzzy import conclusion, memberships
from robomill.models.maths.least_squares import innovation, update
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity

OFF, PI, SELF_TUNING, FUZZY = 0, 1, 2, 3
STAGES = 5
"""Most stages of speed."""
ERROR_SETS, TREND_SETS = 5, 4
LEAST_FORCE = 1.0
"""Newton: what counts as force when the tool cuts air and the sensor shows less; powers and logarithms need it positive."""
PER_METRE = 1e3
"""mm/s of one m/s: the unit of the feed in Eq. (6)."""
HALF_STAGE = 0.5
"""Part of the way to the next slower stage that the rules must ask for before it is taken."""
MARGIN = 0.05
"""Speed ratio by which a stage may lie above what the rules ask for."""
FASTER = 0.1
"""Change of the speed ratio that the rules must ask for before a faster stage is taken."""
HEADROOM = 0.95
"""Part of F_r that the force expected at the faster stage must stay below."""

WRONG_STEP, WRONG_VARIANT, WRONG_REFERENCE, WRONG_SPEED, WRONG_FORCE, WRONG_FEED, WRONG_STAGES, WRONG_EXPONENT, WRONG_CENTRES = range(1, 10)
IN_ORDER, STARTING, IN_AIR, SATURATED, NOTHING_NEW, BOUNDED, STOPPED = range(7)
"""Output `status`; 1 to 5 say why the estimate is held or bounded."""


@dataclass(frozen=True)
class RateData:
    """Constants of the rate controller, from a file in models/data/control; the meaning of each is that of the parameter."""

    sample_time: float = field(metadata=quantity("s", 1e-5, 1.0))
    F_r: float = field(metadata=quantity("N", 0.0))
    V_r: float = field(metadata=quantity("m/s", 0.0))
    eps: float = field(metadata=quantity("m/s", 0.0))
    loop_gain: float = field(metadata=quantity("1/s", 0.0))
    zero_time: float = field(metadata=quantity("s", 0.0))
    unit_force: float = field(metadata=quantity("N", 0.0))
    exponent: float = field(metadata=quantity("1", 0.0))
    forgetting: float = field(metadata=quantity("1", 0.5, 1.0))
    trace_bound: float = field(metadata=quantity("1", 0.0))
    dead_zone: float = field(metadata=quantity("1", 0.0))
    exponent_least: float = field(metadata=quantity("1", 0.0))
    exponent_most: float = field(metadata=quantity("1", 0.0))
    start_time: float = field(metadata=quantity("s", 0.0))
    air_force: float = field(metadata=quantity("N", 0.0))
    error_centres: FloatArray = field(metadata=quantity("1"))
    trend_centres: FloatArray = field(metadata=quantity("1/s"))
    rules: FloatArray = field(metadata=quantity("1"))
    stages: FloatArray = field(metadata=quantity("1", 0.0, 1.0))
    filter_time: float = field(metadata=quantity("s", 0.0))
    hold_down: float = field(metadata=quantity("s", 0.0))
    hold_up: float = field(metadata=quantity("s", 0.0))
    stop_error: float = field(metadata=quantity("1", 0.0))
    stop_time: float = field(metadata=quantity("s", 0.0))


RATE = load(RateData, "control/rate_controller")


@kernel
def _rising(centres: FloatArray) -> bool:
    """Tell if each value is larger than the one before."""
    rising = True
    for i in range(1, centres.shape[0]):
        rising = rising and centres[i] > centres[i - 1]
    return rising


@kernel
def _check(s: Record) -> int:
    """Status of the parameters."""
    if s.variant < OFF or s.variant > FUZZY:
        return WRONG_VARIANT
    if not s.F_r > 0.0:
        return WRONG_REFERENCE
    if not 0.0 < s.eps < s.V_r:
        return WRONG_SPEED
    if not 0.0 < s.exponent_least <= s.exponent <= s.exponent_most:
        return WRONG_EXPONENT
    if not (_rising(s.error_centres) and _rising(s.trend_centres)):
        return WRONG_CENTRES
    last = 0.0
    for i in range(int(s.stage_count)):
        if not last < s.stages[i] <= 1.0:
            return WRONG_STAGES
        last = s.stages[i]
    return 0


@kernel
def _cycles(s: Record, duration: float) -> int:
    """Whole cycles in a duration [s]."""
    cycles: int = math.floor(duration / s.sample_time + 0.5)
    return cycles


@kernel
def _estimate(s: Record) -> None:
    """Eq. (15): ln F = theta_1 + beta ln f from this cycle's force and feed; sets k_estimate, beta_estimate and status.

    Held while it cannot learn: at the start, in air, in saturation (the feed stands still), and while the innovation stays in
    the dead zone. So without excitation nothing moves but what noise beyond the dead zone moves, and that within bounds:
    the trace of the covariance and the exponent.
    """
    if s.counter <= _cycles(s, s.start_time):
        s.status = STARTING
    elif s.force < s.air_force:
        s.status = IN_AIR
    elif s.saturated != 0:
        s.status = SATURATED
    else:
        s.regressor[0] = 1.0
        s.regressor[1] = log(PER_METRE * max(s.feed, s.eps))
        seen = log(max(s.force, LEAST_FORCE))
        if abs(innovation(s.theta, s.regressor, seen)) <= s.dead_zone:
            s.status = NOTHING_NEW
        else:
            trace = update(s.theta, s.covariance, s.work, s.regressor, seen, s.forgetting, s.trace_bound)
            s.status = BOUNDED if trace > s.trace_bound else IN_ORDER
            s.beta_estimate = max(s.exponent_least, min(s.exponent_most, s.theta[1]))
            # what is cut off the exponent goes to the other parameter: the force foreseen at this feed stays as estimated
            s.theta[0] += (s.theta[1] - s.beta_estimate) * s.regressor[1]
            s.theta[1] = s.beta_estimate
            s.k_estimate = exp(s.theta[0] / s.beta_estimate)


@kernel
def _pi(s: Record, h: float) -> None:
    """Set speed_ratio: PI on the linearised force, Eqs. (8)-(14), conditional integration at the limits of Eq. (12).

    That keeps the integral between the limits, too: it grows only while wanted, larger than the integral then, is below 1.
    """
    inverse = 1.0 / s.beta_estimate
    error = power(s.F_r, inverse) - power(max(s.force, LEAST_FORCE), inverse)
    ki = s.loop_gain / (PER_METRE * s.V_r * s.k_estimate)
    if s.gain_error != 0.0:
        ki *= 1.0 + s.gain_error
    growth = ki * error * h
    wanted = s.zero_time * ki * error + s.integral + growth
    least = s.eps / s.V_r
    s.saturated = 0
    if wanted > 1.0:
        s.saturated = 1
    elif wanted < least:
        s.saturated = -1
    if s.saturated * error <= 0.0:
        s.integral += growth
    s.speed_ratio = max(least, min(1.0, wanted))


@kernel
def _infer(s: Record, h: float) -> float:
    """Change of the speed ratio that the rules ask for, from the filtered force and its filtered trend; advances the filters."""
    last = s.filtered
    share = h / (s.filter_time + h)
    s.filtered += (s.force - s.filtered) * share
    s.trend += ((s.filtered - last) / (h * s.F_r) - s.trend) * share
    memberships(s.filtered / s.F_r - 1.0, s.error_centres, s.error_grades)
    memberships(s.trend if s.trend_rules != 0 else 0.0, s.trend_centres, s.trend_grades)
    return conclusion(s.rules, s.error_grades, s.trend_grades)


@kernel
def _room(s: Record, faster: float) -> bool:
    """Tell if the force stays below F_r at a feed larger by this factor."""
    return bool(s.filtered * power(faster, s.exponent) < HEADROOM * s.F_r)


@kernel
def _fuzzy(s: Record, h: float) -> None:
    """Set speed_ratio and stage: slower stages at once, faster ones after a hold and if the force allows, stop as a protection."""
    s.change = _infer(s, h)
    if s.status == STOPPED:
        return
    at = int(s.stage) - 1
    now = s.stages[at]
    s.hold = max(s.hold - 1, -1)
    if at > 0 and s.change < 0.0 and s.change <= -HALF_STAGE * (now - s.stages[at - 1]):
        while at > 0 and s.stages[at] > now + s.change + MARGIN:
            at -= 1
        s.hold = _cycles(s, s.hold_down)
    elif at + 1 < s.stage_count and s.change > FASTER and s.hold < 0 and _room(s, s.stages[at + 1] / now):
        at += 1
        s.hold = _cycles(s, s.hold_up)
    s.overload = s.overload + 1 if at == 0 and s.filtered / s.F_r - 1.0 > s.stop_error else 0
    s.stage = at + 1
    s.speed_ratio = s.stages[at]
    if s.overload > _cycles(s, s.stop_time):
        s.status = STOPPED
        s.stage = 0
        s.speed_ratio = 0.0
    s.saturated = 0
    if at == s.stage_count - 1 and s.change > 0.0:
        s.saturated = 1
    elif at == 0 and s.change < 0.0:
        s.saturated = -1


def init(s: Record) -> int:
    """Full speed at t = 0, the estimate at its start, filters settled on the force there."""
    s.step_size = s.sample_time
    status = _check(s)
    if status != 0:
        return status
    s.counter = 0
    s.status = IN_ORDER
    s.saturated = 0
    s.speed_ratio = 1.0
    s.integral = 1.0
    s.theta[0] = log(s.unit_force)
    s.theta[1] = s.exponent
    for i in range(2):
        for j in range(2):
            s.covariance[i, j] = s.trace_bound if i == j else 0.0
    s.beta_estimate = s.exponent
    s.k_estimate = exp(s.theta[0] / s.theta[1])
    s.filtered = s.force
    s.trend = 0.0
    s.change = 0.0
    s.stage = s.stage_count if s.variant == FUZZY else 0
    s.hold = 0
    s.overload = 0
    return 0


def step(s: Record, t: float, h: float) -> int:
    """One cycle: speed_ratio at t + h from the measured force and the feed."""
    s.step_size = h
    if abs(h - s.sample_time) > 1e-9:
        return WRONG_STEP
    if not abs(s.force) < math.inf:
        return WRONG_FORCE
    if not abs(s.feed) < math.inf:
        return WRONG_FEED
    s.counter += 1
    if s.variant == FUZZY:
        _fuzzy(s, h)
    elif s.variant != OFF:
        if s.variant == SELF_TUNING:
            _estimate(s)
        _pi(s, h)
    return 0


_FORCE = ("force",)

VARIABLES = (
    Variable("force", "input", "Measured process force", "N"),
    Variable("feed", "input", "Actual feed along the path", "m/s", display_unit="mm/s"),
    Variable("speed_ratio", "output", "Commanded feed over the nominal feed V_r", "1", (), 1.0, 0.0, 1.0),
    Variable("k_estimate", "output", "Process gain k on which the gains rest, Eq. (9): F^(1/beta) = k f, in N^(1/beta) s/mm"),
    Variable("beta_estimate", "output", "Exponent beta of the feed on which the gains rest"),
    Variable("stage", "output", "Stage of speed from 1, fuzzy only; 0 = stopped", kind="integer", depends_on=_FORCE),
    Variable("saturated", "output", "1 full speed and more wanted, -1 least speed and less wanted, 0 between", kind="integer"),
    Variable(
        "status",
        "output",
        "0 in order; estimate held: 1 start, 2 in air, 3 in saturation, 4 nothing new; 5 covariance at its bound; 6 stopped by protection",
        kind="integer",
    ),
    Variable("variant", "parameter", "0 off, 1 PI with fixed gains, 2 self-tuning PI, 3 fuzzy", "1", (), SELF_TUNING, 0, 3, "integer"),
    Variable("sample_time", "parameter", "Cycle; must be the communication step", "s", (), RATE.sample_time, 1e-5, 1.0, display_unit="ms"),
    Variable("F_r", "parameter", "Reference of the force", "N", (), RATE.F_r),
    Variable("V_r", "parameter", "Nominal feed, the greatest that can be commanded", "m/s", (), RATE.V_r, display_unit="mm/s"),
    Variable("eps", "parameter", "Least feed commanded by the PI (Eq. 12)", "m/s", (), RATE.eps, display_unit="mm/s"),
    Variable("loop_gain", "parameter", "Gain of the open loop V_r k K_i (Eq. 13)", "1/s", (), RATE.loop_gain, 0.0),
    Variable("zero_time", "parameter", "K_p over K_i (Eq. 11)", "s", (), RATE.zero_time, 0.0, display_unit="ms"),
    Variable(
        "unit_force",
        "parameter",
        "Force at a feed of 1 mm/s that the fixed gains (start: the tuning) count on",
        "N",
        (),
        RATE.unit_force,
        1e-3,
    ),
    Variable(
        "exponent", "parameter", "Exponent beta of the feed that the fixed gains (start: the tuning) count on", "1", (), RATE.exponent
    ),
    # self-tuning
    Variable("forgetting", "parameter", "Forgetting factor per cycle", "1", (), RATE.forgetting, 0.5, 1.0),
    Variable("trace_bound", "parameter", "Largest trace of the covariance; each variance starts there", "1", (), RATE.trace_bound, 0.0),
    Variable("dead_zone", "parameter", "Innovation of ln F that is taken for noise", "1", (), RATE.dead_zone, 0.0),
    Variable("exponent_least", "parameter", "Least exponent that is believed", "1", (), RATE.exponent_least),
    Variable("exponent_most", "parameter", "Largest exponent that is believed", "1", (), RATE.exponent_most),
    Variable("start_time", "parameter", "Time before the estimate begins", "s", (), RATE.start_time, 0.0, 100.0, display_unit="ms"),
    Variable("air_force", "parameter", "Force below which the tool cuts air: nothing is learnt", "N", (), RATE.air_force, 0.0),
    # fuzzy
    Variable("error_centres", "parameter", "Peaks of the sets of F/F_r - 1", "1", (ERROR_SETS,), RATE.error_centres),
    Variable("trend_centres", "parameter", "Peaks of the sets of dF/dt/F_r", "1/s", (TREND_SETS,), RATE.trend_centres),
    Variable(
        "rules", "parameter", "Change of the speed ratio: rows error, columns trend", "1", (ERROR_SETS, TREND_SETS), RATE.rules, -1.0, 1.0
    ),
    Variable("trend_rules", "parameter", "Force trend rules on; off the trend counts as zero", "1", (), 1, kind="boolean"),
    Variable("stages", "parameter", "Speed ratios, rising; `stage_count` of them count", "1", (STAGES,), RATE.stages, 0.0, 1.0),
    Variable("stage_count", "parameter", "Number of stages", "1", (), STAGES, 1, STAGES, "integer"),
    Variable(
        "filter_time",
        "parameter",
        "Time constant of the filter of the force, and of its trend",
        "s",
        (),
        RATE.filter_time,
        0.0,
        display_unit="ms",
    ),
    Variable(
        "hold_down", "parameter", "No faster stage for so long after a slower one", "s", (), RATE.hold_down, 0.0, 100.0, display_unit="ms"
    ),
    Variable(
        "hold_up", "parameter", "No faster stage for so long after a faster one", "s", (), RATE.hold_up, 0.0, 100.0, display_unit="ms"
    ),
    Variable("stop_error", "parameter", "F/F_r - 1 in the lowest stage beyond which the robot stops", "1", (), RATE.stop_error, 0.0),
    Variable("stop_time", "parameter", "Duration of it that is tolerated", "s", (), RATE.stop_time, 0.0, 100.0, display_unit="ms"),
    # effects
    Variable(
        "gain_error",
        "parameter",
        "Relative error of both gains of the PI, as when they were set for a depth with a wrong alpha",
        "1",
        (),
        0.0,
        -0.9,
        9.0,
        effect=True,
    ),
    # states
    Variable("counter", "state", "Cycles since the start", kind="integer"),
    Variable("step_size", "state", "Step size of the last call", "s"),
    Variable("integral", "state", "Integral part of the PI"),
    Variable("theta", "state", "Estimate: ln of the force at 1 mm/s in N, exponent", "1", (2,)),
    Variable("covariance", "state", "Covariance of theta over the variance of ln F", "1", (2, 2)),
    Variable("regressor", "state", "Regressor (1, ln f)", "1", (2,)),
    Variable("work", "state", "Scratch: covariance times regressor", "1", (2,)),
    Variable("filtered", "state", "Filtered force", "N"),
    Variable("trend", "state", "Filtered dF/dt/F_r", "1/s"),
    Variable("error_grades", "state", "Membership of the error", "1", (ERROR_SETS,)),
    Variable("trend_grades", "state", "Membership of the trend", "1", (TREND_SETS,)),
    Variable("change", "state", "Change of the speed ratio that the rules ask for"),
    Variable("hold", "state", "Cycles left in which no faster stage is taken", kind="integer"),
    Variable("overload", "state", "Cycles of too much force in the lowest stage", kind="integer"),
)

MODEL = Model(
    "rate_controller",
    "Controlled material removal rate: fixed PI, self-tuning PI or fuzzy rules from force to feed (paper 003, sec. 4.3)",
    VARIABLES,
    init,
    step,
    (
        "",
        "the step size is {step_size:g} s at t = {t:g} s, but the controller runs every sample_time = {sample_time:g} s; "
        "set the parameter sample_time to the communication step",
        "variant is {variant}, expected 0 (off), 1 (fixed PI), 2 (self-tuning PI) or 3 (fuzzy)",
        "the reference force F_r is {F_r:g} N, expected more than 0; give the force that the process shall have",
        "the least feed eps is {eps:g} m/s and the nominal feed V_r {V_r:g} m/s, expected 0 < eps < V_r; lower eps or raise V_r",
        "force is {force} N at t = {t:g} s, expected a finite number; look at the sensor and its connection",
        "feed is {feed} m/s at t = {t:g} s, expected a finite number; look at what is connected to it",
        "stages are {stages}, of which stage_count = {stage_count} count, expected rising values above 0 and up to 1; "
        "for two-stage switching give (0.5, 1, 0, 0, 0) and stage_count 2",
        "exponent is {exponent:g}, expected 0 < exponent_least = {exponent_least:g} <= exponent <= exponent_most = {exponent_most:g}; "
        "give the exponent of the feed in the force, or wider bounds",
        "error_centres are {error_centres} and trend_centres {trend_centres}, expected rising values; sort them, with their rules",
    ),
)
