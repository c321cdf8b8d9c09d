"""A carriage in a closed loop whose position adds up its force, and is measured behind another component: where its form is, and what."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import Component, Connection, System
from tests.diagnosis.demo import WELL, Part, real

STEP, SECONDS, MASS, GAINS = 0.004, 4.0, 10.0, (4000.0, 300.0)
COULOMB, NOISE = 3.0, {"encoder.shown": 2e-7, "controller.force": 1e-3}
"""N; m and N"""
CATALOGUE = """
[[effect]]
name = "viscous"
component = "carriage"
description = "oil"
source = "made up"
unit = "N.s/m"
minimum = 0.5
maximum = 500.0
sign = "positive"
prior = {kind = "log-normal", scale = 20.0, spread = 0.8}
locations = [{name = "guide", parameters = ["viscous"]}]

[[nuisance]]
component = "carriage"
parameters = ["mass"]
relative = 0.001
source = "made up"
"""


class Program(Part):
    """A motion that reverses."""

    def __init__(self, name: str) -> None:
        super().__init__(name, [real("wanted", "output", "m", dependencies=())])

    def advance(self, t: float, h: float) -> None:
        self.y[0] = 0.1 * math.sin(2.0 * t) + 0.03 * math.sin(5.3 * t)


class Carriage(Part):
    """A mass with friction that is pushed."""

    def __init__(self, name: str) -> None:
        numbers = [real("mass", "parameter", "kg", MASS), real("viscous", "parameter", "N.s/m"), real("coulomb", "parameter", "N")]
        super().__init__(name, [real("force", "input", "N"), *numbers, real("q", "output", "m", dependencies=())])
        self.v = 0.0

    def advance(self, t: float, h: float) -> None:
        for _ in range(20):
            rubbing = self.p["viscous"] * self.v + self.p["coulomb"] * math.tanh(self.v / 1e-3)
            self.v += (float(self.u[0]) - rubbing) / self.p["mass"] * h / 20
            self.y[0] += self.v * h / 20


class Encoder(Part):
    """Shows the position."""

    def __init__(self, name: str) -> None:
        super().__init__(name, [real("q", "input", "m"), real("shown", "output", "m", dependencies=("q",))])

    def advance(self, t: float, h: float) -> None:
        self.y[0] = self.u[0]


class Controller(Part):
    """Force by the error and its rate."""

    def __init__(self, name: str) -> None:
        inputs = [real("wanted", "input", "m"), real("shown", "input", "m")]
        super().__init__(name, [*inputs, real("force", "output", "N", dependencies=("wanted", "shown"))])
        self.before = 0.0

    def advance(self, t: float, h: float) -> None:
        error = float(self.u[0] - self.u[1])
        rate = (error - self.before) / h if h else 0.0
        self.y[0], self.before = GAINS[0] * error + GAINS[1] * rate, error


PARTS = {c.__name__.lower(): c for c in (Program, Carriage, Encoder, Controller)}
SYSTEM = System(
    "carriage",
    STEP,
    tuple(Component(name, name) for name in PARTS),
    (
        Connection("carriage.q", "encoder.q"),
        Connection("program.wanted", "controller.wanted"),
        Connection("encoder.shown", "controller.shown"),
        Connection("controller.force", "carriage.force", delayed=True),
    ),
)


def resolve(source: str, name: str) -> Any:
    return PARTS[source](name)


def measure(repeats: int) -> Sequence[Run]:
    """The carriage with dry friction."""
    clean = run(SYSTEM.with_parameters("carriage", {"coulomb": COULOMB}), None, stop=SECONDS, resolver=resolve)
    rng = np.random.default_rng(1)
    made = []
    for repeat in range(repeats):
        columns = {c: clean[c] + size * rng.normal(size=len(clean.t)) for c, size in NOISE.items()}
        made.append(Run(Path(f"run{repeat}"), clean.t, columns, {c: clean.ports[c] for c in NOISE}, {"labels": {"repeat": repeat}}))
    return made


def test_friction_that_no_entry_expresses_is_a_force_of_the_carriage_and_none_of_the_controller(tmp_path: Path) -> None:
    (tmp_path / "catalogue.toml").write_text(CATALOGUE)
    found = diagnose(SYSTEM, measure(3), Catalogue.load(tmp_path / "catalogue.toml"), resolver=resolve).answer
    assert found.verdict == "unknown"
    assert found.form is not None
    (port,) = found.form.ports
    assert port.port == "carriage.force"
    (dry,) = [t for t in port.terms if "sgn" in t.term and "d(q)/dt" in t.term]
    assert dry.coefficient == pytest.approx(-COULOMB, rel=5.0 * WELL)
    assert all(h.closure > 0.9 for h in found.form.how_far)
