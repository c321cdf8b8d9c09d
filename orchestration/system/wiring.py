"""Connections checked and turned into index arrays before anything runs.

The bus is one flat float64 array in three parts: the outputs of all components in the order of the
system; the same outputs as they were at the last step (for delayed connections); one slot per input
that holds its start value (for open inputs, and before the first step).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from robomill.orchestration.errors import WiringError, unknown
from robomill.orchestration.slaves.protocol import CARRIED, FloatArray, Port, PortData, arrays, base_name, inputs, outputs, whole_range
from robomill.orchestration.system.definition import Connection, System
from robomill.orchestration.system.feedthrough import Element, Link, execution_order, feedthrough, find_loop
from robomill.orchestration.system.loops import Loop, lay_out, regroup
from robomill.orchestration.system.parameters import Convert, same_unit, same_unit_only

Indices = npt.NDArray[np.intp]

MASTER = "master"
RECORD = (
    PortData("iterations", "output", "integer", "1", description="rounds of the loop that took most of them in this step", dependencies=()),
    PortData("residual", "output", "real", "1", description="largest relative change in the last round", dependencies=()),
)
"""What the master itself reports with the algorithm "iterated": the last two outputs of the bus."""


@dataclass(frozen=True)
class Wiring:
    """What the master needs to run a system; see the module text for the bus."""

    order: tuple[str, ...]
    """Components in the order in which they are initialised, and stepped by Gauss-Seidel."""
    outputs: tuple[tuple[str, Port], ...]
    """(component, port) of each output, in the order of the bus."""
    inputs: tuple[tuple[str, Port], ...]
    """(component, port) of each input, in the order of the start slots."""
    output_slice: Mapping[str, slice]
    """Where a component's outputs stand on the bus."""
    gather: Mapping[str, Indices]
    """Positions on the bus of a component's inputs during a run."""
    gather_first: Mapping[str, Indices]
    """Those during initialisation: connections that are delayed or go backwards give the input's start value."""
    start_values: FloatArray = field(repr=False)
    """The bus before initialisation."""
    any_delayed: bool
    """Whether the part with the last step's outputs is read at all."""
    warnings: tuple[str, ...]
    loops: tuple[Loop, ...] = ()
    """Cycles of components, with the algorithm "iterated"."""
    whole: Mapping[int, Sequence[tuple[str, int, int]]] = field(default_factory=dict)
    """By position of an output that is a whole number: (input that it goes to, "" = the bus; least, largest that gets there unchanged)."""

    @property
    def n_outputs(self) -> int:
        """Number of scalar outputs of the system."""
        return len(self.outputs)

    def column_names(self) -> list[str]:
        """`component.port` of each output, in the order of the bus."""
        return [f"{c}.{p.name}" for c, p in self.outputs]


class _Pair(NamedTuple):
    source: Element
    target: Element
    delayed: bool
    connection: Connection


def wire(system: System, components: Mapping[str, Sequence[Port]], convert: Convert = same_unit_only) -> Wiring:
    """Check `system.connections` against the ports of the `components` and lay out the bus; `convert` knows spellings of units.

    WiringError lists every problem found, one sentence each: unknown component or port, wrong
    direction, unit, type or array size, two sources of one input, open inputs (if required to be
    connected), an algebraic loop that Gauss-Seidel cannot resolve.
    """
    problems: list[str] = []
    pairs: list[_Pair] = []
    taken: dict[Element, Connection] = {}
    named = {name: arrays(ports) for name, ports in components.items()}
    for c in system.connections:
        where = system.where(c.line)
        found, said = _expand(c, components, named, convert)
        problems.extend(f"{where}{p}" for p in said)
        for pair in found:
            other = taken.setdefault(pair.target, c)
            if other is not c:
                problems.append(f"{where}input {_name(pair.target)} has two sources: {other} and {c}; remove one of them")
                break
        pairs.extend(found)
    open_inputs = _open_inputs(components, taken)
    if system.require_connected:
        problems.extend(f"{system.where(None)}{text}; connect it, or set require_connected = false" for text in open_inputs)
    problems += [text for name, ports in components.items() for text in _unfit_starts(name, ports)]
    if system.algorithm == "iterated" and MASTER in components:
        problems.append(f"component name {MASTER!r} belongs to the columns of iterated coupling; choose another")
    if problems:
        raise WiringError(problems)
    through = feedthrough(components)
    links: list[Link] = [(p.source, p.target) for p in pairs if not p.delayed]
    loop = find_loop(through, links) if system.algorithm == "gauss-seidel" else None
    if loop:
        raise WiringError([system.where(None) + _loop_text(loop, pairs, list(components))])
    order = execution_order(through, links, list(components))
    if system.algorithm == "iterated":
        order, cycles = regroup(order, links)
        return _layout(components, pairs, order, system.algorithm, open_inputs, [(c, links) for c in cycles])
    rank = {name: i for i, name in enumerate(order)}
    backward = [p for p in pairs if not p.delayed and rank[p.source[0]] >= rank[p.target[0]]]
    warnings = [*open_inputs, *(_backward_texts(backward) if system.algorithm == "gauss-seidel" else [])]
    return _layout(components, pairs, order, system.algorithm, warnings)


