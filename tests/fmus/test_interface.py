"""robomill.fmus.interface: scalar variables and where they stand in the record."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.fmus.components import COMPONENTS, NAMES, component
from robomill.fmus.interface import Interface
from tests.fmus.demo import MODEL

DEMO = Interface(MODEL)


def test_ports_stand_in_the_order_inputs_outputs_parameters_as_declared() -> None:
    assert [p.name for p in DEMO.inputs] == ["x[1]", "x[2]", "enable", "speed", "number"]
    assert [p.name for p in DEMO.outputs] == ["force[1]", "force[2]", "count", "on", "delayed", "curve_value"]
    assert [p.name for p in DEMO.parameters] == ["stiffness[1,1]", "stiffness[2,1]", "drift", "curve"]
    assert DEMO.ports == (*DEMO.inputs, *DEMO.outputs, *DEMO.parameters)


def test_states_are_not_shown() -> None:
    assert not {"steps", "total", "time"} & set(DEMO.by_name)


@pytest.mark.parametrize("name", NAMES)
def test_a_value_reference_is_the_address_of_the_variable_in_the_record(name: str) -> None:
    model = COMPONENTS[name]
    interface = Interface(model)
    data = model.new()
    words = data.view(np.int64)
    for port in interface.ports:
        if port.type == "string":
            assert port.offset == model.dtype.fields[f"{port.name}_rows"][1]
            continue
        index = tuple(int(i) - 1 for i in port.name.partition("[")[2].rstrip("]").split(",") if i)
        before = words.copy()
        field = data[port.variable][0] if index else data[port.variable]
        field[index or 0] = 77 if port.type != "real" else 77.5
        changed = np.flatnonzero(words != before)
        assert changed.tolist() == [port.reference], port.name
        assert len({p.reference for p in interface.ports}) == len(interface.ports)


def test_real_inputs_and_real_outputs_are_contiguous_images() -> None:
    for name in NAMES:
        interface = Interface(COMPONENTS[name])
        for ports in (interface.inputs, interface.outputs):
            references = [p.reference for p in ports if p.type == "real"]
            assert references == list(range(references[0], references[0] + len(references)))


def test_attributes_follow_the_declaration() -> None:
    x, stiffness, drift, on, curve = (DEMO.by_name[n] for n in ("x[1]", "stiffness[2,1]", "drift", "on", "curve"))
    assert (x.unit, x.display_unit, x.variability, x.initial, x.start) == ("m", "mm", "continuous", None, 0.0)
    assert (stiffness.start, stiffness.minimum, stiffness.maximum, stiffness.variability) == (50.0, 0.0, 1e6, "fixed")
    assert drift.variability == "tunable"
    assert (on.type, on.variability, on.initial, on.unit) == ("boolean", "discrete", "calculated", None)
    assert (curve.type, curve.start) == ("string", "")
    assert "rows of 2 columns" in curve.description


def test_dependencies_are_elements_and_none_declared_means_all_inputs() -> None:
    assert DEMO.by_name["force[1]"].dependencies == ("x[1]", "x[2]")
    assert DEMO.by_name["count"].dependencies == ()
    assert DEMO.by_name["on"].dependencies == ("enable", "number")
    speed = Interface(COMPONENTS["sensor_chain"])
    assert speed.by_name["f_T_T[1]"].dependencies == tuple(p.name for p in speed.inputs)
    assert DEMO.by_name["x[1]"].dependencies is None


def test_slices_find_an_array_among_its_kind() -> None:
    assert DEMO.arrays["force"] == slice(0, 2)
    assert DEMO.arrays["delayed"] == slice(4, 5)
    assert [p.name for p in DEMO.parameters[DEMO.arrays["stiffness"]]] == ["stiffness[1,1]", "stiffness[2,1]"]


def test_an_unknown_component_is_refused_with_a_list_of_those_there_are() -> None:
    with pytest.raises(ValueError, match=r"unknown component 'mill'; available: path_interpolator, robot_drive, robot_compliance"):
        component("mill")
    assert "mill" not in COMPONENTS
    assert list(COMPONENTS) == list(NAMES)
    assert len(COMPONENTS) == len(NAMES)
