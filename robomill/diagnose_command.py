"""`robomill diagnose`: what the engine is told about milling cells, and its answer: screen, files, page (robomill/report)."""

from __future__ import annotations

import hashlib
import json
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import date
from functools import cache
from importlib.metadata import version
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

from robomill.cell import next_runs
from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.diagnosis.candidates import LOGGING
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.check import check
from robomill.diagnosis.engine import diagnose_campaign
from robomill.diagnosis.experiment.campaign import Campaign, load_campaign
from robomill.diagnosis.experiment.design import Kind, Offer, Quantity
from robomill.diagnosis.experiment.simulation import Report
from robomill.diagnosis.experiment.store import Store
from robomill.diagnosis.forms.layout import Form
from robomill.diagnosis.inference.adequacy import FALSE_ALARM
from robomill.diagnosis.inference.intervals import MATERIAL
from robomill.diagnosis.outcome import adopt
from robomill.diagnosis.outcome.answer import Answer, Diagnosis, Menu, Which, as_json
from robomill.diagnosis.outcome.reasons import WHY
from robomill.files import FILES, vacant
from robomill.fmus.components import NAMES, companion, component, home, is_component
from robomill.fmus.python.builder import build
from robomill.freed_memory import give_back
from robomill.joints import projections
from robomill.models.components.correction import correction_model
from robomill.models.components.file_names import FORM
from robomill.models.model.cache import source_files
from robomill.models.model.declaration import Model
from robomill.orchestration.runs.lock import FolderLock
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import Component, System
from robomill.report.subject import perhaps
from robomill.report.units import percent
from robomill.tables import say

CATALOGUE = "catalogue.toml"
ANSWER = "diagnosis.json"
LAW, LAW_FMU = f"adopt{FORM}", "adopt_form.fmu"
"""The form of an unknown law: what `robomill run --adopt` takes, and an FMU that other tools put on the connection."""
SHOWN = 6
"""Effects that are printed, beside those that are likelier there than not."""
SIMULATIONS = "simulations"
"""Folder in that of the answer: what has been simulated, until the diagnosis is finished."""


def menu(system: System, folder: Path, file: Path = next_runs.KINDS) -> Menu:
    """What the engine is told about a system: coordinates, and the kinds of runs in `file` (tables of runs go to `folder`)."""
    number = count()

    def designed(kind: next_runs.RunKind) -> Kind:
        def make(values: Mapping[str, float]) -> Offer:
            r = next_runs.prepare(system, kind.name, folder / f"run-{next(number)}", values, file)
            return Offer(r.system, r.parameters, r.seconds)

        return Kind(
            kind.name, tuple(Quantity(r.name, r.unit, r.low, r.high, r.start) for r in kind.ranges), kind.minutes, kind.repeats, make
        )

    return Menu(kinds=lambda: [designed(k) for k in next_runs.kinds_for(system, file)], projections=projections(system))


def kinds_file(named: Path | None, first: Path | None) -> Path:
    """The file of kinds of runs that is named, or that beside the system in the file `first`, or the milling cells' one.

    It is read: errors come first.
    """
    beside = None if first is None else first.parent / next_runs.OWN
    file = named or (beside if beside is not None and beside.is_file() else next_runs.KINDS)
    next_runs.load_kinds(file)
    return file


def answered(
    campaign: Campaign,
    catalogue: Catalogue,
    kinds: Path,
    *,
    jobs: int = 1,
    repair: bool = False,
    false_alarm: float = FALSE_ALARM,
    form: bool = False,
    store: Store | None = None,
    scheduler: str | None = None,
    progress: Report | None = None,
) -> Diagnosis:
    """Diagnose runs with the components, units and next runs of milling cells; `kinds`: file of the kinds of next runs.

    The other arguments, and what is raised, are those of `diagnosis.engine.diagnose_campaign`.
    """
    give_back()
    with TemporaryDirectory() as folder:
        return diagnose_campaign(
            campaign,
            catalogue,
            resolver=resolve,
            convert=convert,
            workers=max(1, jobs),
            report=progress,
            menu=menu(campaign.system, Path(folder), kinds),
            repair=repair,
            false_alarm=false_alarm,
            form=form,
            store=store,
            scheduler=scheduler,
        )


