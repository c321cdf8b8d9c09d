"""Make a benchmark: cases for the diagnosis, truth in a sealed folder, both reproducible bit for bit from what was asked for.

DIR/request.json                   what was asked for
DIR/benchmark.json                 what it is, and the hash of every file of every case
DIR/cases/0001/system.toml         the nominal system; loaded_cell.toml and campaign.toml where some runs are of another system
DIR/cases/0001/calibration.toml    how well its numbers are calibrated: that is known of a cell
DIR/cases/0001/withheld.toml       effects that are taken out of the catalogue for this case, if there are any
DIR/cases/0001/runs/...            the runs
DIR/sealed/0001.json, 0001/*.npy   the truth; DIR/sealed/manifest.json their hashes, whose own hash is in benchmark.json
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from robomill.blind import generate
from robomill.blind.case import DETECTABLE
from robomill.blind.sealing import Benchmark, hashes
from robomill.blind.second import generate as second
from robomill.blind.sets import GENERATOR_VERSION, Plan, plans
from robomill.blind.truth import Truth
from robomill.blind.workers import Progress, work
from robomill.blind.world import LOADED, SYSTEM
from robomill.orchestration.errors import RunError
from robomill.orchestration.runs.run import read_info
from robomill.orchestration.system.toml_text import dump

TIERS = ("T0", "T1")
ATTEMPTS = 5
"""Machines that are drawn for a case at most: one on which the program cannot be run is rare, five in a row are an error. A case of the
set `withheld` is drawn anew, too, while its effect is not clear; the last one is kept as it is."""
CAMPAIGN, WITHHELD = "campaign.toml", "withheld.toml"
CALIBRATION = Path(__file__).with_name("calibration.toml")
"""How well the machines of both generators are calibrated; every case has it."""


class Generator(Protocol):
    """Who can make a case."""

    def __call__(self, folder: Path, plan: Plan, seed: int, tier: str, attempt: int = 0) -> Truth:
        """Write the runs of a case below folder/cases/NNNN/runs and gaps into folder/sealed/NNNN; returns its truth.

        RunError: a machine that cannot run; another attempt draws another.
        """


WRITERS: Mapping[str, Generator] = {"first": generate.write_case, "second": second.write_case}
"""By name; `sets.GENERATORS` has the names that there may be."""


@dataclass(frozen=True)
class Request:
    """What is asked for: all of request.json. Everything in the benchmark follows from it."""

    cases: int
    """Number of cases."""
    seed: int
    """Seed that all cases follow from."""
    tier: str = "T1"
    """Set of channels that are logged."""
    set: str = "mixed"
    """Set of cases."""
    generator: str = "first"
    """Generator of the cases."""
    schema: str = "robomill-blind/2"
    """Name and version of the form."""
    version: int = GENERATOR_VERSION
    """Version of the generator."""

    def plans(self) -> list[Plan]:
        """Its cases. ValueError: a set, tier, generator or number that there is not."""
        if self.tier not in TIERS:
            raise ValueError(f"--tier {self.tier}: expected one of {', '.join(TIERS)}")
        found = plans(self.set, self.cases, self.seed, self.generator)
        missing = sorted({p.generator for p in found} - set(WRITERS))
        if missing:
            raise ValueError(f"--generator {self.generator}: no {', '.join(missing)} generator; there is: {', '.join(WRITERS)}")
        return found


def make(folder: str | Path, request: Request, progress: Progress | None = None, workers: int | None = 1) -> Benchmark:
    """Make a benchmark in `folder`. Cases that are complete are kept, so it can be interrupted.

    With more than one of `workers` (None: all cores) the cases are made in processes of their own; the bits are the same.

    ValueError: something in the request that there is not, or a folder that holds another benchmark.
    """
    every = request.plans()
    folder = Path(folder)
    what = asdict(request)
    head = folder / "request.json"
    if head.is_file():
        if json.loads(head.read_text(encoding="utf-8")) != what:
            raise ValueError(f"{folder} holds another benchmark ({head.read_text(encoding='utf-8').strip()}); choose another folder")
    elif folder.exists() and any(folder.iterdir()):
        raise ValueError(f"{folder} is not empty and holds no benchmark; choose another folder")
    (folder / "sealed").mkdir(parents=True, exist_ok=True)
    write(head, json.dumps(what) + "\n")
    to_do = [p for p in every if not (folder / "sealed" / f"{p.number:04d}.json").is_file()]
    for done, _ in enumerate(work(make_case, [(folder, p, request.seed, request.tier) for p in to_do], workers), 1):
        if progress is not None:
            progress("make", done, len(to_do))
    manifest = hashes(folder / "sealed", exclude=("manifest.json",))
    text = json.dumps(manifest, indent=0, sort_keys=True) + "\n"
    write(folder / "sealed" / "manifest.json", text)
    result = Benchmark(**what, truth=hashlib.sha256(text.encode()).hexdigest(), files=hashes(folder / "cases"))
    write(folder / "benchmark.json", json.dumps(asdict(result), indent=0, sort_keys=True) + "\n")
    return result


def write(file: Path, text: str) -> None:
    """Write a file in one move: it is there as a whole or not at all."""
    part = file.with_name(f".{file.name}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(file)


def make_case(folder: Path, plan: Plan, seed: int, tier: str) -> None:
    """Simulate, write and seal one case; the truth is written last."""
    truth = _drawn(folder, plan, seed, tier)
    write_head(folder / "cases" / f"{plan.number:04d}", plan)
    truth = replace(truth, generator=plan.generator)
    write(folder / "sealed" / f"{plan.number:04d}.json", json.dumps(truth.content, indent=1) + "\n")


def _drawn(folder: Path, plan: Plan, seed: int, tier: str) -> Truth:
    for attempt in range(ATTEMPTS):
        last = attempt == ATTEMPTS - 1
        try:
            truth = WRITERS[plan.generator](folder, plan, seed, tier, attempt)
        except RunError:
            if last:
                raise
            continue
        if last or plan.kind != "withheld" or truth.detectability >= DETECTABLE:
            return truth
    raise AssertionError("the last attempt returns or raises")


def write_head(case: Path, plan: Plan) -> None:
    """What a case has beside its runs: nominal systems, calibration, the campaign where there are several, the effects withheld."""
    shutil.copyfile(SYSTEM, case / "system.toml")
    shutil.copyfile(CALIBRATION, case / CALIBRATION.name)
    runs = {f.name: read_info(f) for f in sorted((case / "runs").iterdir())}
    loaded = {name for name, info in runs.items() if info["system"] == LOADED.stem}
    if loaded:
        shutil.copyfile(LOADED, case / LOADED.name)
        tables = [dump({"campaign": {"name": f"case {case.name}"}})]
        tables += [f"[[condition]]\n{dump(entry)}" for entry in campaign_conditions(runs, loaded)]
        (case / CAMPAIGN).write_text("\n".join(tables), encoding="utf-8")
    if plan.kind == "withheld":
        (case / WITHHELD).write_text(dump({"effects": [s.partition("[")[0] for s in plan.subject]}), encoding="utf-8")


def campaign_conditions(runs: Mapping[str, Mapping[str, Any]], loaded: set[str]) -> list[dict[str, Any]]:
    """The conditions of a campaign file: name, system, runs and role; `runs` by folder, `loaded` those with an applied load.

    Held-out repeats stand with their condition: they are labelled as such.
    """
    conditions: dict[str, dict[str, Any]] = {}
    for folder, info in runs.items():
        label = str(info["labels"]["condition"])
        system = LOADED.name if folder in loaded else "system.toml"
        entry = conditions.setdefault(label, {"name": label, "system": system, "runs": [], "role": "held_out"})
        entry["runs"].append(f"runs/{folder}")
        if not info["labels"]["held_out"]:
            entry["role"] = "diagnose"
    return list(conditions.values())
