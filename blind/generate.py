"""The first generator: a case of the components of this project, with another integration and other numbers than the diagnosis has.

cases/0001/runs/training-1 ...     repeats of each condition, two held-out ones of the first, and two of each held-out condition
sealed/0001/other-cut.npy ...      what the machine without noise is off from the nominal one in each held-out condition
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from robomill.blind import bad_logs, outside
from robomill.blind.conditions import Condition, draw, known, load_table, planned
from robomill.blind.effects import BY_KEY, EFFECTS, EVEN, Instance
from robomill.blind.effects import draw as draw_effect
from robomill.blind.outside import Changes, Columns
from robomill.blind.prediction import LOGGING, Named
from robomill.blind.sets import GENERATOR_VERSION, Plan
from robomill.blind.signatures import ARRAYS, floor
from robomill.blind.truth import TrueEffect, TrueFault, TrueOutside, Truth
from robomill.blind.world import (
    NOISE,
    STEP,
    TRACKER,
    Machine,
    draw_hidden,
    draw_machine,
    jittered,
    measure,
    nominal,
    nominal_system,
    simulate,
    simulate_nominal,
    system_file,
)
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.runs.files import RUN, SIGNALS
from robomill.orchestration.runs.recorder import SCHEMA, frame_of
from robomill.orchestration.system.toml_text import dump

HELD_REPEATS, OTHER_REPEATS = 2, 2
"""Held-out runs of the first condition, and of each held-out condition."""
QUANTITIES: Mapping[str, slice] = {"tool tip": slice(0, 3), "force": slice(3, 6), "torque": slice(6, 12)}
"""Columns of a gap."""
WINDOW = 125
"""Rows of the windows (0.5 s) in which detectability is looked at."""
CAMPAIGN_STIFFNESS = 0.15
"""Smallest stiffness error that a campaign is asked to find."""
LATE = (2e-3, 15e-3)
"""Delay [s] of the late clock of a machine, from and to: one that is later is a bad log."""
LATE_DEVICES = ("drive.*", "sensor.*", "controller.*", "compliance.*")
"""Devices whose clock may be late; the last one is the tracker."""


@dataclass(frozen=True)
class World:
    """What is different from the nominal cell: effects by their parameters, what is put in between, and what is wrong with the log."""

    machine: Machine
    effects: Sequence[Instance]
    changes: Changes
    clocks: Changes

    def simulate(self, c: Condition, random: np.random.Generator | None = None, log: bool = False) -> tuple[FloatArray, Columns]:
        """Times and columns of a run; without `random` no noise; `log`: as it is logged, by clocks that may be late."""
        t, columns, _ = simulate(c, self.machine, self.effects, self.changes, random)
        if log and self.clocks.after is not None:
            self.clocks.after(columns, t, STEP)
        return t, columns


def write_case(folder: Path, plan: Plan, seed: int, tier: str, attempt: int = 0) -> Truth:
    """Simulate a case and write its runs below cases/NNNN/runs; returns its truth. What only the generator knows goes to sealed/NNNN.

    RunError: a machine on which the program cannot be run; another `attempt` draws another one.
    """
    random = np.random.default_rng([GENERATOR_VERSION, seed, plan.number, attempt])
    conditions = draw(seed, plan.shape, plan.number)
    machine = replace(draw_machine(random), hidden=draw_hidden(random))
    truth, changes, fault = _subject(plan, tier, random)
    parameters, others = switched_on(truth.effects)
    world = World(machine, parameters, outside.merged([changes, *others]), clocks(truth.effects))
    truth = replace(
        truth,
        case=plan.number,
        tier=tier,
        repeats=plan.repeats,
        machine=machine.parameters,
        hidden=machine.hidden,
        conditions=conditions,
    )
    truth = _oracle(folder / "sealed" / f"{plan.number:04d}", truth, world, fault)
    runs = folder / "cases" / f"{plan.number:04d}" / "runs"
    shutil.rmtree(runs, ignore_errors=True)
    for c in conditions:
        held = HELD_REPEATS if c is conditions[0] else 0
        for i in range(OTHER_REPEATS if c.held_out else plan.repeats + held):
            t, columns = world.simulate(c, random, log=True)
            columns = measure(columns, tier, random)
            stamped = jittered(t, random)
            if fault is not None:
                fault.apply(columns, t)
            more = not c.held_out and i >= plan.repeats
            number = i + 1 - plan.repeats if more else i + 1
            name = c.name.replace(" ", "-") + ("-held" if more else "")
            labels = {"condition": c.name, "repeat": number, "held_out": c.held_out or more, "tier": tier}
            write_run(runs / f"{name}-{number}", stamped, columns, c, labels)
    return truth


def _subject(plan: Plan, tier: str, random: np.random.Generator) -> tuple[Truth, Changes, bad_logs.BadLog | None]:
    """Truth, out-of-catalogue changes and fault of the log of a case."""
    truth = Truth(plan.kind)
    true: list[TrueEffect] = []
    changes, fault = Changes(), None
    if plan.kind in ("outside", "formed"):
        kind = (outside.FORMED_BY_NAME if plan.kind == "formed" else outside.OUTSIDE_BY_NAME)[plan.subject[0]]
        value, changes = kind.draw(random)
        truth = replace(truth, outside=TrueOutside(kind.name, kind.component, value, kind.unit))
    elif plan.kind == "bad_log":
        fault = bad_logs.draw(plan.subject[0], tier, random)
        truth = replace(truth, bad_log=TrueFault(fault.kind, fault.channel, fault.value, fault.unit))
        if random.random() < EVEN:  # a bad log with something real in it must be stopped just the same
            true = [_true(draw_effect(EFFECTS[int(random.integers(len(EFFECTS)))], random), random)]
    else:
        true = [_effect(text, plan, tier, random) for text in plan.subject]
    return replace(truth, effects=tuple(true)), changes, fault


def _effect(text: str, plan: Plan, tier: str, random: np.random.Generator) -> TrueEffect:
    """An effect of the subject of a plan, at the element that it names, or at any."""
    component, _, parameter = text.partition(".")
    named = Named.of(component, parameter)
    if component == LOGGING:
        device = LATE_DEVICES[int(random.integers(len(LATE_DEVICES) - (tier == "T0")))]
        value = float(LATE[0] * (LATE[1] / LATE[0]) ** random.random())
        return TrueEffect(LOGGING, named.effect, f"{named.effect} {device}", 0, value, "s", "clock")
    effect = BY_KEY[named.key]
    if plan.shape == "campaign" and named.effect == "stiffness_error":
        effect = replace(effect, low=CAMPAIGN_STIFFNESS)
    return _true(draw_effect(effect, random, named.index or None), random)


def _true(e: Instance, random: np.random.Generator) -> TrueEffect:
    return TrueEffect(e.effect.component, e.effect.name, e.parameter, e.index, e.value, e.effect.unit, _formulation(e, random))


_OTHER = {"gear_hysteresis": "bouc_wen", "friction_coulomb": "dahl"}
"""Effects of which there is another formulation; every second one gets it."""


def _formulation(e: Instance, random: np.random.Generator) -> str:
    """How an effect is made: by its `parameter`, or otherwise."""
    return _OTHER.get(e.effect.name, "parameter") if random.random() < EVEN else "parameter"


def switched_on(effects: Sequence[TrueEffect]) -> tuple[list[Instance], list[Changes]]:
    """Effects as they stand in a truth: those that are switched on by their parameter, and the changes that make the others.

    Clocks are not among them.
    """
    parameters: list[Instance] = []
    changes: list[Changes] = []
    for e in effects:
        if not e.physical:
            continue
        instance = e.instance
        if e.formulation == "bouc_wen":
            torque = (94.0, 94.0, 94.0, 20.0, 18.0, 11.0)[instance.index - 1]
            changes.append(outside.bouc_wen(instance.index - 1, instance.value, torque))
        elif e.formulation == "dahl":
            changes.append(outside.dahl(instance.index - 1, instance.value))
        else:
            parameters.append(instance)
    return parameters, changes


def clocks(effects: Sequence[TrueEffect]) -> Changes:
    """What the late clocks among the effects do to the log."""
    return outside.merged([outside.late_clock(e.parameter.partition(" ")[2], e.value) for e in effects if not e.physical])


def write_run(folder: Path, t: FloatArray, columns: Columns, c: Condition, labels: Mapping[str, Any]) -> None:
    """A measured run as `orchestration.runs.run.Run.load` reads it, without a date: the same bytes each time."""
    folder.mkdir(parents=True)
    np.save(folder / "segments.npy", planned(c).table)
    if not c.cuts:
        np.save(folder / "profile.npy", load_table(c))
    ports = nominal(c).ports
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
        "system": nominal_system(system_file(c)).name,
        "clock": {"column": "t", "unit": "s", "step": STEP, "every": 1},
        "labels": {**labels, "kind": "milling" if c.cuts else "static load"},
        "instruments": noise,  # white noise by data sheet; the rest is for the repeats to show
        "parameters": known(c, "segments.npy", "profile.npy"),
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


def _oracle(sealed: Path, truth: Truth, world: World, fault: bad_logs.BadLog | None) -> Truth:
    """The truth with what only the generator can know: how far effects and fault stand out, and what adopting the truth would close.

    `<condition>.npy` in `sealed`: float32[n, 12], noise-free minus nominal (`difference`); clocks are not in it.
    """
    sealed.mkdir(parents=True, exist_ok=True)
    given = [c for c in truth.conditions if not c.held_out]
    bare = World(world.machine, (), Changes(), Changes())
    usual, without = [nominal(c).columns for c in given], [bare.simulate(c)[1] for c in given]
    logs = [world.simulate(c, log=True) for c in given]
    groups = _largest([detectability(w, o, u, truth.tier) for (_, w), o, u in zip(logs, without, usual, strict=True)])
    effects = []
    for e in truth.effects:
        alone = [w for _, w in logs]
        if len(truth.effects) > 1:
            parameters, changes = switched_on([e])
            one = World(world.machine, parameters, outside.merged(changes), clocks([e]))
            alone = [one.simulate(c, log=True)[1] for c in given]
        ratios = _largest([detectability(a, o, u, truth.tier) for a, o, u in zip(alone, without, usual, strict=True)])
        effects.append(replace(e, detectability=max(ratios.values())))
    bad_log = truth.bad_log
    if fault is not None and bad_log is not None:
        ratios = {}
        for (t, with_them), nominal_columns in zip(logs, usual, strict=True):
            faulty = {name: values.copy() for name, values in with_them.items()}
            fault.apply(faulty, t)
            ratios = _largest([ratios, detectability(faulty, with_them, nominal_columns, truth.tier)])
        bad_log = replace(bad_log, detectability=max(ratios.values()))
    ceiling = {}
    instances = [e.instance for e in effects if e.physical]
    for c in truth.conditions:
        if not c.held_out:
            continue
        clean = world.simulate(c)[1]
        gap = difference(clean, nominal(c).columns)
        np.save(sealed / f"{c.name.replace(' ', '-')}.npy", gap.astype(np.float32))
        if truth.kind == "formed":  # what the law itself does to the nominal cell; not what else this world does otherwise
            usual_one, bent = (World(Machine({}), (), x, Changes()).simulate(c)[1] for x in (Changes(), world.changes))
            after = gap - padded(difference(bent, usual_one), len(gap))
            ceiling[c.name] = {quantity: closure(gap[:, part], after[:, part]) for quantity, part in QUANTITIES.items()}
        elif instances:
            after = difference(clean, simulate_nominal(c, instances, truth.hidden).columns)
            ceiling[c.name] = {quantity: closure(gap[:, part], after[:, part]) for quantity, part in QUANTITIES.items()}
    largest = max(groups.values())
    return replace(truth, effects=tuple(effects), bad_log=bad_log, detectability=largest, detectability_by_array=groups, ceiling=ceiling)


def _largest(groups: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The largest ratio of each array over conditions."""
    return {array: max(g.get(array, 0.0) for g in groups) for array in sorted({a for g in groups for a in g})}


def difference(a: Mapping[str, FloatArray], b: Mapping[str, FloatArray]) -> FloatArray:
    """Tool tip [m], compensated force [N] and motor torques [N m] of a minus those of b, (n, 12)."""
    names = [f"{array}[{i}]" for array in (TRACKER, "sensor.f_T_T") for i in (1, 2, 3)]
    names += [f"drive.torque_motor[{i}]" for i in range(1, 7)]
    n = min(len(a[names[0]]), len(b[names[0]]))
    return np.stack([a[k][:n] - b[k][:n] for k in names], axis=1)


def padded(x: FloatArray, rows: int) -> FloatArray:
    """So many rows of [n, k]: cut off, or the last one repeated."""
    return x[np.minimum(np.arange(rows), len(x) - 1)]


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
