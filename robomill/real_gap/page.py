"""What `make diagnose-real` writes: the page, the JSON and the pictures, from a `study.Result`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robomill.cell.palette import BLUE, ORANGE, RED
from robomill.models.robot.dynamics import KR300_DYNAMICS
from robomill.real_gap import conclusions
from robomill.real_gap.estimation import Problem, low_pass, simulate
from robomill.real_gap.study import Closure, Result

G = KR300_DYNAMICS.gear_ratio
WEIGAND_STIFFNESS = (4.578e6, 7.519e6, 4.1e6)
"""Stiffness of the gears of A1..A3 [N m/rad], as published (FACTS 1.4)."""
WHOLE = 100.0
"""Size from which a number is shown without decimals: it has three digits before the point."""


def _unit(result: Result, parameter: str) -> str:
    return next((u.candidate.unit for u in result.uses if parameter in u.candidate.parameters), "")


def _probability(loss: float) -> float:
    """Probability of an effect against its absence at equal odds."""
    return 1.0 / (1.0 + math.exp(-min(loss, 50.0)))


# ------------------------------------------------------------------------------------------- JSON


def as_json(r: Result) -> dict[str, Any]:
    """The keys of DIAGNOSIS.md."""
    A, B = r.gates
    findings = [
        *(_lag(f"robot.q_link[{i + 1}]", False, value=A.link[i], held_out=B.link[i]) for i in range(3)),
        *(_lag(f"robot.torque_motor[{i + 1}]", True, value=A.torque[i][0], held_out=B.torque[i][0]) for i in range(3)),
        *(_lag(f"motion.qd_logged[{i + 1}]", False, value=A.speed[i]) for i in range(6)),
        *(_lag(f"motion.qd_link_logged[{i + 1}]", False, value=A.link_speed[i]) for i in range(3)),
    ]
    c = r.closures
    before = c.before_a.rms
    shares = (before * G) ** 2 / np.sum((before * G) ** 2)
    names = ("standstill", "reversal", "motion")
    where = [
        {
            "component": "inverse_dynamics",
            "location": f"joint {i + 1}",
            "share": float(shares[i]),
            "rms_motor_torque": float(before[i]),
            "unit": "N.m",
            "regime_shares": dict(zip(names, map(float, c.regimes_a[i]), strict=True)),
        }
        for i in range(6)
    ]
    which = [
        {
            "effect": u.candidate.effect,
            "component": "inverse_dynamics",
            "location": u.candidate.location,
            "probability": _probability(u.loss),
            "log_evidence_gain": u.loss,
            "gap_growth_on_held_out_without": u.transfer,
            "transfers": bool(u.transfer > 0.0),
            "parameters": {
                p: {"value": r.best.by_name[p], "interval": list(r.best.interval(p)), "unit": u.candidate.unit}
                for p in u.candidate.parameters
            },
            "confusable_with": list(u.rivals),
        }
        for u in r.uses
    ]
    link = [
        {
            "effect": n.partition("[")[0],
            "component": "inverse_dynamics" if "lag" not in n else "logging",
            "parameters": {n: {"value": v, "interval": list(r.link_fit.interval(n))}},
        }
        for n, v in r.link_fit.by_name.items()
    ]
    how_far = [
        _metric("motor torque, whitened, moving, all axes", "1", c.all, c.ceiling.closure),
        *(_metric(f"motor torque, whitened, moving, joint {i + 1}", "1", axis) for i, axis in enumerate(c.axes)),
        *(
            {
                "metric": f"motor torque {kind}, joint {i + 1}",
                "unit": "N.m",
                "on": "held-out condition",
                "before": float(getattr(c.before, key)[i]),
                "after": float(getattr(c.after, key)[i]),
            }
            for kind, key in (("rms, moving", "rms"), ("p95, moving", "p95"), ("rms, all samples", "rms_all"))
            for i in range(6)
        ),
        *(_metric(f"link encoder, whitened, {n}", "1", axis) for n, axis in r.link_closure.items()),
    ]
    return {
        "schema": "robomill-diagnosis/1",
        "verdict": conclusions.verdict(c.all.interval, r.uses),
        "gate": {"usable": True, "findings": findings, "noise": "from the residual of the adopted model: there are no repeats"},
        "where": where,
        "which": sorted(which, key=lambda w: -float(w["log_evidence_gain"])),
        "link_encoder": {"hypothesis": r.link_best, "effects": link},
        "how_far": how_far,
        "payload": {n: {"value": v[0], "interval": [v[1], v[2]], "unit": "kg"} for n, v in r.payload.items()},
        "adopted": r.adopted,
        "next_run": None,
    }


def _lag(channel: str, repaired: bool, **values: float) -> dict[str, Any]:
    return {"channel": channel, "kind": "lag", **values, "unit": "s", "repaired": repaired}


def _metric(name: str, unit: str, c: Closure, ceiling: float | None = None) -> dict[str, Any]:
    return {
        "metric": name,
        "unit": unit,
        "on": "held-out condition",
        "before": c.before,
        "after": c.after,
        "closure": c.closure,
        "interval": list(c.interval),
        "ceiling": ceiling,
    }


# --------------------------------------------------------------------------------------- pictures


def draw(r: Result, folder: Path) -> list[Path]:
    """Pictures of the torques of B, of the encoder difference of B, and of the closure."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    B = r.recordings[1]
    clock = {"torque_lag": r.adopted["torque_lag"]}
    before, after = (simulate(B, {**clock, **v})["torque_motor"] for v in ({}, r.best.by_name))
    files = []
    fig, axes = plt.subplots(3, 2, figsize=(11, 8.5), sharex=True)
    for i, ax in enumerate(axes.T.flat):
        ax.plot(B.t, B.torque[:, i], color="0.65", lw=0.5, label="measured")
        ax.plot(B.t, low_pass(B.torque, 8.0)[:, i], "k", lw=1.0, label="measured, below 8 Hz")
        ax.plot(B.t, before[:, i], "--", color=RED, lw=1.0, label="rigid body")
        ax.plot(B.t, low_pass(after, 8.0)[:, i], BLUE, lw=1.2, label="with the effects found on A")
        ax.fill_between(B.t, *ax.get_ylim(), where=B.standing[:, i], color="0.93", zorder=0)
        ax.set_title(f"A{i + 1}", loc="left", fontsize=9)
        ax.set_ylabel("motor torque, N m", fontsize=8)
    legend = axes[0, 0].legend(fontsize=7)
    legend.legend_handles[0].set_linewidth(1.5)  # as thin as in the picture it could not be seen
    for ax in axes[-1]:
        ax.set_xlabel("time, s (shaded: the axis stands)", fontsize=8)
    files.append(_save(fig, folder / "real_gap_torque.png"))

    adopted = {**r.best.by_name, **r.link_fit.by_name}
    share = 1.0 if "behind" in r.link_best else 0.0
    full = simulate(B, adopted, friction_link_share=share)
    no_lag = simulate(B, {**adopted, "encoder_lag": 0.0}, friction_link_share=share)
    fig, axes = plt.subplots(3, 1, figsize=(9, 8), sharex=True)
    for i, ax in enumerate(axes):
        ax.plot(B.t, 1e6 * (B.q_raw[:, i] - B.q_link[:, i]), "k", lw=0.8, label="measured")
        ax.plot(B.t, 1e6 * (B.q - full["q_link"])[:, i], BLUE, lw=1.2, label=r.link_best + " (found on A)")
        ax.plot(B.t, 1e6 * (B.q - no_lag["q_link"])[:, i], ORANGE, lw=1.0, label="its twist and offset alone")
        ax.set_title(f"A{i + 1}: motor minus link encoder", loc="left", fontsize=9)
        ax.set_ylabel("µrad", fontsize=8)
    axes[0].legend(fontsize=7)
    axes[-1].set_xlabel("time, s")
    files.append(_save(fig, folder / "real_gap_link.png"))

    fig, ax = plt.subplots(figsize=(7, 3.2))
    gap, left = r.closures.before, r.closures.after
    x = np.arange(6)
    for k, (rms, label) in enumerate(((gap.rms, "rigid body"), (left.rms, "after, moving"), (left.rms_all, "after, with standstill"))):
        ax.bar(x + 0.27 * (k - 1), rms, 0.25, label=label, color=(RED, BLUE, "0.6")[k])
    ax.set_xticks(x, [f"A{i + 1}" for i in range(6)])
    ax.set_ylabel("rms on B, N m at the motor")
    ax.legend(fontsize=8)
    files.append(_save(fig, folder / "real_gap_closure.png"))
    return files


