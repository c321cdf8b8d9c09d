"""Where the rigid-body model of the recorded KR 300 is wrong, why, and how far that closes the gap.

Recording A is diagnosed, B is held out: nothing is chosen or fitted on B.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.catalogue import Candidate, Catalogue
from robomill.logs.importing import import_log
from robomill.models.robot.dynamics import KR300_DYNAMICS
from robomill.orchestration.runs.run import Run
from robomill.real_gap.estimation import (
    MARGIN,
    Fit,
    FloatArray,
    H,
    Noise,
    Problem,
    Recording,
    Step,
    Values,
    fit,
    low_pass,
    select,
    simulate,
)

DATA = Path("data") / "kuka_kr300_recordings"
LINK_EFFECTS = ("encoder_offset", "encoder_lag", "joint_compliance", "backlash")
HYPOTHESES: Mapping[str, tuple[str, ...]] = {
    "offset": ("encoder_offset",),
    "offset + backlash": ("encoder_offset", "backlash"),
    "offset + twist": ("encoder_offset", "joint_compliance"),
    "offset + twist + backlash": ("encoder_offset", "joint_compliance", "backlash"),
    "offset + lag": ("encoder_offset", "encoder_lag"),
    "offset + lag + backlash": ("encoder_offset", "encoder_lag", "backlash"),
    "offset + lag + twist": ("encoder_offset", "encoder_lag", "joint_compliance"),
    "offset + lag + twist + backlash": ("encoder_offset", "encoder_lag", "joint_compliance", "backlash"),
}
"""What the difference between motor and link encoder may be."""
G = KR300_DYNAMICS.gear_ratio
REVERSAL = 0.15
"""Time [s] around a change of direction that counts as reversal."""
TOGETHER = 0.8
"""|correlation| of fitted values from beyond which two effects are rivals (judgement): one can take over most of the other."""


# --------------------------------------------------------------------------------------------- gate


def lag_between(x: FloatArray, y: FloatArray, extra: Sequence[FloatArray] = ()) -> float:
    """Time [s] by which `y` [n] is late against `x` [n]: y = a x(t - lag) + b + sum c_i extra_i, least squares over the lag."""
    n = 40
    base = np.arange(len(x), dtype=float)
    inside = slice(n, len(x) - n)

    def cost(samples: float) -> float:
        M = np.column_stack([np.interp(base - samples, base, x), np.ones(len(x)), *extra])[inside]
        r = y[inside] - M @ np.linalg.lstsq(M, y[inside], rcond=None)[0]
        return float(r @ r)

    grid = np.arange(-n, n + 1.0)
    centre = float(grid[int(np.argmin([cost(g) for g in grid]))])
    for width in (0.25, 0.02):
        fine = centre + width * np.arange(-4, 5)
        centre = float(fine[int(np.argmin([cost(g) for g in fine]))])
    return centre * H


def fast_part(recording: Recording, values: Values) -> FloatArray:
    """Torque residual above 8 Hz [n,6] N m."""
    residual = recording.torque - simulate(recording, values)["torque_motor"]
    return np.asarray(residual - low_pass(residual, 8.0))


def ripple_terms(recording: Recording, axis: int, lag: float) -> tuple[npt.NDArray[np.bool_], FloatArray]:
    """Samples in motion, and cosine and sine of eight times the motor angle `lag` [s] ago there [m,2]."""
    phase = 8.0 * G[axis] * np.interp(recording.t - lag, recording.t, recording.q_raw[:, axis])
    use = np.abs(recording.qd[:, axis]) > math.radians(2.0)
    use[:MARGIN] = use[-MARGIN:] = False
    return use, np.column_stack([np.cos(phase[use]), np.sin(phase[use])])


def torque_clock(recording: Recording) -> list[tuple[float, float]]:
    """Lag [s] of the torques of A1..A3 against the motor angles at which their ripple fits best, and the share it then explains.

    Eight periods per motor turn make a vernier: at 25 deg/s a millisecond is a radian of phase.
    """
    fast = fast_part(recording, {})
    found = []
    for i in range(3):
        best = (0.0, -1.0)
        for lag in 1e-4 * np.arange(-120, 121):
            use, M = ripple_terms(recording, i, float(lag))
            x = fast[use, i]
            share = 1.0 - float(np.sum((x - M @ np.linalg.lstsq(M, x, rcond=None)[0]) ** 2) / np.sum(x**2))
            if share > best[1]:
                best = float(lag), share
        found.append(best)
    return found


@dataclass(frozen=True)
class Gate:
    """Clocks and signs of the channels, by axis: lags [s] against the motor angles, unless said."""

    link: list[float]
    torque: list[tuple[float, float]]
    """As `torque_clock`."""
    speed: list[float]
    """Logged motor speeds against the differentiated motor angles; `link_speed` the same at the link."""
    link_speed: list[float]
    reference: list[float]
    """Motor angles against their reference."""
    tracking: list[float]
    """Largest difference of the motor angles from their reference [rad]."""
    sign: list[tuple[float, float]]
    """Residual [N m] with the sign of the torque as it is, and flipped."""
    counterbalance: tuple[float, float]
    """Residual of A2 [N m] with the counterbalance as it is, and flipped."""


def gate(recording: Recording, run: Run) -> Gate:
    """What is late against the motor encoders, and what has the wrong sign."""
    nominal = simulate(recording, {})
    gear = low_pass(nominal["torque_gear"], 8.0)
    speed, link_speed = run["motion.qd_logged"], run["motion.qd_link_logged"]
    raw_speed, link = np.gradient(recording.q_raw, H, axis=0), recording.q_link
    flipped = simulate(recording, {"counterbalance_error": -2.0})["torque_motor"]
    moving = ~recording.standing[MARGIN:-MARGIN]
    torque = low_pass(recording.torque, 8.0)[MARGIN:-MARGIN]

    def rms(model: FloatArray, sign: float, axis: int) -> float:
        """Residual [N m] after friction that is free."""
        v = recording.qd[MARGIN:-MARGIN, axis]
        y = torque[:, axis] - sign * model[MARGIN:-MARGIN, axis]
        M = np.column_stack([np.tanh(v / 1e-3), v])
        return float(np.std((y - M @ np.linalg.lstsq(M[moving[:, axis]], y[moving[:, axis]], rcond=None)[0])[moving[:, axis]]))

    return Gate(
        link=[lag_between(recording.q_raw[:, i], link[:, i], (gear[:, i],)) for i in range(3)],
        torque=torque_clock(recording),
        speed=[lag_between(raw_speed[:, i], speed[:, i]) for i in range(6)],
        link_speed=[lag_between(np.gradient(link[:, i], H), link_speed[:, i]) for i in range(3)],
        reference=[lag_between(recording.q_ref[:, i], recording.q_raw[:, i]) for i in range(6)],
        tracking=[float(np.abs(recording.q_raw - recording.q_ref)[:, i].max()) for i in range(6)],
        sign=[(rms(nominal["torque_motor"], 1.0, i), rms(nominal["torque_motor"], -1.0, i)) for i in range(6)],
        counterbalance=(rms(nominal["torque_motor"], 1.0, 1), rms(flipped, 1.0, 1)),
    )


# ------------------------------------------------------------------------------------------ figures


@dataclass(frozen=True)
class Closure:
    """A gap before and after, and by how much it closed."""

    before: float
    after: float
    closure: float
    interval: tuple[float, float]


def whitened(problem: Problem, noise: Sequence[Noise], before: Values, after: Values, axes: Sequence[int]) -> Closure:
    """1 - G_after / G_before, G the mean square of whitened residuals; 90 % interval by bootstrap over blocks of 0.5 s."""
    rows = []
    for values in (before, after):
        rows.append([np.square(w) for w in problem.whiten(problem.residual(values), noise)])
    rng = np.random.default_rng(1)
    blocks = [(i, k) for i in axes for k in range(0, len(rows[0][i]), 12)]
    sums = np.array([[rows[j][i][k : k + 12].sum() for j in (0, 1)] for i, k in blocks])
    total = sums.sum(axis=0)
    draws = [sums[rng.integers(0, len(blocks), len(blocks))].sum(axis=0) for _ in range(1000)]
    low, high = np.percentile([1.0 - d[1] / d[0] for d in draws], [5, 95])
    count = sum(len(rows[0][i]) for i in axes)
    return Closure(total[0] / count, total[1] / count, 1.0 - total[1] / total[0], (float(low), float(high)))


@dataclass(frozen=True)
class Residual:
    """Torque residual per axis [6] N m (motor shaft), below 8 Hz."""

    rms: FloatArray
    """In motion."""
    p95: FloatArray
    """95 % of its size in motion."""
    rms_all: FloatArray
    """At all times."""


def left_with(recording: Recording, values: Values) -> Residual:
    """What is left of the torques with some values."""
    r = low_pass(recording.torque - simulate(recording, values)["torque_motor"], 8.0)[MARGIN:-MARGIN]
    moving = ~recording.standing[MARGIN:-MARGIN]
    rms = np.array([np.sqrt(np.mean(r[moving[:, i], i] ** 2)) for i in range(6)])
    p95 = np.array([np.percentile(np.abs(r[moving[:, i], i]), 95) for i in range(6)])
    return Residual(rms, p95, np.sqrt(np.mean(r**2, axis=0)))


def regimes(recording: Recording, values: Values) -> FloatArray:
    """Share of the squared torque residual of each axis at standstill, around reversals and in steady motion [6,3]."""
    r = low_pass(recording.torque - simulate(recording, values)["torque_motor"], 8.0)
    shares = np.empty((6, 3))
    for i in range(6):
        turns = np.flatnonzero(np.diff(np.sign(recording.qd[:, i])) != 0) * H
        near = np.zeros(len(r), dtype=bool)
        for t in turns:
            near |= np.abs(recording.t - recording.t[0] - t) < REVERSAL
        standing = recording.standing[:, i] & ~near
        square = r[:, i] ** 2
        for k, chosen in enumerate((standing, near, ~standing & ~near)):
            shares[i, k] = square[MARGIN:-MARGIN][chosen[MARGIN:-MARGIN]].sum() / square[MARGIN:-MARGIN].sum()
    return shares


@dataclass(frozen=True)
class Ripple:
    """Torque ripple of an axis on A and on B: amplitude [N m], phase [rad], and how much of the residual above 8 Hz it closes."""

    amplitudes: tuple[float, float]
    phases: tuple[float, float]
    on_a: float
    with_a: float
    """On B with amplitude and phase of A."""
    turned: float
    """On B with the amplitude of A and a phase of its own."""


def ripple(recordings: Sequence[Recording], values: Values) -> list[Ripple]:
    """Eight periods per motor turn, for each axis."""
    lag = values["torque_lag"]
    fast = [fast_part(r, values) for r in recordings]
    found = []
    for i in range(6):
        (use_a, M_a), (use_b, M_b) = (ripple_terms(r, i, lag) for r in recordings)
        x_a, x_b = fast[0][use_a, i], fast[1][use_b, i]
        a, b = (np.linalg.lstsq(M, x, rcond=None)[0] for M, x in ((M_a, x_a), (M_b, x_b)))
        turned = b * (np.hypot(*a) / np.hypot(*b))
        closed = [float(1.0 - np.sum((x - M @ v) ** 2) / np.sum(x**2)) for x, M, v in ((x_a, M_a, a), (x_b, M_b, a), (x_b, M_b, turned))]
        found.append(
            Ripple(
                (float(np.hypot(*a)), float(np.hypot(*b))),
                (math.atan2(a[1], a[0]), math.atan2(b[1], b[0])),
                closed[0],
                closed[1],
                closed[2],
            )
        )
    return found


@dataclass(frozen=True)
class Use:
    """What an adopted effect is good for."""

    candidate: Candidate
    loss: float
    """Log evidence on A that is lost without it, everything else fitted anew."""
    transfer: float
    """Relative growth of the whitened gap on B without it."""
    rivals: tuple[str, ...]
    """Adopted effects whose values go together with it (|correlation| above TOGETHER)."""


def uses(problem: Problem, held_out: Problem, chosen: Sequence[Candidate], best: Fit) -> list[Use]:
    """Leave each adopted effect out once."""
    axes = range(problem.axes)
    full = whitened(held_out, best.noise, {}, best.by_name, axes).after
    d = np.sqrt(np.diag(best.covariance))
    correlation = best.covariance / np.outer(d, d)
    found = []
    for c in chosen:
        rest = [x for x in chosen if x is not c]
        without = fit(problem, rest, best.by_name, rounds=2)
        there = whitened(held_out, best.noise, {}, without.by_name, axes).after
        mine = [best.names.index(p) for p in c.parameters]
        theirs = {x.name: [best.names.index(p) for p in x.parameters] for x in rest}
        rivals = tuple(name for name, its in theirs.items() if np.abs(correlation[np.ix_(mine, its)]).max() > TOGETHER)
        found.append(Use(c, best.log_evidence - without.log_evidence, there / full - 1.0, rivals))
    return found


# -------------------------------------------------------------------------------------------- link


@dataclass(frozen=True)
class Hypothesis:
    """What may be between the encoders of motor and link, fitted on A."""

    bic: float
    log_evidence: float
    rms_a: FloatArray
    """What is left on A, per axis [rad]."""
    rms_b: FloatArray
    """What is left on B with the values of A, per axis [rad]."""
    values: Values
    values_b: Values
    """Fitted on B."""


def link_hypotheses(
    catalogue: Catalogue, recordings: Sequence[Recording], adopted: Values
) -> tuple[dict[str, Hypothesis], str, Fit, Problem, Problem]:
    """All hypotheses; the best by evidence with its fit, and the problems."""
    found: dict[str, Hypothesis] = {}
    kept: dict[str, tuple[Fit, Problem, Problem]] = {}
    for name, effects in HYPOTHESES.items():
        for share in (0.0, 1.0):
            if share and "joint_compliance" not in effects:
                continue
            title = name + (", friction behind the spring" if share else "")
            a, b = (Problem(r, "q_link", adopted, {"friction_link_share": share}) for r in recordings)
            candidates = [c for c in catalogue.candidates if c.effect in effects]
            f = fit(a, candidates)
            own = fit(b, candidates)
            left_a, left_b = (np.sqrt(np.mean(r**2, axis=0)) for r in (f.residual, b.residual(f.by_name)))
            found[title] = Hypothesis(f.bic, f.log_evidence, left_a, left_b, f.by_name, own.by_name)
            kept[title] = f, a, b
    best = max(found, key=lambda n: found[n].log_evidence)
    return found, best, *kept[best]


def transmission(problem: Problem, values: Values) -> list[tuple[float, float]]:
    """Strongest period per motor turn in what is left of each link angle, and its amplitude [rad]."""
    r = problem.recording
    left = (r.q_link - simulate(r, {**problem.fixed, **values}, **problem.parameters)["q_link"][:, :3])[MARGIN:-MARGIN]
    orders = np.arange(1.0, 9.0, 0.02)
    found = []
    for i in range(3):
        phase = G[i] * r.q[MARGIN:-MARGIN, i]
        use = np.abs(r.qd[MARGIN:-MARGIN, i]) > math.radians(2.0)
        size = []
        for n in orders:
            M = np.column_stack([np.cos(n * phase[use]), np.sin(n * phase[use])])
            size.append(float(np.hypot(*np.linalg.lstsq(M, left[use, i], rcond=None)[0])))
        best = int(np.argmax(size))
        found.append((float(orders[best]), size[best]))
    return found


# -------------------------------------------------------------------------------------------- run


@dataclass(frozen=True)
class Closures:
    """How far the torque gap closes; on B unless said."""

    axes: list[Closure]
    all: Closure
    on_a: Closure
    ceiling: Closure
    """With the effects fitted on B."""
    no_payload: Residual
    """Before, had the payload been left out of the nominal model."""
    before_a: Residual
    before: Residual
    after: Residual
    regimes_a: FloatArray
    """As `regimes`, on A before; `regimes_left` on B after."""
    regimes_left: FloatArray


@dataclass(frozen=True)
class Result:
    """Everything the report is written from."""

    recordings: tuple[Recording, Recording]
    gates: tuple[Gate, Gate]
    steps: list[Step]
    chosen: list[Candidate]
    best: Fit
    uses: list[Use]
    on_b: Fit
    """The effects of `best` fitted on B: the most that these effects could close there."""
    adopted: dict[str, float]
    closures: Closures
    payload: dict[str, tuple[float, float, float]]
    masquerade: dict[str, tuple[float, float, float]]
    ripple: list[Ripple]
    link: dict[str, Hypothesis]
    link_best: str
    link_fit: Fit
    link_closure: dict[str, Closure]
    transmission: list[list[tuple[float, float]]]


def diagnose(folder: Path) -> Result:
    """The whole diagnosis; run folders go to `folder`."""
    runs = []
    for name in "AB":
        import_log(
            DATA / "map.toml",
            DATA / f"recording_{name}.npz",
            folder / name,
            True,
            {"condition": f"trajectory {name}", "held_out": name == "B"},
        )
        runs.append(Run.load(folder / name))
    A, B = (Recording.of(run, name) for run, name in zip(runs, "AB", strict=True))
    gates = gate(A, runs[0]), gate(B, runs[1])
    catalogue = Catalogue.load(DATA / "catalogue.toml")
    by_name = {c.name: c for c in catalogue.candidates}
    # the gate has the lag of the torques, and the ripple lies above the band of this fit: neither is a candidate here
    offered = [c for c in catalogue.candidates if c.effect not in (*LINK_EFFECTS, "torque_ripple", "torque_lag")]
    clock: dict[str, float] = {"torque_lag": float(np.median([lag for lag, _ in gates[0].torque]))}
    on_a, on_b = Problem(A, "torque_motor", clock), Problem(B, "torque_motor", clock)
    chosen, best, steps = select(on_a, offered, report=lambda text: print(text, flush=True))
    print("leaving each effect out once", flush=True)
    used = uses(on_a, on_b, chosen, best)
    own = fit(on_b, chosen, best.by_name)
    payload: dict[str, tuple[float, float, float]] = {}
    masses = [by_name["payload_mass_error @ payload"], *(by_name[f"payload_com_error @ F.{a}"] for a in "xyz")]
    for name, problem in (("A", on_a), ("B", on_b)):
        f = fit(problem, list(dict.fromkeys([*chosen, *masses])), best.by_name)
        mass = float(A.parameters["payload_mass"])
        low, high = f.interval("payload_mass_error")
        payload[name] = mass + f.by_name["payload_mass_error"], mass + low, mass + high
    lag = by_name["torque_lag @ log"]
    masquerade = {}
    for name, recording in (("A", A), ("B", B)):
        f = fit(Problem(recording, "torque_motor"), [*chosen, lag], {**best.by_name, **clock})
        masquerade[name] = f.by_name["torque_lag"], *f.interval("torque_lag")
    after = {**clock, **best.by_name}
    closures = Closures(
        [whitened(on_b, best.noise, {}, best.by_name, [i]) for i in range(6)],
        whitened(on_b, best.noise, {}, best.by_name, range(6)),
        whitened(on_a, best.noise, {}, best.by_name, range(6)),
        whitened(on_b, best.noise, {}, own.by_name, range(6)),
        left_with(B, {**clock, "payload_mass_error": -float(A.parameters["payload_mass"])}),
        left_with(A, clock),
        left_with(B, clock),
        left_with(B, after),
        regimes(A, clock),
        regimes(B, after),
    )
    print("torque ripple and link encoders", flush=True)
    waves = ripple((A, B), after)
    link, link_name, link_fit, link_a, link_b = link_hypotheses(catalogue, (A, B), best.by_name)
    offset_only = link["offset"].values
    link_closure = {f"A{i + 1}": whitened(link_b, link_fit.noise, offset_only, link_fit.by_name, [i]) for i in range(3)} | {
        "all": whitened(link_b, link_fit.noise, offset_only, link_fit.by_name, range(3))
    }
    return Result(
        (A, B),
        gates,
        steps,
        chosen,
        best,
        used,
        own,
        {**after, **link_fit.by_name},
        closures,
        payload,
        masquerade,
        waves,
        link,
        link_name,
        link_fit,
        link_closure,
        [transmission(p, link_fit.by_name) for p in (link_a, link_b)],
    )
