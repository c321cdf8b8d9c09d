"""The benchmark compares what computes the same, and outlives what does not. Nothing is timed here."""

import importlib
import pickle
import shutil

import pytest

from benchmarks import simulations
from benchmarks.contenders import C_LOOP, Contender, Ring
from benchmarks.measure import Duel, Start, duel
from benchmarks.network import calls
from benchmarks.report import Measured, write
from benchmarks.runners import MasterError, Worker
from robomill.cell.equipment import load_system
from robomill.files import FILES
from tests.tolerances import EXACT

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the benchmarks compile C on the spot")
STEPS = 20


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    made = Ring(tmp_path_factory.mktemp("bench") / "ring", count=3, signals=2)
    yield made
    made.close()


@pytest.fixture(scope="module")
def fought(ring):
    """The C loop, our loop in Python, FMPy, one that is not installed, and one that fails in its process."""
    chosen = [next(c for c in ring.masters() if c.name == C_LOOP)]
    chosen.append(Contender("ours", ring.worker("python", ring.system, "system"), ("none", "memory", "disk")))
    chosen += [Contender(kind, ring.worker(kind, ring.network, "network"), ("none", "memory")) for kind in ("fmpy", "fmpy-buffers")]
    chosen.append(Contender("absent", lambda environment: importlib.import_module("absent_library"), ("none",)))
    chosen.append(Contender("unable", ring.worker("unable", ring.network, "network"), ("none",)))
    return duel(chosen, rounds=1, slice_=0.0, outputs=6, steps=STEPS, say=lambda text: None)


def test_all_masters_compute_the_same(fought):
    assert [(r.name, r.results) for r in fought.rows if r.difference > EXACT] == []
    assert len(fought.rows) == 2 + 3 + 2 + 2


def test_results_are_read_back_from_where_they_were_written(fought):
    assert {(r.name, r.results): r.recorded for r in fought.rows if r.recorded is not None} == {
        ("ours", "memory"): EXACT, ("ours", "disk"): EXACT, ("fmpy", "memory"): EXACT, ("fmpy-buffers", "memory"): EXACT,
    }  # fmt: skip


def test_who_cannot_be_started_is_reported(fought):
    assert fought.missing == {"absent": "not installed (No module named 'absent_library')", "unable": "KeyError: 'unable'"}


def test_a_master_that_dies_is_reported(tmp_path):
    file = tmp_path / "poison.pickle"
    file.write_bytes(pickle.dumps(Poison()))
    worker = Worker("python", file)
    try:
        with pytest.raises(MasterError, match="its process ended with status 3"):
            worker.run(STEPS, "none")
    finally:
        worker.close()


class Poison:
    """Ends the process that unpickles it."""

    def __reduce__(self):
        import os

        return os._exit, (3,)


def test_a_step_of_the_ring_is_three_calls_per_fmu(ring):
    assert calls(ring.network) == 9


def test_the_page_names_who_is_missing(fought, tmp_path):
    nobody = Duel([], {"Ecos (ecospy)": "not installed"}, STEPS)
    write(Measured(fought, 9, nobody, nobody, 19, STEPS, [], [], [], [Start("ours")], 1, 0.0, 60.0, (0.0, 0.0)), tmp_path)
    page = (tmp_path / "masters.md").read_text()
    assert "left out: KeyError: 'unable'" in page
    assert "left out: not installed" in page
    assert "9 of 9 rows have the bits of the C loop" in page
    assert (tmp_path / "masters.png").read_bytes()[:4] == (tmp_path / "scaling.png").read_bytes()[:4] == b"\x89PNG"


def test_simulations_of_a_system_that_stays_open_are_compared_with_those_of_one_that_is_opened_anew():
    costs = simulations.measure(load_system(FILES / "scenarios" / "milling_cell.toml"), 0.04, 2)
    assert (costs.steps, len(costs.anew), len(costs.open)) == (10, 2, 2)
    text = simulations.page(costs, (0.5, 0.5))
    assert "(10 steps of 4 ms)" in text
    assert text.count("\n| ") == 3
