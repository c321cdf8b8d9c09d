"""Packages as other tools write them, by hand: nested systems, parameter mappings, SSP 2.0."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import SystemFileError
from robomill.orchestration.ssp.importing import open_ssp
from tests.orchestration import c_fmu, c_fmu3

pytestmark = pytest.mark.skipif(c_fmu.compiler() is None, reason="no C compiler here")

# In the style of OMSimulator and Orchideo: a cell with a station in it, which has a drive in it; connectors at every level
NESTED = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription" xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
  xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping" xmlns:oms="https://example.org/oms" name="cell" version="1.0">
 <ssd:System name="root">
  <ssd:ParameterBindings>
   <ssd:ParameterBinding source="resources/cell.ssv"><ssd:ParameterMapping source="resources/cell.ssm"/></ssd:ParameterBinding>
   <ssd:ParameterBinding prefix="station."><ssd:ParameterValues>
    <ssv:ParameterSet version="1.0" name="inline"><ssv:Parameters>
     <ssv:Parameter name="drive.motor.label"><ssv:String value="from the top"/></ssv:Parameter>
     <ssv:Parameter name="force"><ssv:Real value="4"/></ssv:Parameter>
    </ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding>
  </ssd:ParameterBindings>
  <ssd:Elements>
   <ssd:System name="station">
    <ssd:Connectors>
     <ssd:Connector name="in" kind="input"><ssc:Real/></ssd:Connector><ssd:Connector name="out" kind="output"><ssc:Real/></ssd:Connector>
     <ssd:Connector name="force" kind="parameter"><ssc:Real/></ssd:Connector>
    </ssd:Connectors>
    <ssd:Elements>
     <ssd:System name="drive">
      <ssd:Connectors>
       <ssd:Connector name="u" kind="input"><ssc:Real/></ssd:Connector><ssd:Connector name="y" kind="output"><ssc:Real/></ssd:Connector>
       <ssd:Connector name="g" kind="parameter"><ssc:Real/></ssd:Connector>
      </ssd:Connectors>
      <ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>
       <ssv:ParameterSet version="1.0" name="x"><ssv:Parameters>
        <ssv:Parameter name="motor.label"><ssv:String value="from within"/></ssv:Parameter>
       </ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>
      <ssd:Elements>
       <ssd:Component name="motor" type="application/x-fmu-sharedlibrary" source="resources/euler.fmu">
        <ssd:Connectors>
         <ssd:Connector name="u" kind="input"/><ssd:Connector name="twice" kind="output"/><ssd:Connector name="gain" kind="parameter"/>
        </ssd:Connectors>
       </ssd:Component>
      </ssd:Elements>
      <ssd:Connections>
       <ssd:Connection startConnector="u" endElement="motor" endConnector="u"/>
       <ssd:Connection startElement="motor" startConnector="twice" endConnector="y"/>
       <ssd:Connection startConnector="g" endElement="motor" endConnector="gain"/>
      </ssd:Connections>
     </ssd:System>
     <ssd:Component name="load" source="resources/euler.fmu"/>
    </ssd:Elements>
    <ssd:Connections>
     <ssd:Connection startConnector="in" endElement="drive" endConnector="u"/>
     <ssd:Connection startElement="drive" startConnector="y" endConnector="out"/>
     <ssd:Connection startElement="load" startConnector="u" endConnector="out"/>
     <ssd:Connection startConnector="force" endElement="drive" endConnector="g"/>
    </ssd:Connections>
   </ssd:System>
   <ssd:Component name="source" source="resources/euler.fmu"/>
   <ssd:Component name="sink" source="resources/euler.fmu"/>
  </ssd:Elements>
  <ssd:Connections>
   <ssd:Connection startElement="station" startConnector="in" endElement="source" endConnector="twice"/>
   <ssd:Connection startElement="station" startConnector="out" endElement="sink" endConnector="u"/>
  </ssd:Connections>
  <ssd:Annotations><ssc:Annotation type="org.openmodelica"><oms:Annotations><oms:SimulationInformation>
   <oms:FixedStepMaster description="oms-ma" stepSize="0.1"/>
  </oms:SimulationInformation></oms:Annotations></ssc:Annotation></ssd:Annotations>
 </ssd:System>
 <ssd:DefaultExperiment startTime="0" stopTime="1"/>
</ssd:SystemStructureDescription>
"""
VALUES = """<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="cell">
 <ssv:Parameters>
  <ssv:Parameter name="Strength"><ssv:Real value="1.5" unit="1"/></ssv:Parameter>
  <ssv:Parameter name="Percent"><ssv:Real value="250"/></ssv:Parameter>
  <ssv:Parameter name="Kind"><ssv:Integer value="1"/></ssv:Parameter>
  <ssv:Parameter name="Off"><ssv:Boolean value="false"/></ssv:Parameter>
  <ssv:Parameter name="sink.gain"><ssv:Real value="99"/></ssv:Parameter>
 </ssv:Parameters></ssv:ParameterSet>"""
