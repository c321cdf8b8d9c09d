"""The 60 static load cases of paper 000, sec. 3.1, put to the compliance component of a system, whatever it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.equipment import load_system
from robomill.cell.milling import with_parameters
from robomill.cell.scenario import Scenario
from robomill.models.calibration.validation_loads import ValidationLoads, validation_loads
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.assembly import assemble
from robomill.orchestration.slaves.protocol import Port, arrays, inputs, outputs
from robomill.orchestration.system.definition import System


@dataclass(frozen=True)
class LoadCase:
    """Displacement of the tool under one load, as summary.json has it."""

    case: int
    """Number of the load."""
    load: str
    """Its place and direction."""
    displacement_m: float
    """Magnitude of the displacement of the tool."""
    d_T_B_m: tuple[float, ...]
    """Displacement in the robot base: x, y, z."""


@dataclass(frozen=True)
class StaticLoads:
    """What a variant comes to, as summary.json has it."""

    mean_displacement_m: float
    """Mean displacement over all loads."""
    max_displacement_m: float
    """Largest displacement."""
    cases: tuple[LoadCase, ...]
    """Each load."""

    @property
    def magnitudes(self) -> FloatArray:
        """Displacement [m] in each case."""
        return np.array([c.displacement_m for c in self.cases])


def displacements(system: System, loads: ValidationLoads) -> FloatArray:
    """Displacement d_T_B [m], [60, 3], of the component `compliance` of `system` under the loads, one quasi-static step each."""
    with assemble(system, resolve, convert) as assembly:
        slave = assembly.slaves["compliance"]
        n = len(loads.label)
        slave.initialise(0.0, n * system.step, system.step)
        u = np.array([float(p.start or 0.0) for p in inputs(slave.ports)])
        y = np.zeros(len(outputs(slave.ports)))
        position = {name: _span(slave.ports, "input", name) for name in ("q_link", "f_T_B")}
        result = np.zeros((n, 3))
        for i in range(n):
            u[position["q_link"]] = loads.q[i]
            u[position["f_T_B"]] = loads.f_T_B[i]
            slave.set_inputs(u)
            slave.step(i * system.step, system.step)
            slave.get_outputs(y)
            result[i] = y[_span(slave.ports, "output", "d_T_B")]
    return result


def _span(ports: Sequence[Port], causality: str, name: str) -> slice:
    """Where an array stands among the inputs or outputs; KeyError lists what there is."""
    chosen = [p for p in ports if p.causality == causality]
    found = arrays(chosen)
    if name not in found:
        raise KeyError(f"component 'compliance' has no {causality} {name!r}; it has {', '.join(found)}")
    first = chosen.index(found[name][0])
    return slice(first, first + len(found[name]))


def run_static_loads(scenario: Scenario, fmus: Path | None = None) -> dict[str, StaticLoads]:
    """Run every variant; by its name."""
    loads = validation_loads()
    found: dict[str, StaticLoads] = {}
    for variant in scenario.variants:
        system = with_parameters(load_system(scenario.system, scenario.equipment), scenario.parameters)
        system = with_parameters(replace(system, name=f"{scenario.name}/{variant.name}"), variant.parameters)
        d = displacements(with_fmus(system, fmus) if fmus else system, loads)
        size = np.linalg.norm(d, axis=1)
        cases = tuple(LoadCase(i + 1, loads.label[i], float(size[i]), tuple(d[i].tolist())) for i in range(len(size)))
        found[variant.name] = StaticLoads(float(size.mean()), float(size.max()), cases)
    return found
