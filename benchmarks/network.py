"""A system of FMUs as plain data, for masters that are not ours: files, value references, links, parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the processes of the peers load nothing of ours
    from robomill.orchestration.assembly import Assembly

TYPES = ("real", "integer", "boolean")


@dataclass(frozen=True)
class Variable:
    """A scalar variable of an FMU."""

    name: str
    reference: int
    type: str
    value: Any = None
    """Value of a parameter."""


@dataclass(frozen=True)
class Member:
    """One FMU in the network. Places are positions among all outputs of the network."""

    name: str
    fmu: str
    parameters: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    """The connected ones."""
    sources: tuple[int, ...]
    """Place of the output that feeds each of them."""
    known_first: tuple[bool, ...]
    """Whether it is fed during initialisation, too (False: delayed, its start value holds)."""
    outputs: tuple[Variable, ...]
    first: int
    """Place of the first output."""


@dataclass(frozen=True)
class Network:
    """All members in the order of execution."""

    step: float
    algorithm: str
    members: tuple[Member, ...]

    @property
    def outputs(self) -> list[tuple[Member, Variable]]:
        """All outputs, by place."""
        return [(m, v) for m in sorted(self.members, key=lambda m: m.first) for v in m.outputs]

    @staticmethod
    def of(assembly: Assembly) -> Network:
        """The network of an assembled system whose components are all FMUs."""
        from robomill.orchestration.slaves.protocol import inputs, outputs

        w, members, n = assembly.wiring, [], assembly.wiring.n_outputs
        for name in w.order:
            slave: Any = assembly.slaves[name]
            references = slave.description.references
            types = {p.name: p.type for p in slave.ports}
            wired = [
                (Variable(p.name, references[p.name], p.type), int(place) % n, bool(at_first < n))
                for p, place, at_first in zip(inputs(slave.ports), w.gather[name], w.gather_first[name], strict=True)
                if place < 2 * n  # beyond stand the start values of open inputs
            ]
            members.append(
                Member(
                    name,
                    next(str(c.source) for c in assembly.system.components if c.name == name),
                    tuple(Variable(k, references[k], types[k], v) for k, v in assembly.parameters[name].items()),
                    tuple(v for v, _, _ in wired),
                    tuple(place for _, place, _ in wired),
                    tuple(first for _, _, first in wired),
                    tuple(Variable(p.name, references[p.name], p.type) for p in outputs(slave.ports)),
                    w.output_slice[name].start,
                )
            )
        return Network(assembly.system.step, assembly.system.algorithm, tuple(members))


def by_type(variables: Sequence[Variable]) -> list[tuple[str, list[int]]]:
    """(type, positions) of the types that occur: each is one call."""
    found = [(t, [i for i, v in enumerate(variables) if v.type == t]) for t in TYPES]
    return [(t, positions) for t, positions in found if positions]


def calls(network: Network) -> int:
    """Calls of FMU functions in a macro step: one set and one get per type, one step."""
    return sum(len(by_type(m.inputs)) + 1 + len(by_type(m.outputs)) for m in network.members)