MAPPING = """<ssm:ParameterMapping xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping" version="1.0">
 <ssm:MappingEntry source="Strength" target="source.u"/>
 <ssm:MappingEntry source="Percent" target="sink.gain"><ssc:LinearTransformation factor="0.01" offset="0.5"/></ssm:MappingEntry>
 <ssm:MappingEntry source="Percent" target="station.load.gain"><ssc:LinearTransformation factor="0.01"/></ssm:MappingEntry>
 <ssm:MappingEntry source="Kind" target="sink.offset"><ssc:IntegerMappingTransformation>
  <ssc:MapEntry source="1" target="7"/></ssc:IntegerMappingTransformation></ssm:MappingEntry>
 <ssm:MappingEntry source="Off" target="sink.invert"><ssc:BooleanMappingTransformation>
  <ssc:MapEntry source="false" target="true"/></ssc:BooleanMappingTransformation></ssm:MappingEntry>
 <ssm:MappingEntry source="NotThere" target="sink.label"/>
</ssm:ParameterMapping>"""


@pytest.fixture(scope="module")
def euler(tmp_path_factory) -> Path:
    return c_fmu.build(tmp_path_factory.mktemp("c"))


def package(folder: Path, files: dict[str, str | bytes], *changes: tuple[str, str]) -> Path:
    """A package of texts and FMUs; each change hits exactly one place."""
    texts = {name: content for name, content in files.items() if isinstance(content, str)}
    for old, new in changes:
        assert sum(text.count(old) for text in texts.values()) == 1, old
        texts = {name: text.replace(old, new) for name, text in texts.items()}
    with zipfile.ZipFile(folder / "theirs.ssp", "w") as z:
        for name, content in {**files, **texts}.items():
            z.writestr(name, content)
    return folder / "theirs.ssp"


@pytest.fixture(scope="module")
def nested(euler) -> dict[str, str | bytes]:
    resources = {"resources/cell.ssv": VALUES, "resources/cell.ssm": MAPPING, "resources/euler.fmu": euler.read_bytes()}
    return {"SystemStructure.ssd": NESTED, **resources}


class TestNested:
    """Systems within systems become one flat system."""

    def test_components_connections_and_values(self, nested, tmp_path):
        with open_ssp(package(tmp_path, nested)) as p:
            s = p.system
            assert (s.step, s.stop, s.algorithm, p.ignored) == (0.1, 1.0, "jacobi", ())
            assert [str(c) for c in s.connections] == [
                "source.twice -> station_drive_motor.u",
                "station_drive_motor.twice -> station_load.u",
                "station_drive_motor.twice -> sink.u",
            ]
            assert {c.name: (dict(c.parameters), dict(c.inputs)) for c in s.components} == {
                "station_drive_motor": ({"label": "from the top", "gain": 4.0}, {}),
                "station_load": ({"gain": 2.5}, {}),
                "source": ({}, {"u": {"value": 1.5, "unit": "1"}}),
                "sink": ({"gain": 3.0}, {"offset": 7, "invert": True}),
            }
            r = run(s)
        # source: u = 1.5, so 3, 6 and 12 from twice to twice, one step later each (Jacobi, but all at t = 0)
        assert r["source.twice"].tolist() == [3.0] * 11
        assert r["station_drive_motor.twice"].tolist() == [6.0] * 11
        assert r["sink.n"][-1] == 7 + 10
        expected = [0.0]
        for _ in range(10):
            expected.append(expected[-1] + 0.1 * 3.0 * 6.0)
        assert r["sink.y"].tolist() == expected  # the same arithmetic: EXACT

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            (
                ('startElement="load" startConnector="u"', 'startElement="load" startConnector="twice"'),
                r"connection of .*: 2 outputs are joined; an input can have one source only",
            ),
            (
                ('endElement="drive" endConnector="g"', 'endElement="motor" endConnector="g"'),
                r"connection force -> motor.g in system 'station': there is no component 'motor'; available: drive, load",
            ),
            (('<ssd:Component name="load"', '<ssd:Component name="drive"'), r"component 'station.drive': its name is given twice"),
            (
                ('name="sink" source', 'name="sink" type="application/x-ssp-package" source'),
                r"component 'sink' is of type 'application/x-ssp-package'",
            ),
            (
                ('source="resources/cell.ssm"', 'sourceBase="component" source="resources/cell.ssm"'),
                r"parameter mapping of the system inside an FMU \(sourceBase = 'component'\) cannot be read",
            ),
            (
                ('source="resources/cell.ssm"', 'source="resources/cell.ssv"'),
                r"resources/cell.ssv is a ParameterSet; expected a ParameterMapping",
            ),
            (
                ('<ssv:Integer value="1"/>', '<ssv:Real value="1"/>'),
                r"a IntegerMappingTransformation does not go with a value of type Real",
            ),
            (
                ('factor="0.01" offset', 'factor="one" offset'),
                r"mapping of parameter 'Percent' to 'sink.gain': LinearTransformation: could not convert",
            ),
            (
                ('value="250"', 'value="250" unit="%"'),
                r"parameter 'gain': its mapping transforms a value in '%' that is wanted in None: give it in that unit",
            ),
            (
                ("<ssd:ParameterMapping source", '<ssd:ParameterMapping type="text/csv" source'),
                r"a parameter mapping of type 'text/csv' cannot be read",
            ),
        ],
    )
    def test_refused(self, nested, tmp_path, change, text):
        with pytest.raises(SystemFileError, match=text), open_ssp(package(tmp_path, nested, change)):
            pass

    def test_without_unit_conversion(self, nested, tmp_path):
        suppressed = ('source="Percent" target="sink.gain"', 'source="Percent" target="sink.gain" suppressUnitConversion="true"')
        other = ('source="Percent" target="station.load.gain"', 'source="None" target="station.load.gain"')
        with open_ssp(package(tmp_path, nested, ('value="250"', 'value="250" unit="%"'), suppressed, other)) as p:
            assert p.system.component("sink").parameters == {"gain": 3.0}


