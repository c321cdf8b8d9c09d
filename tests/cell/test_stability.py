"""robomill.cell.stability: lobes at the poses of a program, margins of its lines, and the time domain beside them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from robomill.cell import milling, stability
from robomill.cell.equipment import load_system, machine_of
from robomill.cell.scenario import ScenarioError, load_scenario
from robomill.cli import main
from robomill.diagnosis.catalogue import Catalogue
from robomill.models.components.regenerative_milling import MAX_MODES, MODEL
from robomill.models.model.declaration import record
from robomill.models.process.stability.modes import Modes, load_modes, receptance
from robomill.models.process.stability.semi_discretisation import depth_limit, enough_intervals, periodic_matrices
from robomill.models.robot.elastic_modes import elastic_modes, frequency_response
from tests.tolerances import ROUNDOFF, physics

SCENARIOS = Path(__file__).parents[2] / "scenarios"
SLOT = SCENARIOS / "robots" / "kr210_2.toml"
RPM = math.pi / 30.0
MM = 1e-3


@pytest.fixture(scope="module")
def cell() -> stability.Cell:
    return stability.prepare(load_scenario(SLOT))


def test_the_cut_of_the_slot_and_the_modes_of_its_pose(cell: stability.Cell) -> None:
    first = cell.cuts[0]
    assert first.axial == pytest.approx(4 * MM, rel=1e4 * ROUNDOFF)
    q = stability.angles_at(cell, first)
    assert cell.machine is not None
    tip = elastic_modes(cell.machine, q)
    f = np.array([5.0, 11.0, 40.0, 300.0])
    ours = receptance(stability.modes_at(cell, first, q, robot_alone=True), f)
    R = stability.frame_of(cell, first)
    theirs = np.einsum("ai,fij,bj->fab", R, frequency_response(tip, f)[:, :3, :3], R)
    assert np.abs(ours - theirs).max() <= 1e4 * ROUNDOFF * np.abs(theirs).max()
    # with spindle and tool in series receptances add up
    both = receptance(stability.modes_at(cell, first, q), f)
    spindle = load_modes("spindle_d16").compliance
    assert np.trace((both - ours)[0].real) == pytest.approx(np.trace(spindle), rel=physics(1.0, relative=1e-3))


def test_verdict_of_each_line_with_and_without_the_spindle(cell: stability.Cell) -> None:
    lines = stability.judge(cell)
    assert [x.stable for x in lines] == [False, False]
    for x in lines:
        assert (x.margin < 1.0) == (x.growth is not None and x.growth > 1.0)
        assert 1000.0 < x.chatter < 1200.0  # the spindle
    robot = stability.judge(stability.prepare(load_scenario(SLOT), modes="none"))
    assert [x.stable for x in robot] == [True, True]
    assert all(x.margin > 2.0 and x.chatter < 150.0 for x in robot)
    spindle = stability.judge(stability.prepare(load_scenario(SLOT), rigid=True))
    # at 13 000 rpm the modes of the robot do not matter: the literature of FACTS 4.2 says the same
    assert [x.margin for x in spindle] == pytest.approx([x.margin for x in lines], rel=physics(1.0, relative=0.01))


def test_robot_modes_limit_at_low_speed_and_differ_over_the_work_space(cell: stability.Cell) -> None:
    cut = cell.cuts[0]
    q = stability.angles_at(cell, cut)
    slow, fast = stability.lobes_at(cell, cut, q, np.array([3000.0, 13000.0]) * RPM, robot_alone=True).depth
    assert slow < 1 * MM
    assert fast > 8 * MM
    line = stability.judge(cell)[0]
    x, y = np.array([0.1, 1.0, 1.28, 1.6]), np.array([0.0, 0.3])
    margin = stability.map_of(cell, line, x, y)
    assert np.isnan(margin[0, 0])
    assert np.ptp(margin[:, 1:]) > 0.1
    with pytest.raises(ScenarioError, match="this one is rigid"):
        stability.map_of(stability.prepare(load_scenario(SLOT), rigid=True), line, x, y)


def _parts(modes: Modes, rpm: float, depth: float, pushed: bool) -> np.ndarray:
    """Deflection of robot modes (in the axes of P) in a slot along x of P, once per whole number of tooth periods, 2.5 s."""
    n = len(modes.frequency)
    length = np.linalg.norm(modes.shape, axis=0)
    to_T = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])

    def padded(values: np.ndarray) -> list[float]:
        return [*values.tolist(), *[0.0] * (MAX_MODES - n)]

    data = MODEL.new()
    data["mode_frequency"], data["mode_damping"] = padded(modes.frequency), padded(modes.damping)
    data["mode_stiffness"] = padded((modes.circular / length) ** 2)
    data["mode_direction"] = [*(to_T @ (modes.shape / length)).T.tolist(), *[[0.0] * 3] * (MAX_MODES - n)]
    data["helix"], data["spindle_speed"], data["v_BT_B"] = 0.2, rpm * RPM, [0.01, 0, 0]
    start = data["p_BP_B"][0] + np.array([-0.03, 0.0, -depth])
    data["p_BT_B"] = start
    init, step = MODEL.compiled()
    s = record(data)
    assert init(s) == 0
    period = 20.0 / rpm
    h = max(round(0.004 / period), 1) * period
    if pushed:
        s.y[:n] += 1e-9
    seen = []
    for k in range(int(2.5 / h)):
        data["p_BT_B"] = start + np.array([0.01 * h * (k + 1), 0.0, 0.0])
        assert step(s, k * h, h) == 0
        seen.append(s.y[:n].copy())
    return np.array(seen)


@pytest.mark.parametrize("rpm", [3000.0, 5200.0])
def test_time_domain_agrees_with_the_lobes_of_the_robot_in_its_pose(cell: stability.Cell, rpm: float) -> None:
    """KR 210-2, slot: its eight main modes inside the component, 10 % either side of the limit; a push of 1 nm dies out or not."""
    cut = cell.cuts[0]
    robot = stability._main(stability.modes_at(cell, cut, stability.angles_at(cell, cut), robot_alone=True))
    assert len(robot.frequency) <= MAX_MODES
    period = 20.0 / rpm
    matrices = periodic_matrices(cell.coefficients, 3, stability.engagement_of(cut), enough_intervals(robot, period))
    limit = depth_limit(robot, matrices, period, 4 * MM)
    for share, grows in ((0.9, False), (1.1, True)):
        calm, pushed = (_parts(robot, rpm, share * limit, p) for p in (False, True))
        apart = np.linalg.norm(pushed - calm, axis=1) / 1e-9
        assert (apart[-100:].max() > 1.0) == grows


def test_which_systems_have_an_elastic_robot() -> None:
    assert machine_of(load_system(SCENARIOS / "milling_cell.toml")) is not None
    scenario = load_scenario(SCENARIOS / "robots" / "fanuc_r2000ic.toml")
    assert machine_of(load_system(scenario.system, scenario.equipment)) is None


def test_what_cannot_be_judged_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"neither tool nor robot can vibrate; name modes \(--modes spindle_d16\)"):
        stability.prepare(load_scenario(SLOT), modes="none", rigid=True)
    with pytest.raises(ScenarioError, match="has no program whose stability could be judged"):
        stability.prepare(load_scenario(SCENARIOS / "static_loads.toml"))
    with pytest.raises(FileNotFoundError, match=r"no parameter file .*modes/nobody\.toml"):
        stability.prepare(load_scenario(SLOT), modes="nobody")


def test_modes_of_the_milling_component_are_used(tmp_path: Path) -> None:
    text = (
        SLOT.read_text(encoding="utf-8")
        .replace("../", f"{SCENARIOS.as_posix()}/")
        .replace("slot.ngc", f"{SLOT.parent.as_posix()}/slot.ngc")
    )
    system = (SCENARIOS / "milling_cell.toml").read_text(encoding="utf-8").replace('"milling_force"', '"regenerative_milling"')
    (tmp_path / "cell.toml").write_text(system, encoding="utf-8")
    own = text.replace(f"{SCENARIOS.as_posix()}/milling_cell.toml", "cell.toml")
    (tmp_path / "slot.toml").write_text(f"{own}\n[parameters.milling]\nmode_stiffness = {['200 N/um'] * MAX_MODES}\n", encoding="utf-8")
    found = stability.prepare(load_scenario(tmp_path / "slot.toml"))
    assert found.notes == ("modes of spindle and tool: those of 'milling'",)
    assert found.spindle is not None
    assert np.diag(found.spindle.compliance) == pytest.approx([0.0, 5e-9, 5e-9], rel=1e3 * ROUNDOFF)


def test_a_variant_mills_the_same_block_with_a_tool_that_vibrates(tmp_path: Path) -> None:
    """One line, `sources.milling`: place and size of the block are those of the job."""
    text = (
        SLOT.read_text(encoding="utf-8")
        .replace("../", f"{SCENARIOS.as_posix()}/")
        .replace("slot.ngc", f"{SLOT.parent.as_posix()}/slot.ngc")
    )
    text += (
        '\n[variants.vibrating]\ntitle = "tool that vibrates"\nsources.milling = "regenerative_milling"\nparameters.controller.mode = 0\n'
    )
    (tmp_path / "slot.toml").write_text(text, encoding="utf-8")
    job = milling.lay_out(load_scenario(tmp_path / "slot.toml"), tmp_path / "out")
    exchanged = milling.of_variant(job, job.scenario.variants[-1]).component("milling")
    assert exchanged.source == "regenerative_milling"
    for name in ("p_BP_B", "quat_BP", "block_size"):
        assert exchanged.parameters[name] == job.system.component("milling").parameters[name]


def test_the_effect_of_the_catalogue_is_one_of_the_component() -> None:
    catalogue = Catalogue.load(SCENARIOS / "regenerative_catalogue.toml")
    (candidate,) = catalogue.candidates
    variable = MODEL.variable(candidate.named[0])
    assert variable.effect
    assert variable.maximum is not None
    assert candidate.maximum <= variable.maximum


def test_command_writes_figures_and_pictures_and_says_what_is_unstable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", str(SLOT), "--json", "--out", str(tmp_path)]) == 1
    shown = json.loads(capsys.readouterr().out)
    assert shown == json.loads((tmp_path / "stability.json").read_text(encoding="utf-8"))
    assert shown["stable"] is False
    assert shown["lines"][0]["limit_mm"] == pytest.approx(shown["lines"][0]["depth_mm"] * shown["lines"][0]["margin"], rel=10 * ROUNDOFF)
    assert (tmp_path / "stability_lobes.png").stat().st_size > 10_000
    assert main(["stability", str(SLOT), "--modes", "none", "--no-pictures", "--out", str(tmp_path / "robot")]) == 0
    said = capsys.readouterr().out
    assert "stable" in said
    assert "stability.json" in said
    assert not list((tmp_path / "robot").glob("*.png"))


def test_command_refuses_speeds_the_wrong_way_round(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", str(SLOT), "--speeds", "9000", "3000", "--out", str(tmp_path)]) == 2
    assert "expected two speeds in rev/min, the lower one first" in capsys.readouterr().err
