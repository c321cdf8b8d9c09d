"""What the commands do: call the package, show the result, write the files. `robomill/cli.py` has their options."""

from __future__ import annotations

import json
import sys
import tomllib
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from robomill import conformance
from robomill.cell import experiments, milling, part, path_learning, removal_rate, scan, static_loads
from robomill.cell import package as ssp
from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.equipment import load_system
from robomill.cell.evaluation import Figures, Result, evaluate
from robomill.cell.plausibility import unusual_values
from robomill.cell.scenario import Scenario, ScenarioError, load_scenario
from robomill.diagnosis.outcome import adopt
from robomill.example_command import examples
from robomill.fmus.components import COMPONENTS, component
from robomill.fmus.provenance import release
from robomill.fmus.python.builder import build as build_python
from robomill.fmus.reference import reference_files
from robomill.fmus.signed import private_key, write_signed
from robomill.models.components.recording import replay_model
from robomill.models.metrology.stl import write_stl
from robomill.models.model.declaration import Model
from robomill.orchestration.assembly import assemble
from robomill.orchestration.assembly import run as run_once
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.runs.lock import FolderLock
from robomill.orchestration.runs.run import Run, check_vacant
from robomill.orchestration.ssp.importing import open_ssp
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.toml_text import parse
from robomill.progress import progress_bar

DEFAULT_FMI = 2
"""Version of FMI that is built where none is asked for; Python FMUs know no other."""
RESULTS = Path("results")
_SHOWN = (
    ("max_deviation_m", "max deviation", 1e3, "mm", "{:.2f}"),
    ("rms_deviation_m", "rms", 1e3, "mm", "{:.2f}"),
    ("p95_deviation_m", "95 %", 1e3, "mm", "{:.2f}"),
    ("peak_force_n", "peak force", 1.0, "N", "{:.0f}"),
    ("reaction_t50_s", "reaction", 1e3, "ms", "{:.0f}"),
    ("real_time_factor", "speed", 1.0, "x real", "{:.0f}"),
)


