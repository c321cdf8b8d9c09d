"""Variants of a milling scenario that are named."""

from __future__ import annotations

import pytest

from robomill.cell.milled import chosen
from robomill.cell.scenario import ScenarioError, load_scenario
from tests import SCENARIOS


def test_a_variant_that_is_named_twice_is_milled_once() -> None:
    scenario = load_scenario(SCENARIOS / "groove.toml")
    assert [v.name for v in chosen(scenario, ["axis", "cartesian", "axis"]).variants] == ["axis", "cartesian"]
    assert chosen(scenario, None) is scenario
    with pytest.raises(ScenarioError, match="no variant axes; variants: uncompensated, cartesian, axis, cartesian_pilot"):
        chosen(scenario, ["axes"])
