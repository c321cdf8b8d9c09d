"""The recommended run on the milling cell: a push at one place leaves a set, and the run that the diagnosis asks for settles it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.cell.milling import with_parameters
from robomill.cell.next_runs import prepare, with_load
from robomill.diagnose_command import menu
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from tests import ROOT

CELL = load_system(ROOT / "scenarios" / "milling_cell.toml")
NOISE = 7e-6  # m
HEIGHT = "compliance.p_BT_B[3]"
EFFECT = """
[[effect]]
name = "{name}"
component = "compliance"
description = "d"
source = "s"
unit = "{unit}"
minimum = {low}
maximum = {high}
sign = "{sign}"
prior = {{kind = "{prior}", scale = {scale}}}
locations = [{places}]
"""
CATALOGUE = EFFECT.format(
    name="stiffness_error",
    unit="1",
    low=0.01,
    high=0.6,
    sign="both",
    prior="normal",
    scale=0.15,
    places=", ".join(f'{{name = "joint {j}", parameters = ["stiffness_error[{j}]"]}}' for j in (2, 3, 5)),
) + EFFECT.format(
    name="base_compliance",
    unit="m/N",
    low=1e-9,
    high=1e-6,
    sign="positive",
    prior="log-normal",
    scale=5e-8,
    places=", ".join(f'{{name = "{a}", parameters = ["base_compliance[{i}]"]}}' for i, a in enumerate("xyz", 1)),
)


def tip(kind: str, values: dict[str, float], truth: dict[str, float], folder: Path, channels: tuple[str, ...]) -> Run:
    """The run of this kind, with these values, of a cell whose robot has `truth`; no noise."""
    r = prepare(with_load(CELL), kind, folder, values)
    system = with_parameters(with_parameters(r.system, r.parameters), {"compliance": truth})
    result = run(system, None, stop=r.seconds, resolver=resolve, convert=convert)
    columns = {c: result.columns[c] for c in channels}
    return Run(folder, result.t, columns, result.ports, {"parameters": r.parameters, "labels": {"condition": kind}})


def noisy(clean: Run, repeats: int, seed: int) -> list[Run]:
    random = np.random.default_rng(seed)
    made = []
    for i in range(repeats):
        columns = {c: v + NOISE * random.standard_normal(v.shape) for c, v in clean.columns.items()}
        made.append(Run(clean.folder / f"repeat_{i}", clean.t, columns, clean.ports, clean.info))
    return made


@pytest.mark.slow
@pytest.mark.parametrize("truth", [{"stiffness_error[3]": -0.15}, {"base_compliance[3]": 8e-8}], ids=["joint 3", "base"])
def test_the_run_that_is_asked_for_names_the_truth(tmp_path: Path, truth: dict[str, float]) -> None:
    (tmp_path / "catalogue.toml").write_text(CATALOGUE)
    runs = noisy(tip("static push", {"elevation": 90.0}, truth, tmp_path / "first", (HEIGHT,)), 3, 1)
    told = menu(with_load(CELL), tmp_path / "menu")
    result = diagnose(
        with_load(CELL), runs, Catalogue.load(tmp_path / "catalogue.toml"), resolver=resolve, convert=convert, menu=told
    ).result
    assert result["verdict"] == "ambiguous"
    found = result["next_run"]
    assert found["separated"]
    assert found["distance"] > found["now"]
    values = {name: v["value"] for name, v in found["parameters"].items()}
    models = {name: values.get("compliance", {}) for name, values in found["models"].items()}
    right = [name for name, values in models.items() if set(values) == set(truth)]
    measured = noisy(tip(found["kind"], values, truth, tmp_path / "asked", (HEIGHT,)), found["repeats"], 2)

    def left(name: str) -> float:
        simulated = tip(found["kind"], values, models[name], tmp_path / "tried", (HEIGHT,))[HEIGHT]
        return float(sum(((r[HEIGHT] - simulated) ** 2).sum() for r in measured))

    assert [min(models, key=left)] == right
