"""The RSI link in real time: cycle jitter, turnaround, lost and late packets, memory; and the time of an answer with each kind of FMU.

    python -m benchmarks.rsi [--minutes 10] [--fmus PYTHON NATIVE] [--out docs/benchmarks/rsi.md]

The robot's side is a process of its own that sends the packets of a groove, recorded in lock step, again and again every 4 ms, so that what
is measured is the link and the partner. FMUS: folders with compensation_controller.fmu of both backends; without them they are built.
"""

from __future__ import annotations

import argparse
import gc
import multiprocessing
import os
import socket
import sys
import tempfile
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.measure import load
from robomill.cell.rsi.krc import FIRST_IPOC, Krc
from robomill.cell.rsi.link import real_time, serve
from robomill.cell.rsi.partner import Partner
from robomill.cell.rsi.preparation import prepare
from robomill.cell.rsi.settings import Link, load_link
from robomill.orchestration.system.definition import System

ROOT = Path(__file__).parent.parent
LINK = ROOT / "scenarios" / "rsi" / "link.toml"
DOCS = ROOT / "docs" / "benchmarks" / "rsi.md"
CYCLE = 0.004
QUANTILES = (0.5, 0.99, 0.999, 0.9999, 1.0)
SAMPLE = 1500
"""Packets that an answer is timed over."""


def packets_of(link: Link, system: System) -> list[bytes]:
    """The packets of a whole program, in lock step with a partner."""
    from robomill.cell.rsi.krc import lockstep

    krc, partner, found = Krc(link, system), Partner(link, system, 10_000), []
    inner = krc.packet

    def packet() -> bytes:
        found.append(inner())
        return found[-1]

    krc.packet = packet  # type: ignore[method-assign]  # listens in
    lockstep(krc, partner)
    krc.close()
    partner.close()
    return found


def renumbered(packet: bytes, ipoc: int) -> bytes:
    """A packet with another IPOC."""
    head, _, rest = packet.partition(b"<IPOC>")
    return head + b"<IPOC>" + str(ipoc).encode() + rest[rest.index(b"<") :]


def send(packets: list[bytes], port: int, cycles: int, priority: int, report: Any) -> None:
    """The robot's side: a packet every 4 ms; its answer counts if it comes before the next."""
    late, own = 0, np.zeros(cycles)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s, real_time(priority):
        s.connect(("127.0.0.1", port))
        gc.disable()
        begin = time.perf_counter() + 0.5
        for k in range(cycles):
            ipoc = FIRST_IPOC + 4 * k
            packet, wanted = renumbered(packets[k % len(packets)], ipoc), f"<IPOC>{ipoc}<".encode()
            while (left := begin + k * CYCLE - time.perf_counter()) > 0.0:
                time.sleep(left)
            own[k] = time.perf_counter() - begin - k * CYCLE
            s.send(packet)
            answered = False
            while not answered and (left := begin + (k + 1) * CYCLE - time.perf_counter()) > 0.0:
                s.settimeout(left)
                try:
                    answered = wanted in s.recv(4096)
                except TimeoutError:
                    break
            late += not answered
    report.put((late, np.quantile(own, QUANTILES)))


def session(
    link: Link, system: System, packets: list[bytes], minutes: float, priority: int
) -> tuple[Partner, int, npt.NDArray[np.float64], str]:
    """A session in real time; the partner, late answers and lateness of packets as the robot's side sees them, why it ended."""
    cycles = round(60.0 * minutes / CYCLE)
    partner = Partner(link, system, cycles + 20)
    context = multiprocessing.get_context("spawn")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        report = context.Queue()
        other = context.Process(target=send, args=(packets, s.getsockname()[1], cycles, priority, report))
        other.start()
        with real_time(priority):
            ended = serve(partner, s)
        late, own = report.get(timeout=30.0)
        other.join()
    return partner, late, own, ended