def run(options: Namespace) -> int:
    """`robomill run`: a scenario of any kind, a plain system file, or an SSP package."""
    if options.file.suffix == ".ssp":
        with open_ssp(options.file, options.step) as package:
            for text in package.ignored:
                print(f"{options.file.name}: ignored: {text}", file=sys.stderr)
            return _run_system(package.system, options, package.start)
    if not options.file.is_file():
        name = options.file.with_suffix("").as_posix().removeprefix("scenarios/")
        if name in examples():
            raise FileNotFoundError(f"no scenario {options.file}; `robomill example {name}` copies it here")
        load_scenario(options.file)  # says what there is
    if options.file.suffix in (".ngc", ".nc", ".gcode", ".tap", ".cnc", ".gc"):
        raise ValueError(
            f"{options.file} is a program: `robomill plan` looks at it, a scenario that names it (scenarios/groove.toml) mills it"
        )
    try:
        is_scenario = "scenario" in parse(options.file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        is_scenario = False  # the system loader names the line
    if not is_scenario:
        return _run_system(load_system(options.file), options)
    if experiments.is_experiment(options.file):
        _only_cells_take(options, "experiment")
        return _run_experiment(options)
    if removal_rate.is_removal_rate(options.file):
        _only_cells_take(options, removal_rate.KIND)
        return _run_removal_rate(options)
    if path_learning.is_learning(options.file):
        _only_cells_take(options, path_learning.KIND)
        return _run_learning(options)
    _only_systems_take(options, "step", "stop")
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


def _chosen(scenario: Scenario, names: Sequence[str] | None) -> Scenario:
    if not names:
        return scenario
    known = {v.name: v for v in scenario.variants}
    unknown = [n for n in names if n not in known]
    if unknown:
        raise ScenarioError(f"{scenario.file}: no variant {', '.join(unknown)}; variants: {', '.join(known)}")
    return replace(scenario, variants=tuple(known[n] for n in names))


def _run_experiment(options: Namespace) -> int:
    experiment = experiments.load_experiment(options.file)
    folder = options.out or RESULTS / experiment.name
    notes, warnings = experiments.remarks(experiment, options.variant)
    for text in warnings:
        print(f"warning: {text}", file=sys.stderr)
    with progress_bar(options.json) as report:
        folder.mkdir(parents=True, exist_ok=True)
        with FolderLock(folder):
            again = options.overwrite
            runs = experiments.run_experiment(experiment, folder, options.variant, options.fmus, options.csv, report, overwrite=again)
    said = {"notes": notes, "warnings": warnings}
    summary = {"scenario": experiment.name, "kind": experiment.kind, "runs": [asdict(r) for r in runs], **said}
    _write(folder / "summary.json", summary)
    if options.json:
        print(json.dumps(summary, indent=1))
        return 0
    table = Table(title=experiment.title, title_justify="left", box=SIMPLE)
    for heading in ("condition", "repeat", "duration\ns", "largest displacement\nmm", "largest force\nN"):
        table.add_column(heading, justify="left" if heading == "condition" else "right")
    for r in runs:
        moved = "" if r.max_displacement_m is None else f"{1e3 * r.max_displacement_m:.3f}"
        force = "" if r.max_force_n is None else f"{r.max_force_n:.0f}"
        table.add_row(r.condition, str(r.repeat), f"{r.duration_s:.1f}", moved, force)
    console = _console()
    console.print(table)
    for text in notes:
        console.print(f"note: {text}", highlight=False, markup=False)
    console.print(f"{len(runs)} runs are in {folder}/", highlight=False)
    return 0


def _run_learning(options: Namespace) -> int:
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
    table = Table(title=scenario.title, title_justify="left", box=SIMPLE)
    for heading in (
        "variant",
        "pass",
        "rms\nmm",
        "worst\nmm",
        "no contact\n%",
        "with F/k, rms\nmm",
        "worst\nmm",
        "program\npoints",
        "worst\nmm",
    ):
        table.add_column(heading, justify="left" if heading == "variant" else "right")
    for r in results:
        for n, p in enumerate(r.passes, 1):
            f, last = p.figures, n == len(r.passes)
            lengths = [f"{1e3 * f[k]:.3f}" for k in ("rms_m", "worst_m", "smoothed_rms_m", "smoothed_worst_m")]
            program = [str(r.figures["points"]), f"{1e3 * r.figures['program_worst_m']:.3f}"] if last else ["", ""]
            table.add_row(r.variant.title if n == 1 else "", str(n), *lengths[:2], f"{100.0 * f['no_contact']:.0f}", *lengths[2:], *program)
    console = _console()
    console.print(table)
    console.print(
        f"In {folder}/: per variant a run per pass, path.mod (RAPID), path.ngc (G-code, unless the tool turns), learnt.png", highlight=False
    )
    return 0


def _run_milling(scenario: Scenario, folder: Path, options: Namespace) -> int:
    assert scenario.workpiece is not None  # load_scenario checks it for this kind
    wanted = _chosen(scenario, options.variant)
    chosen = wanted.variants
    if not (options.overwrite or options.resume):
        check_vacant(folder / v.name for v in chosen)
    results: list[Result] = []
    try:
        with progress_bar(options.json) as report:
            again = {"resume": options.resume, "overwrite": options.overwrite}
            job = milling.lay_out(wanted, folder, options.fmus, **again, checkpoint_every=options.checkpoint_every)
            if options.stl:
                part.require(job.system)
            unusual = milling.check_variants(replace(job, system=_adopted(_looped(job.system, options), options)), chosen)
            job = replace(job, warnings=(*job.warnings, *unusual))
            for text in job.warnings:
                print(f"warning: {text}", file=sys.stderr)
            job = milling.with_pilot(job, report)
            job = replace(job, system=_adopted(_looped(job.system, options), options))  # the plan and its offline force stay nominal
            for variant in chosen:
                recorded, factor = milling.mill(job, variant, report, csv=options.csv)
                result = evaluate(variant.name, variant.title, recorded, scenario.workpiece, factor)
                results.append(scan.scanned(scenario, result) if scenario.scan else result)
                if options.stl:
                    write_stl(folder / variant.name / "part.stl", part.cut_part(recorded, scenario.workpiece).surface())
                summary = _write_summary(scenario, folder, results, job)
    except (OrchestrationError, KeyboardInterrupt):
        if results and not options.json:
            _console().print(_table(scenario, results), "These variants are complete; go on with --resume.", highlight=False)
        raise
    files: list[Path] = []
    if not options.no_pictures:
        from robomill.cell import pictures  # matplotlib takes a second to load

        files = pictures.draw_all(scenario, results, folder)
        if scenario.scan:
            files += scan.draw(scenario, results, folder)
    if options.json:
        print(json.dumps(summary, indent=1))
        return 0
    console = _console()
    console.print(_table(scenario, results))
    for result in results:
        console.print(f"{result.title}: {_largest(result.figures)}", highlight=False)
        if scenario.scan:
            console.print(f"  {scan.text(result, scenario.paper.get(result.name, {}))}", highlight=False)
    for text in job.notes:
        console.print(f"note: {text}", highlight=False, markup=False)
    pictures_note = f" and {len(files)} pictures (start with {files[0].name})" if files else ""
    console.print(f"In {folder}/: a recording per variant, summary.json{pictures_note}", highlight=False)
    return 0


def _write_summary(scenario: Scenario, folder: Path, results: Sequence[Result], job: milling.Job) -> dict[str, Any]:
    """Write summary.json: the results so far, and what it already held of other variants of this scenario."""
    file = folder / "summary.json"
    try:
        old = json.loads(file.read_text(encoding="utf-8"))["variants"]
    except (OSError, ValueError, KeyError, TypeError):
        old = {}
    figures = {**old, **{r.name: asdict(r.figures) for r in results}}
    said = {"notes": list(job.notes), "warnings": list(job.warnings)}
    summary = {"scenario": scenario.name, **said, "variants": {v.name: figures[v.name] for v in scenario.variants if v.name in figures}}
    _write(file, summary)
    return summary


def _table(scenario: Scenario, results: Sequence[Result]) -> Table:
    """Our figures, and beside them those of the paper where it has them."""
    table = Table(title=f"{scenario.title}\nin brackets: published", title_justify="left", box=SIMPLE)
    table.add_column("variant", no_wrap=True)
    for _, title, _, unit, _ in _SHOWN:
        table.add_column(f"{title}\n{unit}", justify="right")
    for r in results:
        cells = []
        for key, _, factor, _, form in _SHOWN:
            ours, published = getattr(r.figures, key), scenario.paper.get(r.name, {}).get(key)
            text = "-" if ours is None else form.format(factor * ours)
            if key == "max_deviation_m" and r.figures.max_deviation_limited:
                text = f">= {text}"
            cells.append(text if published is None else f"{text} ({form.format(factor * published)})")
        table.add_row(r.title, *cells)
    return table


def _largest(figures: Figures) -> str:
    """Where the largest deviation is, whether it may be more, or why there is none."""
    if figures.max_deviation_m is None:
        return str(figures.note)
    text = f"largest deviation: {figures.max_deviation_location}"
    if figures.max_deviation_limited:
        size = f">= {1e3 * figures.max_deviation_m:.2f} mm (limit of the measure)"
        text += f"; {size}: somewhere a thin wall or the rim of the block is gone, and nothing is left there to measure to"
    return text


def _run_static(scenario: Scenario, folder: Path, options: Namespace) -> int:
    if (folder / "summary.json").exists() and not options.overwrite:
        raise ScenarioError(
            f"{folder} already holds results (summary.json); choose another folder (--out), or allow overwriting (--overwrite)"
        )
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
    table = Table(title=f"{scenario.title}\nin brackets: published", title_justify="left")
    for heading in ("variant", "mean displacement\nmm", "largest\nmm", "smallest\nmm"):
        table.add_column(heading, justify="left" if heading == "variant" else "right")
    for name, size in magnitudes.items():
        mean = f"{1e3 * size.mean():.2f}" + (f" ({1e3 * published[name]:.2f})" if name in published else "")
        table.add_row(titles[name], mean, f"{1e3 * size.max():.2f}", f"{1e3 * size.min():.2f}")
    console = _console()
    console.print(table)
    console.print(f"summary.json and the picture are in {folder}/", highlight=False)
    return 0


def _run_removal_rate(options: Namespace) -> int:
    _only_systems_take(options, "step", "stop")
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
    console = _console()
    console.print(_rate_table(scenario, results))
    for r in results:
        for text in r.remarks:
            console.print(f"{r.variant.title}: {text}", highlight=False, markup=False)
    console.print(f"In {folder}/: a recording per variant, summary.json and {len(files)} pictures", highlight=False)
    return 0


def _rate_table(scenario: removal_rate.RateScenario, results: Sequence[removal_rate.RateResult]) -> Table:
    """Time, peak and each section of all variants, and beside them what the paper has."""
    table = Table(title=f"{scenario.title}\nin brackets: published", title_justify="left", box=SIMPLE)
    columns = [("duration_s", "time\ns", "{:.2f}"), ("saved_percent", "saved\n%", "{:z.0f}"), ("peak_force_n", "peak\nN", "{:.0f}")]
    for section in scenario.sections:
        columns.append((f"force_{section.name}_n", f"{section.name}\nmean N", "{:.0f}"))
        columns.append((f"std_{section.name}_n", "std\nN", "{:.1f}"))
        columns.append((f"line_{section.name}_hz", "line\nHz", "{:.0f}"))
    columns = [c for c in columns if c[0] in results[0].figures]
    table.add_column("variant")
    for _, heading, _ in columns:
        table.add_column(heading, justify="right")
    for r in results:
        published = scenario.paper.get(r.variant.name, {})
        cells = [
            form.format(r.figures[key]) + (f" ({form.format(published[key])})" if key in published else "") for key, _, form in columns
        ]
        table.add_row(r.variant.title, *cells)
    return table


def _looped(system: System, options: Namespace) -> System:
    """With the loop of `--loop`."""
    return system if options.loop is None else replace(system, loop=options.loop)


def _adopted(system: System, options: Namespace) -> System:
    """With the parameter set of `--adopt`; its values replace those of the system."""
    return system if options.adopt is None else adopt.adopted(system, options.adopt)


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


def build(options: Namespace) -> int:
    """`robomill build`: FMUs of all or some components, a replay FMU of one of them, or whole systems as SSP packages."""
    key = None if options.sign is None else private_key(options.sign)
    packages: list[System] = []
    if options.ssp is not None:
        packages = ssp.systems(options.ssp, options.out / "tables" / options.ssp.stem, options.variant)
    names = options.component or (ssp.used(packages) if packages else list(COMPONENTS))
    models = [component(name) for name in names]
    if options.replay is not None:
        if len(names) != 1 or not options.component:
            raise ValueError("--replay needs exactly one --component: the one that the recording stands in for")
        models = [_replay_model(Run.load(options.replay), names[0], options.recorded_as or names[0])]
    options.out.mkdir(parents=True, exist_ok=True)
    with progress_bar(options.json) as report:
        files = _build(models, options, report)
        written = ssp.write(packages, options.out, options.out, report)
    signed: list[Path] = []
    if key is not None:
        signed = [options.out / f"robomill-{release()}.zip"]
        write_signed(signed[0], {f.relative_to(options.out).as_posix(): f.read_bytes() for f in (*files, *written)}, key)
    if options.json:
        told = {"fmus": files, "packages": written, **({"archive": signed} if signed else {})}
        print(json.dumps({what: [str(f) for f in found] for what, found in told.items()}))
    else:
        for f in (*files, *written, *signed):
            print(f"{f}  {f.stat().st_size / 1024:.0f} kB")
    return 0


def _build(models: Sequence[Model], options: Namespace, report: milling.Progress) -> list[Path]:
    """FMUs of all models with the backend and for the FMI versions that were asked for."""
    versions = sorted(set(options.fmi or [DEFAULT_FMI]))
    report("build", 0, len(models) * len(versions))
    files: list[Path] = []

    def done(file: Path) -> None:
        files.append(file)
        report("build", len(files), len(models) * len(versions))

    if options.backend == "native":
        from robomill.fmus.native.builder import build_all  # needs LLVM: a second to load

        built: list[Path] = []
        for fmi in versions:
            # the folder itself is where `run --fmus` and the packages, which know no FMI 3, look
            folder = options.out / f"fmi{fmi}" if fmi != DEFAULT_FMI and len(versions) > 1 else options.out
            platforms = tuple(options.platform or ["linux64"])
            built += build_all(
                models,
                folder,
                fmi=fmi,
                platforms=platforms,
                arrays=not options.scalars,
                sources=options.sources,
                reference=lambda m: reference_files(m.name),
                done=done,
            )
        return built
    if versions != [DEFAULT_FMI] or options.platform or options.scalars or options.sources:
        raise ValueError(
            "--fmi 3, --platform, --scalars and --sources go with --backend native; Python FMUs are FMI 2 for linux64 and win64"
        )
    for model in models:
        done(build_python(model, options.out))
    return files


def _replay_model(recorded: Run, component_name: str, recorded_as: str) -> Model:
    """The model that plays back what `recorded_as` did in a run, in place of the component `component_name`."""
    model = component(component_name)
    if recorded_as not in recorded.components:
        raise ValueError(
            f"{recorded.folder} has no component {recorded_as!r}; it has {', '.join(recorded.components)}: say which one with --as"
        )
    outputs = [v.name for v in model.variables if v.causality == "output"]
    columns = {name: recorded[f"{recorded_as}.{name}"] for name in outputs}
    return replay_model(model, recorded.t - recorded.t[0], columns)


def check(options: Namespace) -> int:
    """`robomill check`: the conformance battery on each FMU; status 1 if a check failed."""
    reports: dict[str, list[conformance.Result]] = {}
    with progress_bar(options.json) as report:
        for i, fmu in enumerate(options.fmus):
            report(f"check {fmu.name}", i, len(options.fmus))
            reports[str(fmu)] = conformance.check_fmu(fmu)
        report("check", len(options.fmus), len(options.fmus))
    failed = sum(not r.passed for results in reports.values() for r in results)
    if options.json:
        print(json.dumps({name: [asdict(r) for r in results] for name, results in reports.items()}, indent=1))
        return 1 if failed else 0
    colour = {"passed": "green", "failed": "red", "finding": "yellow", "skipped": "cyan"}
    console = _console()
    for name, results in reports.items():
        table = Table(title=name, title_justify="left", show_header=False)
        for r in results:
            table.add_row(r.check, f"[{colour[r.outcome]}]{r.outcome}[/]", escape(r.detail))
        console.print(table)
    console.print(f"{failed} checks failed" if failed else "no check failed", highlight=False)
    return 1 if failed else 0


def _console() -> Console:
    """Standard output; wide enough for the tables where it is not a terminal."""
    console = Console()
    return console if console.is_terminal else Console(width=120)


def _write(file: Path, content: Any) -> None:
    file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
