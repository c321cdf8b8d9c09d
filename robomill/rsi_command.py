"""`robomill rsi` and `robomill krc`: both sides of the link to a KUKA controller, and its configuration file."""

from __future__ import annotations

import json
import socket
import sys
from argparse import ArgumentTypeError, Namespace
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from robomill.files import vacant
from robomill.option_types import in_unit

DONE, BAD = 0, 1
ROOM = 600.0
"""Seconds of a session that are kept where nobody says how long it lasts."""
_WARNING = "simulation software without any safety function: the limits of POSCORR and AXISCORR and the safety controller protect, not this"
Address = tuple[str, int]


def add_partner_arguments(parser: Any) -> None:
    """Options of `robomill rsi`."""
    _add_priority(parser)
    parser.add_argument("link", type=Path, metavar="LINK.toml", help="what goes over the wire, limits, watchdog: docs/how_to/rsi.md")
    parser.add_argument("--listen", type=address, metavar="IP:PORT", help="where to wait for the robot controller (default: the link's)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the recorded session (default: results/NAME)")
    parser.add_argument(
        "--duration", type=in_unit("s"), metavar="S", help="end after so long, s or with a unit (default: when it falls silent)"
    )
    parser.add_argument(
        "--fmus", type=Path, nargs="?", const=Path("dist"), metavar="FOLDER", help="answer with the FMUs in FOLDER (dist)"
    )  # fmt: skip
    parser.add_argument("--label", action="append", default=[], metavar="KEY=VALUE", help="a label of the recorded run; may be repeated")
    parser.add_argument("--overwrite", action="store_true", help="replace a run that is in the folder, or FILE.xml")
    parser.add_argument(
        "--config", type=Path, metavar="FILE.xml", help="write KUKA's configuration file for this link, and do nothing else"
    )


def _add_priority(parser: Any) -> None:
    parser.add_argument("--priority", type=int, default=0, metavar="N", help="real-time priority (SCHED_FIFO), 1 to 99 (default: none)")


def add_robot_arguments(parser: Any) -> None:
    """Options of `robomill krc`."""
    parser.add_argument("link", type=Path, metavar="LINK.toml", help="the link file; the partner has the same one")
    parser.add_argument("--to", type=address, metavar="IP:PORT", help="where the partner listens (default: the link's)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for what the robot did (default: results/NAME_robot)")
    parser.add_argument("--overwrite", action="store_true", help="replace a run that is in the folder")
    parser.add_argument("--fmus", type=Path, nargs="?", const=Path("dist"), metavar="FOLDER", help="run the FMUs in FOLDER (dist)")
    parser.add_argument("--adopt", type=Path, metavar="FILE.ssv", help="a robot with these parameters instead of the nominal one")
    parser.add_argument("--lost", type=float, default=0.0, metavar="P", help="probability that a datagram is lost, in either direction")
    parser.add_argument("--late", type=float, default=0.0, metavar="P", help="probability that a datagram comes a cycle late")
    parser.add_argument("--doubled", type=float, default=0.0, metavar="P", help="probability that a datagram comes twice")
    parser.add_argument("--jitter", type=in_unit("s"), default=0.0, metavar="S", help="packets leave up to so much late, s or with a unit")
    parser.add_argument("--seed", type=int, default=1, help="of losses, delays and jitter (default: 1)")
    _add_priority(parser)
    parser.add_argument("--in-step", action="store_true", help="go on as fast as answers come, instead of in real time")