def run(options: Namespace) -> int:
    """Exit status 0: answered; 1: the log is not usable. One at a time in a folder."""
    if not (options.check or options.overwrite):
        vacant(options.out / ANSWER)
    new = not options.out.exists()
    options.out.mkdir(parents=True, exist_ok=True)
    try:
        with FolderLock(options.out):
            return _run(options)
    finally:
        if new:
            with suppress(OSError):  # what is refused before anything was simulated leaves nothing behind
                options.out.rmdir()


def _run(options: Namespace) -> int:
    from robomill.progress import progress_bar

    first: Path | None = options.campaign or options.system
    file = catalogue_file(options.catalogue, first)
    campaign = campaign_of(options)
    system = campaign.system
    systems = systems_of(campaign)
    catalogue = catalogue_of(*systems, file=file, calibration=options.calibration)
    store = Store(options.out / SIMULATIONS, sources(*systems))
    if len(store) and not options.json:
        print(
            f"{len(store)} simulations of a check or an interrupted diagnosis are in {store.folder}/; those that still hold are taken over",
            file=sys.stderr,
        )
    kinds = kinds_file(options.next_runs, first)
    if options.check:
        return _check(options, campaign, catalogue, store, kinds)
    with progress_bar(options.json) as progress:
        try:
            found = answered(
                campaign,
                catalogue,
                kinds,
                jobs=options.jobs,
                repair=options.repair,
                false_alarm=options.false_alarm,
                form=options.form,
                store=store,
                scheduler=options.scheduler,
                progress=progress,
            )
        except KeyboardInterrupt as error:
            error.add_note(f"{len(store)} simulations are kept in {store.folder}/: the same command goes on")
            raise
    page = write(found, system, [*campaign.runs, *campaign.held_out], catalogue, options.out)
    store.remove()
    if options.json:
        print(as_json(found.result))
    else:
        say(*lines(found.answer))
        beside = ["diagnosis.json", *(name for name in ("adopt.ssv", LAW, LAW_FMU) if (options.out / name).is_file())]
        say(f"report: {page}; beside it {', '.join(beside[:-1])}{' and ' if len(beside) > 1 else ''}{beside[-1]}")
    return 1 if found.answer.verdict == "bad_log" else 0


def _check(options: Namespace, campaign: Campaign, catalogue: Catalogue, store: Store, kinds: Path) -> int:
    """What the runs can show. The simulations stay where they are: the diagnosis takes them over."""
    from robomill.check_table import show
    from robomill.progress import progress_bar

    if options.repair:
        raise ValueError("--repair goes with a diagnosis, which --check does not make; leave one of them out")
    with progress_bar(options.json) as progress, TemporaryDirectory() as folder:
        made = menu(campaign.system, Path(folder), kinds).kinds()
        jobs = max(1, options.jobs)
        found = check(campaign, catalogue, resolver=resolve, convert=convert, workers=jobs, report=progress, store=store, kinds=made)
    if options.json:
        print(as_json(found.result))
    else:
        show(found)
    return 0


def campaign_of(options: Namespace) -> Campaign:
    """The campaign that is named, or that of a system and its runs, with what is adopted.

    ValueError where both are given, or neither; where something is adopted in a campaign, whose systems need not have the same components.
    """
    if options.campaign is None:
        if options.system is None or not options.runs:
            raise ValueError("expected SYSTEM.toml RUN..., or --campaign FILE.toml: nothing to diagnose is named")
        system = load_system(options.system)
        if options.adopt is not None:
            system = adopt.adopted(system, options.adopt)
        return Campaign.of(system, [Run.load(f) for f in options.runs], [Run.load(f) for f in options.held_out])
    if given := [str(f) for f in (options.system, *options.runs, *options.held_out) if f is not None]:
        raise ValueError(f"--campaign {options.campaign} names systems and runs itself; {given[0]} is one more: put it into the file")
    if options.adopt is not None:
        raise ValueError(f"--adopt {options.adopt}: with --campaign, put its values into [parameters] of the systems that have them")
    return load_campaign(options.campaign, load_system)


def systems_of(campaign: Campaign) -> list[System]:
    """The systems of a campaign, that of the first runs first."""
    system = campaign.system
    return [system, *(p.system for p in campaign.parts if p.system is not system)]


def catalogue_file(named: Path | None, first: Path | None) -> Path:
    """The catalogue that is named, or that beside the system or campaign in the file `first`, or the milling cell's.

    FileNotFoundError where the named one is not there.
    """
    if named is not None and not named.is_file():
        raise FileNotFoundError(f"no catalogue {named}; without --catalogue it is {CATALOGUE} beside the system, or the milling cell's")
    beside = None if first is None else first.parent / CATALOGUE
    return named or (beside if beside is not None and beside.is_file() else FILES / "scenarios" / CATALOGUE)


