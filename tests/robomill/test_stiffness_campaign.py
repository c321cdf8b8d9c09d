"""The campaign of scenarios/campaigns/stiffness: loads on purpose and cuts in one diagnosis find the stiffness of a joint."""

from __future__ import annotations

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
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System

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
@pytest.mark.parametrize(("joint", "error"), [(2, 0.15), (3, -0.3)])
def test_a_stiffness_error_is_found_and_placed(joint: int, error: float) -> None:
    answer = diagnosed(measured(joint, error, seed=10 * joint))
    first = answer.which[0]
    assert answer.verdict in ("identified", "ambiguous")
    assert (first.effect, first.location) == ("stiffness_error", f"joint {joint}")
    estimate = first.parameters[f"stiffness_error[{joint}]"]
    low, high = estimate.interval
    # intervals are of 90 %: half of one more on either side
    assert low - 0.5 * (high - low) < error < high + 0.5 * (high - low)
