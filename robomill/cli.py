"""The command line. Every command is a thin face of a function of the package; exit status 0 done, 1 the answer is bad, 2 could not run."""

from __future__ import annotations

import argparse
import importlib
import json
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from robomill.models.planning.gcode import DIALECTS
from robomill.models.planning.point_path import INTERPOLATIONS
from robomill.models.planning.quantities import QUANTITIES
from robomill.option_types import in_unit, probability
from robomill.orchestration.errors import Interrupted, OrchestrationError

DESCRIPTION = "Digital twin of compliance-compensated robot milling, made of exchangeable FMUs."

ACTIONS = {
    "example": ("example_command", "run"),
    "run": ("commands", "run"),
    "build": ("commands", "build"),
    "check": ("commands", "check"),
    "plan": ("plan_command", "plan"),
    "compensate": ("compensate_command", "run"),
    "place": ("place_command", "run"),
    "import": ("import_command", "run"),
    "diagnose": ("diagnose_command", "run"),
    "blind": ("blind_command", "blind"),
    "identify": ("identify_command", "run"),
    "stability": ("stability_command", "run"),
    "rsi": ("rsi_command", "partner"),
    "krc": ("rsi_command", "robot"),
}
"""Module and function of each command; imported when it is called, because some take seconds."""


class _Parser(argparse.ArgumentParser):
    """Ends with an exception that has the text, for --json."""

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        print(f"{self.prog}: error: {message}", file=sys.stderr)
        raise SystemExit(2) from ValueError(message)


def parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    from robomill import blind_command, compensate_command, identify_command, place_command, rsi_command

    main_parser = _Parser(
        "robomill", description=DESCRIPTION, epilog="Start with: robomill example groove, then robomill run scenarios/groove.toml"
    )
    commands = main_parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    example = _command(commands, "example", "list the examples that come with robomill, or copy one here", "robomill example groove")
    example.add_argument("name", nargs="?", help="which one; without, they are listed")
    example.add_argument("folder", nargs="?", type=Path, metavar="DIR", help="where to (default: scenarios, as in the documentation)")

    run = _command(commands, "run", "run a scenario in all its variants, or a system file once", "robomill run scenarios/groove.toml")
    run.add_argument("file", type=Path, help="scenario or system file (TOML), or an SSP package (.ssp)")
    run.add_argument("--out", type=Path, help="folder for the results (default: results/NAME)")
    run.add_argument("--variant", action="append", metavar="NAME", help="only this variant; may be repeated")
    run.add_argument(
        "--fmus",
        type=Path,
        nargs="?",
        const=Path("dist"),
        metavar="FOLDER",
        help="run the FMUs in FOLDER (dist) instead of the models in process",
    )
    run.add_argument("--stop", type=in_unit("s"), metavar="S", help="stop time, s or with a unit (system files and packages)")
    run.add_argument(
        "--step", type=in_unit("s"), metavar="S", help='communication step, s or with a unit, such as "4 ms" (system files and packages)'
    )
    run.add_argument(
        "--loop",
        choices=("auto", "compiled", "python"),
        help="how the master runs; the numbers are the same (default: what the system file says)",
    )
    run.add_argument("--csv", action="store_true", help="also write signals.csv")
    run.add_argument("--checkpoint-every", type=int, metavar="STEPS", help="save each so many steps all that --resume goes on from")
    present = run.add_mutually_exclusive_group()
    present.add_argument("--overwrite", action="store_true", help="replace runs that are in the folder (default: that is refused)")
    present.add_argument(
        "--resume",
        action="store_true",
        help="keep finished runs in the folder, go on with one that has a checkpoint, begin the others anew",
    )
    run.add_argument(
        "--adopt", type=Path, metavar="FILE", help="with the effects (.ssv) or the form (.form.json) that `robomill diagnose` found"
    )
    run.add_argument("--no-pictures", action="store_true", help="skip the pictures")
    run.add_argument("--stl", action="store_true", help="write the machined part as part.stl beside each recording (cells with tri-dexels)")

    build = _command(commands, "build", "write every FMU", "robomill build --out dist")
    build.add_argument("--out", type=Path, default=Path("dist"), help="folder for the FMUs (default: dist)")
    build.add_argument(
        "--backend",
        choices=("python", "native"),
        default="python",
        help="python: needs Python, NumPy and Numba on the other side; native: needs nothing (default: python)",
    )
    build.add_argument(
        "--fmi",
        type=int,
        choices=(2, 3),
        nargs="+",
        action="extend",
        help="FMI version (3: native only; default: 2); `--fmi 2 3`: both, FMI 3 in the subfolder fmi3",
    )
    build.add_argument(
        "--platform", action="append", choices=("linux64", "win64", "darwin64"), help="native only; may be repeated (default: linux64)"
    )
    build.add_argument("--component", action="append", metavar="NAME", help="only this component; may be repeated")
    build.add_argument("--ssp", type=Path, metavar="FILE", help="also write this system, or this scenario in all its variants, as SSP 1.0")
    build.add_argument("--variant", action="append", metavar="NAME", help="with --ssp: only this variant; may be repeated")
    build.add_argument("--replay", type=Path, metavar="RUN", help="a replay FMU of --component from this recorded run")
    build.add_argument(
        "--as", dest="recorded_as", metavar="NAME", help="name of the component in the recorded run, where it differs (path, drive, ...)"
    )

    check = _command(commands, "check", "check FMUs, ours or not: validity, conformance, repeatability", "robomill check dist/*.fmu")
    check.add_argument("fmus", type=Path, nargs="+", metavar="FMU", help="co-simulation FMUs of FMI 2.0 or 3.0")

    plan = _command(commands, "plan", "plan a program and say what it does", "robomill plan scenarios/groove.ngc")
    _plan_arguments(plan)

    stability = _command(
        commands,
        "stability",
        "say whether the cuts of a program chatter, and draw the lobes at its poses",
        "robomill stability scenarios/robots/kr210_2.toml --map",
    )
    _stability_arguments(stability)

    offline = _command(
        commands,
        "compensate",
        "correct a program for the bending of the robot, from the simulation, and write it as G-code, KRL and RAPID",
        "robomill compensate scenarios/kr210/offline.toml",
    )
    compensate_command.add_arguments(offline)

    place = _command(
        commands, "place", "find where workpiece and spindle bend the robot least", "robomill place scenarios/kr210/offline.toml"
    )
    place_command.add_arguments(place)

    bring = _command(
        commands,
        "import",
        "bring a foreign log in as a run folder (CSV, npz, MAT, MDF4, RSI)",
        "robomill import data/kuka_kr300_recordings/map.toml data/kuka_kr300_recordings/recording_A.npz --out runs/A",
    )
    bring.add_argument("mapping", type=Path, metavar="MAP.toml", help="which column is which port, unit, frame, clock: docs/import.md")
    bring.add_argument("log", type=Path, metavar="LOG", help="the log")
    bring.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="folder for the run")
    bring.add_argument("--label", action="append", default=[], metavar="KEY=VALUE", help="a label beside those of the mapping, or instead")
    bring.add_argument("--overwrite", action="store_true", help="replace a run that is in the folder")

    diagnose = _command(
        commands,
        "diagnose",
        "say where measured runs depart from their simulation, why, and how far that can be mended",
        "robomill diagnose scenarios/milling_cell.toml runs/slot-* --held-out runs/pocket-*",
    )
    diagnose.add_argument("system", type=Path, nargs="?", metavar="SYSTEM.toml", help="the nominal simulation")
    diagnose.add_argument(
        "runs", type=Path, nargs="*", metavar="RUN", help="folders of measured runs; repeats of one condition belong together"
    )
    diagnose.add_argument(
        "--campaign", type=Path, metavar="FILE.toml", help="in place of these: conditions of several systems (docs/campaigns.md)"
    )
    diagnose.add_argument(
        "--held-out",
        type=Path,
        nargs="+",
        default=[],
        metavar="RUN",
        help="runs that are not fitted: does the answer hold there, and how far is the gap closed",
    )
    diagnose.add_argument(
        "--catalogue",
        type=Path,
        metavar="FILE",
        help="effects to look for (default: catalogue.toml beside the system, else the milling cell's)",
    )
    diagnose.add_argument(
        "--next-runs",
        type=Path,
        metavar="FILE",
        help="kinds of runs that the next one is designed from (default: next_runs.toml beside the system, else the milling cell's)",
    )
    diagnose.add_argument("--out", type=Path, default=Path("results") / "diagnosis", metavar="DIR", help="folder for the answer")
    diagnose.add_argument(
        "--check", action="store_true", help="say what these runs can show, and what is missing: nothing is fitted, docs/check.md"
    )
    diagnose.add_argument(
        "--form", action="store_true", help="look for the form of what is left whatever the verdict (default: if it is unknown)"
    )
    diagnose.add_argument("--repair", action="store_true", help="correct a clock that is late, and diagnose the rest")
    diagnose.add_argument(
        "--false-alarm",
        type=probability,
        default=0.02,
        metavar="P",
        help="probability of an effect on a machine that has none, between 0 and 1 (default: 0.02)",
    )
    diagnose.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")
    diagnose.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="simulate on the workers of this Dask cluster instead")

    blind = _command(
        commands, "blind", "the benchmark of withheld effects: make, run, score, page", "robomill blind make results/blind --cases 24"
    )
    blind_command.add_arguments(blind)

    identify = _command(
        commands,
        "identify",
        "identify parameters of the cell: springs of the robot, payload of the force sensor",
        "robomill identify stiffness data/fanuc_r2000ic/loads.toml",
    )
    identify_command.add_arguments(identify)

    rsi = _command(commands, "rsi", "answer a KUKA controller in real time over RSI, and record it", "robomill rsi scenarios/rsi/link.toml")
    rsi_command.add_partner_arguments(rsi)
    krc = _command(
        commands, "krc", "be the robot controller of such a link, simulated", "robomill krc scenarios/rsi/link.toml --lost 0.001"
    )
    rsi_command.add_robot_arguments(krc)
    return main_parser


