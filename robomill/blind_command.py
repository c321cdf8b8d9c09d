"""`robomill blind make|run|score|withhold|page`: the withheld-effect benchmark on the command line; only here it meets the diagnosis."""

from __future__ import annotations

import json
from argparse import SUPPRESS, Namespace
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE
from rich.table import Table

from robomill.files import FILES

if TYPE_CHECKING:
    from robomill.diagnosis.catalogue import Catalogue

PAGE = Path("docs/benchmarks/blind.md")
SIMULATIONS = "simulations"
CATALOGUE = FILES / "scenarios" / "catalogue.toml"


def add_arguments(parser: Any) -> None:
    """The steps and their options."""
    steps = parser.add_subparsers(dest="step", required=True, metavar="STEP")
    make = steps.add_parser("make", help="simulate cases with withheld effects and seal the truth", description="Make a benchmark.")
    make.add_argument("folder", type=Path, metavar="DIR", help="folder for it")
    make.add_argument("--cases", type=int, default=240, help="how many (default: 240)")
    make.add_argument("--seed", type=int, default=1, help="same seed, same bits (default: 1)")
    make.add_argument("--tier", choices=("T0", "T1"), default="T1", help="T1: with a laser tracker on the tool tip (default); T0: without")
    make.add_argument("--jobs", type=int, help="processes (default: one per core)")
    run = steps.add_parser("run", help="diagnose every case that has no prediction yet", description="Diagnose the cases; may be repeated.")
    run.add_argument("folder", type=Path, metavar="DIR", help="folder of the benchmark")
    run.add_argument("--jobs", type=int, help="processes (default: one per core)")
    run.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers see DIR, such as tcp://host:8786")
    score = steps.add_parser("score", help="hash the predictions, unseal, score", description="Score the predictions.")
    score.add_argument("folder", type=Path, metavar="DIR", help="folder of the benchmark")
    score.add_argument("--no-isolability", action="store_true", help="take every detectable single as isolable; saves minutes")
    score.add_argument("--no-baselines", action="store_true", help="leave out the methods to compare with; saves minutes")
    withhold = steps.add_parser(
        "withhold",
        help="diagnose clear singles again, their effect taken out of the catalogue",
        description="Diagnose the detectable, isolable singles of a scored benchmark again, each without its effect in the catalogue.",
    )
    withhold.add_argument("folder", type=Path, metavar="DIR", help="folder of the scored benchmark")
    withhold.add_argument("--jobs", type=int, help="processes (default: one per core)")
    page = steps.add_parser("page", help="write the results of scored benchmarks as Markdown", description="Write the page of results.")
    page.add_argument("folders", type=Path, nargs="+", metavar="DIR", help="folders of scored benchmarks, in the order of the page")
    page.add_argument("--output", type=Path, default=PAGE, metavar="FILE", help=f"the page (default: {PAGE})")
    for step in (make, run, score, withhold, page):
        step.add_argument("--json", action="store_true", default=SUPPRESS, help="print the result as JSON and nothing else")


def diagnose_case(case: Path, out: Path, without: str | None = None) -> None:
    """Diagnose one case as anybody would: its system, its runs, the catalogue of the cell. Writes diagnosis.json.

    `without` (`component.parameter`): the effect with that parameter is not in the catalogue, at no place.

    Simulations of the nominal cell and of what may be wrong with it are the same in all cases of a condition: they are kept in
    `simulations` beside the cases, which may be deleted at any time.
    """
    from robomill.cell.binding import convert, resolve
    from robomill.cell.equipment import load_system
    from robomill.diagnose_command import menu, sources
    from robomill.diagnosis.catalogue import Catalogue
    from robomill.diagnosis.engine import diagnose
    from robomill.diagnosis.experiment.store import Store
    from robomill.orchestration.runs.run import Run

    runs = [Run.load(f) for f in sorted((case / "runs").iterdir()) if f.is_dir()]
    system = load_system(case / "system.toml")
    catalogue = lacking(Catalogue.load(CATALOGUE), without)
    with TemporaryDirectory() as folder:
        told = menu(system, Path(folder))
        store = Store(case.parent.parent / SIMULATIONS, sources(system))
        found = diagnose(system, runs, catalogue, resolver=resolve, convert=convert, menu=told, store=store)
    (out / "diagnosis.json").write_text(json.dumps(found.result, indent=1) + "\n", encoding="utf-8")


def lacking(catalogue: Catalogue, parameter: str | None) -> Catalogue:
    """The catalogue without what switches on `component.parameter`, at any place."""
    from robomill.orchestration.slaves.protocol import base_name

    known = [c for c in catalogue.candidates if parameter not in {f"{c.component}.{base_name(p)}" for p in c.named}]
    return replace(catalogue, candidates=tuple(known))


