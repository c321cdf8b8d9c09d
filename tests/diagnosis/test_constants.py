"""Constants: each name means one thing; what lies just beyond one of gate, noise and phases is found, and would not be if it were twice as
large.
"""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.catalogue import COS, SIN, Candidate, Prior
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import Setting
from robomill.diagnosis.gate import checks as gate
from robomill.diagnosis.gate import phases
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.inference import search
from robomill.diagnosis.inference.noise import fast, own_noise
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import measure

STEP = 0.01
CHANNEL = "sensors.y[1]"
T = STEP * np.arange(1000)
QUIET = np.array([1e-6])
ROOT = Path(__file__).parent.parent.parent
SHARED = {"LOGGING"}
"""What the benchmark has, too, with the meaning that it has in the diagnosis: one must not know the other."""


def test_the_name_of_a_constant_means_one_thing_in_diagnosis_and_benchmark() -> None:
    places: dict[str, list[str]] = {}
    for path in sorted([*(ROOT / "diagnosis").rglob("*.py"), *(ROOT / "blind").rglob("*.py")]):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
            for name in {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name) and n.id.isupper()}:
                places.setdefault(name, []).append(str(path.relative_to(ROOT)))
    assert len(places) > 100
    assert {name: files for name, files in places.items() if len(files) > 1 and name not in SHARED} == {}


def recorded(x: FloatArray, t: FloatArray = T) -> Run:
    one = measure(repeats=1, seconds=STEP)[0]
    return replace(one, t=t, columns={CHANNEL: x}, ports={CHANNEL: one.ports[CHANNEL]})


def without(rows: int, of: int) -> list[tuple[str, bool]]:
    """What the gate says of a gap of so many steps in the middle of a run."""
    t = STEP * np.arange(of)
    t = np.delete(t, np.arange(of // 2, of // 2 + rows - 1))
    return [(f.kind, f.fatal) for f in gate.raw(recorded(np.sin(t), t), [CHANNEL], {}, STEP)]


class TestGate:
    def test_a_gap_is_noted_and_a_long_one_or_a_large_part_of_a_run_stops_the_log(self) -> None:
        assert without(11, of=10000) == []
        assert without(20, of=10000) == [("time", False)]  # BREAK
        assert without(100, of=10000) == [("time", True)]  # LONG_BREAK
        assert without(40, of=1000) == [("time", False)]
        assert without(58, of=1000) == [("time", True)]  # PART

    @pytest.mark.parametrize(("part", "kinds"), [(0.07, []), (0.15, ["constant"])])
    def test_a_channel_that_stands_still_for_a_part_of_a_run(self, part: float, kinds: list[str]) -> None:
        s = np.sin(T)
        n = int(part * len(T))
        x = s.copy()
        x[250 : 250 + n] = x[250]
        found = gate.standstill(recorded(x), x[:, None], s[:, None], [CHANNEL], STEP, QUIET)
        assert [f.kind for f in found] == kinds  # REST


class TestNoise:
    def test_the_motion_of_40_samples_is_slow_and_that_of_5_is_not(self) -> None:
        """FAST: a mean over twice as many samples would take a tenth of the slow one for noise."""
        n = np.arange(4000)
        share = [float(np.std(fast(np.sin(2.0 * np.pi * n / period)[:, None]))) * np.sqrt(2.0) for period in (40, 5)]
        assert share[0] < 0.05
        assert share[1] > 1.0

    def test_noise_is_guessed_five_times_at_most(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """GUESSES: where the best model is another one each time."""
        made: list[int] = []

        class Restless:
            def __init__(self, *_: Any) -> None:
                made.append(len(made))
                self.evidence = SimpleNamespace(whitening=SimpleNamespace(guessed=True))

            def run(self) -> list[Any]:
                return [SimpleNamespace(model=(len(made),), values={}, log_evidence=0.0)]

        monkeypatch.setattr(search, "Search", Restless)
        simulator: Any = SimpleNamespace(repeated=lambda *_: [[np.zeros((3, 1))]])
        search.searched(SimpleNamespace(), simulator, [[np.zeros((3, 1))]], [])  # type: ignore[arg-type]  # a Search that asks for nothing
        assert len(made) == 5

    def test_a_spell_that_scatters_more_than_chance_lets_it_is_noise_of_its_own(self) -> None:
        """RARE: three times the variance of white noise is, twice is not."""
        for size, more in ((1.3, False), (2.0, True)):
            rng = np.random.default_rng(3)
            runs = [rng.normal(size=1000) for _ in range(40)]
            for k, x in enumerate(runs):
                x[500:625] += (-1) ** k * size / np.sqrt(125)  # variance of the spell: 1 + size^2
            boxes = own_noise([runs], 1, 125)
            assert bool(np.any(np.count_nonzero(boxes, axis=0) == 125)) is more


class TestPhases:
    """An effect whose phase differs, in a laboratory that only adds waves."""

    WAVES = (np.sin(7.0 * T), np.cos(7.0 * T))
    RIPPLE = Candidate(
        "ripple",
        "drive",
        "axis",
        (f"ripple{COS}phase", f"ripple{SIN}phase"),
        minimum=0.01,
        maximum=5.0,
        prior=Prior("normal", 1.0),
        unit="N.m",
        both_signs=True,
        locations=1,
        phase_per_run=True,
    )

    def looked_at(self, amplitude: float) -> tuple[list[Finding], int]:
        """What is said of four runs, and how many simulations that took."""
        rng = np.random.default_rng(1)
        runs = [amplitude * np.sin(7.0 * T + phase) + 0.1 * rng.normal(size=len(T)) for phase in (0.3, 2.1, -1.6, 3.0)]
        asked = []

        def sampled(_: int, changes: Setting) -> FloatArray:
            asked.append(changes)
            waves = dict(zip(self.RIPPLE.addresses, self.WAVES, strict=True))
            return np.asarray(sum((v * waves[a] for a, v in changes), np.zeros(len(T))))[:, None]

        laboratory: Any = SimpleNamespace(
            conditions=[Condition("", {}, tuple(map(recorded, runs)), T)], channels=[CHANNEL], sampled=sampled
        )
        return phases.aligned(laboratory, [self.RIPPLE], 1), len(asked)

    def test_phases_differ_by_clear_evidence(self) -> None:
        """DIFFERENT_PHASES: evidence of 8 nats is too little, evidence of 18 is not."""
        assert self.looked_at(0.06)[0] == []
        ((found,), _) = self.looked_at(0.065)
        assert 12.0 < found.value < 24.0

    def test_the_amplitude_takes_three_simulations_of_each_part(self) -> None:
        """PHASE_ROUNDS, and the nominal one."""
        assert self.looked_at(1.0)[1] == 1 + 3 * 2
