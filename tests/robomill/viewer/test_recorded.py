"""What is read of a run: which component is the tool, the plan, the force; and what is missing is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.orchestration.errors import ResultsError
from robomill.orchestration.runs.importing import write_run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData
from robomill.viewer.chain import TIP, from_dh
from robomill.viewer.recorded import SIDE_BY_SIDE, SOLVED, Recorded, recordings
from tests.tolerances import ROUNDOFF

BENDING = 0.01
"""rad: bending of 2 mm is taken up by turns of an axis 0.5 m away at most, four times as much where others turn against it."""
LENGTH = 0.01
"""m: what the planned tool moves in the made-up run."""


def made(folder: Path, **columns: np.ndarray) -> None:
    """A run folder with these columns, __ in place of the point."""
    named = {name.replace("__", "."): values for name, values in columns.items()}
    every = {
        f"{n}[{i + 1}]" if v.ndim > 1 else n: v[:, i] if v.ndim > 1 else v
        for n, v in named.items()
        for i in range(np.atleast_2d(v.T).shape[0])
    }
    ports = {n: PortData(n.partition(".")[2], "output", "real", "m") for n in every}
    t = 0.1 * np.arange(len(next(iter(every.values()))))
    write_run(folder, t, every, ports, {"sources": {"path": "path_interpolator"}})


def moving(n: int = 11) -> dict[str, np.ndarray]:
    share = np.linspace(0.0, 1.0, n)
    line = np.outer(share, [LENGTH, 0.0, 0.0])
    return {"path__p_BT_B": line, "arm__p_BT_B": line + np.array([-1e-3, 2e-3, 0.0]), "arm__quat_BT": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))}


def test_components_are_known_by_what_they_have(results: Path) -> None:
    found, notes = recordings(results, None)
    assert [r.name for r in found] == ["uncompensated", "cartesian"]  # as in summary.json; the offline run is none
    r = found[0]
    assert (r.tool, r.planned, r.force, r.angles, notes) == ("compliance", "path", "milling", "drive.q_motor", [])
    workpiece = r.workpiece()
    assert workpiece is not None
    assert workpiece.size == pytest.approx((0.02, 0.04, 0.01), rel=ROUNDOFF)
    assert workpiece.abc[0] == pytest.approx(np.pi, rel=ROUNDOFF)
    assert r.kept[-1] == len(r.run) - 1


def test_a_deviation_is_across_the_feed(tmp_path: Path) -> None:
    made(tmp_path / "run", **moving())
    (r,), _ = recordings(tmp_path / "run", None)
    assert r.across == pytest.approx(np.tile([0.0, 2e-3, 0.0], (11, 1)), rel=ROUNDOFF, abs=ROUNDOFF)  # late by 1 mm: left out
    assert (r.force, r.angles, r.robot(), r.workpiece()) == (None, None, None, None)


def test_a_run_of_one_sample_has_a_deviation_in_all_directions(tmp_path: Path) -> None:
    made(tmp_path / "run", **moving(1))
    (r,), _ = recordings(tmp_path / "run", None)
    assert r.across == pytest.approx(np.array([[-1e-3, 2e-3, 0.0]]), rel=ROUNDOFF)


def test_quaternions_do_not_jump(tmp_path: Path) -> None:
    columns = moving()
    columns["arm__quat_BT"][5:] *= -1.0
    made(tmp_path / "run", **columns)
    (r,), _ = recordings(tmp_path / "run", None)
    assert np.all(r.quat[:, 0] == 1.0)


def test_what_is_lost_between_the_samples_is_known(results: Path) -> None:
    r = recordings(results, ["cartesian"])[0][0]
    assert r.lost == 0.0  # a short run is kept as it is
    few = replace(r, kept=np.array([0, len(r.run) - 1]))
    p = r.run["compliance.p_BT_B"]
    straight = p[0] + (r.run.t - r.run.t[0])[:, None] / np.ptp(r.run.t) * (p[-1] - p[0])
    assert few.lost == pytest.approx(np.linalg.norm(p - straight, axis=1).max(), rel=1000 * ROUNDOFF)


def test_angles_that_are_not_recorded_are_solved(results: Path) -> None:
    r = recordings(results, ["uncompensated"])[0][0]
    few = replace(r, kept=r.kept[::20])
    s = few.robot()
    assert s is not None
    q = few.solved(s)
    assert q is not None
    assert from_dh(s, q[0], 8e-3).poses(q)[:, TIP, :3, 3] == pytest.approx(few.p, rel=ROUNDOFF, abs=SOLVED)
    assert np.abs(q - few.q).max() < BENDING
    silent = replace(few, run=replace(r.run, info={k: v for k, v in r.run.info.items() if k != "inputs"}))
    assert silent.solved(s) is None
    away = replace(few, run=replace(r.run, columns={**r.run.columns, "compliance.p_BT_B[1]": 9.0 + r.run["compliance.p_BT_B"][:, 0]}))
    assert away.solved(s) is None  # out of reach


def test_of_many_runs_the_first_are_shown(tmp_path: Path) -> None:
    for k in range(SIDE_BY_SIDE + 2):
        made(tmp_path / f"run-{k}", **moving())
    found, notes = recordings(tmp_path, None)
    assert len(found) == SIDE_BY_SIDE
    assert notes == [f"6 runs are in {tmp_path}; shown are run-0, run-1, run-2, run-3; choose others with --variant"]
    assert [r.name for r in recordings(tmp_path, ["run-5"])[0]] == ["run-5"]


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    def refused(text: str, names: list[str] | None = None, folder: Path = tmp_path) -> None:
        with pytest.raises(ResultsError, match=text):
            recordings(folder, names)

    refused("no folder .*nowhere; expected one that `robomill run` wrote", folder=tmp_path / "nowhere")
    refused("neither in it nor in its folders is a run.toml; expected a folder that `robomill run` wrote")
    made(tmp_path / "a", robot__speed=np.zeros(5))
    refused(r"no component has a tool pose: expected columns NAME.p_BT_B\[1..3\] .m. and .*there are columns of robot; record these ports")
    made(tmp_path / "b", **moving())
    refused("unknown run 'c'; available: a, b", ["c"])
    run = Run.load(tmp_path / "b")
    stock = {"parameters": {"milling": {"stock": "/gone/stock.npy", **_block()}}}
    with pytest.raises(ResultsError, match=r"the table /gone/stock.npy is gone, and plan/stock.npy beside the run as well; run again"):
        Recorded("b", replace(run, info=stock), "arm", None, None, None, np.arange(2)).workpiece()


def _block() -> dict[str, float]:
    return {f"{k}[{i + 1}]": 1.0 for k, n in (("p_BP_B", 3), ("quat_BP", 4), ("block_size", 3)) for i in range(n)}
