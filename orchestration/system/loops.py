"""Cycles of components, for iterated coupling: which components go round together, and which signals close the round.

With `algorithm = "iterated"` every connection that is not marked delayed holds at the END of each step. Components
that only feed forward need one call for that; components on a cycle (a strongly connected part of the graph of
components) are a `Loop` and are stepped again and again until the signals that go backwards in it stay the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from robomill.orchestration.slaves.protocol import Port, base_name, inputs
from robomill.orchestration.system.feedthrough import Element, Link

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Loop:
    """Components that are iterated together."""

    members: tuple[str, ...]
    """In the order in which they are stepped within one round."""
    feedback: Indices
    """Positions on the bus of the outputs that go backwards: the unknowns of the iteration."""
    names: tuple[str, ...]
    """`component.port` of each unknown."""
    arrays: Indices
    """Number of the array that each unknown is an element of; the elements of an array are measured by one scale."""
    starts: npt.NDArray[np.float64]
    """First guess of the unknowns at the start: the start value of (the first of) the inputs that they go to."""
    inner: Mapping[str, tuple[Indices, Indices]]
    """By member: positions among its inputs of those that come from within the loop, and where these stand on the bus."""

    def __str__(self) -> str:
        return " -> ".join([*self.members, self.members[0]])


def regroup(order: Sequence[str], links: Sequence[Link]) -> tuple[list[str], list[tuple[str, ...]]]:
    """The order of execution with the components of each cycle next to each other, and the cycles.

    Between cycles everything goes forwards; within one, and where nothing is prescribed, the given order stays.
    """
    reached = _reachable(order, links)
    groups: list[tuple[str, ...]] = []
    placed: set[str] = set()
    for name in order:
        if name not in placed:
            group = tuple(n for n in order if n == name or (n in reached[name] and name in reached[n]))
            groups.append(group)
            placed.update(group)
    sorted_groups: list[tuple[str, ...]] = []
    while groups:
        waiting = {n for g in groups for n in g}
        # a group none of whose members is reached from another group that still waits; the first such in the old order
        ready = next(g for g in groups if not any(g[0] in reached[n] for n in waiting.difference(g)))
        sorted_groups.append(ready)
        groups.remove(ready)
    cycles = [g for g in sorted_groups if g[0] in reached[g[0]]]
    return [n for g in sorted_groups for n in g], cycles


def _reachable(names: Sequence[str], links: Sequence[Link]) -> dict[str, set[str]]:
    """Components that each one's outputs get to along connections (itself only if it is on a cycle)."""
    onward: dict[str, set[str]] = {n: set() for n in names}
    for source, target in links:
        onward[source[0]].add(target[0])
    reached: dict[str, set[str]] = {}
    for name in names:
        found: set[str] = set()
        waiting = [name]
        while waiting:
            for nxt in onward[waiting.pop()] - found:
                found.add(nxt)
                waiting.append(nxt)
        reached[name] = found
    return reached


def lay_out(cycle: Sequence[str], links: Sequence[Link], components: Mapping[str, Sequence[Port]], place: Mapping[Element, int]) -> Loop:
    """The loop of the components `cycle` (in the order of execution); `place` gives the position of an output on the bus."""
    rank = {name: i for i, name in enumerate(cycle)}
    within = [(s, t) for s, t in links if s[0] in rank and t[0] in rank]
    starts: dict[Element, float] = {}
    for source, target in within:
        if rank[source[0]] >= rank[target[0]]:
            port = next(p for p in components[target[0]] if p.name == target[1])
            starts.setdefault(source, float(port.start or 0.0))
    unknowns = sorted(starts, key=place.__getitem__)
    bases = list(dict.fromkeys((c, base_name(p)) for c, p in unknowns))
    sources = {target: place[source] for source, target in within}
    inner = {}
    for name in cycle:
        found = [(i, sources[name, p.name]) for i, p in enumerate(inputs(components[name])) if (name, p.name) in sources]
        inner[name] = (np.array([i for i, _ in found], dtype=np.intp), np.array([k for _, k in found], dtype=np.intp))
    return Loop(
        members=tuple(cycle),
        feedback=np.array([place[e] for e in unknowns], dtype=np.intp),
        names=tuple(f"{c}.{p}" for c, p in unknowns),
        arrays=np.array([bases.index((c, base_name(p))) for c, p in unknowns], dtype=np.intp),
        starts=np.array([starts[e] for e in unknowns]),
        inner=inner,
    )