def _save(figure: Any, file: Path) -> Path:
    import matplotlib.pyplot as plt

    figure.tight_layout()
    figure.savefig(file, dpi=110)
    plt.close(figure)
    return file


# ------------------------------------------------------------------------------------------- page


def _row(*cells: object) -> str:
    return "| " + " | ".join(str(c) for c in cells) + " |"


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    return "\n".join([_row(*head), _row(*(["---"] * len(head))), *(_row(*r) for r in rows)])


def _ms(values: Sequence[float]) -> str:
    return ", ".join(f"{1e3 * v:.1f}" for v in values)


def _percent(x: float) -> str:
    return f"{100.0 * x:.1f} %"


def _number(x: float) -> str:
    return f"{x:.3g}" if abs(x) < WHOLE else f"{x:.0f}"


def page(r: Result, pictures: Sequence[Path]) -> str:
    """docs/real_gap.md."""
    A, B = r.gates
    c = r.closures
    where = _table(
        ("axis", "rms A, N m", "p95 A, N m", "rms at the joint, N m", "standstill", "around reversals", "in motion"),
        [
            (
                f"A{i + 1}",
                f"{c.before_a.rms[i]:.2f}",
                f"{c.before_a.p95[i]:.2f}",
                f"{c.before_a.rms[i] * G[i]:.0f}",
                *(_percent(s) for s in c.regimes_a[i]),
            )
            for i in range(6)
        ],
    )
    which = _table(
        ("effect", "value (90 % interval)", "unit", "ln evidence lost without it (A)", "gap on B without it", "goes together with"),
        [
            (
                f"{u.candidate.effect}, {u.candidate.location}",
                ", ".join(
                    f"{_number(r.best.by_name[p])} ({_number(r.best.interval(p)[0])} to {_number(r.best.interval(p)[1])})"
                    for p in u.candidate.parameters
                ),
                u.candidate.unit,
                f"{u.loss:.1f}",
                f"{100.0 * u.transfer:+.1f} %",
                "; ".join(u.rivals) or "-",
            )
            for u in sorted(r.uses, key=lambda u: (u.candidate.location, -u.loss))
        ],
    )
    own = r.on_b.by_name
    squares = 1.0 - (c.after.rms / c.before.rms) ** 2
    stable = _table(
        ("parameter", "A", "B (fitted there, for comparison only)"),
        [(n, _number(v), _number(own[n])) for n, v in sorted(r.best.by_name.items())],
    )
    far = _table(
        (
            "axis",
            "rms before",
            "after",
            "p95 before",
            "after",
            "rms all samples before",
            "after",
            "closure, squares",
            "closure, whitened (90 %)",
        ),
        [
            (
                f"A{i + 1}",
                *(f"{getattr(x, key)[i]:.2f}" for key in ("rms", "p95", "rms_all") for x in (c.before, c.after)),
                _percent(squares[i]),
                f"{_percent(c.axes[i].closure)} ({_percent(c.axes[i].interval[0])} to {_percent(c.axes[i].interval[1])})",
            )
            for i in range(6)
        ],
    )
    link = _table(
        ("hypothesis", "ln evidence (A)", "BIC (A)", "rms A, µrad (A1, A2, A3)", "rms B, µrad"),
        [
            (
                n,
                f"{h.log_evidence:.0f}",
                f"{h.bic:.0f}",
                ", ".join(f"{1e6 * x:.0f}" for x in h.rms_a),
                ", ".join(f"{1e6 * x:.0f}" for x in h.rms_b),
            )
            for n, h in r.link.items()
        ],
    )
    best = r.link[r.link_best]
    values = []
    for n, v in r.link_fit.by_name.items():
        low, high = r.link_fit.interval(n)
        other = best.values_b[n]
        if n.startswith("joint_compliance"):
            stiff = f"{1.0 / v:.3g} N m/rad" if low > 0.0 else f"not seen; stiffer than {1.0 / max(high, 1e-12):.2g} N m/rad"
            values.append((n, f"{1e6 * v:.3f} ({1e6 * low:.3f} to {1e6 * high:.3f}) µrad/(N m)", f"{1e6 * other:.3f}", stiff))
        elif n == "encoder_lag":
            values.append((n, f"{1e3 * v:.2f} ({1e3 * low:.2f} to {1e3 * high:.2f}) ms", f"{1e3 * other:.2f}", "all three encoders"))
        else:
            values.append((n, f"{1e6 * v:.0f} ({1e6 * low:.0f} to {1e6 * high:.0f}) µrad", f"{1e6 * other:.0f}", ""))
    back = r.link["offset + lag + twist + backlash"].values
    gaps = ", ".join(f"A{i}: {1e6 * back[f'backlash[{i}]']:.0f}" for i in (1, 2, 3))
    steps = _table(
        ("step", "effect", "gain in ln evidence", "BIC"),
        [(k, ("drop " if s.gain < 0.0 else "") + s.candidate.name, f"{s.gain:+.1f}", f"{s.bic:.0f}") for k, s in enumerate(r.steps, 1)],
    )
    waves = _table(
        ("axis", "amplitude A, N m", "amplitude B", "phase A, deg", "phase B", "closure A", "B, phase its own", "B, phase of A"),
        [
            (
                f"A{i}",
                *(f"{amplitude:.3f}" for amplitude in w.amplitudes),
                *(f"{math.degrees(phase):.0f}" for phase in w.phases),
                *(_percent(x) for x in (w.on_a, w.turned, w.with_a)),
            )
            for i, w in enumerate(r.ripple, 1)
        ],
    )
    pairs = [(n, v, own[n], r.best.interval(n)[1] - v, r.on_b.interval(n)[1] - own[n]) for n, v in r.best.by_name.items()]
    agree = sum(abs(a - b) <= math.hypot(sa, sb) for _, a, b, sa, sb in pairs)
    noise = Problem(r.recordings[1], "torque_motor").used
    standing = ", ".join(_percent(1.0 - float(np.mean(noise[:, i]))) for i in range(6))
    images = {p.stem: f"pictures/{p.name}" for p in pictures}
    inertia = ", ".join(
        f"A{i}: {r.best.by_name[f'rotor_inertia_error[{i}]'] * KR300_DYNAMICS.rotor_inertia[i - 1] * G[i - 1] ** 2:.0f}"
        for i in range(1, 7)
        if f"rotor_inertia_error[{i}]" in r.best.by_name
    )
    lag_a, lag_b = r.masquerade["A"], r.masquerade["B"]
    return f"""# The gap between model and robot on the KR 300 recordings

Written by `make diagnose-real` (robomill/real_gap); do not edit. JSON: real_gap.json. Recording A is diagnosed. Recording B is held
out: another trajectory, on which nothing was chosen or fitted unless a column says so. Nominal model: component `inverse_dynamics` with all effects
off, that is the rigid body with Weigand's masses, counterbalance and rotors and the payload as stated (about 150 kg, taken 0.1 m in front of
the flange), fed the *measured* motor angles. Data: 250 Hz, 10 s each, free motion of all axes (data/kuka_kr300_recordings, MIT).

**In one sentence.** Adopted on A for the torque gap: {conclusions.adopted(r.chosen)}. It closes **{_percent(c.all.closure)}** ({_percent(c.all.interval[0])} to {_percent(c.all.interval[1])}) of the whitened torque gap of moving
axes on B ({_percent(min(squares))} to {_percent(max(squares))} of its squares, axis by axis). Of the difference between motor and link encoders: {conclusions.link(r.link)}.

## Gate: clocks and signs

- Link encoders late against motor encoders, A1..A3: {_ms(A.link)} ms on A, {_ms(B.link)} ms on B. Treated below as a candidate.
- Logged motor speeds late against the differentiated motor angles by {_ms(A.speed)} ms, logged link speeds by {_ms(A.link_speed)} ms.
  Neither is used; speeds and accelerations here are zero-phase derivatives of the motor angles ({15} Hz).
- Motor angles late against the reference by {_ms(A.reference)} ms on A, {_ms(B.reference)} ms on B (negative: ahead of it); on A they differ from it by up to
  {", ".join(f"{math.degrees(x):.2f}" for x in A.tracking)} deg. The reference is not used as the motion.
- Torques of A1..A3 late against the motor angles by {_ms([x for x, _ in A.torque])} ms on A and {_ms([x for x, _ in B.torque])} ms on B: read off the torque ripple (below), whose eight
  periods per motor turn make a vernier of about a radian per millisecond. {1e3 * r.adopted["torque_lag"]:.1f} ms (from A) is repaired before everything else. Left
  to the physics, the torques below 8 Hz of A want {1e3 * lag_a[0]:.1f} ({1e3 * lag_a[1]:.1f} to {1e3 * lag_a[2]:.1f}) ms, those of B {1e3 * lag_b[0]:.1f} ({1e3 * lag_b[1]:.1f} to {1e3 * lag_b[2]:.1f}) ms. That fit is not used: a lag of friction
  looks like an error of inertia.
- Torques, link encoders and logged speeds come {conclusions.clocks(A, B)} after the motor angles. A difference of clocks does not say which is wrong; it may as well be
  the motor angles that are ahead. "Late" here means: against the motor angles.
- Signs: with free friction the residual of A is, with the sign as it is / flipped, {", ".join(f"{a:.2f}/{b:.2f}" for a, b in A.sign)} N m. Counterbalance as FACTS 1.4 has it / flipped:
  {A.counterbalance[0]:.2f}/{A.counterbalance[1]:.2f} N m on A2.
- Standing axes ({standing} of the samples of B, A1..A6): static friction may hold any torque up to breakaway. These
  samples are left out of the fit and of the whitened figures; "all samples" includes them.
- Noise: there are no repeats, so it is a guess from the residual of the adopted model on A (white + Ornstein-Uhlenbeck per axis, below 8 Hz).
  No noise floor is subtracted from any gap: closures are lower than they would be with one.

## Where: the torque gap of the rigid body, per axis

Motor torque below 8 Hz, moving axes; then which share of the squared gap of recording A (all samples) lies in which regime.

{where}

![torques]({images["real_gap_torque"]})

## Which: effects adopted on A, by evidence

{which}

Each was tried against the others: in every step the one with the largest evidence (Bayes factor above 20) was added and all were fitted anew with
complete reruns of the component. "Gap on B without it": growth of the whitened gap on B if the effect is left out and all others are
fitted anew on A; a negative figure means that the effect does *not* help on B, and its value should not be believed.

What was offered and not adopted: everything else in data/kuka_kr300_recordings/catalogue.toml for torques, among it the payload's mass and
centre of gravity, the counterbalance and the torque constants wherever they are missing above.

**Payload.** With the adopted effects, mass and centre of gravity free: {r.payload["A"][0]:.0f} ({r.payload["A"][1]:.0f} to {r.payload["A"][2]:.0f}) kg on A and, as a check, {r.payload["B"][0]:.0f} ({r.payload["B"][1]:.0f} to {r.payload["B"][2]:.0f}) kg on B.
Stated with the data are about 150 kg: {conclusions.payload(150.0, r.payload)}. Prior: 150 +- 40 kg.

**Inertia.** The relative errors of the rotor inertias amount, at the joint, to kg m2 of {inertia or "none"}. The rotor inertia of 0.01 kg m2 that the recordings
state for A4..A6 would be an error of +4.8: {conclusions.outside(r.best, "rotor_inertia_error", (4, 5, 6), 4.8)}. On B these corrections come out as {conclusions.ratios(r.best, r.on_b, "rotor_inertia_error")}.
The payload's own inertia, which nobody stated, is not told from them here.

The same effects fitted on B, to see what is a property of the robot and what of the recording:

{stable}

{agree} of {len(pairs)} pairs agree within their joint 90 % intervals (90 % would be {0.9 * len(pairs):.0f}). The intervals
do not know what changes from one trajectory to the next. {conclusions.stability(r.best, r.on_b)}.

## How far: closure on the held-out recording B

{far}

Motor torques in N m, below 8 Hz, moving axes unless said. All axes together, whitened: {_percent(c.all.closure)} on B, {_percent(c.on_a.closure)} on A itself. The same effects
*fitted on B* close {_percent(c.ceiling.closure)}: that is the most this set of effects could do there, so the ratio is {c.all.closure / c.ceiling.closure:.3f}. (Had the payload been left out of the
nominal model, the rms before would have been {", ".join(f"{x:.1f}" for x in c.no_payload.rms)} N m; that is not what is reported.) The noise model
has no repeats to learn from and takes slow residuals of A for noise, so the whitened closure is strict where a gap is slow. Both are given.

![closure]({images["real_gap_closure"]})

What is left on B lies at standstill / around reversals / in motion: {"; ".join(f"A{i + 1} " + " / ".join(_percent(x) for x in c.regimes_left[i]) for i in range(6))}.

## Ripple: what goes with the motor angle

Eight periods per motor turn (as motors with four pole pairs would have), fitted to the residual above 8 Hz:

{waves}

{conclusions.ripple(r.ripple)}. No ripple is among the adopted values. At 25 deg/s the
eighth order is at 143 Hz, above the Nyquist frequency of 125 Hz: it appears aliased.

## Motor-to-link encoder difference (A1..A3): hypotheses

{link}

Chosen on A by evidence: **{r.link_best}**. Closure on B against the offset alone, whitened: {", ".join(f"{n} {_percent(x.closure)}" for n, x in r.link_closure.items())}.

{_table(("parameter", "A (90 % interval)", "fitted on B", ""), values)}

- **Terms.** Best hypothesis with a term against the best without it: {conclusions.link(r.link)}.
- **Clock or wind-up.** Viscous friction that winds up the gears as late as this would have to be {conclusions.needed_friction(r, WEIGAND_STIFFNESS)}.
- **Twist.** {conclusions.twist(r.link_fit, best.values_b)}. Weigand has {", ".join(f"{k:.2g}" for k in WEIGAND_STIFFNESS)} N m/rad.
- **Backlash.** Fitted half gaps beside lag and twist, µrad: {gaps}; published: 30 µrad.
- **Offset.** Angles are relative to a start pose: an offset says nothing about the robot.
- **Described, not explained:** what is left has its strongest line at {", ".join(f"{n:.2f} periods per motor turn, {1e6 * a:.0f} µrad on A{i + 1}" for i, (n, a) in enumerate(r.transmission[0]))} (A) and
  {", ".join(f"{n:.2f}, {1e6 * a:.0f} µrad" for n, a in r.transmission[1])} (B).
  {conclusions.orders(r.transmission)}; the catalogue of these data has no entry that is periodic in a motor turn at the link.

![encoders]({images["real_gap_link"]})

## Shortfalls

- Two recordings of 10 s, one trajectory each, no repeats: intervals rest on a noise model that was fitted to the same residual, and one held-out
  condition is one. The bootstrap over blocks of 0.5 s does not know of other trajectories, temperatures or days.
- B was held out from every fit and choice that the program makes, but not from its author: that the lag of the torques is read from the ripple and not
  fitted, and that the payload's inertia is in the catalogue, was decided after looking at fits of both recordings.
- Friction at standstill is not modelled (no presliding, no memory); the columns "all samples" of the table hold standing axes, too.
- The Stribeck speed (0.02 rad/s) and the smoothing speed (1 mrad/s) are fixed, not fitted.
- Wrist couplings of the gears and gyroscopic moments of the rotors are not in the model.
- The catalogue for these data was written knowing Weigand's publication; on a robot nobody has identified before, it would have been longer.

## Selection, step by step

{steps}
"""
