"""The campaign of scenarios/campaigns/stiffness: loads on purpose and cuts in one diagnosis find the stiffness of a joint."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest

from robomill.blind.world import draw_machine, measure
from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.cell.experiments import ExperimentCondition, in_folder, load_experiment, prepare
from robomill.cell.scenario import ComponentParameters
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose_campaign
from robomill.diagnosis.experiment.campaign import Campaign, Part
from robomill.diagnosis.experiment.store import Store
from robomill.diagnosis.outcome.answer import Answer
from robomill.files import FILES
from robomill.models.calibration.validation_loads import validation_loads
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.playback import Playback
from robomill.orchestration.slaves.protocol import PortData, Slave
from robomill.orchestration.system.definition import Component, Connection, System

FOLDER = FILES / "scenarios" / "campaigns" / "stiffness"
REPEATS = 3


@cache
def planned(name: str) -> tuple[System, tuple[tuple[ExperimentCondition, ComponentParameters], ...]]:
    """The system of an experiment, and what its experimenter sets in each condition; the tables are in a folder of their own."""
    experiment = load_experiment(FOLDER / f"{name}.toml")
    system = load_system(experiment.system)
    folder = Path(mkdtemp())
    made = []
    for i, c in enumerate(experiment.conditions):
        _, known = prepare(experiment, c, system, folder / str(i))
        made.append((c, in_folder(known, folder / str(i))))
    return system, tuple(made)


def measured(joint: int, error: float, seed: int) -> Campaign:
    """Runs of a machine whose calibrated numbers are off by a little, with the noise of its instruments; `joint` from 1 on."""
    random = np.random.default_rng(seed)
    machine = {c: dict(values) for c, values in draw_machine(random).parameters.items()}
    machine["compliance"][f"stiffness_error[{joint}]"] = error
    parts = []
    for name in ("loads", "cuts"):
        system, conditions = planned(name)
        runs: tuple[list[Run], list[Run]] = [], []
        for c, known in conditions:
            for repeat in range(REPEATS):
                seeds = {component: {"seed": int(random.integers(1, 2**31))} for component in ("sensor", "controller")}
                made = system
                for table in (machine, known, seeds):
                    for component, values in table.items():
                        if any(component == k.name for k in made.components):
                            made = made.with_parameters(component, values)
                clean = run(made, None, resolver=resolve, convert=convert)
                columns = measure(dict(clean.columns), "T1", random)
                info = {"parameters": known, "labels": {"condition": c.name, "repeat": repeat}}
                ports = {k: clean.ports[k] for k in columns}
                runs[c.held_out].append(Run(Path(f"{name}-{c.name}-{repeat}"), clean.t, columns, ports, info))
        parts.append(Part(name, system, tuple(runs[0]), tuple(runs[1])))
    return Campaign("stiffness", tuple(parts))


def diagnosed(campaign: Campaign, store: Store | None = None) -> Answer:
    """With the catalogue of the milling cell."""
    catalogue = Catalogue.load(FILES / "scenarios" / "catalogue.toml")
    return diagnose_campaign(campaign, catalogue, resolver=resolve, convert=convert, store=store).answer


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "error", "seed"), [(2, 0.15, 500), (1, 0.15, 501), (3, 0.15, 502)])
def test_a_stiffness_error_is_found_and_placed(joint: int, error: float, seed: int) -> None:
    """The machines of docs/how_to/campaigns.md, which says what they show and what not."""
    answer = diagnosed(measured(joint, error, seed))
    first = answer.which[0]
    assert answer.verdict in ("identified", "ambiguous")
    assert (first.effect, first.location) == ("stiffness_error", f"joint {joint}")
    estimate = first.parameters[f"stiffness_error[{joint}]"]
    low, high = estimate.interval
    # intervals are of 90 %: half of one more on either side
    assert low - 0.5 * (high - low) < error < high + 0.5 * (high - low)


HELD = 10
"""Steps for which each static load is held: samples are means over some of them."""
STATIC = replace(
    load_system(FILES / "scenarios" / "static_cell.toml"),
    components=(Component("loads", "loads"), Component("compliance", "robot_compliance")),
    connections=(Connection("loads.q", "compliance.q_link"), Connection("loads.f", "compliance.f_T_B")),
)
"""The robot alone, under the 60 loads of the paper one after the other."""


def with_loads(source: str, name: str) -> Slave:
    """The components of the cell, and one that plays the loads."""
    if source != "loads":
        return resolve(source, name)
    loads = validation_loads()
    series = {
        f"{port}[{i + 1}]": np.repeat(rows[:, i], HELD) for port, rows in (("q", loads.q), ("f", loads.f_T_B)) for i in range(rows.shape[1])
    }
    units = {"q": "rad", "f": "N"}
    ports = [PortData(port, "output", unit=units[port[0]], start=0.0) for port in series]
    times = np.asarray(STATIC.step * np.arange(len(loads.q) * HELD), dtype=np.float64)
    return Playback.of_series(name, ports, series, times)


@pytest.mark.slow
def test_static_loads_of_the_robot_alone_and_a_cell_are_one_campaign() -> None:
    """They share the component `compliance`; the cell has sensor and drives beside it, and other channels."""
    random = np.random.default_rng(3)
    error = {"stiffness_error[2]": 0.3}
    stop = HELD * len(validation_loads().q) * STATIC.step
    clean = run(STATIC.with_parameters("compliance", error), None, stop=stop, resolver=with_loads, convert=convert)
    tip = [c for c in clean.columns if c.startswith("compliance.d_T_B")]
    static = []
    for k in range(REPEATS):
        columns = {c: clean.columns[c] + 1e-5 * random.standard_normal(len(clean.t)) for c in tip}
        static.append(Run(Path(f"static-{k}"), clean.t, columns, {c: clean.ports[c] for c in tip}, {}))
    system, conditions = planned("loads")
    (known,) = (known for c, known in conditions if c.name == "hanging weight")
    weighed = []
    for k in range(REPEATS):
        made = system.with_parameters("compliance", error).with_parameters("sensor", {"seed": 50 + k})
        for component, values in known.items():
            made = made.with_parameters(component, values)
        moved = run(made, None, resolver=resolve, convert=convert)
        shown = measure(dict(moved.columns), "T1", random)
        weighed.append(Run(Path(f"weight-{k}"), moved.t, shown, {c: moved.ports[c] for c in shown}, {"parameters": known}))
    campaign = Campaign("static", (Part("weight", system, tuple(weighed)), Part("static", STATIC, tuple(static))))
    catalogue = Catalogue.load(FILES / "scenarios" / "catalogue.toml")
    few = tuple(c for c in catalogue.candidates if c.effect in ("stiffness_error", "payload_error", "sensor_gain"))
    answer = diagnose_campaign(campaign, replace(catalogue, candidates=few), resolver=with_loads, convert=convert).answer
    first = answer.which[0]
    assert answer.verdict == "identified"
    assert (first.effect, first.location) == ("stiffness_error", "joint 2")
    low, high = first.parameters["stiffness_error[2]"].interval
    assert low - 0.5 * (high - low) < 0.3 < high + 0.5 * (high - low)