def catalogue_of(*systems: System, file: Path, calibration: Path | None = None) -> Catalogue:
    """The catalogue in `file`, and the effects that components from outside bring: `catalogue.toml` beside the module of their model.

    There the component goes by the name of its model. `calibration`: file of tolerances in place of those of the catalogue.
    """
    own: dict[Path, Catalogue] = {}
    systems_own = {
        (s.folder / CATALOGUE).resolve() for s in systems
    }  # beside a system, it goes by the names there, and --catalogue replaces it
    for c, model in _from_outside(*systems):
        beside = companion(model, CATALOGUE).resolve()
        if beside.is_file() and beside not in systems_own:  # a package may have several components, and one file about all of them
            own[beside] = own.get(beside, Catalogue.load(beside)).about(model.name, c.name)
    catalogue = Catalogue.load(file)
    for brought in own.values():
        catalogue = catalogue.joined(brought)
    return catalogue if calibration is None else catalogue.calibrated(calibration)


def _from_outside(*systems: System) -> list[tuple[Component, Model]]:
    """Components that run in process and are none of this project, with their models; each name once."""
    found = {c.name: c for s in reversed(systems) for c in s.components if c.source not in NAMES and is_component(c.source)}
    return [(c, component(c.source)) for c in found.values()]


def write(found: Diagnosis, system: System, runs: Sequence[Run], catalogue: Catalogue, folder: Path) -> Path:
    """diagnosis.json, adopt.ssv where there is something to adopt, and the report, which is returned."""
    from robomill import report

    folder.mkdir(parents=True, exist_ok=True)
    (folder / ANSWER).write_text(as_json(found.result) + "\n", encoding="utf-8")
    if found.answer.verdict in ("identified", "ambiguous") or found.answer.number is not None:
        adopt.write(found.adopted, folder / "adopt.ssv")
    else:
        (folder / "adopt.ssv").unlink(missing_ok=True)  # of an earlier answer
    for old in (folder / LAW, folder / LAW_FMU):
        old.unlink(missing_ok=True)
    if found.answer.form is not None and found.answer.form.specification:
        text = json.dumps(found.answer.form.specification, indent=1)
        (folder / LAW).write_text(text + "\n", encoding="utf-8")
        build(correction_model(found.answer.form.specification), folder / LAW_FMU, page="", reference={})
    made = f"diagnosed on {date.today().isoformat()} by robomill {version('robomill')}"
    return report.write(report.Subject(found, system, runs, catalogue, made), folder)


def sources(*systems: System) -> str:
    """Hash of all that a simulation is computed with: simulations kept on disk are those of this program and these components."""
    digest = hashlib.sha256(_own_sources())
    for _, model in _from_outside(*systems):
        for name, file in source_files(home(model)[0]).items():
            if not name.startswith("robomill."):
                digest.update(file.read_bytes())
    return digest.hexdigest()


@cache
def _own_sources() -> bytes:
    digest = hashlib.sha256()
    for package in ("models", "fmus", "orchestration", "diagnosis/experiment"):
        for file in sorted((FILES / package).rglob("*")):
            if file.suffix in (".py", ".toml"):
                digest.update(file.read_bytes())
    return digest.digest()


