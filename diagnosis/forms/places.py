"""Where a form may be: the outputs of a component or its inputs, alone or in the closed loop, and which of these leaves least."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.experiment.component_replay import ComponentReplay
from robomill.diagnosis.experiment.simulation import Laboratory
from robomill.diagnosis.forms.doubts import Doubts
from robomill.diagnosis.forms.layout import Side
from robomill.diagnosis.forms.ports import Problem, behind, direct, doubted, entering, into
from robomill.diagnosis.forms.selection import worse
from robomill.diagnosis.forms.solving import Solved, solve
from robomill.diagnosis.inference.adequacy import UNKNOWN
from robomill.diagnosis.inference.intervals import MATERIAL
from robomill.diagnosis.outcome.closure import BLOCKS
from robomill.models.components.correction import TIME
from robomill.orchestration.slaves.protocol import FloatArray


@dataclass(frozen=True)
class Place:
    """Forms of the outputs of a component, or of its inputs."""

    component: str
    side: Side
    forms: Sequence[Solved]

    @property
    def targets(self) -> set[str]:
        """Measured arrays that they explain."""
        return {array for s in self.forms if s.terms for array in s.problem.targets}

    @property
    def terms(self) -> int:
        """Number of terms."""
        return sum(len(s.terms) for s in self.forms)

    @property
    def approximate(self) -> bool:
        """Whether the closed loop may do otherwise than the columns of the terms say."""
        return any(s.problem.approximate for s in self.forms)

    @property
    def reads_outputs(self) -> bool:
        """Whether a term is of an output of the component."""
        read = [(s.problem.seen.host, f.variable.name) for s in self.forms for _, t in s.terms for f in t.factors]
        return any(name != TIME and not host.is_input(name) for host, name in read)


def _that_say_something(place: Place) -> Place:
    return replace(place, forms=[s for s in place.forms if s.terms])


def best_of(left: Sequence[FloatArray], terms: Sequence[int], gap: float) -> int:
    """Which of several forms is the best: the simplest that does not leave more than the one that leaves least (Breiman et al. 1984).

    The simplest has the fewest `terms`; of equals it is the earliest. More is what is `left` in blocks [blocks] by more than a standard
    error, and by MATERIAL of the `gap` or more.
    """
    least = min(range(len(left)), key=lambda k: float(left[k].sum()))

    def more(k: int) -> bool:
        return worse(left[k], left[least]) and float((left[k] - left[least]).sum()) >= MATERIAL * gap

    return min((k for k in range(len(left)) if not more(k)), key=lambda k: terms[k])


@dataclass
class Places:
    """Forms of the ports of components, as what was measured has it."""

    laboratory: Laboratory
    replays: Sequence[ComponentReplay]
    deviation: Mapping[str, float]
    """Standard deviation of the noise of each channel, of block means [its unit]; where nothing is left, that speaks, too."""
    doubts: Doubts
    arrays: Set[str]
    """Measured arrays that something is to be explained of; empty: all."""

    def alone(self, components: Sequence[str]) -> list[Place]:
        """One place for each component that explains something alone; that which leaves least comes first.

        Inputs are looked at where that is likely to be worth their simulations: of the first component, and of the one whose outputs are
        the best place, where these have several arrays or leave more than noise. And of those with several arrays that this place explains
        as something that goes into them.
        """
        outputs = {name: self._outputs(name) for name in components}
        first = self._best_first(list(outputs.values()))[:1]
        likely = [*components[:1], *(place.component for place in first)]
        behind_it = [array.partition(".")[0] for place in first for array in sorted(place.targets)]
        for name in dict.fromkeys([*likely, *(owner for owner in behind_it if owner in outputs)]):
            if len(outputs[name].targets) > 1 or (name in likely and self._leaves_more_than_noise(outputs[name])):
                inputs = self._place(name, "input", entering(self.laboratory, self.replays, name, self.deviation))
                outputs[name] = (self._best_first([outputs[name], inputs]) or [outputs[name]])[0]
        return [_that_say_something(place) for place in self._best_first(list(outputs.values()))]

    def in_loop(self, components: Sequence[str]) -> list[Place]:
        """Inputs of each component with outputs behind it that are not replayed alone, by the closed loop; the best place first."""
        tried = [self._place(name, "input", into(self.laboratory, self.replays, name)) for name in components]
        return [_that_say_something(place) for place in self._best_first(tried)]

    def closes(self, place: Place) -> float:
        """Squares that a place closes, over those of the noise."""
        inside = [(c, s) for s in place.forms for c in s.left if c in self.deviation]
        return float(sum((s.gap[c] - s.left[c]).sum() / self.deviation[c] ** 2 for c, s in inside))

    def _best_first(self, tried: Sequence[Place]) -> list[Place]:
        """Those that say something, the best one first.

        Nothing is said by terms that close less of the noise's squares than ln n each (Schwarz 1978), with n samples.
        """
        price = np.log(sum(len(r.grid) // self.laboratory.decimation for r in self.replays))
        places = [place for place in tried if place.terms and self.closes(place) > price * place.terms]
        if not places:
            return []
        left = self._left(places)
        gap = max(self.closes(place) + float(x.sum()) for place, x in zip(places, left, strict=True))
        best = best_of(left, [place.terms for place in places], gap)
        return [*places[best : best + 1], *places[:best], *places[best + 1 :]]

    def _outputs(self, name: str) -> Place:
        """The outputs of a component, also those without terms."""
        hidden: dict[tuple[str, ...], Solved] = {}
        for s in self._solved(behind(self.laboratory, self.replays, name)):  # of outputs that are seen in the same channels, one
            other = hidden.setdefault(s.problem.channels, s)
            if s.closure > other.closure:
                hidden[s.problem.channels] = s
        return Place(name, "output", [*self._solved(direct(self.laboratory, self.replays, name)), *hidden.values()])

    def _place(self, name: str, side: Side, problems: Sequence[Problem]) -> Place:
        return Place(name, side, self._solved(problems))

    def _solved(self, problems: Sequence[Problem]) -> list[Solved]:
        return [self._solve(p) for p in problems if not self.arrays or not self.arrays.isdisjoint(p.targets)]

    def _solve(self, problem: Problem) -> Solved:
        solved = solve(doubted(problem, self.replays, self.doubts, self.deviation))
        return self._solve(problem.of(solved.terms)) if problem.simulated is not None and solved.terms else solved

    def _leaves_more_than_noise(self, place: Place) -> bool:
        left = {c: float(x.sum()) for s in place.forms for c, x in s.left.items() if c in self.deviation}
        rows = sum(len(r.grid) // self.laboratory.decimation / len(r.measured) for r in self.replays)
        return bool(sum(x / self.deviation[c] ** 2 for c, x in left.items()) > UNKNOWN * rows * len(left))

    def _left(self, places: Sequence[Place]) -> list[FloatArray]:
        """Squares that each place leaves in all channels that any explains, over those of the noise, [conditions * BLOCKS]."""
        gap = {c: x for p in places for s in p.forms for c, x in s.gap.items() if c in self.deviation}
        of = [{c: x for s in p.forms for c, x in s.left.items()} for p in places]
        none = np.zeros(BLOCKS * len(self.replays))
        return [np.sum([none, *(left.get(c, x) / self.deviation[c] ** 2 for c, x in gap.items())], axis=0) for left in of]
