"""`robomill blind make|run|score|page`: the withheld-effect benchmark on the command line; only here it meets the diagnosis."""

from __future__ import annotations

import json
import tomllib
from argparse import SUPPRESS, Namespace
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE
from rich.table import Table

from robomill.files import FILES, vacant
from robomill.option_types import add_overwrite

if TYPE_CHECKING:
    from robomill.diagnosis.catalogue import Catalogue

PAGE = Path("docs/benchmarks/blind.md")
REASONS = "reasons.toml"
"""Beside the page: why bounds are missed."""
SIMULATIONS = "simulations"
CATALOGUE = FILES / "scenarios" / "catalogue.toml"


def add_arguments(parser: Any) -> None:
    """The steps and their options."""
    steps = parser.add_subparsers(dest="step", required=True, metavar="STEP")
    make = steps.add_parser(
        "make",
        help="simulate cases with withheld effects and seal the truth",
        description="Simulate cases with withheld effects and seal the truth.",
        epilog="Example: robomill blind make results/blind --cases 24",
    )
    make.add_argument("folder", type=Path, metavar="DIR", help="folder for the benchmark")
    make.add_argument(
        "--set",
        default="mixed",
        help="kind of cases: withheld, null, single, machine, few, campaign, bad_log, outside, formed or mixed (default: mixed)",
    )
    make.add_argument("--cases", type=int, default=240, help="number of cases (default: 240)")
    make.add_argument("--seed", type=int, default=1, help="of all random numbers; the same seed gives the same bits (default: 1)")
    make.add_argument(
        "--tier", choices=("T0", "T1"), default="T1", help="T1: with a laser tracker on the tool tip; T0: without (default: T1)"
    )
    make.add_argument("--generator", default="first", help="first, second, or both: each for every second case (default: first)")
    make.add_argument("--jobs", type=int, help="processes (default: one per core)")
    run = steps.add_parser(
        "run",
        help="diagnose every case that has no prediction yet",
        description="Diagnose every case that has no prediction yet; an interrupted run goes on.",
        epilog="Example: robomill blind run results/blind",
    )
    run.add_argument("folder", type=Path, metavar="DIR", help="folder of the benchmark")
    run.add_argument("--jobs", type=int, help="processes (default: one per core)")
    run.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers see DIR, such as tcp://host:8786")
    score = steps.add_parser(
        "score",
        help="hash the predictions, unseal, score",
        description="Hash the predictions, unseal the truth, and score the predictions by it.",
        epilog="Example: robomill blind score results/blind",
    )
    score.add_argument("folder", type=Path, metavar="DIR", help="folder of the benchmark")
    score.add_argument("--jobs", type=int, help="processes for the signatures (default: one per core)")
    score.add_argument("--no-isolability", action="store_true", help="take every detectable single as isolable; saves minutes")
    score.add_argument("--no-baselines", action="store_true", help="leave out the methods to compare with; saves minutes")
    page = steps.add_parser(
        "page",
        help="write the results of scored benchmarks as Markdown",
        description="Write the results of scored benchmarks as a Markdown page.",
        epilog="Example: robomill blind page results/blind --output results/blind.md",
    )
    page.add_argument("folders", type=Path, nargs="+", metavar="DIR", help="folders of scored benchmarks")
    page.add_argument("--output", type=Path, default=PAGE, metavar="FILE", help=f"the page (default: {PAGE}); {REASONS} beside it")
    add_overwrite(score, "score.json")
    add_overwrite(page, "the page")
    for step in (make, run, score, page):
        step.add_argument("--json", action="store_true", default=SUPPRESS, help="print the result as JSON and nothing else")


