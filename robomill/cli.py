"""The command line. Every command is a thin face of a function of the package; exit status 0 done, 1 the answer is bad, 2 could not run."""

from __future__ import annotations

import argparse
import errno
import gc
import importlib
import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, NoReturn

from robomill import __version__
from robomill.collector import put_off
from robomill.orchestration.errors import Interrupted, OrchestrationError, unknown

STATUS = (
    "Exit status 0: done. 1: the answer is bad (a check failed, a log is not usable, a program does not fit, nothing converged). "
    "2: it could not run; the message says why. 128 + N: ended by signal N, such as 130 by Ctrl-C."
)
_RIGHTS = "name a place where you may read and write"
REMEDIES = {
    errno.EACCES: _RIGHTS,
    errno.EPERM: _RIGHTS,
    errno.EROFS: _RIGHTS,
    errno.ENOENT: "correct the path",
    errno.ENOTDIR: "a part of this path is a file where a folder is expected; name another path",
    errno.EISDIR: "expected a file; name one",
    errno.ENOSPC: "free room on the disk, or name a place on another one",
}
"""What to do where the operating system refuses."""
DESCRIPTION = "Digital twin of compliance-compensated robot milling, made of exchangeable FMUs."


class Command(NamedTuple):
    """A command, its options and what it does: functions of modules below `robomill`, which are imported when they are used."""

    name: str
    help: str
    example: str
    action: str
    """`module.function`, which takes the options and returns the exit status."""
    options: str
    """`module.function`, which adds the options to a parser."""


COMMANDS = (
    Command(
        "example",
        "list the examples that come with robomill, or copy one here",
        "robomill example groove",
        "example_command.run",
        "command_options.example",
    ),
    Command(
        "run",
        "run a scenario in all its variants, or a system file once",
        "robomill run scenarios/groove.toml",
        "run_command.run",
        "command_options.run",
    ),
    Command(
        "sweep",
        "run a scenario or system over a grid of parameters, and keep a table of summaries",
        'robomill sweep scenarios/groove.toml --set "milling.tool_wear=0,0.2,0.4" --variant cartesian',
        "sweep_command.run",
        "sweep_command.add_arguments",
    ),
    Command(
        "view",
        "write runs as one HTML page: robot, part, deviation and force in space and time",
        "robomill view results/groove",
        "view_command.run",
        "view_command.add_arguments",
    ),
    Command(
        "build",
        "write the components as FMUs, and systems as SSP packages",
        "robomill build --out dist",
        "build_command.run",
        "command_options.build",
    ),
    Command(
        "check",
        "check FMUs, ours or not: validity, conformance, repeatability",
        "robomill check dist/*.fmu",
        "check_command.run",
        "command_options.check",
    ),
    Command(
        "verify",
        "check a release archive against its signature",
        "robomill verify dist/robomill-0.1.0.zip --key public.pem",
        "verify_command.run",
        "command_options.verify",
    ),
    Command(
        "plan",
        "plan a program, and say how long it takes, what it cuts and whether the robot reaches it",
        "robomill plan scenarios/groove.ngc",
        "plan_command.plan",
        "command_options.plan",
    ),
    Command(
        "stability",
        "say whether the cuts of a program chatter, and draw the lobes at its poses",
        "robomill stability scenarios/robots/kr210_2.toml --map",
        "stability_command.run",
        "command_options.stability",
    ),
    Command(
        "compensate",
        "correct a program for the bending of the robot, from the simulation, and write it as G-code, KRL and RAPID",
        "robomill compensate scenarios/kr210/offline.toml",
        "compensate_command.run",
        "compensate_command.add_arguments",
    ),
    Command(
        "place",
        "find where workpiece and spindle bend the robot least",
        "robomill place scenarios/kr210/offline.toml",
        "place_command.run",
        "place_command.add_arguments",
    ),
    Command(
        "import",
        "import a log of another program as a run folder (CSV, npz, MAT, HDF5, MDF4, ROS bags, RSI)",
        "robomill import data/kuka_kr300_recordings/map.toml data/kuka_kr300_recordings/recording_A.npz --out runs/A",
        "import_command.run",
        "command_options.bring",
    ),
    Command(
        "diagnose",
        "say where measured runs depart from their simulation, why, and how far that can be mended",
        "robomill diagnose scenarios/milling_cell.toml runs/slot-* --held-out runs/pocket-*",
        "diagnose_command.run",
        "command_options.diagnose",
    ),
    Command(
        "blind",
        "the benchmark of withheld effects: make, run, score, page",
        "robomill blind make results/blind --cases 24",
        "blind_command.blind",
        "blind_command.add_arguments",
    ),
    Command(
        "identify",
        "identify parameters of the cell: springs of the robot, payload of the force sensor",
        "robomill identify stiffness data/fanuc_r2000ic/loads.toml",
        "identify_command.run",
        "identify_command.add_arguments",
    ),
    Command(
        "rsi",
        "answer a KUKA controller in real time over RSI, and record it",
        "robomill rsi scenarios/rsi/link.toml",
        "rsi_command.partner",
        "rsi_command.add_partner_arguments",
    ),
    Command(
        "krc",
        "simulate the robot controller at the other end of an RSI link",
        "robomill krc scenarios/rsi/link.toml --lost 0.001",
        "rsi_command.robot",
        "rsi_command.add_robot_arguments",
    ),
    Command(
        "completion",
        "print what makes a shell complete commands, options and files",
        "robomill completion bash",
        "completion_command.run",
        "command_options.completion",
    ),
)


