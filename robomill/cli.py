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

from robomill import __version__
from robomill.option_types import add_overwrite, in_unit, probability
from robomill.orchestration.errors import Interrupted, OrchestrationError

STATUS = (
    "Exit status 0: done. 1: the answer is bad (a check failed, a log is not usable, a program does not fit, nothing converged). "
    "2: it could not run; the message says why. 128 + N: ended by signal N, such as 130 by Ctrl-C."
)
DESCRIPTION = "Digital twin of compliance-compensated robot milling, made of exchangeable FMUs."

ACTIONS = {
    "example": ("example_command", "run"),
    "run": ("commands", "run"),
    "sweep": ("sweep_command", "run"),
    "build": ("commands", "build"),
    "view": ("view_command", "run"),
    "check": ("commands", "check"),
    "verify": ("verify_command", "run"),
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
    "completion": ("completion_command", "run"),
}
"""Module and function of each command; imported when it is called, because some take seconds."""


SHELLS = ("bash", "zsh", "fish")
"""Shells that commands are completed in."""


class Parser(argparse.ArgumentParser):
    """Ends with an exception that has the text, for --json."""

    _later: tuple[str, str] | None = None

    def add_when_used(self, module: str, function: str) -> None:
        """Options that `function(parser)` of a module adds when the command is parsed or described; imported no earlier."""
        self._later = module, function

    def complete(self) -> None:
        """Add the options that were put off."""
        later, self._later = self._later, None
        if later is not None:
            getattr(importlib.import_module(f"robomill.{later[0]}"), later[1])(self)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """That of argparse, with all options."""
        self.complete()
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Usage and text to standard error, then SystemExit with status 2 and the text as its cause."""
        self.print_usage(sys.stderr)
        print(f"{self.prog}: error: {message}", file=sys.stderr)
        raise SystemExit(2) from ValueError(message)


def parser() -> argparse.ArgumentParser:
    """All commands and their options; those of commands that load much are added when they are parsed (`Parser.complete`)."""
    main_parser = Parser(
        "robomill", description=DESCRIPTION, epilog=f"{STATUS} Start with: robomill example groove, then robomill run scenarios/groove.toml"
    )
    main_parser.add_argument("--version", action="version", version=f"robomill {__version__}")
    commands = main_parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    example = _command(commands, "example", "list the examples that come with robomill, or copy one here", "robomill example groove")
    example.add_argument("name", nargs="?", help="example to copy; without it, the examples are listed")
    example.add_argument(
        "folder", nargs="?", type=Path, metavar="DIR", help="folder to copy it into (default: scenarios, as in the documentation)"
    )

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
    run.add_argument("--checkpoint-every", type=int, metavar="STEPS", help="every STEPS steps, save all that --resume goes on from")
    present = run.add_mutually_exclusive_group()
    present.add_argument("--overwrite", action="store_true", help="replace runs that are in the folder (default: that is refused)")
    present.add_argument(
        "--resume",
        action="store_true",
        help="keep finished runs in the folder, go on with one that has a checkpoint, begin the others anew",
    )
    run.add_argument(
        "--adopt",
        type=Path,
        metavar="FILE",
        help="use what `robomill diagnose` found: effects or other parameters (.ssv), or a form (.form.json)",
    )
    run.add_argument("--no-pictures", action="store_true", help="skip the pictures")
    run.add_argument("--stl", action="store_true", help="write the machined part as part.stl beside each recording (cells with tri-dexels)")

    sweep = _command(
        commands,
        "sweep",
        "run a scenario or system over a grid of parameters, and keep a table of summaries",
        'robomill sweep scenarios/groove.toml --set "milling.tool_wear=0,0.2,0.4" --variant cartesian',
    )
    sweep.add_when_used("sweep_command", "add_arguments")

    view = _command(
        commands, "view", "write runs as one HTML page: robot, part, deviation and force in space and time", "robomill view results/groove"
    )
    view.add_when_used("view_command", "add_arguments")

    build = _command(commands, "build", "write the components as FMUs, and systems as SSP packages", "robomill build --out dist")
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
        help="FMI version; 3 needs --backend native; `--fmi 2 3` writes both, FMI 3 into the subfolder fmi3 (default: 2)",
    )
    build.add_argument(
        "--platform", action="append", choices=("linux64", "win64", "darwin64"), help="native only; may be repeated (default: linux64)"
    )
    build.add_argument(
        "--scalars", action="store_true", help="FMI 3, native: a variable for each element of an array, for importers without arrays"
    )
    build.add_argument("--sources", action="store_true", help="native: with C sources, for importers that compile")
    build.add_argument("--component", action="append", metavar="NAME", help="only this component; may be repeated")
    build.add_argument("--ssp", type=Path, metavar="FILE", help="also write this system, or this scenario in all its variants, as SSP 1.0")
    build.add_argument("--variant", action="append", metavar="NAME", help="with --ssp: only this variant; may be repeated")
    build.add_argument("--replay", type=Path, metavar="RUN", help="write a replay FMU of --component from this recorded run")
    build.add_argument(
        "--as", dest="recorded_as", metavar="NAME", help="name of the component in the recorded run, where it differs (path, drive, ...)"
    )

    build.add_argument(
        "--sign", type=Path, metavar="KEY.pem", help="also write all that was built as one archive, signed with this Ed25519 private key"
    )

    check = _command(commands, "check", "check FMUs, ours or not: validity, conformance, repeatability", "robomill check dist/*.fmu")
    check.add_argument("fmus", type=Path, nargs="+", metavar="FMU", help="co-simulation FMUs of FMI 2.0 or 3.0")

    verify = _command(
        commands, "verify", "check a release archive against its signature", "robomill verify dist/robomill-0.1.0.zip --key public.pem"
    )
    verify.add_argument("archive", type=Path, help="archive of robomill build --sign")
    verify.add_argument("--key", type=Path, required=True, metavar="PUBLIC.pem", help="Ed25519 public key of its maker")

    plan = _command(
        commands,
        "plan",
        "plan a program, and say how long it takes, what it cuts and whether the robot reaches it",
        "robomill plan scenarios/groove.ngc",
    )
    plan.add_when_used("cli", "add_plan_arguments")

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
    offline.add_when_used("compensate_command", "add_arguments")

    place = _command(
        commands, "place", "find where workpiece and spindle bend the robot least", "robomill place scenarios/kr210/offline.toml"
    )
    place.add_when_used("place_command", "add_arguments")

    bring = _command(
        commands,
        "import",
        "import a log of another program as a run folder (CSV, npz, MAT, HDF5, MDF4, ROS bags, RSI)",
        "robomill import data/kuka_kr300_recordings/map.toml data/kuka_kr300_recordings/recording_A.npz --out runs/A",
    )
    bring.add_argument("mapping", type=Path, metavar="MAP.toml", help="which column is which port, in which unit and frame, on which clock")
    bring.add_argument("log", type=Path, metavar="LOG", help="the log: a file, or the folder of a ROS bag")
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
        "--campaign", type=Path, metavar="FILE.toml", help="in place of these: conditions of several systems (docs/how_to/campaigns.md)"
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
        "--check", action="store_true", help="say what these runs can show, and what is missing: nothing is fitted, docs/how_to/check.md"
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
    add_overwrite(diagnose)
    diagnose.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")
    diagnose.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="simulate on the workers of this Dask cluster instead")

    blind = _command(
        commands, "blind", "the benchmark of withheld effects: make, run, score, page", "robomill blind make results/blind --cases 24"
    )
    blind.add_when_used("blind_command", "add_arguments")

    identify = _command(
        commands,
        "identify",
        "identify parameters of the cell: springs of the robot, payload of the force sensor",
        "robomill identify stiffness data/fanuc_r2000ic/loads.toml",
    )
    identify.add_when_used("identify_command", "add_arguments")

    rsi = _command(commands, "rsi", "answer a KUKA controller in real time over RSI, and record it", "robomill rsi scenarios/rsi/link.toml")
    rsi.add_when_used("rsi_command", "add_partner_arguments")
    krc = _command(
        commands,
        "krc",
        "simulate the robot controller at the other end of an RSI link",
        "robomill krc scenarios/rsi/link.toml --lost 0.001",
    )
    krc.add_when_used("rsi_command", "add_robot_arguments")
    completion = _command(
        commands, "completion", "print what makes a shell complete commands, options and files", "robomill completion bash"
    )
    completion.add_argument("shell", choices=SHELLS, help="which shell; docs/how_to/python.md says where the text belongs")
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
    add_overwrite(stability)


def add_plan_arguments(plan: argparse.ArgumentParser) -> None:
    """Where the program stands, and how it is read where it does not say itself."""
    from robomill.models.planning.gcode import DIALECTS
    from robomill.models.planning.point_path import INTERPOLATIONS
    from robomill.models.planning.quantities import QUANTITIES

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
        "--orientation",
        choices=INTERPOLATIONS,
        help="where the tool turns on a path of points: over the way between points, or in the corners only",
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
    add_overwrite(plan, "files")
    plan.add_argument(
        "--spline", action="store_true", help="with --write FILE.src: SPLINE blocks through the points instead of LIN with C_DIS"
    )


def _command(commands: Any, name: str, text: str, example: str) -> Parser:
    command: Parser = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=f"Example: {example}")
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
