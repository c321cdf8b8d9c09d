"""A run as a few numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robomill.cell.scenario import Workpiece
from robomill.cell.summaries import MILLING, STATISTICS, columns, summary, tool_deviation
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData

T = np.array([0.0, 0.1, 0.2, 0.3])
BLOCK = Workpiece((1.0, 0.0, 1.0), (0.1, 0.06, 0.03))


def a_run(**changed: np.ndarray) -> Run:
    """Four samples: the tool is off by 1, 2, 2, 9 mm; the cutter is in the material at the two in the middle."""
    off = 1e-3 * np.array([1.0, 2.0, 2.0, 9.0])
    signals = {
        "path.p_BT_B": np.zeros((4, 3)),
        "compliance.p_BT_B": np.stack([off, 0.0 * off, 0.0 * off], axis=1),
        "milling.depth": np.array([0.0, 1.0, 0.0, 0.0]),
        "milling.removal_rate": np.array([0.0, 0.0, 1.0, 0.0]),
        "sensor.f_T_T": np.array([[3.0, 4.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 2.0]]),
        "one.y": np.array([-3.0, 1.0, 2.0, 2.0]),
        **changed,
    }
    flat = {}
    for name, values in signals.items():
        flat |= {name: values} if values.ndim == 1 else {f"{name}[{i + 1}]": values[:, i] for i in range(values.shape[1])}
    return Run(Path(), T, flat, {n: PortData(n.partition(".")[2], "output", "real") for n in flat}, {})


@pytest.mark.parametrize(
    ("asked", "value"),
    [
        ("max(one.y)", 2.0),
        ("min(one.y)", -3.0),
        ("mean(one.y)", 0.5),
        ("rms(one.y)", np.sqrt(4.5)),
        ("std(one.y)", np.sqrt(4.25)),
        ("peak(one.y)", 3.0),
        ("first(one.y)", -3.0),
        (" last( one.y ) ", 2.0),
        ("peak(sensor.f_T_T)", 5.0),
        ("peak(sensor.f_T_T[3])", 2.0),
        ("mean(sensor.f_T_T)", 2.0),
    ],
)
def test_statistics_of_signals_and_of_the_magnitude_of_vectors(asked: str, value: float) -> None:
    made = summary(asked)
    assert made.function(a_run()) == value
    assert made.name == asked.strip()
    assert set(STATISTICS) >= {asked.strip().partition("(")[0]}


def test_figures_of_milling_look_at_the_tool_where_it_cuts() -> None:
    run = a_run()
    assert tool_deviation(run).tolist() == [2e-3, 2e-3]
    made = {name: summary(name, workpiece=BLOCK).function(run) for name in MILLING}
    assert made == {"max_tool_deviation_m": 2e-3, "rms_tool_deviation_m": 2e-3, "peak_force_n": 5.0}
    assert {"milling.depth", "sensor.f_T_T"} <= (columns([summary(n, workpiece=BLOCK) for n in MILLING]) or set())


def test_what_cuts_nothing_has_no_deviation() -> None:
    nothing = a_run(**{"milling.depth": np.zeros(4), "milling.removal_rate": np.zeros(4)})
    with pytest.raises(ValueError, match="nothing is cut: the tool never met the block"):
        summary("max_tool_deviation_m", workpiece=BLOCK).function(nothing)


def test_a_function_is_a_summary_that_may_need_anything() -> None:
    made = summary(len, "rows")
    assert (made.name, made.function(a_run())) == ("rows", 4)
    assert summary(len).name == "len"
    assert columns([made, summary("max(one.y)")]) is None
    assert columns([summary("max(one.y)")]) == {"one.y"}


@pytest.mark.parametrize(
    ("asked", "workpiece", "text"),
    [
        ("peek(one.y)", None, r"summary 'peek\(one.y\)': unknown statistic 'peek'; did you mean 'peak'\?"),
        ("max(y)", None, r"unknown summary 'max\(y\)'; or a statistic of a signal, such as 'peak\(sensor.f_T_T\)', with max, min"),
        ("peak_force_n", None, "unknown summary 'peak_force_n'"),
        ("peak_force", BLOCK, "unknown summary 'peak_force'; did you mean 'peak_force_n'"),
        (3.0, None, r"summary 3.0: expected a text such as"),
    ],
)
def test_what_is_no_summary_is_refused(asked: object, workpiece: Workpiece | None, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        summary(asked, workpiece=workpiece)  # type: ignore[arg-type]
