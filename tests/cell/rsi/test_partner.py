"""The partner on a virtual clock: answers, limits, every kind of failure, and what is recorded."""

from __future__ import annotations

import gc
import socket
import sys
import threading
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from robomill.cell.binding import resolve
from robomill.cell.rsi.link import real_time, serve
from robomill.cell.rsi.partner import Partner
from robomill.cell.rsi.settings import Link
from robomill.cli import main
from robomill.orchestration.errors import RunError
from robomill.orchestration.runs.run import Run
from tests.cell.rsi.conftest import MS, Bench, Packet, Q
from tests.tolerances import EXACT, ROUNDOFF

LAST_DIGIT = 0.5e-4 * (1.0 + ROUNDOFF)
"""Half of the last of four decimals: what the wire leaves of a value."""


def settle(bench: Bench, packet: Packet, cycles: int = 20) -> np.ndarray:
    """Send good packets; the correction that is sent in the end [mm]."""
    for k in range(cycles):
        sent = bench.sent(packet(k))
    assert np.linalg.norm(sent) > 0.1
    return sent


def test_an_answer_brings_back_ipoc_and_the_correction_of_the_controller(bench: Bench, packet: Packet) -> None:
    for k in range(10):
        text = bench.ask(packet(k))
    root = ElementTree.fromstring(text)
    assert root.attrib == {"Type": "ImFree"}
    assert root.findtext("IPOC") == "5036"
    rkorr = root.find("RKorr")
    assert rkorr is not None
    assert list(rkorr.attrib) == ["X", "Y", "Z", "A", "B", "C"]
    slave = resolve("compensation_controller", "alone")
    slave.configure(dict(bench.partner.side.assembly.parameters["controller"]))
    slave.initialise(0.0, 1.0, 0.004)
    y = np.zeros(len([p for p in slave.ports if p.causality == "output"]))
    for k in range(10):
        slave.set_inputs(np.concatenate([[300.0, 1e-3 * k, 0.0], np.zeros(6), np.deg2rad(Q), [0.0, 0.025, 0.0]]))
        if k:
            slave.step(0.004 * (k - 1), 0.004)
        slave.get_outputs(y)
    for name, wanted in zip("XYZ", 1e3 * y[:3], strict=True):
        assert float(rkorr.attrib[name]) == pytest.approx(wanted, rel=EXACT, abs=LAST_DIGIT)
    assert np.linalg.norm(y[:3]) > 1e-4


def test_a_jump_of_the_force_is_sent_at_the_rate_that_is_allowed(bench: Bench, packet: Packet) -> None:
    sent = [bench.sent(packet(k, 0.0 if k < 3 else 1000.0)) for k in range(20)]
    steps = np.abs(np.diff(sent, axis=0)).max(axis=1)
    assert steps.max() == pytest.approx(0.4, rel=ROUNDOFF)  # 100 mm/s in 4 ms
    assert bench.partner.watchdog.counts["clipped"] > 0
    assert np.abs(sent[-1]).max() > 1.0


def test_a_limit_holds_whatever_the_controller_wants(link: Link, packet: Packet) -> None:
    low = replace(link, receive=tuple(replace(s, limit=0.05) for s in link.receive))
    bench = Bench(low)
    sent = np.array([bench.sent(packet(k)) for k in range(20)])
    assert np.abs(sent).max() == 0.05


