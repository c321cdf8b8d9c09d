"""Feedthrough between ports: algebraic loops and the order of execution.

An input feeds an output through when the output depends on it instantaneously (declared by the
component; unknown counts as yes). A loop of such dependencies and connections, element by element,
is an algebraic loop: no order of execution satisfies it. Components, though, are stepped whole: their
order may leave a connection that goes backwards even where there is no algebraic loop.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping, Sequence

from robomill.orchestration.slaves.protocol import Port, inputs, outputs

Element = tuple[str, str]
"""(component, port)."""
Link = tuple[Element, Element]
"""From an output to an input, not delayed."""


def feedthrough(components: Mapping[str, Sequence[Port]]) -> dict[Element, list[Element]]:
    """Outputs that each input feeds through to, in the order of the ports."""
    through: dict[Element, list[Element]] = {}
    for name, ports in components.items():
        names = [p.name for p in inputs(ports)]
        known = set(names)
        for i in names:
            through[name, i] = []
        for o in outputs(ports):
            for i in names if o.dependencies is None else known.intersection(o.dependencies):
                through[name, i].append((name, o.name))
    return through


def find_loop(through: Mapping[Element, Iterable[Element]], links: Iterable[Link]) -> list[Element] | None:
    """One algebraic loop as the elements it passes (input, output, input, ..., output), or None.

    Depth-first search without recursion, in the order of the ports: the same system gives the same loop.
    """
    onward: dict[Element, list[Element]] = {e: list(found) for e, found in through.items()}
    for source, target in links:
        onward.setdefault(source, []).append(target)
    done: set[Element] = set()
    for start in through:
        path: list[Element] = []
        on_path: set[Element] = set()
        stack: list[tuple[Element, int]] = [(start, 0)]
        while stack:
            element, depth = stack.pop()
            for left in path[depth:]:
                on_path.discard(left)
                done.add(left)
            del path[depth:]
            if element in on_path:
                return _from_an_input(path[path.index(element) :], through)
            if element in done:
                continue
            path.append(element)
            on_path.add(element)
            stack.extend((e, depth + 1) for e in reversed(onward.get(element, [])))
        done.update(path)
    return None


def _from_an_input(loop: list[Element], through: Mapping[Element, object]) -> list[Element]:
    return loop if loop[0] in through else [*loop[1:], loop[0]]


def execution_order(through: Mapping[Element, Sequence[Element]], links: Sequence[Link], components: Sequence[str]) -> list[str]:
    """Components so that as many connections as matter go forwards; ties in the order of the system.

    A connection matters (hard) if it ends in an input that feeds through to an output which is itself
    connected; else (soft) nobody sees in the same step whether it was fresh.
    """
    connected = {source for source, _ in links}
    hard: set[tuple[str, str]] = set()
    soft: set[tuple[str, str]] = set()
    for source, target in links:
        if source[0] != target[0]:
            matters = any(o in connected for o in through.get(target, ()))
            (hard if matters else soft).add((source[0], target[0]))
    place = {name: i for i, name in enumerate(components)}
    waits = {name: [0, 0] for name in components}  # hard and soft connections from components that are not in the order yet
    onward: dict[str, list[tuple[str, int]]] = {name: [] for name in components}
    for kind, edges in enumerate((hard, soft)):
        for a, b in edges:
            waits[b][kind] += 1
            onward[a].append((b, kind))
    heap = [(*waits[name], place[name]) for name in components]
    heapq.heapify(heap)
    order: list[str] = []
    while heap:
        *rank, i = heapq.heappop(heap)
        name = components[i]
        if name not in waits or rank != waits[name]:  # it is in the order, or stands in the heap with fewer, too
            continue
        del waits[name]
        order.append(name)
        for b, kind in onward[name]:
            if b in waits:
                waits[b][kind] -= 1
                heapq.heappush(heap, (*waits[b], place[b]))
    return order
