"""Specification of `robomill import`: foreign logs become run folders, or are refused with the reason."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from robomill import cli
from robomill.logs.importing import MIRRORED, import_log
from robomill.orchestration.errors import ResultsError
from robomill.orchestration.runs.run import Run
from tests import ROOT
from tests.robomill.logs.foreign import CLOCK, FORCE, FX, FY, FZ, MAP, T, bring, csv, refused
from tests.tolerances import EXACT, ROUNDOFF, physics

DATA = ROOT / "data" / "kuka_kr300_recordings"

# ------------------------------------------------------------------------------- what is brought in


def test_a_csv_log_becomes_a_measured_run_in_si(tmp_path: Path) -> None:
    run = bring(tmp_path, MAP + '[labels]\ncondition = "air"\nrepeat = 3\nheld_out = true\n[parameters.drive]\nlag = 2.0\n')
    np.testing.assert_allclose(run["sensor.f_S_raw"], np.stack([FX, FY, FZ], axis=1), rtol=4.0 * ROUNDOFF, atol=ROUNDOFF)
    assert np.all(run.t - T == EXACT)
    assert run.unit("sensor.f_S_raw") == "N"
    assert run.outcome == "finished"
    assert run.info["kind"] == "measured"
    assert run.info["labels"] == {"condition": "air", "repeat": 3, "held_out": True}
    assert run.info["parameters"] == {"drive": {"lag": "2.0"}}, "nobody knows its unit yet: who does, asks for it"
    assert run.info["columns"]["sensor.f_S_raw[2]"]["frame"] == "S"
    assert run.info["clock"]["step"] == 0.01


def test_a_csv_log_with_semicolons_decimal_commas_and_a_preamble(tmp_path: Path) -> None:
    log = csv(tmp_path, "Anlage 3\n\ntime;fx;fy;fz\n0,0;0,001;0;0\n0,01;0,002;0;0\n")
    run = bring(tmp_path, '[log]\ndelimiter = ";"\ndecimal = ","\nskip_rows = 2\n' + MAP, log)
    assert run["sensor.f_S_raw"][:, 0].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("kind", ["npz", "mat"])
def test_arrays_of_npz_and_mat_logs_are_columns_whichever_way_round(tmp_path: Path, kind: str) -> None:
    log = tmp_path / f"log.{kind}"
    arrays = {"time": T, "lying": np.stack([FX, FY, FZ]), "standing": np.stack([FX, FY, FZ], axis=1), "note": np.array("text")}
    if kind == "npz":
        np.savez(log, **arrays)
    else:
        savemat(log, arrays)
    for name in ("lying", "standing"):
        run = bring(tmp_path, CLOCK + f'[[signal]]\nport = "sensor.f_S_raw"\ncolumn = "{name}"\nunit = "N"\n', log)
        assert np.all(run["sensor.f_S_raw"] - arrays["standing"] == EXACT)


def test_a_signal_is_low_passed_without_phase_and_differentiated(tmp_path: Path) -> None:
    """A slow sine stays what it is, a fast one goes; the derivative is that of central differences, whose error is (w h)^2 / 6."""
    t = 0.002 * np.arange(3001)
    slow, fast = 2.0 * math.pi * 1.0, 2.0 * math.pi * 60.0
    log = tmp_path / "log.npz"
    np.savez(log, t=t, x=np.sin(slow * t) + 0.3 * np.sin(fast * t))
    signal = '[[signal]]\nport = "motion.{}"\ncolumn = "x"\nunit = "deg"\nlow_pass = "15 Hz"\n'
    text = '[clock]\ncolumn = "t"\nunit = "s"\nstep = "2 ms"\n'
    text += signal.format("q") + signal.format("v") + "derivative = 1\n" + signal.format("a") + "derivative = 2\n"
    run = bring(tmp_path, text, log)
    middle = slice(500, -500)  # zero-phase filters have no neighbours at the ends
    kept = math.pi / 180.0 / (1.0 + (1.0 / 15.0) ** 8)
    left = 0.3 * (15.0 / 60.0) ** 8 * (fast / slow) ** 2  # of the fast sine, in the second derivative
    for name, unit, truth in (
        ("q", "rad", np.sin(slow * t)),
        ("v", "rad/s", slow * np.cos(slow * t)),
        ("a", "rad/s2", -slow * slow * np.sin(slow * t)),
    ):
        assert run.unit(f"motion.{name}") == unit
        bound = (2.0 * (slow * 0.002) ** 2 / 6.0 + left) * np.abs(truth).max() * kept
        assert np.abs(run[f"motion.{name}"] - kept * truth)[middle].max() < bound
    assert run.info["imported"]["filtered"] is True


def test_what_cannot_be_filtered_is_refused(tmp_path: Path) -> None:
    smooth = FORCE + 'low_pass = "20 Hz"\n'
    assert "low_pass and derivative need evenly spaced times; set clock.step (or clock.rate)" in refused(tmp_path, CLOCK + smooth)
    grid = CLOCK + 'step = "10 ms"\n'
    assert "low_pass is 60 Hz; expected less than half the rate, 50 Hz" in refused(tmp_path, grid + smooth.replace("20 Hz", "60 Hz"))
    few = csv(tmp_path, "time,fx,fy,fz\n" + "".join(f"{0.01 * i:.2f},1,2,3\n" for i in range(MIRRORED)))
    assert f"low_pass needs more than {MIRRORED} rows, there are {MIRRORED}; import a longer log" in refused(tmp_path, grid + smooth, few)
    assert "expected a frequency above 0 Hz" in refused(tmp_path, grid + smooth.replace("20 Hz", "-1 Hz"))
    rate = (
        '[components]\nrobot = "inverse_dynamics"\n' + grid + '[[signal]]\nport = "robot.qd"\ncolumns = ["fx","fy","fz","fx","fy","fz"]\n'
    )
    assert "wrong unit: robot.qd is in rad/s" in refused(tmp_path, rate + 'unit = "deg"\n')
    assert bring(tmp_path, rate + 'unit = "deg"\nderivative = 1\n').unit("robot.qd") == "rad/s"
    pieces = grid + f'[cut]\nperiod = "{0.01 * MIRRORED} s"\n' + smooth  # these have neighbours
    assert len(bring(tmp_path, pieces, run="run/repeat_1")) == MIRRORED


@pytest.mark.parametrize("clock", [CLOCK, CLOCK + 'step = "10 ms"\n'])
def test_rows_that_are_missing_are_said(tmp_path: Path, clock: str, capsys: pytest.CaptureFixture[str]) -> None:
    times = [0.01 * i + (2e-3 if i % 2 else 0.0) for i in range(60) if i not in (30, 31)]  # jitter is no gap
    log = csv(tmp_path, "time,fx,fy,fz\n" + "".join(f"{t:.3f},1,2,3\n" for t in times))
    (tmp_path / "map.toml").write_text(clock + FORCE, encoding="utf-8")
    out = tmp_path / "run"
    assert cli.main(["import", str(tmp_path / "map.toml"), str(log), "--out", str(out)]) == 0
    assert f"{out}: the log has no row for 28 ms from 0.292 s on" in capsys.readouterr().out.splitlines()
    assert cli.main(["import", str(tmp_path / "map.toml"), str(log), "--out", str(out), "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["gap_s"] == pytest.approx([0.292, 0.32], rel=1e2 * ROUNDOFF)
    whole = csv(tmp_path, "time,fx,fy,fz\n" + "".join(f"{0.01 * i:.2f},1,2,3\n" for i in range(60)))
    assert import_log(tmp_path / "map.toml", whole, out, overwrite=True)[0][0].gap is None


@pytest.mark.parametrize("clock", ['column = "t"\nunit = "s"\nstep = "2 ms"\n', 'rate = "500 Hz"\n'])
@pytest.mark.parametrize("cut", ['from = "2.5 s"\nto = "3.5 s"\n', 'at = ["2.5 s"]\nlength = "1 s"\n', 'from = "0 s"\nto = "6.5 s"\n'])
def test_a_filter_sees_no_end_where_a_piece_of_a_log_has_one(tmp_path: Path, clock: str, cut: str) -> None:
    """The piece is that of the whole log, which is filtered at its own ends only."""
    log = tmp_path / "log.npz"
    np.savez(log, t=0.002 * np.arange(3001), x=np.random.default_rng(3).normal(size=3001).cumsum())
    signal = '[[signal]]\nport = "motion.{}"\ncolumn = "x"\nunit = "deg"\n'
    text = f"[clock]\n{clock}" + signal.format("q") + 'low_pass = "4 Hz"\nderivative = 2\n' + signal.format("v") + "derivative = 1\n"
    whole = {port: bring(tmp_path, text, log)[port].copy() for port in ("motion.q", "motion.v")}
    piece = bring(tmp_path, text + f"[cut]\n{cut}", log, run="run/repeat_1" if "length" in cut else "run")
    begin = 1250 if "2.5 s" in cut else 0
    assert len(piece) == (500 if begin else 3001)
    for port, x in whole.items():
        forgotten = 1e-10 if port == "motion.q" else 1e3 * ROUNDOFF  # FORGOTTEN
        np.testing.assert_allclose(piece[port], x[begin : begin + len(piece)], rtol=0.0, atol=forgotten * np.abs(x).max())


def test_an_rsi_log_has_its_units_its_answers_and_its_ipoc_as_clock(tmp_path: Path) -> None:
    packets = [
        f'<Rob TYPE="KUKA"><RIst X="{1000 + k}" Y="0" Z="500" A="{10 * k}" B="20" C="10"/>'
        f'<AIPos A1="{k}" A2="-90" A3="90" A4="0" A5="0" A6="0"/>'
        f"<IPOC>{4000 + 4 * k}</IPOC></Rob>\n"
        f'<Sen Type="ImFree"><RKorr X="0.{k}" Y="0" Z="0" A="0" B="0" C="0"/><IPOC>{4000 + 4 * k}</IPOC></Sen>'
        for k in range(5)
    ]
    log = tmp_path / "rsi.xml"
    log.write_text("received at 12:00\n" + "\n".join(packets), encoding="utf-8")
    run = bring(
        tmp_path,
        '[clock]\ncolumn = "IPOC"\nunit = "ms"\noffset = "-4 s"\n'
        '[components]\ncompliance = "robot_compliance"\ncontroller = "compensation_controller"\n'
        '[[signal]]\nport = "compliance.p_BT_B"\ncolumns = ["RIst.X", "RIst.Y", "RIst.Z"]\n'
        '[[signal]]\nport = "compliance.quat_BT"\ncolumns = ["RIst.A", "RIst.B", "RIst.C"]\norientation = "abc"\n'
        '[[signal]]\nport = "drive.q_motor"\ncolumns = ["AIPos.A1", "AIPos.A2", "AIPos.A3", "AIPos.A4", "AIPos.A5", "AIPos.A6"]\n'
        '[[signal]]\nport = "controller.correction_B"\ncolumns = ["Sen.RKorr.X", "Sen.RKorr.Y", "Sen.RKorr.Z"]\n',
        log,
    )
    np.testing.assert_allclose(run.t, 0.004 * np.arange(5), rtol=0.0, atol=1e3 * ROUNDOFF)
    np.testing.assert_allclose(run["compliance.p_BT_B"][:, 0], 1.0 + 1e-3 * np.arange(5), rtol=ROUNDOFF)
    np.testing.assert_allclose(run["drive.q_motor"][:, 0], np.deg2rad(np.arange(5)), rtol=0.0, atol=ROUNDOFF)
    np.testing.assert_allclose(run["controller.correction_B"][:, 0], 1e-4 * np.arange(5), rtol=0.0, atol=ROUNDOFF)
    # FACTS 8.1: A = 30, B = 20, C = 10 deg (its last number is printed to eight digits only)
    expected = [0.951548525, 0.038134577, 0.189307857, 0.239298341]
    np.testing.assert_allclose(run["compliance.quat_BT"][3], expected, rtol=0.0, atol=physics(0.0, absolute=5e-9))


def test_an_mdf4_log_with_a_clock_per_group(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    log = tmp_path / "log.mf4"
    mdf = asammdf.MDF()
    fast = 0.005 * np.arange(80)
    mdf.append([asammdf.Signal(FX, T, unit="N", name="fx"), asammdf.Signal(FY, T, unit="N", name="fy")])
    mdf.append([asammdf.Signal(2.0 * fast, fast, unit="Nm", name="m")])
    mdf.save(log)
    mdf.close()
    signals = '[[signal]]\nport = "sensor.f"\ncolumns = ["fx", "fy"]\n[[signal]]\nport = "sensor.m"\ncolumn = "m"\n'
    run = bring(tmp_path, '[clock]\ncolumn = "0/time"\nunit = "s"\n' + signals, log)
    assert np.all(run["sensor.f"][:, 1] - FY == EXACT)
    np.testing.assert_allclose(run["sensor.m"], 2.0 * run.t, rtol=4.0 * ROUNDOFF)
    assert run.unit("sensor.m") == "N.m"


def test_mdf4_without_its_package_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    (tmp_path / "log.mf4").write_bytes(b"MDF     4.10")
    text = refused(tmp_path, MAP, tmp_path / "log.mf4")
    assert "needs the package 'asammdf', which is not installed" in text
    assert "pip install asammdf" in text


def test_signs_scales_and_offsets_act_in_the_unit_of_the_log(tmp_path: Path) -> None:
    run = bring(tmp_path, MAP + "sign = [1, -1, 1]\nscale = [1.0, 2.0, 1.0]\noffset = [0.0, 0.5, 0.0]\n")
    np.testing.assert_allclose(run["sensor.f_S_raw"][:, 1], 500.0 - 2.0 * FY, rtol=10.0 * ROUNDOFF)


def test_a_rotation_turns_the_frame_of_the_log_into_that_of_the_port(tmp_path: Path) -> None:
    expected = np.stack([FX, FY, FZ], axis=1) @ Rotation.from_euler("ZYX", [90.0, 0.0, 30.0], degrees=True).as_matrix().T
    by_angles = bring(tmp_path, MAP + 'rotation = {abc = ["90 deg", 0, "30 deg"]}\n')["sensor.f_S_raw"]
    np.testing.assert_allclose(by_angles, expected, rtol=0.0, atol=1e3 * ROUNDOFF)
    s, c = 0.5, math.sqrt(0.75)
    by_matrix = bring(tmp_path, MAP + f"rotation = [[0, {-c!r}, {s!r}], [1, 0, 0], [0, {s!r}, {c!r}]]\n")["sensor.f_S_raw"]
    np.testing.assert_allclose(by_matrix, expected, rtol=0.0, atol=1e3 * ROUNDOFF)


def test_a_signal_with_a_late_clock_is_shifted_and_the_run_trimmed(tmp_path: Path) -> None:
    late = '[[signal]]\nport = "sensor.m"\ncolumn = "fz"\nunit = "kN"\nshift = "-25 ms"\n'
    run = bring(tmp_path, CLOCK + FORCE + late)
    np.testing.assert_allclose(run["sensor.m"], 700.0 * (run.t + 0.025), rtol=1e2 * ROUNDOFF)
    assert run.t[-1] == T[-4]  # 25 ms are more than two steps of 10 ms


def test_a_clock_can_be_counted_and_put_on_a_grid(tmp_path: Path) -> None:
    run = bring(tmp_path, '[clock]\nrate = "100 Hz"\nstep = "4 ms"\noffset = "1 s"\n' + FORCE)
    np.testing.assert_allclose(np.diff(run.t), 0.004, rtol=1e3 * ROUNDOFF)
    assert run.t[0] == 1.0
    np.testing.assert_allclose(run["sensor.f_S_raw"][:, 2], 700.0 * (run.t - 1.0), rtol=0.0, atol=1e4 * ROUNDOFF)


# ------------------------------------------------------------------------------------ what is refused


LISTED = """
[components]
sensor = "sensor_chain"
[parameters.sensor]
seed = 4
"""


def test_parameters_of_a_listed_component_come_in_the_units_of_its_ports(tmp_path: Path) -> None:
    lines = 'zero_drift = ["30 mN", 0, "-1 N"]\n"load_cog_S[2]" = "12 mm"\nload_mass = {value = 500, unit = "g"}\n'
    found = bring(tmp_path, MAP + LISTED + lines).info["parameters"]["sensor"]
    assert found == {"seed": 4, "zero_drift": [0.03, 0.0, -1.0], "load_cog_S[2]": 0.012, "load_mass": 0.5}


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (
            "load_mass = 25",
            "map.toml:13: component 'sensor': parameter 'load_mass': 25 has no unit; expected a text with one, such as \"25 kg\"",
        ),
        ('load_mass = "25 mm"', "map.toml:13: component 'sensor': parameter 'load_mass': 25 mm cannot be expressed in kg"),
        ('load_mas = "25 kg"', "map.toml:13: component 'sensor': unknown parameter 'load_mas'; did you mean 'load_mass'"),
        ("zero_drift = [0,\n 0,\n 3]", "map.toml:15: component 'sensor': parameter 'zero_drift[3]': 3 has no unit"),
    ],
)
def test_a_parameter_that_is_wrong_is_refused_where_it_stands(tmp_path: Path, line: str, text: str) -> None:
    assert text in refused(tmp_path, MAP + LISTED + line + "\n")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            '"kN"',
            '"kN"\nrange = [-1.0, 1.0]',
            "map.toml:8: signal 1 'sensor.f_S_raw': range.0: -1 has no unit; expected a text with one, such as \"-1 N\"",
        ),
        ('"kN"', '"kN"\nshift = -3', "map.toml:8: signal 1 'sensor.f_S_raw': shift: -3 has no unit"),
        (
            'column = "time"\nunit = "s"',
            "rate = 250",
            'map.toml:2: [clock] rate: 250 has no unit; expected a text with one, such as "250 Hz"',
        ),
        ('column = "time"\nunit = "s"', 'rate = "4 ms"', "map.toml:2: [clock] rate: 4 ms cannot be expressed in Hz"),
        (
            '"kN"',
            '"kN"\nrotation = {abc = [90, 0, 0]}',
            "map.toml:8: signal 1 'sensor.f_S_raw': rotation.abc.0: 90 has no unit; expected a text with one, such as \"90 deg\"",
        ),
        ('"kN"', '"kN"\nsign = true', "expected a number or a list of numbers; found True"),
        ("[clock]", "[labels]\ntier = 1979-05-27\n[clock]", "map.toml:2: [labels] tier: expected a text, a number, true or false"),
        ("[clock]", "[log]\nskip_rows = true\n[clock]", "map.toml:2: [log] skip_rows: expected a whole number, at least 0; found True"),
    ],
)
def test_a_number_without_a_unit_is_refused_where_it_stands(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert expected in refused(tmp_path, MAP.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"fz"]', '"f_z"]', "unknown column 'f_z'; did you mean 'fz'"),
        ('"kN"', '"kNx"', "unknown unit 'kNx'"),
        ('"kN"', '"kN"\nrange = ["-1 N", "1 N"]', "outside the range [-1, 1] N that the mapping expects; is 'kN' the wrong unit"),
        ('unit = "kN"\n', "", "a unit is missing: the log states none"),
        ("columns", "colums", "unknown key 'colums'; did you mean 'columns'"),
        ('"sensor.f_S_raw"', '"force"', "'force' is no port; expected component.port"),
        ('column = "time"', 'column = "time"\nrate = 250', "give either column (and unit) or rate (Hz)"),
        ('"s"', '"mm"', "'mm' does not measure time"),
        ('"kN"', '"kN"\nsign = 2', "expected 1 or -1; found 2"),
        ('"kN"', '"kN"\nsign = [1, -1]', "2 values of scale or sign for 3 columns"),
        ('"kN"', '"kN"\nrotation = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]', "the matrix is no rotation"),
        ('"kN"', '"kN"\norientation = "xyz"', "expected 'abc'"),
        ('"kN"', '"kN"\nshift = "3 mm"', "3 mm cannot be expressed in s: it measures something else; units that fit: s, ms"),
        ('"kN"', '"kN"\nshift = "9 s"', "the signals have no time in common"),
        ("[clock]", '[log]\nformat = "xls"\n[clock]', "unknown format 'xls'"),
        ("[clock]", '[components]\nsensor = "sensor"\n[clock]', "unknown component 'sensor'"),
        ("[clock]", '[components]\nsensor = "sensor_chain"\n[clock]', ""),
        (CLOCK, "", "a table [clock] is missing"),
        (FORCE, "", "expected at least one [[signal]]"),
    ],
)
def test_a_mapping_that_does_not_fit_says_why(tmp_path: Path, old: str, new: str, expected: str) -> None:
    mapping = MAP.replace(old, new, 1)
    other = FORCE.replace("sensor.", "other.") if expected.startswith("the signals") else ""
    if expected:
        assert expected in refused(tmp_path, mapping + other)
    else:
        bring(tmp_path, mapping)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("f_S_raw", "f_raw", "unknown port 'f_raw'; did you mean"),
        ('"kN"', '"mm"', "wrong unit: sensor.f_S_raw is in N, 'mm' measures something else"),
        ('"fz"]', '"fz", "fx"]', "has 3 elements; the mapping gives 4"),
    ],
)
def test_ports_of_known_components_are_checked(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = refused(tmp_path, '[components]\nsensor = "sensor_chain"\n' + MAP.replace(old, new, 1))
    assert expected in text


def test_a_wrong_unit_is_noticed_where_the_log_states_its_own(tmp_path: Path) -> None:
    log = tmp_path / "rsi.xml"
    log.write_text("".join(f'<Rob><RIst X="{k}"/><IPOC>{k}</IPOC></Rob>' for k in range(3)), encoding="utf-8")
    signal = '[[signal]]\nport = "a.x"\ncolumn = "RIst.X"\nunit = "m"\n'
    assert "wrong unit: the mapping says 'm', the log states 'mm'" in refused(tmp_path, '[clock]\nrate = "250 Hz"\n' + signal, log)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ("0.0,1,1,1\n0.1,1,,1\n", "column 'fy' has 1 values that are no numbers (NaN, infinite or missing), the first in row 2 of 2"),
        ("0.0,1,1,1\n0.1,1,nan,1\n", "column 'fy' has 1 values that are no numbers"),
        ("0.0,1,1,1\n0.2,1,1,1\n0.2,1,1,1\n", "time does not increase from row 2 (0.2 s) to row 3 (0.2 s), 1 times in all"),
        ("0.0,1,1,1\nx,1,1,1\n", "row 3, column 'time': 'x' is no number"),
        ("0.0,1,1\n", "row 2 has 3 fields, the row of names has 4"),
        ("0.0,1,1,1\n", "has 1 rows; expected at least 2"),
        ("", "expected a row of names and rows of numbers"),
    ],
)
def test_a_damaged_log_says_where(tmp_path: Path, rows: str, expected: str) -> None:
    assert expected in refused(tmp_path, MAP, csv(tmp_path, "time,fx,fy,fz\n" + rows))


@pytest.mark.parametrize(
    ("suffix", "expected"),
    [("npz", "not an npz file"), ("mat", "not a MAT file"), ("xml", "no packet <Rob"), ("bin", "the format of '.bin' is not known")],
)
def test_a_file_that_is_not_what_its_name_says_is_refused(tmp_path: Path, suffix: str, expected: str) -> None:
    (tmp_path / f"log.{suffix}").write_bytes(b"something else altogether, and rather more than a header")
    assert expected in refused(tmp_path, MAP, tmp_path / f"log.{suffix}")


def test_a_run_is_not_overwritten_unasked(tmp_path: Path) -> None:
    bring(tmp_path)
    with pytest.raises(ResultsError, match="already holds a run"):
        import_log(tmp_path / "map.toml", tmp_path / "log.csv", tmp_path / "run")


# ----------------------------------------------------------------------------------- the command


def test_the_mapping_of_the_real_recordings_fits_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, held_out in (("A", "false"), ("B", "true")):
        log = DATA / f"recording_{name}.npz"
        arguments = ["import", str(DATA / "map.toml"), str(log), "--out", str(tmp_path / name), "--label", f"held_out={held_out}", "--json"]
        assert cli.main(arguments) == 0
        assert json.loads(capsys.readouterr().out)["rows"] == 2500
        run, raw = Run.load(tmp_path / name), np.load(log)
        assert run.info["labels"]["held_out"] is (held_out == "true")
        expected = np.deg2rad(raw["act_pos_mot_deg"][:, :2500].T + np.array([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]))
        # put on the grid of 4 ms: 0.25 us at most off, at 0.8 rad/s
        assert np.abs(run["robot.q"] - expected).max() <= 2.6e-7 * 0.8
        assert run["robot.q_link"].shape == (2500, 3)
        assert run.unit("robot.torque_motor") == "N.m"


def test_the_command_reports_errors_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["import", str(tmp_path / "none.toml"), "x.csv", "--out", str(tmp_path / "run")]) == 2
    assert f"robomill import: no mapping file {tmp_path / 'none.toml'}" in capsys.readouterr().err
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    assert cli.main(["import", str(tmp_path / "map.toml"), str(csv(tmp_path)), "--out", str(tmp_path / "run"), "--label", "x"]) == 2
    assert "expected KEY=VALUE" in capsys.readouterr().err
