"""`robomill identify`: the FANUC loads from the shipped set, runs of our own components, what comes out of it put into the cell again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.cell.equipment import load_system
from robomill.cli import main
from robomill.diagnosis.outcome import adopt
from robomill.identify_command import MOST_ROWS
from robomill.models.components import robot_compliance, sensor_chain
from robomill.models.model.declaration import Record, record
from robomill.models.robot.kinematics import KR300
from tests import ROOT
from tests.models.calibration.test_stiffness import TRUE, WORK_SPACE, measured
from tests.tolerances import ROUNDOFF, chance, physics

FANUC = ROOT / "data" / "fanuc_r2000ic" / "loads.toml"
H = 0.004
WEIGHT = 60.0 * 9.81
TILT = np.deg2rad([0.8, -0.4])
REFIT = 0.05  # the file has the springs refitted without axis 6, which twenty poses need not determine


def answer(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def run_folder(folder: Path, columns: dict[str, np.ndarray], robot: str = "", tool: str = "", kind: str = "measured") -> Path:
    """A run as another program may write it: run.toml and signals.csv; arrays by port."""
    folder.mkdir(parents=True, exist_ok=True)
    flat = {f"{name}[{i + 1}]": column for name, rows in columns.items() for i, column in enumerate(np.asarray(rows).T)}
    (folder / "run.toml").write_text(
        f'schema = "robomill-run/1"\nkind = "{kind}"\nrobot = "{robot}"\ntool = "{tool}"\n'
        + "".join(f'[columns."{name}"]\nport = "{name}"\n' for name in flat),
        encoding="utf-8",
    )
    t = H * np.arange(len(next(iter(flat.values()))))
    lines = [
        ",".join(f'"{n}"' for n in ("t", *flat)),
        *(",".join(map(repr, map(float, row))) for row in np.column_stack([t, *flat.values()])),
    ]
    (folder / "signals.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def loads_run(folder: Path, **about: str) -> Path:
    """Twenty simulated loads on the IRB 6400R with noise; the tip is 120 mm beside axis 6."""
    loads = measured(20, 3)
    return run_folder(folder, {"robot.q_link": loads.q, "load.f_T_B": loads.f_T_B, "tracker.d_T_B": loads.d_T_B}, **about)


def tool_file(folder: Path) -> Path:
    text = (ROOT / "models" / "data" / "tools" / "spindle_in_line.toml").read_text(encoding="utf-8")
    file = folder / "tip.toml"
    file.write_text(text.replace("[0.0, 0.0, 450.0]", "[120.0, 0.0, 450.0]"), encoding="utf-8")
    return file


class TestStiffness:
    @pytest.mark.paper
    def test_fanuc_loads_that_are_shipped(self, capsys: pytest.CaptureFixture[str]) -> None:
        """Rigid 1.73, joints 0.37 (0.405 left out), with tilt of joint 3 0.29 (0.316) mm; half of the last digit."""
        assert main(["identify", "stiffness", str(FANUC), "--json"]) == 0
        joints = answer(capsys)
        main(["identify", "stiffness", str(FANUC), "--tilt", "3", "--json"])
        tilt = answer(capsys)
        for found, printed, digit in (
            (joints["rigid_m"], 1.73e-3, 5e-6),
            (joints["residual_m"], 0.37e-3, 5e-6),
            (joints["left_out_m"], 0.405e-3, 5e-7),
            (tilt["residual_m"], 0.29e-3, 5e-6),
            (tilt["left_out_m"], 0.316e-3, 5e-7),
        ):
            assert abs(found - printed) < physics(0.0, absolute=digit)

    def test_says_what_is_not_determined_and_returns_1(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["identify", "stiffness", str(FANUC), "--springs", "axes", "--poses", "1"]) == 1
        text = capsys.readouterr().out
        assert "FANUC R-2000iC: 43 poses, springs at the axis angles, condition number 3.11" in text
        assert "displacement 1.73 mm rms; left 0.425 mm rms, of poses left out 0.459 mm; most at pose 17, 1.16 mm" in text
        assert "A negative stiffness is no property of a robot: something else is missing" in text
        assert text.count("would help, ") == 1

    def test_a_run_gives_the_springs_and_the_cell_takes_them(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """Within four of the stated standard deviations of the truth; the file is that of `[robot] compliance`."""
        run, out = loads_run(tmp_path / "loads", robot="ABB IRB 6400R/2.5-150"), tmp_path / "springs.toml"
        main(["identify", "stiffness", str(run), "--tool", str(tool_file(tmp_path)), "--out", str(out), "--json"])
        result = answer(capsys)
        for spring, truth in zip(result["springs"], TRUE, strict=True):
            c = spring["compliance_rad_per_nm"]
            assert abs(c - truth) < chance(spring["relative_deviation"] * abs(c))
        assert result["robot"] == "ABB IRB 6400R/2.5-150"
        system = tmp_path / "cell.toml"
        system.write_text(
            'name = "cell"\nstep = "4 ms"\nstop = "4 ms"\n[robot]\nname = "irb6400r_25_150"\ncompliance = "springs.toml"\n'
            '[components.compliance]\nsource = "robot_compliance"\n',
            encoding="utf-8",
        )
        given = load_system(system).component("compliance").parameters["stiffness"]
        assert np.reshape(given, (11, 3))[0, 2] == pytest.approx(result["springs"][0]["stiffness_nm_per_rad"], rel=REFIT)
        assert main(["run", str(system), "--out", str(tmp_path / "run")]) == 0

    @pytest.mark.slow
    def test_simulated_loads_of_the_irb_6400(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """The experiment that is shipped: spindle in line, so all springs but axis 6; a percent for finite turns and held samples."""
        assert main(["run", str(ROOT / "scenarios" / "irb6400" / "stiffness_loads.toml"), "--out", str(tmp_path), "--no-pictures"]) == 0
        capsys.readouterr()
        assert main(["identify", "stiffness", *map(str, sorted(tmp_path.glob("*-1"))), "--json"]) == 1
        found = answer(capsys)
        for spring, truth in zip(found["springs"][:5], TRUE, strict=False):
            assert abs(spring["compliance_rad_per_nm"] - truth) < physics(truth, relative=0.01)
        assert found["springs"][5]["finding"].startswith("not determined: the loads have no moment about it in any pose")
        assert found["residual_m"] < WORK_SPACE
        assert found["poses"] <= MOST_ROWS

    def test_springs_at_the_joints_of_a_coupled_robot_are_warned_of(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        main(["identify", "stiffness", str(FANUC), "--out", str(tmp_path / "s.toml")])
        said = capsys.readouterr()
        assert "the springs are at the joints; robot_compliance puts them at the axis angles of FANUC R-2000iC" in said.err
        assert "A1, A2, A3, A4, A5, A6; rigid: none; they leave 0.372 mm rms" in said.out

    @pytest.mark.parametrize(
        ("old", "new", "text"),
        [
            ('"fanuc_r2000ic"', '"fanuc"', "no parameter file"),
            ('name = "fanuc_r2000ic"', "", "no robot: expected [robot] with a name of models/data/robots or a file, or the option --robot"),
            ('"joints"', '"gears"', "unknown springs 'gears'; available: axes, joints"),
            ('file = "forces.csv"', 'file = "force.csv"', "no such file; beside it are "),
            ('"theta5", ', "", "expected 6 names of columns; found ["),
            ('unit = "N"', 'unit = "m"', "1 m cannot be expressed in N: it measures something else"),
            ('"deltay"', '"dy"', "unknown column 'dy'"),
            ("[displacement]", "[displacements]", "unknown key 'displacements'"),
        ],
    )
    def test_errors_of_a_set(self, tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, text: str) -> None:
        for file in FANUC.parent.glob("*.csv"):
            (tmp_path / file.name).write_bytes(file.read_bytes())
        (tmp_path / "set.toml").write_text(FANUC.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
        assert main(["identify", "stiffness", str(tmp_path / "set.toml")]) == 2
        assert text in capsys.readouterr().err

    def test_columns_of_other_lengths(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        for file in FANUC.parent.glob("*.csv"):
            (tmp_path / file.name).write_bytes(file.read_bytes())
        (tmp_path / "forces.csv").write_text("".join((tmp_path / "forces.csv").read_text().splitlines(keepends=True)[:-1]))
        (tmp_path / "set.toml").write_text(FANUC.read_text(encoding="utf-8"), encoding="utf-8")
        assert main(["identify", "stiffness", str(tmp_path / "set.toml")]) == 2
        assert "42 rows, q has 43; expected one row per pose in each" in capsys.readouterr().err

    def test_errors_of_runs(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        loads_run(tmp_path / "unnamed")
        bare = run_folder(
            tmp_path / "bare", {"robot.q_link": np.zeros((9, 6)), "load.f_T_B": np.ones((9, 3))}, robot="ABB IRB 6400R/2.5-150"
        )
        named = loads_run(tmp_path / "named", robot="ABB IRB 6400R/2.5-150", tool="spindle in line with the flange")
        for files, text in (
            ([tmp_path / "unnamed"], "does not say its robot (label ''): give --robot, one of fanuc_r2000ic, irb6400r_25_150"),
            ([bare], "no displacement: expected a column *.d_T_B; it has robot.q_link, load.f_T_B"),
            ([tmp_path / "nowhere"], "expected a TOML file of columns or a run folder, see docs/how_to/identify.md"),
            (
                [FANUC.parent / "forces.csv"],
                "is no measured set: expected a run folder, or a TOML file that says which columns of it are what",
            ),
            ([FANUC, named], "springs elsewhere; identify them one by one"),
        ):
            assert main(["identify", "stiffness", *map(str, files)]) == 2
            assert text in capsys.readouterr().err

    def test_sets_add_up(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["identify", "stiffness", str(FANUC), str(FANUC), "--json"]) == 0
        twice = answer(capsys)
        assert main(["identify", "stiffness", str(FANUC), "--json"]) == 0
        once = answer(capsys)
        assert twice["poses"] == 2 * once["poses"]
        assert twice["residual_m"] == pytest.approx(once["residual_m"], rel=1e2 * ROUNDOFF)


def sensor(q: np.ndarray, **values: Any) -> Record:
    """sensor_chain at rest at these axis angles, its noise on, without a hose."""
    s = record(sensor_chain.MODEL.new())
    s.q[:] = q
    for name, value in {"hose_coefficients": 0.0, "model_hose": 0.0, **values}.items():
        if np.ndim(getattr(s, name)):
            getattr(s, name)[...] = value
        else:
            setattr(s, name, value)
    assert sensor_chain.MODEL.init(s) == 0
    return s


def tilted() -> np.ndarray:
    """Gravity in a base that is turned by TILT about its x and y."""
    return np.asarray(Rotation.from_rotvec([*TILT, 0.0]).inv().apply([0.0, 0.0, -9.81]))


def configurations(n: int = 15) -> np.ndarray:
    """Axis angles of wrist orientations all over."""
    rng = np.random.default_rng(2)
    return np.column_stack([np.tile([0.1, -1.4, 1.6], (n, 1)), rng.uniform([-3.0, -2.0, -3.0], [3.0, 2.0, 3.0], (n, 3))])


def payload_run(folder: Path, hose: Any = 0.0) -> Path:
    """Fifteen configurations, each read once."""
    q = configurations()
    read = [sensor(a, gravity_B=tilted(), hose_coefficients=hose, seed=k + 1, resolution_f=0.0, resolution_m=0.0) for k, a in enumerate(q)]
    columns = {"sensor.q": q, "sensor.f_S_raw": [list(s.f_S_raw) for s in read], "sensor.m_S_raw": [list(s.m_S_raw) for s in read]}
    return run_folder(folder, {k: np.asarray(v) for k, v in columns.items()}, kind="simulated")


class TestPayload:
    @pytest.mark.paper
    def test_15_configurations_and_the_sensor_that_takes_the_result(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """Paper 003, sec. 5.3: weight, centre of gravity, offset, tilt within four standard deviations; nothing is left at new poses."""
        out = tmp_path / "payload.ssv"
        assert main(["identify", "payload", str(payload_run(tmp_path / "run")), "--out", str(out), "--json"]) == 0
        found = answer(capsys)
        assert abs(found["weight_n"] - WEIGHT) < chance(found["weight_deviation_n"])
        assert np.all(np.abs(np.array(found["tilt_rad"]) - TILT) < chance(1.0) * np.array(found["tilt_deviation_rad"]) + np.sum(TILT**2))
        s = sensor(configurations()[0])
        for name, truth in (("model_cog_S", s.load_cog_S), ("model_offset_f", s.offset_f), ("model_offset_m", s.offset_m)):
            of = found["parameters"][name]
            assert np.all(np.abs(np.array(of["value"]) - truth) < chance(1.0) * np.array(of["deviation"]))
        given = {
            name: np.zeros_like(getattr(s, name))
            for name in ("model_weight_B", "model_cog_S", "model_offset_f", "model_offset_m", "model_hose")
        }
        for name, value in adopt.read(out)["sensor"].items():
            field, _, index = name.removesuffix("]").partition("[")
            given[field][tuple(int(i) - 1 for i in index.split(","))] = value["value"]
        quiet = {
            "gravity_B": tilted(),
            "noise_f": 0.0,
            "noise_m": 0.0,
            "walk_f": 0.0,
            "walk_m": 0.0,
            "resolution_f": 0.0,
            "resolution_m": 0.0,
        }
        for q in np.random.default_rng(9).uniform(KR300.q_min, KR300.q_max, (20, 6)):
            before, after = sensor(q, **quiet), sensor(q, **quiet, **given)
            # four standard deviations of weight and offset together, each direction
            assert np.abs(after.f_T_T).max() < chance(2.0 * max(found["parameters"]["model_offset_f"]["deviation"]))
            assert np.abs(before.f_T_T).max() > 2.0  # what the tilt does to a sensor that does not know it

    def test_a_hose_is_subtracted_first(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """Taken for weight otherwise: 30 N and more of it."""
        run = payload_run(tmp_path / "run", hose=sensor_chain.HOSE.coefficients)
        assert main(["identify", "payload", str(run), "--hose", "hose_gallows", "--json"]) == 0
        known = answer(capsys)
        assert abs(known["weight_n"] - WEIGHT) < chance(known["weight_deviation_n"])
        main(["identify", "payload", str(run), "--json"])
        unknown = answer(capsys)
        assert unknown["residual_force_n"] > 2.0 * known["residual_force_n"] or abs(unknown["weight_n"] - WEIGHT) > 10.0

    def test_says_what_was_found(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        out = tmp_path / "p.ssv"
        assert main(["identify", "payload", str(payload_run(tmp_path / "run")), "--out", str(out), "--component", "ft"]) == 0
        text = capsys.readouterr().out
        assert "KUKA KR 300 R2500 ultra: 15 orientations, condition numbers" in text
        assert "base tilted by " in text
        assert f"{out}: parameters of ft; robomill run SCENARIO --adopt {out}" in text
        assert set(adopt.read(out)) == {"ft"}

    def test_orientations_that_leave_something_open(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        run = run_folder(
            tmp_path / "run",
            {"s.q": np.zeros((5, 6)), "s.f_S_raw": np.ones((5, 3)), "s.m_S_raw": np.ones((5, 3))},
            kind="simulated",
        )
        assert main(["identify", "payload", str(run)]) == 2
        assert "gravity must point along all three axes of the sensor" in capsys.readouterr().err


def test_moments_of_a_run_are_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """KR 300 with drive springs: pure moments, which Eq. (23) knows of only by m_T_B."""
    rng, q, m, d = np.random.default_rng(1), [], [], []
    stiff = np.full((11, 3), 1e30)
    springs = [(0, 7.5e6), (1, 1.1e7), (3, 6.0e6), (5, 9e5), (6, 9e5), (7, 4.9e5)]
    for row, k in springs:
        stiff[row, 2] = k
    for _ in range(30):
        s = record(robot_compliance.MODEL.new())
        s.q_link[:] = rng.uniform([-1, -2.0, 1.0, -2, 0.5, -2], [1, -1.0, 2.0, 2, 1.5, 2])
        s.m_T_B[:] = rng.uniform(-1.0, 1.0, 3)
        s.stiffness[...] = stiff
        assert robot_compliance.MODEL.init(s) == 0
        q.append(np.array(s.q_link))
        m.append(np.array(s.m_T_B))
        d.append(np.array(s.d_T_B))
    columns = {"r.q_link": q, "r.f_T_B": np.zeros((30, 3)), "r.m_T_B": m, "r.d_T_B": d}
    run = run_folder(tmp_path / "run", {k: np.asarray(v) for k, v in columns.items()}, kind="simulated")
    assert main(["identify", "stiffness", str(run), "--poses", "0", "--json"]) == 0
    found = [s["stiffness_nm_per_rad"] for s in answer(capsys)["springs"]]
    # 1 N.m turns a drive by 2e-6 rad: what the first order leaves
    assert np.abs(np.array(found) / [k for _, k in springs] - 1.0).max() < physics(1.0, relative=1e-4)
