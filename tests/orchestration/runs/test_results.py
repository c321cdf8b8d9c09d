"""Recording and reading runs: columns, units, crash safety."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib

import numpy as np
import pyarrow.parquet
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import ResultsError
from robomill.orchestration.runs.disk import LINE, zeros_on_lines
from robomill.orchestration.runs.recorder import Recorder, frame_of
from robomill.orchestration.runs.run import Run
from robomill.orchestration.runs.signals import finalise
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.definition import Recording
from robomill.orchestration.system.wiring import wire
from tests import ROOT
from tests.orchestration.mocks import Mock, resolver, system


def pose():
    """An array, a matrix, an integer and a boolean."""
    ports = [
        PortData("speed", "input", unit="1", start=1.0),
        *(
            PortData(f"p_BT_B[{i}]", "output", unit="m", minimum=-9.0, maximum=9.0, description="position", dependencies=("speed",))
            for i in (1, 2, 3)
        ),
        *(PortData(f"R[{i},{j}]", "output", unit="1", dependencies=()) for i in (1, 2) for j in (1, 2)),
        PortData("block", "output", type="integer", dependencies=()),
        PortData("finished", "output", type="boolean", dependencies=()),
    ]
    return Mock("path", ports, lambda u, t: [t, 2 * t, 1 / 3 + t, 1, 2, 3, 4, round(t / 0.004), t > 0.01])


def record(folder, recording=Recording(), stop=0.02, **options):  # noqa: B008  # frozen
    slaves = [pose()]
    return run(system(slaves, recording=recording), folder, stop=stop, resolver=resolver(slaves), **options)


class TestManyRows:
    """Rows that come as whole arrays."""

    @pytest.mark.parametrize("every", [1, 3])
    @pytest.mark.parametrize("chunk", [5, 100])
    def test_what_is_on_disk_is_what_was_observed(self, tmp_path, every, chunk):
        """An array that is written as it stands, one that is full in part, another full one: the stream holds all of them at once."""
        slave = Mock("c", [PortData(name, "output") for name in ("y", "z")], lambda _, t: [t, t])
        wiring = wire(system([slave]), {"c": slave.ports})
        recorder = Recorder(tmp_path, chunk=chunk, every=every)
        recorder.begin(wiring, 0.004)
        rows = np.random.default_rng(3).standard_normal((3, 56))
        rows[0] = np.arange(1, 57) * 0.004
        for first, count in ((0, 24), (24, 8), (32, 24)):
            columns = np.zeros((3, 24))
            columns[:, :count] = rows[:, first : first + count]
            recorder.observe_columns(columns, count)
        recorder.flush()
        live = Run.load(tmp_path)
        recorder.end("finished", "")
        for run_ in (live, Run.load(tmp_path)):
            assert np.array_equal([run_.t, run_["c.y"], run_["c.z"]], rows[:, ::every])

    def test_rows_that_are_much_are_not_kept_for_later(self, tmp_path, monkeypatch):
        """With very many columns what was kept before goes first, less than that is kept as ever."""
        slave = Mock("c", [PortData("y", "output")], lambda _, t: [t])
        recorder = Recorder(tmp_path)
        recorder.begin(wire(system([slave]), {"c": slave.ports}), 0.004)
        monkeypatch.setattr("robomill.orchestration.runs.recorder._MUCH", 8 * 7 * 2)
        recorder.observe(0.0, np.array([1.0]))
        columns = np.arange(1.0, 17.0).reshape(2, 8)
        lengths = []
        for count in (7, 6):
            recorder.observe_columns(columns, count)
            columns += 8.0
            lengths.append(len(Run.load(tmp_path)))
        recorder.end("finished", "")
        assert lengths == [8, 8]
        assert np.array_equal(Run.load(tmp_path)["c.y"], [1.0, *columns[1, :7] - 16.0, *columns[1, :6] - 8.0])

    def test_arrays_written_as_they_stand_begin_with_a_line_of_the_cache(self, tmp_path):
        """Wherever the messages before them end, and in memory as in the file; foreign readers do not mind the longer heads."""
        slave = Mock("c", [PortData(name, "output") for name in ("y", "z")], lambda _, t: [t, t])
        recorder = Recorder(tmp_path, chunk=5)
        recorder.begin(wire(system([slave]), {"c": slave.ports}), 0.004)
        columns = zeros_on_lines(3, 24)
        for count in (24, 7, 24):
            recorder.observe_columns(columns, count)
        recorder.flush()
        with pyarrow.memory_map(str(tmp_path / "signals.arrow")) as file:
            batches = [b for b in pyarrow.ipc.open_stream(file) if len(b) == 24]
            addresses = [batch.column(0).buffers()[1].address for batch in batches] + [columns.ctypes.data]
        recorder.end("finished", "")
        assert [address % LINE for address in addresses] == [0, 0, 0]


class TestReading:
    """Run.load and what it gives."""

    def test_columns_arrays_units(self, tmp_path):
        r = record(tmp_path / "r")
        assert list(r.columns)[:4] == ["path.p_BT_B[1]", "path.p_BT_B[2]", "path.p_BT_B[3]", "path.R[1,1]"]
        assert np.array_equal(r["path.p_BT_B[3]"], 1 / 3 + r.t)
        assert r["path.p_BT_B"].shape == (6, 3)
        assert np.array_equal(r["path.R"][5], [[1, 2], [3, 4]])
        assert list(r["path.block"]) == [0, 1, 2, 3, 4, 5]
        assert list(r["path.finished"]) == [0, 0, 0, 1, 1, 1]
        assert (r.unit("path.p_BT_B"), r.unit("path.block"), r.components, len(r), r.outcome) == ("m", "", ("path",), 6, "finished")
        assert "path.R" in r
        assert "path.S" not in r

    def test_the_same_from_memory(self, tmp_path):
        a, b = record(tmp_path / "r"), record(None)
        assert list(a.columns) == list(b.columns)
        assert all(np.array_equal(a[c], b[c]) for c in a.columns)
        assert np.array_equal(a.t, b.t)

    def test_unknown_column(self, tmp_path):
        r = record(tmp_path / "r")
        with pytest.raises(KeyError, match=r"unknown column 'path.p_BT'; did you mean 'path.p_BT_B' or"):
            r["path.p_BT"]
        with pytest.raises(KeyError, match="unknown column 'x'"):
            r.unit("x")

    def test_some_elements_of_a_matrix(self, tmp_path):
        r = record(tmp_path / "r", Recording(("path.R[2,1]", "path.R[1,2]")))
        assert np.array_equal(r["path.R"][0], [2, 3])

    def test_errors(self, tmp_path):
        with pytest.raises(ResultsError, match="no run folder"):
            Run.load(tmp_path / "none")
        (tmp_path / "x").write_text("")
        with pytest.raises(ResultsError, match=r"is not a run: there is no run.toml in it; it holds x"):
            Run.load(tmp_path)
        (tmp_path / "run.toml").write_text("a = ")
        with pytest.raises(ResultsError, match=r"run.toml: not valid TOML"):
            Run.load(tmp_path)
        (tmp_path / "run.toml").write_text("")
        with pytest.raises(ResultsError, match=r"there is no signals.parquet, signals.arrow or signals.csv in it"):
            Run.load(tmp_path)
        (tmp_path / "signals.parquet").write_text("rubbish")
        with pytest.raises(ResultsError, match="the signals cannot be read"):
            Run.load(tmp_path)

    @pytest.mark.parametrize(
        ("csv", "text"),
        [
            ("time,a.b\n0,1\n", "the signals have no column 't'"),
            (
                "t,a.b\n0,1\nnan,2\n2,3\n",
                r"time is nan in row 1 \(counted from zero\) of 3; expected finite numbers that increase \[s\]; "
                "import the log anew, without that row",
            ),
            ("t,a.b\n0,1\n1,2\n,3\n", r"time is nan in row 2 \(counted from zero\) of 3"),
            ("t,a.b\n0,1\ninf,2\n", r"time is inf in row 1 \(counted from zero\) of 2"),
            ("t,a.b\n0,1\n0,2\n", "time does not increase after t = 0 s"),
            ("t,a.b\n0,x\n", "column 'a.b' holds no numbers but string"),
        ],
    )
    def test_bad_measurements(self, tmp_path, csv, text):
        (tmp_path / "run.toml").write_text("")
        (tmp_path / "signals.csv").write_text(csv)
        with pytest.raises(ResultsError, match=text):
            Run.load(tmp_path)

    def test_a_measured_run_names_the_port_of_each_column(self, tmp_path):
        (tmp_path / "run.toml").write_text('[columns.Fx]\nport = "sensor.f_S_raw[1]"\nunit = "N"\n')
        (tmp_path / "signals.csv").write_text("t,Fx\n0,1.5\n0.004,2.5\n")
        r = Run.load(tmp_path)
        assert list(r["sensor.f_S_raw[1]"]) == [1.5, 2.5]
        assert r.unit("sensor.f_S_raw") == "N"


class TestWriting:
    """What is in the folder."""

    def test_what_the_parquet_file_says(self, tmp_path):
        record(tmp_path / "r")
        schema = pyarrow.parquet.read_schema(tmp_path / "r" / "signals.parquet")
        assert [str(schema.field(n).type) for n in ("t", "path.p_BT_B[1]", "path.block", "path.finished")] == [
            "double",
            "double",
            "int64",
            "bool",
        ]
        field = schema.field("path.p_BT_B[1]")
        said = {k.decode(): v.decode() for k, v in field.metadata.items() if not k.startswith(b"PARQUET")}
        assert said == {
            "component": "path", "port": "p_BT_B[1]", "type": "real", "unit": "m", "minimum": "-9.0", "maximum": "9.0",
            "description": "position", "frame": "B", "dependencies": "speed",
        }  # fmt: skip
        assert tomllib.loads(schema.metadata[b"robomill"].decode())["system"] == "test"

    def test_run_toml(self, tmp_path):
        record(tmp_path / "r", labels={"robot": "KR 300", "repeat": 2})
        info = tomllib.loads((tmp_path / "r" / "run.toml").read_text())
        assert (info["schema"], info["outcome"], info["system"], info["algorithm"]) == (
            "robomill-run/1",
            "finished",
            "test",
            "gauss-seidel",
        )
        assert (info["robot"], info["labels"], info["clock"]["step"]) == ("KR 300", {"repeat": 2}, 0.004)
        assert info["columns"]["path.p_BT_B[2]"] == {"port": "path.p_BT_B[2]", "unit": "m", "frame": "B", "type": "real"}
        assert info["warnings"] == ["input path.speed is not connected: it keeps its start value 1"]
        assert sorted(p.name for p in (tmp_path / "r").iterdir()) == ["run.toml", "signals.parquet"]

    @pytest.mark.parametrize(
        ("patterns", "expected"),
        [
            (["path.block"], ["path.block"]),
            (["path.p_BT_B"], ["path.p_BT_B[1]", "path.p_BT_B[2]", "path.p_BT_B[3]"]),
            (["path.finished", "path.p_*[3]"], ["path.p_BT_B[3]", "path.finished"]),
            (["*.block", "path.bl*"], ["path.block"]),
        ],
    )
    def test_chosen_columns(self, tmp_path, patterns, expected):
        r = record(tmp_path / "r", Recording(tuple(patterns)))
        assert list(r.columns) == expected
        assert list(Run.load(tmp_path / "r").t) == list(r.t)

    def test_whole_component(self, tmp_path):
        assert len(record(tmp_path / "r", Recording(("path",))).columns) == 9

    def test_unknown_column(self, tmp_path):
        with pytest.raises(ResultsError, match=r"recording: unknown column 'path.blok'; did you mean 'path.block' or"):
            record(tmp_path / "r", Recording(("path.blok",)))

    def test_every_other_step_and_small_chunks(self, tmp_path):
        r = record(tmp_path / "r", Recording(every=2, chunk=3), stop=0.04)
        assert list(r["path.block"]) == [0, 2, 4, 6, 8, 10]

    def test_csv_has_all_digits(self, tmp_path):
        r = record(tmp_path / "r", Recording(csv=True))
        (tmp_path / "r" / "signals.parquet").unlink()
        again = Run.load(tmp_path / "r")
        assert all(np.array_equal(r[c], again[c]) for c in r.columns)

    def test_an_existing_run_is_not_overwritten_by_accident(self, tmp_path):
        record(tmp_path / "r", stop=0.02)
        with pytest.raises(
            ResultsError, match=r"already holds a run \(run.toml, signals.parquet\); choose another folder, or allow overwriting"
        ):
            record(tmp_path / "r", stop=0.04)
        assert len(Run.load(tmp_path / "r")) == 6
        assert len(record(tmp_path / "r", stop=0.04, overwrite=True)) == 11


KILLED = """
import os, signal, sys
from pathlib import Path
from tests.orchestration.mocks import source, resolver, system
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.disk import LINE, zeros_on_lines
from robomill.orchestration.system.definition import Recording
from robomill.orchestration.system.wiring import wire

