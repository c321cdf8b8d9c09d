"""Systems and scenarios as SSP packages, and packages as systems: what `robomill build --ssp` and `robomill run X.ssp` do."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from robomill.cell import milling
from robomill.cell.binding import convert, with_fmus
from robomill.cell.equipment import load_system
from robomill.cell.scenario import ScenarioError, load_scenario
from robomill.fmus.components import is_component
from robomill.orchestration.ssp.export import export
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.toml_text import parse


def systems(file: Path, work: Path, variants: Sequence[str] | None = None) -> list[System]:
    """What a file stands for: the system of a system file, or one per variant (all, or those named) of a milling scenario.

    A scenario is planned, and its offline run done, in the folder `work`; the tables stay there.
    """
    try:
        is_scenario = file.is_file() and "scenario" in parse(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        is_scenario = False  # the system loader names the line
    if not is_scenario:
        return [load_system(file)]
    scenario = load_scenario(file)
    if scenario.kind != "milling":
        raise ScenarioError(
            f"{file}: is of kind {scenario.kind!r}; packages are made of milling scenarios and of system files; give one of these"
        )
    known = [v.name for v in scenario.variants]
    unknown = [n for n in variants or () if n not in known]
    if unknown:
        raise ScenarioError(f"{file}: no variant {', '.join(unknown)}; variants: {', '.join(known)}")
    job = milling.prepare(scenario, work)
    made = []
    for variant in scenario.variants:
        if not variants or variant.name in variants:
            system = milling.of_variant(job, variant)
            made.append(replace(system, name=f"{scenario.name}_{variant.name}", stop=job.steps * system.step))
    return made


def used(made: Sequence[System]) -> list[str]:
    """The in-process components that the systems consist of: their FMUs are needed."""
    return list(dict.fromkeys(c.source for s in made for c in s.components if is_component(c.source)))


def write(made: Sequence[System], fmus: Path, folder: Path, report: Callable[[str, int, int], object]) -> list[Path]:
    """Write NAME.ssp of each system into `folder`, with the FMUs in the folder `fmus`; returns the files."""
    files = []
    for i, system in enumerate(made):
        report("package", i, len(made))
        files.append(export(with_fmus(system, fmus), folder / f"{system.name.replace('/', '_')}.ssp", convert))
    report("package", len(made), len(made))
    return files
