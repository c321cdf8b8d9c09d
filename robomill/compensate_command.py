"""`robomill compensate`: a program corrected for the bending of the robot, from the simulation."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robomill.option_types import in_unit

if TYPE_CHECKING:
    from robomill.cell.compensation import Compensation
    from robomill.cell.scenario import Scenario

_ENDINGS = {
    "converged": "converged",
    "settled": "settled: another correction takes off less than a tenth",
    "iterations": "not converged: all corrections are used up, the last one still took off more than a tenth (--iterations)",
}


def add_arguments(parser: Any) -> None:
    """What is compensated, and how."""
    parser.add_argument("file", type=Path, metavar="SCENARIO|PROGRAM", help="milling scenario; or a program, with --cell")
    parser.add_argument(
        "--cell", type=Path, metavar="SCENARIO", help="mill PROGRAM in the cell, on the block and with the tools of this one"
    )
    parser.add_argument("--variant", metavar="NAME", help="variant of the scenario (default: the first)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default: results/NAME_compensated)")
    parser.add_argument(
        "--format",
        action="append",
        metavar="NAME",
        help="gcode, krl, krl-spline, rapid; may be repeated (default: gcode, krl, rapid)",
    )
    mm = in_unit("mm")
    parser.add_argument("--tolerance", type=mm, metavar="MM", help="of the chords (default: 0.01 mm)")
    parser.add_argument("--limit", type=mm, metavar="MM", help="largest correction (default: 5 mm)")
    parser.add_argument("--iterations", type=int, metavar="N", help="corrections at most (default: 8)")
    parser.add_argument("--no-perturbed", action="store_true", help="do not try the result on machines with other springs and forces")
    parser.add_argument("--no-pictures", action="store_true", help="skip the pictures")
    parser.add_argument("--overwrite", action="store_true", help="replace results that are in the folder (default: that is refused)")


def run(options: Namespace) -> int:
    """Compensate, write the programs and say what came of it; status 1 if it has not converged."""
    from robomill.cell.compensated_program import DEFAULT_FORMATS, check_formats, write_programs, write_summary
    from robomill.cell.compensation import PERTURBED, Settings, compensate
    from robomill.orchestration.runs.lock import FolderLock
    from robomill.progress import progress_bar

    scenario = _scenario(options)
    formats = tuple(options.format or DEFAULT_FORMATS)
    check_formats(formats)
    lengths = {n: 1e-3 * getattr(options, n) for n in ("tolerance", "limit") if getattr(options, n) is not None}
    counts = {} if options.iterations is None else {"iterations": options.iterations}
    settings = Settings(**lengths, **counts)
    folder = options.out or Path("results") / f"{scenario.name}_compensated"
    folder.mkdir(parents=True, exist_ok=True)
    perturbed = () if options.no_perturbed else PERTURBED
    with progress_bar(options.json) as report, FolderLock(folder):
        result = compensate(scenario, options.variant, folder, settings, report, perturbed=perturbed, overwrite=options.overwrite)
        files = write_programs(result, folder, formats)
        figures = write_summary(result, folder)
        if not options.no_pictures:
            from robomill.cell import compensation_pictures  # matplotlib takes a second to load

            files += compensation_pictures.draw_all(result, folder)
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        _show(result, folder, files)
    return 1 if result.ending == "iterations" else 0


def _scenario(options: Namespace) -> Scenario:
    from robomill.cell.compensation import CompensationError
    from robomill.cell.scenario import load_scenario

    if options.file.suffix == ".toml" and options.cell is None:
        return load_scenario(options.file)
    if options.cell is None:
        raise CompensationError(
            f"{options.file} is a program: say in which cell it is milled, --cell SCENARIO.toml (robot, block, tools; such as "
            "scenarios/kr210/offline.toml), or give the scenario itself"
        )
    if not options.file.is_file():
        raise FileNotFoundError(f"no program file {options.file}; expected G-code, or a path of points (TOML)")
    return replace(load_scenario(options.cell), program=options.file.resolve(), name=options.file.stem)


def _show(result: Compensation, folder: Path, files: list[Path]) -> None:
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table(title=f"{result.scenario.title}: {result.variant.title}", title_justify="left", box=SIMPLE)
    for heading in ("", "tool tip\nrms mm", "95 %\nmm", "max\nmm", "surface\nrms mm", "95 %\nmm", "max\nmm", "time\ns"):
        table.add_column(heading, justify="right" if heading else "left")
    table.add_row("nominal", *["0"] * 6, f"{result.before.plan.duration:.2f}")
    for name, done, scanned in zip(("uncompensated", "compensated"), (result.before, result.after), result.results, strict=True):
        f, s = done.figures, scanned.figures
        surface = [_mm(v) for v in (s.rms_deviation_m, s.p95_deviation_m, s.max_deviation_m)]
        table.add_row(name, _mm(f.rms_m), _mm(f.p95_m), _mm(f.max_m), *surface, f"{done.plan.duration:.2f}")
    console.print(table)
    table = Table(box=SIMPLE)
    for heading in ("iteration", "tool tip\nrms mm", "smoothed\nrms mm", "contraction", "rho", "factor", "poses", "largest correction\nmm"):
        table.add_column(heading, justify="right")
    for i in result.iterations:
        told = [f"{v:+.2f}" if v is not None else "-" for v in (i.contraction, i.rho)]
        size = [f"{i.factor:g}", str(i.points), _mm(i.largest_correction_m)] if i.number else ["-"] * 3
        table.add_row(str(i.number), _mm(i.rms_m), _mm(i.left_m), *told, *size)
    console.print(table)
    console.print(_ENDINGS[result.ending], highlight=False)
    for t in result.trials:
        console.print(
            f"springs {100 * t.machine.stiffness:+.0f} %, force {100 * t.machine.force:+.0f} %: "
            f"{_mm(t.before.figures.rms_m)} mm rms before, "
            f"{_mm(t.after.figures.rms_m)} mm after; {100 * t.left:+.0f} % of the deviation is left",
            highlight=False,
        )
    for note in result.remarks:
        console.print(f"note: {note}", highlight=False, markup=False)
    console.print(
        f"In {folder}/: {', '.join(f.name for f in files)}, compensation.json, correction.csv, a run per iteration", highlight=False
    )


def _mm(value: float | None) -> str:
    return "-" if value is None else f"{1e3 * value:.3f}"