def lines(answer: Answer) -> list[str]:
    """The answer in sentences."""
    guess = " (nothing was repeated: the noise is a guess)" if answer.guessed else ""
    out = [f"verdict: {answer.verdict}{guess}"]
    out += [f"note: {text}" for text in answer.skipped]
    out += [f"log: {f.channel} {f.text}" for f in answer.findings]
    for w in answer.where:
        if w.component != LOGGING and w.share >= MATERIAL:
            out.append(f"where: {w.component} ({w.location}), {100 * w.share:.0f} % of the gap, strongest in {w.direction}")
    if answer.not_replayed:
        out.append(f"where: {answer.not_replayed}")
    shown = max(SHOWN, sum(e.probability > 1.0 - e.probability for e in answer.which))
    for e in answer.which[:shown]:
        values = ", ".join(f"{k} = {v.text}" for k, v in e.parameters.items())
        idle = "" if e.material else "; closes next to nothing: listed, no cause"
        out.append(f"which: {e.effect} at {e.location}, probability {e.probability:.2f}{_if_listed(answer, e)}, {values}{idle}")
    if rest := answer.which[shown:]:
        out.append(f"which: {len(rest)} more, with probabilities up to {rest[0].probability:.2f}, in the report")
    if answer.suspected:
        out.append(f"suspected: {perhaps(answer, ', '.join(f'{w.effect} at {w.location}' for w in answer.suspected))}")
    out += [f"calibrated: {p.text}" for p in answer.calibrated or ()]
    out += _gap_lines(answer)
    if answer.unknown:
        out += [f"unknown: the best model {WHY[reason]}" for reason in answer.unknown.why]
        for x in answer.unknown.instead:
            there = ", ".join(x.ports)
            part = "more than all" if x.gain > 1.0 else f"{100 * x.gain:.1f} %"  # an effect may make the gap larger
            out.append(f"stand-in: {x.effect}; {x.law} in its place does better in {there}, by {part} of the gap there")
    if (one := answer.number) is not None:
        out.append(f"number: {one.text}; no effect of the catalogue is about it, and its probability is {one.probability:.2f}")
    if answer.onset:
        out.append(f"onset: {answer.onset.text}")
    if answer.form:
        out += _form_lines(answer.form)
        if (nearest := answer.closer) is not None and not answer.form.refuted:
            closed = f"{100 * (nearest.closure or 0.0):.0f} %, {nearest.on}"
            out.append(f"form: the effects that are nearest close more of the whole gap (all signals, each over its noise), {closed}")
    elif answer.verdict == "unknown" and answer.number is None:
        out.append("form: none was found that predicts parts of the runs that were left out")
    if answer.next_run:
        out.append(f"next run: {answer.next_run.text}")
    return out


def _if_listed(answer: Answer, effect: Which) -> str:
    """How likely an effect of an answer that is `unknown` is, if what is wrong is in the catalogue after all."""
    if answer.verdict != "unknown" or answer.number is not None or answer.tests is None or answer.tests.p_fit <= 0.0:
        return ""
    return f" ({min(effect.probability / answer.tests.p_fit, 1.0):.2f} if the cause is in the catalogue)"


def _gap_lines(answer: Answer) -> list[str]:
    """What tolerances take of the gap, where that is all; what the best model is worth in new conditions; how far it closes the gap."""
    out = []
    if answer.verdict == "none" and (gap := answer.gap) is not None and gap.before > gap.noise:
        rest = "; whether the rest is noise is a guess" if gap.noise_is_a_guess else ""
        share = f"{percent(gap.within_calibration / gap.before)} of it lies within the tolerances of calibrated numbers"
        far = f"; the farthest off: {gap.farthest.text}" if gap.farthest is not None else ""
        out.append(f"gap: {share}{far}{rest}")
    if t := answer.transfer:
        gain = f"gains {t.gain:.4g} nats of {t.expected_gain:.4g} expected"
        out.append(f"new conditions: {gain}, leaves {t.after:.2f} times the chi2 of noise and discrepancy, nominal {t.before:.2f}")
    for h in answer.how_far:
        if h.unit != "1":
            closed = "not measurable" if h.closure is None else f"closure {100 * h.closure:.0f} %"
            out.append(f"how far: {h.metric}, {h.on}: {h.before:.3g} -> {h.after:.3g} {h.unit}, {closed}")
    return out


def _form_lines(form: Form) -> list[str]:
    """A form in sentences. What one closes that the loop refutes is no merit: it is not said."""
    out = []
    for p in form.ports:
        worth = ": of no use" if form.refuted else f", which closes {100 * p.closure:.0f} %"
        out.append(f"form: {p.port} lacks {p.formula} ({p.unit}){worth}")
    out += [f"form: {text}" for text in (*form.like, form.note) if text]
    for h in form.how_far:
        if h.unit != "1" and h.closure is not None:
            closed = "" if form.refuted else f", closure {100 * h.closure:.0f} %"
            out.append(f"form in the loop: {h.metric}, {h.on}: {h.before:.3g} -> {h.after:.3g} {h.unit}{closed}")
    larger = dict.fromkeys(h.metric for h in form.how_far if h.unit != "1" and (h.closure or 0.0) < 0.0)
    if larger and not form.refuted:
        out.append(f"form: in the loop it makes larger: {', '.join(larger)}; look at that before it is adopted")
    return out