class Parser(argparse.ArgumentParser):
    """Ends with an exception that has the text, for --json."""

    _later: str | None = None

    def add_when_used(self, options: str) -> None:
        """Options that a `module.function` adds when the command is parsed or described; imported no earlier."""
        self._later = options

    def complete(self) -> None:
        """Add the options that were put off."""
        later, self._later = self._later, None
        if later is not None:
            _function(later)(self)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """That of argparse, with all options; what it does not know is refused where the options are known that it may have meant."""
        self.complete()
        found, left = super().parse_known_args(args, namespace)
        if left:
            self.error(self._refusal(left[0]))
        return found, left

    def _refusal(self, argument: str) -> str:
        if argument.startswith("-"):
            return unknown("option", argument.partition("=")[0], [o for o in self._option_string_actions if o.startswith("--")])
        return f"unexpected argument {argument!r}; leave it out, or put a name with blanks in quotes (--help says what is expected)"

    def error(self, message: str) -> NoReturn:
        """Usage and text to standard error, then SystemExit with status 2 and the text as its cause."""
        self.print_usage(sys.stderr)
        print(f"{self.prog}: error: {message}", file=sys.stderr)
        raise SystemExit(2) from ValueError(message)


def parser(name: str = "") -> argparse.ArgumentParser:
    """The command of that name, or all if there is none; options are added when they are parsed (`Parser.complete`)."""
    main_parser = Parser(
        "robomill", description=DESCRIPTION, epilog=f"{STATUS} Start with: robomill example groove, then robomill run scenarios/groove.toml"
    )
    main_parser.add_argument("--version", action="version", version=f"robomill {__version__}")
    commands = main_parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    for c in [c for c in COMMANDS if c.name == name] or COMMANDS:
        command: Parser = commands.add_parser(
            c.name, help=c.help, description=f"{c.help[0].upper()}{c.help[1:]}.", epilog=f"Example: {c.example}"
        )
        command.add_argument("--json", action="store_true", help="print the result as JSON and nothing else")
        command.add_when_used(c.options)
    return main_parser


def _function(name: str) -> Callable[[Any], Any]:
    """The `module.function` of a command; imported now, because some modules take seconds."""
    module, _, function = name.partition(".")
    module = f"robomill.{module}"
    if module not in sys.modules:
        with put_off():
            importlib.import_module(module)
            gc.freeze()  # what modules hold stays: the collector need not look through it, now or later
    found: Callable[[Any], Any] = getattr(sys.modules[module], function)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; errors that a user can mend become one message on stderr and exit status 2."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments:
        parser().print_help()
        return 2
    try:
        options = parser(arguments[0]).parse_args(arguments)
    except SystemExit as end:
        if end.__cause__ is not None and "--json" in arguments:
            print(json.dumps({"error": str(end.__cause__)}))
        raise
    action = next(c.action for c in COMMANDS if c.name == options.command)
    try:
        with _ended_by_signals():
            return int(_function(action)(options))
    except Interrupted as error:
        print(f"robomill {options.command}: {error}", file=sys.stderr)
        return 128 + error.signal
    except KeyboardInterrupt as error:
        number = error.args[0] if error.args else signal.SIGINT
        said = [f"interrupted{f' by {number.name}' if error.args else ''}", *getattr(error, "__notes__", ())]
        print(f"robomill {options.command}: {'; '.join(said)}", file=sys.stderr)
        return 128 + int(number)
    except (OrchestrationError, ValueError, LookupError, OSError, RuntimeError) as error:
        text = error.args[0] if isinstance(error, KeyError) and error.args else _refused_access(error) or error
        if options.json:
            print(json.dumps({"error": str(text)}))
        print(f"robomill {options.command}: {text}", file=sys.stderr)
        return 2


def _refused_access(error: Exception) -> str:
    """What a refusal of the operating system is about and what helps; nothing for errors of another origin."""
    if not isinstance(error, OSError) or error.errno is None or error.filename is None:
        return ""
    remedy = REMEDIES.get(error.errno, "look at this place and who may read and write there")
    return f"{error.filename}: {(error.strerror or 'refused').lower()}; {remedy}"


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