def answers(link: Link, system: System, packets: list[bytes]) -> tuple[npt.NDArray[np.float64], float, int, int]:
    """Times of answers [s], the first one, blocks that stay per 1000 answers, largest transient memory of one [bytes]."""
    partner = Partner(link, system, 3 * SAMPLE + 100)
    numbered = [renumbered(packets[k % len(packets)], FIRST_IPOC + 4 * k) for k in range(3 * SAMPLE)]
    times = np.zeros(SAMPLE)
    clock = time.perf_counter_ns

    def one(k: int) -> int:
        now = clock()
        n = partner.answer(partner.rob.put(numbered[k]), 4_000_000 * k)
        partner.sent(4_000_000 * k)
        assert n
        return clock() - now

    first = one(0) * 1e-9
    for k in range(1, SAMPLE):
        times[k] = one(k) * 1e-9
    gc.collect()
    gc.disable()
    before = sys.getallocatedblocks()
    for k in range(SAMPLE, SAMPLE + 1000):
        one(k)
    kept = sys.getallocatedblocks() - before
    gc.enable()
    tracemalloc.start()
    peak = 0
    for k in range(SAMPLE + 1000, SAMPLE + 1100):
        tracemalloc.reset_peak()
        base, _ = tracemalloc.get_traced_memory()
        one(k)
        peak = max(peak, tracemalloc.get_traced_memory()[1] - base)
    tracemalloc.stop()
    partner.close()
    return times[1:], first, kept, peak


def build(folder: Path) -> tuple[Path, Path]:
    """The controller as an FMU of both backends."""
    from robomill.cli import main as command

    for backend in ("python", "native"):
        command(["build", "--backend", backend, "--component", "compensation_controller", "--out", str(folder / backend)])
    return folder / "python", folder / "native"


def in_real_time(
    found: tuple[Partner, int, npt.NDArray[np.float64], str], minutes: float, how: str, busy: tuple[float, float]
) -> list[str]:
    """What a session measured, as Markdown."""
    partner, late, own, _ = found
    columns, w = partner.session.columns(), partner.watchdog
    cycles = partner.session.count
    rows = []
    for what, name in (("interval between packets, at the partner", "link.interval"), ("turnaround at the partner", "link.turnaround")):
        used = columns[name][2:]
        rows.append((what, np.quantile(used[used > 0.0], QUANTILES)))
    rows.append(("how late the robot's side sends", own))
    fault = "without a fault" if not w.fault or w.only_silent else f"with a fault: {w.fault}"
    return [
        f"{how}: {minutes:g} minutes, {cycles} cycles, load average {busy[0]:.1f} before and {busy[1]:.1f} after.",
        "",
        "| ms | median | 99 % | 99.9 % | 99.99 % | largest |",
        "|---|---|---|---|---|---|",
        *(f"| {what} | {' | '.join(f'{1e3 * q:.3f}' for q in numbers)} |" for what, numbers in rows),
        "",
        f"{w.counts['lost']} packets were lost, {w.counts['old'] + w.counts['malformed']} unusable; {late} answers "
        f"({100 * late / cycles:.3f} %) came after the cycle of 4 ms, as the robot's side counts. The partner ended {fault}.",
        "",
    ]


def page(kinds: dict[str, Any], sessions: list[str]) -> str:
    """The page as Markdown."""
    lines = [
        "# The RSI link in real time",
        "",
        "Written by `python -m benchmarks.rsi`: packets every 4 ms on loopback, robot's side and partner (native FMU) in two processes",
        f"on {os.cpu_count()} cores **shared with other work**, no real-time kernel. Back to [the link](../rsi.md).",
        "",
        *sessions,
        "Time of an answer (read, step the controller, bound, write, record) without sockets, and what it allocates:",
        "",
        "| compensation_controller | median us | 99 % us | first ms | blocks that stay per 1000 answers | largest transient bytes |",
        "|---|---|---|---|---|---|",
    ]
    for name, (times, first, kept, peak) in kinds.items():
        lines.append(
            f"| {name} | {1e6 * np.median(times):.0f} | {1e6 * np.quantile(times, 0.99):.0f} | {1e3 * first:.1f} | {kept} | {peak} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.rsi", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--fmus", type=Path, nargs=2, metavar=("PYTHON", "NATIVE"))
    parser.add_argument("--out", type=Path, default=DOCS)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        link = load_link(LINK)
        python, native = options.fmus or build(folder)
        systems = {"in process": prepare(link, folder / "plan", partner=True).system}
        systems |= {
            kind: prepare(link, folder / "plan", partner=True, fmus=fmus).system
            for kind, fmus in (("Python FMU", python), ("native FMU", native))
        }
        packets = packets_of(link, systems["in process"])
        kinds = {kind: answers(link, system, packets) for kind, system in systems.items()}
        said = []
        for minutes, priority, how in (
            (options.minutes, 50, "With real-time priority (`--priority 50`, SCHED_FIFO)"),
            (options.minutes / 5.0, 0, "Without"),
        ):
            before = load()
            found = session(link, systems["native FMU"], packets, minutes, priority)
            said += in_real_time(found, minutes, how, (before, load()))
            found[0].close()
        options.out.write_text(page(kinds, said), encoding="utf-8")
    print(options.out.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
