"""Laws that no catalogue has, in recordings of real machines: forms of them, and what is said of the answers without the right name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from benchmarks.recordings import taken_out
from benchmarks.recordings.cases import Case, cases, prepare
from benchmarks.recordings.taken_out import COUPLING, TakenOut
from robomill.cell.binding import convert, resolve
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.component_replay import ComponentReplay
from robomill.diagnosis.experiment.preparation import prepared
from robomill.diagnosis.forms.discovery import like_delays, port_forms
from robomill.diagnosis.forms.layout import Form, PortForm
from robomill.diagnosis.forms.ports import direct
from robomill.diagnosis.forms.solving import Solved, solve
from robomill.diagnosis.outcome.closure import HowFar
from robomill.orchestration.runs.run import Run
from tests.tolerances import ROUNDOFF

LATE = 3.05
"""ms by which the encoders behind the gears are late (first edition and least squares: 3.04 and 3.05 ms)."""
NEAR = 0.15
"""ms: half of what the three joints differ by when each is fitted alone, and the digits of the text."""


@pytest.fixture(scope="module")
def kuka() -> Case:
    return next(c for c in cases() if c.name == COUPLING.recording)


@pytest.fixture(scope="module")
def given(kuka: Case, tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    folder = tmp_path_factory.mktemp("kuka")
    prepare(folder / "prepared")
    return kuka.runs(folder, folder / "prepared")[0]


def found(case: Case, runs: Sequence[Run], ports: Sequence[str]) -> list[Solved]:
    """The forms of these ports of the robot: no catalogue takes part."""
    laboratory = prepared(Campaign.of(case.system(), runs, []), case.catalogue(), resolve, convert).laboratory
    condition = laboratory.conditions[0]
    replay = ComponentReplay(laboratory, 0, [condition.matrix(r, laboratory.channels) for r in condition.runs])
    problems = {p.terms[0][0]: p for p in direct(laboratory, [replay], "robot")}
    return [solve(problems[port]) for port in ports]


def test_a_late_clock_is_the_speed_with_one_size_in_three_channels(kuka: Case, given: list[Run]) -> None:
    ports = [f"q_link[{i}]" for i in (1, 2, 3)]
    solved = found(kuka, given, ports)
    for i, s in enumerate(solved):
        assert f"qd[{i + 1}]" in [t.text for _, t in s.terms]
        assert s.closure > 0.9
    (text,) = like_delays(solved)
    assert text.endswith(" in robot.q_link[1], robot.q_link[2], robot.q_link[3]")
    assert abs(float(text.removeprefix("like a delay of ").partition(" ms")[0]) - LATE) < NEAR


def test_a_wrist_coupling_is_the_speed_of_another_joint_at_the_right_motor(kuka: Case, given: list[Run]) -> None:
    column = COUPLING.torque.partition(".")[2]
    (before,), (after,) = (found(kuka, runs, [column]) for runs in (given, [COUPLING.added(r) for r in given]))
    name = COUPLING.speed.partition(".")[2]
    assert name not in [t.text for _, t in before.terms]
    ((value, (low, high)),) = [
        (v, i) for (_, t), v, i in zip(after.terms, after.found.values, after.found.intervals, strict=True) if t.text == name
    ]
    assert low <= COUPLING.size <= high
    assert abs(value - COUPLING.size) < 0.5 * (high - low)


def test_six_motors_lack_friction_of_their_own_joint(kuka: Case, given: list[Run]) -> None:
    for i, port in enumerate(port_forms(found(kuka, given, [f"torque_motor[{k}]" for k in range(1, 7)]))):
        index = port.port[-3:]
        assert f"qd{index}" in port.terms[0].term, (i, port.formula)
        assert port.closure > 0.5, port.formula


def answer(what: str, verdict: str, closed: float, form: Form | None = None, **named: float) -> TakenOut:
    closures = {("robot.q_link rms", "diagnosed runs"): 0.99, ("robot.q_link rms", "held-out condition"): closed}
    return TakenOut(what, verdict, {n.replace("_at_", " @ "): p for n, p in named.items()}, "", form, closures, 1.0)


def test_names_that_take_the_place_of_what_was_taken_out_are_counted(kuka: Case) -> None:
    port = PortForm("robot.q_link[1]", "rad", "-0.003 qd[1]", (), 0.996, None)
    seen = HowFar("rms", "robot.q_link", "rad", "held-out condition", 3e-3, 3e-4, 0.0, 0.99)
    form = Form("robot", "output", 0.0, (port,), ("like a delay of 3 ms in robot.q_link[1]",), (seen,))
    whole = answer("", "identified", 0.98, form, coulomb_at_a=0.98, viscous_at_a=0.97, load_at_a=0.1)
    wrong = answer("coulomb", "identified", 0.97, viscous_at_a=0.99, load_at_a=0.96)
    right = answer("viscous", "unknown", 0.5, coulomb_at_a=0.9, load_at_a=0.96)
    assert wrong.in_its_place(whole) == {"load @ a": 0.96}
    text = taken_out.text(kuka, [whole, wrong, right])
    assert "| nothing | identified | coulomb @ a 0.980 | - | 0.0 % | 1.0 |" in text
    assert "| coulomb | identified | viscous @ a 0.990 | load @ a 0.96 | 1.0 % | 1.0 |" in text
    assert "- as it was recorded: like a delay of 3 ms in robot.q_link[1]" in text
    assert "  - robot.q_link[1] (rad): -0.003 qd[1], closes 100 %" in text
    assert "  - in the loop, robot.q_link rms, held-out condition: 0.003 -> 0.0003 rad, 99 %" in text
    assert "With names in its place, and `identified`: coulomb, of 2." in text
    assert "Of these, as much of the gap is closed without the right names, within 2 %: coulomb." in text
    worse = answer("coulomb", "identified", 0.9, viscous_at_a=0.99, load_at_a=0.96)
    assert worse.closes_less(whole) == pytest.approx(0.08, rel=ROUNDOFF)
    assert whole.closes_less(worse) == 0.0  # it closes more
    assert "Of these" not in taken_out.text(kuka, [whole, worse, right])


def test_a_coupling_is_added_to_one_column_only(given: list[Run]) -> None:
    run = given[0]
    other = COUPLING.added(run)
    assert [c for c in run.columns if not np.array_equal(run.columns[c], other.columns[c])] == [COUPLING.torque]
    assert COUPLING.text == "put into the log: robot.torque_motor[5] + 2 N.m.s/rad motion.qd[4]"