def _layout(
    components: Mapping[str, Sequence[Port]],
    pairs: Sequence[_Pair],
    order: Sequence[str],
    algorithm: str,
    warnings: Sequence[str],
    cycles: Sequence[tuple[Sequence[str], Sequence[Link]]] = (),
) -> Wiring:
    iterated = algorithm == "iterated"
    outs = [(name, p) for name, ports in components.items() for p in outputs(ports)] + ([(MASTER, p) for p in RECORD] if iterated else [])
    ins = [(name, p) for name, ports in components.items() for p in inputs(ports)]
    n = len(outs)
    place = {(name, p.name): i for i, (name, p) in enumerate(outs)}
    slot = {(name, p.name): 2 * n + i for i, (name, p) in enumerate(ins)}
    run, first = dict(slot), dict(slot)
    rank = {name: i for i, name in enumerate(order)}
    any_delayed = False
    for p in pairs:
        forward = rank[p.source[0]] < rank[p.target[0]]
        # With Jacobi, and backwards, the output on the bus is still that of the last step when it is read.
        # Iterated, a component may run several times in a step, so what is delayed is always read from the copy.
        from_last = p.delayed and (iterated or (forward and algorithm == "gauss-seidel"))
        any_delayed |= from_last
        run[p.target] = place[p.source] + (n if from_last else 0)
        if (forward or iterated) and not p.delayed:
            first[p.target] = place[p.source]
    starts = np.concatenate([np.zeros(2 * n), [float(p.start or 0.0) for _, p in ins]])
    whole = {i: [("", *whole_range(p))] for i, (_, p) in enumerate(outs) if p.type == "integer"}
    by_element = {(name, p.name): p for name, p in ins}
    for pair in pairs:
        if place[pair.source] in whole:
            whole[place[pair.source]].append((_name(pair.target), *whole_range(by_element[pair.target])))
    slices, begin = {}, 0
    for name, ports in components.items():
        slices[name] = slice(begin, begin + len(outputs(ports)))
        begin = slices[name].stop

    def indices(positions: Mapping[Element, int], name: str) -> Indices:
        return np.array([positions[name, p.name] for p in inputs(components[name])], dtype=np.intp)

    return Wiring(
        order=tuple(order),
        outputs=tuple(outs),
        inputs=tuple(ins),
        output_slice=slices,
        gather={name: indices(run, name) for name in components},
        gather_first={name: indices(first, name) for name in components},
        start_values=starts,
        any_delayed=any_delayed,
        warnings=tuple(warnings),
        loops=tuple(lay_out(cycle, links, components, place) for cycle, links in cycles),
        whole=whole,
    )


def _expand(
    c: Connection, components: Mapping[str, Sequence[Port]], named: Mapping[str, Mapping[str, tuple[Port, ...]]], convert: Convert
) -> tuple[list[_Pair], list[str]]:
    """The scalar connections of one connection, and what is wrong with it (then there are none); `named`: arrays of each component."""
    ends = []
    for text, wanted, word in ((c.source, "output", "from"), (c.target, "input", "to")):
        name, _, port = text.partition(".")
        if name not in components:
            return [], [f"connection {c}: {unknown('component', name, components)}"]
        ports = components[name]
        members = named[name].get(port) or tuple(p for p in ports if p.name == port)
        if not members:
            others = arrays(outputs(ports) if wanted == "output" else inputs(ports))
            if base_name(port) in others:
                whole = others[base_name(port)]
                return [], [f"connection {c}: there is no {text}: {name}.{base_name(port)} has {_size(whole, base_name(port))}"]
            return [], [f"connection {c}: {unknown(f'{wanted} of {name!r}:', port, others)}"]
        if members[0].causality != wanted:
            return [], [f"connection {c}: {_direction(text, members[0].causality, word, wanted, name)}"]
        if members[0].type not in CARRIED:
            return [], [f"connection {c}: {text} is of type {members[0].type}, which cannot be connected: only numbers and booleans can"]
        ends.append((name, port, members))
    (source, from_port, froms), (target, to_port, tos) = ends
    if [p.name[len(from_port) :] for p in froms] != [p.name[len(to_port) :] for p in tos] and not len(froms) == len(tos) == 1:
        sizes = _size(froms, from_port), _size(tos, to_port)
        if sizes[0] == sizes[1]:
            names = " and ".join(f"{members[0].name} to {members[-1].name}" for members in (froms, tos))
            return [], [f"connection {c}: the elements have other indices, {names}: connect them one by one"]
        return [], [f"connection {c}: {c.source} has {sizes[0]}, {c.target} has {sizes[1]}"]
    for a, b in zip(froms, tos, strict=True):
        if a.type != b.type and (a.type, b.type) != ("integer", "real"):
            return [], [f"connection {c}: type mismatch: {source}.{a.name} is {a.type}, {target}.{b.name} is {b.type}"]
        if a.unit is not None and b.unit is not None and not same_unit(a.unit, b.unit, convert):
            return [], [f"connection {c}: unit mismatch: {source}.{a.name} is in {a.unit!r}, {target}.{b.name} expects {b.unit!r}"]
    return [_Pair((source, a.name), (target, b.name), c.delayed, c) for a, b in zip(froms, tos, strict=True)], []


