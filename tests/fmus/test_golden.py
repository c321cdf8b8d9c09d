"""Golden results: inputs and outputs of every component, kept as files, and its interface."""

from __future__ import annotations

import pytest

from robomill.fmus.components import COMPONENTS, NAMES
from robomill.fmus.interface import Interface
from tests.fmus import golden


@pytest.mark.parametrize("name", NAMES)
def test_interface_is_the_one_on_file(name: str) -> None:
    file = golden.FOLDER / name / "interface.txt"
    found, kept = (golden.interface_text(Interface(COMPONENTS[name])), file.read_text(encoding="utf-8"))
    assert found == kept, f"{file}: ports changed; if that is intended: python -m tests.fmus.regenerate {name}, then review the diff"


@pytest.mark.parametrize("plain", [False, True], ids=["compiled", "plain"])
@pytest.mark.parametrize("name", NAMES)
def test_outputs_are_those_on_file_bit_by_bit(name: str, plain: bool) -> None:
    model, folder = COMPONENTS[name], golden.FOLDER / name
    interface = Interface(model)
    expected = golden.read(folder / "out.csv", interface.outputs)
    found = golden.run(model, golden.read(folder / "in.csv", interface.inputs), golden.parameters(folder), plain)
    assert not golden.first_difference(folder / "out.csv", interface.outputs, expected, found)


@pytest.mark.parametrize("name", NAMES)
def test_the_inputs_on_file_exercise_the_component(name: str) -> None:
    """Not one output signal may be constant throughout, but for those that the chosen mode leaves at zero."""
    interface = Interface(COMPONENTS[name])
    rows = golden.read(golden.FOLDER / name / "out.csv", interface.outputs)
    idle = {v for v, s in interface.arrays.items() if any(p.variable == v for p in interface.outputs) and (rows[:, s] == rows[0, s]).all()}
    allowed = {
        "path_interpolator": {"quat_BT", "spindle_speed"},
        "compensation_controller": {"correction_B"},
        "rate_controller": {"stage"},
        "lead_through": {"q_ref"},
        "deformation_compensation": {"correction_q", "pilot_blend"},
        "spindle_holder": {"m_S_raw", "m_T_T"},
        "face_milling_force": {"f_turn_T_B", "m_turn_T_B"},
        "tridexel_milling_force": {"f_turn_T_B", "m_turn_T_B"},
    }
    assert idle <= allowed.get(name, set())


def test_a_difference_is_reported_with_variable_step_and_file() -> None:
    folder = golden.FOLDER / "milling_force"
    ports = Interface(COMPONENTS["milling_force"]).outputs
    expected = golden.read(folder / "out.csv", ports)
    found = expected.copy()
    found[50:, 1] += 1e-9
    text = golden.first_difference(folder / "out.csv", ports, expected, found)
    assert text.startswith("tests/golden/milling_force/out.csv: f_T_B[2] differs first in step 50 (t = 0.200 s): ")
    assert "51 values of 1 variables differ" in text
    assert "python -m tests.fmus.regenerate" in text


def test_numbers_read_back_bit_by_bit(tmp_path_factory: pytest.TempPathFactory) -> None:
    ports = Interface(COMPONENTS["robot_compliance"]).outputs
    rows = golden.read(golden.FOLDER / "robot_compliance" / "out.csv", ports) / 3.0
    file = tmp_path_factory.mktemp("golden") / "out.csv"
    golden.write(file, ports, rows)
    assert (golden.read(file, ports) == rows).all()
