"""The scalar variables of a model as FMI sees them, derived from its declaration; the one table behind every backend.

Value reference = position in the record, counted in words of eight bytes: all fields are float64 or
int64, so the record is a flat image and a value reference is an address in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

from robomill.models.model.declaration import Causality, Model, Variable

WORD = 8
"""Bytes of every element of a record."""

PortType = Literal["real", "integer", "boolean", "string"]
PortValue = float | int | bool | str


@dataclass(frozen=True, slots=True)
class Port:
    """One scalar variable: an element of a declared variable, or a table as the path of its file."""

    name: str
    """`x`, `q[1]` or `stiffness[3,1]`; the elements of an array follow each other in C order."""
    variable: str
    """Name of the declared variable that it is an element of."""
    causality: Causality
    type: PortType
    variability: Literal["continuous", "discrete", "fixed", "tunable"]
    initial: Literal["exact", "calculated"] | None
    reference: int
    """FMI value reference = word in the record; of a table, the word with its number of rows."""
    unit: str | None
    display_unit: str | None
    start: PortValue
    """Start value [unit]; outputs have it, too, though FMI shows none (`initial` is calculated)."""
    minimum: float | None
    maximum: float | None
    description: str
    dependencies: tuple[str, ...] | None
    """Outputs only (else None): names of the inputs that it depends on instantaneously in a step."""

    @property
    def offset(self) -> int:
        """Position in the record [bytes]."""
        return WORD * self.reference


class Interface:
    """Ports of a model in the order inputs, outputs, parameters, each as declared; states are not shown."""

    def __init__(self, model: Model) -> None:
        self.model = model
        ports = [
            p
            for causality in ("input", "output", "parameter")
            for v in model.variables
            if v.causality == causality
            for p in _ports(model, v)
        ]
        self.ports: tuple[Port, ...] = tuple(ports)
        self.inputs, self.outputs, self.parameters = (
            tuple(p for p in ports if p.causality == causality) for causality in ("input", "output", "parameter")
        )
        self.by_name = {p.name: p for p in ports}
        self.by_reference = {p.reference: p for p in ports}

    @cached_property
    def arrays(self) -> dict[str, slice]:
        """Where the elements of a declared variable stand among the inputs, the outputs or the parameters."""
        found: dict[str, slice] = {}
        for group in (self.inputs, self.outputs, self.parameters):
            for i, port in enumerate(group):
                first = found.setdefault(port.variable, slice(i, i))
                found[port.variable] = slice(first.start, i + 1)
        return found

    @cached_property
    def tables_at(self) -> int:
        """Byte of the record at which the tables begin: before it stands everything a step changes, behind it are addresses."""
        names = [v.name for v in self.model.variables if v.kind == "table"]
        fields: Any = self.model.dtype.fields
        return min((fields[f"{name}_rows"][1] for name in names), default=self.model.dtype.itemsize)


_KNOWN: dict[int, Interface] = {}


def interface_of(model: Model) -> Interface:
    """The interface of a model, made once: with hundreds of ports that takes longer than a short run."""
    if id(model) not in _KNOWN:  # it holds its model, so the number stays that of this one
        _KNOWN[id(model)] = Interface(model)
    return _KNOWN[id(model)]


def _ports(model: Model, v: Variable) -> list[Port]:
    """One port per element of a declared variable; one for a table."""
    fields: Any = model.dtype.fields
    if v.kind == "table":
        text = f"{v.description} [path of a .npy file with rows of {v.shape[0]} columns; empty = the built-in rows]"
        return [_port(v, v.name, fields[f"{v.name}_rows"][1] // WORD, "", text, None)]
    first = fields[v.name][1] // WORD
    starts = v.start_values.ravel().tolist()
    dependencies = None
    if v.causality == "output":
        followed = [i for i in model.variables if i.causality == "input" and (v.depends_on is None or i.name in v.depends_on)]
        dependencies = tuple(element for i in followed for element in i.element_names)
    return [_port(v, name, first + i, starts[i], v.description, dependencies) for i, name in enumerate(v.element_names)]


def _port(v: Variable, name: str, word: int, start: float | str, description: str, dependencies: tuple[str, ...] | None) -> Port:
    real = v.kind == "real"
    value: PortValue = start
    if v.kind == "integer":
        value = int(start)
    elif v.kind == "boolean":
        value = bool(start)
    parameter = v.causality == "parameter"
    return Port(
        name=name,
        variable=v.name,
        causality=v.causality,
        type="string" if v.kind == "table" else v.kind,
        variability=("tunable" if v.tunable else "fixed") if parameter else ("continuous" if real else "discrete"),
        initial={"input": None, "output": "calculated", "parameter": "exact"}[v.causality],
        reference=word,
        unit=v.unit if real else None,
        display_unit=v.display_unit if real else None,
        start=value,
        minimum=v.minimum,
        maximum=v.maximum,
        description=description,
        dependencies=dependencies,
    )
