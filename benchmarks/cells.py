"""Cells of other papers as systems of `benchmarks.elsewhere`: machines whose numbers are off within the tolerances of their catalogues.

The machine is simulated by the components that the diagnosis has, too. What these cases show is whether the engine goes with other sensors,
controllers and robots, not whether it is right on machines that are formulated otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from robomill.blind.world import measure
from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system, ports_of
from robomill.cell.experiments import Experiment, load_experiment, run_condition
from robomill.diagnosis.candidates import LOGGING, Address
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.preparation import prepared
from robomill.files import FILES
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import base_name
from robomill.orchestration.system.definition import System

ALSO = ("sensor.bridge", "current.current")
"""Measured arrays, beside those of the blind benchmark."""
OTHER = 100
"""Repeats that a machine has behind it: no simulation has the same noise."""


@dataclass(frozen=True)
class Cell:
    """A folder of `scenarios/` with an experiment and catalogue.toml."""

    name: str
    experiment: str
    usual: Mapping[str, float]
    """`component.parameter` of the catalogue -> size that is usual [SI]; a negative one may have either sign."""
    same: Mapping[str, str] = field(default_factory=dict)
    """`component.parameter` -> another one that does the same."""

    @property
    def folder(self) -> Path:
        """Where it is."""
        return FILES / "scenarios" / self.name

    def catalogue(self) -> Catalogue:
        """What may be wrong with it."""
        return Catalogue.load(self.folder / "catalogue.toml")

    def system(self) -> System:
        """The nominal one."""
        return load_system(self._experiment().system)

    def parameter(self, effect: str) -> str:
        """`component.parameter` of an effect."""
        return effect

    def runs(self, effects: Mapping[str, float], seed: int, repeats: int, folder: Path) -> tuple[list[Run], list[Run]]:
        """Diagnosed and held-out runs of a machine with these effects, whose numbers are drawn by the seed."""
        experiment = self._experiment()
        nominal = run_condition(experiment, experiment.conditions[0], 1, folder / "nominal", overwrite=True)
        campaign = Campaign.of(self.system(), [nominal])
        rng, machine = np.random.default_rng(seed), {}
        for nuisance in prepared(campaign, self.catalogue(), resolve, convert).nuisances:
            if nuisance.address[0] != LOGGING:
                machine[nuisance.address] = nuisance.nominal + nuisance.scale * rng.normal()
        for name, value in effects.items():
            component, _, parameter = name.partition(".")
            machine[component, parameter] = machine.get((component, parameter), 0.0) + value
        experiment = replace(experiment, machine=_whole(machine, self.system()))
        found: tuple[list[Run], list[Run]] = ([], [])
        for condition in experiment.conditions:
            for repeat in range(1, repeats + 1):
                place = folder / f"{condition.name}-{repeat}"
                made = run_condition(experiment, condition, OTHER + repeat, place, overwrite=True)
                also = {name: x for name, x in made.columns.items() if base_name(name) in ALSO}
                found[condition.held_out].append(replace(made, columns=measure(made.columns, "T1", rng) | also))
        return found

    def _experiment(self) -> Experiment:
        return load_experiment(self.folder / self.experiment)


def _whole(values: Mapping[Address, float], system: System) -> dict[str, dict[str, Any]]:
    """Component -> parameter -> value, in which arrays that the system gives are whole."""
    found: dict[str, dict[str, Any]] = {}
    for (component, parameter), value in values.items():
        into, base = found.setdefault(component, {}), base_name(parameter)
        given = into.get(base, system.component(component).parameters.get(base))
        if base == parameter or given is None:
            into[parameter] = float(value)
        else:
            elements = [p.name for p in ports_of(system, component) if base_name(p.name) == base]
            array = np.array(given, dtype=np.float64).ravel()
            array[elements.index(parameter)] = value
            into[base] = array.tolist()
    return found


CELLS = (
    Cell(
        "kr500",
        "slots.toml",
        {
            **{f"sensor.bridge_gain_error[{i}]": -0.05 for i in range(1, 7)},
            **{f"sensor.dead_channel[{i}]": 0.4 for i in range(1, 7)},
            **{f"sensor.attack_point[{i}]": -0.01 for i in range(1, 4)},
            "sensor.cross_talk": -0.04,
        },
        {f"sensor.dead_channel[{i}]": f"sensor.bridge_gain_error[{i}]" for i in range(1, 7)},
    ),
    Cell(
        "irb6400",
        "end_millings.toml",
        {
            **{f"sensor.misalignment[{i}]": -0.05 for i in range(1, 4)},
            "sensor.weight_error": -2.0,
            "current.current_gain_error": -0.1,
            "current.friction_error": -0.3,
            "path.override_error": -0.03,
        },
    ),
    Cell(
        "kr210",
        "pushes.toml",
        {
            **{f"compliance.tilt_stiffness_error[{i}]": -0.25 for i in range(1, 7)},
            "compliance.damping_error": -0.5,
            "compliance.mode_frequency_error": -0.08,
        },
    ),
)
