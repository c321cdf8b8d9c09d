"""Every FMU of this project goes through the conformance battery without a failure, a finding or a gap."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import pytest

from robomill.conformance import CHECKS, Result, check_fmu
from robomill.fmus.components import NAMES, component
from robomill.fmus.native.builder import build
from robomill.fmus.reference import reference_files

NOT_APPLICABLE = {
    "milling_force": {"dependencies"},
    "tridexel_milling_force": {"dependencies"},
    "compensation_controller": {"dependencies"},
    "spindle_current": {"arrays"},
}
"""Checks that may be skipped: a cutter out of the material, an input without effect at that moment, a component of scalars."""


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_battery(built: Callable[[str], Path], name: str) -> None:
    judge(name, check_fmu(built(name)), {"arrays"})


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="builds libraries for linux64")
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", NAMES)
def test_battery_native(name: str, fmi: Literal[2, 3], tmp_path: Path) -> None:
    file = build(component(name), tmp_path, fmi=fmi, reference=reference_files(name))
    judge(name, check_fmu(file), {"arrays"} if fmi == 2 else set())


def judge(name: str, results: list[Result], not_applicable: set[str]) -> None:
    """All checks were made; none failed or found anything."""
    assert [r.check for r in results][4:] == list(CHECKS)
    skippable = not_applicable | NOT_APPLICABLE.get(name, set())
    for result in results:
        allowed = {"passed", "skipped"} if result.check in skippable else {"passed"}
        assert result.outcome in allowed, f"{name}: {result.check}: {result.outcome}: {result.detail}"
