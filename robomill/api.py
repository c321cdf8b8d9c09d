"""What scripts and notebooks import: `import robomill as rm`. The names in `__all__` stay as they are from version to version.

    >>> import robomill as rm
    >>> run = rm.run(rm.load("static_cell"))      # a system file that comes with robomill; or a file of yours
    >>> run["compliance.d_T_B"].shape, run.unit("compliance.d_T_B")
    ((2, 3), 'm')

A milling scenario has several variants, and gives a run of each::

    runs = rm.run("groove", "results/groove")     # as `robomill run scenarios/groove.toml`
    runs["cartesian"]["compliance.p_BT_B"]        # float64[n, 3], m
    runs.figures["cartesian"].max_deviation_m     # m
    runs["cartesian"].to_pandas("sensor.f_T_T")   # a table over t; to_xarray, to_csv, plot

Measured runs and their simulation are compared by `rm.diagnose`::

    answer = rm.diagnose("scenarios/milling_cell.toml", ["runs/slot-1", "runs/slot-2"], held_out=["runs/pocket-1"])
    answer.verdict, answer.closure
    answer.report("results/diagnosis")
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, Unpack, overload

from robomill.cell import milled
from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.equipment import load_system
from robomill.cell.milled import Runs
from robomill.cell.scenario import Scenario, load_scenario
from robomill.diagnose_command import answered, catalogue_file, catalogue_of, kinds_file, systems_of
from robomill.diagnosed import Diagnosed
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.inference.adequacy import FALSE_ALARM
from robomill.diagnosis.outcome import adopt as adoption
from robomill.loading import load
from robomill.orchestration.assembly import run as run_system
from robomill.orchestration.errors import unknown
from robomill.orchestration.loop.master import Manipulator, Observer
from robomill.orchestration.runs.lock import FolderLock
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System as _System
from robomill.orchestration.system.parameters import Convert
from robomill.progress import progress_bar
from robomill.sweeping import SweepTable, sweep

__all__ = ["Diagnosed", "Run", "Runs", "Scenario", "SweepTable", "System", "diagnose", "load", "load_scenario", "run", "sweep"]

Parameters = Mapping[str, Mapping[str, Any]]
"""component -> parameter -> value: a number (or nested lists of them) in the unit of the port, or a text with its unit, "20 urad"."""


class System(_System):
    """`orchestration.system.definition.System`, whose files may give values with units."""

    @staticmethod
    def load(file: str | Path, convert: Convert = convert) -> _System:
        """Read a system file, and give its components the robot, tool, material and sensor that it names (`cell.equipment`).

        SystemFileError names file, line, what was found and what is allowed.
        """
        return load_system(file)


class RunOptions(TypedDict, total=False):
    """Options of `run`, which says what they mean."""

    parameters: Parameters
    adopt: str | Path | None
    fmus: str | Path | None
    loop: str | None
    overwrite: bool
    resume: bool
    progress: bool
    stop: float | None
    start: float
    labels: Mapping[str, Any] | None
    observers: Sequence[Observer]
    manipulators: Sequence[Manipulator]


@overload
def run(what: _System, folder: str | Path | None = None, **options: Unpack[RunOptions]) -> Run: ...
@overload
def run(what: str | Path | Scenario, folder: str | Path | None = None, *, variant: str, **options: Unpack[RunOptions]) -> Run: ...
@overload
def run(what: Scenario, folder: str | Path | None = None, *, variant: None = None, **options: Unpack[RunOptions]) -> Runs: ...
@overload
def run(what: str | Path, folder: str | Path | None = None, *, variant: None = None, **options: Unpack[RunOptions]) -> Runs | Run: ...


def run(
    what: str | Path | Scenario | _System,
    folder: str | Path | None = None,
    *,
    variant: str | None = None,
    parameters: Parameters | None = None,
    adopt: str | Path | None = None,
    fmus: str | Path | None = None,
    loop: str | None = None,
    overwrite: bool = False,
    resume: bool = False,
    progress: bool = False,
    **options: Any,
) -> Runs | Run:
    """Run a milling scenario in all its variants, or in one, or a system once.

    what: Scenario or System, or what `load` takes. A scenario gives `Runs` (variant -> Run, with what was measured of the parts);
    with `variant`, and for a system, the one `Run`.
    folder: where the results go. Without one nothing stays on disk: a scenario's temporary folder goes with what is returned.
    Runs that are to be diagnosed or viewed later need a folder.
    parameters: component -> parameter -> value in the unit of the port, in place of those of the files.
    adopt: file of effects that a diagnosis found (adopt.ssv). fmus: folder of FMUs that run in place of the models in process.
    loop: "auto", "compiled" or "python"; the numbers are the same.
    overwrite, resume: replace runs that are in the folder, or go on with them; with neither that is refused.
    progress: show it on standard error.
    Only with systems: stop, start [s]; labels, observers, manipulators (`orchestration.assembly.run`).

        >>> run("static_cell", parameters={"compliance": {"stiffness_error[2]": -0.1}}).outcome
        'finished'

    Raises what `load` raises; ResultsError where a folder holds a run; RunError where a component fails, and Interrupted: what was
    computed until then is in the folder.
    """
    subject = load(what) if isinstance(what, str | Path) else what
    if isinstance(subject, Run):
        raise ValueError(f"{subject.folder} is the folder of a run that has been made; expected a scenario or a system file")
    for name in options:
        if name not in RunOptions.__annotations__:
            raise TypeError(unknown("option", name, RunOptions.__annotations__))
    place = None if folder is None else Path(folder)
    built = None if fmus is None else Path(fmus)

    def changed(system: _System) -> _System:
        system = system if loop is None else replace(system, loop=loop)
        return system if adopt is None else adoption.adopted(system, adopt)

    if isinstance(subject, Scenario):
        _refuse(options, subject)
        return _mill(subject, place, variant, parameters or {}, changed, built, overwrite, resume, progress)
    if variant is not None:
        raise ValueError(f"variant = {variant!r} goes with scenarios; the system {subject.name!r} is one run; leave it out")
    system = changed(subject)
    for component, values in (parameters or {}).items():
        system = system.with_parameters(component, values)
    system = system if built is None else with_fmus(system, built)
    with progress_bar(not progress) as report:
        return run_system(
            system,
            place,
            resolver=resolve,
            convert=convert,
            overwrite=overwrite,
            resume=resume,
            progress=lambda done, total: report(system.name, done, total),
            **options,
        )


def _refuse(options: Mapping[str, Any], scenario: Scenario) -> None:
    """ValueError for options that milling would ignore, and for scenarios of other kinds."""
    if options:
        raise ValueError(
            f"{', '.join(options)} goes with systems; the scenario {scenario.name!r} takes its step and its end from its system and program"
            "; leave it out"
        )
    if scenario.kind != "milling":
        raise ValueError(f"{scenario.name!r} is of the kind {scenario.kind!r}, expected milling; run it with: robomill run {scenario.file}")


def _mill(
    scenario: Scenario,
    folder: Path | None,
    variant: str | None,
    parameters: Parameters,
    changed: Any,
    fmus: Path | None,
    overwrite: bool,
    resume: bool,
    progress: bool,
) -> Runs | Run:
    scenario = milled.with_parameters(scenario, parameters)
    names = None if variant is None else [variant]
    place = folder or Path(tempfile.mkdtemp(prefix="robomill_"))
    place.mkdir(parents=True, exist_ok=True)
    try:
        with progress_bar(not progress) as report, FolderLock(place):
            runs = milled.mill_variants(
                scenario, place, names, changed=changed, fmus=fmus, overwrite=overwrite, resume=resume, progress=report
            )
    except BaseException:
        if folder is None:
            shutil.rmtree(place, ignore_errors=True)
        raise
    found = runs if variant is None else runs[variant]
    if folder is None:
        weakref.finalize(found, shutil.rmtree, place, ignore_errors=True)
    return found


def diagnose(
    system: str | Path | _System,
    runs: Sequence[str | Path | Run],
    *,
    held_out: Sequence[str | Path | Run] = (),
    catalogue: str | Path | None = None,
    calibration: str | Path | None = None,
    next_runs: str | Path | None = None,
    repair: bool = False,
    false_alarm: float = FALSE_ALARM,
    form: bool = False,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: bool = False,
) -> Diagnosed:
    """Say where measured runs depart from their simulation, why, and how far that can be mended: `robomill diagnose`.

    system: the nominal simulation, a System or what `load` takes. runs: folders of measured runs, or Runs; repeats of one condition
    belong together. held_out: runs that are not fitted, which show whether the answer holds.
    catalogue: file of the effects to look for; next_runs: file of the kinds of runs that could be made next. Without them, those beside
    the system's file, else those of the milling cell.
    calibration: file of how well the numbers of this machine are calibrated, in place of the tolerances in the catalogue.
    repair: correct a clock that is late, and diagnose the rest. false_alarm: probability, 0 to 1, of an effect on a machine that has none.
    form: look for the form of what is left whatever the verdict, and not only if it is `unknown`.
    jobs: processes; with more than one a script needs `if __name__ == "__main__":`. scheduler: tcp://HOST:PORT of a Dask cluster instead.
    progress: show it on standard error.

    Returns verdict, effects, closure; `report(folder)` writes the page. A log that is not usable is an answer ("bad_log"), no error.
    DataError where the runs do not fit the system; the other errors are those of `load`.
    A worked example is docs/tutorials/diagnose_a_log.md.
    """
    subject = load(system) if isinstance(system, str | Path) else system
    if not isinstance(subject, _System):
        raise ValueError(f"{system} is no system file; expected the system that simulates the runs, such as scenarios/milling_cell.toml")
    if not 0.0 < false_alarm < 1.0:
        raise ValueError(f"false_alarm = {false_alarm!r}; expected a probability between 0 and 1, such as {FALSE_ALARM}")
    campaign = Campaign.of(subject, _runs(runs), _runs(held_out))
    named, known, kinds = (None if f is None else Path(f) for f in (catalogue, calibration, next_runs))
    effects = catalogue_of(*systems_of(campaign), file=catalogue_file(named, subject.file), calibration=known)
    with progress_bar(not progress) as report:
        found = answered(
            campaign,
            effects,
            kinds_file(kinds, subject.file),
            jobs=jobs,
            repair=repair,
            false_alarm=false_alarm,
            form=form,
            scheduler=scheduler,
            progress=report,
        )
    return Diagnosed(found, campaign.system, (*campaign.runs, *campaign.held_out), effects)


def _runs(given: Sequence[str | Path | Run]) -> list[Run]:
    if isinstance(given, str | Path | Run):
        raise TypeError(f"runs = {given!r}; expected a list of folders or Runs, such as [{str(given)!r}]")
    return [r if isinstance(r, Run) else Run.load(r) for r in given]