def _stability_arguments(stability: argparse.ArgumentParser) -> None:
    stability.add_argument("scenario", type=Path, metavar="SCENARIO", help="a milling scenario: program, block, robot, tool, material")
    stability.add_argument(
        "--modes",
        metavar="NAME",
        help="modes of spindle and tool: a name of models/data/modes, a .toml file, or none (default: those of the component milling, "
        "else spindle_d16, an assumption)",
    )
    stability.add_argument("--rigid", action="store_true", help="the robot is rigid: spindle and tool alone")
    stability.add_argument(
        "--speeds",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="spindle speeds of the lobes, rev/min (default: around the program's)",
    )
    stability.add_argument(
        "--map", action="store_true", help="also the margin of the worst line over places 0.6 m around it, robot alone (some 10 s)"
    )
    stability.add_argument("--out", type=Path, metavar="DIR", help="folder for stability.json and the pictures (default: results/NAME)")
    stability.add_argument("--no-pictures", action="store_true", help="skip the pictures")


def _plan_arguments(plan: argparse.ArgumentParser) -> None:
    """Where the program stands, and how it is read where it does not say itself."""

    def place(option: str, text: str) -> None:
        plan.add_argument(option, nargs=3, type=in_unit("mm"), metavar=("X", "Y", "Z"), help=text)

    plan.add_argument(
        "program", type=Path, help="G-code, a path of points (TOML), KRL (.src) or RAPID (.mod) as robomill writes it, or a scenario"
    )
    place("--at", 'centre of the block\'s top in the base: mm, or with a unit, such as "1.3 m" (default: 1300 0 1200)')
    plan.add_argument(
        "--robot",
        metavar="NAME",
        default="kr300_r2500_ultra",
        help="whose reach is checked: a name of models/data/robots, or a .toml file",
    )
    plan.add_argument("--turn", type=in_unit("deg"), metavar="DEG", help="workpiece turned about z: degrees, or with a unit")
    plan.add_argument(
        "--block",
        nargs=3,
        type=in_unit("mm"),
        metavar=("LX", "LY", "LZ"),
        help="size of the block, mm; what the program cuts of it is checked",
    )
    plan.add_argument("--zero", metavar="PLACE", help="where G54 lies in the block, such as front-left-top (default: centre-top)")
    plan.add_argument(
        "--offset",
        nargs=4,
        action="append",
        default=[],
        metavar=("G55", "X", "Y", "Z"),
        help="origin of a work offset, mm from the centre of the block's top; may be repeated",
    )
    place("--start", "where the tool stands before the first block, mm from program zero (default: over the first point)")
    place("--home", "where G28, G30 and G53 lead, mm from program zero (default: 100 mm over the block)")
    plan.add_argument(
        "--dialect",
        choices=DIALECTS,
        help="unit of dwells: linuxcnc G4 P in s, fanuc and marlin in ms, haas in ms unless P has a decimal point (default: linuxcnc)",
    )
    plan.add_argument("--no-block-delete", action="store_true", help="execute lines that begin with /")
    plan.add_argument("--wear", action="store_true", help="G41 and G42 correct wear only: the program has the centre path")
    plan.add_argument("--tool", type=in_unit("mm"), metavar="D", help="diameter of the tool, mm (default: that of milling_force)")
    plan.add_argument("--out", type=Path, metavar="FILE.npy", help="write the segment table for the path component")
    plan.add_argument(
        "--orientation", choices=INTERPOLATIONS, help="of a path of points: turn over the way between points, or in the corners only"
    )
    plan.add_argument(
        "--within", choices=QUANTITIES, help="lower the feed of lines on which an axis would exceed its speed (acceleration, jerk as well)"
    )
    plan.add_argument(
        "--write",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="write the program for a controller: KUKA KRL (.src), ABB RAPID (.mod) or G-code (.ngc); may be repeated",
    )
    plan.add_argument(
        "--spline", action="store_true", help="with --write FILE.src: SPLINE blocks through the points instead of LIN with C_DIS"
    )


