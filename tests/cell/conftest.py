"""Runs that several test files look at: each scenario is run once per session."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from robomill.cell import milling
from robomill.cell.evaluation import Result, evaluate
from robomill.cell.scenario import load_scenario
from tests import SCENARIOS


class Runs:
    """Results of scenarios by name, run on first use."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.results = cache(self._results)

    def _results(self, name: str, fmus: Path | None = None) -> dict[str, Result]:
        scenario = load_scenario(SCENARIOS / f"{name}.toml")
        assert scenario.workpiece is not None
        folder = self.folder / (f"{name}_fmus" if fmus else name)
        job = milling.prepare(scenario, folder, fmus)
        found = {}
        for variant in scenario.variants:
            run, factor = milling.mill(job, variant)
            found[variant.name] = evaluate(variant.name, variant.title, run, scenario.workpiece, factor)
        return found


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    return Runs(tmp_path_factory.mktemp("scenarios"))
