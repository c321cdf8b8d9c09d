"""The command line as a user meets it: help, results on disk, and one clear error for every kind of bad input."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest

from robomill.cli import main
from robomill.orchestration.runs.lock import FolderLock
from robomill.orchestration.runs.run import Run
from tests import SCENARIOS

PROGRAM = "G21 G90 G17 G54\nT1 M6\nS13000 M3\nG0 X-20. Y0. Z2.\nG1 Z-5. F1500.\nX20.\nM30\n"


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """A folder with a short scenario of one variant; the working directory."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "milling_cell.toml").write_text((SCENARIOS / "milling_cell.toml").read_text())
    (tmp_path / "part.ngc").write_text(PROGRAM)
    (tmp_path / "part.toml").write_text(
        '[scenario]\nname = "part"\nkind = "milling"\nsystem = "milling_cell.toml"\nprogram = "part.ngc"\n'
        '[workpiece]\nposition = ["1300 mm", 0, "1.2 m"]\nabc = ["180 deg", 0, 0]\nsize = ["10 mm", "60 mm", "30 mm"]\n'
        "[variants.cartesian]\nparameters.controller.mode = 1\n"
    )
    return tmp_path


def refused(capsys, *arguments: str) -> str:
    assert main(arguments) == 2
    return capsys.readouterr().err


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize("command", ["run", "view", "build", "check", "plan"])
def test_every_command_has_help_with_an_example(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    assert f"Example: robomill {command}" in " ".join(capsys.readouterr().out.split())


def test_a_run_leaves_recording_summary_and_pictures(cell, capsys):
    assert main(["run", "part.toml", "--csv"]) == 0
    assert "reaction" in capsys.readouterr().out
    folder = cell / "results" / "part"
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["scenario"] == "part"
    assert summary["warnings"] == []
    (note,) = summary["notes"]
    assert "2 blocks are slowed" in note
    figures = summary["variants"]["cartesian"]
    wanted = {
        "max_deviation_m",
        "max_deviation_location",
        "rms_deviation_m",
        "p95_deviation_m",
        "peak_force_n",
        "reaction_t50_s",
        "real_time_factor",
    }
    assert wanted <= set(figures)
    recorded = Run.load(folder / "cartesian")
    assert recorded.outcome == "finished"
    assert recorded.unit("milling.f_T_B") == "N"
    assert (folder / "cartesian" / "signals.csv").is_file()
    for picture in ("surfaces.png", "deviation.png", "cartesian/surface.png", "cartesian/force.png", "cartesian/projection.png"):
        assert (folder / picture).stat().st_size > 10_000


def test_json_and_nothing_else(cell, capsys):
    assert main(["run", "part.toml", "--no-pictures", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["scenario"] == "part"


def test_one_variant_again_keeps_the_figures_of_the_others(cell, capsys):
    edit(cell / "part.toml", "[variants.cartesian]", "[variants.uncompensated]\nparameters.controller.mode = 0\n[variants.cartesian]")
    assert main(["run", "part.toml", "--no-pictures"]) == 0
    file = cell / "results" / "part" / "summary.json"
    before = json.loads(file.read_text())["variants"]
    assert main(["run", "part.toml", "--no-pictures", "--variant", "cartesian", "--overwrite"]) == 0
    after = json.loads(file.read_text())["variants"]
    assert list(after) == ["uncompensated", "cartesian"]
    assert after["uncompensated"] == before["uncompensated"]


def test_a_variant_that_cannot_run_is_refused_before_any_recording_is_replaced(cell, capsys):
    assert main(["run", "part.toml", "--no-pictures"]) == 0
    recording = (cell / "results" / "part" / "cartesian" / "signals.parquet").read_bytes()
    (cell / "part.toml").write_text((cell / "part.toml").read_text() + "[variants.bad]\nparameters.controller.mode = 9\n")
    assert "maximum 2" in refused(capsys, "run", "part.toml", "--no-pictures", "--overwrite")
    assert (cell / "results" / "part" / "cartesian" / "signals.parquet").read_bytes() == recording


def test_what_is_there_is_replaced_only_when_asked_for(cell, capsys):
    """None of several variants is begun: the second is there, the first is not."""
    edit(cell / "part.toml", "[variants.cartesian]", "[variants.uncompensated]\nparameters.controller.mode = 0\n[variants.cartesian]")
    assert main(["run", "part.toml", "--no-pictures", "--variant", "cartesian"]) == 0
    folder = cell / "results" / "part"
    recording = (folder / "cartesian" / "signals.parquet").read_bytes()
    text = refused(capsys, "run", "part.toml", "--no-pictures")
    assert "part/cartesian already holds a run (run.toml, signals.parquet); choose another folder, or allow overwriting" in text
    assert "--overwrite" in text
    assert not (folder / "uncompensated").exists()
    assert (folder / "cartesian" / "signals.parquet").read_bytes() == recording
    assert main(["run", "part.toml", "--no-pictures", "--resume"]) == 0
    assert (folder / "uncompensated").exists()
    assert (folder / "cartesian" / "signals.parquet").read_bytes() == recording
    with pytest.raises(SystemExit):
        main(["run", "part.toml", "--resume", "--overwrite"])
    (cell / "one.toml").write_text('name = "one"\nstep = "4 ms"\nstop = "0.1 s"\n[components.drive]\nsource = "robot_drive"\n')
    assert main(["run", "one.toml"]) == 0
    assert "results/one already holds a run" in refused(capsys, "run", "one.toml")
    assert main(["run", "one.toml", "--overwrite"]) == 0


def test_two_at_once_in_one_folder(cell, capsys):
    folder = cell / "results" / "part"
    folder.mkdir(parents=True)
    with FolderLock(folder):
        assert f"another run is being written there, by process {os.getpid()}" in refused(capsys, "run", "part.toml", "--overwrite")
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_signals_end_a_command_with_their_status(cell, name):
    (cell / "one.toml").write_text('name = "one"\nstep = "4 ms"\nstop = "1e6 s"\n[components.drive]\nsource = "robot_drive"\n')
    process = subprocess.Popen(
        [sys.executable, "-m", "robomill", "run", "one.toml"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    live = cell / "results" / "one" / "signals.arrow"
    for _ in range(600):
        if process.poll() is not None or (live.exists() and live.stat().st_size > 100_000):
            break
        time.sleep(0.1)
    process.send_signal(getattr(signal, name))
    _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + getattr(signal, name)
    assert "interrupted" in said
    r = Run.load(cell / "results" / "one")
    assert r.outcome == "interrupted"
    assert len(r) > 0


def test_what_a_system_goes_on_without_is_said_before_it_runs(cell, capsys):
    (cell / "one.toml").write_text('name = "one"\nstep = "4 ms"\nstop = "8 ms"\n[components.drive]\nsource = "robot_drive"\n')
    assert main(["run", "one.toml"]) == 0
    told = capsys.readouterr().err
    for text in Run.load(cell / "results/one").info["warnings"]:
        assert f"warning: {text}\n" in told
    assert "warning: input drive.q_ref is not connected" in told


class TestBadInput:
    def test_options_that_do_not_apply_are_refused(self, cell, capsys):
        assert "--step goes with system files" in refused(capsys, "run", "part.toml", "--step", "0.001")
        for name in ("experiments/static_loads", "irb6400/lead_through"):
            assert "--stop goes with system files" in refused(capsys, "run", str(SCENARIOS / f"{name}.toml"), "--stop", "1")
        (cell / "one.toml").write_text('name = "one"\nstep = "0.004 s"\nstop = "0.1 s"\n[components.path]\nsource = "path_interpolator"\n')
        assert "--variant goes with scenarios" in refused(capsys, "run", "one.toml", "--variant", "axis")

    def test_loop(self, tmp_path, monkeypatch, capsys):
        """Only FMUs in other processes must be called from Python, so that who insists on compiled code is refused."""
        monkeypatch.chdir(tmp_path)
        assert main(["build", "--component", "path_interpolator", "--out", "."]) == 0
        text = 'name = "p"\nstep = "0.004 s"\nstop = "0.04 s"\n[components.s]\nsource = "path_interpolator.fmu"\nisolate = true\n'
        (tmp_path / "isolated.toml").write_text(text)
        assert "component 's' (IsolatedSlave) can only be called from Python" in refused(
            capsys, "run", "isolated.toml", "--loop", "compiled"
        )
        assert main(["run", "isolated.toml", "--loop", "python"]) == 0
        assert "--loop: only with milling" in refused(capsys, "run", str(SCENARIOS / "static_loads.toml"), "--loop", "python")

    def test_a_catalogue_that_is_not_there(self, cell, capsys):
        told = refused(capsys, "diagnose", str(SCENARIOS / "milling_cell.toml"), "runs", "--catalogue", "mine.toml")
        assert "no catalogue mine.toml; without --catalogue it is catalogue.toml beside the system, or the milling cell's" in told

    def test_a_diagnosis_is_of_a_campaign_or_of_a_system_and_its_runs(self, cell, capsys):
        system = str(SCENARIOS / "milling_cell.toml")
        for given in ((), (system,)):
            assert "expected SYSTEM.toml RUN..., or --campaign FILE.toml" in refused(capsys, "diagnose", *given)
        told = refused(capsys, "diagnose", system, "--campaign", "c.toml")
        assert f"--campaign c.toml names systems and runs itself; {system} is one more: put it into the file" in told
        assert "no campaign c.toml" in refused(capsys, "diagnose", "--campaign", "c.toml")
        told = refused(capsys, "diagnose", "--campaign", "c.toml", "--adopt", "a.ssv")
        assert "--adopt a.ssv: with --campaign, put its values into [parameters] of the systems that have them" in told

    def test_static_loads_replace_nothing_unasked(self, tmp_path, monkeypatch, capsys):
        (tmp_path / "summary.json").write_text("{}")
        arguments = ("run", str(SCENARIOS / "static_loads.toml"), "--no-pictures", "--out", str(tmp_path))
        assert "already holds results (summary.json)" in refused(capsys, *arguments)
        assert (tmp_path / "summary.json").read_text() == "{}"
        assert main([*arguments, "--overwrite"]) == 0

    def test_a_component_that_is_not_there_is_named_with_its_line(self, cell, capsys):
        edit(cell / "part.toml", "[variants.cartesian]", '[parameters]\nmiling.spacing = "1 mm"\n[variants.cartesian]')
        assert "part.toml:11: unknown component 'miling'; did you mean 'milling'" in refused(capsys, "run", "part.toml")

    def test_a_program_is_no_scenario(self, cell, capsys):
        assert "`robomill plan part.ngc` looks at the program" in refused(capsys, "run", "part.ngc")

    def test_malformed_program_names_the_line(self, cell, capsys):
        edit(cell / "part.ngc", "X20.", "X2O.")
        assert "part.ngc line 6" in refused(capsys, "run", "part.toml")

    def test_unreachable_path_names_block_pose_and_what_to_do(self, cell, capsys):
        edit(cell / "part.toml", "1300 mm", "2900 mm")
        text = refused(capsys, "run", "part.toml")
        assert "reach" in text
        assert "path" in text

    def test_unknown_port(self, cell, capsys):
        edit(cell / "milling_cell.toml", 'to = "drive.q_ref"', 'to = "drive.q_reff"')
        text = refused(capsys, "run", "part.toml")
        assert "q_reff" in text
        assert "did you mean 'q_ref'" in text

    def test_unit_mismatch(self, cell, capsys):
        edit(cell / "milling_cell.toml", 'to = "milling.v_BT_B"', 'to = "drive.correction_B"')
        text = refused(capsys, "run", "part.toml")
        assert "m/s" in text
        assert "drive.correction_B" in text

    def test_two_sources_for_one_port(self, cell, capsys):
        extra = '\n[[connections]]\nfrom = "path.q_ref"\nto = "compliance.q_link"\n'
        (cell / "milling_cell.toml").write_text((cell / "milling_cell.toml").read_text() + extra)
        text = refused(capsys, "run", "part.toml")
        assert "compliance.q_link" in text
        assert "drive.q_link" in text
        assert "path.q_ref" in text

    def test_missing_and_broken_fmu(self, cell, capsys):
        edit(cell / "milling_cell.toml", 'source = "robot_drive"', 'source = "gone.fmu"')
        assert "gone.fmu" in refused(capsys, "run", "part.toml")
        (cell / "gone.fmu").write_bytes(b"not a zip")
        assert "gone.fmu" in refused(capsys, "run", "part.toml")

    def test_unknown_parameter_and_value_out_of_bounds(self, cell, capsys):
        edit(cell / "part.toml", "controller.mode = 1", "controller.mod = 1")
        assert "did you mean 'mode'" in refused(capsys, "run", "part.toml")
        edit(cell / "part.toml", "controller.mod = 1", "controller.mode = 7")
        text = refused(capsys, "run", "part.toml")
        assert "mode" in text
        assert "maximum 2" in text

    def test_missing_scenario_lists_what_is_there(self, cell, capsys):
        assert "part.toml" in refused(capsys, "run", "nowhere.toml")

    def test_unknown_variant(self, cell, capsys):
        assert "variants: cartesian" in refused(capsys, "run", "part.toml", "--variant", "axis")


@pytest.mark.slow
def test_ctrl_c_leaves_a_readable_recording(cell):
    """A long program is stopped while it runs: exit status 130, one line, and the results so far."""
    edit(cell / "part.ngc", "G1 Z-5.", "G4 P1200.\nG1 Z-5.")
    process = subprocess.Popen(
        [sys.executable, "-m", "robomill", "run", "part.toml", "--no-pictures"],
        cwd=cell,
        env=dict(os.environ),
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    live = cell / "results" / "part" / "cartesian" / "signals.arrow"
    deadline = time.monotonic() + 120
    while not (live.is_file() and live.stat().st_size > 200_000):
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    text = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert "interrupted at t =" in text
    recorded = Run.load(live.parent)
    assert recorded.outcome == "interrupted"
    assert len(recorded) > 100


class TestResume:
    """`--resume` keeps what is finished and goes on with what is not."""

    def signals(self, folder: Path, variant: str) -> dict[str, bytes]:
        run = Run.load(folder / variant)
        return {"t": run.t.tobytes(), **{name: column.tobytes() for name, column in run.columns.items()}}

    def test_an_interrupted_scenario(self, cell, capsys, monkeypatch):
        """The first of two variants is finished, the second was stopped in its middle."""
        from robomill.cell import milling

        edit(cell / "part.toml", "[variants.cartesian]", "[variants.none]\nparameters.controller.mode = 0\n[variants.cartesian]")
        assert main(["run", "part.toml", "--no-pictures", "--out", "whole"]) == 0
        edit(cell / "milling_cell.toml", 'step = "4 ms"', 'step = "4 ms"\nloop = "python"')  # the compiled loop reports at no certain step
        arguments = ["run", "part.toml", "--no-pictures", "--out", "parts", "--checkpoint-every", "100"]

        def stop(progress: object, what: str, steps: int) -> object:
            def report(done: int, total: int) -> None:
                if what == "cartesian" and done == 250:
                    raise KeyboardInterrupt

            return report

        with monkeypatch.context() as patch:
            patch.setattr(milling, "_reporting", stop)
            assert main(arguments) == 130
        assert Run.load(cell / "parts/cartesian").outcome == "interrupted"
        before = (cell / "parts/none/signals.parquet").stat().st_mtime_ns
        edit(cell / "milling_cell.toml", 'loop = "python"', 'loop = "auto"')
        assert main([*arguments, "--resume"]) == 0
        assert (cell / "parts/none/signals.parquet").stat().st_mtime_ns == before
        assert Run.load(cell / "parts/cartesian").info["resumed"] == [0.8]
        for variant in ("none", "cartesian"):
            assert self.signals(cell / "whole", variant) == self.signals(cell / "parts", variant)
        figures = json.loads((cell / "parts/summary.json").read_text())["variants"]
        whole = json.loads((cell / "whole/summary.json").read_text())["variants"]
        assert figures["none"]["real_time_factor"] is None
        for variant in figures:
            assert {k: v for k, v in figures[variant].items() if k != "real_time_factor"} == {
                k: v for k, v in whole[variant].items() if k != "real_time_factor"
            }

    def test_another_program(self, cell, capsys):
        assert main(["run", "part.toml", "--no-pictures"]) == 0
        edit(cell / "part.ngc", "Z-5.", "Z-4.")
        assert "holds a run of another system: files: path.segments was" in refused(capsys, "run", "part.toml", "--resume")


class TestBuild:
    """Which files `robomill build` writes."""

    @pytest.mark.slow
    @pytest.mark.skipif(sys.platform != "linux", reason="builds libraries for linux64")
    def test_both_versions_of_fmi_side_by_side(self, tmp_path, monkeypatch, capsys):
        """FMI 2 where everything looks, FMI 3 below; both pass the battery and give the same bits."""
        monkeypatch.chdir(tmp_path)
        text = 'name = "one"\nstep = "0.004 s"\nstop = "0.1 s"\n[components.sensor]\nsource = "sensor_chain"\n'
        (tmp_path / "one.toml").write_text(text)
        assert main(["build", "--backend", "native", "--fmi", "2", "3", "--ssp", "one.toml", "--json"]) == 0
        files = ["dist/sensor_chain.fmu", "dist/fmi3/sensor_chain.fmu"]
        assert json.loads(capsys.readouterr().out) == {"fmus": files, "packages": ["dist/one.ssp"]}
        assert main(["check", *files, "--json"]) == 0
        reports = json.loads(capsys.readouterr().out)
        told = [next(r["detail"] for r in reports[f] if r["check"] == "exports") for f in files]
        assert [t[-7:] for t in told] == ["FMI 2.0", "FMI 3.0"]
        runs = []
        for folder in ("dist", "dist/fmi3"):
            assert main(["run", "one.toml", "--fmus", folder, "--out", f"{folder}/run"]) == 0
            runs.append(Run.load(tmp_path / folder / "run"))
        assert len(runs[0]) == 26
        for name in runs[0].columns:
            assert runs[0][name].tobytes() == runs[1][name].tobytes(), name

    def test_fmi_3_is_native(self, tmp_path, monkeypatch, capsys):
        monkeypatch.chdir(tmp_path)
        assert "--fmi 3, --platform, --scalars and --sources go with --backend native" in refused(
            capsys, "build", "--fmi", "2", "--fmi", "3"
        )
        assert not list(tmp_path.rglob("*.fmu"))


def with_more_values(package: Path) -> None:
    """A value for a variable that the FMU does not have goes into a package."""
    with zipfile.ZipFile(package) as z:
        files = {name: z.read(name) for name in z.namelist()}
    value = b'<ssv:Parameters><ssv:Parameter name="temperature_of_moon"><ssv:Real value="1"/></ssv:Parameter>'
    files["resources/sensor.ssv"] = files["resources/sensor.ssv"].replace(b"<ssv:Parameters>", value)
    with zipfile.ZipFile(package, "w") as z:
        for name, content in files.items():
            z.writestr(name, content)


class TestPackages:
    """`robomill build --ssp` and `robomill run X.ssp`."""

    @pytest.mark.slow
    def test_round_trip_of_a_scenario(self, cell, capsys):
        """The package, unpacked and run through FMUs, gives the numbers of the scenario run in process."""
        assert main(["run", "part.toml", "--no-pictures", "--out", "here"]) == 0
        capsys.readouterr()
        assert main(["build", "--ssp", "part.toml", "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["packages"] == ["dist/part_cartesian.ssp"]
        assert len(told["fmus"]) == 6
        with_more_values(cell / "dist/part_cartesian.ssp")
        assert main(["run", "dist/part_cartesian.ssp", "--out", "there"]) == 0
        assert "part_cartesian.ssp: ignored: component 'sensor': unknown variable 'temperature_of_moon'" in capsys.readouterr().err
        here, there = Run.load(cell / "here/cartesian"), Run.load(cell / "there")
        assert set(here.columns) == set(there.columns)
        assert here.t.tobytes() == there.t.tobytes()
        for name in here.columns:
            assert here[name].tobytes() == there[name].tobytes(), name

    def test_refused(self, cell, capsys):
        (cell / "x.ssp").write_text("hello")
        assert "x.ssp: not a zip archive, so not an SSP" in refused(capsys, "run", "x.ssp")
        assert "y.ssp: no such file; SSPs in that folder: x.ssp" in refused(capsys, "run", "y.ssp")
        assert "no variant none; variants: cartesian" in refused(capsys, "build", "--ssp", "part.toml", "--variant", "none")


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("from robomill.cli import parser; parser().format_help()", ("numpy", "numba", "rich")),
        (
            "import robomill.run_command",
            ("matplotlib", "pandas", "rich", "fmpy", "scipy.ndimage", "scipy.optimize", "pyarrow", "importlib.metadata"),
        ),
        (
            "import numpy as np; from robomill.orchestration.runs.signals import arrow; arrow(np.zeros(3)); arrow(np.array([True]))",
            ("pandas",),
        ),
    ],
)
def test_a_command_loads_what_it_begins_with_and_no_more(code: str, absent: tuple[str, ...]) -> None:
    check = f"import sys; {code}; print([name for name in {absent!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_collector_does_not_look_at_what_modules_hold() -> None:
    load = "from robomill.cli import _function; _function('command_options.run')"
    code = f"import gc; {load}; print(gc.get_freeze_count() > 0, gc.isenabled())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True True"


def test_options_that_are_added_when_they_are_used_are_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, option in (
        (["identify", "stiffness"], "--tilt"),
        (["sweep"], "--summary"),
        (["plan"], "--dialect"),
        (["rsi"], "--listen"),
    ):
        with pytest.raises(SystemExit):
            main([*arguments, "--help"])
        assert option in capsys.readouterr().out