def _command(commands: Any, name: str, text: str, example: str) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = commands.add_parser(
        name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=f"Example: {example}"
    )
    command.add_argument("--json", action="store_true", help="print the result as JSON and nothing else")
    return command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; errors that a user can mend become one message on stderr and exit status 2."""
    try:
        options = parser().parse_args(arguments)
    except SystemExit as end:
        if end.__cause__ is not None and "--json" in (sys.argv[1:] if arguments is None else arguments):
            print(json.dumps({"error": str(end.__cause__)}))
        raise
    module, function = ACTIONS[options.command]
    try:
        with _ended_by_signals():
            action = getattr(importlib.import_module(f"robomill.{module}"), function)
            return int(action(options))
    except Interrupted as error:
        print(f"robomill {options.command}: {error}", file=sys.stderr)
        return 128 + error.signal
    except KeyboardInterrupt as error:
        number = error.args[0] if error.args else signal.SIGINT
        print(f"robomill {options.command}: interrupted{f' by {number.name}' if error.args else ''}", file=sys.stderr)
        return 128 + int(number)
    except (OrchestrationError, ValueError, LookupError, OSError, RuntimeError) as error:
        text = error.args[0] if isinstance(error, KeyError) and error.args else error
        if options.json:
            print(json.dumps({"error": str(text)}))
        print(f"robomill {options.command}: {text}", file=sys.stderr)
        return 2


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP end a command as Ctrl-C does: processes that it has started go, and temporary files."""
    names = [n for n in ("SIGTERM", "SIGHUP") if hasattr(signal, n)]
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, _: Any) -> None:
        raise KeyboardInterrupt(signal.Signals(number))

    before = {getattr(signal, n): signal.getsignal(getattr(signal, n)) for n in names}
    caught = {number: old for number, old in before.items() if old == signal.SIG_DFL}
    for number in caught:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number, old in caught.items():
            signal.signal(number, old)


if __name__ == "__main__":
    sys.exit(main())
