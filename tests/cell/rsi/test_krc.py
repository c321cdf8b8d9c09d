"""The simulator of the robot controller, and both sides together in lock step."""

from __future__ import annotations

import socket
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from robomill.cell import milling
from robomill.cell.rsi.krc import Krc, lockstep
from robomill.cell.rsi.link import drive, serve
from robomill.cell.rsi.network import Direction, Faults
from robomill.cell.rsi.partner import Partner
from robomill.cell.rsi.pose import Pose
from robomill.cell.rsi.settings import Link, LinkError, load_link
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System
from tests import SCENARIOS
from tests.cell.rsi.test_settings import LINK, written
from tests.tolerances import ROUNDOFF

ON_THE_WIRE = 5e-5
"""Half of the last of four decimals: mm, deg, N."""
STIFFNESS = 0.3e6
"""Below the stiffness of the robot in any direction, N/m: 2.3 um/N in the softest, with margin."""


LEVER = 3.0
"""Longer than from axis 1 to the tool tip, m."""


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[Link, System]:
    """Drive and controller alone, for 0.2 s."""
    link = load_link(written(tmp_path_factory.mktemp("small")))
    return link, replace(link.system, stop=0.2)


def test_a_packet_says_where_the_robot_is(small: tuple[Link, System]) -> None:
    krc = Krc(*small)
    krc.advance()
    first = krc.packet()
    assert first.startswith(b'<Rob TYPE="KUKA"><RIst X="')
    assert krc.rob.read(krc.rob.put(first)) == 0
    q = krc.run()["drive.q_motor"][-1]
    np.testing.assert_allclose([krc.rob.values[krc.rob.index[f"AIPos.A{i}"]] for i in range(1, 7)], np.rad2deg(q), atol=ON_THE_WIRE, rtol=0)
    krc.end_cycle()
    krc.advance()
    krc.packet()
    assert krc.rob.ipoc == krc.ipoc
    assert (krc.late, krc.rob.wholes[krc.rob.index["Delay.D"]]) == (1, 1)


def test_the_pose_is_that_of_pinocchio() -> None:
    """Chain of modified DH joints by an independent library; A, B, C by its rotation about z, y, x."""
    q = np.deg2rad([10.0, -70.0, 80.0, 20.0, 50.0, -30.0])
    placed = pin.SE3.Identity()
    for i in range(6):
        theta = KR300.axis_sign[i] * q[i] + KR300.dh_offset[i]
        turn = pin.SE3(pin.utils.rotate("x", KR300.dh_alpha[i]), np.zeros(3))
        slide = pin.SE3(np.eye(3), np.array([KR300.dh_a[i], 0.0, 0.0]))
        screw = pin.SE3(pin.utils.rotate("z", theta), np.array([0.0, 0.0, KR300.dh_d[i]]))
        placed = placed * turn * slide * screw
    w, x, y, z = SPINDLE_ACROSS.quat_FT
    placed = placed * pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(SPINDLE_ACROSS.p_FT_F))
    pose = Pose(KR300, SPINDLE_ACROSS).of(q)
    np.testing.assert_allclose(pose[:3], 1e3 * placed.translation, rtol=1e2 * ROUNDOFF)
    roll, pitch, yaw = np.deg2rad(pose[[5, 4, 3]])
    np.testing.assert_allclose(pin.rpy.rpyToMatrix(roll, pitch, yaw), placed.rotation, atol=1e2 * ROUNDOFF, rtol=0)


def test_only_the_answer_of_this_cycle_counts(small: tuple[Link, System]) -> None:
    krc, partner = Krc(*small), Partner(*small, 100)
    answers = []
    for _ in range(3):
        krc.advance()
        n = partner.answer(partner.rob.put(krc.packet()), 4_000_000 * len(answers))
        answers.append(bytes(partner.sen.view(n)))
        krc.end_cycle()
    assert krc.late == 3
    krc.advance()
    assert not krc.take(answers[2])
    assert not krc.take(b"<Sen")
    n = partner.answer(partner.rob.put(krc.packet()), 12_000_000)
    answer = bytes(partner.sen.view(n))
    assert krc.take(answer)
    assert not krc.take(answer)
    assert krc.foreign == 3


