"""What FMUs carry for other tools: reference experiments that FMPy runs, FMI-LS-REF, provenance, bill of materials, terminals, icons."""

from __future__ import annotations

import json
import os
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import fmpy
import numpy as np
import pytest
from fmpy.util import read_csv
from lxml import etree

from robomill.fmus.components import COMPONENTS, NAMES
from robomill.fmus.interface import Interface
from robomill.fmus.native.builder import build
from robomill.fmus.provenance import EXTRA, commit, directory_hash
from robomill.fmus.reference import EXTRA as LS_REF
from robomill.fmus.reference import experiment_files, reference_files
from robomill.fmus.terminals import ICONS
from robomill.orchestration.ssp.parameter_set import given_by
from tests.tolerances import discretisation

SCHEMAS = Path(fmpy.__file__).parent / "schema/fmi3"
QUICK = ("robot_drive", "surface_contact")
"""Components that short test runs build, too: others differ in their ports only."""
ALL = [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in NAMES]
needs_linux = pytest.mark.skipif(sys.platform != "linux", reason="runs linux64 libraries")
LENGTH_OF_STEPS = discretisation(1e5, np.spacing(0.4) / 0.004, 1)
"""FMPy steps by the difference of two times, which is off by their rounding; 1e5: the gains of chattering and of differentiated signals."""


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Path of the native FMU of a component with its reference experiment, unpacked."""
    folder = tmp_path_factory.mktemp("exchange")

    def unpacked(name: str, fmi: Literal[2, 3], arrays: bool = True) -> Path:
        place = folder / f"{fmi}{arrays}" / name
        if not place.is_dir():
            file = build(COMPONENTS[name], place.with_suffix(".fmu"), fmi=fmi, arrays=arrays, reference=reference_files(name))
            fmpy.extract(str(file), unzipdir=str(place))
        return place

    return unpacked


@needs_linux
@pytest.mark.parametrize(("fmi", "arrays"), [(2, True), (3, False)])
@pytest.mark.parametrize("name", ALL)
def test_fmpy_reproduces_the_reference_experiment(
    name: str, fmi: Literal[2, 3], arrays: bool, fmu: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By `simulate_fmu` with its own reader of CSV files, as `fmpy simulate --input-file in.csv` does."""
    folder = fmu(name, fmi, arrays)
    monkeypatch.chdir(folder / "documentation/reference")  # where the tables are
    parameters = json.loads(Path("parameters.json").read_text())
    expected = read_csv("out.csv")
    found = simulate(folder, read_csv("in.csv"), parameters, expected["time"][-1])
    same_outputs(found, expected)


