"""The reference experiment of an FMU: inputs, parameters and outputs that were computed, in the forms that importers read.

`documentation/reference/` holds `in.csv`, `out.csv`, `parameters.json` and tables. `extra/org.fmi-standard.fmi-ls-ref/` says in the
words of the layered standard FMI-LS-REF what they are: the manifest, the parameters as an SSV file, and the experiment in the
format of its 1.0.0-alpha.1 (appendix; 1.0.0-beta.1 refers to the same format elsewhere).

CSV files are as FMPy and the Reference FMUs' `fmusim` read them: first column `time`, then a column per variable. In FMI 3.0 the
elements of an array stand in one column, separated by blanks. The times are k * h as doubles, which importers come by: at any other
number they would interpolate between two rows.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping
from html import escape
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from robomill.files import FILES
from robomill.fmus.instance import DEFAULT_STEP
from robomill.fmus.interface import Interface
from robomill.fmus.model_description import xml_file
from robomill.orchestration.ssp.parameter_set import parameter_set

FOLDER = "documentation/reference"
EXTRA = "extra/org.fmi-standard.fmi-ls-ref"
STANDARD = {
    "xmlns:fmi-ls": "http://fmi-standard.org/fmi-ls-manifest",
    "fmi-ls:fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
    "fmi-ls:fmi-ls-version": "1.0.0-alpha.1",  # also what 1.0.0-beta.1 prescribes
    "fmi-ls:fmi-ls-description": "Layered Standard providing information on related files included in an FMU.",
}
_UP = "../../"
"""From the folder of the manifest to the root of the archive."""


class Related(NamedTuple):
    """A file of the archive and its role, as FMI-LS-REF defines them."""

    place: str
    mime: str
    role: str
    description: str


def reference_files(name: str) -> dict[str, bytes]:
    """Inputs, outputs, parameters and tables of the golden results of a component; empty where there are none."""
    folder = FILES / "tests" / "golden" / name
    return {f.name: f.read_bytes() for f in sorted(folder.glob("*")) if f.suffix in (".csv", ".json", ".npy")}


def experiment_files(interface: Interface, arrays: bool, files: Mapping[str, bytes]) -> tuple[dict[str, bytes], list[Related]]:
    """Content of the archive made of `files` (as `reference_files` gives them), and what the manifest says of it.

    With `arrays` an array is one variable, as in FMI 3.0; else its elements are.
    `in.csv` and `out.csv` have a column of times [s] and one per element; row k of `in.csv` holds from t_k on, row k of `out.csv`
    are the outputs at t_k.
    """
    content = {f"{FOLDER}/{name}": _table(interface, arrays, data) if name.endswith(".csv") else data for name, data in files.items()}
    if not {"in.csv", "out.csv"} <= files.keys():
        return content, []
    values: dict[str, Any] = json.loads(files.get("parameters.json", b"{}"))
    if values:
        content[f"{EXTRA}/parameters.ssv"] = parameter_set("reference", _typed(interface, arrays, values))
    steps = files["in.csv"].count(b"\n") - 1
    content[f"{EXTRA}/smoke-test.exp"] = _experiment(steps, bool(values))
    content["documentation/fmi-ls-ref.html"] = _page(interface, arrays, steps, values).encode()
    related = [
        Related(f"{EXTRA}/smoke-test.exp", "application/x-ma-ls-experiments", "experiment/smoke-test", "The reference experiment"),
        Related(f"{FOLDER}/in.csv", "text/csv", "testcase", "Inputs of the reference experiment"),
        Related(f"{FOLDER}/out.csv", "text/csv", "result", "Outputs of the reference experiment, bit by bit"),
    ]
    if values:
        ssv = Related(f"{EXTRA}/parameters.ssv", "application/x-ssp-parameter-set", "parameter", "Parameters of the reference experiment")
        related.insert(1, ssv)
    return content, related


def manifest_files(related: Iterable[Related]) -> dict[str, bytes]:
    """fmi-ls-manifest.xml of FMI-LS-REF, by its place in the archive."""
    root = Element("fmiReferences", STANDARD)
    for place, mime, role, description in related:
        source = place.removeprefix(f"{EXTRA}/") if place.startswith(EXTRA) else _UP + place
        SubElement(root, "Related", type=mime, source=source, role=role, description=description)
    return {f"{EXTRA}/fmi-ls-manifest.xml": xml_file(root)}


def _table(interface: Interface, arrays: bool, data: bytes) -> bytes:
    """The table with times k * h; with `arrays` one column for each variable."""
    (_, *names), *rows = csv.reader(io.StringIO(data.decode()))
    columns: dict[str, list[int]] = {}
    for i, name in enumerate(names, start=1):
        columns.setdefault(interface.by_name[name].variable if arrays else name, []).append(i)
    made = io.StringIO()
    writer = csv.writer(made, lineterminator="\n")
    writer.writerow(["time", *columns])
    for k, row in enumerate(rows):
        writer.writerow([repr(k * DEFAULT_STEP), *(" ".join(row[i] for i in places) for places in columns.values())])
    return made.getvalue().encode()


def _typed(interface: Interface, arrays: bool, values: Mapping[str, Any]) -> dict[str, tuple[str, Any]]:
    """Type and value by variable; `arrays` are whole, with the start values of the elements that are not given."""
    if not arrays:
        return {name: (interface.by_name[name].type, value) for name, value in values.items()}
    found: dict[str, tuple[str, Any]] = {}
    for name in values:
        port = interface.by_name[name]
        ports = interface.parameters[interface.arrays[port.variable]]
        whole = [values.get(p.name, p.start) for p in ports]
        shape = interface.model.variable(port.variable).shape if port.type != "string" else ()
        found[port.variable] = port.type, np.array(whole).reshape(shape) if shape else whole[0]
    return found


def _experiment(steps: int, parameters: bool) -> bytes:
    root = Element("Experiments", name="reference", description="Inputs and outputs that were computed when the FMU was made")
    times = {"startTime": "0.0", "stopTime": repr(steps * DEFAULT_STEP), "stepSize": repr(DEFAULT_STEP)}
    experiment = SubElement(root, "Experiment", {"name": "reference", **times})
    if parameters:
        SubElement(experiment, "Parameters", source="parameters.ssv")
    SubElement(experiment, "Stimuli", source=f"{_UP}{FOLDER}/in.csv")
    SubElement(experiment, "References", source=f"{_UP}{FOLDER}/out.csv")
    return xml_file(root)


def _page(interface: Interface, arrays: bool, steps: int, values: Mapping[str, Any]) -> str:
    """documentation/fmi-ls-ref.html, which the layered standard recommends: what the experiment is and how to run it."""
    name = interface.model.name
    files = sorted(str(v) for k, v in values.items() if interface.by_name[k].type == "string")
    notes = [
        f"{steps} steps of {DEFAULT_STEP:g} s. Row k of <code>reference/in.csv</code> holds from its time on; row k of "
        "<code>reference/out.csv</code> are the outputs at its time, the first after initialisation.",
        "The outputs are to be met bit by bit. Other numbers mean another FMU, other inputs, or another mode of rounding.",
        "Parameters: <code>reference/parameters.json</code> by element, "
        "<code>extra/org.fmi-standard.fmi-ls-ref/parameters.ssv</code> as SSV.",
    ]
    if files:
        notes.append(
            f"The texts {', '.join(files)} name files beside in.csv: make <code>documentation/reference</code> the working directory."
        )
    if arrays:
        notes.append("The elements of an array stand in one column, separated by blanks, in C order.")
    items = "".join(f"<li>{note}</li>" for note in notes)
    title = f"{escape(name)}: reference experiment"
    head = f'<head><meta charset="utf-8"><title>{title}</title></head>'
    return f'<!DOCTYPE html>\n<html lang="en">{head}<body><h1>{title}</h1><ul>{items}</ul></body></html>\n'
