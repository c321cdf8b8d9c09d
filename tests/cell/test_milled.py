"""Variants of a milling scenario that are named."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from robomill.cell import milling
from robomill.cell.milled import chosen, mill_variants
from robomill.cell.scenario import ScenarioError, load_scenario
from robomill.orchestration.errors import RunError
from robomill.orchestration.runs.run import Run
from tests import SCENARIOS


def test_a_variant_that_is_named_twice_is_milled_once() -> None:
    scenario = load_scenario(SCENARIOS / "groove.toml")
    assert [v.name for v in chosen(scenario, ["axis", "cartesian", "axis"]).variants] == ["axis", "cartesian"]
    assert chosen(scenario, None) is scenario
    with pytest.raises(ScenarioError, match="no variant axes; variants: uncompensated, cartesian, axis, cartesian_pilot"):
        chosen(scenario, ["axes"])


def test_variants_are_complete_in_their_order_though_one_is_computed_while_the_one_before_is_completed(tmp_path) -> None:
    scenario = load_scenario(SCENARIOS / "groove.toml")
    job = milling.prepare(scenario, tmp_path)
    found = [(v.name, behind.run()) for v, behind, _ in milling.mill_all(job, scenario.variants[:2])]
    assert [name for name, _ in found] == [v.name for v in scenario.variants[:2]]
    for v, (_, run) in zip(scenario.variants[:2], found, strict=True):
        alone, _ = milling.mill(replace(job, folder=tmp_path / "alone"), v)
        assert all(np.array_equal(run[name], alone[name]) for name in alone.arrays())


def test_a_variant_that_fails_keeps_nothing_from_the_one_before(tmp_path, monkeypatch) -> None:
    """What was milled before is in summary.json when the error is raised."""
    scenario = load_scenario(SCENARIOS / "groove.toml")
    milled = milling._milled

    def fails(job, variant, progress, csv):
        if variant.name == "axis":
            raise RunError("no oil", "milling", 1.0)
        return milled(job, variant, progress, csv)

    monkeypatch.setattr(milling, "_milled", fails)
    with pytest.raises(RunError, match="no oil"):
        mill_variants(scenario, tmp_path, ["cartesian", "axis"])
    assert list(json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["variants"]) == ["cartesian"]
    assert Run.load(tmp_path / "cartesian").outcome == "finished"
