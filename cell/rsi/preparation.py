"""From a link file to a system that can run: the plan of its scenario, FMUs for one side, what run.toml says of the session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from robomill.cell import milling
from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.rsi.settings import Link
from robomill.orchestration.assembly import assemble
from robomill.orchestration.system.definition import System


@dataclass(frozen=True)
class Prepared:
    """A whole cell that can run, and what is known of it."""

    system: System
    about: Mapping[str, Any]
    """Program, robot, workpiece, labels, and the parameters of all components as they stand in run.toml."""


def prepare(link: Link, folder: Path, partner: bool, fmus: Path | None = None, progress: milling.Progress | None = None) -> Prepared:
    """Plan the scenario of a link, if it has one, into `folder`/plan; `fmus`: FMUs for the components of the side that is asked for.

    Raises what `milling.prepare` and `assemble` raise.
    """
    system, about = link.system, dict[str, Any](link.system.labels)
    if link.scenario is not None and link.variant is not None:
        job = milling.prepare(link.scenario, folder, progress=progress, overwrite=True)
        system = milling.of_variant(job, link.variant)
        block = " x ".join(f"{1e3 * length:g}" for length in job.workpiece.size)
        about |= {"program": job.plan.name, "workpiece": f"block {block} mm", "condition": link.variant.name}
    labels = {k: about.pop(k) for k in list(about) if k not in ("program", "robot", "tool", "workpiece")}
    with assemble(system, resolve, convert) as assembly:
        parameters = assembly.about()["parameters"]
    if fmus is not None:
        own = {c.name for c in system.components if (c.name in link.partner) == partner}
        exchanged = with_fmus(replace(system, components=tuple(c for c in system.components if c.name in own)), fmus)
        system = replace(system, components=tuple(exchanged.component(c.name) if c.name in own else c for c in system.components))
    return Prepared(system, {**about, "labels": labels, "parameters": parameters})