def diagnose_case(case: Path, out: Path) -> None:
    """Diagnose one case as anybody would: its systems, its runs, its calibration, the catalogue of the cell. Writes diagnosis.json.

    Effects in the case's withheld.toml are taken out of the catalogue. Simulations of the nominal cell and of what may be wrong with it
    are the same in all cases that were measured in the same way: they are kept in `simulations` beside the cases, which may be deleted
    at any time. Data that are refused are a stop: the verdict is `bad_log`, with the error as `refused`.
    """
    from robomill.blind.make import CALIBRATION
    from robomill.cell.binding import convert, resolve
    from robomill.cell.equipment import load_system
    from robomill.diagnose_command import menu, sources
    from robomill.diagnosis.catalogue import Catalogue
    from robomill.diagnosis.engine import diagnose_campaign
    from robomill.diagnosis.experiment.campaign import Campaign, load_campaign
    from robomill.diagnosis.experiment.measured import DataError
    from robomill.diagnosis.experiment.store import Store
    from robomill.freed_memory import give_back
    from robomill.orchestration.runs.run import Run

    give_back()
    if (case / "campaign.toml").is_file():
        campaign = load_campaign(case / "campaign.toml", load_system)
    else:
        runs = [Run.load(f) for f in sorted((case / "runs").iterdir()) if f.is_dir()]
        campaign = Campaign.of(load_system(case / "system.toml"), runs)
    catalogue = lacking(Catalogue.load(CATALOGUE).calibrated(case / CALIBRATION.name), withheld(case))
    with TemporaryDirectory() as folder:
        told = menu(campaign.system, Path(folder))
        store = Store(case.parent.parent / SIMULATIONS, sources(*{p.system.name: p.system for p in campaign.parts}.values()))
        try:
            result = diagnose_campaign(campaign, catalogue, resolver=resolve, convert=convert, menu=told, store=store).result
        except DataError as error:
            result = {"verdict": "bad_log", "refused": str(error)}
    (out / "diagnosis.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def withheld(case: Path) -> list[str]:
    """Effects (`component.parameter`) that are taken out of the catalogue for a case."""
    file = case / "withheld.toml"
    return [str(e) for e in tomllib.loads(file.read_text(encoding="utf-8"))["effects"]] if file.is_file() else []


def lacking(catalogue: Catalogue, parameters: Sequence[str]) -> Catalogue:
    """The catalogue without what switches on one of the parameters (`component.parameter`), at any place."""
    from robomill.orchestration.slaves.protocol import base_name

    known = [c for c in catalogue.candidates if not any(f"{c.component}.{base_name(p)}" in parameters for p in c.named)]
    return replace(catalogue, candidates=tuple(known))


def blind(options: Namespace) -> int:
    """`robomill blind`: exit status 1 if a case could not be diagnosed."""
    from robomill.progress import progress_bar
    from robomill.tables import console, say

    with progress_bar(options.json) as report:
        if options.step == "make":
            from robomill.blind.make import Request, make

            request = Request(options.cases, options.seed, options.tier, options.set, options.generator)
            made = asdict(make(options.folder, request, report, options.jobs))
            summary = {k: v for k, v in made.items() if k != "files"}
            text = f"{made['cases']} cases of the set {made['set']}, tier {made['tier']} in {options.folder}/cases, "
            text += f"truth sealed as {made['truth'][:12]}"
        elif options.step == "run":
            from robomill.blind.run import run_cases

            summary = run_cases(options.folder, diagnose_case, options.jobs, report, options.scheduler)
            text = f"{summary['done']} diagnosed, {summary['before']} were there, {len(summary['failed'])} failed, of {summary['cases']}"
            text += "".join(f"\ncase {name}: {error}" for name, error in sorted(summary["failed"].items()))
        elif options.step == "page":
            if not options.overwrite:
                vacant(options.output, option="--output")
            summary, text = write_page(options.folders, options.output)
        else:
            from robomill.blind.score import score

            if not options.overwrite:
                vacant(options.folder / "score.json", option="another DIR")
            found = score(
                options.folder,
                isolability=not options.no_isolability,
                baselines=not options.no_baselines,
                workers=options.jobs,
                progress=report,
            )
            summary = asdict(found)
            (options.folder / "score.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
            text = ""
    if options.json:
        print(json.dumps(summary, indent=1))
    elif text:
        print(text)
    else:
        screen = console()
        for table in tables(summary):
            screen.print(table)
        say(f"everything, effect by effect, is in {options.folder / 'score.json'}")
    return 1 if summary.get("failed") else 0


def write_page(folders: Sequence[Path], output: Path) -> tuple[dict[str, Any], str]:
    """Write the page of results; returns what was done and says it. BenchmarkError where a folder has not been scored."""
    from robomill.blind.page import page, read_reasons
    from robomill.blind.sealing import BenchmarkError

    for folder in folders:
        if not (folder / "score.json").is_file():
            raise BenchmarkError(f"{folder} has not been scored (no score.json); score it with: robomill blind score {folder}")
    scores = [json.loads((folder / "score.json").read_text(encoding="utf-8")) for folder in folders]
    text = page(scores, f"robomill blind page {' '.join(f.name for f in folders)}", read_reasons(output.parent / REASONS))
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(text, encoding="utf-8")
    return {"page": str(output), "benchmarks": len(scores)}, f"{len(scores)} benchmarks in {output}"


def tables(summary: dict[str, Any]) -> list[Table]:
    """The figures that have cases, by generator and beside the baselines, and what was said for each true effect."""
    from robomill.blind.acceptance import ASKED, bound, met
    from robomill.blind.results import ALL

    scores, baselines, tier = summary["scores"], summary["baselines"], summary["tier"]
    makers = [name for name in scores if name != ALL]
    title = f"set {summary['set']}, tier {tier}, {summary['cases']} cases, {summary['predictions']} predictions"
    first = Table(title=title, box=SIMPLE)
    for heading in ("", "value", "95 %", "cases", "bound", *makers, *baselines):
        first.add_column(heading.replace("_", " "), justify="left" if heading == "" else "right", no_wrap=heading == "")
    for key, figure in scores[ALL].items():
        asked = key in ASKED[summary["set"]]
        if not figure["count"] and not asked:
            continue
        others = [_number(table.get(key)) for table in (*(scores[m] for m in makers), *baselines.values())]
        interval = figure["interval"]
        between = f"{interval[0]:.2f} .. {interval[1]:.2f}" if interval else ""
        limit, style = str(bound(key, tier)) if asked else "", "red" if asked and met(key, figure["value"], tier) is False else None
        first.add_row(key, _number(figure), between, str(figure["count"]), limit, *others, style=style)
    second = Table(title="effects", box=SIMPLE)
    for heading in ("effect", "cases", "detectable", "isolable", "detected", "named", "in first 3", "said first"):
        second.add_column(heading, justify="left" if heading in ("effect", "said first") else "right")
    for key, row in summary["per_effect"].items():
        counted = summary["confusion"].get(key) or summary["confusion"].get(f"withheld: {key}", {})
        said = ", ".join(f"{name} {n}" for name, n in counted.items())
        second.add_row(key, *(str(v) for v in row.values()), said)
    return [first, second] if summary["per_effect"] else [first]


def _number(figure: dict[str, Any] | None) -> str:
    return "" if figure is None or figure["value"] is None else f"{figure['value']:.2f}"
