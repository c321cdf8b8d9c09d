"""Every FMU of this project goes through the conformance battery without a failure, a finding or a gap."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fmus.components import NAMES
from robomill.conformance import check_fmu

NOT_APPLICABLE = {"milling_force": {"dependencies"}, "compensation_controller": {"dependencies"}}
"""Checks that may be skipped: a cutter out of the material, an input without effect at that moment."""


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_battery(built: Callable[[str], Path], name: str) -> None:
    results = check_fmu(built(name))
    assert len(results) == 15
    for result in results:
        allowed = {"passed", "skipped"} if result.check in NOT_APPLICABLE.get(name, set()) else {"passed"}
        assert result.outcome in allowed, f"{name}: {result.check}: {result.outcome}: {result.detail}"
