"""Options of the commands whose own modules take long to load: the command line is read and described without them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from robomill.option_types import add_overwrite, in_unit, probability

SHELLS = ("bash", "zsh", "fish")
"""Shells that commands are completed in."""


def example(parser: Any) -> None:
    """Which example, and where to."""
    parser.add_argument("name", nargs="?", help="example to copy; without it, the examples are listed")
    parser.add_argument(
        "folder", nargs="?", type=Path, metavar="DIR", help="folder to copy it into (default: scenarios, as in the documentation)"
    )


def run(parser: Any) -> None:
    """What is run, how, and where the results go."""
    parser.add_argument("file", type=Path, help="scenario or system file (TOML), or an SSP package (.ssp)")
    parser.add_argument("--out", type=Path, help="folder for the results (default: results/NAME)")
    parser.add_argument("--variant", action="append", metavar="NAME", help="only this variant; may be repeated")
    parser.add_argument(
        "--fmus",
        type=Path,
        nargs="?",
        const=Path("dist"),
        metavar="FOLDER",
        help="run the FMUs in FOLDER (dist) instead of the models in process",
    )
    parser.add_argument("--stop", type=in_unit("s"), metavar="S", help="stop time, s or with a unit (system files and packages)")
    parser.add_argument(
        "--step", type=in_unit("s"), metavar="S", help='communication step, s or with a unit, such as "4 ms" (system files and packages)'
    )
    parser.add_argument(
        "--loop",
        choices=("auto", "compiled", "python"),
        help="how the master runs; the numbers are the same (default: what the system file says)",
    )
    parser.add_argument("--csv", action="store_true", help="also write signals.csv")
    parser.add_argument("--checkpoint-every", type=int, metavar="STEPS", help="every STEPS steps, save all that --resume goes on from")
    present = parser.add_mutually_exclusive_group()
    present.add_argument("--overwrite", action="store_true", help="replace runs that are in the folder (default: that is refused)")
    present.add_argument(
        "--resume",
        action="store_true",
        help="keep finished runs in the folder, go on with one that has a checkpoint, begin the others anew",
    )
    parser.add_argument(
        "--adopt",
        type=Path,
        metavar="FILE",
        help="use what `robomill diagnose` found: effects or other parameters (.ssv), or a form (.form.json)",
    )
    parser.add_argument("--no-pictures", action="store_true", help="skip the pictures")
    parser.add_argument(
        "--stl", action="store_true", help="write the machined part as part.stl beside each recording (cells with tri-dexels)"
    )


def build(parser: Any) -> None:
    """What is built, in which form, and where to."""
    parser.add_argument("--out", type=Path, default=Path("dist"), help="folder for the FMUs (default: dist)")
    parser.add_argument(
        "--backend",
        choices=("python", "native"),
        default="python",
        help="python: needs Python, NumPy and Numba on the other side; native: needs nothing (default: python)",
    )
    parser.add_argument(
        "--fmi",
        type=int,
        choices=(2, 3),
        nargs="+",
        action="extend",
        help="FMI version; 3 needs --backend native; `--fmi 2 3` writes both, FMI 3 into the subfolder fmi3 (default: 2)",
    )
    parser.add_argument(
        "--platform", action="append", choices=("linux64", "win64", "darwin64"), help="native only; may be repeated (default: linux64)"
    )
    parser.add_argument(
        "--scalars", action="store_true", help="FMI 3, native: a variable for each element of an array, for importers without arrays"
    )
    parser.add_argument("--sources", action="store_true", help="native: with C sources, for importers that compile")
    parser.add_argument("--component", action="append", metavar="NAME", help="only this component; may be repeated")
    parser.add_argument("--ssp", type=Path, metavar="FILE", help="also write this system, or this scenario in all its variants, as SSP 1.0")
    parser.add_argument("--variant", action="append", metavar="NAME", help="with --ssp: only this variant; may be repeated")
    parser.add_argument("--replay", type=Path, metavar="RUN", help="write a replay FMU of --component from this recorded run")
    parser.add_argument(
        "--as", dest="recorded_as", metavar="NAME", help="name of the component in the recorded run, where it differs (path, drive, ...)"
    )
    parser.add_argument(
        "--sign", type=Path, metavar="KEY.pem", help="also write all that was built as one archive, signed with this Ed25519 private key"
    )


def check(parser: Any) -> None:
    """What is checked."""
    parser.add_argument("fmus", type=Path, nargs="+", metavar="FMU", help="co-simulation FMUs of FMI 2.0 or 3.0")


def verify(parser: Any) -> None:
    """Archive and key."""
    parser.add_argument("archive", type=Path, help="archive of robomill build --sign")
    parser.add_argument("--key", type=Path, required=True, metavar="PUBLIC.pem", help="Ed25519 public key of its maker")


def bring(parser: Any) -> None:
    """Mapping, log and folder of `robomill import`."""
    parser.add_argument(
        "mapping", type=Path, metavar="MAP.toml", help="which column is which port, in which unit and frame, on which clock"
    )
    parser.add_argument("log", type=Path, metavar="LOG", help="the log: a file, or the folder of a ROS bag")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="folder for the run")
    parser.add_argument("--label", action="append", default=[], metavar="KEY=VALUE", help="a label beside those of the mapping, or instead")
    parser.add_argument("--overwrite", action="store_true", help="replace a run that is in the folder")


def diagnose(parser: Any) -> None:
    """System, runs, and how they are diagnosed."""
    parser.add_argument("system", type=Path, nargs="?", metavar="SYSTEM.toml", help="the nominal simulation")
    parser.add_argument(
        "runs", type=Path, nargs="*", metavar="RUN", help="folders of measured runs; repeats of one condition belong together"
    )
    parser.add_argument(
        "--campaign", type=Path, metavar="FILE.toml", help="in place of these: conditions of several systems (docs/how_to/campaigns.md)"
    )
    parser.add_argument(
        "--held-out",
        type=Path,
        nargs="+",
        default=[],
        metavar="RUN",
        help="runs that are not fitted: does the answer hold there, and how far is the gap closed",
    )
    parser.add_argument(
        "--catalogue",
        type=Path,
        metavar="FILE",
        help="effects to look for (default: catalogue.toml beside the system, else the milling cell's)",
    )
    parser.add_argument(
        "--adopt",
        type=Path,
        metavar="FILE",
        help="diagnose the system with what was found before: effects or other parameters (.ssv), or a form (.form.json)",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="how well the numbers of this machine are calibrated, in place of the tolerances in the catalogue (docs/how_to/check.md)",
    )
    parser.add_argument(
        "--next-runs",
        type=Path,
        metavar="FILE",
        help="kinds of runs that the next one is designed from (default: next_runs.toml beside the system, else the milling cell's)",
    )
    parser.add_argument("--out", type=Path, default=Path("results") / "diagnosis", metavar="DIR", help="folder for the answer")
    parser.add_argument(
        "--check", action="store_true", help="say what these runs can show, and what is missing: nothing is fitted, docs/how_to/check.md"
    )
    parser.add_argument(
        "--form", action="store_true", help="look for the form of what is left whatever the verdict (default: if it is unknown)"
    )
    parser.add_argument("--repair", action="store_true", help="correct a clock that is late, and diagnose the rest")
    parser.add_argument(
        "--false-alarm",
        type=probability,
        default=0.02,
        metavar="P",
        help="probability of an effect on a machine that has none, between 0 and 1 (default: 0.02)",
    )
    add_overwrite(parser)
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="simulate on the workers of this Dask cluster instead")


def completion(parser: Any) -> None:
    """Which shell."""
    parser.add_argument("shell", choices=SHELLS, help="which shell; docs/how_to/python.md says where the text belongs")


def stability(parser: Any) -> None:
    """Scenario, modes, speeds, and what is drawn."""
    parser.add_argument("scenario", type=Path, metavar="SCENARIO", help="a milling scenario: program, block, robot, tool, material")
    parser.add_argument(
        "--modes",
        metavar="NAME",
        help="modes of spindle and tool: a name of models/data/modes, a .toml file, or none (default: those of the component milling, "
        "else spindle_d16, an assumption)",
    )
    parser.add_argument("--rigid", action="store_true", help="the robot is rigid: spindle and tool alone")
    parser.add_argument(
        "--speeds",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="spindle speeds of the lobes, rev/min (default: around the program's)",
    )
    parser.add_argument(
        "--map", action="store_true", help="also the margin of the worst line over places 0.6 m around it, robot alone (some 10 s)"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for stability.json and the pictures (default: results/NAME)")
    parser.add_argument("--no-pictures", action="store_true", help="skip the pictures")
    add_overwrite(parser)


def plan(parser: Any) -> None:
    """Where the program stands, and how it is read where it does not say itself."""
    from robomill.models.planning.gcode import DIALECTS
    from robomill.models.planning.point_path import INTERPOLATIONS
    from robomill.models.planning.quantities import QUANTITIES

    def place(option: str, text: str) -> None:
        parser.add_argument(option, nargs=3, type=in_unit("mm"), metavar=("X", "Y", "Z"), help=text)

    parser.add_argument(
        "program", type=Path, help="G-code, a path of points (TOML), KRL (.src) or RAPID (.mod) as robomill writes it, or a scenario"
    )
    place("--at", 'centre of the block\'s top in the base: mm, or with a unit, such as "1.3 m" (default: 1300 0 1200)')
    parser.add_argument(
        "--robot",
        metavar="NAME",
        default="kr300_r2500_ultra",
        help="whose reach is checked: a name of models/data/robots, or a .toml file",
    )
    parser.add_argument("--turn", type=in_unit("deg"), metavar="DEG", help="workpiece turned about z: degrees, or with a unit")
    parser.add_argument(
        "--block",
        nargs=3,
        type=in_unit("mm"),
        metavar=("LX", "LY", "LZ"),
        help="size of the block, mm; what the program cuts of it is checked",
    )
    parser.add_argument("--zero", metavar="PLACE", help="where G54 lies in the block, such as front-left-top (default: centre-top)")
    parser.add_argument(
        "--offset",
        nargs=4,
        action="append",
        default=[],
        metavar=("G55", "X", "Y", "Z"),
        help="origin of a work offset, mm from the centre of the block's top; may be repeated",
    )
    place("--start", "where the tool stands before the first block, mm from program zero (default: over the first point)")
    place("--home", "where G28, G30 and G53 lead, mm from program zero (default: 100 mm over the block)")
    parser.add_argument(
        "--dialect",
        choices=DIALECTS,
        help="unit of dwells: linuxcnc G4 P in s, fanuc and marlin in ms, haas in ms unless P has a decimal point (default: linuxcnc)",
    )
    parser.add_argument("--no-block-delete", action="store_true", help="execute lines that begin with /")
    parser.add_argument("--wear", action="store_true", help="G41 and G42 correct wear only: the program has the centre path")
    parser.add_argument("--tool", type=in_unit("mm"), metavar="D", help="diameter of the tool, mm (default: that of milling_force)")
    parser.add_argument("--out", type=Path, metavar="FILE.npy", help="write the segment table for the path component")
    parser.add_argument(
        "--orientation",
        choices=INTERPOLATIONS,
        help="where the tool turns on a path of points: over the way between points, or in the corners only",
    )
    parser.add_argument(
        "--within", choices=QUANTITIES, help="lower the feed of lines on which an axis would exceed its speed (acceleration, jerk as well)"
    )
    parser.add_argument(
        "--write",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="write the program for a controller: KUKA KRL (.src), ABB RAPID (.mod) or G-code (.ngc); may be repeated",
    )
    add_overwrite(parser, "files")
    parser.add_argument(
        "--spline", action="store_true", help="with --write FILE.src: SPLINE blocks through the points instead of LIN with C_DIS"
    )
