"""A system of scalar outputs: one driven axis with a motor torque and an encoder on the link, at any pace; and its catalogue."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robomill.diagnosis.catalogue import Catalogue
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import Component, Connection, System
from tests.diagnosis.demo import Part, real

NOISE = {"drive.torque": 0.05, "drive.angle": 2e-5}
"""N.m, rad"""
OFFSET = """
[[effect]]
name = "encoder_offset"
component = "drive"
description = "zero of the encoder on the link"
source = "made up"
unit = "rad"
minimum = 1e-5
maximum = 0.1
sign = "both"
prior = {kind = "normal", scale = 1e-3}
locations = [{name = "axis", parameters = ["angle_offset"]}]
"""
DEAD_TIME = OFFSET.replace("encoder_offset", "dead_time").replace("angle_offset", "dead_time").replace('"rad"', '"s"')
"""One that does to the encoder what a late clock does to its log."""
RIPPLE = """
[[effect]]
name = "ripple"
component = "drive"
description = "torque that goes with the angle"
source = "made up"
unit = "N.m"
minimum = 0.01
maximum = 5.0
sign = "positive"
prior = {kind = "log-normal", scale = 0.3, spread = 0.8}
locations = [{name = "axis", parameters = ["ripple"], phase = "ripple_phase"}]
"""
_EFFECT = """
[[effect]]
name = "{name}"
component = "{component}"
description = "{name} of the axis"
source = "made up"
unit = "{unit}"
minimum = {minimum}
maximum = {maximum}
sign = "{sign}"
prior = {{kind = "normal", scale = {scale}}}
locations = [{{name = "axis", parameters = ["{parameter}"]}}]
"""
_ENTRIES: tuple[dict[str, Any], ...] = (
    {"name": "coulomb", "component": "drive", "unit": "N.m", "parameter": "coulomb", "minimum": 0.01, "maximum": 20.0, "scale": 1.0},
    {"name": "viscous", "component": "drive", "unit": "N.m.s/rad", "parameter": "viscous", "minimum": 0.01, "maximum": 20.0, "scale": 1.0},
    {"name": "inertia", "component": "drive", "unit": "kg.m2", "parameter": "inertia_error", "minimum": 0.01, "maximum": 2.0, "scale": 0.3},
    {"name": "clock", "component": "logging", "unit": "s", "parameter": "lag drive.angle", "minimum": 2e-4, "maximum": 0.1, "scale": 0.01},
)


class Program(Part):
    """A motion that reverses: angle, speed, acceleration; `pace` times as fast as in 2 s."""

    def __init__(self, name: str) -> None:
        outputs = [real(n, "output", u, dependencies=()) for n, u in (("q", "rad"), ("v", "rad/s"), ("a", "rad/s2"))]
        super().__init__(name, [real("pace", "parameter", "1", 1.0), real("size", "parameter", "1", 1.0), *outputs])

    def advance(self, t: float, h: float) -> None:
        size = self.p["size"]
        w = [2.0 * math.pi * f * self.p["pace"] for f in (0.5, 1.3)]
        self.y[0] = size * sum(0.3 * math.sin(x * t) for x in w)
        self.y[1] = size * sum(0.3 * x * math.cos(x * t) for x in w)
        self.y[2] = size * sum(-0.3 * x * x * math.sin(x * t) for x in w)


class Drive(Part):
    """Torque of the motor and angle of the link, both scalar."""

    def __init__(self, name: str) -> None:
        names = (
            ("coulomb", "N.m"),
            ("viscous", "N.m.s/rad"),
            ("inertia_error", "kg.m2"),
            ("breakaway", "N.m"),
            ("angle_offset", "rad"),
            ("dead_time", "s"),
            ("ripple", "N.m"),
            ("ripple_phase", "rad"),
        )
        inputs = [real(n, "input", u) for n, u in (("q", "rad"), ("v", "rad/s"), ("a", "rad/s2"))]
        outputs = [
            real("torque", "output", "N.m", dependencies=("v", "a"), description="torque of the motor"),
            real("angle", "output", "rad", dependencies=("q",)),
        ]
        super().__init__(name, [*inputs, *(real(n, "parameter", u) for n, u in names), *outputs])
        self.seen: list[tuple[float, float]] = []

    def advance(self, t: float, h: float) -> None:
        p, (q, v, a) = self.p, self.u
        self.seen = [*self.seen[-200:], (t, q)]
        rubbing = p["coulomb"] + p["breakaway"] * math.exp(-((v / 0.3) ** 2))
        self.y[0] = (
            (1.0 + p["inertia_error"]) * a
            + p["viscous"] * v
            + rubbing * math.tanh(v / 0.02)
            + p["ripple"] * math.sin(20.0 * q + p["ripple_phase"])
        )
        shown = float(np.interp(t - p["dead_time"], *zip(*self.seen, strict=True))) if p["dead_time"] else q
        self.y[1] = shown + p["angle_offset"]


PARTS = {"program": Program, "drive": Drive}


def system(step: float = 0.004, pace: float = 1.0) -> System:
    """The axis at a communication step [s]."""
    parts = (Component("program", "program", parameters={"pace": pace}), Component("drive", "drive"))
    return System("axis", step, parts, tuple(Connection(f"program.{n}", f"drive.{n}") for n in "qva"))


def resolve(source: str, name: str) -> Any:
    return PARTS[source](name)


def catalogue(folder: Path, *, lag: str = "drive.angle", pace: float = 1.0, more: str = "") -> Catalogue:
    """Friction, inertia and a clock; `pace` makes what is a time as much shorter."""
    text = ""
    for entry in _ENTRIES:
        time = 1.0 / pace if entry["name"] == "clock" else 1.0
        sized = {k: entry[k] * time for k in ("minimum", "maximum", "scale")}
        text += _EFFECT.format(**{**entry, **sized, "sign": "both"}).replace("drive.angle", lag)
    (folder / "axis.toml").write_text(text + more)
    return Catalogue.load(folder / "axis.toml")


def measure(
    truth: Mapping[str, float] | None = None,
    *,
    step: float = 0.004,
    pace: float = 1.0,
    seconds: float = 4.0,
    repeats: int = 1,
    size: float = 1.0,
    seed: int = 1,
    late: float = 0.0,
    columns: Sequence[str] = ("drive.torque", "drive.angle"),
    **labels: Any,
) -> list[Run]:
    """Noisy runs of the axis with `truth` (parameter of the drive -> value); the link's encoder is `late` [s]."""
    machine = system(step, pace).with_parameters("program", {"size": size}).with_parameters("drive", dict(truth or {}))
    clean = run(machine, None, stop=seconds, resolver=resolve)
    rng, made = np.random.default_rng(seed), []
    for repeat in range(repeats):
        made.append(
            Run(
                Path(f"run{repeat}"),
                clean.t,
                {c: _late(clean.t, clean[c], late * (c == "drive.angle")) + NOISE[c] * rng.normal(size=len(clean.t)) for c in columns},
                {c: clean.ports[c] for c in columns},
                {"parameters": {"program": {"size": size}}, "labels": {"condition": f"size {size}", "repeat": repeat, **labels}},
            )
        )
    return made


def _late(t: Any, x: Any, lag: float) -> Any:
    return np.interp(t - lag, t, x)
