"""SSP packages: the same numbers after a round trip, valid by the standard's schema, and what others write."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.ssp.ssd import get_connections, read_ssd
from lxml import etree

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import OrchestrationError, SlaveError, SystemFileError, WiringError
from robomill.orchestration.loop.acceleration import Iteration
from robomill.orchestration.ssp.export import export
from robomill.orchestration.ssp.importing import open_ssp
from robomill.orchestration.system.definition import Component, Connection, Recording, System
from tests.orchestration import c_fmu, c_fmu3
from tests.tolerances import ROUNDOFF

SCHEMAS = Path(fmpy.__file__).parent / "ssp/schema"


@pytest.fixture(scope="module")
def euler(tmp_path_factory) -> Path:
    if c_fmu.compiler() is None:
        pytest.skip("no C compiler here")
    return c_fmu.build(tmp_path_factory.mktemp("c"))


@pytest.fixture
def system(euler, tmp_path) -> System:
    """Three Euler FMUs in a ring with one delay, arrays apart everything that a system can say."""
    (tmp_path / "täble 1.npy").write_bytes(b"some table")
    components = (
        Component("a", str(euler), {"gain": 0.1 + 0.2, "label": {"file": str(tmp_path / "täble 1.npy")}}, inputs={"u": 2.5}),
        Component("b", str(euler), {"gain": 3.0}),
        Component("c", str(euler), isolate=True, time_limit=5.0),
    )
    connections = (
        Connection("a.twice", "b.u"),
        Connection("b.twice", "c.u", delayed=True),
        Connection("a.n", "b.offset"),
        Connection("b.on", "c.invert"),
    )
    recording = Recording(("a", "b.y", "c.*"), every=2, chunk=10)
    return System(
        "ring", 0.01, components, connections, stop=0.5, recording=recording, labels={"robot": "R", "repeat": 3}, stop_when="c.on"
    )


class TestRoundTrip:
    """A system, its package, and the system read from it."""

    def test_same_numbers(self, system, tmp_path):
        before = run(replace(system, stop_when=None))
        with open_ssp(export(system, tmp_path / "x/ring.ssp")) as package:
            after = run(replace(package.system, stop_when=None))
        assert list(before.columns) == list(after.columns)
        assert before.ports == after.ports
        for name in before.columns:
            assert np.array_equal(before[name], after[name]), name
        assert np.ptp(before["c.y"]) > 0.0
        assert before["a.twice"][0] == 5.0

    def test_same_system(self, system, tmp_path):
        with open_ssp(export(system, tmp_path / "ring.ssp")) as package:
            got = package.system
            assert package.start == 0.0
            for name in ("name", "step", "stop", "stop_when", "algorithm", "recording", "labels", "require_connected", "check_ranges"):
                assert getattr(got, name) == getattr(system, name), name
            assert [str(c) for c in got.connections] == [str(c) for c in system.connections]
            assert [c.delayed for c in got.connections] == [False, True, False, False]
            assert [(c.name, c.isolate, c.time_limit) for c in got.components] == [
                (c.name, c.isolate, c.time_limit) for c in system.components
            ]
            assert got.components[0].parameters["gain"] == 0.1 + 0.2
            assert got.components[0].inputs == {"u": 2.5}
            file = got.folder / got.components[0].parameters["label"]["file"]
            assert file.read_bytes() == b"some table"
        assert not file.exists()

    def test_iterated_and_rates(self, system, tmp_path):
        settings = Iteration("anderson", tolerance=1e-6, depth=3, hold="mean")
        components = tuple(
            replace(c, isolate=False, time_limit=60.0, rate=r, every=e)
            for c, r, e in zip(system.components, (1, 2, 1), (1, 1, 3), strict=True)
        )
        made = replace(system, algorithm="iterated", iteration=settings, components=components, recording=Recording())
        with open_ssp(export(made, tmp_path / "ring.ssp")) as package:
            assert (package.system.algorithm, package.system.iteration) == ("iterated", settings)
            assert [(c.rate, c.every) for c in package.system.components] == [(1, 1), (2, 1), (1, 3)]
            before, after = run(replace(made, stop_when=None)), run(replace(package.system, stop_when=None))
        for name in before.columns:
            assert np.array_equal(before[name], after[name]), name

    def test_same_bytes(self, system, tmp_path):
        assert export(system, tmp_path / "1.ssp").read_bytes() == export(system, tmp_path / "2.ssp").read_bytes()

    def test_resume(self, system, tmp_path):
        """The folder it is unpacked to is another one each time; that is no other system."""
        file = export(replace(system, stop_when=None, recording=Recording(checkpoint_every=10)), tmp_path / "ring.ssp")
        with open_ssp(file) as package:
            run(package.system, tmp_path / "whole")
            run(package.system, tmp_path / "r", stop=0.3)
        with open_ssp(file) as package:
            again = run(package.system, tmp_path / "r", resume=True)
        assert again.info["resumed"] == [0.2]
        whole = run(replace(system, stop_when=None, recording=Recording()))
        assert all(np.array_equal(whole[n], again[n]) for n in whole.columns)


class TestProfile:
    """The form that every importer reads."""

    @pytest.fixture
    def package(self, system, tmp_path) -> Path:
        return export(system, tmp_path / "ring.ssp")

    def parse(self, package: Path, name: str, schema: str) -> etree._Element:
        with zipfile.ZipFile(package) as z:
            tree = etree.fromstring(z.read(name))
        etree.XMLSchema(etree.parse(str(SCHEMAS / schema))).assertValid(tree)
        return tree

    def test_valid_by_the_schemas(self, package):
        ssd = self.parse(package, "SystemStructure.ssd", "SystemStructureDescription.xsd")
        assert (ssd.get("version"), ssd.prefix, ssd[0].prefix) == ("1.0", "ssd", "ssd")
        for name in ("resources/a.ssv", "resources/b.ssv"):
            ssv = self.parse(package, name, "SystemStructureParameterValues.xsd")
            assert (ssv.get("version"), ssv.get("name"), ssv.prefix) == ("1.0", "default", "ssv")

    def test_files(self, package):
        with zipfile.ZipFile(package) as z:
            names = z.namelist()
        assert names == ["SystemStructure.ssd", "resources/a.ssv", "resources/a_label.npy", "resources/b.ssv", "resources/euler.fmu"]

    def test_flat_and_only_what_is_connected(self, package):
        """As FMPy reads it: it fails on inputs that nothing is connected to."""
        ssd = read_ssd(package)
        assert ssd.system.connectors == []
        assert [c.name for c in ssd.system.elements] == ["a", "b", "c"]
        connectors = [(e.name, c.name, c.kind) for e in ssd.system.elements for c in e.connectors]
        assert ("a", "twice", "output") in connectors
        assert ("a", "u", "input") not in connectors
        assert len(get_connections(ssd.system)) == 4

    def test_units(self, package):
        ssd = self.parse(package, "SystemStructure.ssd", "SystemStructureDescription.xsd")
        units = {u.get("name"): dict(u[0].attrib) for u in ssd.iter("{*}Unit")}
        assert units == {"1": {}, "m": {"m": "1"}}
        assert {c.get("unit") for c in ssd.iter("{*}Real")} == {"1"}

    def test_the_step_is_where_others_look(self, package):
        ssd = self.parse(package, "SystemStructure.ssd", "SystemStructureDescription.xsd")
        (osp,) = ssd.iterfind(
            "{*}DefaultExperiment/{*}Annotations/{*}Annotation[@type='com.opensimulationplatform']/{*}Algorithm/{*}FixedStepAlgorithm"
        )
        assert osp.get("baseStepSize") == "0.01"
        (oms,) = ssd.iterfind("{*}System/{*}Annotations/{*}Annotation[@type='org.openmodelica']//{*}FixedStepMaster")
        assert oms.get("stepSize") == "0.01"

    def test_the_times_are_where_others_look(self, package):
        ssd = self.parse(package, "SystemStructure.ssd", "SystemStructureDescription.xsd")
        (experiment,) = ssd.iterfind("{*}DefaultExperiment")
        assert dict(experiment.attrib) == {"startTime": "0.0", "stopTime": "0.5"}

    def test_as_omsimulator_reads_it(self, package):
        """Version 2 takes another child of the root for a fault and of a system's annotations reads the first; 3 reads attributes."""
        ssd = self.parse(package, "SystemStructure.ssd", "SystemStructureDescription.xsd")
        assert {etree.QName(e).localname for e in ssd} <= {"System", "Enumerations", "Units", "DefaultExperiment"}
        annotations = ssd.findall("{*}System/{*}Annotations/{*}Annotation")
        assert [a.get("type") for a in annotations] == ["org.openmodelica", "com.github.robomill"]
        assert annotations[0][0].tag == "{https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd}Annotations"
        (simulation,) = annotations[0][0]
        assert dict(simulation.attrib) == {"name": "oms_ma_default", "method": "oms_ma", "fixedStepSize": "0.01"}
        assert [dict(e.attrib) for e in simulation] == [
            {"description": "oms-ma", "stepSize": "0.01", "absoluteTolerance": "1e-4", "relativeTolerance": "1e-4"}
        ]

    def test_packages_of_earlier_versions(self, package, tmp_path):
        """Those had what only our master knows at the root."""
        old = tmp_path / "old.ssp"
        with zipfile.ZipFile(package) as source, zipfile.ZipFile(old, "w") as target:
            for name in source.namelist():
                data = source.read(name)
                if name == "SystemStructure.ssd":
                    root = etree.fromstring(data)
                    ours = root.findall("{*}System/{*}Annotations/{*}Annotation")[1]
                    etree.SubElement(root, root[0].tag.replace("System", "Annotations")).append(ours)
                    data = etree.tostring(root)
                target.writestr(name, data)
        with open_ssp(old) as moved, open_ssp(package) as new:
            assert replace(moved.system, file=None) == replace(new.system, file=None)
            assert moved.system.algorithm == "gauss-seidel"

    def test_not_of_fmus(self, tmp_path):
        with pytest.raises(SystemFileError, match=r"an SSP holds FMUs; not one yet: g \(mock\), r \(replay:x\): build them"):
            export(System("s", 0.1, (Component("g", "mock"), Component("r", "replay:x"))), tmp_path / "s.ssp")

    def test_not_of_fmi_3(self, euler, tmp_path):
        new = c_fmu3.build(tmp_path, c_fmu3.PLAIN)
        made = System("s", 0.1, (Component("a", str(euler)), Component("b", str(new)), Component("c", str(new), rate=2)))
        with pytest.raises(SystemFileError, match=r"an SSP 1.0 connects FMUs of FMI 2.0; of FMI 3.0: b, c: build them with --fmi 2"):
            export(made, tmp_path / "s.ssp")

    def test_two_fmus_of_one_name(self, euler, tmp_path):
        (tmp_path / "other").mkdir()
        other = c_fmu.build(tmp_path / "other", c_fmu.SOURCE.replace("y += h", "y += 2 * h"))
        made = System("s", 0.1, (Component("a", str(euler)), Component("b", str(other))), stop=1.0)
        before = run(made)
        with open_ssp(export(made, tmp_path / "s.ssp")) as package:
            assert [c.source for c in package.system.components] == ["resources/euler.fmu", "resources/euler_2.fmu"]
            assert np.array_equal(run(package.system)["b.y"], before["b.y"])