@pytest.mark.parametrize("holdon", [True, False])
def test_without_an_answer_the_last_one_holds_if_the_configuration_says_so(small: tuple[Link, System], holdon: bool) -> None:
    link, system = small
    config = replace(link.config, receive=tuple(replace(e, holdon=holdon) for e in link.config.receive))
    krc = Krc(replace(link, config=config), system)
    krc.advance()
    krc.packet()
    krc.sen.values[0], krc.sen.ipoc = 2.0, krc.ipoc
    assert krc.take(bytes(krc.sen.view(krc.sen.write())))
    krc.end_cycle()
    assert krc.side.remotes[0].values[0] == pytest.approx(2e-3, rel=ROUNDOFF)
    krc.advance()
    krc.end_cycle()
    assert krc.side.remotes[0].values[0] == pytest.approx(2e-3 if holdon else 0.0, rel=ROUNDOFF)


def test_too_many_late_answers_end_the_session(small: tuple[Link, System]) -> None:
    krc = Krc(*small, timeout=10)
    while not krc.ended:
        krc.advance()
        krc.packet()
        krc.end_cycle()
    assert krc.ended == "10 answers in a row were late: RSI ends with a timeout at t = 0.036 s"
    assert krc.run().outcome == "failed"


def test_the_network_does_what_it_is_told() -> None:
    count = 4000
    network = Direction(Faults(lost=0.1, late=0.2, doubled=0.05, seed=3), 0)
    out = [network.carry(str(k).encode()) for k in range(count)]
    again = Direction(Faults(lost=0.1, late=0.2, doubled=0.05, seed=3), 0)
    assert out == [again.carry(str(k).encode()) for k in range(count)]
    for found, share in ((network.lost, 0.1), (network.late, 0.2), (network.doubled, 0.05)):
        assert abs(found - share * count) < 4.0 * np.sqrt(share * count)
    assert sum(map(len, out)) == count - network.lost + network.doubled - len(network._waiting)
    assert all(str(k - 1).encode() in came for k, came in enumerate(out) if len(came) > 1 and came[0] != came[1])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"lost": 1.5}, "lost is 1.5; expected a probability from 0 to 1"),
        ({"lost": 0.6, "late": 0.6}, "expected at most 1: a datagram has one fate"),
        ({"jitter": -1.0}, "jitter is -1 s; expected a time of 0 or more"),
    ],
)
def test_faults_that_cannot_be_are_refused(given: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Faults(**given)  # type: ignore[arg-type]


def test_a_system_without_an_end_or_without_axes_is_refused(small: tuple[Link, System]) -> None:
    link, system = small
    with pytest.raises(LinkError, match="has no end: give it stop or stop_when"):
        Krc(link, replace(system, stop=None))
    with pytest.raises(LinkError, match=r"unknown output of the robot with six elements: 'path.q_ref'"):
        Krc(replace(link, planned="path.q_ref"), system)


def test_over_a_socket_and_in_step_nothing_depends_on_time(small: tuple[Link, System]) -> None:
    link, system = small
    link = replace(link, watch=replace(link.watch, silence=0.7, end=0.7))
    direct_krc, direct = Krc(link, system), Partner(link, system, 200)
    lockstep(direct_krc, direct)
    krc, partner = Krc(link, system), Partner(link, system, 200)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        thread = threading.Thread(target=serve, args=(partner, s))
        thread.start()
        drive(krc, s.getsockname(), in_step=True)
        thread.join(30.0)
    assert krc.ended == direct_krc.ended == "stopped at t = 0.200 s"
    for name, column in direct_krc.run().columns.items():
        np.testing.assert_array_equal(krc.run().columns[name], column)
    assert krc.late == 0


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> milling.Job:
    """The groove, planned."""
    link = load_link(SCENARIOS / "rsi" / "link.toml")
    assert link.scenario is not None
    return milling.prepare(link.scenario, tmp_path_factory.mktemp("groove"))


@pytest.fixture(scope="module")
def groove(job: milling.Job) -> tuple[Link, System, Run]:
    """The groove with pilot control, and what it is without any link."""
    link = load_link(SCENARIOS / "rsi" / "link.toml")
    assert link.variant is not None
    run, _ = milling.mill(job, link.variant)
    return link, milling.of_variant(job, link.variant), run


@pytest.mark.slow
@pytest.mark.parametrize("decimals", [4, 9])
def test_the_groove_over_the_link_is_that_without_it(groove: tuple[Link, System, Run], decimals: int) -> None:
    """The link adds no cycle: the answer of a cycle is used in the next, as the delayed connection of the system says."""
    link, system, run = groove
    link = replace(link, decimals=decimals)
    krc, partner = Krc(link, system), Partner(link, system, len(run) + 10)
    lockstep(krc, partner)
    found, digit = krc.run(), 0.5 * 10.0**-decimals
    assert len(found) == len(run)
    # a force that is rounded bends the model by less than digit / STIFFNESS, and the answer is rounded once more; both twice over the loop
    bound = 4.0 * (digit / STIFFNESS + 1e-3 * digit)
    columns = partner.session.columns()
    for i in range(1, 4):
        np.testing.assert_allclose(columns[f"controller.correction_B[{i}]"], run[f"controller.correction_B[{i}]"], atol=bound, rtol=0)
    np.testing.assert_allclose(found["compliance.p_BT_B"], run["compliance.p_BT_B"], atol=bound, rtol=0)
    assert np.ptp(run["controller.correction_B"], axis=0).max() > 1e-4


@pytest.mark.slow
def test_axis_corrections_with_the_sensor_on_the_partners_side(job: milling.Job, tmp_path: Path) -> None:
    """Another cut of the same system, AK instead of RKorr, and the cutting force in the telegram."""
    text = (SCENARIOS / "rsi" / "link.toml").read_text().partition("[[send]]")[0]
    text = text.replace('"../groove.toml"', f'"{SCENARIOS / "groove.toml"}"').replace("cartesian_pilot", "axis")
    text = text.replace('["controller"]', '["sensor", "controller"]').replace("decimals = 4", "decimals = 9")
    carried = {"AIPos": ("drive.q_motor", "deg"), "Feed": ("path.v_BT_B", "mm/s"), "Force": ("milling.f_T_B", "N")}
    carried |= {"Moment": ("milling.m_T_B", "N.m")}
    for element, (port, unit) in carried.items():
        text += f'[[send]]\nelement = "{element}"\nport = "{port}"\nunit = "{unit}"\n'
    text += '[[receive]]\nelement = "AK"\nport = "controller.correction_q"\nunit = "deg"\nlimit = "5 deg"\n'
    xml = (SCENARIOS / "rsi" / "ethernet.xml").read_text()
    for i, name in enumerate("XYZABC"):
        xml = xml.replace(f"RKorr.{name}", f"AK.A{i + 1}")
    (tmp_path / "ethernet.xml").write_text(xml)
    (tmp_path / "link.toml").write_text(text)
    link = load_link(tmp_path / "link.toml")
    assert link.variant is not None
    run, _ = milling.mill(job, link.variant)
    system = milling.of_variant(job, link.variant)
    krc, partner = Krc(link, system), Partner(link, system, len(run) + 10)
    lockstep(krc, partner)
    found = krc.run()
    bound = 4.0 * np.deg2rad(0.5e-9) * LEVER + 4.0 * 0.5e-9 / STIFFNESS
    np.testing.assert_allclose(found["compliance.p_BT_B"], run["compliance.p_BT_B"], atol=bound, rtol=0)
    assert np.ptp(run["controller.correction_q"], axis=0).max() > 1e-4


@pytest.mark.slow
def test_a_bad_network_costs_little_and_is_counted(groove: tuple[Link, System, Run]) -> None:
    link, system, run = groove
    krc, partner = Krc(link, system), Partner(link, system, len(run) + 10)
    lockstep(krc, partner, Faults(lost=0.01, late=0.02, doubled=0.01, seed=5), most=600)
    counts = partner.watchdog.counts
    assert not partner.watchdog.failed
    assert counts["lost"] > 0
    assert counts["old"] > 0
    assert krc.late > 0
    difference = np.linalg.norm(krc.run()["compliance.p_BT_B"] - run["compliance.p_BT_B"][:600], axis=1)
    assert 0.0 < difference.max() < 1e-4


def test_a_link_without_a_scenario_needs_no_plan(tmp_path: Path) -> None:
    assert load_link(written(tmp_path, LINK)).scenario is None