def _direction(text: str, causality: str, word: str, wanted: str, name: str) -> str:
    article = "an" if causality[0] in "aeiou" else "a"
    if causality == "structural parameter":
        return f"{text} is a structural parameter, which decides sizes of arrays and keeps its start value"
    if causality == "parameter":
        return f"{text} is a parameter; set it under [components.{name}.parameters]"
    never = " (an output is never a destination)" if causality == "output" else ""
    return f"{text} is {article} {causality}; {word!r} takes an {wanted}{never}"


def _size(members: Sequence[Port], port: str) -> str:
    if len(members) == 1:
        return "1 element"
    last = members[-1].name[len(port) + 1 : -1]
    return f"{len(members)} elements" + (f" [{last}]" if "," in last else "")


def _unfit_starts(name: str, ports: Sequence[Port]) -> Iterator[str]:
    """One text per input whose start value does not get there unchanged."""
    for p in inputs(ports):
        if p.type == "integer" and p.start is not None:
            low, high = whole_range(p)
            if not low <= int(p.start) <= high:
                yield f"input {name}.{p.name}: start value {int(p.start)} does not fit: expected a whole number from {low} to {high}"


def _open_inputs(components: Mapping[str, Sequence[Port]], taken: Mapping[Element, object]) -> list[str]:
    """One text per array with open elements."""
    texts = []
    for name, ports in components.items():
        connectable = inputs(ports)
        if all((name, p.name) in taken for p in connectable):
            continue
        for base, members in arrays(connectable).items():
            missing = [p for p in members if (name, p.name) not in taken]
            if missing:
                which = f"{name}.{base}" if len(missing) == len(members) else ", ".join(f"{name}.{p.name}" for p in missing)
                starts = dict.fromkeys(f"{float(p.start or 0.0):.9g}" for p in missing)
                value = starts.popitem()[0] if len(starts) == 1 else "[" + ", ".join(f"{float(p.start or 0.0):.9g}" for p in missing) + "]"
                unit = "" if missing[0].unit in (None, "1") else f" {missing[0].unit}"
                texts.append(f"input {which} is not connected: it keeps its start value {value}{unit}")
    return texts


def _loop_text(loop: Sequence[Element], pairs: Sequence[_Pair], components: Sequence[str]) -> str:
    hops = [base for base, nxt in pairwise([*map(_base, loop), ""]) if base != nxt]
    by_ends = {(p.source, p.target): p.connection for p in pairs if not p.delayed}
    closed = [*loop, loop[0]]
    candidates = [by_ends[edge] for edge in pairwise(closed) if edge in by_ends]
    place = {name: i for i, name in enumerate(components)}

    def backwards(c: Connection) -> int:
        return place[c.source.partition(".")[0]] - place[c.target.partition(".")[0]]

    best = max(candidates, key=backwards)
    others = [str(c) for c in candidates if c is not best]
    return (
        f"algebraic loop: {' -> '.join([*hops, hops[0]])}; Gauss-Seidel cannot resolve it: mark the connection {best} with delayed = true"
        + (f" (or one of {', '.join(others)})" if others else "")
        + ", or use algorithm = 'iterated' or 'jacobi'"
    )


def _backward_texts(backward: Sequence[_Pair]) -> list[str]:
    return [
        f"connection {c} goes backwards in the order of execution, though not in an algebraic loop: its input sees the last step "
        "(mark it delayed = true to say so)"
        for c in dict.fromkeys(p.connection for p in backward)
    ]


def _base(element: Element) -> str:
    return f"{element[0]}.{base_name(element[1])}"


def _name(element: Element) -> str:
    return f"{element[0]}.{element[1]}"
