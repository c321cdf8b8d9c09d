"""What is left of the last step when an importer has added up its steps: no step, in every face of a model."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from robomill.fmus.in_process import InProcessSlave
from robomill.fmus.interface import Interface
from robomill.orchestration.slaves.fmu import FmuSlave
from tests.fmus import native_runs as runs
from tests.fmus.demo import MODEL

COUNT = [p.name for p in Interface(MODEL).outputs].index("count")
FACES = ("in process", "Python FMU", *(("native FMI 2", "native FMI 3") if runs.ON_LINUX else ()))


@pytest.fixture(params=FACES)
def slave(request: pytest.FixtureRequest, built: Callable[[str], Path], built_native: Callable[..., Path]) -> Iterator[runs.Slave]:
    face = str(request.param)
    made: runs.Slave = (
        InProcessSlave(MODEL, plain=True)
        if face == "in process"
        else FmuSlave(built_native("demo", int(face[-1])) if "native" in face else built("demo"))
    )
    yield made
    made.close()


def steps(slave: runs.Slave) -> float:
    out = np.zeros(len(Interface(MODEL).outputs))
    slave.get_outputs(out)
    return float(out[COUNT])


def begin(slave: runs.Slave) -> None:
    slave.initialise(0.0, 10.0, runs.H)
    slave.set_inputs(np.array([0.1, -0.1, 1.0, 0.0, 3.0]))


def test_an_importer_that_adds_up_its_steps(slave: runs.Slave) -> None:
    """As OMSimulator does: 1837 steps of 4 ms end 3.66e-13 s before 7.348 s."""
    begin(slave)
    t, lengths = 0.0, []
    while t < 7.348:
        after = min(t + runs.H, 7.348)
        slave.step(t, after - t)
        lengths.append(after - t)
        t = after
    assert len(lengths) == 1838
    assert 3e-13 < lengths[-1] < 4e-13
    assert steps(slave) == 1837


def test_a_short_step_is_one(slave: runs.Slave) -> None:
    """Half a unit in the last place for each of 1000 additions: 4.44e-13 s at 4 s; at 0 s and after two weeks, too."""
    begin(slave)
    for done, (t, h) in enumerate([(0.0, 5e-324), (4.0, 4.5e-13), (1e6, 0.003)], 1):
        slave.step(t, h)
        assert steps(slave) == done
    for t, h in ((4.0, 4.4e-13), (1e6, 0.0019)):
        slave.step(t, h)
        assert steps(slave) == 3
