"""Periodic effects have a phase that no two machines share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robomill.diagnose_command import lines, write
from robomill.diagnosis.candidates import Candidate, CatalogueError, Prior, physical
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import Setting
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.gate.phases import aligned
from robomill.diagnosis.outcome import adopt
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.axis import RIPPLE, catalogue, measure, resolve, system
from tests.diagnosis.demo import WELL
from tests.diagnosis.test_constants import CHANNEL, recorded
from tests.tolerances import ROUNDOFF, physics


@pytest.mark.parametrize("phase", [0.0, 2.0, -1.2])
def test_an_effect_of_any_phase_is_found_with_its_amplitude(tmp_path: Path, phase: float) -> None:
    truth = {"ripple": 0.4, "ripple_phase": phase}
    runs = measure(truth, repeats=3)
    held = measure(truth, repeats=2, size=0.6, seed=2)
    found_in = catalogue(tmp_path, more=RIPPLE)
    found = diagnose(system(), runs, found_in, held_out=held, resolver=resolve)
    assert found.result["verdict"] == "identified"
    (first, *_) = found.result["which"]
    assert (first["effect"], list(first["parameters"])) == ("ripple", ["ripple", "ripple_phase"])
    for name, value in truth.items():
        low, high = first["parameters"][name]["interval"]
        assert low < value < high
    assert first["parameters"]["ripple"]["value"] == pytest.approx(0.4, rel=WELL)
    assert first["parameters"]["ripple_phase"]["unit"] == "rad"
    assert found.result["transfer"]["worth"] > 0.0
    write(found, system(), [*runs, *held], found_in, tmp_path / "answer")
    written = {name: p["value"] for name, p in adopt.read(tmp_path / "answer" / "adopt.ssv")["drive"].items()}
    assert written == pytest.approx(truth, abs=WELL)  # a phase [rad] is known as well as its amplitude, relative
    assert any("ripple_phase" in line for line in lines(found.answer))


def test_parts_make_an_amplitude_and_a_phase() -> None:
    parts = {("a", "x[2] cos p[2]"): 3.0, ("a", "x[2] sin p[2]"): -4.0, ("a", "y"): 1.0, ("b", "z sin w"): 2.0}
    assert physical(parts) == pytest.approx(
        {("a", "y"): 1.0, ("a", "x[2]"): 5.0, ("a", "p[2]"): math.atan2(-4.0, 3.0), ("b", "z"): 2.0, ("b", "w"): 0.5 * math.pi},
        rel=ROUNDOFF,
    )


def test_parts_add_up_to_a_wave_of_their_phase() -> None:
    """What the engine takes for a straight line is one: a cos p + b sin p of a wave."""
    t = np.linspace(0.0, 6.0, 50)
    values = physical({("a", "x cos p"): 0.7, ("a", "x sin p"): -0.2})
    wave = values["a", "x"] * np.sin(t + values["a", "p"])
    assert wave == pytest.approx(0.7 * np.sin(t) - 0.2 * np.cos(t), abs=ROUNDOFF)


def test_a_phase_needs_its_amplitude(tmp_path: Path) -> None:
    file = tmp_path / "catalogue.toml"
    file.write_text(RIPPLE.replace('["ripple"]', '["ripple", "coulomb"]'))
    with pytest.raises(CatalogueError, match=r"phase: 'ripple_phase' needs one parameter of a component beside it, its amplitude"):
        Catalogue.load(file)


def started(phases: list[float], amplitude: float, **more: Any) -> list[Run]:
    """Repeats that each have a phase of their own, as after every start of a spindle."""
    return [
        measure({"ripple": amplitude, "ripple_phase": phase}, repeats=1, seed=10 * k + 100 * more.get("size", 0), **more)[0]
        for k, phase in enumerate(phases)
    ]


PER_RUN = RIPPLE.replace('phase = "ripple_phase"', 'phase = "ripple_phase", per = "run"')


def test_a_phase_that_differs_from_run_to_run_neither_cancels_nor_stops_the_log(tmp_path: Path) -> None:
    runs = started([0.3, 2.1, -1.6, 3.0], 0.4)
    held = started([1.0, -2.5], 0.4, size=2)
    result = diagnose(system(), runs, catalogue(tmp_path, more=PER_RUN), held_out=held, resolver=resolve).result
    assert result["verdict"] == "identified"
    assert [(f["kind"], f["fatal"]) for f in result["gate"]["findings"]] == [("phase", False)]
    assert "ripple, axis" in result["gate"]["findings"][0]["text"]
    amplitude = result["which"][0]["parameters"]["ripple"]
    low, high = amplitude["interval"]
    assert high - low < 0.2 * 0.4  # a tenth up and down
    assert amplitude["value"] == pytest.approx(0.4, abs=0.5 * (high - low) / 1.96)  # a standard deviation: the seed is fixed
    assert result["transfer"]["worth"] > 0.0
    (torque,) = (h for h in result["how_far"] if h["channel"] == "drive.torque" and h["on"] == "held-out condition")
    assert torque["closure"] > 0.95


def test_runs_of_one_phase_are_left_alone(tmp_path: Path) -> None:
    for amplitude in (0.0, 0.4):
        result = diagnose(system(), started([2.0] * 4, amplitude), catalogue(tmp_path, more=PER_RUN), resolver=resolve).result
        assert result["gate"]["findings"] == []
        assert result["verdict"] == ("identified" if amplitude else "none")


def test_only_a_phase_is_of_a_run(tmp_path: Path) -> None:
    file = tmp_path / "catalogue.toml"
    file.write_text(RIPPLE.replace('phase = "ripple_phase"', 'per = "run"'))
    with pytest.raises(CatalogueError, match=r"per: 'run' is for a phase, which is not there; add phase = PARAMETER"):
        Catalogue.load(file)


def test_only_a_phase_of_a_run_has_a_start(tmp_path: Path) -> None:
    file = tmp_path / "catalogue.toml"
    file.write_text(RIPPLE.replace('phase = "ripple_phase"', 'phase = "ripple_phase", start = "begin"'))
    with pytest.raises(CatalogueError, match=r"start: 'begin' is for a phase that differs from run to run; add per = 'run'"):
        Catalogue.load(file)


SPEED = 40.0
"""How fast the spindle below turns [rad/s]."""


def turning(
    phases: Sequence[tuple[float, float]], start: str, missed: float = 0.0, speed: float = SPEED, decimation: int = 1
) -> tuple[FloatArray, FloatArray, list[Finding], int]:
    """Runs of a cutter whose runout shows once and, backwards, twice a turn, beside a step.

    Before, brought, what is said, and of how many steps a sample is the mean then.

    `phases`: of the runout, and of the spindle where the run begins. `missed`: what teeth that miss the chip do to the mean, from the
    third second on; with three teeth it turns three times as fast as the phase, and not with the start.
    """
    t, rng = 0.004 * np.arange(1500), np.random.default_rng(1)
    runout = Candidate(
        "runout",
        "mill",
        "cutter",
        ("runout cos angle", "runout sin angle"),
        0.01,
        9.0,
        Prior("normal", 1.0),
        "m",
        True,
        1,
        phase_per_run=True,
        start=start,
    )

    def signal(real: float, ahead: float, begin: float) -> FloatArray:
        turned, runs_out = speed * t + begin, real + 1j * ahead
        mean = missed * (runs_out**3).real / max(abs(runs_out) ** 2, 1e-9) * (t > 3.0)
        return np.asarray((runs_out * (np.exp(1j * turned) + 0.8 * np.exp(-2j * turned))).real + mean)

    def sampled(_: int, changes: Setting) -> FloatArray:
        known = {parameter: v for (_, parameter), v in changes}
        return signal(known.get("runout cos angle", 0.0), known.get("runout sin angle", 0.0), known.get("begin", 0.0))[:, None]

    runs = [2.0 * signal(np.cos(p), np.sin(p), s) + 0.1 * rng.normal(size=len(t)) + 3.0 * (t > 3.0) for p, s in phases]
    conditions = [Condition("", {}, tuple(recorded(x, t) for x in runs), t)]
    laboratory: Any = SimpleNamespace(
        conditions=conditions, channels=[CHANNEL], sampled=sampled, decimation=decimation, factor=lambda _: decimation
    )
    said = aligned(laboratory, [runout], 1)
    (condition,) = laboratory.conditions
    return np.stack(runs), np.stack([condition.matrix(r, [CHANNEL])[:, 0] for r in condition.runs]), said, laboratory.decimation


SCATTERS = 0.02
"""Standard deviation of 9000 samples of noise: 1 / sqrt(2 x 9000) is 0.007, and six of 1500 numbers of each run are fitted."""
STARTED = [(0.3, 1.0), (2.1, 4.0), (-1.6, 2.2), (3.0, 5.5), (1.1, 0.2), (-2.5, 3.1)]


def test_runs_that_begin_at_any_angle_are_brought_to_one() -> None:
    before, brought, said, _ = turning(STARTED, "begin")
    assert [f.kind for f in said] == ["phase"]
    t = 0.004 * np.arange(before.shape[1])
    there = 2.0 * (np.cos(SPEED * t) + 0.8 * np.cos(2.0 * SPEED * t)) + 3.0 * (t > 3.0)
    assert float(np.std(before - there)) > 15.0 * 0.1
    # the amplitude of six random phases, and what the step does as fast as that
    assert float(np.std(brought - there)) < 3.0 * 0.1
    assert float(np.std(brought - brought.mean(axis=0))) == pytest.approx(0.1 * np.sqrt(5.0 / 6.0), rel=SCATTERS)


def test_without_a_start_two_harmonics_are_not_of_one_phase() -> None:
    _, alone, *_ = turning(STARTED, "")
    assert float(np.std(alone - alone.mean(axis=0))) > 5.0 * 0.1


def test_what_a_phase_does_to_the_mean_stays_in_the_runs() -> None:
    """All runs have the phase 0.5 and other starts: what is brought is the wave, with phase zero; the mean is that of phase 0.5."""
    of_one = [(0.5, s) for _, s in STARTED]
    _, plain, *_ = turning(of_one, "begin")
    _, brought, *_ = turning(of_one, "begin", missed=4.0)
    kept = 2.0 * 4.0 * math.cos(3.0 * 0.5)
    late = 0.004 * np.arange(brought.shape[1]) > 3.0
    assert float((brought - plain)[:, late].mean()) == pytest.approx(kept, abs=physics(2.0 * 4.0, SCATTERS))


@pytest.mark.parametrize(("decimation", "whole"), [(1, 1), (2, 3), (3, 3), (4, 6), (5, 6), (7, 9)])
def test_samples_are_means_over_whole_turns(decimation: int, whole: int) -> None:
    """A turn takes one and a half steps (10 000 rev/min at 4 ms): three steps are two turns. Samples that are no means stay so."""
    assert turning(STARTED, "begin", speed=2.0 * math.pi / (1.5 * 0.004), decimation=decimation)[3] == whole


def test_where_no_samples_hold_whole_turns_they_hold_least_of_a_part() -> None:
    """A turn of 9.5 steps: of up to eight steps eight leave least."""
    assert turning(STARTED, "begin", speed=2.0 * math.pi / (9.5 * 0.004), decimation=4)[3] == 8


def test_runs_that_begin_alike_are_left_alone() -> None:
    before, brought, said, _ = turning(STARTED[:1] * 6, "begin")
    assert said == []
    assert np.array_equal(before, brought)
