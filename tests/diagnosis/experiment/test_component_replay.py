"""What adds up what goes in is not replayed alone: by its order of growth, on a carriage that a controller pushes with a force."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.component_replay import ADDS_UP, ComponentReplay, order_of_growth
from robomill.diagnosis.experiment.preparation import prepared
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from robomill.orchestration.system.definition import Component, Connection, System
from robomill.orchestration.system.parameters import same_unit_only
from tests.diagnosis.demo import Part, real

STEP, SECONDS, NOISE = 0.01, 6.0, 1e-4
OF_THE_MEAN = 0.05
"""Relative: norms over a quarter of a run are not the powers of its mean time; of t^2 that makes the order 1.904, of t 0.982."""
CATALOGUE = """
[[effect]]
name = "friction"
component = "carriage"
description = "dry friction"
source = "made up"
unit = "N"
minimum = 0.01
maximum = 5.0
sign = "positive"
prior = {kind = "log-normal", scale = 0.5, spread = 0.8}
locations = [{name = "carriage", parameters = ["friction"]}]

[[effect]]
name = "gain"
component = "scale"
description = "the scale shows too much"
source = "made up"
unit = "1"
minimum = 0.002
maximum = 0.5
sign = "both"
prior = {kind = "normal", scale = 0.05}
locations = [{name = "scale", parameters = ["gain_error"]}]
"""
WITHOUT_FRICTION = CATALOGUE.partition('[[effect]]\nname = "gain"')[1] + CATALOGUE.partition('[[effect]]\nname = "gain"')[2]


class Plan(Part):
    def __init__(self, name: str) -> None:
        super().__init__(name, [real("x", "output", "m", dependencies=())])

    def advance(self, t: float, h: float) -> None:
        self.y[0] = 0.2 * (1.0 - math.cos(2.0 * t)) + 0.1 * math.sin(0.7 * t) ** 2


class Controller(Part):
    """A PD controller; a PI-D one with an integral."""

    def __init__(self, name: str) -> None:
        parameters = [real("integral", "parameter", "1/s")]
        super().__init__(name, [real("wanted", "input", "m"), real("x", "input", "m"), *parameters, real("f", "output", "N")])
        self.sum = self.before = 0.0

    def advance(self, t: float, h: float) -> None:
        error = self.u[0] - self.u[1]
        self.sum += self.p["integral"] * error * h
        rate = (error - self.before) / h if h else 0.0
        self.y[0] = 100.0 * (error + self.sum) + 14.0 * rate
        self.before = error


class Carriage(Part):
    """A mass of 1 kg that nothing holds but the controller."""

    def __init__(self, name: str) -> None:
        super().__init__(name, [real("f", "input", "N"), real("friction", "parameter", "N"), real("x", "output", "m", dependencies=())])
        self.x = self.v = 0.0

    def advance(self, t: float, h: float) -> None:
        for _ in range(5 if h else 0):
            self.v += h / 5 * (self.u[0] - self.p["friction"] * math.tanh(self.v / 1e-2))
            self.x += h / 5 * self.v
        self.y[0] = self.x


class Scale(Part):
    """Shows where the carriage is, with a lag of 50 ms: it forgets."""

    def __init__(self, name: str) -> None:
        super().__init__(name, [real("x", "input", "m"), real("gain_error", "parameter", "1"), real("shown", "output", "m")])
        self.x = 0.0

    def advance(self, t: float, h: float) -> None:
        self.x += (1.0 - math.exp(-h / 0.05)) * (self.u[0] - self.x)
        self.y[0] = self.x * (1.0 + self.p["gain_error"])


PARTS = {"plan": Plan, "controller": Controller, "carriage": Carriage, "scale": Scale}
SYSTEM = System(
    "carriage",
    STEP,
    tuple(Component(name, name) for name in PARTS),
    (
        Connection("plan.x", "controller.wanted"),
        Connection("carriage.x", "controller.x", delayed=True),
        Connection("controller.f", "carriage.f"),
        Connection("carriage.x", "scale.x"),
    ),
)


def resolve(source: str, name: str) -> Any:
    return PARTS[source](name)


def measure(system: System, *, friction: float = 0.0, repeats: int = 3) -> list[Run]:
    """Runs in which force, carriage and scale are recorded, with noise."""
    clean = run(system.with_parameters("carriage", {"friction": friction}), None, stop=SECONDS, resolver=resolve)
    rng, made = np.random.default_rng(1), []
    for repeat in range(repeats):
        columns = {
            c: clean[c] + NOISE * size * rng.normal(size=len(clean.t))
            for c, size in (("controller.f", 50.0), ("carriage.x", 1.0), ("scale.shown", 1.0))
        }
        made.append(Run(Path(f"run{repeat}"), clean.t, columns, {c: clean.ports[c] for c in columns}, {"labels": {"repeat": repeat}}))
    return made


def catalogue(folder: Path, text: str = CATALOGUE) -> Catalogue:
    (folder / "catalogue.toml").write_text(text)
    return Catalogue.load(folder / "catalogue.toml")


def adding(folder: Path, system: System) -> dict[str, float]:
    """Orders of growth of what is not replayed."""
    start = prepared(Campaign.of(system, measure(system)), catalogue(folder), resolve, same_unit_only)
    return ComponentReplay.of(start.laboratory, 0).adding


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0])
def test_the_order_is_the_exponent_of_a_response_that_grows(order: float) -> None:
    t = np.linspace(0.0, 1.0, 4001)[:, None]
    late = np.where(t > 0.5, np.maximum(t - 0.5, 0.0) ** order, 0.0)
    assert order_of_growth(t**order, late) == pytest.approx(order, rel=OF_THE_MEAN)


def test_what_settles_has_order_zero_and_what_does_nothing_too() -> None:
    t = np.linspace(0.0, 1.0, 4001)[:, None]

    def lag(since: float) -> FloatArray:
        return np.where(t > since, 1.0 - np.exp(-(t - since) / 0.02), 0.0)

    assert order_of_growth(lag(0.0), lag(0.5)) < 0.1 * ADDS_UP
    assert order_of_growth(0.0 * t, 0.0 * t) == 0.0
    assert order_of_growth(t, 0.0 * t) == math.inf


def test_the_time_constant_from_which_a_lag_counts_as_an_integrator_is_half_of_a_run() -> None:
    """Doubling ADDS_UP would let all lags pass, and integrators too; a half of it would stop lags of a third of a run."""
    t = np.linspace(0.0, 1.0, 4001)[:, None]

    def order(constant: float) -> float:
        return order_of_growth(1.0 - np.exp(-t / constant), np.where(t > 0.5, 1.0 - np.exp(-(t - 0.5) / constant), 0.0))

    assert order(0.4) < ADDS_UP < order(0.6)
    assert order(0.33) > 0.5 * ADDS_UP
    assert order(100.0) < 2.0 * ADDS_UP


def test_a_mass_that_nothing_holds_is_not_replayed_but_its_controller_and_its_scale_are(tmp_path: Path) -> None:
    (array, order), *others = adding(tmp_path, SYSTEM).items()
    assert (array, others) == ("carriage.x", [])
    assert 1.5 < order < 2.0  # two integrators, nearer to two than to one


def test_an_integral_in_the_controller_adds_up_too(tmp_path: Path) -> None:
    assert list(adding(tmp_path, SYSTEM.with_parameters("controller", {"integral": 2.0}))) == ["controller.f", "carriage.x"]


def test_the_answer_says_what_was_not_replayed_and_blames_nobody_for_it(tmp_path: Path) -> None:
    """Friction that is in no catalogue: replayed alone, the carriage would be a metre off in the end."""
    result = diagnose(SYSTEM, measure(SYSTEM, friction=0.4), catalogue(tmp_path, WITHOUT_FRICTION), resolver=resolve).result
    assert result["verdict"] == "unknown"
    assert result["not_replayed"].startswith("not replayed alone: carriage.x: driven with measured inputs, small errors add up there")
    assert [r["output"] for r in result["replay"]] == ["scale.shown"]
    assert not any(w["component"] in ("controller", "scale") for w in result["where"])


def test_a_condition_is_replayed_once_for_all_who_ask(tmp_path: Path) -> None:
    """Where the gap is and what form it has are asked of the same replays, as long as the measured runs are the same."""
    laboratory = prepared(Campaign.of(SYSTEM, measure(SYSTEM)), catalogue(tmp_path), resolve, same_unit_only).laboratory
    first = ComponentReplay.of(laboratory, 0)
    assert ComponentReplay.of(laboratory.shown_in([0]), 0) is first
    laboratory.conditions = [replace(c) for c in laboratory.conditions]
    assert ComponentReplay.of(laboratory, 0) is not first
