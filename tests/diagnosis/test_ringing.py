"""A machine that rings, recorded once: what it does within a few samples is no noise, and its input has the unit of its output."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.preparation import RINGING, ROWS, prepared
from robomill.diagnosis.inference.adequacy import MISFIT
from robomill.orchestration.runs.importing import write_run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray, PortData
from robomill.orchestration.system.definition import Component, Connection, System
from robomill.orchestration.system.parameters import same_unit_only
from tests.diagnosis.demo import Part, real

STEP = 1e-3
NATURAL = 2.0 * np.pi * 120.0
"""rad/s; 8.3 samples in a period."""
CATALOGUE = """
[[effect]]
name = "damping"
component = "circuit"
description = "it is damped more"
source = "made up"
unit = "1"
minimum = 0.02
maximum = 0.8
sign = "both"
prior = {kind = "normal", scale = 0.2}
locations = [{name = "circuit", parameters = ["damping_error"]}]

[[effect]]
name = "stiffness"
component = "circuit"
description = "it is stiffer"
source = "made up"
unit = "1"
minimum = 0.005
maximum = 0.5
sign = "both"
prior = {kind = "normal", scale = 0.1}
locations = [{name = "circuit", parameters = ["stiffness_error"]}]

[[nuisance]]
component = "circuit"
parameters = ["gain"]
relative = 0.01
source = "made up"
"""


class Circuit(Part):
    """x'' = w^2 (gain u - (1 + s) x - cubic x^3) - 0.06 (1 + d) w x', and an offset in what is shown."""

    def __init__(self, name: str) -> None:
        effects = [real("damping_error", "parameter", "1"), real("stiffness_error", "parameter", "1"), real("cubic", "parameter", "V-2")]
        more = [real("gain", "parameter", "1", 1.0), real("offset", "parameter", "V")]
        super().__init__(name, [real("u", "input", "V"), *effects, *more, real("shown", "output", "V", dependencies=())])
        self.x = self.v = 0.0

    def advance(self, t: float, h: float) -> None:
        p, n = self.p, 4
        a, c = NATURAL**2 * (1.0 + p["stiffness_error"]), 0.06 * NATURAL * (1.0 + p["damping_error"])
        push, bent, d = NATURAL**2 * p["gain"] * self.u[0], NATURAL**2 * p["cubic"], h / n
        for _ in range(n):
            self.v += d * (push - a * self.x - bent * self.x**3 - c * self.v)
            self.x += d * self.v
        self.y[0] = self.x + p["offset"]


SYSTEM = System("circuit", STEP, (Component("drive", "measured"), Component("circuit", "circuit")), (Connection("drive.u", "circuit.u"),))


Change = Callable[[FloatArray], FloatArray]


def recorded(
    folder: Path, truth: Mapping[str, float], samples: int = 2 * ROWS, change: Change | None = None, late: int = 0, size: float = 0.1
) -> Run:
    """A single recording of noise of this size [V] through a low-pass, with noise of 0.3 mV.

    `change`: of the input that is logged; `late`: samples by which the output is.
    """
    random = np.random.default_rng(3)
    u = np.asarray(np.convolve(random.normal(0.0, size, samples + 4), np.full(5, 0.2), "valid"), dtype=np.float64)
    made = Circuit("circuit")
    made.p |= truth
    made.advance(0.0, 0.0)
    shown = [made.y[0]]
    for x in u[1:]:
        made.u[:] = x
        made.advance(0.0, STEP)
        shown.append(made.y[0])
    columns = {"drive.u": u if change is None else change(u), "circuit.shown": np.roll(shown, late) + random.normal(0.0, 3e-4, samples)}
    ports = {name: PortData(name.partition(".")[2], "output", unit="V") for name in columns}
    write_run(folder / f"{size:g}", STEP * np.arange(samples), columns, ports, {"labels": {"condition": f"{size:g} V"}})
    return Run.load(folder / f"{size:g}")


def catalogue(folder: Path) -> Catalogue:
    (folder / "catalogue.toml").write_text(CATALOGUE)
    return Catalogue.load(folder / "catalogue.toml")


def answer(folder: Path, truth: Mapping[str, float], **how: Any) -> dict[str, Any]:
    """The diagnosis of one recording, with a smaller one held out."""
    runs = [recorded(folder, truth, size=size, **how) for size in (0.1, 0.05)]
    return diagnose(SYSTEM, runs[:1], catalogue(folder), held_out=runs[1:], resolver=lambda _, name: Circuit(name)).result


@pytest.mark.slow
def test_nothing_is_wrong(tmp_path: Path) -> None:
    assert answer(tmp_path, {})["verdict"] == "none"


@pytest.mark.slow
def test_an_effect_is_named_with_its_value(tmp_path: Path) -> None:
    found = answer(tmp_path, {"damping_error": -0.25})
    assert found["verdict"] == "identified"
    (damping,) = (w for w in found["which"] if w["effect"] == "damping")
    (estimate,) = damping["parameters"].values()
    low, high = estimate["interval"]
    assert low <= -0.25 <= high


@pytest.mark.slow
def test_a_law_that_is_in_no_catalogue_is_unknown(tmp_path: Path) -> None:
    """A gap of a fifth of the signal, that rings as the signal does."""
    assert answer(tmp_path, {"cubic": 8.0})["verdict"] == "unknown"


@pytest.mark.slow
def test_an_offset_that_is_in_no_catalogue_is_no_mistake_in_units_or_signs(tmp_path: Path) -> None:
    """Input and output are in volt: with both divided by 1000, a thousandth of any gap would be left."""
    found = answer(tmp_path, {"offset": 0.01})
    assert found["verdict"] != "bad_log"


@pytest.mark.slow
def test_an_input_that_is_turned_is_said(tmp_path: Path) -> None:
    """Nobody can say which of one input and one output is turned."""
    found = answer(tmp_path, {}, change=lambda u: -u)
    ((channel, kind),) = {(f["channel"], f["kind"]) for f in found["gate"]["findings"] if f["fatal"]}
    assert channel in ("drive.u", "circuit.shown")
    assert kind == "sign"


@pytest.mark.slow
def test_a_clock_that_is_in_no_catalogue_is_unknown(tmp_path: Path) -> None:
    """Two thirds of the signal are left: that is what regressions on it take for no noise."""
    assert answer(tmp_path, {}, late=1)["verdict"] == "unknown"


@pytest.mark.parametrize(("samples", "factor"), [(ROWS, 1), (2 * ROWS, 1), (2 * RINGING, 2)])
def test_samples_are_no_longer_than_their_means_keep_what_the_machine_does(tmp_path: Path, samples: int, factor: int) -> None:
    """Means over two samples keep 83 % of a ringing of 8.3, too little; beyond RINGING samples they are taken all the same."""
    lost = 1.0 - np.sinc(2.0 * STEP * NATURAL / (2.0 * np.pi)) ** 2
    assert lost > MISFIT
    run = recorded(tmp_path, {}, samples)
    found = prepared(Campaign.of(SYSTEM, [run]), catalogue(tmp_path), lambda _, name: Circuit(name), same_unit_only)
    assert found.laboratory.decimation == factor


def test_a_slow_machine_is_averaged_as_far_as_asked(tmp_path: Path) -> None:
    """What a run of constant input shows is kept by means over any number of samples."""
    run = recorded(tmp_path, {}, 4 * ROWS, change=np.zeros_like)
    found = prepared(Campaign.of(SYSTEM, [run]), catalogue(tmp_path), lambda _, name: Circuit(name), same_unit_only)
    assert found.laboratory.decimation == 4
