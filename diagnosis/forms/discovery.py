"""What a law is like that is in no catalogue: a form at the port where the gap arises, put into the loop, and what it is worth there."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from robomill.diagnosis.experiment.component_replay import ComponentReplay
from robomill.diagnosis.experiment.simulation import Laboratory, decimate
from robomill.diagnosis.forms.doubts import Doubts
from robomill.diagnosis.forms.layout import Curve, Form, PortForm, Range, TermFound, Worse
from robomill.diagnosis.forms.library import Term
from robomill.diagnosis.forms.loop import Loop, specification
from robomill.diagnosis.forms.places import Place, Places, best_of
from robomill.diagnosis.forms.ports import Seen, Signals, alike
from robomill.diagnosis.forms.signals import Variable, index_of
from robomill.diagnosis.forms.solving import Solved
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.localisation.where import WHOLE
from robomill.diagnosis.outcome.answer import Answer
from robomill.diagnosis.outcome.closure import BLOCKS
from robomill.diagnosis.outcome.how_far import CLOSING, Closing, Groups
from robomill.models.components.correction import TIME
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.slaves.protocol import FloatArray, base_name


def port_forms(found: Sequence[Solved]) -> tuple[PortForm, ...]:
    """What is said of each port, the largest part of its gap first."""
    made = []
    for s in found:
        for element in dict.fromkeys(e for e, _ in s.terms):
            at = [i for i, (e, _) in enumerate(s.terms) if e == element]
            port = s.problem.seen.host.ports[element]
            unit = port.unit or "1"
            terms = tuple(
                TermFound(
                    s.terms[i][1].text,
                    float(s.found.values[i]),
                    [float(x) for x in s.found.intervals[i]],
                    s.terms[i][1].unit(unit),
                    float(s.found.adds[i]),
                )
                for i in at
            )
            name = f"{s.problem.seen.host.name}.{element}"
            made.append(PortForm(name, unit, formula(terms), terms, s.closure, _curve(s, element)))
    return tuple(sorted(made, key=lambda p: -p.closure))


def formula(terms: Sequence[TermFound]) -> str:
    """The sum in a line; numbers in SI to four digits."""
    text = ""
    for k, t in enumerate(terms):
        sign = "-" if t.coefficient < 0.0 else "+" if k else ""
        text += f" {sign} " if k else sign
        text += f"{abs(t.coefficient):.4g}" + ("" if t.term == "1" else f" {t.term}")
    return text


def _curve(s: Solved, element: str) -> Curve | None:
    """Means of gap and form in bins of the variable of the first term; None where what the port does is not seen as it is."""
    first = next((t for e, t in s.terms if e == element and t.factors), None)
    if first is None or s.problem.extra or any(np.ptp(e[element]) > 0.0 or e[element].shape[1] > 1 for e in s.problem.effect):
        return None
    v, d = first.factors[0].variable, s.problem.decimation
    scale = float(s.problem.effect[0][element][0, 0])
    x = np.concatenate([decimate(k[v][:, None], d)[:, 0] for k in s.problem.seen.known])
    rows = s.problem.rows(s.terms)
    order = np.array_split(np.argsort(x, kind="stable"), BLOCKS)
    columns = (x, rows.y / scale, rows.X @ s.found.values / scale)
    return Curve(v.text, v.unit, *([float(c[o].mean()) for o in order if len(o)] for c in columns))


def like_delays(found: Sequence[Solved]) -> tuple[str, ...]:
    """Ports whose first term is the rate of what passes, with sizes that agree: in words, like a delay (y + c dy/dt is y, -c later)."""
    late: dict[str, list[tuple[str, float, list[float]]]] = {}
    for s in found:
        for (element, term), c, interval in zip(s.terms, s.found.values, s.found.intervals, strict=True):
            if len(term.factors) != 1 or term.factors[0].kind != "value":
                continue
            v = term.factors[0].variable
            is_own_rate = v.rate and v.name == element
            alone = sum(e == element and _is_speed(s, element, t) for e, t in s.terms) <= 1  # two of them together are another delay
            if alone and (is_own_rate or (v.index == index_of(element) and _is_speed(s, element, term))):
                late.setdefault(s.problem.seen.host.name, []).append((element, -float(c), [-float(interval[1]), -float(interval[0])]))
    texts = []
    for host, members in late.items():
        for group in _agreeing(members):
            low, high = max(i[0] for _, _, i in group), min(i[1] for _, _, i in group)
            mean = float(np.mean([c for _, c, _ in group]))
            if len(group) > 1:
                low, high = min(low, mean), max(high, mean)
            else:
                low, high = group[0][2]
            ports = ", ".join(f"{host}.{e}" for e, _, _ in group)
            what = "a delay" if mean > 0.0 else "a lead"
            per, unit = (1e3, "ms") if abs(mean) < 1.0 else (1.0, "s")
            ends = sorted(abs(per * x) for x in (low, high))
            texts.append(f"like {what} of {per * abs(mean):.3g} {unit} ({ends[0]:.3g} to {ends[1]:.3g}) in {ports}")
    return tuple(texts)


def _is_speed(s: Solved, element: str, term: Term) -> bool:
    """Whether a term is the rate of something that has the unit of the port."""
    return term.unit(s.problem.seen.host.ports[element].unit or "1") == "s"


def _agreeing(members: list[tuple[str, float, list[float]]]) -> list[list[tuple[str, float, list[float]]]]:
    """Members whose intervals have a value in common, largest group first."""
    rest, groups = list(members), []
    while rest:
        best = max(({x[0]: x for x in rest if x[2][0] <= m[1] <= x[2][1]} | {m[0]: m} for m in rest), key=len)
        groups.append(list(best.values()))
        rest = [m for m in rest if m[0] not in best]
    return groups


def discovered(
    search: Search, groups: Groups, components: Sequence[str], titles: Mapping[str, str], arrays: Collection[str] = ()
) -> Form | None:
    """The form of what is unknown, in the closed loop; None where blocks that have not seen it are not predicted better by any.

    `components`: where it may be, the likeliest first; `arrays`: measured arrays in which more is left than tolerances explain (empty: all
    are looked at); `groups`: measured repeats of every condition, the diagnosed ones first.
    """
    simulator, n = search.simulator, len(search.groups)
    laboratory = simulator.laboratory
    own = [i for i in range(n) if alike(laboratory, i)]
    if not own:
        return None
    try:
        replays = [ComponentReplay.of(shown, i) for shown in [laboratory.shown_in(own)] for i in own]
        measured = zip(itertools.compress(laboratory.channels, search.evidence.active), search.evidence.whitening.deviation, strict=True)
        noise = {c: float(d) for c, d in measured}
        places = Places(laboratory.shown_in(own), replays, noise, Doubts(replays, search.nuisances), frozenset(arrays))
        alone, looped = places.alone(components), places.in_loop(components)
    except OrchestrationError as error:
        return Form("", "output", 0.0, (), note=f"no form was looked for: {error}")
    with TemporaryDirectory() as folder:
        loop = Loop(simulator, Path(folder), _weights(search), groups, n)
        tried = [_Tried.of(loop, place) for place in (*alone[:1], *looped)]
        if not tried:
            return None
        runs = [t for t in tried if t.left is not None]
        if runs:
            gap = float(_in_blocks(loop.left(simulator.repeated(range(n), (), 1)) or []).sum())
            best = runs[best_of([_in_blocks(t.left or []) for t in runs], [t.place.terms for t in runs], gap)]
        else:
            best = max(tried, key=lambda t: places.closes(t.place))
        place = best.place
        late = laboratory.system.step if place.side == "input" and place.reads_outputs else 0.0
        form = Form(place.component, place.side, late, port_forms(place.forms), like_delays(place.forms))
        if best.note:
            return replace(form, note=best.note)
        try:
            after = loop.simulated(best.specification, range(len(laboratory.conditions)), CLOSING)
        except OrchestrationError as error:
            return replace(form, note=f"not put into the loop: {error}")
    others = sorted({p.component for p in alone if p.component != place.component and not p.targets <= place.targets})
    note = f"beside it, something is left at {', '.join(others)}" if others else ""
    closing = Closing(search, groups, titles)
    closures = closing.with_these(dict(enumerate(after)), list(closing.kinds))
    form = replace(
        form,
        how_far=closures,
        ranges=_ranges(laboratory, place.forms, n),
        worse=tuple(Worse(h.metric, h.on, h.before, h.after, h.unit) for h in closures if h.after > h.before),
        note=note,
    )
    if any(h.channel == WHOLE and h.on == closing.hardest and h.after > h.before for h in closures):
        refuted = (
            f"in the loop the whole gap on {closing.hardest} is larger with the form than without it: it is of no use, and not adopted"
        )
        return replace(form, note=f"{refuted}; {note}" if note else refuted)
    return replace(form, specification=best.specification)


@dataclass(frozen=True)
class _Tried:
    """Forms in the loop of the diagnosed runs."""

    place: Place
    specification: dict[str, Any]
    left: Sequence[FloatArray] | None
    """What is left of each condition, weighted, [rows, channels]; None where it cannot run."""
    note: str
    """Why it is not in the loop; empty if it is."""

    @staticmethod
    def of(loop: Loop, place: Place) -> _Tried:
        """The forms of a place, fitted in the loop where their columns do not say what they do there."""
        given = _specification(place.forms)
        try:
            if place.approximate:
                fitted_there = loop.refitted(given, np.concatenate([_doubts(s) for s in place.forms]))
                if fitted_there is not None:
                    place = replace(place, forms=_refitted(place.forms, fitted_there))
                    given = fitted_there
            left = loop.left(loop.simulated(given, range(loop.n), 1))
        except OrchestrationError as error:
            return _Tried(place, {}, None, f"not put into the loop: {error}")
        stands = "with the form in the loop the system does not run: it is said as it was found, and not adopted"
        return _Tried(place, given, left, stands if left is None else "")


def _in_blocks(left: Sequence[FloatArray]) -> FloatArray:
    return np.array([float((part**2).sum()) for x in left for part in np.array_split(x, BLOCKS)])


def _weights(search: Search) -> FloatArray:
    """Weight of each channel in the loop: 1 over the standard deviation of its innovations; 0 of those that say nothing."""
    weights = np.zeros(len(search.simulator.laboratory.channels))
    weights[search.evidence.active] = 1.0 / np.sqrt(np.diag(search.evidence.whitening.factor @ search.evidence.whitening.factor.T))
    return weights


def _doubts(s: Solved) -> FloatArray:
    """Half of each interval, as a part of the coefficient."""
    return np.asarray(0.5 * np.diff(s.found.intervals, axis=1)[:, 0] / np.abs(s.found.values))


def _specification(found: Sequence[Solved]) -> dict[str, Any]:
    host = found[0].problem.seen.host
    corrected = list(dict.fromkeys(base_name(e) for s in found for e, _ in s.terms))
    read = [base_name(f.variable.name) for s in found for _, t in s.terms for f in t.factors if f.variable.name != TIME]
    arrays = []
    for base in dict.fromkeys([*read, *corrected]):
        port = next(p for name, p in host.ports.items() if base_name(name) == base)
        arrays.append((base, port.unit or "1", host.counts[base]))
    terms = []
    for s in found:
        for (element, term), c in zip(s.terms, s.found.values, strict=True):
            factors = [f.plain() for f in term.factors]
            unit = term.unit(host.ports[element].unit or "1")
            terms.append({"element": element, "coefficient": float(c), "unit": unit, "text": term.text, "factors": factors})
    return specification(host.name, arrays, corrected, terms)


def _refitted(forms: Sequence[Solved], fitted_there: Mapping[str, Any]) -> list[Solved]:
    """The forms with the coefficients that the closed loop gave; intervals hold what was found before, too."""
    found = {(t["element"], t["text"]): t["coefficient"] for t in fitted_there["terms"]}
    made = []
    for s in forms:
        after = np.array([found[e, t.text] for e, t in s.terms])
        shifted = s.found.intervals + (after - s.found.values)[:, None]
        low, high = np.minimum(s.found.intervals, shifted)[:, 0], np.maximum(s.found.intervals, shifted)[:, 1]
        made.append(replace(s, found=replace(s.found, values=after, intervals=np.stack([low, high], axis=1))))
    return made


def _ranges(laboratory: Laboratory, found: Sequence[Solved], n: int) -> tuple[Range, ...]:
    """Where each variable of the form was, in the diagnosed and in the held-out runs."""
    seen = found[0].problem.seen
    used = list(dict.fromkeys(f.variable for s in found for _, t in s.terms for f in t.factors))
    held = [i for i in range(n, len(laboratory.conditions)) if alike(laboratory, i)]
    shown = laboratory.shown_in(held)
    there = Seen.of(shown, [ComponentReplay.of(shown, i) for i in held], seen.host.name, seen.side).known if held else []

    def span(known: Sequence[Signals], v: Variable) -> list[float] | None:
        values_ = [k[v] for k in known if v in k]
        return [min(float(x.min()) for x in values_), max(float(x.max()) for x in values_)] if values_ else None

    return tuple(Range(v.text, v.unit, span(seen.known, v) or [0.0, 0.0], span(there, v)) for v in used)


def suspects(answer: Answer, laboratory: Laboratory) -> list[str]:
    """Components where the form may be, the likeliest first.

    They are those that the replay blames and cannot tell from them, and those in whose measured outputs it leaves something; or else all.
    """
    names = [c.name for c in laboratory.system.components]
    blamed = [n for w in answer.where if w.log_odds is not None for n in (w.component, *(w.alternatives or ()))]
    first = blamed or [w.component for w in answer.where] + ([answer.unknown.component] if answer.unknown else [])
    owners = sorted({array.partition(".")[0] for array in left_in(answer)})
    found = [n for n in dict.fromkeys([*first, *owners]) if n in names]
    return [*found, *(n for n in names if n not in found)] if not blamed else found


def left_in(answer: Answer) -> set[str]:
    """Measured arrays in which the replay leaves more than noise and tolerances; empty where nothing was replayed."""
    return {array for w in answer.where for array in w.outputs or ()}
