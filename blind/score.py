"""Score predictions against the sealed truth.

A prediction is `predictions/NNNN/diagnosis.json` (schema robomill-diagnosis/1). Effects are compared by component and parameter name, so
the catalogue of the diagnosis may call them what it likes. Every figure comes with its count and a 95 % interval.

Detectable: the oracle ratio of the generator (largest over measured arrays and windows of 0.5 s) is at least `DETECTABLE`.
Isolable: no other catalogue candidate and no clock of the log explains the change that the true effect makes but for as much
(`signatures.confusable`). Both are properties of the data, not of the prediction.

A clock is a matter of the log, not of physics: a prediction that names one first stops the log, whatever its verdict.
"""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from blind.generate import hashes
from models.declaration import FloatArray

DETECTABLE = 3.0
"""Oracle ratio from which a case counts as detectable."""
STRATA = (
    ("hidden, below 1", 0.0, 1.0),
    ("marginal, 1 to 3", 1.0, 3.0),
    ("clear, 3 to 10", 3.0, 10.0),
    ("strong, above 10", 10.0, math.inf),
)
LOGGING = "logging"
"""Component that stands for the log itself."""
LISTED = 0.01
"""Probability from which a candidate belongs to the set of an ambiguous answer."""
REAL = ("single", "double", "triple", "outside")
"""Kinds of cases with something real and a good log."""
ADOPTED = 0.5
"""Probability from which a candidate counts as claimed (the first one always does)."""
COMPONENTS = {
    "path_interpolator": "path",
    "robot_drive": "drive",
    "robot_compliance": "compliance",
    "milling_force": "milling",
    "sensor_chain": "sensor",
    "compensation_controller": "controller",
}
"""Models -> their names in the system; both are understood."""
AXES = ("x", "y", "z")
CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")

ComponentValues = Mapping[str, Mapping[str, float]]
"""Component -> parameter -> value."""
Closures = Callable[[int, ComponentValues], Mapping[str, tuple[float, float]]]
"""(number of the case, claimed values) -> sum of squares of the true gap by held-out condition, before and after, of the array that
counts at the tier."""
Confusable = Callable[[int, int], Sequence[str]]
"""(number of the case, index of its effect) -> other candidates (`component.parameter`) that the data cannot tell from that effect."""
Separates = Callable[[int, Mapping[str, Any], Sequence[ComponentValues]], bool]
"""(number of the case, recommended run, values of the wrong candidates) -> whether the run tells all of them from the truth."""


class BenchmarkError(ValueError):
    """A benchmark folder that cannot be scored; says what is wrong and what to do."""


@dataclass(frozen=True)
class Named:
    """An effect as it is named: component, parameter without element, element (0 = scalar)."""

    component: str
    effect: str
    index: int = 0

    @property
    def key(self) -> str:
        """`component.effect`."""
        return f"{self.component}.{self.effect}"

    @staticmethod
    def of(component: str, parameter: str) -> Named:
        """From a component (or its model's name) and an element such as `stiffness_error[2]`; of the log `lag PATTERN` and the like."""
        if component == LOGGING:
            return Named(LOGGING, parameter.partition(" ")[0])
        base, _, rest = parameter.partition("[")
        first = rest.rstrip("]").partition(",")[0]
        index = int(first) if first.isdecimal() else 0
        return Named(COMPONENTS.get(component, component), base, index)


@dataclass(frozen=True)
class Entry:
    """One line of `which`."""

    names: tuple[Named, ...]
    probability: float
    parameters: Mapping[str, Mapping[str, Any]]
    component: str
    confusable: tuple[str, ...]

    def is_effect(self, true: Named) -> bool:
        """Whether it names the effect, at whatever element."""
        return any(n.key == true.key for n in self.names)

    def is_exactly(self, true: Named) -> bool:
        """Whether it names the effect at its element."""
        return true in self.names

    @property
    def values(self) -> dict[str, dict[str, float]]:
        """Its parameters by component."""
        return {self.component: {p: float(v["value"]) for p, v in self.parameters.items() if v.get("value") is not None}}


