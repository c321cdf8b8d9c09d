"""A channel with the wrong sign, on a rotor with dry friction: what comes to rest does not turn round."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from robomill.diagnosis import engine
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.inference.estimation import Fit
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import Component, Connection, System
from tests.diagnosis.demo import Part, changed, real
from tests.diagnosis.formula import candidate

NOISE = 0.01
"""rad/s"""
DRY = """
[[effect]]
name = "coulomb"
component = "rotor"
description = "dry friction of the bearings"
source = "made up"
unit = "N.m"
minimum = 0.001
maximum = 10.0
sign = "positive"
prior = {kind = "log-normal", scale = 0.3, spread = 0.8}
locations = [{name = "bearings", parameters = ["coulomb"]}]
"""


class Motor(Part):
    """A torque from the beginning on; `gain_error` is in no catalogue."""

    def __init__(self, name: str) -> None:
        super().__init__(name, [real("gain_error", "parameter", "1"), real("m", "output", "N.m", dependencies=())])

    def advance(self, t: float, h: float) -> None:
        self.y[0] = 1.0 + self.p["gain_error"]


class Rotor(Part):
    """dw/dt = m - w - coulomb sgn(w), each divided by 1 kg.m2: it stays at rest once it is."""

    def __init__(self, name: str) -> None:
        ports = [real("m", "input", "N.m"), real("coulomb", "parameter", "N.m"), real("w", "output", "rad/s", dependencies=())]
        super().__init__(name, ports)
        self.w = 0.0

    def advance(self, t: float, h: float) -> None:
        self.w += h * (self.u[0] - self.w)
        self.w = math.copysign(max(abs(self.w) - h * self.p["coulomb"], 0.0), self.w)
        self.y[0] = self.w


PARTS = {"motor": Motor, "rotor": Rotor}
SYSTEM = System("rotor", 0.01, tuple(Component(name, name) for name in PARTS), (Connection("motor.m", "rotor.m"),))


def resolve(source: str, name: str) -> Any:
    return PARTS[source](name)


def measure(**truth: dict[str, float]) -> list[Run]:
    """Three noisy runs of 8 s with `truth`, component -> parameter -> value."""
    system = SYSTEM
    for component, values in truth.items():
        system = system.with_parameters(component, values)
    clean, random = run(system, None, stop=8.0, resolver=resolve), np.random.default_rng(1)
    column = "rotor.w"
    noisy = [clean[column] + NOISE * random.standard_normal(len(clean.t)) for _ in range(3)]
    told = [{"labels": {"condition": "on", "repeat": i}} for i in range(len(noisy))]
    ports = {column: clean.ports[column]}
    return [Run(Path(f"run{i}"), clean.t, {column: x}, ports, info) for i, (x, info) in enumerate(zip(noisy, told, strict=True))]


def answer(folder: Path, runs: list[Run]) -> dict[str, Any]:
    (folder / "dry.toml").write_text(DRY)
    return diagnose(SYSTEM, runs, Catalogue.load(folder / "dry.toml"), resolver=resolve).result


def test_no_sign_is_wrong_because_a_slope_goes_on_where_the_machine_rests(tmp_path: Path) -> None:
    """A motor too strong by a fifth: along its slope dry friction would turn the rotor round, which with the other sign is the log."""
    result = answer(tmp_path, measure(motor={"gain_error": 0.2}))
    assert result["gate"]["findings"] == []
    assert result["verdict"] == "unknown"


def test_a_wrong_sign_is_no_dry_friction_whose_slope_turns_the_rotor_round(tmp_path: Path) -> None:
    result = answer(tmp_path, changed(measure(rotor={"coulomb": 0.2}), "rotor.w", lambda t, w: -w))
    assert result["verdict"] == "bad_log"
    assert [(f["kind"], f["channel"]) for f in result["gate"]["findings"]] == [("sign", "rotor.w")]


@pytest.mark.parametrize(
    ("turned", "left", "effects", "alone"),
    [(1.2, 1.46, 1, True), (1.2, 1.1, 1, False), (1.2, 1.1, 3, True), (1.4, 1.1, 3, False), (9.0, 12.0, 3, True)],
)
def test_a_turned_sign_explains_by_itself_what_several_effects_do_together(turned: float, left: float, effects: int, alone: bool) -> None:
    """What is over noise: `turned`, of the log with the other sign by the nominal system, and `left`, by that many effects as it is."""
    evidence = SimpleNamespace(
        residual=lambda groups: np.array([turned]), level=lambda x: float(x[0]), space=SimpleNamespace(y=np.array([left + 5.0]))
    )
    search = cast("Any", SimpleNamespace(evidence=evidence, explainable=lambda x: 0.0))
    model = tuple(candidate(f"part {k}") for k in range(effects))
    assert engine._nominal(search, [], Fit(model, {}, {}, 0.0, 0.0, np.array([5.0]))) is alone


@pytest.mark.parametrize(
    ("believed", "left", "found"),
    [(False, 3.2, True), (False, 3.4, False), (True, 2.0, True), (True, 2.2, False)],
)
def test_how_much_a_turned_sign_may_leave_depends_on_what_explains_the_log_as_it_is(
    believed: bool, left: float, found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The nominal system leaves 41 times noise, a right model LEVEL: of the rest a twentieth may be left, or a fiftieth."""
    as_it_is, turned = cast("Any", SimpleNamespace(leaves=10.0)), cast("Any", SimpleNamespace(leaves=left))
    nominal, best = (Fit(model, {}, {}, 0.0, 0.0) for model in ((), (candidate("part"),)))

    def over_noise(search: Any, fit: Fit) -> float:
        return 41.0 if search is as_it_is and not fit.model else float(search.leaves)

    monkeypatch.setattr(engine, "searched", lambda *_: (turned, [nominal, best]))
    monkeypatch.setattr(engine, "_best", lambda *_: best)
    monkeypatch.setattr(engine, "_simulated", lambda _, fit: fit)
    monkeypatch.setattr(engine, "_little", lambda *_: False)
    monkeypatch.setattr(engine, "_right", lambda search, *_: search is as_it_is and believed)
    monkeypatch.setattr(engine, "_shows", lambda *_: True)
    monkeypatch.setattr(engine, "over_noise", over_noise)
    sign = Finding("rotor.w", "sign", -1.0, "1", "has the wrong sign")
    catalogue = cast("Any", None)
    as_it_is.simulator, as_it_is.evidence = None, SimpleNamespace(whitening=SimpleNamespace(guessed=False))
    assert (engine._explained(catalogue, as_it_is, [nominal, best], [], [], [sign]) is best) is found  # MISFIT, LITTLE