def blind(options: Namespace) -> int:
    """`robomill blind`: exit status 1 if a case could not be diagnosed."""
    from robomill.commands import _console
    from robomill.progress import progress_bar

    with progress_bar(options.json) as report:
        if options.step == "make":
            from robomill.blind.generate import make

            made = asdict(make(options.folder, options.cases, options.seed, options.tier, report, options.jobs))
            summary = {k: v for k, v in made.items() if k != "files"}
            text = f"{made['cases']} cases of tier {made['tier']} in {options.folder}/cases, truth sealed as {made['truth'][:12]}"
        elif options.step == "run":
            from robomill.blind.run import run_cases

            summary = run_cases(options.folder, diagnose_case, options.jobs, report, options.scheduler)
            text = f"{summary['done']} diagnosed, {summary['before']} were there, {len(summary['failed'])} failed, of {summary['cases']}"
            text += "".join(f"\ncase {name}: {error}" for name, error in sorted(summary["failed"].items()))
        elif options.step == "withhold":
            from robomill.blind.withhold import withhold

            summary = asdict(withhold(options.folder, diagnose_case, options.jobs, report))
            (options.folder / "withheld.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
            verdicts = ", ".join(f"{round(f['value'] * f['count'])} {v}" for v, f in summary["figures"].items() if f["value"])
            text = f"{len(summary['cases'])} diagnosed without their effect in the catalogue: {verdicts or 'none'}"
            text += "".join(f"\ncase {name}: {error}" for name, error in sorted(summary["failed"].items()))
        elif options.step == "page":
            summary, text = write_page(options.folders, options.output)
        else:
            from robomill.blind.score import score

            found = score(options.folder, isolability=not options.no_isolability, baselines=not options.no_baselines, progress=report)
            summary = asdict(found)
            (options.folder / "score.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
            text = ""
    if options.json:
        print(json.dumps(summary, indent=1))
    elif text:
        print(text)
    else:
        console = _console()
        for table in tables(summary):
            console.print(table)
        console.print(f"everything, effect by effect, is in {options.folder / 'score.json'}", highlight=False)
    return 1 if summary.get("failed") else 0


def write_page(folders: Sequence[Path], output: Path) -> tuple[dict[str, Any], str]:
    """Write the page of results; returns what was done and says it. BenchmarkError where a folder has not been scored."""
    from robomill.blind.page import page
    from robomill.blind.sealing import BenchmarkError

    for folder in folders:
        if not (folder / "score.json").is_file():
            raise BenchmarkError(f"{folder} has not been scored (no score.json); score it with: robomill blind score {folder}")
    scores = [json.loads((folder / "score.json").read_text(encoding="utf-8")) for folder in folders]
    for folder, score in zip(folders, scores, strict=True):
        if (folder / "withheld.json").is_file():
            score["withheld"] = json.loads((folder / "withheld.json").read_text(encoding="utf-8"))
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(page(scores, f"robomill blind page {' '.join(f.name for f in folders)}"), encoding="utf-8")
    return {"page": str(output), "benchmarks": len(scores)}, f"{len(scores)} benchmarks in {output}"


def tables(summary: dict[str, Any]) -> list[Table]:
    """The scores beside those of the baselines, and what was said for each true effect."""
    from robomill.blind.acceptance import bound, met

    baselines = summary["baselines"]
    first = Table(title=f"tier {summary['tier']}, {summary['cases']} cases, {summary['predictions']} predictions", box=SIMPLE)
    for heading in ("", "value", "95 %", "cases", "bound", *baselines):
        first.add_column(heading.replace("_", " "), justify="left" if heading == "" else "right", no_wrap=heading == "")
    for key, figure in summary["scores"].items():
        others = [_number(baselines[b].get(key)) for b in baselines]
        interval = figure["interval"]
        between = f"{interval[0]:.2f} .. {interval[1]:.2f}" if interval else ""
        asked, style = bound(key, summary["tier"]), "red" if met(key, figure["value"], summary["tier"]) is False else None
        first.add_row(key, _number(figure), between, str(figure["count"]), "" if asked is None else str(asked), *others, style=style)
    second = Table(title="single effects", box=SIMPLE)
    for heading in ("effect", "cases", "detectable", "isolable", "detected", "named", "in first 3", "said first"):
        second.add_column(heading, justify="left" if heading in ("effect", "said first") else "right")
    for key, row in summary["per_effect"].items():
        said = ", ".join(f"{name} {n}" for name, n in summary["confusion"].get(key, {}).items())
        second.add_row(key, *(str(v) for v in row.values()), said)
    return [first, second]


def _number(figure: dict[str, Any] | None) -> str:
    return "" if figure is None or figure["value"] is None else f"{figure['value']:.2f}"
