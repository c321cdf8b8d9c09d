"""fmus.model_description, fmus.fmi2, fmus.documentation, fmus.archive and fmus.probe: what stands in an FMU."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from xml.etree.ElementTree import Element, fromstring

import fmpy
import pytest
from fmpy.validation import validate_fmu

from robomill.fmus import archive, probe
from robomill.fmus.components import COMPONENTS, NAMES
from robomill.fmus.documentation import index_html
from robomill.fmus.interface import Interface
from robomill.models.model.declaration import Model, Record, Variable
from tests.fmus import demo
from tests.tolerances import ROUNDOFF

Built = Callable[[str], Path]


@pytest.fixture
def xml(built: Built) -> Element:
    with zipfile.ZipFile(built("demo")) as fmu:
        return fromstring(fmu.read("modelDescription.xml"))


def found(xml: Element, path: str) -> Element:
    element = xml.find(path)
    assert element is not None, path
    return element


@pytest.mark.parametrize("name", [*NAMES, "demo"])
def test_the_validator_finds_nothing(built: Built, name: str) -> None:
    assert validate_fmu(str(built(name))) == []


@pytest.mark.parametrize("name", NAMES)
def test_every_variable_has_a_unit_and_a_description(built: Built, name: str) -> None:
    description = fmpy.read_model_description(str(built(name)))
    assert [v.name for v in description.modelVariables if not v.description or (v.type == "Real" and not v.unit)] == []
    assert {u.name for u in description.unitDefinitions} == {v.unit for v in description.modelVariables if v.unit}


def test_attributes_of_the_co_simulation(xml: Element) -> None:
    attributes = found(xml, "CoSimulation").attrib
    assert attributes["modelIdentifier"] == "demo"
    assert attributes["needsExecutionTool"] == "false"
    assert attributes["canHandleVariableCommunicationStepSize"] == "true"
    assert attributes["canGetAndSetFMUstate"] == attributes["canSerializeFMUstate"] == "true"
    assert found(xml, "DefaultExperiment").attrib["stepSize"] == "0.004"
    assert "generationDateAndTime" not in xml.attrib


def test_display_units_convert_from_si(xml: Element) -> None:
    """FMI 2.0, 2.2.2: value in display unit = factor * value in unit + offset. 1 m = 1000 mm; 2 pi rad/s = 60 rpm."""
    assert found(xml, "UnitDefinitions/Unit[@name='m']/DisplayUnit[@name='mm']").attrib["factor"] == "1000.0"
    rpm = float(found(xml, "UnitDefinitions/Unit[@name='rad/s']/DisplayUnit[@name='rpm']").attrib["factor"])
    assert rpm == pytest.approx(60.0 / (2.0 * 3.141592653589793), rel=ROUNDOFF)
    assert found(xml, "UnitDefinitions/Unit[@name='N/m']/BaseUnit").attrib == {"kg": "1", "s": "-2"}


def test_a_variable_has_unit_bounds_start_and_display_unit(xml: Element) -> None:
    stiffness = found(xml, "ModelVariables/ScalarVariable[@name='stiffness[2,1]']")
    assert stiffness.attrib["variability"] == "fixed"
    assert found(stiffness, "Real").attrib == {"unit": "N/m", "min": "0.0", "max": "1000000.0", "start": "50.0"}
    assert found(xml, "ModelVariables/ScalarVariable[@name='x[1]']/Real").attrib == {"unit": "m", "displayUnit": "mm", "start": "0.0"}
    assert found(xml, "ModelVariables/ScalarVariable[@name='enable']/Boolean").attrib == {"start": "true"}
    assert found(xml, "ModelVariables/ScalarVariable[@name='curve']/String").attrib == {"start": ""}
    assert found(xml, "ModelVariables/ScalarVariable[@name='force[1]']/Real").attrib == {"unit": "N"}


def test_outputs_name_what_they_follow_at_once(xml: Element) -> None:
    names = [v.attrib["name"] for v in found(xml, "ModelVariables")]

    def follows(part: str, output: str) -> set[str]:
        entry = found(xml, f"ModelStructure/{part}/Unknown[@index='{names.index(output) + 1}']")
        return {names[int(i) - 1] for i in entry.attrib["dependencies"].split()}

    assert follows("Outputs", "force[2]") == {"x[1]", "x[2]"}
    assert follows("Outputs", "count") == set()
    assert follows("InitialUnknowns", "on") == {"enable", "number", "stiffness[1,1]", "stiffness[2,1]", "drift", "curve"}


def test_initial_dependencies_are_found_by_trying() -> None:
    """A delay: in a step it follows nothing, at the start it shows its input."""

    def init(s: Record) -> int:
        for i in range(2):
            s.y[i] = s.u[i]
        return 0

    def step(s: Record, t: float, h: float) -> int:
        return 0 if abs(h - 0.004) < 1e-9 else 1

    model = Model(
        "delay",
        "One step late",
        (
            Variable("u", "input", "In", "m", (2,)),
            Variable("w", "input", "Not used", "m"),
            Variable("y", "output", "Out", "m", (2,), depends_on=()),
        ),
        init,
        step,
        ("", "wrong step"),
    )
    interface = Interface(model)
    assert probe.initial_dependencies(interface, plain=True) == {"y[1]": ("u[1]", "u[2]"), "y[2]": ("u[1]", "u[2]")}
    assert not probe.accepts_other_steps(interface, plain=True)
    assert probe.accepts_other_steps(Interface(demo.MODEL))


@pytest.mark.parametrize(("name", "expected"), [("robot_drive", False), ("sensor_chain", False), ("milling_force", True)])
def test_components_that_count_cycles_say_that_they_need_their_step(name: str, expected: bool) -> None:
    assert probe.accepts_other_steps(Interface(COMPONENTS[name])) is expected


def test_the_documentation_has_ports_parameters_and_the_page_without_raw_markup() -> None:
    html = index_html(Interface(demo.MODEL), "test", ["a < b"], page="# Equations\n\n| a | b |\n|---|---|\n| 1 | 2 |\n\n<script>x</script>")
    assert html.count("<h1>") == 1
    assert "<td>1</td>" in html
    assert "<script>" not in html
    assert "Springs &lt;with&gt; a table &amp; an effect" in html
    assert "<code>stiffness[2,1]</code>" in html
    assert "a &lt; b" in html
    assert "follows at once: enable, number" in html


def test_an_archive_is_the_same_whenever_it_is_written(tmp_path: Path) -> None:
    content = {"b.txt": b"2", "modelDescription.xml": b"<x/>", "a/c.txt": b"1"}
    archive.write(tmp_path / "1.fmu", content)
    archive.write(tmp_path / "new" / "2.fmu", dict(reversed(content.items())))
    assert (tmp_path / "1.fmu").read_bytes() == (tmp_path / "new" / "2.fmu").read_bytes()
    with zipfile.ZipFile(tmp_path / "1.fmu") as fmu:
        assert fmu.namelist() == ["modelDescription.xml", "a/c.txt", "b.txt"]
        assert {e.date_time for e in fmu.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    assert [f.name for f in tmp_path.glob(".*")] == []
