"""`robomill diagnose`: what the engine is told about milling cells, and its answer: screen, files, page (robomill/report)."""

from __future__ import annotations

import hashlib
import sys
from argparse import Namespace
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from robomill.cell import next_runs
from robomill.cell.binding import convert, resolve
from robomill.diagnosis.catalogue import LOGGING, Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.store import Store
from robomill.diagnosis.outcome import adopt
from robomill.diagnosis.outcome.answer import Diagnosis, Menu, as_json
from robomill.diagnosis.outcome.next_run import Offer
from robomill.joints import PROJECTIONS
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System

CATALOGUE = "catalogue.toml"
SIMULATIONS = "simulations"
"""Folder in that of the answer: what has been simulated, until the diagnosis is finished."""


def menu(system: System, folder: Path) -> Menu:
    """What the engine is told about a system; for a milling cell, runs that could be made next (tables go to `folder`)."""

    def offers() -> dict[str, Offer]:
        made = {}
        for kind in next_runs.kinds(system):
            r = next_runs.prepare(system, kind, folder / kind)
            shown = {c: {k: v for k, v in values.items() if k not in ("segments", "profile")} for c, values in r.parameters.items()}
            made[kind] = Offer(r.system, r.parameters, r.seconds, r.minutes, r.repeats, {c: v for c, v in shown.items() if v})
        return made

    return Menu(offers=offers, projections=PROJECTIONS)


def run(options: Namespace) -> int:
    """Exit status 0: answered; 1: the log is not usable."""
    from robomill.commands import _progress

    file = options.catalogue or options.system.parent / CATALOGUE
    if not file.is_file():
        raise FileNotFoundError(f"no catalogue {file}; name one with --catalogue (the milling cell's is scenarios/{CATALOGUE})")
    catalogue, system = Catalogue.load(file), System.load(options.system, convert)
    runs, held = [Run.load(f) for f in options.runs], [Run.load(f) for f in options.held_out]
    store = Store(options.out / SIMULATIONS, sources())
    if len(store) and not options.json:
        print(
            f"{len(store)} simulations of an interrupted diagnosis are in {store.folder}/; those that still hold are taken over",
            file=sys.stderr,
        )
    with _progress(options.json) as progress, TemporaryDirectory() as folder:
        try:
            found = diagnose(
                system,
                runs,
                catalogue,
                held_out=held,
                resolver=resolve,
                convert=convert,
                workers=max(1, options.jobs),
                report=progress,
                menu=menu(system, Path(folder)),
                repair=options.repair,
                store=store,
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted; {len(store)} simulations are kept in {store.folder}/: the same command goes on"
            ) from None
    page = write(found, system, [*runs, *held], catalogue, options.out)
    store.remove()
    if options.json:
        print(as_json(found.result))
    else:
        print("\n".join(lines(found.result)))
        print(f"report: {page}; beside it diagnosis.json{' and adopt.ssv' if (options.out / 'adopt.ssv').is_file() else ''}")
    return 1 if found.result["verdict"] == "bad_log" else 0


def write(found: Diagnosis, system: System, runs: Sequence[Run], catalogue: Catalogue, folder: Path) -> Path:
    """diagnosis.json, adopt.ssv where there is something to adopt, and the report, which is returned."""
    from robomill import report

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "diagnosis.json").write_text(as_json(found.result) + "\n", encoding="utf-8")
    if found.result["verdict"] in ("identified", "ambiguous"):
        adopt.write(found.adopted, folder / "adopt.ssv")
    else:
        (folder / "adopt.ssv").unlink(missing_ok=True)  # of an earlier answer
    return report.write(report.Subject(found, system, runs, catalogue), folder)


@cache
def sources() -> str:
    """Hash of all that a simulation is computed with: simulations kept on disk are those of this program."""
    digest = hashlib.sha256()
    for package in ("models", "fmus", "orchestration", "diagnosis"):
        for file in sorted((Path(__file__).parent / package).rglob("*")):
            if file.suffix in (".py", ".toml"):
                digest.update(file.read_bytes())
    return digest.hexdigest()


def lines(result: dict[str, Any]) -> list[str]:
    """The answer in sentences."""
    guess = " (nothing was repeated: the noise is a guess)" if result.get("gap", {}).get("noise_is_a_guess") else ""
    out = [f"verdict: {result['verdict']}{guess}"]
    out += [f"log: {f['channel']} {f['text']}" for f in result["gate"]["findings"]]
    for w in result["where"]:
        if w["component"] != LOGGING:
            out.append(f"where: {w['component']} ({w['location']}), {100 * w['share']:.0f} % of the gap, strongest in {w['direction']}")
    for w in result["which"][:6]:
        values = ", ".join(
            f"{k} = {v['value']:.4g} [{v['interval'][0]:.4g} .. {v['interval'][1]:.4g}] {v['unit']}" for k, v in w["parameters"].items()
        )
        out.append(f"which: {w['effect']} at {w['location']}, probability {w['probability']:.2f}, {values}")
    if "transfer" in result:
        t = result["transfer"]
        gain = f"gains {t['gain']:.4g} nats of {t['promised']:.4g} promised"
        out.append(f"new conditions: {gain}, leaves {t['after']:.2f} times the energy of noise, nominal {t['before']:.2f}")
    for h in result["how_far"]:
        if h["unit"] != "1":
            closed = "not measurable" if h["closure"] is None else f"closure {100 * h['closure']:.0f} %"
            out.append(f"how far: {h['metric']}, {h['on']}: {h['before']:.3g} -> {h['after']:.3g} {h['unit']}, {closed}")
    if result["next_run"]:
        r = result["next_run"]
        text = f"{r['kind']}, {r['minutes']:.0f} min, to separate {', '.join(r['separates'])}"
        text += f": {r['distance']:.1f} deviations apart instead of {r['now']:.1f}"
        out.append(f"next run: {text if r['separated'] else 'none on the menu would separate ' + ', '.join(r['separates'])}")
    return out
