"""What the figures of the KR 300 recordings say, in sentences that other figures would change.

A term is favoured where the best hypothesis with it has more than FAVOURED ln evidence on top of the best one without it, and disfavoured
the other way round; between them these data do not decide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from robomill.diagnosis.catalogue import Candidate
from robomill.real_gap.estimation import Fit
from robomill.real_gap.study import Gate, Hypothesis, Result, Ripple, Use

FAVOURED = math.log(20.0)
"""Log of a Bayes factor that counts as strong (Kass & Raftery 1995), as in the selection of the effects."""
LINK_TERMS = {"offset": "an offset", "lag": "a clock", "twist": "elastic twist", "backlash": "backlash"}
"""Term of a hypothesis about the link encoders -> what it stands for."""


def adopted(chosen: Sequence[Candidate]) -> str:
    """`friction_coulomb (joint 1, joint 2); rotor_inertia_error (joint 4)`."""
    places: dict[str, list[str]] = {}
    for c in chosen:
        places.setdefault(c.effect, []).append(c.location)
    return "; ".join(f"{effect} ({', '.join(sorted(where))})" for effect, where in sorted(places.items())) or "nothing"


def verdict(closed: tuple[float, float], uses: Sequence[Use]) -> str:
    """`identified` if what was adopted closes a part of the gap on new conditions (its 90 % interval), and each effect helps there."""
    if not uses or closed[0] <= 0.0:
        return "unknown"
    return "identified" if all(u.transfer > 0.0 for u in uses) else "ambiguous"


def gains(hypotheses: Mapping[str, Hypothesis]) -> dict[str, float]:
    """Term -> ln evidence of the best hypothesis with it less that of the best without it."""
    found = {}
    for term in LINK_TERMS:
        having = {name: term in name.partition(",")[0].split(" + ") for name in hypotheses}
        best = [max((h.log_evidence for n, h in hypotheses.items() if having[n] is on), default=-math.inf) for on in (True, False)]
        if math.inf not in map(abs, best):
            found[term] = float(best[0] - best[1])
    return found


def link(hypotheses: Mapping[str, Hypothesis]) -> str:
    """One clause per term, those with the largest evidence first."""
    said = []
    for term, gain in sorted(gains(hypotheses).items(), key=lambda item: -item[1]):
        if gain > FAVOURED:
            said.append(f"{LINK_TERMS[term]} is favoured (ln evidence {gain:+.0f})")
        elif gain < -FAVOURED:
            said.append(f"{LINK_TERMS[term]} is disfavoured ({gain:+.0f})")
        else:
            said.append(f"for or against {LINK_TERMS[term]} these data say little ({gain:+.1f})")
    return "; ".join(said)


def twist(fitted: Fit, on_b: Mapping[str, float]) -> str:
    """For each axis whether a compliance is seen on A, and whether the one of B lies in its interval."""
    said = []
    for name, value in fitted.by_name.items():
        if name.startswith("joint_compliance"):
            low, high = fitted.interval(name)
            axis = f"A{name.rstrip(']').partition('[')[2]}"
            seen = f"{1.0 / value:.2g} N m/rad" if low > 0.0 else "not seen on A (its interval holds zero)"
            same = "within" if low <= on_b[name] <= high else "outside"
            said.append(f"{axis}: {seen}; what is fitted on B lies {same} the interval of A")
    return ". ".join(said) or "No hypothesis with twist was chosen"


def payload(stated: float, found: Mapping[str, tuple[float, float, float]]) -> str:
    """Whether what was stated with the data lies in the intervals."""
    return ", ".join(f"{'within' if low <= stated <= high else 'outside'} the interval of {name}" for name, (_, low, high) in found.items())


def stability(a: Fit, b: Fit) -> str:
    """Which kinds of parameters change least and most from one recording to the other: median of |B - A| / |A|."""
    changes: dict[str, list[float]] = {}
    for name, value in a.by_name.items():
        if value:
            changes.setdefault(name.partition("[")[0], []).append(abs(b.by_name[name] - value) / abs(value))
    order = sorted((float(np.median(c)), kind) for kind, c in changes.items())
    if len(order) <= 1:
        return "There are too few kinds of parameters to compare"
    (least, first), (most, last) = order[0], order[-1]
    return f"From A to B, {first} changes least ({100.0 * least:.0f} % by the median) and {last} most ({100.0 * most:.0f} %)"


def ratios(a: Fit, b: Fit, kind: str) -> str:
    """Values of a kind on B over those on A."""
    found = [b.by_name[n] / v for n, v in a.by_name.items() if n.startswith(kind) and v]
    return f"{min(found):.2f} to {max(found):.2f} times those of A" if found else "not adopted"


def outside(fitted: Fit, kind: str, axes: Sequence[int], value: float) -> str:
    """In how many intervals of these axes a value lies."""
    names = [n for n in (f"{kind}[{i}]" for i in axes) if n in fitted.by_name]
    inside = sum(low <= value <= high for low, high in map(fitted.interval, names))
    return f"it lies in {inside} of {len(names)} intervals"


def ripple(waves: Sequence[Ripple]) -> str:
    """Whether amplitude and phase of the ripple carry over: closures on B with the amplitude of A, and with its phase too."""
    kept, turned = [w.turned for w in waves], [w.with_a for w in waves]
    helps = [sum(x > 0.0 for x in part) for part in (kept, turned)]
    n = len(waves)
    own = f"{round(100 * min(kept))} % to {round(100 * max(kept))} % on B (more than nothing on {helps[0]} of {n} axes)"
    same = f"{round(100 * min(turned))} % to {round(100 * max(turned))} % (on {helps[1]} of {n})"
    return f"With the amplitude of A and a phase of its own it closes {own}; with the phase of A {same}"


def orders(found: Sequence[Sequence[tuple[float, float]]]) -> str:
    """Whether the strongest line of what is left is the same in both recordings."""
    apart = max(abs(a[0] - b[0]) for a, b in zip(*found, strict=True))
    return f"The orders of the two recordings differ by {apart:.2f} at most"


def clocks(*gates: Gate) -> str:
    """Range of the lateness [ms] of torques, link encoders and logged speeds against the motor angles."""
    late = [x for g in gates for x in (*g.link, *(t for t, _ in g.torque), *g.speed)]
    return f"{1e3 * min(late):.1f} to {1e3 * max(late):.1f} ms"


def needed_friction(r: Result, stiffness: Sequence[float]) -> str:
    """Viscous friction [kN m s/rad] that would wind up the gears as late as the encoders are, beside what the torques show."""
    windup = [1e-3 * lag * k for lag, k in zip(r.gates[0].link, stiffness, strict=True)]
    seen = [1e-3 * r.best.by_name.get(f"friction_viscous[{i}]", 0.0) for i in (1, 2, 3)]
    needed, shown = (", ".join(f"{x:.1f}" for x in values) for values in (windup, seen))
    return f"{needed} kN m s/rad at Weigand's stiffnesses; the torques show {shown}"
