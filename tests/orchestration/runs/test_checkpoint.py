"""Checkpoints and going on from them: the same numbers as without an interruption, or a clear refusal."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow.parquet
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import Interrupted, OrchestrationError, ResultsError, RunError, SlaveError
from robomill.orchestration.runs.checkpoint import Snapshot, read, write
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.definition import Component, Connection, Recording, System
from tests.orchestration import c_fmu
from tests.orchestration.mocks import Mock

STEP, STOP = 0.01, 1.0


class Memo(NamedTuple):
    """A state with names, as in-process components have them."""

    value: float
    stepped: bool
    raw: bytes


class Spring(Mock):
    """A damped oscillator with everything a state can be made of; `dies` lets it fail at a time, once."""

    def __init__(self, name: str = "spring", dies: float = np.inf, error: BaseException | None = None) -> None:
        ports = [PortData("f", "input", start=0.0), PortData("x", "output", unit="1", dependencies=())]
        ports += [PortData("count", "output", "integer", dependencies=()), PortData("moving", "output", "boolean", dependencies=())]
        super().__init__(name, [*ports, PortData("k", "parameter", unit="1", start=1.0)], lambda u, t: self.outputs())
        self.x, self.v, self.n, self.dies, self.error = 1.0, np.zeros(1), 0, dies, error

    def outputs(self) -> list[float]:
        return [self.x, self.n, abs(self.v[0]) > 0.3]

    def step(self, t: float, h: float) -> None:
        if t > self.dies:
            raise self.error or ValueError("broken")
        self.v += h * (-30.0 * self.x - 0.1 * self.v + self.u[0])
        self.x += h * float(self.v[0])
        self.n += 1
        super().step(t, h)

    def get_state(self) -> Any:
        return Memo(self.x, self.stepped, self.v.tobytes()), [self.n, np.float64(self.t)], {"y": self.y.copy(), "text": "ä", "none": None}

    def set_state(self, state: Any) -> None:
        memo, (self.n, self.t), arrays = state
        self.x, self.stepped, self.v = memo.value, memo.stepped, np.frombuffer(memo.raw).copy()
        self.y, self.t = arrays["y"], float(self.t)


def oscillator(*more: Component, every: int = 30, record: int = 1, **changes: Any) -> System:
    """Two springs that pull each other, one of them with delay."""
    components = (Component("a", "spring", {"k": 2.0}), Component("b", "spring"), *more)
    connections = (Connection("a.x", "b.f"), Connection("b.x", "a.f", delayed=True))
    recording = Recording(checkpoint_every=every, every=record, chunk=7)
    return replace(System("two", STEP, components, connections, recording=recording, stop=STOP), **changes)


def resolver(dies: float = np.inf, error: BaseException | None = None) -> Any:
    return lambda source, name: Spring(name, dies if name == "b" else np.inf, error)


def same_content(one: Path, other: Path) -> None:
    a, b = (pyarrow.parquet.read_table(f / "signals.parquet") for f in (one, other))
    assert a.schema.equals(b.schema)
    assert [f.metadata for f in a.schema] == [f.metadata for f in b.schema]
    for name in a.column_names:
        assert a[name].combine_chunks().equals(b[name].combine_chunks()), name


@pytest.fixture
def whole(tmp_path) -> Path:
    """A run without interruption."""
    run(oscillator(), tmp_path / "whole", resolver=resolver())
    return tmp_path / "whole"


class TestSameNumbers:
    """However the run was ended, what is continued equals what was not interrupted."""

    def test_after_an_error(self, whole, tmp_path):
        folder = tmp_path / "r"
        with pytest.raises(RunError, match="component 'b' failed"):
            run(oscillator(), folder, resolver=resolver(0.745))
        assert (Run.load(folder).outcome, Run.load(folder).t[-1]) == ("failed", 0.75)
        snapshot = read(folder)
        assert (snapshot.done, snapshot.time) == (60, 0.6)
        result = run(oscillator(), folder, resolver=resolver(), resume=True)
        assert result.outcome == "finished"
        assert result.info["resumed"] == [0.6]
        assert result.info["created"] == Run.load(folder).info["created"]
        same_content(whole, folder)
        assert np.ptp(result["a.x"]) > 1.0

    def test_again_and_again(self, whole, tmp_path):
        folder = tmp_path / "r"
        for t in (0.1, 0.4, 0.5, 0.985):  # the first before any checkpoint
            with pytest.raises(RunError):
                run(oscillator(), folder, resolver=resolver(t), resume=True)
        result = run(oscillator(), folder, resolver=resolver(), resume=True)
        assert result.info["resumed"] == [0.3, 0.3, 0.9]
        same_content(whole, folder)

    def test_every_third_row(self, tmp_path):
        """The steps that are recorded stay the same ones."""
        run(oscillator(record=3), tmp_path / "whole", resolver=resolver())
        with pytest.raises(RunError):
            run(oscillator(record=3, every=20), tmp_path / "r", resolver=resolver(0.5))
        run(oscillator(record=3, every=20), tmp_path / "r", resolver=resolver(), resume=True)
        same_content(tmp_path / "whole", tmp_path / "r")

    def test_ctrl_c(self, whole, tmp_path):
        def press(done: int, total: int) -> None:
            if done == 50:
                os.kill(os.getpid(), signal.SIGINT)

        with pytest.raises(Interrupted):
            run(oscillator(), tmp_path / "r", resolver=resolver(), progress=press)
        run(oscillator(), tmp_path / "r", resolver=resolver(), resume=True)
        same_content(whole, tmp_path / "r")

    def test_a_killed_process(self, whole, tmp_path):
        script = (
            "import os\nfrom pathlib import Path\nfrom robomill.orchestration.assembly import run\n"
            "from tests.orchestration.runs.test_checkpoint import oscillator, resolver\n"
            f"run(oscillator(), Path({str(tmp_path / 'r')!r}), resolver=resolver(),"
            " progress=lambda done, total: os.kill(os.getpid(), 9) if done == 77 else None)\n"
        )
        assert subprocess.run([sys.executable, "-c", script], check=False).returncode == -9
        assert (tmp_path / "r/signals.arrow").is_file()
        run(oscillator(), tmp_path / "r", resolver=resolver(), resume=True)
        same_content(whole, tmp_path / "r")

    def test_stopped_while_it_is_taken_up(self, whole, tmp_path, monkeypatch):
        """The signals were set aside and only a part of them is back: they are still all there."""
        folder = tmp_path / "r"
        with pytest.raises(RunError):
            run(oscillator(), folder, resolver=resolver(0.8))
        with monkeypatch.context() as patch:
            patch.setattr("robomill.orchestration.runs.stream.rows_of", lambda file: (_ for _ in ()).throw(KeyboardInterrupt))
            with pytest.raises(Interrupted):
                run(oscillator(), folder, resolver=resolver(), resume=True)
        assert (folder / "before-signals.parquet").is_file()
        run(oscillator(), folder, resolver=resolver(), resume=True)
        assert sorted(f.name for f in folder.iterdir()) == ["checkpoint.zip", "run.toml", "signals.parquet"]
        same_content(whole, folder)

    def test_overridden_inputs(self, tmp_path):
        """An override that began before the checkpoint and was never repeated holds after it."""

        def push(master: Any, t: float) -> None:
            if t == 0.2:
                master.override("a.f", 5.0)

        a = run(oscillator(), tmp_path / "whole", resolver=resolver(), manipulators=[push])
        with pytest.raises(RunError):
            run(oscillator(), tmp_path / "r", resolver=resolver(0.5), manipulators=[push])
        run(oscillator(), tmp_path / "r", resolver=resolver(), manipulators=[push], resume=True)
        same_content(tmp_path / "whole", tmp_path / "r")
        assert not np.array_equal(a["a.x"], run(oscillator(), resolver=resolver())["a.x"])

    @pytest.mark.parametrize("algorithm", ["jacobi", "iterated"])
    def test_other_algorithms(self, tmp_path, algorithm):
        made = oscillator(algorithm=algorithm)
        run(made, tmp_path / "whole", resolver=resolver())
        with pytest.raises(RunError):
            run(made, tmp_path / "r", resolver=resolver(0.5))
        run(made, tmp_path / "r", resolver=resolver(), resume=True)
        same_content(tmp_path / "whole", tmp_path / "r")

    @pytest.mark.parametrize("isolate", [False, True])
    def test_fmus_and_replays(self, tmp_path, isolate):
        if c_fmu.compiler() is None:
            pytest.skip("no C compiler here")
        file = c_fmu.build(tmp_path)
        run(oscillator(), tmp_path / "recorded", resolver=resolver())
        made = oscillator(Component("x", str(file), {"gain": 3.0}, isolate=isolate), Component("old", f"replay:{tmp_path / 'recorded'}#a"))
        made = replace(made, connections=(*made.connections, Connection("old.x", "x.u")))
        run(made, tmp_path / "whole", resolver=resolver())
        with pytest.raises(RunError):
            run(made, tmp_path / "r", resolver=resolver(0.5))
        result = run(made, tmp_path / "r", resolver=resolver(), resume=True)
        same_content(tmp_path / "whole", tmp_path / "r")
        assert np.ptp(result["x.y"]) > 0.0

    @pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
    def test_the_compiled_loop(self, tmp_path, algorithm):
        """Saved and continued in either loop: the checkpoints are the same, too."""
        if c_fmu.compiler() is None:
            pytest.skip("no C compiler here")
        file = str(c_fmu.build(tmp_path))
        components = tuple(Component(n, file, {"gain": g}, every=e) for n, g, e in (("a", 2.0, 1), ("b", 3.0, 1), ("c", 4.0, 7)))
        connections = (
            Connection("a.twice", "b.u"),
            Connection("b.twice", "c.u", delayed=True),
            Connection("c.n", "a.offset", delayed=True),
        )
        made = System("fmus", STEP, components, connections, algorithm, recording=Recording(checkpoint_every=3, every=2, chunk=7))
        run(replace(made, loop="python", recording=Recording(every=2)), tmp_path / "whole", stop=STOP)
        for first, second in (("compiled", "python"), ("python", "compiled"), ("compiled", "compiled")):
            folder = tmp_path / f"{first}-{second}"
            run(made, folder, stop=0.5, loop=first)
            assert read(folder).done == 48
            assert run(made, folder, stop=STOP, loop=second, resume=True).info["resumed"] == [0.48]
            assert read(folder).done == 99
            same_content(tmp_path / "whole", folder)


class TestWhatResumeFinds:
    """A finished run is not run again; nothing to go on from means from the beginning."""

    def test_finished(self, whole):
        before = {f.name: f.stat().st_mtime_ns for f in whole.iterdir()}
        result = run(oscillator(), whole, resolver=resolver(0.0), resume=True)  # would fail if it ran
        assert result.outcome == "finished"
        assert {f.name: f.stat().st_mtime_ns for f in whole.iterdir()} == before

    def test_finished_but_now_longer(self, whole, tmp_path):
        run(oscillator(), whole, resolver=resolver(), resume=True, stop=1.5)
        run(oscillator(), tmp_path / "r", resolver=resolver(), stop=1.5)
        same_content(whole, tmp_path / "r")

    def test_finished_by_an_output(self, tmp_path):
        made = oscillator(stop=None, stop_when="b.moving")
        t = run(made, tmp_path / "r", resolver=resolver()).t[-1]
        assert 0.0 < t < 1.0
        assert run(made, tmp_path / "r", resolver=resolver(0.0), resume=True).t[-1] == t

    def test_nothing(self, whole, tmp_path):
        run(oscillator(), tmp_path / "new", resolver=resolver(), resume=True)
        same_content(whole, tmp_path / "new")
        with pytest.raises(OrchestrationError, match="resume needs the folder of the run"):
            run(oscillator(), resolver=resolver(), resume=True)

    def test_a_new_run_removes_the_checkpoint(self, whole):
        run(oscillator(every=0), whole, resolver=resolver(), overwrite=True)
        assert not (whole / "checkpoint.zip").exists()


class TestRefused:
    """Whatever would give other numbers than an uninterrupted run."""

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"step": 0.02}, r"clock: step was 0.01, is 0.02"),
            ({"algorithm": "jacobi"}, r"algorithm was 'gauss-seidel', is 'jacobi'"),
            ({"connections": ()}, r"connections: without a.x -> b.f, b.x -> a.f \(delayed\)"),
            ({"components": (Component("a", "spring", {"k": 3.0}), Component("b", "spring"))}, r"parameters: a.k was 2.0, is 3.0"),
        ],
    )
    def test_another_system(self, whole, change, text):
        with pytest.raises(OrchestrationError, match=rf"holds a run of another system: {text}.*; run it anew without resuming"):
            run(oscillator(**change), whole, resolver=resolver(), resume=True)
        assert Run.load(whole).outcome == "finished"  # it is still there

    def test_another_fmu(self, tmp_path):
        if c_fmu.compiler() is None:
            pytest.skip("no C compiler here")
        made = oscillator(Component("x", str(c_fmu.build(tmp_path))))
        run(made, tmp_path / "r", resolver=resolver())
        c_fmu.build(tmp_path, c_fmu.SOURCE.replace("y += h", "y += 2 * h"))
        with pytest.raises(OrchestrationError, match=r"another system: files: x was '\w+', is '\w+'"):
            run(made, tmp_path / "r", resolver=resolver(), resume=True)

    def test_an_fmu_that_cannot_save(self, tmp_path):
        """At the beginning, not at the first checkpoint."""
        if c_fmu.compiler() is None:
            pytest.skip("no C compiler here")
        mute = c_fmu.build(tmp_path, description=c_fmu.DESCRIPTION.replace('canSerializeFMUstate="true"', ""))
        text = (
            r"component 'x' cannot save its state beyond this process, which checkpoint_every needs: .* must declare canSerializeFMUstate"
        )
        with pytest.raises(SlaveError, match=text):
            run(oscillator(Component("x", str(mute))), tmp_path / "r", resolver=resolver())
        (tmp_path / "d").mkdir()
        mute = c_fmu.build(tmp_path / "d", description=c_fmu.DESCRIPTION.replace('canGetAndSetFMUstate="true"', ""))
        with pytest.raises(
            SlaveError, match=r"'x' cannot save its state, which .*: euler.fmu cannot save its state \(canGetAndSetFMUstate"
        ):
            run(oscillator(Component("x", str(mute))), tmp_path / "r", resolver=resolver(), overwrite=True)

    def test_a_state_of_something_else(self, tmp_path):
        class Odd(Spring):
            def get_state(self) -> Any:
                return object()

        with pytest.raises(SlaveError, match=r"component 'a' cannot save its state beyond this process, .*: it holds a object"):
            run(oscillator(), tmp_path / "r", resolver=lambda source, name: Odd(name))

    @pytest.mark.parametrize("damage", ["cut", "no json", "schema", "blob"])
    def test_damaged(self, tmp_path, damage):
        with pytest.raises(RunError):
            run(oscillator(), tmp_path / "r", resolver=resolver(0.5))
        file = tmp_path / "r/checkpoint.zip"
        with zipfile.ZipFile(file) as z:
            files = {n: z.read(n) for n in z.namelist()}
        if damage == "cut":
            file.write_bytes(file.read_bytes()[:-30])
        else:
            changed = {"no json": b"{", "schema": b'{"schema": "x"}', "blob": b"x"}[damage]
            files |= {n: changed for n in files if n.endswith(".bin" if damage == "blob" else ".json")}
            with zipfile.ZipFile(file, "w") as z:
                for n, data in files.items():
                    z.writestr(n, data)
        with pytest.raises(ResultsError, match=r"checkpoint.zip: the checkpoint cannot be read: .*run it anew without resuming"):
            run(oscillator(), tmp_path / "r", resolver=resolver(), resume=True)

    def test_signals_that_are_gone(self, tmp_path):
        with pytest.raises(RunError):
            run(oscillator(), tmp_path / "r", resolver=resolver(0.5))
        (tmp_path / "r/signals.parquet").unlink()
        with pytest.raises(ResultsError, match=r"there is no signals.parquet or signals.arrow in it"):
            run(oscillator(), tmp_path / "r", resolver=resolver(), resume=True)


class TestFile:
    """What is written is what is read, in plain data."""

    def test_every_kind_of_value(self, tmp_path):
        state = (
            b"\0\xff",
            [1, -2.5, True, None, "\n"],
            {"a": np.arange(6, dtype=np.int32).reshape(2, 3), 3: float("nan")},
            np.float64(0.1),
        )
        write(tmp_path, Snapshot(5, 10, 2, np.array([0.1, -0.0]), {"x": np.array([1, 2])}, {"x": state}))
        got = read(tmp_path)
        assert (got.done, got.start_ticks, got.step_ticks, got.time) == (5, 10, 2, 2e-8)
        assert got.bus.tobytes() == np.array([0.1, -0.0]).tobytes()
        back = got.states["x"]
        assert back[:2] == state[:2]
        assert isinstance(back, tuple)
        assert back[2]["a"].dtype == np.int32
        assert np.array_equal(back[2]["a"], state[2]["a"])
        assert np.isnan(back[2][3])
        assert (back[3], type(back[3])) == (state[3], np.float64)

    def test_is_replaced_as_a_whole(self, tmp_path, monkeypatch):
        write(tmp_path, Snapshot(1, 0, 1, np.zeros(1), {}, {}))
        monkeypatch.setattr("os.fsync", lambda number: (_ for _ in ()).throw(OSError("disk full")))
        with pytest.raises(ResultsError, match=r"checkpoint.zip: the checkpoint at t = 2e-09 s cannot be written: disk full"):
            write(tmp_path, Snapshot(2, 0, 1, np.zeros(1), {}, {}))
        assert read(tmp_path).done == 1
        assert [f.name for f in tmp_path.iterdir()] == ["checkpoint.zip"]

    def test_holds_no_code(self, tmp_path):
        write(tmp_path, Snapshot(1, 0, 1, np.zeros(1), {}, {"x": (1, b"2")}))
        with zipfile.ZipFile(tmp_path / "checkpoint.zip") as z:
            assert json.loads(z.read("checkpoint.json"))["states"] == {"x": {"tuple": [1, {"bytes": 0}]}}
