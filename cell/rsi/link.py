"""The link in real time: a socket, a clock, and nothing else. The partner waits for packets, the robot controller makes the clock."""

from __future__ import annotations

import gc
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from robomill.cell.rsi.krc import Krc
from robomill.cell.rsi.network import Direction, Faults
from robomill.cell.rsi.partner import Partner
from robomill.cell.rsi.telegram import LONGEST
from robomill.cell.rsi.watchdog import NANO, WAITING

PATIENCE = 5.0
"""How long the simulator waits for an answer in lock step [s]."""
_LOOK = 0.25
"""How often the partner looks up while no robot has called [s]."""


@contextmanager
def without_collector() -> Iterator[None]:
    """No garbage collection meanwhile: all that is there is set aside, and a session makes no cycles of objects."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


@contextmanager
def real_time(priority: int) -> Iterator[None]:
    """Be scheduled before all ordinary processes meanwhile (SCHED_FIFO, Linux); 0: as always. OSError says what is missing."""
    if not priority:
        yield
        return
    if not hasattr(os, "sched_setscheduler"):
        raise OSError("a real-time priority needs Linux; leave --priority away")
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (PermissionError, OSError) as error:
        least, most = (f(os.SCHED_FIFO) for f in (os.sched_get_priority_min, os.sched_get_priority_max))
        raise OSError(
            f"priority {priority} is refused: {error.strerror}; expected {least} to {most} and the right to it (CAP_SYS_NICE, or rtprio in "
            "limits.conf); without --priority it runs as any process"
        ) from None
    try:
        yield
    finally:
        os.sched_setscheduler(0, before, parameter)


def serve(partner: Partner, listening: socket.socket, duration: float | None = None, waited: Callable[[], bool] | None = None) -> str:
    """Answer one robot controller until it falls silent, `duration` [s] after its first packet, or Ctrl-C; returns why it is over.

    `listening` is a bound UDP socket. Only the first sender is listened to.
    `waited` is asked now and then while nobody has called; False ends it.
    """
    try:
        with without_collector():
            ended = _first(partner, listening, waited)
            end = time.perf_counter_ns() + round(NANO * duration) if duration is not None else None
            return ended or _answer(partner, listening, end)
    except KeyboardInterrupt:
        return "interrupted"


def _first(partner: Partner, listening: socket.socket, waited: Callable[[], bool] | None) -> str:
    """Answer the first packet that can be read, and listen to its sender only from then on; why it is over, "" if it is not."""
    w, rob, sen = partner.watchdog, partner.rob, partner.sen
    listening.settimeout(_LOOK)
    while True:
        try:
            length, sender = listening.recvfrom_into(rob.buffer)
        except TimeoutError:
            if waited is not None and not waited():
                return "no robot controller has called"
            continue
        n = partner.answer(length, time.perf_counter_ns())
        if w.state == WAITING:
            continue  # nothing that a robot controller sends
        listening.connect(sender)
        listening.settimeout(w.settings.silence)
        listening.send(sen.view(n))
        partner.sent(time.perf_counter_ns())
        return ""


def _answer(partner: Partner, connected: socket.socket, end: int | None) -> str:
    """Answer packet after packet; why it is over. Per cycle there are two calls of the system, and no object stays."""
    w, buffer, view = partner.watchdog, partner.rob.buffer, partner.sen.view
    clock = time.perf_counter_ns
    now = clock()
    while end is None or now < end:
        try:
            length = connected.recv_into(buffer)
            now = clock()
            n = partner.answer(length, now)
            if n:
                connected.send(view(n))
                partner.sent(clock())
        except TimeoutError:
            now = clock()
            if w.silent(now):
                return f"the robot controller stopped sending after IPOC {w.ipoc}"
        except ConnectionRefusedError:
            continue  # its socket is closed: what it sent before is still to be read, then it is silent
    return "the time that was asked for is over"


def drive(
    krc: Krc,
    address: tuple[str, int],
    faults: Faults | None = None,
    in_step: bool = False,
    progress: Callable[[float], object] | None = None,
) -> None:
    """Be the robot controller for a partner at `address`: one packet per cycle, in real time or (`in_step`) as fast as answers come."""
    faults = faults or Faults()
    there, back = Direction(faults, 0), Direction(faults, 1)
    cycle = round(NANO * krc.system.step)
    clock = time.perf_counter_ns
    buffer = bytearray(LONGEST)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s, without_collector():
        s.connect(address)
        begin = clock()
        count = 0
        while not krc.ended:
            krc.advance()
            datagrams = there.carry(krc.packet())
            deadline = begin + (count + 1) * cycle
            if not in_step:
                _until(begin + count * cycle + round(NANO * there.jitter()))
            for datagram in datagrams:
                _send(s, datagram)
            if in_step:
                # the answer to what was just sent; a packet that is lost or late has none in this cycle
                wanted = datagrams[-1:] == [bytes(krc.rob.view(len(datagrams[-1])))] if datagrams else False
                deadline = clock() + (round(NANO * PATIENCE) if wanted else 0)
            _listen(krc, s, buffer, back, deadline, in_step)
            krc.end_cycle()
            count += 1
            if progress is not None:
                progress(count * krc.system.step)


def _send(s: socket.socket, datagram: bytes) -> None:
    with suppress(ConnectionRefusedError):  # nobody listens there yet, or any more: the count of late answers says so
        s.send(datagram)


def _listen(krc: Krc, s: socket.socket, buffer: bytearray, back: Direction, deadline: int, in_step: bool) -> None:
    """Take answers until that of this cycle has come, or the deadline [ns] is over: the robot reckons its next cycle ahead of time."""
    while not krc.answered:
        left = deadline - time.perf_counter_ns()
        if left <= 0:
            return
        s.settimeout(left / NANO)
        try:
            n = s.recv_into(buffer)
        except TimeoutError:
            return
        except ConnectionRefusedError:
            if not in_step:
                _until(deadline)
            return
        came = back.carry(bytes(buffer[:n]))
        for answer in came:
            krc.take(answer)
        if in_step and not krc.answered and len(came) != 1:
            return  # it was lost or is late


def _until(moment: int) -> None:
    """Sleep until the clock [ns] says `moment`."""
    left = moment - time.perf_counter_ns()
    if left > 0:
        time.sleep(left / NANO)
