"""Adopted effects as an SSP parameter set (`adopt.ssv`), or an unknown law as a form: what a diagnosis writes, and a run takes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robomill.diagnosis.candidates import LOGGING, Address
from robomill.models.components.correction import read_form
from robomill.models.components.file_names import FORM
from robomill.orchestration.errors import SystemFileError, unknown
from robomill.orchestration.ssp.files import Files
from robomill.orchestration.ssp.parameter_set import ROOT, given_by, parameter_set
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.written import Written


def write(values: Mapping[Address, float], file: str | Path) -> Path:
    """Write `component.parameter` = value [unit of the parameter] for each; what is wrong with the log is left out."""
    path = Path(file)
    named = {f"{component}.{name}": ("real", float(v)) for (component, name), v in sorted(values.items()) if component != LOGGING}
    path.write_bytes(parameter_set("adopt", named))
    return path


def read(file: str | Path) -> dict[str, Written]:
    """Component -> parameter -> {value, unit}, each with the file as its place; a unit of None is that of the parameter.

    SystemFileError or FileNotFoundError says what is wrong.
    """
    path = Path(file)
    if not path.is_file():
        raise FileNotFoundError(f"no parameter set {path}")
    files = Files(path, path.parent, {path.name})
    found: dict[str, dict[str, Any]] = {}
    for parameter in files.xml(path.name, ROOT).iterfind("Parameters/Parameter"):
        what = f"parameter {parameter.get('name')!r}"
        component, _, name = parameter.get("name", "").partition(".")
        if not name:
            raise files.fail(f"{what}; expected component.parameter")
        if name in found.setdefault(component, {}):
            raise files.fail(f"{what} is there twice; leave one of them out")
        given = given_by(files, parameter, what)
        found[component][name] = {"value": given.value, "unit": given.unit}
    return {c: Written(values, {(name,): str(path) for name in values}) for c, values in found.items()}


def adopted(system: System, file: str | Path) -> System:
    """The system with the values of a parameter set in place of its own, or with a form (`*.form.json`) in its loop.

    SystemFileError names components that it has not.
    """
    known = [c.name for c in system.components]
    if str(file).endswith(FORM):
        try:
            component = read_form(Path(file)).specification["stands_for"]
        except LookupError as error:
            raise SystemFileError(str(error)) from None
        if component not in known:
            raise SystemFileError(f"{file}: a form of {component!r}: {unknown('component', component, known)}")
        return system.with_correction(component, str(Path(file).resolve()))
    for component, values in read(file).items():
        if component not in known:
            raise SystemFileError(f"{file}: parameter '{component}.{next(iter(values))}': {unknown('component', component, known)}")
        system = system.with_parameters(component, values)
    return system