@dataclass(frozen=True)
class Prediction:
    """A diagnosis.json, as far as it is scored."""

    verdict: str
    which: tuple[Entry, ...] = ()
    where: tuple[Mapping[str, Any], ...] = ()
    how_far: tuple[Mapping[str, Any], ...] = ()
    next_run: Mapping[str, Any] | None = None
    cpu: float | None = None
    """Time that it took [s]."""

    @staticmethod
    def read(content: Mapping[str, Any]) -> Prediction:
        """Entries sorted by probability; anything that is missing counts as empty."""
        entries = []
        for w in content.get("which") or ():
            component = str(w.get("component", ""))
            parameters = w.get("parameters") or {}
            names = tuple(Named.of(component, p) for p in parameters) or (Named.of(component, str(w.get("effect", ""))),)
            others = tuple(str(c) for c in w.get("confusable_with") or ())
            entries.append(Entry(names, float(w.get("probability", 0.0)), parameters, COMPONENTS.get(component, component), others))
        entries.sort(key=lambda e: -e.probability)
        where = tuple(content.get("where") or ())
        return Prediction(
            str(content.get("verdict", "missing")),
            tuple(entries),
            where,
            tuple(content.get("how_far") or ()),
            content.get("next_run"),
            (content.get("time") or {}).get("cpu"),
        )

    @property
    def stopped(self) -> bool:
        """Whether it says that the log is at fault: by its verdict, or because a clock is what it names first."""
        return self.verdict == "bad_log" or bool(self.claimed and self.claimed[0].component == LOGGING)

    @property
    def found(self) -> bool:
        """Whether it says that there is something real."""
        return self.verdict in ("identified", "ambiguous", "unknown") and not self.stopped

    @property
    def claimed(self) -> tuple[Entry, ...]:
        """What the prediction stands for: nothing unless identified or ambiguous, else the first and all that are likely."""
        if self.verdict not in ("identified", "ambiguous") or not self.which:
            return ()
        return (self.which[0], *(e for e in self.which[1:] if e.probability >= ADOPTED))

    @property
    def listed(self) -> tuple[Entry, ...]:
        """Members of the set of an ambiguous answer."""
        return tuple(e for e in self.which if e.probability >= LISTED)


@dataclass(frozen=True)
class Case:
    """Truth and prediction of one case."""

    number: int
    kind: str
    truth: Mapping[str, Any]
    prediction: Prediction

    @property
    def effects(self) -> tuple[Named, ...]:
        """True catalogue effects."""
        return tuple(Named.of(e["component"], e["parameter"]) for e in self.truth["effects"])

    @property
    def detectable(self) -> bool:
        """By the oracle: something in it; of a bad log its fault (a channel that stands still has no noise, which is always seen)."""
        if self.kind == "bad_log":
            fault = self.truth["bad_log"]
            return fault["kind"] == "constant" or float(fault.get("detectability", math.inf)) >= DETECTABLE
        return float(self.truth["detectability"]) >= DETECTABLE

    def effect_detectable(self, i: int) -> bool:
        """Whether effect `i` is, by itself."""
        return float(self.truth["effects"][i].get("detectability", self.truth["detectability"])) >= DETECTABLE


# --- figures with their intervals ---------------------------------------------------------------------------------------------