# SSP 2.0: types and arrays of FMI 3.0, with Dimension; values of arrays as lists; items of enumerations by name
TWO = """<?xml version="1.0" encoding="UTF-8"?>
<SystemStructureDescription version="2.0" name="two">
 <System name="root">
  <Elements>
   <Component name="a" source="types.fmu">
    <Connectors>
     <Connector name="y" kind="output"><Float64 unit="N"/><Dimension size="2"/><Dimension size="3"/></Connector>
     <Connector name="out_Int32" kind="output"><Int32/><Dimension size="2"/></Connector>
    </Connectors>
    <ParameterBindings><ParameterBinding><ParameterValues><ParameterSet version="2.0" name="p"><Parameters>
     <Parameter name="gain"><Float64 value="1 2 3 4 5 6"/><Dimension size="2"/><Dimension size="3"/></Parameter>
     <Parameter name="limit"><Float64 value="1e8"/></Parameter>
     <Parameter name="in_Int32"><Int32 value="40 41"/><Dimension size="2"/></Parameter>
     <Parameter name="in_Int64"><Enumeration value="b"/></Parameter>
    </Parameters></ParameterSet></ParameterValues></ParameterBinding></ParameterBindings>
   </Component>
   <Component name="b" source="types.fmu">
    <Connectors>
     <Connector name="u" kind="input"><Float64 unit="N"/><Dimension size="2"/><Dimension size="3"/></Connector>
     <Connector name="in_Int32" kind="input"><Int32/><Dimension size="2"/></Connector>
    </Connectors>
   </Component>
  </Elements>
  <Connections>
   <Connection startElement="a" startConnector="y" endElement="b" endConnector="u"/>
   <Connection startElement="a" startConnector="out_Int32" endElement="b" endConnector="in_Int32"/>
  </Connections>
 </System>
 <DefaultExperiment startTime="0" stopTime="0.04"/>
</SystemStructureDescription>
"""


@pytest.fixture(scope="module")
def types(tmp_path_factory) -> bytes:
    description = c_fmu3.PLAIN.replace('<Int64 name="in_Int64"', '<Enumeration declaredType="Choice" name="in_Int64"').replace(
        'causality="input" start="0"/>', 'causality="input" start="1"/>'
    )
    return c_fmu3.build(tmp_path_factory.mktemp("c"), description).read_bytes()


class TestTwo:
    """SSP 2.0 with FMUs of FMI 3.0."""

    def test_arrays(self, types, tmp_path):
        with open_ssp(package(tmp_path, {"SystemStructure.ssd": TWO, "types.fmu": types}), step=0.004) as p:
            assert p.ignored == ()
            assert p.system.component("a").inputs == {"in_Int32": [40, 41], "in_Int64": 2}
            r = run(p.system)
        assert r["a.y"][1].tolist() == [[0.004 * g * 0.5 for g in row] for row in ((1, 2, 3), (4, 5, 6))]
        assert r["b.out_Int32"][-1].tolist() == [42.0, 43.0]
        assert r["a.out_Int64"][-1] == 3.0
        assert np.ptp(r["b.y[2,3]"]) > 0.0

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            (
                ('<Enumeration value="b"/>', '<Enumeration value="c"/>'),
                r"parameter 'in_Int64' = 'c' is not an item of its enumeration; items: a, b",
            ),
            (('value="1 2 3 4 5 6"', 'value="1 2 x"'), r"component 'a': parameter 'gain' = '1 2 x' is not of type Float64"),
            (('value="1 2 3 4 5 6"', 'value="1 2 3"'), r"parameter 'gain' has shape \[2, 3\]; found values of shape \[3\]"),
            (('<Int32 value="40 41"/>', '<Binary value="40"/>'), r"parameter 'in_Int32' is of type Binary; expected a value of type"),
        ],
    )
    def test_refused(self, types, tmp_path, change, text):
        file = package(tmp_path, {"SystemStructure.ssd": TWO, "types.fmu": types}, change)
        with pytest.raises(SystemFileError, match=text), open_ssp(file, step=0.004) as p:
            run(p.system)
