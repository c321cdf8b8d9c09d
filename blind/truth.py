"""What is in a case: the sealed truth, as the generator writes it and who scores reads it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from robomill.blind.conditions import Condition
from robomill.blind.effects import BY_KEY, Instance
from robomill.blind.prediction import LOGGING, Named


@dataclass(frozen=True)
class TrueEffect:
    """A catalogue effect; value in SI."""

    component: str
    """Component of the system, or `logging`."""
    effect: str
    """Name of the parameter without its element."""
    parameter: str
    """Name of the element: `stiffness_error[2]`."""
    index: int
    """Element of the parameter, from 1; 0: it is a scalar."""
    value: float
    """Value, in `unit`."""
    unit: str
    """SI unit."""
    formulation: str = "parameter"
    """How it is made: by its parameter, or as something else, such as `bouc_wen`; `clock`: in the log."""
    detectability: float | None = None
    """Oracle ratio of this effect alone; None: not looked at."""

    @property
    def named(self) -> Named:
        """As predictions name it."""
        return Named.of(self.component, self.parameter)

    @property
    def physical(self) -> bool:
        """Whether it is in the machine, not in its log."""
        return self.component != LOGGING

    @property
    def instance(self) -> Instance:
        """As it is switched on; of a clock there is none (KeyError)."""
        return Instance(BY_KEY[f"{self.component}.{self.effect}"], self.index, self.value)


@dataclass(frozen=True)
class TrueOutside:
    """A change that no catalogue entry expresses."""

    name: str
    """What the change is."""
    component: str | None
    """None: no single one."""
    value: float
    """Value, in `unit`."""
    unit: str
    """SI unit."""


@dataclass(frozen=True)
class TrueFault:
    """A fault of the log; `channel` is an array or an element of one."""

    kind: str
    """What is wrong with the log."""
    channel: str
    """Array, or element of one."""
    value: float
    """Value, in `unit`."""
    unit: str
    """SI unit."""
    detectability: float | None = None
    """Oracle ratio; None: not looked at."""


@dataclass(frozen=True)
class Truth:
    """All of a case; of a null there are no effects, and neither of the two after them."""

    kind: str
    """What sort of case it is: null, single, double, withheld, unknown, bad_log."""
    effects: tuple[TrueEffect, ...] = ()
    """Effects that the machine has."""
    outside: TrueOutside | None = None
    """Change that no catalogue entry expresses."""
    bad_log: TrueFault | None = None
    """Fault of the log."""
    case: int = 0
    """Number of the case."""
    tier: str = "T1"
    """Set of channels that are logged."""
    generator: str = "first"
    """Generator that made it."""
    repeats: int = 6
    """Runs of each diagnosed condition."""
    machine: Mapping[str, Mapping[str, Any]] | None = None
    """Perturbed parameters; None: the generator has none that the models know."""
    hidden: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Constants that no two machines share, as far as the models have parameters for them."""
    conditions: tuple[Condition, ...] = ()
    """What was measured, held-out conditions last; empty: the generator has conditions of its own."""
    detectability: float = 0.0
    """Oracle ratio of all that is in it, the largest over the measured arrays."""
    detectability_by_array: Mapping[str, float] = field(default_factory=dict)
    """Oracle ratio by measured array."""
    ceiling: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Held-out condition -> tool tip or force -> closure if the true effects are adopted."""

    @staticmethod
    def read(content: Mapping[str, Any]) -> Truth:
        """From the content of the sealed file."""
        records: dict[str, Any] = {k: kind(**content[k]) for k, kind in (("outside", TrueOutside), ("bad_log", TrueFault)) if k in content}
        records["effects"] = tuple(TrueEffect(**e) for e in content["effects"])
        records["conditions"] = tuple(Condition(**{**c, "position": tuple(c["position"])}) for c in content.get("conditions", ()))
        return Truth(**{**content, **records})

    @property
    def aborted_run(self) -> str:
        """Folder of the repeat that was aborted: the last one of the first condition (`second.generate`). Empty where none was."""
        if self.bad_log is None or self.bad_log.kind != "aborted" or not self.conditions:
            return ""
        return f"{self.conditions[0].name.replace(' ', '-')}-{self.repeats}"

    @property
    def content(self) -> dict[str, Any]:
        """The content of the sealed file."""
        return {k: v for k, v in asdict(self).items() if v is not None}
