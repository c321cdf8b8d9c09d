"""The test part, complete and in all four variants: the numbers do not depend on what the components are made of (EXACT)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from robomill.cell import milling
from robomill.cell.scenario import load_scenario
from robomill.fmus.components import COMPONENTS
from robomill.fmus.native.builder import build_all
from robomill.fmus.python.builder import build
from robomill.models.model.declaration import Model
from tests import SCENARIOS
from tests.cell.conftest import Runs
from tests.cell.test_scenarios import assert_equal

pytestmark = pytest.mark.slow


def python(models: list[Model], folder: Path) -> None:
    for model in models:
        build(model, folder)


@pytest.mark.parametrize(
    ("builder", "variants"),
    [
        pytest.param(build_all, ("uncompensated", "cartesian", "axis", "cartesian_pilot"), id="native, FMI 2.0"),
        # one with everything on; the others take long, and the groove has them all (test_scenarios)
        pytest.param(partial(build_all, fmi=3), ("cartesian_pilot",), id="native, FMI 3.0"),
        pytest.param(python, ("cartesian_pilot",), id="python"),
    ],
)
def test_the_test_part_from_fmus(builder: Callable[..., object], variants: tuple[str, ...], runs: Runs, tmp_path: Path) -> None:
    in_process = runs.results("test_part")
    sources = set(in_process["cartesian"].run.info["sources"].values())
    builder([m for name, m in COMPONENTS.items() if name in sources], tmp_path / "fmus")
    job = milling.prepare(load_scenario(SCENARIOS / "test_part.toml"), tmp_path / "runs", tmp_path / "fmus")
    for variant in job.scenario.variants:
        if variant.name in variants:
            found, _ = milling.mill(job, variant)
            assert set(found.info["sources"]) == set(milling.PARTS)
            assert all(source.endswith(".fmu") for source in found.info["sources"].values())
            assert len(found.columns) == len(in_process[variant.name].run.columns) > 90
            assert_equal(in_process[variant.name].run, found)