FOREIGN = """<?xml version="1.0"?>
<ssd:SystemStructureDescription version="1.0" name="theirs" xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription">
 <ssd:System name="root">
  <ssd:Connectors><ssd:Connector name="in" kind="input"><ssc:Real/></ssd:Connector></ssd:Connectors>
  <ssd:ParameterBindings>
   <ssd:ParameterBinding source="parameters/all%20of%20them.ssv"/>
  </ssd:ParameterBindings>
  <ssd:Elements>
   <ssd:Component name="the first.one" source="fmus/eul%C3%A9r.fmu" type="application/x-fmu-sharedlibrary">
    <ssd:Connectors>
     <ssd:Connector name="u" kind="input"><ssc:Real/></ssd:Connector><ssd:Connector name="twice" kind="output"><ssc:Real/></ssd:Connector>
    </ssd:Connectors>
    <ssd:ParameterBindings>
     <ssd:ParameterBinding prefix="ga"><ssd:ParameterValues>
      <ssv:ParameterSet version="1.0" name="x"><ssv:Parameters>
       <ssv:Parameter name="in"><ssv:Real value="7"/></ssv:Parameter></ssv:Parameters></ssv:ParameterSet>
     </ssd:ParameterValues></ssd:ParameterBinding>
    </ssd:ParameterBindings>
   </ssd:Component>
   <ssd:Component name="2" source="fmus/eul%C3%A9r.fmu" implementation="CoSimulation">
    <ssd:Connectors>
     <ssd:Connector name="u" kind="input"/>
     <ssd:Connector name="y" kind="output"/>
    </ssd:Connectors>
   </ssd:Component>
  </ssd:Elements>
  <ssd:Connections>
   <ssd:Connection startElement="2" startConnector="u" endElement="the first.one" endConnector="twice"/>
   <ssd:Connection startConnector="in" endElement="the first.one" endConnector="u"/>
   <ssd:Connection startElement="2" startConnector="y" endConnector="out"/>
  </ssd:Connections>
 </ssd:System>
 <ssd:DefaultExperiment startTime="10" stopTime="10.5">
  <ssd:Annotations><ssc:Annotation type="com.opensimulationplatform">
   <osp:Algorithm><osp:FixedStepAlgorithm baseStepSize="1e-1"/></osp:Algorithm></ssc:Annotation></ssd:Annotations>
 </ssd:DefaultExperiment>
</ssd:SystemStructureDescription>
"""
PARAMETERS = """<ssv:ParameterSet version="1.0" name="p"><ssv:Parameters>
 <ssv:Parameter name="2.gain"><ssv:Real value="3" unit="1"/></ssv:Parameter>
 <ssv:Parameter name="the first.one.u"><ssv:Real value="1.5"/></ssv:Parameter>
 <ssv:Parameter name="2.label"><ssv:String value="text"/></ssv:Parameter>
 <ssv:Parameter name="in"><ssv:Real value="1.5"/></ssv:Parameter>
</ssv:Parameters></ssv:ParameterSet>"""