def progress(done, total):
    if done == 57:
        os.kill(os.getpid(), signal.SIGKILL)

slaves = [source("s", lambda t: 3 * t)]
run(system(slaves, recording=Recording(chunk=int(sys.argv[2]))), Path(sys.argv[1]), stop=1.0, resolver=resolver(slaves), progress=progress)
"""


class TestCrash:
    """What is left when a process dies."""

    @pytest.fixture
    def killed(self, tmp_path):
        return self.left(tmp_path / "r", 10)

    def left(self, folder, chunk):
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        result = subprocess.run([sys.executable, "-c", KILLED, folder, str(chunk)], cwd=ROOT, env=environment, check=False)
        assert result.returncode != 0
        return folder

    def test_a_killed_process_leaves_all_rows(self, killed):
        r = Run.load(killed)
        assert (r.outcome, len(r)) == ("running", 58)  # chunks of 10: 50 on disk, and what was in memory
        assert "while no component was being called" in r.info["message"]
        assert np.array_equal(r["s.y"], 3 * r.t)

    def test_also_with_a_torn_last_chunk(self, killed):
        live = killed / "signals.arrow"
        live.write_bytes(live.read_bytes()[:-100])
        assert len(Run.load(killed)) == 40

    def test_rows_and_columns_are_kept_before_the_first_chunk_is_written(self, tmp_path):
        killed = self.left(tmp_path / "r", 250)
        assert not (killed / "signals.arrow").exists()
        there, whole = Run.load(killed), Run.load(self.left(tmp_path / "whole", 10))
        assert (there.outcome, len(there)) == ("running", 58)
        assert np.array_equal(there["s.y"], 3 * there.t)
        assert there.ports == whole.ports
        finalise(killed)
        assert len(Run.load(killed)) == 58
        assert Run.load(killed).ports == whole.ports
        assert not (killed / "flight").exists()

    def test_it_can_be_finalised_later(self, killed):
        finalise(killed)
        assert not (killed / "signals.arrow").exists()
        assert len(Run.load(killed)) == 58
        assert not (killed / "flight").exists()
        finalise(killed)  # nothing left to do

    def test_readable_while_it_runs(self, tmp_path):
        seen = []

        def look(done, total):
            r = Run.load(tmp_path / "r")
            seen.append((len(r), r.outcome))

        record(tmp_path / "r", Recording(chunk=2), progress=look)
        assert seen == [(2, "running"), (2, "running"), (4, "running"), (4, "running"), (6, "running")]


@pytest.mark.parametrize(
    ("port", "frame"),
    [
        ("p_BT_B[1]", "B"),
        ("quat_BT", "B"),
        ("f_T_T", "T"),
        ("f_S_raw", "S"),
        ("q_link[6]", ""),
        ("spindle_torque", ""),
        ("R_BT[1,1]", "B"),
        ("d_T_B", "B"),
    ],
)
def test_frames_are_read_from_names(port, frame):
    assert frame_of(port) == frame
