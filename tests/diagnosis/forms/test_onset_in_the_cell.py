"""When an effect began, in the closed loop of a milling cell: the force of the cut grows by three tenths while the groove is milled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.blind.insert import Insert, insert, resolver
from robomill.cell.binding import convert, resolve
from robomill.cell.milling import of_variant, prepare
from robomill.cell.scenario import load_scenario
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.preparation import prepared
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.diagnosis.forms.onset import Onset, onset_of
from robomill.diagnosis.inference.search import Search
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System
from tests import ROOT

EFFECTS = ("cutting_coefficient", "tool_wear", "sensor_gain", "stock_error")
"""Effects that change the force of the cut, or what is shown of it."""
NOISE = {"compliance.p_BT_B": 6e-6, "drive.torque_motor": 0.05, "milling.spindle_torque": 0.03, "sensor.f_S_raw": 0.0, "path.p_BT_B": 0.0}
"""What is measured, and its noise beside that of the sensor [unit of the column]."""
WRENCH = {"f": (3, "N"), "m": (3, "N.m")}
MORE, SINCE = 0.3, 4.0
"""Part of the force, and when it begins to be there [s]; the groove takes 7.3 s."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> System:
    scenario = load_scenario(ROOT / "scenarios" / "groove.toml")
    job = prepare(scenario, tmp_path_factory.mktemp("groove"))
    return of_variant(job, next(v for v in scenario.variants if v.name == "cartesian"))


def measured(cell: System, more: Callable[[float], float]) -> list[Run]:
    """Three repeats of the groove with a force that is larger by a part `more` of the time [s]."""
    force = {"milling.f_T_B": ("f", "f_out"), "milling.m_T_B": ("m", "m_out")}
    machine = insert(cell, "cut", force, ("compliance", "drive", "sensor"))

    def larger() -> Insert:
        return Insert("cut", WRENCH, {"f_out": (3, "N"), "m_out": (3, "N.m")}, lambda: lambda t, h, u: u * (1.0 + more(t)))

    runs = []
    for k in range(3):
        made = run(machine.with_parameters("sensor", {"seed": 100 + k}), None, resolver=resolver({"cut": larger}, resolve), convert=convert)
        rng = np.random.default_rng(k)
        columns = {c: x + s * rng.normal(size=len(x)) for c, x in made.columns.items() for name, s in NOISE.items() if c.startswith(name)}
        runs.append(replace(made, folder=Path(f"run{k}"), columns=columns, info={**made.info, "labels": {"condition": "groove"}}))
    return runs


def looked_at(cell: System, more: Callable[[float], float]) -> Onset | None:
    catalogue = Catalogue.load(ROOT / "scenarios" / "catalogue.toml")
    few = replace(catalogue, candidates=tuple(c for c in catalogue.candidates if c.effect in EFFECTS), tolerances=())
    start = prepared(Campaign.of(cell, measured(cell, more), []), few, resolve, convert)
    simulator = Simulator(start.laboratory)
    return onset_of(Search(start.catalogue, simulator, start.laboratory.measured()[: start.n], start.nuisances))


@pytest.mark.parametrize(
    ("how", "more"), [("switches on", lambda t: MORE * (t >= SINCE)), ("grows", lambda t: 0.5 * MORE * max(t - SINCE, 0.0))]
)
def test_it_is_said_when_the_force_began_to_grow(cell: System, how: str, more: Callable[[float], float]) -> None:
    found = looked_at(cell, more)
    assert found is not None
    assert (found.component, found.how) == ("milling", how)
    assert found.interval is not None
    assert found.interval[0] <= SINCE <= found.interval[1]


def test_a_force_that_is_too_large_all_the_time_began_at_no_time(cell: System) -> None:
    """A gain that switches on explains a little more than one that is always there; the right effect all the time explains all."""
    assert looked_at(cell, lambda t: MORE) is None
