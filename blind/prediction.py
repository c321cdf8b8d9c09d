"""What a diagnosis says of one case: `predictions/NNNN/diagnosis.json` (schema robomill-diagnosis/1), as far as it is scored.

Effects are known by component and parameter name, so the catalogue of the diagnosis may call them what it likes.
A clock is a matter of the log, not of physics: a prediction that names one first stops the log, whatever its verdict.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

LOGGING = "logging"
"""Component that stands for the log itself."""
IN_THE_SET = 0.01
"""Probability from which a candidate belongs to the set of an ambiguous answer."""
CLAIMED = 0.5
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

ComponentValues = Mapping[str, Mapping[str, float]]
"""Component -> parameter -> value; of the log: `lag PATTERN` -> s."""


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
class Candidate:
    """One line of `which`."""

    names: tuple[Named, ...]
    probability: float
    parameters: Mapping[str, Mapping[str, Any]]
    component: str
    confusable: tuple[str, ...]

    @staticmethod
    def read(content: Mapping[str, Any]) -> Candidate:
        """From a line; named by its parameters, by the name of its effect if it has none."""
        component = str(content.get("component", ""))
        parameters = content.get("parameters") or {}
        names = tuple(Named.of(component, p) for p in parameters) or (Named.of(component, str(content.get("effect", ""))),)
        others = tuple(str(c) for c in content.get("confusable_with") or ())
        return Candidate(names, float(content.get("probability", 0.0)), parameters, COMPONENTS.get(component, component), others)

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
    """A diagnosis.json; candidates by falling probability."""

    verdict: str
    which: tuple[Candidate, ...] = ()
    where: tuple[Mapping[str, Any], ...] = ()
    how_far: tuple[Mapping[str, Any], ...] = ()
    next_run: Mapping[str, Any] | None = None
    form: Mapping[str, Any] | None = None
    """The form of an unknown law, as plain data (`models.components.correction`)."""
    cpu: float | None = None
    """CPU time that it took [s]."""
    wall: float | None = None
    """Wall time that it took [s]."""
    left_out: frozenset[str] = frozenset()
    """Runs that it names as cut short, and does not use."""

    @staticmethod
    def read(content: Mapping[str, Any]) -> Prediction:
        """Anything that is missing counts as empty."""
        findings = (content.get("gate") or {}).get("findings") or ()
        candidates = sorted((Candidate.read(w) for w in content.get("which") or ()), key=lambda c: -c.probability)
        return Prediction(
            str(content.get("verdict", "missing")),
            tuple(candidates),
            tuple(content.get("where") or ()),
            tuple(content.get("how_far") or ()),
            content.get("next_run"),
            (content.get("form") or {}).get("specification") or None,
            (content.get("time") or {}).get("cpu"),
            (content.get("time") or {}).get("wall"),
            frozenset(str(f["run"]) for f in findings if f["kind"] == "short" and f.get("repaired")),
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
    def claimed(self) -> tuple[Candidate, ...]:
        """What the prediction stands for: nothing unless identified or ambiguous, else the first and all that are likely."""
        if self.verdict not in ("identified", "ambiguous") or not self.which:
            return ()
        return (self.which[0], *(c for c in self.which[1:] if c.probability >= CLAIMED))

    @property
    def claimed_keys(self) -> set[str]:
        """Effects that it stands for, as `component.effect`."""
        return {n.key for c in self.claimed for n in c.names}

    @property
    def claimed_values(self) -> ComponentValues:
        """Parameters that it stands for."""
        values: dict[str, dict[str, float]] = {}
        for candidate in self.claimed:
            for component, parameters in candidate.values.items():
                values.setdefault(component, {}).update(parameters)
        return values

    @property
    def listed(self) -> tuple[Candidate, ...]:
        """Members of the set of an ambiguous answer."""
        return tuple(c for c in self.which if c.probability >= IN_THE_SET)

    @property
    def component(self) -> str | None:
        """The component that is named first: by the largest share, else by the first effect. None where nothing is said to be there."""
        if not self.found:
            return None
        if self.where:
            name = str(self._largest_share.get("component", ""))
            return COMPONENTS.get(name, name)
        return self.which[0].component if self.which else None

    @property
    def location(self) -> str:
        """The place that is named first, such as `joint 2`; empty if none is."""
        return str(self._largest_share.get("location", "")).partition(",")[0].strip()

    @property
    def _largest_share(self) -> Mapping[str, Any]:
        return max(self.where, key=lambda w: float(w.get("share", 0.0))) if self.where else {}
