"""What the master is given from outside: components by name, and unit conversion."""

from __future__ import annotations

from pathlib import Path

from robomill.fmus.components import COMPONENTS, PYTHON, component, is_component
from robomill.fmus.in_process import InProcessSlave
from robomill.models.components.applied_load import MODEL as APPLIED_LOAD
from robomill.models.components.file_names import FORM
from robomill.models.model.units import convert
from robomill.orchestration.slaves.protocol import Slave
from robomill.orchestration.system.definition import System

__all__ = ["convert", "resolve", "with_fmus"]


def resolve(source: str, name: str) -> Slave:
    """The in-process component `source` as a slave called `name`; LookupError says what is wrong, or what there is."""
    if source == "applied_load":  # for experiments; no component of the twin, so no FMU is built of it
        return InProcessSlave(APPLIED_LOAD, name)
    if source.endswith(FORM):
        from robomill.cell.form_slave import FormSlave  # its model needs Numba, which takes half a second to import
        from robomill.models.components.correction import read_form

        return FormSlave(name, read_form(Path(source)).specification)
    if not is_component(source):
        known = ", ".join([*COMPONENTS, "applied_load"])
        raise LookupError(
            f"there is no component {source!r}; components: {known}; or name an .fmu file, a form ({FORM}), replay:FOLDER, "
            f"{PYTHON}package.module:MODEL or {PYTHON}file.py:MODEL"
        )
    try:
        return InProcessSlave(component(source), name)
    except ValueError as error:
        raise LookupError(str(error)) from error


def with_fmus(system: System, folder: Path) -> System:
    """The system with every component that runs in process taken from its FMU in `folder`.

    FileNotFoundError names the FMU that is missing and the command that builds it.
    """
    for c in system.components:
        if is_component(c.source):
            fmu = (folder / f"{component(c.source).name}.fmu").resolve()
            if not fmu.is_file():
                only = "" if c.source in COMPONENTS else f" --component {c.source}"
                raise FileNotFoundError(f"component {c.name!r}: no FMU {fmu}; build it with `robomill build{only} --out {folder}`")
            system = system.with_source(c.name, str(fmu))
    return system
