"""The system cut open wherever an output is measured: which components stand between the cuts. Structure only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from robomill.orchestration.slaves.protocol import base_name
from robomill.orchestration.system.definition import System


@dataclass(frozen=True)
class Segment:
    """A measured output, and the components between it and the cuts before it."""

    output: str
    """Array or scalar, `component.port`."""
    components: tuple[str, ...]
    """That of the output first."""


@dataclass(frozen=True)
class Structure:
    """What the connections alone say."""

    segments: tuple[Segment, ...]
    """Measured outputs and the components in their reach."""
    alike: tuple[tuple[str, ...], ...]
    """Sets of more than one component that are in the same segments: no replay can tell them apart."""


def segments(system: System, measured: Sequence[str]) -> list[Segment]:
    """One for each measured output; a component is in it that reaches the output without passing a measured one.

    Structure only: every input of a component is taken to act on every output.
    """
    before: dict[str, list[str]] = {}
    for c in system.connections:
        if base_name(c.source) not in measured:
            before.setdefault(c.target.partition(".")[0], []).append(c.source.partition(".")[0])
    found = []
    for output in measured:
        members = [output.partition(".")[0]]
        for m in members:
            members += [b for b in dict.fromkeys(before.get(m, ())) if b not in members]
        found.append(Segment(output, tuple(members)))
    return found


def sets_alike(found: Sequence[Segment], components: Sequence[str]) -> list[tuple[str, ...]]:
    """Components that are in the same segments, which no replay can tell apart; each component is in one set."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for c in components:
        groups.setdefault(tuple(s.output for s in found if c in s.components), []).append(c)
    return [tuple(g) for seen, g in groups.items() if seen]


def structure(system: System, measured: Sequence[str]) -> Structure:
    """The segments between the `measured` outputs (`component.port`), and the components that these cannot tell apart."""
    found = segments(system, measured)
    sets = sets_alike(found, [c.name for c in system.components])
    return Structure(tuple(found), tuple(s for s in sets if len(s) > 1))


def by_array(channels: Sequence[str]) -> dict[str, list[int]]:
    """Array or scalar -> places of its elements among the channels, in their order."""
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(channels):
        groups.setdefault(base_name(name), []).append(i)
    return groups


def playing(system: System) -> set[str]:
    """Components that nothing goes into: what they give is a program."""
    return {c.name for c in system.components} - {c.target.partition(".")[0] for c in system.connections}
