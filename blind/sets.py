"""What is in a benchmark: the sets, and the plan of each case before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from robomill.blind import bad_logs, outside
from robomill.blind.effects import BY_KEY, EVEN

GENERATOR_VERSION = 8
"""Version of the generator: numbers change only with it."""
PROPORTIONS: Mapping[str, float] = {"null": 0.20, "single": 0.38, "double": 0.15, "triple": 0.04, "outside": 0.15, "bad_log": 0.08}
"""Share of the cases of each kind in the set `mixed`, as DIAGNOSIS.md has them."""
REPEATS, NULL_REPEATS, FEW_REPEATS = 6, (1, 2, 3, 6), (1, 2, 3)
"""Runs of each diagnosed condition; those of the sets `null` and `few`, in turn."""
CAMPAIGN_REPEATS = 3
"""Runs of each condition of a campaign."""
ALTERNATING = ("cuts", "loads")
"""Shapes of the sets with effects, in turn."""
GENERATORS = ("first", "second", "both")
STIFF_JOINTS = (1, 2, 3)
"""Joints whose stiffness a campaign is to find."""
MACHINE_SIZES = (4, 8)
"""Effects at once in the set `machine`, from and to."""


@dataclass(frozen=True)
class Plan:
    """What a case is about."""

    number: int
    kind: str
    subject: tuple[str, ...] = ()
    """Keys of effects, with their element (`compliance.stiffness_error[2]`) where it is not drawn, or `logging.lag`; name of the outside
    kind, or of the fault of the log."""
    repeats: int = REPEATS
    """Runs of each diagnosed condition."""
    shape: str = "cuts"
    """One of `conditions.SHAPES`."""
    generator: str = "first"


Cases = list[Plan]
_Maker = Callable[[int, np.random.Generator], list[tuple[str, tuple[str, ...]]]]
"""(number of cases, random) -> kind and subject of each."""


class _Deck:
    """Cards dealt in random order, shuffled anew when they are used up."""

    def __init__(self, cards: Sequence[str], random: np.random.Generator) -> None:
        self._cards, self._random, self._left = list(cards), random, list[str]()

    def next(self) -> str:
        if not self._left:
            self._left = [self._cards[i] for i in self._random.permutation(len(self._cards))]
        return self._left.pop()

    def deal(self, count: int) -> list[tuple[str, ...]]:
        return [(self.next(),) for _ in range(count)]


def _of_a_kind(kind: str, cards: Sequence[str]) -> _Maker:
    """A set of one kind of cases, whose subjects come in turn."""
    return lambda n, random: [(kind, subject) for subject in _Deck(cards, random).deal(n)]


def _mixed(n: int, random: np.random.Generator) -> list[tuple[str, tuple[str, ...]]]:
    """All kinds in their proportions."""
    exact = {kind: share * n for kind, share in PROPORTIONS.items()}
    counts = {kind: int(value) for kind, value in exact.items()}
    for kind in sorted(exact, key=lambda k: counts[k] - exact[k])[: n - sum(counts.values())]:
        counts[kind] += 1
    found: list[tuple[str, tuple[str, ...]]] = [("null", ())] * counts["null"]
    found += [("single", s) for s in _Deck([*BY_KEY], random).deal(counts["single"])]
    for kind, size in (("double", 2), ("triple", 3)):
        found += [(kind, tuple(str(k) for k in random.choice([*BY_KEY], size, replace=False))) for _ in range(counts[kind])]
    found += [("outside", s) for s in _Deck([*outside.OUTSIDE_BY_NAME], random).deal(counts["outside"])]
    return found + [("bad_log", s) for s in _Deck([*bad_logs.LOG_FAULTS], random).deal(counts["bad_log"])]


def machine_effects(random: np.random.Generator) -> tuple[str, ...]:
    """Four to eight effects as a real robot has them: two joints softer or stiffer, friction in two or more, and wear of what turns."""
    joints = [int(i) + 1 for i in random.permutation(6)]
    kinds = ["drive.friction_coulomb" if random.random() < EVEN else "drive.friction_viscous" for _ in joints]
    friction = [f"{kind}[{joint}]" for kind, joint in zip(kinds, joints, strict=True)]
    stiff = [f"compliance.stiffness_error[{i}]" for i in random.choice(STIFF_JOINTS, 2, replace=False)]
    others = [*friction[2:4], "milling.runout", "milling.tool_wear", "logging.lag"]
    count = int(random.integers(MACHINE_SIZES[0], MACHINE_SIZES[1] + 1)) - 4
    return (*stiff, *friction[:2], *(str(k) for k in random.permutation(others)[:count]))


def _machines(n: int, random: np.random.Generator) -> list[tuple[str, tuple[str, ...]]]:
    return [("machine", machine_effects(random)) for _ in range(n)]


SETS: Mapping[str, _Maker] = {
    "withheld": _of_a_kind("withheld", [*BY_KEY]),
    "null": lambda n, random: [("null", ())] * n,
    "single": _of_a_kind("single", [*BY_KEY]),
    "machine": _machines,
    "few": _of_a_kind("single", [*BY_KEY]),
    "campaign": _of_a_kind("single", [f"compliance.stiffness_error[{i}]" for i in STIFF_JOINTS]),
    "bad_log": _of_a_kind("bad_log", [*bad_logs.LOG_FAULTS]),
    "outside": _of_a_kind("outside", [*outside.OUTSIDE_BY_NAME]),
    "mixed": _mixed,
    "formed": _of_a_kind("formed", [*outside.FORMED_BY_NAME]),
}
"""In the order of the page of results."""
_SHAPES: Mapping[str, Sequence[str]] = {"campaign": ("campaign",), **dict.fromkeys(("withheld", "null", "single", "machine"), ALTERNATING)}
_REPEATS: Mapping[str, Sequence[int]] = {"null": NULL_REPEATS, "few": FEW_REPEATS, "campaign": (CAMPAIGN_REPEATS,)}


def plans(name: str, cases: int, seed: int, generator: str = "first") -> Cases:
    """The cases of a set in random order, so that their numbers say nothing. Repeats, shapes and generators are as often as each other.

    ValueError: an unknown set or generator, or no cases.
    """
    if cases < 1:
        raise ValueError(f"--cases {cases}: expected at least 1")
    if name not in SETS:
        raise ValueError(f"--set {name}: expected one of {', '.join(SETS)}")
    if generator not in GENERATORS:
        raise ValueError(f"--generator {generator}: expected one of {', '.join(GENERATORS)}")
    random = np.random.default_rng([GENERATOR_VERSION, seed, list(SETS).index(name)])
    subjects = SETS[name](cases, random)
    shapes, repeats = _SHAPES.get(name, ("cuts",)), _REPEATS.get(name, (REPEATS,))
    order = [int(j) for j in random.permutation(cases)]
    makers = GENERATORS[:2] if generator == "both" else (generator,)
    # one after the other in mixed radix: every combination comes, however many there are of each
    turns = ((shape, repeat, maker) for _ in order for repeat in repeats for shape in shapes for maker in makers)
    found = []
    for i, (j, (shape, repeat, maker)) in enumerate(zip(order, islice(turns, cases), strict=True)):
        found.append(Plan(i + 1, *subjects[j], repeat, shape, maker))
    return found