class TestOthers:
    """A package as other tools write them: undeclared prefixes, connections backwards, the outside, values for the whole system."""

    def package(self, euler: Path, folder: Path, *changes: tuple[str, str]) -> Path:
        ssd, ssv = FOREIGN, PARAMETERS
        for old, new in changes:
            assert (old in ssd) + (old in ssv) == 1, old
            ssd, ssv = ssd.replace(old, new), ssv.replace(old, new)
        with zipfile.ZipFile(folder / "theirs.ssp", "w") as z:
            z.writestr("SystemStructure.ssd", ssd)
            z.writestr("parameters/all of them.ssv", ssv)
            z.writestr("fmus/eulér.fmu", euler.read_bytes())
        return folder / "theirs.ssp"

    def test_runs(self, euler, tmp_path):
        with open_ssp(self.package(euler, tmp_path)) as package:
            s = package.system
            assert (package.start, s.stop, s.step, s.algorithm, s.name) == (10.0, 10.5, 0.1, "jacobi", "theirs")
            assert [c.name for c in s.components] == ["the_first_one", "2"]
            assert [str(c) for c in s.connections] == ["the_first_one.twice -> 2.u"]
            assert s.components[0].parameters == {"gain": 7.0}
            r = run(s, start=package.start)
        assert (r.t[0], r.t[-1]) == (10.0, 10.5)
        assert r["the_first_one.twice"].tolist() == [3.0] * 6
        # Jacobi: its input is 3.0 in every step, as it was at the start
        expected = [0.0]
        for _ in range(5):
            expected.append(expected[-1] + 0.1 * 3.0 * 3.0)
        assert np.allclose(r["2.y"], expected, rtol=ROUNDOFF, atol=0.0)

    def test_a_step_of_ones_own(self, euler, tmp_path):
        file = self.package(euler, tmp_path, ("osp:FixedStepAlgorithm", "osp:Other"))
        with (
            pytest.raises(SystemFileError, match=r"theirs.ssp: does not say how long a communication step is: give one \(--step\)"),
            open_ssp(file),
        ):
            pass
        with open_ssp(file, step=0.05) as package:
            assert package.system.step == 0.05

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            (('version="1.0" name="theirs"', 'version="3.0" name="theirs"'), r"is of SSP version '3.0'; only 1.0 and 2.0 can be read"),
            (
                ('<ssd:Component name="2"', '<ssd:SignalDictionaryReference name="bus"/><ssd:Component name="2"'),
                r"SignalDictionaryReference 'bus' cannot be read; only components and systems can: connect what it joins directly",
            ),
            (('name="2" source', 'name="the first.one" source'), r"component 'the first.one': its name is given twice"),
            (
                ('type="application/x-fmu-sharedlibrary"', 'type="application/x-ssp-package"'),
                r"of type 'application/x-ssp-package'; only FMUs",
            ),
            (
                ('implementation="CoSimulation"', 'implementation="ModelExchange"'),
                r"component '2' demands ModelExchange; only co-simulation",
            ),
            (
                ('source="fmus/eul%C3%A9r.fmu" impl', 'source="../x.fmu" impl'),
                r"component '2': source '../x.fmu' is not a file within the package",
            ),
            (
                ('source="fmus/eul%C3%A9r.fmu" impl', 'source="file:///x.fmu" impl'),
                r"source 'file:///x.fmu' is not a file within the package",
            ),
            (
                ('source="fmus/eul%C3%A9r.fmu" impl', 'source="fmus/x.fmu" impl'),
                r"there is no fmus/x.fmu in the package; available: .*fmus/eulér.fmu",
            ),
            (("all%20of%20them", "none"), r"parameters of the system: there is no parameters/none.ssv in the package"),
            (('prefix="ga"', 'type="text/csv"'), r"component 'the first.one': parameters of type 'text/csv' cannot be read"),
            (
                ('prefix="ga">', "><ssd:ParameterMapping/>"),
                r"parameter mapping of component 'the first.one': neither a source nor a ParameterMapping within",
            ),
            (('value="7"', 'value="seven"'), r"component 'the first.one': parameter 'in' = 'seven' is not of type Real"),
            (
                ('<ssv:Real value="7"/>', '<ssv:Binary value="00"/>'),
                r"parameter 'in' is of type Binary; expected a value of type Real, Float64, Float32, Integer",
            ),
            (
                ('endConnector="twice"/>', 'endConnector="twice"><ssc:LinearTransformation factor="2"/></ssd:Connection>'),
                r"a LinearTransformation cannot",
            ),
            (
                ('endElement="the first.one" endConnector="twice"', 'endElement="none" endConnector="twice"'),
                r"there is no component 'none'; available: the",
            ),
            (
                ('name="twice" kind="output"', 'name="twice" kind="calculatedParameter"'),
                r"connection of 2.u and the first.one.twice: parameters cannot be connected",
            ),
            (('baseStepSize="1e-1"', 'baseStepSize="fast"'), r"FixedStepAlgorithm: baseStepSize = 'fast' is not a value of type float"),
            (('baseStepSize="1e-1"', 'baseStepSize="0"'), r"step = 0.0 s is not a positive whole number of nanoseconds"),
            (('stopTime="10.5"', 'stopTime="inf"'), r"DefaultExperiment: stopTime = 'inf' is not a value of type float"),
            (("<ssd:System name", "<ssd:Other name"), r"SystemStructure.ssd is not valid XML: mismatched tag"),
            (('<?xml version="1.0"?>', '<!DOCTYPE x [<!ENTITY a "b">]>'), r"refused: SystemStructure.ssd has a document type declaration"),
            (('<ssv:ParameterSet version="1.0" name="p">', "<ssv:Other>"), r"parameters/all of them.ssv is not valid XML"),
        ],
    )
    def test_refused(self, euler, tmp_path, change, text):
        with pytest.raises(SystemFileError, match=text), open_ssp(self.package(euler, tmp_path, change)):
            pass

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            (('value="3" unit="1"', 'value="3" unit="mm"'), r"parameter 'gain': unit 'mm' cannot be converted to '1'"),
            (('value="3" unit="1"', 'value="-3" unit="1"'), r"parameter 'gain': -3 1 is below its minimum 0 1"),
        ],
    )
    def test_values_that_do_not_fit(self, euler, tmp_path, change, text):
        with open_ssp(self.package(euler, tmp_path, change)) as package, pytest.raises(SystemFileError, match=text):
            run(package.system, start=10.0)

    def test_values_that_fit_nothing_are_ignored_and_told(self, euler, tmp_path):
        """As the standard wants it: a parameter set may hold more than the system has."""
        with open_ssp(self.package(euler, tmp_path, ('name="2.gain"', 'name="2.gein"'))) as package:
            assert package.system.components[1].parameters == {"label": "text"}
            (text,) = package.ignored
        assert text.startswith("component '2': unknown variable 'gein'; did you mean 'gain'?")

    def test_connectors_that_the_fmu_does_not_have(self, euler, tmp_path):
        change = ('startElement="2" startConnector="u"', 'startElement="2" startConnector="v"')
        with open_ssp(self.package(euler, tmp_path, change)) as package, pytest.raises(WiringError, match=r"unknown input of '2': 'v'"):
            run(package.system)

    def test_not_a_package(self, tmp_path):
        (tmp_path / "a.ssp").write_text("hello")
        with pytest.raises(SlaveError, match=r"a.ssp: not a zip archive, so not an SSP"), open_ssp(tmp_path / "a.ssp"):
            pass
        with pytest.raises(SlaveError, match=r"b.ssp: no such file; SSPs in that folder: a.ssp"), open_ssp(tmp_path / "b.ssp"):
            pass
        c_fmu.pack(tmp_path / "c.ssp", "<x/>")
        with (
            pytest.raises(SystemFileError, match=r"c.ssp: no SystemStructure.ssd in it, so not an SSP; it holds modelDescription.xml"),
            open_ssp(tmp_path / "c.ssp"),
        ):
            pass

    def test_paths_that_escape(self, tmp_path):
        with zipfile.ZipFile(tmp_path / "a.ssp", "w") as z:
            z.writestr("SystemStructure.ssd", FOREIGN)
            z.writestr("../evil", "x")
        with pytest.raises(OrchestrationError, match=r"refused: entry '../evil'"), open_ssp(tmp_path / "a.ssp"):
            pass