@pytest.mark.parametrize("kind", ["malformed", "replayed", "clock", "silent", "large", "frozen", "component"])
def test_every_failure_takes_the_correction_back_to_zero(bench: Bench, packet: Packet, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    held = settle(bench, packet)
    w, k, pause = bench.partner.watchdog, 20, 4 * MS

    def fail(*_: object) -> None:
        raise RunError("component 'controller' is broken", "controller", 0.1)

    if kind == "malformed":
        assert [bench.ask(b"<Rob nonsense", 1) for _ in range(5)] == [b""] * 5
        said = "5 packets in a row cannot be used; the last: unreadable packets: the XML is broken at byte 5"
    elif kind == "replayed":
        assert [bench.ask(packet(19), 1) for _ in range(5)] == [b""] * 5
        said = "5 packets in a row cannot be used; the last: IPOC 5076 is not after 5076"
    elif kind == "clock":
        k = 3000
        said = "the clock of the robot jumped: IPOC 17000 after 5076; expected 5080"
    elif kind == "silent":
        k, pause = 26, 28 * MS
        said = "no packet for 0.028 s"
    elif kind == "large":
        said = "the sensor sensor.f_T_T (Force.X, Force.Y, Force.Z) shows more than 3000 on the wire; expected at most that"
    elif kind == "frozen":
        for _ in range(25):
            bench.ask(packet(19, ipoc=5000 + 4 * k))
            k += 1
        said = "the sensor sensor.f_T_T (Force.X, Force.Y, Force.Z) has shown the same value for 25 cycles"
        held = bench.partner._held.copy()
    else:
        monkeypatch.setattr(bench.partner._master, "step", fail)
        said = "the partner's components: component 'controller' is broken"
    first = bench.sent(packet(k, 5000.0 if kind == "large" else 300.0), pause)
    assert w.fault == said
    assert w.failed
    path = [first, *(bench.sent(packet(k + i + 1)) for i in range(60))]
    sizes = np.linalg.norm(path, axis=1)
    assert np.all(np.diff(sizes) <= 0.0)
    assert np.all(path[52] == 0.0)
    assert np.linalg.norm(path[20]) == pytest.approx(np.linalg.norm(held) * (1.0 - 80.0 / 200.0), abs=4.0 / 200.0 * np.linalg.norm(held))
    assert bench.partner.summary()["state"] == "safe"


def test_lost_packets_are_made_up_for_with_the_values_held(bench: Bench, packet: Packet) -> None:
    for k in range(5):
        bench.ask(packet(k))
    bench.ask(packet(8), 16 * MS)
    session = bench.partner.session
    assert session.count == 9
    columns = session.columns()
    np.testing.assert_allclose(columns["sensor.f_T_T[2]"], 1e-3 * np.array([0, 1, 2, 3, 4, 4, 4, 4, 8]), rtol=ROUNDOFF)
    assert columns["link.lost"][-1] == 3.0
    np.testing.assert_allclose(session.rows[:9, 0], 0.004 * np.arange(9), rtol=ROUNDOFF)


def test_nothing_happens_before_a_packet_that_can_be_read(bench: Bench, packet: Packet) -> None:
    assert bench.ask(b"hello") == b""
    assert bench.partner.watchdog.state == 0
    assert bench.ask(packet(0))


def test_a_session_is_a_run_folder(bench: Bench, packet: Packet, tmp_path: Path) -> None:
    settle(bench, packet)
    bench.partner.write(
        tmp_path / "s", {"program": "p", "labels": {"condition": "c"}, "parameters": {"drive": {"backlash[1]": 0.0}}}, "over"
    )
    run = Run.load(tmp_path / "s")
    assert (run.outcome, run.info["kind"], run.info["message"]) == ("finished", "measured", "over")
    assert run.info["link"]["answered"] == 20
    assert run.info["parameters"]["controller"]["mode"] == 1
    assert run.info["parameters"]["drive"] == {"backlash[1]": 0.0}
    np.testing.assert_allclose(run["drive.q_motor"][-1], np.deg2rad(Q), rtol=ROUNDOFF)
    assert (run.unit("sensor.f_T_T"), run.unit("link.turnaround")) == ("N", "s")
    np.testing.assert_allclose(1e3 * run["link.sent_correction_B"][-1], bench.partner._sent, rtol=ROUNDOFF)


def test_a_session_with_a_fault_is_a_failed_run(bench: Bench, packet: Packet, tmp_path: Path) -> None:
    settle(bench, packet)
    bench.ask(packet(20, 5000.0))
    bench.partner.write(tmp_path / "s", {}, "over")
    run = Run.load(tmp_path / "s")
    assert run.outcome == "failed"
    assert run.info["message"].startswith("the sensor sensor.f_T_T")


def test_a_session_that_is_full_goes_on_and_says_so(link: Link, packet: Packet) -> None:
    bench = Bench(link, rows=5)
    for k in range(8):
        assert bench.ask(packet(k))
    assert (bench.partner.session.count, bench.partner.watchdog.counts["unrecorded"]) == (5, 3)


def test_answers_leave_no_objects_behind(bench: Bench, packet: Packet) -> None:
    packets = [packet(k) for k in range(450)]
    for k in range(250):
        bench.ask(packets[k])
    gc.collect()
    gc.disable()
    try:
        before = sys.getallocatedblocks()
        for k in range(250, 450):
            n = bench.partner.answer(bench.partner.rob.put(packets[k]), 4 * MS * (k + 1))
            bench.partner.sent(4 * MS * (k + 1) + 1000 * n)
        assert sys.getallocatedblocks() - before < 100  # less than one in two answers
    finally:
        gc.enable()


def test_over_a_socket_only_the_first_sender_is_answered(link: Link, packet: Packet) -> None:
    patient = replace(link, watch=replace(link.watch, silence=0.7, end=0.7))
    partner = Partner(patient, patient.system, 100)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        s.bind(("127.0.0.1", 0))
        ended: list[str] = []
        thread = threading.Thread(target=lambda: ended.append(serve(partner, s)))
        thread.start()
        robot.settimeout(30.0)
        robot.connect(s.getsockname())
        for k in range(20):
            robot.send(packet(k))
            assert f"<IPOC>{5000 + 4 * k}</IPOC>".encode() in robot.recv(4096)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
                other.sendto(packet(1000), s.getsockname())
        thread.join(30.0)
    assert ended == ["the robot controller stopped sending after IPOC 5076"]
    assert partner.watchdog.only_silent
    assert partner.watchdog.counts["received"] == 20
    assert gc.isenabled()


def test_nobody_calls(link: Link) -> None:
    partner = Partner(link, link.system, 1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        assert serve(partner, s, waited=lambda: False) == "no robot controller has called"


def test_a_priority_that_there_is_not_is_refused() -> None:
    with pytest.raises(OSError, match=r"priority 1000 is refused: .*; without --priority it runs as any process"), real_time(1000):
        pass


@pytest.mark.slow
def test_the_fmu_of_the_controller_gives_the_same_answers(link: Link, packet: Packet, bench: Bench, tmp_path: Path) -> None:
    assert main(["build", "--component", "compensation_controller", "--out", str(tmp_path)]) == 0
    other = Bench(replace(link, system=link.system.with_source("controller", str(tmp_path / "compensation_controller.fmu"))))
    for k in range(60):
        text = packet(k, 10.0 * k)
        assert other.ask(text) == bench.ask(text)
    assert bench.partner.summary() == other.partner.summary()
    other.partner.close()