@needs_linux
@pytest.mark.parametrize("name", ["rate_controller", "surface_contact"])
def test_fmpy_reads_arrays_of_one_shape(name: str, fmu: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    folder = fmu(name, 3)
    monkeypatch.chdir(folder / "documentation/reference")
    interface = Interface(COMPONENTS[name])
    values = json.loads(Path("parameters.json").read_text())
    parameters: dict[str, Any] = {}
    for port in interface.parameters:
        if port.name in values:
            elements = interface.parameters[interface.arrays[port.variable]]
            parameters[port.variable] = [values.get(p.name, p.start) for p in elements] if len(elements) > 1 else values[port.name]
    inputs, expected = read_csv("in.csv"), read_csv("out.csv")
    assert name == "rate_controller" or inputs.dtype[1].shape
    same_outputs(simulate(folder, inputs, parameters, expected["time"][-1]), expected)


@needs_linux
def test_fmpy_cannot_read_arrays_of_different_shapes(fmu: Callable[..., Path]) -> None:
    """Its class Input stacks the inputs of a type into one array. Once it can, docs/exchange/fmpy.md says too little."""
    folder = fmu("robot_drive", 3)
    inputs = read_csv(folder / "documentation/reference/in.csv")
    assert {inputs.dtype[n].shape for n in inputs.dtype.names} == {(), (3,), (6,)}
    with pytest.raises(ValueError, match="all input arrays must have the same shape"):
        simulate(folder, inputs, {}, 0.1)


def simulate(folder: Path, inputs: Any, parameters: dict[str, Any], stop: float) -> Any:
    """FMPy's result."""
    return fmpy.simulate_fmu(str(folder), start_values=parameters, input=inputs, stop_time=float(stop), output_interval=0.004)


def same_outputs(found: Any, expected: Any) -> None:
    """Up to the lengths of steps, relative to the largest value of each signal."""
    assert len(found) == len(expected) > 100
    for name in expected.dtype.names:
        scale = np.abs(expected[name]).max()
        assert np.abs(found[name].reshape(expected[name].shape) - expected[name]).max() <= LENGTH_OF_STEPS * scale, name


@pytest.mark.parametrize(("fmi", "arrays"), [(2, True), (3, True), (3, False)])
def test_the_manifest_names_files_that_are_there(fmi: Literal[2, 3], arrays: bool, fmu: Callable[..., Path]) -> None:
    folder = fmu("robot_drive", fmi, arrays)
    manifest = etree.parse(str(folder / LS_REF / "fmi-ls-manifest.xml")).getroot()
    etree.XMLSchema(file=str(SCHEMAS / "fmi3LayeredStandardManifest.xsd"))  # the attributes below are those that it declares
    prefix = "{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-"
    assert (manifest.tag, manifest.get(f"{prefix}name")) == ("fmiReferences", "org.fmi-standard.fmi-ls-ref")
    assert manifest.get(f"{prefix}version") == "1.0.0-alpha.1"
    assert manifest.get(f"{prefix}description") == "Layered Standard providing information on related files included in an FMU."
    roles = {}
    for related in manifest:
        assert (folder / LS_REF / related.get("source")).resolve().is_file(), related.get("source")
        roles[related.get("role")] = Path(related.get("source")).name
    assert roles["experiment/smoke-test"] == "smoke-test.exp"
    assert (roles["result"], roles["parameter"]) == ("out.csv", "parameters.ssv")
    assert "in.csv" in (folder / "documentation/fmi-ls-ref.html").read_text()


def test_the_experiment_names_its_files_and_times(fmu: Callable[..., Path]) -> None:
    folder = fmu("robot_drive", 2)
    (experiment,) = etree.parse(str(folder / LS_REF / "smoke-test.exp")).getroot()
    assert dict(experiment.attrib) == {"name": "reference", "startTime": "0.0", "stopTime": "0.4", "stepSize": "0.004"}
    sources = {part.tag: (folder / LS_REF / part.get("source")).resolve() for part in experiment}
    assert list(sources) == ["Parameters", "Stimuli", "References"]
    assert all(file.is_file() for file in sources.values())
    times = read_csv(sources["Stimuli"])["time"]
    assert times.tolist() == [k * 0.004 for k in range(100)]  # bit by bit, else importers interpolate


def test_parameters_of_fmi_3_are_whole_arrays() -> None:
    interface = Interface(COMPONENTS["compensation_controller"])
    files = {"in.csv": b"t\n0.0\n", "out.csv": b"t\n0.0\n", "parameters.json": b'{"ki[2]": 0.5, "mode": 2}'}
    content, _ = experiment_files(interface, True, files)
    root = etree.fromstring(content[f"{LS_REF}/parameters.ssv"])
    assert root.get("version") == "2.0"
    ki, mode = root.iter("{*}Parameter")
    assert (ki.get("name"), ki[0].get("value").split()[1], ki[1].get("size")) == ("ki", "0.5", "3")
    assert (mode.get("name"), mode[0].get("value"), len(mode)) == ("mode", "2", 1)
    for element in ki.iter():
        element.tag = etree.QName(element).localname
    assert given_by(None, ki, "ki").value[1] == 0.5  # type: ignore[arg-type]  # files are for errors only


def test_the_statement_of_provenance_fits_the_content(fmu: Callable[..., Path]) -> None:
    folder = fmu("robot_drive", 2)
    statement = json.loads((folder / EXTRA / "provenance.json").read_text())
    assert (statement["_type"], statement["predicateType"]) == ("https://in-toto.io/Statement/v1", "https://slsa.dev/provenance/v1")
    (binaries,) = statement["subject"]
    file = "binaries/linux64/robot_drive.so"
    assert binaries == {"name": "binaries/", "digest": {"dirHash": directory_hash({file: (folder / file).read_bytes()})}}
    definition = statement["predicate"]["buildDefinition"]
    assert definition["externalParameters"] == {"component": "robot_drive", "backend": "native", "fmi": "2.0", "platforms": ["linux64"]}
    sources, *tools = definition["resolvedDependencies"]
    assert sources["digest"].get("gitCommit", "") == commit()
    assert {t["uri"].partition("@")[0] for t in tools} == {"pkg:pypi/numba", "pkg:pypi/llvmlite"}


def test_the_bill_of_materials(fmu: Callable[..., Path], built: Callable[[str], Path]) -> None:
    native = json.loads((fmu("robot_drive", 2) / EXTRA / "sbom.cdx.json").read_text())
    with zipfile.ZipFile(built("demo")) as archive:
        python = json.loads(archive.read(f"{EXTRA}/sbom.cdx.json"))
    for bill in (native, python):
        assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
        references = {"fmu", *(c["bom-ref"] for c in bill["components"])}
        assert len(references) == len(bill["components"]) + 1
        assert {d for entry in bill["dependencies"] for d in (entry["ref"], *entry["dependsOn"])} <= references
        assert not {"timestamp", "serialNumber"} & {*bill, *bill["metadata"]}
    scopes = {c["name"]: c["scope"] for c in python["components"]}
    assert scopes == {"pythonfmu": "required", "numpy": "required", "numba": "optional"}
    assert {c["name"] for c in native["components"] if c["scope"] == "required"} == {"C library of the system"}


@pytest.mark.parametrize(("fmi", "arrays"), [(2, True), (3, True), (3, False)])
def test_terminals_bundle_variables_that_there_are(fmi: Literal[2, 3], arrays: bool, fmu: Callable[..., Path]) -> None:
    folder = fmu("robot_drive", fmi, arrays)
    document = etree.parse(str(folder / "terminalsAndIcons/terminalsAndIcons.xml"))
    etree.XMLSchema(file=str(SCHEMAS / "fmi3TerminalsAndIcons.xsd")).assertValid(document)
    members = [(m.getparent().get("name"), m.get("memberName"), m.get("variableName")) for m in document.iter("TerminalMemberVariable")]
    assert {m[2] for m in members} <= {v.name for v in fmpy.read_model_description(str(folder)).modelVariables}
    whole = fmi == 3 and arrays
    assert (("wrench_T_B", "force", "f_T_B") if whole else ("wrench_T_B", "force[2]", "f_T_B[2]")) in members


@pytest.mark.parametrize("name", [*NAMES, "robomill"])
def test_every_component_has_an_icon(name: str) -> None:
    assert (ICONS / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert etree.parse(str(ICONS / f"{name}.svg")).getroot().get("viewBox") == "0 0 96 96"


@needs_linux
def test_the_command_line_of_fmpy(fmu: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """As docs/exchange/fmpy.md has it."""
    from fmpy.cli import main

    folder = fmu("surface_contact", 2)
    monkeypatch.chdir(folder / "documentation/reference")
    start = [text for name, value in json.loads(Path("parameters.json").read_text()).items() for text in (name, str(value))]
    options = ["--stop-time", "0.4", "--output-interval", "0.004", "--input-file", "in.csv", "--output-file", "found.csv"]
    monkeypatch.setattr(sys, "argv", ["fmpy", "simulate", os.fspath(folder.with_suffix(".fmu")), *options, "--start-values", *start])
    main()
    same_outputs(read_csv("found.csv"), read_csv("out.csv"))
