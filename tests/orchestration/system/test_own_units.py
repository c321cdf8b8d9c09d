"""Specification of units that only an FMU knows: written values come to it over the base units that it gives."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from fmpy.model_description import read_model_description

from robomill.models.model.units import convert
from robomill.orchestration.system.own_units import by_definition
from tests.tolerances import ROUNDOFF

XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Drive" guid="x">
  <CoSimulation modelIdentifier="drive"/>
  <UnitDefinitions>
    <Unit name="Umdrehungen"><BaseUnit rad="1" s="-1" factor="6.283185307179586"/></Unit>
    <Unit name="Grad"><BaseUnit K="1" offset="273.15"/></Unit>
    <Unit name="Balken"><BaseUnit/></Unit>
    <Unit name="N"><BaseUnit/></Unit>
  </UnitDefinitions>
  <ModelVariables/><ModelStructure/>
</fmiModelDescription>"""


@pytest.fixture(scope="module")
def definitions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, SimpleNamespace]:
    file = tmp_path_factory.mktemp("fmu") / "modelDescription.xml"
    Path(file).write_text(XML, encoding="utf-8")
    return {u.name: u for u in read_model_description(str(file.parent), validate=False).unitDefinitions}


@pytest.mark.parametrize(
    ("value", "unit", "wanted", "expected"),
    [
        (120.0, "rpm", "Umdrehungen", 2.0),
        (3.0, "Umdrehungen", "Umdrehungen", 3.0),
        (25.0, "degC", "Grad", 25.0),
        (2.0, "kN", "N", 2000.0),
    ],
)
def test_a_value_comes_to_a_unit_of_the_fmu(
    definitions: dict[str, SimpleNamespace], value: float, unit: str, wanted: str, expected: float
) -> None:
    assert abs(by_definition(convert, definitions)(value, unit, wanted) - expected) <= 10.0 * ROUNDOFF * expected


@pytest.mark.parametrize(
    ("value", "unit", "wanted", "text"),
    [
        (2.0, "mm", "Umdrehungen", "2 mm cannot be expressed in 'Umdrehungen', which is no unit that is known here"),
        (2.0, "", "Grad", '2 has no unit; expected a text with one, such as "2 Grad"'),
        (2.0, "m", "Balken", "2 m cannot be expressed in 'Balken'"),
        (2.0, "m", "furlong", "2 m cannot be expressed in 'furlong'"),
        (2.0, "m", "N", "2 m cannot be expressed in N: it measures something else; units that fit: N, mN, kN"),
    ],
)
def test_what_does_not_fit_is_refused_as_ever(
    definitions: dict[str, SimpleNamespace], value: float, unit: str, wanted: str, text: str
) -> None:
    with pytest.raises(ValueError, match=f"^{text}"):
        by_definition(convert, definitions)(value, unit, wanted)