def address(text: str) -> Address:
    """`192.168.1.10:49152`."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 <= int(port) < 1 << 16:
        raise ArgumentTypeError(f"{text!r}: expected IP:PORT, such as 127.0.0.1:49152")
    return host, int(port)


def partner(options: Namespace) -> int:
    """Answer a robot controller and record the session; status 1 after a fault."""
    from robomill.cell.rsi import ethernet
    from robomill.cell.rsi.link import real_time, serve
    from robomill.cell.rsi.partner import Partner
    from robomill.cell.rsi.preparation import prepare
    from robomill.cell.rsi.settings import load_link
    from robomill.import_command import labels as read_labels
    from robomill.orchestration.runs.lock import FolderLock
    from robomill.orchestration.runs.run import check_vacant
    from robomill.progress import progress_bar
    from robomill.run_command import RESULTS

    link = load_link(options.link)
    if options.config is not None:
        if not options.overwrite:
            vacant(options.config, option="--config")
        ethernet.write(link.config, options.config)
        print(json.dumps({"written": str(options.config)}) if options.json else f"{options.config}: copy it to the robot controller")
        return DONE
    folder: Path = options.out or RESULTS / link.name
    labels = read_labels(options.label)
    if not options.overwrite:
        check_vacant([folder])
    folder.mkdir(parents=True, exist_ok=True)
    where: Address = options.listen or (link.config.address, link.config.port)
    with FolderLock(folder), _bound(where) as listening:
        with progress_bar(options.json) as report:
            prepared = prepare(link, folder, partner=True, fmus=options.fmus, progress=report)
        rows = round((options.duration or ROOM) / link.system.step) + 2 + link.watch.gap
        made = Partner(link, prepared.system, rows)
        try:
            for text in made.side.notes:
                print(f"note: {text}", file=sys.stderr)
            print(f"warning: {_WARNING}", file=sys.stderr)
            print(f"listening at {where[0]}:{listening.getsockname()[1]}", file=sys.stderr, flush=True)
            with real_time(options.priority):
                ended = serve(made, listening, options.duration)
            result = {**made.summary(), "ended": ended, **_times(made.session.columns(), link.system.step)}
            if made.session.count:
                about = {**prepared.about, "labels": {**prepared.about["labels"], **labels}}
                made.write(folder, about, ended, options.overwrite)
        finally:
            made.close()
    if options.json:
        print(json.dumps(result))
    else:
        _show(result, folder)
    return BAD if result["fault"] else DONE


def _bound(where: Address) -> socket.socket:
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        s.bind(where)
    except OSError as error:
        s.close()
        raise OSError(
            f"cannot listen at {where[0]}:{where[1]}: {error.strerror}; name an address of this machine with --listen IP:PORT"
        ) from None
    return s


def _times(columns: Any, step: float) -> dict[str, Any]:
    """Percentiles of interval and turnaround, s, after the first two cycles."""
    found: dict[str, Any] = {}
    for name in ("interval", "turnaround"):
        values = columns[f"link.{name}"][2:]
        values = values[values > 0.0]
        if len(values):
            p50, p99, p999 = np.quantile(values, (0.5, 0.99, 0.999))
            found[f"{name}_s"] = {"median": p50, "p99": p99, "p99_9": p999, "largest": float(values.max())}
    return found


def _show(result: dict[str, Any], folder: Path) -> None:
    print(f"{result['ended']}; {result['state']}{': ' + result['fault'] if result['fault'] else ''}")
    print(
        ", ".join(f"{result[k]} {k}" for k in ("cycles", "answered", "lost", "malformed", "old", "clock", "late", "clipped", "unrecorded"))
    )
    for name in ("interval_s", "turnaround_s"):
        if name in result:
            print(f"{name[:-2]}: " + ", ".join(f"{k} {1e3 * v:.3f} ms" for k, v in result[name].items()))
    print(f"the session is in {folder}/" if result["cycles"] else "nothing was recorded")


def robot(options: Namespace) -> int:
    """Be the robot controller for a partner; status 1 if RSI ended with a timeout."""
    from robomill.cell.rsi.krc import Krc
    from robomill.cell.rsi.link import drive, real_time
    from robomill.cell.rsi.network import Faults
    from robomill.cell.rsi.preparation import prepare
    from robomill.cell.rsi.settings import load_link
    from robomill.diagnosis.outcome import adopt
    from robomill.orchestration.runs.importing import write_run
    from robomill.orchestration.runs.lock import FolderLock
    from robomill.orchestration.runs.run import check_vacant
    from robomill.progress import progress_bar
    from robomill.run_command import RESULTS

    link = load_link(options.link)
    faults = Faults(options.lost, options.late, options.doubled, options.jitter, options.seed)
    folder: Path = options.out or RESULTS / f"{link.name}_robot"
    if not options.overwrite:
        check_vacant([folder])
    folder.mkdir(parents=True, exist_ok=True)
    where: Address = options.to or (link.config.address, link.config.port)
    with FolderLock(folder), progress_bar(options.json) as report:
        prepared = prepare(link, folder, partner=False, fmus=options.fmus, progress=report)
        system = prepared.system if options.adopt is None else adopt.adopted(prepared.system, options.adopt)
        made = Krc(link, system)
        try:
            for text in made.side.notes:
                print(f"note: {text}", file=sys.stderr)
            with real_time(options.priority):
                drive(made, where, faults, options.in_step)
            run = made.run()
        finally:
            made.close()
        about = {
            **prepared.about,
            **{k: v for k, v in run.info.items() if k != "parameters"},
            "kind": "simulated",
            "network": asdict(faults),
        }
        write_run(folder, run.t, run.columns, run.ports, about, options.overwrite)
    result = {"ended": made.ended, "cycles": len(run), "late": made.late, "foreign": made.foreign, **_figures(link, run)}
    if options.json:
        print(json.dumps(result))
    else:
        print(f"{made.ended}; {len(run)} cycles, {made.late} without their answer, {made.foreign} answers that were not used")
        if "max_deviation_m" in result:
            print(part_told(result))
        print(f"what the robot did is in {folder}/")
    return BAD if run.outcome == "failed" else DONE


def part_told(figures: Mapping[str, Any]) -> str:
    """A sentence about the part; in a session that ended early the tool may not have met it."""
    if figures["max_deviation_m"] is None:
        return "nothing was cut: the session ended before the tool met the block"
    return f"largest deviation of the part {1e3 * figures['max_deviation_m']:.2f} mm, peak force {figures['peak_force_n']:.0f} N"


def _figures(link: Any, run: Any) -> dict[str, Any]:
    """How well the part is milled, if it is."""
    from robomill.cell.evaluation import evaluate

    if link.scenario is None or run.outcome == "failed":
        return {}
    result = evaluate(link.variant.name, link.variant.title, run, link.scenario.workpiece, float("nan"))
    return {k: getattr(result.figures, k) for k in ("max_deviation_m", "rms_deviation_m", "peak_force_n")}
