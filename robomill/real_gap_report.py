"""`make diagnose-real`: where the rigid-body model of the recorded KR 300 is wrong, why, and how far that closes the gap.

Recording A is diagnosed, B is held out: nothing is chosen or fitted on B. Writes docs/real_gap.md, docs/real_gap.json (the keys of
a diagnosis) and pictures; needs the two recordings in data/kuka_kr300_recordings and about two minutes.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.catalogue import Candidate, Catalogue
from robomill.logs.importing import import_log
from robomill.models.robot.dynamics import KR300_DYNAMICS
from robomill.orchestration.runs.run import Run
from robomill.real_gap import MARGIN, Fit, FloatArray, H, Problem, Recording, Step, Values, fit, low_pass, select, simulate

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


def gate(recording: Recording, run: Run) -> dict[str, Any]:
    """Clocks and signs of the channels [s]: what is late against the motor encoders."""
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

    return {
        "link": [lag_between(recording.q_raw[:, i], link[:, i], (gear[:, i],)) for i in range(3)],
        "torque": torque_clock(recording),
        "speed": [lag_between(raw_speed[:, i], speed[:, i]) for i in range(6)],
        "link_speed": [lag_between(np.gradient(link[:, i], H), link_speed[:, i]) for i in range(3)],
        "reference": [lag_between(recording.q_ref[:, i], recording.q_raw[:, i]) for i in range(6)],
        "tracking": [float(np.abs(recording.q_raw - recording.q_ref)[:, i].max()) for i in range(6)],
        "sign": [(rms(nominal["torque_motor"], 1.0, i), rms(nominal["torque_motor"], -1.0, i)) for i in range(6)],
        "counterbalance": (rms(nominal["torque_motor"], 1.0, 1), rms(flipped, 1.0, 1)),
        "standing": [float(np.mean(recording.standing[:, i])) for i in range(6)],
    }


# ------------------------------------------------------------------------------------------ figures


@dataclass(frozen=True)
class Closure:
    """A gap before and after, and by how much it closed."""

    before: float
    after: float
    closure: float
    interval: tuple[float, float]


def whitened(problem: Problem, noise: Any, before: Values, after: Values, axes: Sequence[int]) -> Closure:
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


def figures(recording: Recording, before: Values, after: Values) -> dict[str, FloatArray]:
    """Per axis rms and 95 % of |residual| [N m, motor shaft] before and after, below 8 Hz: moving, and at all times."""
    found: dict[str, FloatArray] = {}
    for name, values in (("before", before), ("after", after)):
        r = low_pass(recording.torque - simulate(recording, values)["torque_motor"], 8.0)[MARGIN:-MARGIN]
        moving = ~recording.standing[MARGIN:-MARGIN]
        found[f"{name} rms"] = np.array([np.sqrt(np.mean(r[moving[:, i], i] ** 2)) for i in range(6)])
        found[f"{name} p95"] = np.array([np.percentile(np.abs(r[moving[:, i], i]), 95) for i in range(6)])
        found[f"{name} rms all"] = np.sqrt(np.mean(r**2, axis=0))
    return found


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


def ripple(recordings: Sequence[Recording], values: Values) -> list[dict[str, float]]:
    """Torque ripple of eight periods per motor turn above 8 Hz, per axis: amplitude [N m] and phase [rad] on A and B, closures.

    `B with A` has amplitude and phase of A, `B with the amplitude of A` has a phase of its own.
    """
    lag = values["torque_lag"]
    fast = [fast_part(r, values) for r in recordings]
    found = []
    for i in range(6):
        (use_a, M_a), (use_b, M_b) = (ripple_terms(r, i, lag) for r in recordings)
        x_a, x_b = fast[0][use_a, i], fast[1][use_b, i]
        a, b = (np.linalg.lstsq(M, x, rcond=None)[0] for M, x in ((M_a, x_a), (M_b, x_b)))
        turned = b * (np.hypot(*a) / np.hypot(*b))
        found.append(
            {
                "amplitude A": float(np.hypot(*a)),
                "amplitude B": float(np.hypot(*b)),
                "phase A": math.atan2(a[1], a[0]),
                "phase B": math.atan2(b[1], b[0]),
                "A": float(1.0 - np.sum((x_a - M_a @ a) ** 2) / np.sum(x_a**2)),
                "B with A": float(1.0 - np.sum((x_b - M_b @ a) ** 2) / np.sum(x_b**2)),
                "B with the amplitude of A": float(1.0 - np.sum((x_b - M_b @ turned) ** 2) / np.sum(x_b**2)),
            }
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
    """Adopted effects whose values go together with it (|correlation| above 0.8)."""


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
        rivals = tuple(x.name for x in rest if np.abs(correlation[np.ix_(mine, [best.names.index(p) for p in x.parameters])]).max() > 0.8)
        found.append(Use(c, best.log_evidence - without.log_evidence, there / full - 1.0, rivals))
    return found


# -------------------------------------------------------------------------------------------- link


def link_hypotheses(
    catalogue: Catalogue, recordings: Sequence[Recording], adopted: Values
) -> tuple[dict[str, dict[str, Any]], str, Fit, Problem, Problem]:
    """Each hypothesis on A: BIC, evidence, rms on A and on B [rad]; the best by evidence with its fit, and the problems."""
    found: dict[str, dict[str, Any]] = {}
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
            found[title] = {
                "bic": f.bic,
                "log_evidence": f.log_evidence,
                "A": np.sqrt(np.mean(f.residual**2, axis=0)),
                "B": np.sqrt(np.mean(b.residual(f.by_name) ** 2, axis=0)),
                "values": f.by_name,
                "B values": own.by_name,
            }
            kept[title] = f, a, b
    best = max(found, key=lambda n: found[n]["log_evidence"])
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
class Result:
    """Everything the report is written from."""

    recordings: tuple[Recording, Recording]
    gates: tuple[dict[str, Any], dict[str, Any]]
    steps: list[Step]
    chosen: list[Candidate]
    best: Fit
    uses: list[Use]
    on_b: Fit
    """The same effects fitted on B: the most that these effects could close there."""
    adopted: dict[str, float]
    closures: dict[str, Any]
    payload: dict[str, tuple[float, float, float]]
    masquerade: dict[str, tuple[float, float, float]]
    ripple: list[dict[str, float]]
    link: dict[str, dict[str, Any]]
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
    clock: dict[str, float] = {"torque_lag": float(np.median([lag for lag, _ in gates[0]["torque"]]))}
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
    closures: dict[str, Any] = {
        "axes": [whitened(on_b, best.noise, {}, best.by_name, [i]) for i in range(6)],
        "all": whitened(on_b, best.noise, {}, best.by_name, range(6)),
        "A": whitened(on_a, best.noise, {}, best.by_name, range(6)),
        "ceiling": whitened(on_b, best.noise, {}, own.by_name, range(6)),
        "no payload": figures(B, {**clock, "payload_mass_error": -float(A.parameters["payload_mass"])}, after),
        "figures A": figures(A, clock, after),
        "figures B": figures(B, clock, after),
        "regimes before": regimes(A, clock),
        "regimes after": regimes(B, after),
    }
    print("torque ripple and link encoders", flush=True)
    waves = ripple((A, B), after)
    link, link_name, link_fit, link_a, link_b = link_hypotheses(catalogue, (A, B), best.by_name)
    offset_only: Values = link["offset"]["values"]
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder for real_gap.md, real_gap.json and pictures (default: docs)")
    parser.add_argument("--runs", type=Path, default=Path("results") / "real_gap", help="folder for the imported runs")
    options = parser.parse_args(arguments)
    from robomill import real_gap_page

    result = diagnose(options.runs)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "real_gap.json").write_text(json.dumps(real_gap_page.as_json(result), indent=1) + "\n", encoding="utf-8")
    pictures = real_gap_page.draw(result, options.out / "pictures")
    (options.out / "real_gap.md").write_text(real_gap_page.page(result, pictures), encoding="utf-8")
    print(f"{options.out / 'real_gap.md'}, {options.out / 'real_gap.json'} and {len(pictures)} pictures are written")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
