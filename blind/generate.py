"""Make a benchmark: cases for the diagnosis, truth in a sealed folder, both reproducible bit for bit from (cases, seed, tier).

DIR/benchmark.json                 what it is, and the hash of every file of every case
DIR/cases/0001/system.toml         the nominal system
DIR/cases/0001/runs/training-1 ... six repeats, training-held-1, -2, and two of each held-out condition
DIR/sealed/0001.json, 0001/*.npy   the truth; DIR/sealed/manifest.json their hashes, whose own hash is in benchmark.json
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from robomill.blind import bad_logs, outside
from robomill.blind.conditions import Condition, draw, known, planned
from robomill.blind.effects import BY_KEY, EFFECTS, EVEN, Instance
from robomill.blind.effects import draw as draw_effect
from robomill.blind.outside import Changes, Columns
from robomill.blind.sealing import Benchmark, hashes
from robomill.blind.signatures import ARRAYS, floor
from robomill.blind.truth import TrueEffect, TrueFault, TrueOutside, Truth
from robomill.blind.workers import Progress, work
from robomill.blind.world import (
    NOISE,
    STEP,
    SYSTEM,
    TRACKER,
    Machine,
    draw_machine,
    jittered,
    measure,
    nominal,
    nominal_system,
    simulate,
    simulate_nominal,
)
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.errors import RunError
from robomill.orchestration.runs.recorder import SCHEMA, frame_of
from robomill.orchestration.runs.run import RUN, SIGNALS
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.toml_text import dump

GENERATOR_VERSION = 2
"""Version of the generator: numbers change only with it."""
TIERS = ("T0", "T1")
PROPORTIONS: Mapping[str, float] = {"null": 0.20, "single": 0.38, "double": 0.15, "triple": 0.04, "outside": 0.15, "bad_log": 0.08}
"""Share of the cases of each kind, as DIAGNOSIS.md has them."""
REPEATS, HELD_REPEATS, OTHER_REPEATS = 6, 2, 2
WINDOW = 125
"""Rows of the windows (0.5 s) in which detectability is looked at."""
ATTEMPTS = 5
"""Machines that are drawn for a case at most: one on which the program cannot be run is rare, five in a row are an error."""


@dataclass(frozen=True)
class Plan:
    """What a case is about, before anything is simulated."""

    number: int
    kind: str
    subject: tuple[str, ...] = ()
    """Keys of effects, name of the outside kind or of the fault of the log."""


def plans(cases: int, seed: int) -> list[Plan]:
    """Kinds in the proportions, effects and kinds in turn from a shuffled list, all in random order: the number says nothing."""
    if cases < 1:
        raise ValueError(f"--cases {cases}: expected at least 1")
    random = np.random.default_rng([GENERATOR_VERSION, seed])
    exact = {kind: share * cases for kind, share in PROPORTIONS.items()}
    counts = {kind: int(value) for kind, value in exact.items()}
    for kind in sorted(exact, key=lambda k: counts[k] - exact[k])[: cases - sum(counts.values())]:
        counts[kind] += 1
    effects, kinds, faults = _Deck([*BY_KEY], random), _Deck([*outside.OUTSIDE_BY_NAME], random), _Deck([*bad_logs.LOG_FAULTS], random)
    subjects: list[tuple[str, tuple[str, ...]]] = [("null", ())] * counts["null"]
    subjects += [("single", (effects.next(),)) for _ in range(counts["single"])]
    for kind, size in (("double", 2), ("triple", 3)):
        subjects += [(kind, tuple(str(k) for k in random.choice([*BY_KEY], size, replace=False))) for _ in range(counts[kind])]
    subjects += [("outside", (kinds.next(),)) for _ in range(counts["outside"])]
    subjects += [("bad_log", (faults.next(),)) for _ in range(counts["bad_log"])]
    order = random.permutation(len(subjects))
    return [Plan(i + 1, *subjects[j]) for i, j in enumerate(order)]


class _Deck:
    """Cards dealt in random order, shuffled anew when they are used up."""

    def __init__(self, cards: Sequence[str], random: np.random.Generator) -> None:
        self._cards, self._random, self._left = list(cards), random, list[str]()

    def next(self) -> str:
        if not self._left:
            self._left = [self._cards[i] for i in self._random.permutation(len(self._cards))]
        return self._left.pop()


def make(folder: str | Path, cases: int, seed: int, tier: str, progress: Progress | None = None, workers: int | None = 1) -> Benchmark:
    """Make a benchmark in `folder`. Cases that are complete are kept, so it can be interrupted.

    With more than one of `workers` (None: all cores) the cases are made in processes of their own; the bits are the same.

    ValueError: an unknown tier, or a folder that holds another benchmark.
    """
    if tier not in TIERS:
        raise ValueError(f"tier {tier!r}: expected one of {', '.join(TIERS)}")
    every = plans(cases, seed)
    folder = Path(folder)
    what: dict[str, Any] = {"schema": "robomill-blind/1", "version": GENERATOR_VERSION, "cases": cases, "seed": seed, "tier": tier}
    head = folder / "request.json"
    if head.is_file():
        if json.loads(head.read_text(encoding="utf-8")) != what:
            raise ValueError(f"{folder} holds another benchmark ({head.read_text(encoding='utf-8').strip()}); choose another folder")
    elif folder.exists() and any(folder.iterdir()):
        raise ValueError(f"{folder} is not empty and holds no benchmark; choose another folder")
    (folder / "sealed").mkdir(parents=True, exist_ok=True)
    write(head, json.dumps(what) + "\n")
    to_do = [p for p in every if not (folder / "sealed" / f"{p.number:04d}.json").is_file()]
    for done, _ in enumerate(work(make_case, [(folder, p, seed, tier) for p in to_do], workers), 1):
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
    """Simulate, write and seal one case. A machine on which the program cannot be run (RunError) is drawn anew, ATTEMPTS in all."""
    for attempt in range(ATTEMPTS):
        try:
            _attempt(folder, plan, tier, np.random.default_rng([GENERATOR_VERSION, seed, plan.number, attempt]))
        except RunError:
            if attempt == ATTEMPTS - 1:
                raise
        else:
            return


def _attempt(folder: Path, plan: Plan, tier: str, random: np.random.Generator) -> None:
    """One try; the truth is written last."""
    conditions = draw(random)
    machine = draw_machine(random)
    truth, changes, fault = _subject(plan, tier, random)
    place = folder / "cases" / f"{plan.number:04d}"
    shutil.rmtree(place, ignore_errors=True)
    (place / "runs").mkdir(parents=True)
    shutil.copyfile(SYSTEM, place / "system.toml")
    parameters, others = switched_on(truth.effects)
    everything = outside.merged([changes, *others])
    for c, count, held in (
        (conditions[0], REPEATS + HELD_REPEATS, False),
        (conditions[1], OTHER_REPEATS, True),
        (conditions[2], OTHER_REPEATS, True),
    ):
        for i in range(count):
            held_out = held or i >= REPEATS
            t, columns, ports = simulate(c, machine, parameters, everything, random)
            columns = measure(columns, tier, random)
            stamped = jittered(t, random)
            if fault is not None:
                fault.apply(columns, t)
            number = i + 1 if held or i < REPEATS else i + 1 - REPEATS
            name = c.name.replace(" ", "-") + ("-held" if held_out and not held else "")
            labels = {"condition": c.name, "repeat": number, "held_out": held_out, "tier": tier, "kind": "milling"}
            write_run(place / "runs" / f"{name}-{number}", stamped, columns, ports, c, labels)
    truth = replace(truth, case=plan.number, tier=tier, machine=machine.parameters, conditions=conditions)
    truth = _oracle(folder / "sealed" / f"{plan.number:04d}", truth, machine, (parameters, everything), fault)
    write(folder / "sealed" / f"{plan.number:04d}.json", json.dumps(truth.content, indent=1) + "\n")


def _subject(plan: Plan, tier: str, random: np.random.Generator) -> tuple[Truth, Changes, bad_logs.BadLog | None]:
    """Truth, out-of-catalogue changes and fault of the log of a case."""
    truth = Truth(plan.kind)
    effects: list[Instance] = []
    changes, fault = Changes(), None
    if plan.kind in ("single", "double", "triple"):
        effects = [draw_effect(BY_KEY[key], random) for key in plan.subject]
    elif plan.kind == "outside":
        kind = outside.OUTSIDE_BY_NAME[plan.subject[0]]
        value, changes = kind.draw(random)
        truth = replace(truth, outside=TrueOutside(kind.name, kind.component, value, kind.unit))
    elif plan.kind == "bad_log":
        fault = bad_logs.draw(plan.subject[0], tier, random)
        truth = replace(truth, bad_log=TrueFault(fault.kind, fault.channel, fault.value, fault.unit))
        if random.random() < EVEN:  # a bad log with something real in it must be stopped just the same
            effects = [draw_effect(EFFECTS[int(random.integers(len(EFFECTS)))], random)]
    true = [
        TrueEffect(e.effect.component, e.effect.name, e.parameter, e.index, e.value, e.effect.unit, _formulation(e, random))
        for e in effects
    ]
    return replace(truth, effects=tuple(true)), changes, fault


_OTHER = {"gear_hysteresis": "bouc_wen", "friction_coulomb": "dahl"}
"""Effects of which there is another formulation; every second one gets it."""


def _formulation(e: Instance, random: np.random.Generator) -> str:
    """How an effect is made: by its `parameter`, or otherwise."""
    return _OTHER.get(e.effect.name, "parameter") if random.random() < EVEN else "parameter"


def switched_on(effects: Sequence[TrueEffect]) -> tuple[list[Instance], list[Changes]]:
    """Effects as they stand in a truth: those that are switched on by their parameter, and the changes that make the others."""
    parameters: list[Instance] = []
    changes: list[Changes] = []
    for e in effects:
        instance = e.instance
        if e.formulation == "bouc_wen":
            torque = (94.0, 94.0, 94.0, 20.0, 18.0, 11.0)[instance.index - 1]
            changes.append(outside.bouc_wen(instance.index - 1, instance.value, torque))
        elif e.formulation == "dahl":
            changes.append(outside.dahl(instance.index - 1, instance.value))
        else:
            parameters.append(instance)
    return parameters, changes


def write_run(
    folder: Path, t: FloatArray, columns: Columns, ports: Mapping[str, PortData], c: Condition, labels: Mapping[str, Any]
) -> None:
    """A measured run as `orchestration.runs.run.Run.load` reads it, without a date: the same bytes each time."""
    folder.mkdir(parents=True)
    np.save(folder / "segments.npy", planned(c).table)
    described = {n: {"port": n, "unit": ports[n].unit or "", "frame": frame_of(ports[n].name), "type": ports[n].type} for n in columns}
    noise = {array: values[0] for array, values in NOISE.items() if any(n.partition("[")[0] == array for n in columns)}
    info = {
        "schema": SCHEMA,
        "outcome": "finished",
        "message": "",
        "kind": "measured",
        "program": "program",
        "robot": nominal_system().labels["robot"],
        "tool": "end mill D16 z3",
        "workpiece": "AW-2017",
        "system": "milling_cell",
        "clock": {"column": "t", "unit": "s", "step": STEP, "every": 1},
        "labels": dict(labels),
        "instruments": noise,  # white noise by data sheet; the rest is for the repeats to show
        "parameters": known(c, "segments.npy"),
        "columns": described,
    }
    text = dump(info)
    (folder / RUN).write_text(text, encoding="utf-8")
    fields = [pa.field("t", pa.float64(), metadata={"unit": "s", "description": "time"})]
    fields += [pa.field(n, pa.float32(), metadata={k: d[k] for k in ("unit", "frame")}) for n, d in described.items()]
    schema = pa.schema(fields, metadata={"robomill": text})
    pyarrow.parquet.write_table(
        pa.table([t, *(v.astype(np.float32) for v in columns.values())], schema=schema), folder / SIGNALS, compression="zstd"
    )


def _oracle(
    sealed: Path,
    truth: Truth,
    machine: Machine,
    world: tuple[Sequence[Instance], Changes],
    fault: bad_logs.BadLog | None,
) -> Truth:
    """The truth with what only the generator can know: how far effects and fault stand out, and what adopting the truth would close.

    `<condition>.npy` in `sealed`: float32[n, 6], noise-free minus nominal, tool tip [m] and compensated force [N].
    """
    sealed.mkdir(parents=True, exist_ok=True)
    main, tier, usual = truth.conditions[0], truth.tier, nominal(truth.conditions[0]).columns
    t, with_them, _ = simulate(main, machine, *world, None)
    _, without, _ = simulate(main, machine, (), Changes(), None)
    groups = detectability(with_them, without, usual, tier)
    effects = []
    for e in truth.effects:
        alone = with_them
        if len(truth.effects) > 1:
            parameters, changes = switched_on([e])
            _, alone, _ = simulate(main, machine, parameters, outside.merged(changes), None)
        effects.append(replace(e, detectability=max(detectability(alone, without, usual, tier).values())))
    bad_log = truth.bad_log
    if fault is not None and bad_log is not None:
        logged = {name: values.copy() for name, values in with_them.items()}
        fault.apply(logged, t)
        bad_log = replace(bad_log, detectability=max(detectability(logged, with_them, usual, tier).values()))
    ceiling = {}
    for c in truth.conditions[1:]:
        _, clean, _ = simulate(c, machine, *world, None)
        gap = difference(clean, nominal(c).columns)
        np.save(sealed / f"{c.name.replace(' ', '-')}.npy", gap.astype(np.float32))
        if effects:
            after = difference(clean, simulate_nominal(c, [e.instance for e in effects]).columns)
            ceiling[c.name] = {"tool tip": closure(gap[:, :3], after[:, :3]), "force": closure(gap[:, 3:], after[:, 3:])}
    largest = max(groups.values())
    return replace(truth, effects=tuple(effects), bad_log=bad_log, detectability=largest, detectability_by_array=groups, ceiling=ceiling)


def difference(a: Mapping[str, FloatArray], b: Mapping[str, FloatArray]) -> FloatArray:
    """Tool tip [m] and compensated force [N] of a minus those of b, (n, 6)."""
    names = [f"{array}[{i}]" for array in (TRACKER, "sensor.f_T_T") for i in (1, 2, 3)]
    n = min(len(a[names[0]]), len(b[names[0]]))
    return np.stack([a[k][:n] - b[k][:n] for k in names], axis=1)


def closure(before: FloatArray, after: FloatArray) -> float:
    """1 - G_after/G_before, mean squares; NaN-free: 0 where there was no gap."""
    n = min(len(before), len(after))
    g = float(np.mean(before[:n] ** 2))
    return 0.0 if g == 0.0 else 1.0 - float(np.mean(after[:n] ** 2)) / g


def detectability(
    with_them: Mapping[str, FloatArray], without: Mapping[str, FloatArray], nominal_columns: Mapping[str, FloatArray], tier: str
) -> dict[str, float]:
    """By measured array: the largest ratio, over its elements and windows of 0.5 s, of two rms values.

    Above: the change by the effects. Below: what is there without them, that is the gap between this machine and the nominal one in
    that window, and what machine and noise usually leave after six repeats (`signatures.floor`).
    """
    result: dict[str, float] = {}
    for name, y0 in without.items():
        array = name.partition("[")[0]
        if array not in ARRAYS or (tier == "T0" and array == TRACKER):
            continue
        n = min(len(y0), len(with_them[name]), len(nominal_columns[name]))
        change, gap = with_them[name][:n] - y0[:n], y0[:n] - nominal_columns[name][:n]
        usual = floor(name, nominal_columns[name])[:n]
        for k in range(0, max(n - WINDOW, 1), WINDOW):
            window = slice(k, k + WINDOW)
            below = np.sqrt(np.mean(gap[window] ** 2) + np.mean(usual[window] ** 2))
            result[array] = max(result.get(array, 0.0), float(np.sqrt(np.mean(change[window] ** 2)) / below))
    return result
