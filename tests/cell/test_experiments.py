"""Experiment files: what is simulated as it would be measured."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.cell.experiments import folder_of, is_experiment, known_parameters, load_experiment, remarks, run_condition, run_experiment
from robomill.cell.milling import with_parameters
from robomill.cell.scenario import ScenarioError
from robomill.cli import main
from robomill.fmus.interface import interface_of
from robomill.models.calibration.validation_loads import displacement
from robomill.models.components.applied_load import MODEL
from robomill.models.model.declaration import record
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import base_name
from tests import ROOT
from tests.tolerances import ROUNDOFF

FOLDER = ROOT / "scenarios" / "experiments"
FILES = sorted(f for f in FOLDER.glob("*.toml") if is_experiment(f))


def first_condition(name):
    experiment = load_experiment(FOLDER / f"{name}.toml")
    return experiment, experiment.conditions[0]


def test_there_is_a_file_for_every_kind_of_measurement():
    kinds = {load_experiment(f).kind for f in FILES}
    assert kinds == {
        "air cut",
        "reversals",
        "static load",
        "static load with hanging weight",
        "force staircase",
        "milling",
        "sensor poses",
        "warm-up",
        "tap test",
    }


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.stem)
def test_each_has_a_condition_to_diagnose_and_one_held_out(file):
    held_out = [c.held_out for c in load_experiment(file).conditions]
    assert any(held_out)
    assert not all(held_out)


def test_a_run_has_its_labels_and_can_be_simulated_again_from_what_it_says(tmp_path):
    experiment, c = first_condition("static_loads")
    measured = run_condition(experiment, c, 2, tmp_path / "r")
    labels = measured.info["labels"]
    assert (labels["condition"], labels["repeat"], labels["held_out"], labels["kind"]) == ("push +x", 2, False, "static load")
    known = measured.info["parameters"]
    assert known["load"]["profile"] == "profile.npy"
    assert "sensor" not in known  # its seed is nothing that an experimenter knows
    absolute = {k: {n: str(tmp_path / "r" / v) if n in ("segments", "profile") else v for n, v in d.items()} for k, d in known.items()}
    again = run(with_parameters(load_system(experiment.system), absolute), None, resolver=resolve, convert=convert)
    np.testing.assert_array_equal(again["load.f_T_B"], measured["load.f_T_B"])
    np.testing.assert_array_equal(again["compliance.d_T_B"], measured["compliance.d_T_B"])
    assert np.any(again["sensor.f_S_raw"] != measured["sensor.f_S_raw"])


def test_a_push_deflects_the_tool_as_the_compliance_model_says(tmp_path):
    experiment, c = first_condition("static_loads")
    r = run_condition(experiment, c, 1, tmp_path / "r")
    k = int(np.searchsorted(r.t, 3.0))
    np.testing.assert_array_equal(r["load.f_T_B"][k], [300.0, 0.0, 0.0])
    from robomill.models.components.robot_compliance import MODEL as COMPLIANCE

    data = COMPLIANCE.new()
    s = record(data)
    s.sensor_stiffness_scale = 0.1
    COMPLIANCE.plain()[0](s)
    d, theta = np.zeros(3), np.zeros(3)
    displacement(s, r["drive.q_link"][k], np.array([300.0, 0.0, 0.0]), np.zeros(3), d, theta)
    np.testing.assert_allclose(r["compliance.d_T_B"][k], d, rtol=1e3 * ROUNDOFF)


def test_a_hanging_weight_pulls_down_all_the_time(tmp_path):
    experiment, c = first_condition("static_loads_with_weight")
    r = run_condition(experiment, c, 1, tmp_path / "r")
    np.testing.assert_allclose(r["load.f_T_B"][:, 2], -25.0 * 9.81, rtol=ROUNDOFF)


def test_the_machine_may_have_what_the_runs_do_not_say(tmp_path):
    experiment, c = first_condition("static_loads")
    soft = replace(experiment, machine={"compliance": {"tool_compliance": "0.5 um/N"}})
    r = run_condition(soft, c, 1, tmp_path / "a")
    assert "tool_compliance" not in json.dumps(r.info["parameters"])
    stiff = run_condition(experiment, c, 1, tmp_path / "b")
    k = int(np.searchsorted(r.t, 3.0))
    difference = np.linalg.norm(r["compliance.d_T_B"][k] - stiff["compliance.d_T_B"][k])
    assert difference == pytest.approx(0.5e-6 * 300.0, rel=1e3 * ROUNDOFF)  # the force is across the tool


def test_27_orientations_are_27_orientations(tmp_path):
    experiment, c = first_condition("sensor_poses")
    r = run_condition(experiment, c, 1, tmp_path / "r")
    slow = np.linalg.norm(np.gradient(r["path.quat_BT"], axis=0), axis=1) < 1e-9
    quat = np.unique(np.round(r["path.quat_BT"][slow], 6), axis=0)
    assert len(quat) == 27


def test_warm_up_is_a_known_time(tmp_path):
    experiment = load_experiment(FOLDER / "warm_up.toml")
    known = known_parameters(experiment, experiment.conditions[1], load_system(experiment.system))
    assert known["compliance"]["warm_up_time"] == "20 min"


def test_the_command_runs_one_condition(tmp_path, capsys):
    status = main(["run", str(FOLDER / "tap_test.toml"), "--variant", "along y", "--out", str(tmp_path), "--json"])
    summary = json.loads(capsys.readouterr().out)
    assert status == 0
    assert [r["folder"] for r in summary["runs"]] == ["along_y-1", "along_y-2", "along_y-3"]
    measured = Run.load(tmp_path / "along_y-3")
    assert np.abs(measured["load.f_T_B"][:, 1]).max() == 600.0


def test_programs_of_experiments_have_notes_and_warnings(tmp_path):
    """A groove that is read with M8 and mills with its spindle at rest."""
    (tmp_path / "cut.nc").write_text("G21 G90 F600\nM8\nG0 X-70 Y0 Z10\nG1 Z-5\nX70\n")
    file = tmp_path / "cut.toml"
    file.write_text(
        f'[scenario]\nname = "cut"\nkind = "experiment"\nsystem = "{FOLDER.parent / "milling_cell.toml"}"\n[experiment]\nkind = "milling"\n'
        '[[condition]]\nname = "one"\nprogram = "cut.nc"\nposition = ["1300 mm", 0, "1200 mm"]\nabc = ["180 deg", 0, 0]\n'
        'size = ["100 mm", "60 mm", "30 mm"]\n'
    )
    notes, warnings = remarks(load_experiment(file))
    assert any("cut.nc: skipped: M8 (coolant) (condition one)" in text for text in notes)
    assert any("cut while the spindle stands" in text for text in warnings)


def test_an_unknown_condition_is_named_with_those_there_are(tmp_path, capsys):
    assert main(["run", str(FOLDER / "tap_test.toml"), "--variant", "along w", "--out", str(tmp_path)]) == 2
    assert "no condition along w; conditions: along x, along y, along z" in capsys.readouterr().err


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.stem)
def test_every_condition_has_a_folder_of_its_own(file):
    """`push +x` and `push -x`: the runs of one replaced those of the other."""
    names = [c.name for c in load_experiment(file).conditions]
    assert len({folder_of(name) for name in names}) == len(names)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("400 N", "400 mm", "experiment.toml:20: condition 1 'along x': load.2.1: 400 mm cannot be expressed in N"),
        ('"400 N"', "400", "condition 1 'along x': load.2.1: 400 has no unit; expected a text with one, such as \"400 N\""),
        (
            '"1.004 s"',
            '"0.004 s"',
            "ment.toml:20: condition 1 'along x': load.2: the time 0.004 s is not after that of the row before, 1 s",
        ),
        ("held_out = true", 'held_out = "no"', "held_out: expected true or false; found 'no'"),
        ("repeats = 3", "repeats = true", "repeats: expected a whole number, at least 1; found True"),
        ("repeats = 3", "repeats = 0", r"experiment.toml:10: \[experiment\] repeats: expected a whole number, at least 1; found 0"),
        ("repeats = 3", "repeat = 3", r"experiment.toml:10: \[experiment\] repeat: unknown key 'repeat'; did you mean 'repeats'"),
        (
            '"along y"',
            '"along x"',
            r"toml:23: condition 2 'along x': name: 'along x' and 'along x' are the same or have the same folder of results, along_x",
        ),
        ('"0.990 s", 0', '"0.990 mm", 0', r"experiment.toml:20: condition 1 'along x': load.0.0: 0.99 mm cannot be expressed in s"),
    ],
)
def test_errors_say_what_is_wrong(tmp_path, old, new, message):
    text = (FOLDER / "tap_test.toml").read_text(encoding="utf-8").replace(old, new)
    file = tmp_path / "experiment.toml"
    for name in ("loaded_cell.toml", "programs/hold.ngc"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text((FOLDER / name).read_text(encoding="utf-8"), encoding="utf-8")
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=message):
        load_experiment(file)


class TestAppliedLoad:
    ROWS = np.array([[1.0, 0, 0, 0, 0, 0, 0], [3.0, 10.0, -4.0, 2.0, 1.0, 0.0, 6.0]])

    def stepped(self, rows, functions, t):
        data = MODEL.new()
        MODEL.load_table(data, "profile", np.asarray(rows, dtype=np.float64))
        s = record(data)
        init, step = functions
        status = init(s)
        if status == 0 and t > 0.0:
            status = step(s, 0.0, t)
        return status, data

    @pytest.mark.parametrize(("t", "share"), [(0.0, 0.0), (1.0, 0.0), (1.5, 0.25), (3.0, 1.0), (9.0, 1.0)])
    def test_linear_between_rows_and_held_outside(self, t, share):
        _, data = self.stepped(self.ROWS, MODEL.plain(), t)
        np.testing.assert_allclose(data["f_T_B"][0], share * self.ROWS[1, 1:4], rtol=ROUNDOFF)
        np.testing.assert_allclose(data["m_T_B"][0], share * self.ROWS[1, 4:], rtol=ROUNDOFF)

    def test_an_empty_table_is_no_load(self):
        _, data = self.stepped(np.zeros((0, 7)), MODEL.plain(), 1.0)
        assert not np.any(data["f_T_B"])

    def test_plain_and_compiled_agree_bit_for_bit(self):
        words = interface_of(MODEL).tables_at  # what follows is where the rows of each lie
        for t in np.linspace(0.0, 4.0, 41):
            plain, compiled = (self.stepped(self.ROWS, way, t)[1].tobytes() for way in (MODEL.plain(), MODEL.compiled()))
            assert plain[:words] == compiled[:words]

    def test_times_must_increase(self):
        status, data = self.stepped(self.ROWS[[0, 1, 1]], MODEL.plain(), 0.0)
        assert "the times of the profile do not increase from row 1 (counted from zero) to the next" in MODEL.message(
            status, record(data), math.nan
        )


def test_only_the_columns_that_are_named_are_recorded(tmp_path):
    experiment = replace(load_experiment(ROOT / "scenarios" / "experiments" / "static_loads.toml"), columns=("drive.q_motor",), repeats=1)
    (summary,) = run_experiment(experiment, tmp_path, ["push +x"])
    assert {base_name(c) for c in Run.load(tmp_path / summary.folder).columns} == {"drive.q_motor"}
    assert summary.max_displacement_m is summary.max_force_n is None


def test_another_repeat_has_another_noise_in_each_component_that_has_some(tmp_path):
    """A force sensor and the current of the spindle; with the noise of one only, the other's would be taken for what comes again."""
    experiment = load_experiment(ROOT / "scenarios" / "irb6400" / "end_millings.toml")
    one, other, again = (run_condition(experiment, experiment.conditions[0], r, tmp_path / str(i)) for i, r in enumerate((1, 2, 1)))
    for noisy in ("sensor.f_S_raw", "current.current"):
        assert np.array_equal(one[noisy], again[noisy])
        assert np.std(one[noisy] - other[noisy]) > 0.0
    assert np.array_equal(one["path.q_ref"], other["path.q_ref"])
