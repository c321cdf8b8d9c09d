"""Damaged FMUs, packages and system files: every one is refused with one clear error, or does no harm.

Nothing crashes the process, hangs, or writes outside its folder.
"""

from __future__ import annotations

import concurrent.futures
import hashlib
import multiprocessing
import re
from collections import Counter
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from robomill.orchestration.ssp.export import export
from robomill.orchestration.system.definition import Component, Connection, System
from tests.orchestration import c_fmu, c_fmu3
from tests.orchestration.damage import KINDS, session
from tests.orchestration.ssp.test_ssp_foreign import MAPPING, NESTED, VALUES, package

LIMIT = 30.0  # s for one case
SYSTEM = """\
name = "ring"
step = "0.1 s"
stop = "1.0 s"
algorithm = "gauss-seidel"
check_ranges = true

[labels]
robot = "R"

[components.a]
source = "euler.fmu"
parameters = {gain = 2.0, label = "text"}

[components.b]
source = "euler.fmu"
inputs = {u = 1.0}

[components.b.parameters]
gain = {value = 3.0, unit = "1"}

[[connections]]
from = "a.twice"
to = "b.u"

[[connections]]
from = "b.on"
to = "a.invert"
delayed = true

[recording]
columns = ["a", "b.y"]
every = 1
chunk = 10
checkpoint_every = 3
"""


@pytest.fixture(scope="module")
def originals(tmp_path_factory) -> Path:
    if c_fmu.compiler() is None:
        pytest.skip("no C compiler here")
    folder = tmp_path_factory.mktemp("originals")
    euler = c_fmu.build(folder)
    (folder / "ring.toml").write_text(SYSTEM)
    components = (Component("a", str(euler), {"gain": 2.0}, inputs={"u": 0.5}), Component("b", str(euler), {"gain": 3.0}))
    connections = (Connection("a.twice", "b.u"), Connection("b.n", "a.offset", delayed=True))
    export(System("ring", 0.1, components, connections, stop=1.0), folder / "ring.ssp")
    c_fmu3.build(folder, c_fmu3.PLAIN)
    resources = {"resources/cell.ssv": VALUES, "resources/cell.ssm": MAPPING, "resources/euler.fmu": euler.read_bytes()}
    package(folder, {"SystemStructure.ssd": NESTED, **resources})
    return folder


def content(folder: Path) -> dict[str, str]:
    """Everything in a folder."""
    files = (f for f in folder.rglob("*") if f.is_file())
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def check(cases: list[tuple[str, int]], originals: Path, folder: Path) -> Counter[str]:
    """Run the cases one after the other in a process that is to survive them all; returns how they ended."""
    found: Counter[str] = Counter()
    before = content(originals)
    with concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        for kind, number in cases:
            place = folder / f"{kind}{number}"
            place.mkdir()
            try:
                name, text = pool.submit(session, kind, number, str(originals), str(place)).result(LIMIT)
            except BrokenProcessPool:
                pytest.fail(f"{kind} {number} crashed the process")
            except concurrent.futures.TimeoutError:
                for process in pool._processes.values():
                    process.kill()
                pytest.fail(f"{kind} {number} hangs")
            assert name, f"{kind} {number}: no OrchestrationError but\n{text}"
            assert "Traceback" not in text, f"{kind} {number}: not worded for users:\n{text}"
            assert name == "ran" or re.search(r"\w+.* \w+", text), f"{kind} {number}: {text!r}"
            assert len(text) < 5000, f"{kind} {number}: {len(text)} characters"
            assert sorted(p.name for p in place.iterdir()) == ["temporary", "work"], f"{kind} {number} wrote beside its folder"
            assert not list((place / "temporary").iterdir()), f"{kind} {number} left temporary files"
            found["ran" if name == "ran" else "refused"] += 1
    assert content(originals) == before
    assert not Path("/tmp/evil").exists()
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_some(kind, originals, tmp_path):
    """Twenty of each kind."""
    found = check([(kind, n) for n in range(20)], originals, tmp_path)
    assert found["refused"] >= 10


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many(kind, originals, tmp_path):
    """120 of each of the five kinds, 600 together."""
    found = check([(kind, n) for n in range(20, 140)], originals, tmp_path)
    assert found["refused"] >= 60


def test_undamaged(originals, tmp_path, monkeypatch):
    """The originals run: what is refused is refused because of the damage."""
    import tests.orchestration.damage as module

    monkeypatch.setattr(
        module,
        "damaged",
        lambda kind, number, source, folder: (originals / KINDS[kind], False),
    )
    monkeypatch.chdir(tmp_path)
    for kind in KINDS:
        (tmp_path / kind).mkdir()
        module.attempt(kind, 0, originals, tmp_path / kind)
