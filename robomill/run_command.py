"""`robomill run`: a scenario in its variants, a system once: run it, show the result, write the files. Options: `command_options.py`."""

from __future__ import annotations

import json
import sys
import tomllib
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.equipment import load_system
from robomill.cell.plausibility import unusual_values
from robomill.cell.scenario import Scenario, ScenarioError, load_scenario
from robomill.orchestration.assembly import assemble
from robomill.orchestration.assembly import run as run_once
from robomill.orchestration.errors import OrchestrationError, available
from robomill.orchestration.runs.lock import FolderLock
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.toml_text import parse
from robomill.progress import progress_bar
from robomill.tables import Heading, notes, say, show

if TYPE_CHECKING:  # what only some commands need, or the end of a run, is imported there: a run begins without it
    from robomill.cell.milled import Runs
    from robomill.cell.removal_rate import RateResult, RateScenario

RESULTS = Path("results")
VARIANT = Heading("variant", "left")


def run(options: Namespace) -> int:
    """`robomill run`: a scenario of any kind, a plain system file, or an SSP package."""
    if options.file.suffix == ".ssp":
        from robomill.orchestration.ssp.importing import open_ssp

        with open_ssp(options.file, options.step) as package:
            for text in package.ignored:
                print(f"{options.file.name}: ignored: {text}", file=sys.stderr)
            return _run_system(package.system, options, package.start)
    if not options.file.is_file():
        from robomill.example_command import examples

        name = options.file.with_suffix("").as_posix().removeprefix("scenarios/")
        if name in examples():
            raise FileNotFoundError(f"no scenario {options.file}; `robomill example {name}` copies it here")
        load_scenario(options.file)  # says what there is
    if options.file.suffix in (".ngc", ".nc", ".gcode", ".tap", ".cnc", ".gc"):
        raise ValueError(
            f"{options.file} is a program, expected a scenario: `robomill plan {options.file}` looks at the program; "
            "a scenario that names it mills it: `robomill example groove` copies one"
        )
    try:
        table = parse(options.file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        table = {"step": ""}  # the system loader names the line
    head = table.get("scenario")
    if head is None and not table.keys() & {"step", "connections"}:
        raise ValueError(
            f"{options.file} is neither a scenario (no table scenario) nor a system (no step, no connections); it has {available(table)}; "
            "name another file, or see what `robomill example` copies"
        )
    if head is None:
        return _run_system(load_system(options.file), options)
    kind = head.get("kind") if isinstance(head, dict) else None
    _only_systems_take(options, "step", "stop")
    if kind in _OTHER_KINDS:
        _only_cells_take(options, kind)
        return _OTHER_KINDS[kind](options)
    scenario = load_scenario(options.file)
    folder = options.out or RESULTS / scenario.name
    if scenario.kind != "milling":
        _only_cells_take(options, scenario.kind)
    folder.mkdir(parents=True, exist_ok=True)
    with FolderLock(folder):
        return _run_milling(scenario, folder, options) if scenario.kind == "milling" else _run_static(scenario, folder, options)


def _only_systems_take(options: Namespace, *names: str) -> None:
    """Refuse options that a scenario would silently ignore."""
    given = [f"--{n}" for n in names if getattr(options, n) is not None]
    if given:
        raise ValueError(
            f"{', '.join(given)} goes with system files and packages; a scenario takes its step and its end from its system and program"
        )


def _only_cells_take(options: Namespace, kind: str) -> None:
    """Refuse options that a scenario of another kind would silently ignore."""
    given = [
        f"--{n.replace('_', '-')}"
        for n in ("loop", "adopt", "resume", "checkpoint_every", "stl")
        if getattr(options, n) not in (None, False)
    ]
    if given:
        raise ValueError(
            f"{', '.join(given)}: only with milling scenarios, system files and packages; {options.file} is of the kind {kind}"
        )


def _run_experiment(options: Namespace) -> int:
    from robomill.cell import experiments

    experiment = experiments.load_experiment(options.file)
    folder = options.out or RESULTS / experiment.name
    found, warnings = experiments.remarks(experiment, options.variant)
    for text in warnings:
        print(f"warning: {text}", file=sys.stderr)
    with progress_bar(options.json) as report:
        folder.mkdir(parents=True, exist_ok=True)
        with FolderLock(folder):
            again = options.overwrite
            runs = experiments.run_experiment(experiment, folder, options.variant, options.fmus, options.csv, report, overwrite=again)
    said = {"notes": found, "warnings": warnings}
    summary = {"scenario": experiment.name, "kind": experiment.kind, "runs": [asdict(r) for r in runs], **said}
    _write(folder / "summary.json", summary)
    if options.json:
        print(json.dumps(summary, indent=1))
        return 0
    rows = []
    for r in runs:
        moved = "" if r.max_displacement_m is None else f"{1e3 * r.max_displacement_m:.3f}"
        force = "" if r.max_force_n is None else f"{r.max_force_n:.0f}"
        rows.append([r.condition, str(r.repeat), f"{r.duration_s:.1f}", moved, force])
    numbers = ("repeat", "duration\ns", "largest displacement\nmm", "largest force\nN")
    show(experiment.title, [Heading("condition", "left"), *map(Heading, numbers)], rows)
    notes(found, f"{folder}/summary.json")
    say(f"{len(runs)} runs are in {folder}/")
    return 0


def _run_learning(options: Namespace) -> int:
    from robomill.cell import path_learning

    scenario = path_learning.load_learning(options.file)
    folder = options.out or RESULTS / scenario.name
    folder.mkdir(parents=True, exist_ok=True)
    with progress_bar(options.json) as report, FolderLock(folder):
        summary, results = path_learning.run_learning(scenario, folder, options.variant, options.fmus, report, options.overwrite)
    _write(folder / "summary.json", summary)
    if not options.no_pictures:
        from robomill.cell import learning_pictures

        learning_pictures.draw_all(scenario, results, folder)
    if options.json:
        print(json.dumps(summary, indent=1))
        return 0
    rows = []
    for r in results:
        for n, p in enumerate(r.passes, 1):
            f, last = p.figures, n == len(r.passes)
            lengths = [f"{1e3 * f[k]:.3f}" for k in ("rms_m", "worst_m", "smoothed_rms_m", "smoothed_worst_m")]
            program = [str(r.figures["points"]), f"{1e3 * r.figures['program_worst_m']:.3f}"] if last else ["", ""]
            rows.append([r.variant.title, str(n), *lengths[:2], f"{100.0 * f['no_contact']:.0f}", *lengths[2:], *program])
    numbers = ("pass", "rms\nmm", "worst\nmm", "no contact\n%", "with F/k, rms\nmm", "worst\nmm", "program\npoints", "worst\nmm")
    show(scenario.title, [VARIANT, *map(Heading, numbers)], rows)
    say(f"In {folder}/: per variant a run per pass, path.mod (RAPID), path.ngc (G-code, unless the tool turns), learnt.png")
    return 0


def _run_milling(scenario: Scenario, folder: Path, options: Namespace) -> int:
    from robomill.cell import milled

    complete: list[milled.Runs] = []
    try:
        with progress_bar(options.json) as report:
            runs = milled.mill_variants(
                scenario,
                folder,
                options.variant,
                changed=lambda system: _adopted(_looped(system, options), options),
                fmus=options.fmus,
                csv=options.csv,
                stl=options.stl,
                checkpoint_every=options.checkpoint_every,
                resume=options.resume,
                overwrite=options.overwrite,
                progress=report,
                warn=lambda text: print(f"warning: {text}", file=sys.stderr),
                done=complete.append,
            )
    except (OrchestrationError, KeyboardInterrupt):
        if complete and not options.json:
            _show_milled(complete[-1])
            say("These variants are complete; go on with --resume.")
        raise
    files = []
    if not options.no_pictures:
        with progress_bar(options.json) as report:
            files = runs.pictures(report)
    if options.json:
        print((folder / milled.SUMMARY).read_text(encoding="utf-8"), end="")
        return 0
    _show_milled(runs)
    if scenario.scan:
        from robomill.cell import scan

        say(*(f"{r.title}: {scan.text(r, scenario.paper.get(r.name, {}))}" for r in runs.results))
    notes(runs.notes, f"{folder / milled.SUMMARY}")
    pictures_note = f" and {len(files)} pictures (start with {files[0].name})" if files else ""
    say(f"In {folder}/: a recording per variant, {milled.SUMMARY}{pictures_note}")
    return 0


def _show_milled(runs: Runs) -> None:
    """Our figures, and beside them those of the paper where it has them; where the largest deviation is, in short."""
    from robomill.cell import milled

    headings = [VARIANT, *(Heading(f"{c.title}\n{c.unit}") for c in milled.COLUMNS), Heading("largest at", "left", folds=True)]
    rows = [[*row, (r.figures.max_deviation_location or "").partition(":")[0]] for row, r in zip(runs.rows(), runs.results, strict=True)]
    show(f"{runs.scenario.title}\nin brackets: published" if runs.scenario.paper else runs.scenario.title, headings, rows)
    for r in runs.results:
        if r.figures.max_deviation_m is None:
            say(f"{r.title}: {r.figures.note}")
        elif r.figures.max_deviation_limited:
            size = f">= {1e3 * r.figures.max_deviation_m:.2f} mm (limit of the measure)"
            say(f"{r.title}: {size}: somewhere a thin wall or the rim of the block is gone, and nothing is left there to measure to")


def _run_static(scenario: Scenario, folder: Path, options: Namespace) -> int:
    if (folder / "summary.json").exists() and not options.overwrite:
        raise ScenarioError(
            f"{folder} already holds results (summary.json); choose another folder (--out), or allow overwriting (--overwrite)"
        )
    from robomill.cell import static_loads

    found = static_loads.run_static_loads(scenario, options.fmus)
    written = {name: asdict(one) for name, one in found.items()}
    summary = {**next(iter(written.values())), "scenario": scenario.name, "variants": written}  # at its top the first variant
    magnitudes = {name: one.magnitudes for name, one in found.items()}
    _write(folder / "summary.json", summary)
    published = {name: figures["mean_displacement_m"] for name, figures in scenario.paper.items() if "mean_displacement_m" in figures}
    titles = {v.name: v.title for v in scenario.variants}
    if not options.no_pictures:
        from robomill.cell import pictures

        pictures.load_cases(magnitudes, titles, published).savefig(folder / "load_cases.png", dpi=130)
    if options.json:
        print(json.dumps(summary, indent=1))
        return 0
    rows = []
    for name, size in magnitudes.items():
        mean = f"{1e3 * size.mean():.2f}" + (f" ({1e3 * published[name]:.2f})" if name in published else "")
        rows.append([titles[name], mean, f"{1e3 * size.max():.2f}", f"{1e3 * size.min():.2f}"])
    numbers = ("mean displacement\nmm", "largest\nmm", "smallest\nmm")
    show(f"{scenario.title}\nin brackets: published", [VARIANT, *map(Heading, numbers)], rows)
    say(f"summary.json and the picture are in {folder}/")
    return 0


def _run_removal_rate(options: Namespace) -> int:
    from robomill.cell import removal_rate

    scenario = removal_rate.load_removal_rate(options.file)
    if options.variant:
        unknown = sorted(set(options.variant) - {v.name for v in scenario.variants})
        if unknown:
            known = ", ".join(v.name for v in scenario.variants)
            raise ScenarioError(f"{scenario.file}: no variant {', '.join(unknown)}; variants: {known}")
        scenario = replace(scenario, variants=tuple(v for v in scenario.variants if v.name in options.variant))
    folder = options.out or RESULTS / scenario.name
    folder.mkdir(parents=True, exist_ok=True)
    with progress_bar(options.json) as report, FolderLock(folder):
        results = removal_rate.run_removal_rate(scenario, folder, options.fmus, options.csv, report, options.overwrite)
    summary = removal_rate.summary(scenario, results)
    _write(folder / "summary.json", summary)
    files: list[Path] = []
    if not options.no_pictures:
        from robomill.cell import rate_pictures

        files = rate_pictures.draw_all(scenario, results, folder)
    if options.json:
        print(json.dumps(summary, indent=1))
        return 0
    _show_rates(scenario, results)
    for r in results:
        say(*(f"{r.variant.title}: {text}" for text in r.remarks))
    say(f"In {folder}/: a recording per variant, summary.json and {len(files)} pictures")
    return 0


def _show_rates(scenario: RateScenario, results: Sequence[RateResult]) -> None:
    """Time, peak and each section of all variants, and beside them what the paper has."""
    columns = [("duration_s", "time\ns", "{:.2f}"), ("saved_percent", "saved\n%", "{:z.0f}"), ("peak_force_n", "peak\nN", "{:.0f}")]
    for section in scenario.sections:
        columns.append((f"force_{section.name}_n", f"{section.name}\nmean N", "{:.0f}"))
        columns.append((f"std_{section.name}_n", "std\nN", "{:.1f}"))
        columns.append((f"line_{section.name}_hz", "line\nHz", "{:.0f}"))
    columns = [c for c in columns if c[0] in results[0].figures]
    rows = []
    for r in results:
        published = scenario.paper.get(r.variant.name, {})
        cells = [
            form.format(r.figures[key]) + (f" ({form.format(published[key])})" if key in published else "") for key, _, form in columns
        ]
        rows.append([r.variant.title, *cells])
    show(f"{scenario.title}\nin brackets: published", [VARIANT, *(Heading(text) for _, text, _ in columns)], rows)


def _looped(system: System, options: Namespace) -> System:
    """With the loop of `--loop`."""
    return system if options.loop is None else replace(system, loop=options.loop)


def _adopted(system: System, options: Namespace) -> System:
    """With the parameter set of `--adopt`; its values replace those of the system."""
    if options.adopt is None:
        return system
    from robomill.diagnosis.outcome import adopt

    return adopt.adopted(system, options.adopt)


def _run_system(system: System, options: Namespace, start: float = 0.0) -> int:
    if options.variant:
        raise ValueError("--variant goes with scenarios; a system file or package is one run")
    if options.step is not None:
        system = replace(system, step=options.step)
    system = _adopted(_looped(system, options), options)
    if options.fmus is not None:
        system = with_fmus(system, options.fmus)
    if options.csv:
        system = replace(system, recording=replace(system.recording, csv=True))
    if options.checkpoint_every is not None:
        system = replace(system, recording=replace(system.recording, checkpoint_every=options.checkpoint_every))
    folder = options.out or RESULTS / system.name
    with assemble(system, resolve, convert) as assembly:
        for text in (*assembly.wiring.warnings, *unusual_values(assembly)):
            print(f"warning: {text}", file=sys.stderr)
    with progress_bar(options.json) as report:
        result = run_once(
            system,
            folder,
            stop=options.stop,
            start=start,
            resolver=resolve,
            convert=convert,
            progress=lambda done, total: report(system.name, done, total),
            overwrite=options.overwrite,
            resume=options.resume,
        )
    rows, end, columns = len(result), float(result.t[-1]), list(result.columns)
    if options.json:
        print(json.dumps({"system": system.name, "folder": str(folder), "rows": rows, "end_s": end, "columns": columns}))
    else:
        print(f"{system.name}: {rows} rows up to t = {end:.6g} s, {len(columns)} signals, in {folder}/")
    return 0


def _write(file: Path, content: Any) -> None:
    file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


_OTHER_KINDS: dict[str, Callable[[Namespace], int]] = {
    "experiment": _run_experiment,
    "removal_rate": _run_removal_rate,
    "path_learning": _run_learning,
}
"""Scenarios that are neither milled nor loaded: kind and who runs them."""
