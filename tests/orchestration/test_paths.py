"""FMUs, packages, systems and runs in folders with any name, short or long."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.ssp.export import export
from robomill.orchestration.ssp.importing import open_ssp
from robomill.orchestration.system.definition import System
from tests.orchestration import c_fmu
from tests.tolerances import ROUNDOFF

NAMES = {
    "letters": "Fräsen größer 100 % - фреза 铣削 \U0001f916",
    "signs": "a b;c&d'e(f)#g{h}+~$HOME=[1]",
    "long": "/".join(["long" * 30] * 8),
    "short": "x",
}


@pytest.fixture(scope="module")
def euler(tmp_path_factory) -> bytes:
    if c_fmu.compiler() is None:
        pytest.skip("no C compiler here")
    return c_fmu.build(tmp_path_factory.mktemp("c")).read_bytes()


@pytest.mark.parametrize("kind", NAMES)
@pytest.mark.parametrize("isolate", [False, True])
def test_everything_works_there(euler, tmp_path, monkeypatch, kind, isolate):
    """Loading, running, recording, checkpoints, packing and unpacking, temporary files included; the long path has some 1000 characters."""
    folder = tmp_path / NAMES[kind]
    folder.mkdir(parents=True)
    (folder / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder / "temporary"))
    (folder / "eulér ü.fmu").write_bytes(euler)
    (folder / "täble.npy").write_bytes(b"x")
    (folder / "system ß.toml").write_text(
        'name = "ß"\nstep = "0.1 s"\nstop = "1.0 s"\n[components.x]\nsource = "eulér ü.fmu"\nparameters.label = {file = "täble.npy"}\n'
        f"isolate = {str(isolate).lower()}\n[recording]\ncheckpoint_every = 4\n",
        encoding="utf-8",
    )
    system = System.load(folder / "system ß.toml")
    result = run(system, folder / "rün", resolver=None)
    assert np.allclose(result["x.y"], 0.5 * result.t, rtol=ROUNDOFF, atol=0.0)  # the start value of u, integrated
    assert Run.load(folder / "rün").outcome == "finished"
    with open_ssp(export(system, folder / "pack äge.ssp")) as package:
        assert np.array_equal(run(package.system)["x.y"], result["x.y"])
    assert list((folder / "temporary").iterdir()) == []
    assert len(str(folder / "rün")) > 900 or kind != "long"


def test_relative_to_the_working_directory(euler, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("x.fmu").write_bytes(euler)
    Path("s.toml").write_text('name = "s"\nstep = "0.1 s"\nstop = "1.0 s"\n[components.x]\nsource = "x.fmu"\nisolate = true\n')
    assert len(run(System.load("s.toml"), "r")) == 11
    assert Path("r/signals.parquet").is_file()
