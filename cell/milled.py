"""A milling scenario in its variants: milled one after the other, measured, kept together."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from robomill.cell import milling
from robomill.cell.scenario import Scenario, ScenarioError
from robomill.orchestration import html
from robomill.orchestration.errors import unknown
from robomill.orchestration.optional import optional
from robomill.orchestration.runs.run import Run, check_vacant
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.written import merged

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from robomill.cell.evaluation import Figures, Result

SUMMARY = "summary.json"


class Column(NamedTuple):
    """A figure of a variant as tables show it."""

    key: str
    title: str
    unit: str
    factor: float
    """From the unit of the figure (SI) to that of the table."""
    form: str

    def text(self, figures: Figures, published: Mapping[str, float]) -> str:
        """The figure, and in brackets what was published."""
        ours, theirs = getattr(figures, self.key), published.get(self.key)
        text = "-" if ours is None else self.form.format(self.factor * ours)
        if self.key == "max_deviation_m" and figures.max_deviation_limited:
            text = f">= {text}"
        return text if theirs is None else f"{text} ({self.form.format(self.factor * theirs)})"


COLUMNS = (
    Column("max_deviation_m", "max deviation", "mm", 1e3, "{:.2f}"),
    Column("rms_deviation_m", "rms", "mm", 1e3, "{:.2f}"),
    Column("p95_deviation_m", "95 %", "mm", 1e3, "{:.2f}"),
    Column("peak_force_n", "peak force", "N", 1.0, "{:.0f}"),
    Column("reaction_t50_s", "reaction", "ms", 1e3, "{:.0f}"),
    Column("real_time_factor", "speed", "x real", 1.0, "{:.0f}"),
)


@dataclass(frozen=True, eq=False)
class Runs(Mapping[str, Run]):
    """The runs of a milling scenario by variant, and what was measured of the parts."""

    scenario: Scenario
    folder: Path
    """The runs by variant, the tables of the plan, summary.json."""
    results: tuple[Result, ...]
    notes: tuple[str, ...] = ()
    """What the reader of the program skipped or decided, and where the planner did not hold the feed."""
    warnings: tuple[str, ...] = ()
    """What is wrong with the plan, or unusual."""

    def __getitem__(self, variant: str) -> Run:
        if variant not in self._by_name:
            raise KeyError(unknown("variant", variant, self._by_name))
        return self._by_name[variant].run

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self.results)

    @property
    def _by_name(self) -> dict[str, Result]:
        return {r.name: r for r in self.results}

    @property
    def figures(self) -> dict[str, Figures]:
        """Variant -> deviations [m], forces [N], reaction time [s]."""
        return {r.name: r.figures for r in self.results}

    def rows(self) -> list[list[str]]:
        """A row per variant: its title and COLUMNS, in brackets what was published."""
        paper = self.scenario.paper
        return [[r.title, *(c.text(r.figures, paper.get(r.name, {})) for c in COLUMNS)] for r in self.results]

    def to_pandas(self) -> pd.DataFrame:
        """A row per variant; the columns are the fields of `Figures`, whose names end in their units.

        MissingPackageError without pandas (`pip install robomill[pandas]`).
        """
        pandas = optional("pandas", "Runs.to_pandas")
        index = pandas.Index(list(self), name="variant")
        frame: pd.DataFrame = pandas.DataFrame([asdict(f) for f in self.figures.values()], index=index)
        return frame

    def plot(self) -> Figure:
        """Draw the deviation of the machined surfaces [mm] as colour maps, seen from above, walls folded outwards."""
        from robomill.cell import pictures  # matplotlib takes a second to load

        assert self.scenario.workpiece is not None  # load_scenario checks it for this kind
        return pictures.surfaces(self.results, self.scenario.workpiece)

    def pictures(self, progress: milling.Progress | None = None) -> list[Path]:
        """Draw every picture of the scenario into `folder`; returns the files."""
        from robomill.cell import pictures

        files = pictures.draw_all(self.scenario, self.results, self.folder, progress)
        from robomill.cell import scan

        return files + (scan.draw(self.scenario, self.results, self.folder) if self.scenario.scan else [])

    def summary(self, others: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """What summary.json holds; `others`: figures of variants that are not among these."""
        figures = {**(others or {}), **{name: asdict(f) for name, f in self.figures.items()}}
        variants = {v.name: figures[v.name] for v in self.scenario.variants if v.name in figures}
        return {"scenario": self.scenario.name, "notes": list(self.notes), "warnings": list(self.warnings), "variants": variants}

    def _repr_html_(self) -> str:
        headings = ("variant", *(f"{c.title}, {c.unit}" for c in COLUMNS))
        caption = f"{self.scenario.title}{' (in brackets: published)' if self.scenario.paper else ''}"
        return html.table(caption, headings, self.rows()) + html.paragraphs((*self.warnings, *self.notes))


def chosen(scenario: Scenario, names: Sequence[str] | None) -> Scenario:
    """The scenario with the variants in `names` alone; all, where none is named. ScenarioError lists what there is."""
    if not names:
        return scenario
    known = {v.name: v for v in scenario.variants}
    if missing := [n for n in names if n not in known]:
        raise ScenarioError(f"{scenario.file}: no variant {', '.join(missing)}; variants: {', '.join(known)}")
    return replace(scenario, variants=tuple(known[n] for n in dict.fromkeys(names)))


def with_parameters(scenario: Scenario, parameters: Mapping[str, Mapping[str, Any]]) -> Scenario:
    """The scenario with parameters of components (plain numbers in the unit of the port) in place of its own and those of its variants."""
    both = {**scenario.parameters, **{c: merged(scenario.parameters.get(c, {}), values) for c, values in parameters.items()}}
    variants = [
        replace(v, parameters={c: merged(own, parameters[c]) if c in parameters else own for c, own in v.parameters.items()})
        for v in scenario.variants
    ]
    return replace(scenario, parameters=both, variants=tuple(variants))


def same(system: System) -> System:
    """The system as it is."""
    return system


def mill_variants(
    scenario: Scenario,
    folder: Path,
    names: Sequence[str] | None = None,
    *,
    changed: Callable[[System], System] = same,
    fmus: Path | None = None,
    csv: bool = False,
    stl: bool = False,
    checkpoint_every: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: milling.Progress | None = None,
    warn: Callable[[str], object] | None = None,
    done: Callable[[Runs], object] | None = None,
) -> Runs:
    """Mill all variants, or those in `names`, below `folder`; summary.json there is written anew after each.

    `changed` is applied to the planned system before it mills: the plan and its offline force stay those of the scenario. `stl`: also
    the machined part as part.stl. `warn` is called with each warning before anything is milled, `done` with what is complete after
    each variant. Nothing is begun where a folder holds a run, unless `overwrite` or `resume`. Raises what `milling.prepare` and
    `milling.mill` raise; what is complete stays.
    """
    assert scenario.workpiece is not None  # load_scenario checks it for this kind
    wanted = chosen(scenario, names)
    if not (overwrite or resume):
        check_vacant(folder / v.name for v in wanted.variants)
    job = milling.lay_out(wanted, folder, fmus, resume=resume, overwrite=overwrite, checkpoint_every=checkpoint_every)
    if stl:
        from robomill.cell import part

        part.require(job.system)
    unusual = milling.check_variants(replace(job, system=changed(job.system)), wanted.variants)
    job = replace(job, warnings=(*job.warnings, *unusual))
    if warn is not None:
        for text in job.warnings:
            warn(text)
    job = milling.with_pilot(job, progress)
    job = replace(job, system=changed(job.system))
    runs = Runs(scenario, folder, (), job.notes, job.warnings)
    others = _figures_in(folder / SUMMARY)
    for variant, completing, factor in milling.mill_all(job, wanted.variants, progress, csv=csv):
        from robomill.cell import evaluation, scan  # with what the surface is measured with: the run begins without it

        recorded = completing.run()
        result = evaluation.evaluate(variant.name, variant.title, recorded, scenario.workpiece, factor)
        runs = replace(runs, results=(*runs.results, scan.scanned(scenario, result) if scenario.scan else result))
        if stl:
            from robomill.models.metrology.stl import write_stl

            write_stl(folder / variant.name / "part.stl", part.cut_part(recorded, scenario.workpiece).surface())
        (folder / SUMMARY).write_text(json.dumps(runs.summary(others), indent=1) + "\n", encoding="utf-8")
        if done is not None:
            done(runs)
    return runs


def _figures_in(file: Path) -> dict[str, Any]:
    """Figures of variants that were milled before."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))["variants"]
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return found if isinstance(found, dict) else {}