def wilson(hits: int, count: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """95 % interval of a proportion (Wilson 1927); (0, 1) without cases."""
    if count == 0:
        return 0.0, 1.0
    p, n = hits / count, float(count)
    centre, half = p + z * z / (2.0 * n), z * math.sqrt(p * (1.0 - p) / n + z * z / (4.0 * n * n))
    low, high = (centre - half) / (1.0 + z * z / n), (centre + half) / (1.0 + z * z / n)
    return (0.0 if hits == 0 else low), (1.0 if hits == count else high)


def proportion(outcomes: Sequence[bool]) -> dict[str, Any]:
    """Share of hits with count and Wilson interval; value None without cases."""
    hits, n = sum(outcomes), len(outcomes)
    return {"value": hits / n if n else None, "count": n, "interval": list(wilson(hits, n)) if n else None}


def median(values: Sequence[float], q: float = 0.5) -> dict[str, Any]:
    """Quantile with count and the distribution-free 95 % interval from order statistics (None where there are too few)."""
    n = len(values)
    if n == 0:
        return {"value": None, "count": 0, "interval": None}
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    below = np.cumsum([math.comb(n, k) * q**k * (1.0 - q) ** (n - k) for k in range(n + 1)])  # P(at most k values below the quantile)
    low, high = int(np.searchsorted(below, 0.025)), int(np.searchsorted(below, 0.975))
    interval = [float(ordered[low - 1]) if low >= 1 else -math.inf, float(ordered[high]) if high < n else math.inf]
    known = all(math.isfinite(v) for v in interval)
    return {"value": float(np.quantile(ordered, q)), "count": n, "interval": interval if known else None}


def calibration(probabilities: Sequence[float], right: Sequence[bool], bins: int = 10) -> dict[str, Any]:
    """Expected calibration error over equal bins of probability, with a bootstrap interval (1000 resamples, fixed seed)."""
    p, y = np.asarray(probabilities, dtype=np.float64), np.asarray(right, dtype=np.float64)
    if len(p) == 0:
        return {"value": None, "count": 0, "interval": None}
    place = np.minimum((p * bins).astype(int), bins - 1)

    def error(rows: Any) -> float:
        total = 0.0
        for b in range(bins):
            inside = rows[place[rows] == b]
            if len(inside):
                total += abs(float(np.mean(p[inside]) - np.mean(y[inside]))) * len(inside) / len(rows)
        return total

    random = np.random.default_rng(0)
    resampled = [error(random.integers(0, len(p), len(p))) for _ in range(1000)]
    interval = [float(v) for v in np.quantile(resampled, (0.025, 0.975))]
    return {"value": error(np.arange(len(p))), "count": len(p), "interval": interval}


# --- scores -------------------------------------------------------------------------------------------------------------------


@dataclass
class Scorer:
    """All scores of a set of cases. The callables may be left out: what needs them is then empty, or all cases count as isolable."""

    cases: Sequence[Case]
    tier: str = "T1"
    closures: Closures | None = None
    confusable: Confusable | None = None
    separates: Separates | None = None
    _isolable: dict[tuple[int, int], bool] = field(default_factory=dict)

    def effect_isolable(self, c: Case, i: int) -> bool:
        """Whether the data can tell effect `i` from every other candidate, the same effect elsewhere included."""
        if self.confusable is None:
            return True
        key = (c.number, i)
        if key not in self._isolable:
            self._isolable[key] = not self.confusable(*key)
        return self._isolable[key]

    def clear(self, c: Case) -> list[int]:
        """Effects that are detectable and isolable."""
        return [i for i in range(len(c.effects)) if c.effect_detectable(i) and self.effect_isolable(c, i)]

    def of(self, *kinds: str) -> list[Case]:
        """Cases of those kinds."""
        return [c for c in self.cases if c.kind in kinds]

    @property
    def singles(self) -> list[Case]:
        """Singles that are detectable and isolable."""
        return [c for c in self.of("single") if c.detectable and self.clear(c)]

    def scores(self) -> dict[str, Any]:
        """All keys of the benchmark."""
        singles = self.singles
        real = [c for c in self.of(*REAL) if c.detectable]
        unknowns = [c for c in self.of("outside") if c.detectable]
        doubles = [c for c in self.of("double") if c.detectable]
        both = [c for c in doubles if len(self.clear(c)) == len(c.effects)]
        some = [c for c in doubles if self.clear(c)]
        told = [c for c in doubles if all(self.effect_isolable(c, i) for i in range(len(c.effects)) if c.effect_detectable(i))]
        catalogue = [c for c in self.of("single", "double", "triple") if c.detectable]
        bad_logs = self.of("bad_log")
        ambiguous = [c for c in self.of("single") if c.detectable and c.prediction.verdict == "ambiguous"]
        named = [c for c in singles if c.prediction.claimed and c.prediction.claimed[0].is_exactly(c.effects[0])]
        estimates = [e for c in named if (e := _estimate(c)) is not None]
        closed = self._closures(named)
        answered = [c for c in self.of("single", "null", "outside") if c.prediction.found and c.prediction.claimed]
        times = [c.prediction.cpu for c in self.cases if c.prediction.cpu is not None]
        return {
            "null_false_alarm": proportion([c.prediction.verdict != "none" for c in self.of("null")]),
            "bad_log_stopped": proportion([c.prediction.stopped for c in bad_logs if c.detectable]),
            "bad_log_stopped_of_all": proportion([c.prediction.stopped for c in bad_logs]),
            "detection": proportion([c.prediction.found for c in real]),
            "good_log_stopped": proportion([c.prediction.stopped for c in self.of("null", *REAL)]),
            "component_top1": proportion([_component(c.prediction) == c.effects[0].component for c in singles]),
            "location_top1": proportion([_location_right(c) for c in singles if c.effects[0].index]),
            "effect_top1": proportion([_among(c, 1) for c in singles]),
            "effect_top3": proportion([_among(c, 3) for c in singles]),
            "effect_top1_of_detectable": proportion([_among(c, 1) for c in self.of("single") if c.detectable]),
            "ambiguity_holds_truth": proportion([_holds(c) for c in ambiguous]),
            "ambiguity_median_size": median([float(len(c.prediction.listed)) for c in ambiguous]),
            "next_run_separates": proportion(self._separated(ambiguous)),
            "unknown_recall": proportion([c.prediction.verdict == "unknown" for c in unknowns]),
            "false_unknown": proportion([c.prediction.verdict == "unknown" for c in catalogue]),
            "confident_wrong_on_unknown": proportion([c.prediction.verdict == "identified" for c in unknowns]),
            "doubles_exact": proportion([_claimed_keys(c) == {e.key for e in c.effects} for c in both]),
            "doubles_one_right": proportion([bool(_claimed_keys(c) & {e.key for e in c.effects}) for c in some]),
            "doubles_nothing_invented": proportion([not _claimed_keys(c) - {e.key for e in c.effects} for c in told]),
            "parameter_error_median": median([e[0] for e in estimates]),
            "parameter_error_p90": median([e[0] for e in estimates], 0.9),
            "interval_coverage": proportion([e[1] for e in estimates if e[1] is not None]),
            "closure_over_ceiling_median": median([r for r, _ in closed]),
            "closure_over_ceiling_p10": median([r for r, _ in closed], 0.1),
            "claimed_closure_error_median": median([e for _, e in closed if e is not None]),
            "ece": calibration([c.prediction.claimed[0].probability for c in answered], [_first_right(c) for c in answered]),
            "cpu_time_median": median(times),
            "cpu_time_p90": median(times, 0.9),
        }

    def _separated(self, cases: Sequence[Case]) -> list[bool]:
        """Of each case with an ambiguous answer, whether the recommended run tells the truth from what it is not; no run: no."""
        if self.separates is None:
            return []
        found = []
        for c in cases:
            wrong = [e.values for e in c.prediction.listed if not e.is_exactly(c.effects[0])][:1]
            recommended = c.prediction.next_run
            if wrong and "machine" in c.truth:  # version 1 of the generator did not keep it
                found.append(recommended is not None and self.separates(c.number, recommended, wrong))
        return found

    def _closures(self, cases: Sequence[Case]) -> list[tuple[float, float | None]]:
        """For each case: true closure over ceiling, and |claimed - true| where there is a claim.

        The former is a mean over the held-out conditions on which the truth itself closes at least half of the gap, the latter is of all
        held-out conditions together, as it is claimed.
        """
        if self.closures is None:
            return []
        array, quantity = ("compliance.p_BT_B", "tool tip") if self.tier == "T1" else ("sensor.f_T_T", "force")
        found: list[tuple[float, float | None]] = []
        for c in cases:
            ceilings = {name: float(v[quantity]) for name, v in c.truth.get("ceiling", {}).items() if v[quantity] >= 0.5}
            if not ceilings:
                continue
            adopted: dict[str, dict[str, float]] = {}
            for entry in c.prediction.claimed:
                for component, values in entry.values.items():
                    adopted.setdefault(component, {}).update(values)
            gaps = self.closures(c.number, adopted)
            ratio = float(np.mean([_closed(*gaps[name]) / ceiling for name, ceiling in ceilings.items()]))
            claims = [
                float(h["closure"])
                for h in c.prediction.how_far
                if h.get("on") == "held-out condition" and h.get("closure") is not None and h.get("channel", array) == array
            ]
            together = _closed(sum(before for before, _ in gaps.values()), sum(after for _, after in gaps.values()))
            error = abs(claims[0] - together) if claims else None
            found.append((ratio, error))
        return found

    def strata(self) -> dict[str, Any]:
        """Detection and naming by oracle detectability, all real cases and all singles."""
        table = {}
        for name, low, high in STRATA:
            inside = [c for c in self.of(*REAL) if low <= float(c.truth["detectability"]) < high]
            singles = [c for c in inside if c.kind == "single"]
            table[name] = {
                "detection": proportion([c.prediction.found for c in inside]),
                "component_top1": proportion([_component(c.prediction) == c.effects[0].component for c in singles]),
                "effect_top1": proportion([_among(c, 1) for c in singles]),
            }
        return table

    def confusion(self) -> dict[str, dict[str, int]]:
        """True effect (kind of the case where there is none) -> what was said first -> cases. Singles, nulls, unknowns, bad logs."""
        table: dict[str, dict[str, int]] = {}
        for c in self.cases:
            if c.kind in ("double", "triple"):
                continue
            row = table.setdefault(_true_name(c), {})
            said = c.prediction.claimed[0].names[0].key if c.prediction.claimed else c.prediction.verdict
            row[said] = row.get(said, 0) + 1
        return {name: dict(sorted(row.items(), key=lambda item: -item[1])) for name, row in sorted(table.items())}

    def per_effect(self) -> dict[str, Any]:
        """Of each true effect (singles): cases, detectable, isolable, found, named."""
        table: dict[str, Any] = {}
        for c in self.of("single"):
            row = table.setdefault(
                c.effects[0].key, {"cases": 0, "detectable": 0, "isolable": 0, "detected": 0, "named": 0, "named_top3": 0}
            )
            row["cases"] += 1
            row["detectable"] += c.detectable
            row["isolable"] += c.detectable and bool(self.clear(c))
            row["detected"] += c.prediction.found
            row["named"] += _among(c, 1)
            row["named_top3"] += _among(c, 3)
        return dict(sorted(table.items()))


def _closed(before: float, after: float) -> float:
    return 0.0 if before == 0.0 else 1.0 - after / before


def _true_name(c: Case) -> str:
    if c.kind == "single":
        return c.effects[0].key
    if c.kind == "outside":
        return f"outside: {c.truth['outside']['name']}"
    return f"bad log: {c.truth['bad_log']['kind']}" if c.kind == "bad_log" else c.kind


def _component(p: Prediction) -> str | None:
    """The component that is named first: by the largest share, else by the first effect. Nothing where nothing is claimed to be there."""
    if not p.found:
        return None
    if p.where:
        name = str(max(p.where, key=lambda w: float(w.get("share", 0.0))).get("component", ""))
        return COMPONENTS.get(name, name)
    return p.which[0].component if p.which else None


def _among(c: Case, n: int) -> bool:
    """Whether the effect is among the first n of a case that is said to have one."""
    return c.prediction.found and any(e.is_effect(c.effects[0]) for e in c.prediction.which[:n])


def _location_right(c: Case) -> bool:
    """Component and element: by `where`, if it gives a location, else by the first effect's element."""
    true, p = c.effects[0], c.prediction
    if _component(p) != true.component:
        return False
    first = max(p.where, key=lambda w: float(w.get("share", 0.0))) if p.where else {}
    location = str(first.get("location", "")).partition(",")[0].strip()
    if location:
        return location in location_names(true)
    return bool(p.which) and any(n.index == true.index for n in p.which[0].names)


def location_names(true: Named) -> tuple[str, ...]:
    """What an element of an effect may be called."""
    if true.effect == "sensor_gain_error_axis":
        return (CHANNELS[true.index - 1],)
    if true.effect == "geometry_error":
        return (("link arm", "forearm")[true.index - 1],)
    if true.effect in ("base_compliance", "zero_drift", "misalignment", "frame_error"):
        return (AXES[true.index - 1],)
    return (f"joint {true.index}", f"axis {true.index}", f"A{true.index}")


def _holds(c: Case) -> bool:
    """Whether the set of an ambiguous answer has the true effect in it: listed, or named as not to be told from a listed one."""
    true = c.effects[0]
    names = {
        true.effect,
        f"{true.effect}[{true.index}]",
        *(f"{true.effect} {at} {n}" for at in ("at", "@") for n in location_names(true) if true.index),
    }
    return any(e.is_effect(true) or names & set(e.confusable) for e in c.prediction.listed)


def _claimed_keys(c: Case) -> set[str]:
    return {n.key for e in c.prediction.claimed for n in e.names}


def _first_right(c: Case) -> bool:
    """Whether the first candidate is the truth, at its element; never where there is no catalogue effect."""
    return bool(c.effects) and c.prediction.which[0].is_exactly(c.effects[0])


def _estimate(c: Case) -> tuple[float, bool | None] | None:
    """Relative error of the parameter, and whether its interval covers the truth; None if no value is given."""
    true, value = c.effects[0], float(c.truth["effects"][0]["value"])
    for name, said in c.prediction.claimed[0].parameters.items():
        if Named.of(true.component, name) == true and said.get("value") is not None:
            interval = said.get("interval")
            covered = None if interval is None else bool(interval[0] <= value <= interval[1])
            return abs(float(said["value"]) - value) / abs(value), covered
    return None


# --- folders ------------------------------------------------------------------------------------------------------------------


def freeze_predictions(folder: Path) -> tuple[dict[str, str], bool]:
    """Hash the predictions and note that before the truth is opened; returns the hashes and whether they are those of the first time."""
    current = {k: v for k, v in hashes(folder / "predictions").items() if k.endswith("/diagnosis.json") and not k.startswith(".")}
    file = folder / "predictions.json"
    if file.is_file():
        return current, json.loads(file.read_text(encoding="utf-8")) == current
    file.write_text(json.dumps(current, indent=0, sort_keys=True) + "\n", encoding="utf-8")
    return current, True


def unseal(folder: Path) -> tuple[dict[str, Any], dict[int, dict[str, Any]]]:
    """benchmark.json and the truths by case. BenchmarkError if cases or truth are not those that were made."""
    file = folder / "benchmark.json"
    if not file.is_file():
        raise BenchmarkError(
            f"{folder} holds no finished benchmark (no benchmark.json); make one with: robomill blind make {folder} --cases N"
        )
    head: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    sealed = folder / "sealed"
    manifest = sealed / "manifest.json"
    if not manifest.is_file() or hashlib.sha256(manifest.read_bytes()).hexdigest() != head["truth"]:
        raise BenchmarkError(f"{manifest} is not the one whose hash is in benchmark.json: the truth was changed or is not here")
    listed = json.loads(manifest.read_text(encoding="utf-8"))
    if hashes(sealed, exclude=("manifest.json",)) != listed:
        raise BenchmarkError(f"{sealed}: files differ from manifest.json: the truth was changed")
    changed = sorted(k for k, v in hashes(folder / "cases").items() if head["files"].get(k, v) != v)
    if changed:
        raise BenchmarkError(f"{folder / 'cases'}: changed since it was made: {', '.join(changed[:5])}")
    truths = {int(name[:4]): json.loads((sealed / name).read_text(encoding="utf-8")) for name in listed if name.endswith(".json")}
    return head, truths


def load_cases(folder: Path, truths: Mapping[int, Mapping[str, Any]]) -> list[Case]:
    """Truths with their predictions; one that is missing or unreadable has the verdict `missing`."""
    cases = []
    for number, truth in sorted(truths.items()):
        file = folder / "predictions" / f"{number:04d}" / "diagnosis.json"
        try:
            prediction = Prediction.read(json.loads(file.read_text(encoding="utf-8")))
        except (OSError, ValueError):
            prediction = Prediction("missing")
        cases.append(Case(number, str(truth["kind"]), truth, prediction))
    return cases


def gap(folder: Path, number: int, condition: str) -> FloatArray:
    """Noise-free gap of a held-out condition as sealed, (n, 6): tool tip [m], force [N]."""
    values: FloatArray = np.load(folder / "sealed" / f"{number:04d}" / f"{condition.replace(' ', '-')}.npy").astype(np.float64)
    return values


def true_closures(folder: Path, truths: Mapping[int, Mapping[str, Any]], tier: str) -> Closures:
    """Gaps by running the nominal cell with the claimed parameters against the sealed noise-free gap. Unchanged where it cannot run."""
    from blind.conditions import from_truth
    from blind.generate import difference
    from blind.world import nominal, simulate_adopted
    from orchestration.errors import OrchestrationError

    columns = slice(0, 3) if tier == "T1" else slice(3, 6)

    def closures(number: int, adopted: ComponentValues) -> dict[str, tuple[float, float]]:
        result = {}
        for c in [from_truth(c) for c in truths[number]["conditions"]][1:]:
            before = gap(folder, number, c.name)[:, columns]
            try:
                step = difference(simulate_adopted(c, adopted).columns, nominal(c).columns)[:, columns]
            except OrchestrationError:
                step = np.zeros_like(before)
            n = min(len(before), len(step))
            result[c.name] = float(np.sum(before[:n] ** 2)), float(np.sum((before[:n] - step[:n]) ** 2))
        return result

    return closures


def oracle_confusable(folder: Path, truths: Mapping[int, Mapping[str, Any]], tier: str) -> Confusable:
    """What cannot be told from an effect, from signatures (kept in the folder `oracle`)."""
    from blind.conditions import from_truth
    from blind.generate import instance_of
    from blind.signatures import clocks, confusable, features, library
    from blind.world import nominal, simulate_nominal

    def found(number: int, i: int) -> list[str]:
        truth = truths[number]
        condition, true = from_truth(truth["conditions"][0]), instance_of(truth["effects"][i])
        lib = library(condition, folder / "oracle").for_tier(tier)
        rows, reference = lib.matrix.shape[1] // len(lib.columns), nominal(condition)
        change = features(simulate_nominal(condition, [true]).columns, reference.columns, lib.columns, rows)
        return confusable(lib, true, change, DETECTABLE) + clocks(lib, reference, change, DETECTABLE)

    return found


def baseline_scores(
    folder: Path, truths: Mapping[int, Mapping[str, Any]], scorer: Scorer, progress: Callable[[str, int, int], object] | None = None
) -> dict[str, Any]:
    """The same figures for methods that only name one effect: null false alarms, detection, component, location and effect."""
    from blind.baselines import BASELINES, Guess, residual
    from blind.conditions import from_truth
    from blind.signatures import library

    guesses: dict[str, dict[int, Guess]] = {name: {} for name in BASELINES}
    for i, c in enumerate(scorer.cases):
        if progress is not None:
            progress("baselines", i, len(scorer.cases))
        condition = from_truth(truths[c.number]["conditions"][0])
        lib = library(condition, folder / "oracle").for_tier(scorer.tier)
        r = residual(folder / "cases" / f"{c.number:04d}", condition, lib.columns)
        for name, baseline in BASELINES.items():
            guesses[name][c.number] = baseline(lib, r)
    singles = scorer.singles
    real = [c for c in scorer.of(*REAL) if c.detectable]
    unknowns = [c for c in scorer.of("outside") if c.detectable]
    table = {}
    for name, by_case in guesses.items():
        table[name] = {
            "null_false_alarm": proportion([by_case[c.number].key is not None for c in scorer.of("null")]),
            "detection": proportion([by_case[c.number].key is not None for c in real]),
            "component_top1": proportion([by_case[c.number].component == c.effects[0].component for c in singles]),
            "location_top1": proportion(
                [
                    (by_case[c.number].component, by_case[c.number].index) == (c.effects[0].component, c.effects[0].index)
                    for c in singles
                    if c.effects[0].index
                ]
            ),
            "effect_top1": proportion([by_case[c.number].key == c.effects[0].key for c in singles]),
            "confident_wrong_on_unknown": proportion([by_case[c.number].key is not None for c in unknowns]),
        }
    return table


def separation(truths: Mapping[int, Mapping[str, Any]], tier: str) -> Separates:
    """Whether recommended runs separate, by making them: with the sealed machine and its true effects, and with what else was said."""
    from blind.next_run import separates
    from orchestration.errors import OrchestrationError

    def found(number: int, recommended: Mapping[str, Any], wrong: Sequence[ComponentValues]) -> bool:
        try:
            return separates(truths[number], str(recommended.get("kind")), wrong, tier, DETECTABLE)
        except (OrchestrationError, LookupError):  # no such run, or one that cannot be made
            return False

    return found


def commit() -> str:
    """The version of this code: the commit of its repository, with `+` where files differ from it; empty without one."""
    here = Path(__file__).parent
    try:
        text = [subprocess.run(["git", *a], cwd=here, capture_output=True, text=True, check=True).stdout.strip() for a in _GIT]
    except (OSError, subprocess.CalledProcessError):
        return ""
    return text[0] + ("+" if text[1] else "")


_GIT = (["rev-parse", "--short", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])


def score(
    folder: str | Path,
    *,
    isolability: bool = True,
    baselines: bool = True,
    progress: Callable[[str, int, int], object] | None = None,
) -> dict[str, Any]:
    """Freeze the predictions, unseal, score. `isolability` and `baselines` need signatures: about 15 s for each of six conditions, once.

    Returns tier, cases, scores, strata, per_effect, confusion, baselines. BenchmarkError where the folder is not as it was made.
    """
    folder = Path(folder)
    frozen, first = freeze_predictions(folder)
    head, truths = unseal(folder)
    tier = str(head["tier"])
    cases = load_cases(folder, truths)
    scorer = Scorer(
        cases,
        tier,
        true_closures(folder, truths, tier),
        oracle_confusable(folder, truths, tier) if isolability else None,
        separation(truths, tier),
    )
    result: dict[str, Any] = {
        "schema": "robomill-blind-score/1",
        "tier": tier,
        "cases": len(cases),
        "seed": head["seed"],
        "version": head.get("version"),
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": commit(),
        "predictions": len(frozen),
        "predictions_as_first_unsealed": first,
        "kinds": {k: len(scorer.of(k)) for k in ("null", "single", "double", "triple", "outside", "bad_log")},
        "isolability": isolability,
    }
    result["scores"] = scorer.scores()
    result["strata"] = scorer.strata()
    result["per_effect"] = scorer.per_effect()
    result["confusion"] = scorer.confusion()
    result["baselines"] = baseline_scores(folder, truths, scorer, progress) if baselines else {}
    return result
