"""The second generator: a case of a cell that was written again from the papers; the same folders, columns and truth as the first one's.

`write_case` has the signature of `blind.generate.write_case`. A machine is drawn once for a case: tolerances, hidden constants, effects.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from robomill.blind.conditions import BLOCK, Condition, draw, load_table, planned
from robomill.blind.effects import BY_KEY, EFFECTS, EVEN
from robomill.blind.effects import draw as draw_effect
from robomill.blind.generate import HELD_REPEATS, OTHER_REPEATS, QUANTITIES, closure, detectability, difference, padded, write_run
from robomill.blind.prediction import LOGGING, Named
from robomill.blind.second import effects, logs, machine, outside
from robomill.blind.second.cell import STEP as FINE
from robomill.blind.second.cell import Cell, Log, shaft_torques, simulate
from robomill.blind.second.kernel import FloatArray
from robomill.blind.second.motion import followed
from robomill.blind.second.path import Played, play
from robomill.blind.second.sensing import CYCLE
from robomill.blind.sets import Plan
from robomill.blind.truth import TrueEffect, TrueFault, TrueOutside, Truth
from robomill.blind.world import TRACKER, nominal, simulate_nominal
from robomill.orchestration.errors import RunError

VERSION = 5
"""Version of this generator: numbers change only with it."""
LATE = (5e-3, 40e-3)
"""Delay [s] of the late clock of a machine, from and to."""
LATE_DEVICES = ("drive", "sensor", "controller", "compliance")
"""Devices whose clock may be late; the last one is the tracker."""
CAMPAIGN_STIFFNESS = 0.15
"""Smallest stiffness error that a campaign is asked to find."""
NOISE_F, NOISE_M, INSIDE_F, INSIDE_M = 1.0, 0.1, 0.4, 0.04
"""Noise of the sensor (white, by data sheet) and inside the loop (coloured): N and N m."""
PLACED = 5e-6
"""Standard deviation of the place of a new block [m]."""

Columns = dict[str, FloatArray]


@dataclass(frozen=True)
class Machine:
    """A machine: how it differs from the nominal cell, at any place."""

    seed: tuple[int, ...]
    """Where the draws of tolerances and hidden constants begin."""
    effects: tuple[TrueEffect, ...] = ()
    change: Callable[[Cell], Cell] | None = None
    """What is outside of the catalogue."""
    tolerances: bool = True
    """Whether calibrated numbers and hidden constants are its own; else it is the nominal cell."""

    def at(self, c: Condition) -> Cell:
        """The machine as it stands in a condition."""
        cell = machine.nominal(machine.Place(c.position, c.turn, BLOCK, c.mode, c.warm_up_time))
        random = np.random.default_rng(self.seed)
        if self.tolerances:
            cell, _ = machine.perturbed(cell, random)
            cell, _ = effects.constants(cell, random)
        cell = effects.switched_on(cell, self.effects)
        return cell if self.change is None else self.change(cell)

    def numbers(self, c: Condition) -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, Any]]]:
        """What is off, and the hidden constants that the models know, component -> parameter -> values."""
        random = np.random.default_rng(self.seed)
        cell, off = machine.perturbed(machine.nominal(machine.Place(c.position, c.turn, BLOCK, c.mode, c.warm_up_time)), random)
        return off, effects.constants(cell, random)[1]


def _load(c: Condition, t: FloatArray) -> FloatArray:
    """Wrench on the tool [n,6] that is applied on purpose."""
    if c.cuts:
        return np.zeros((len(t), 6))
    table = load_table(c)
    return np.stack([np.interp(t, table[:, 0], table[:, 1 + i]) for i in range(6)], axis=1)


def run(m: Machine, c: Condition, random: np.random.Generator | None = None) -> tuple[FloatArray, Columns]:
    """Times [s] and columns of a run; without `random` no noise and nothing that varies from run to run. RunError: it cannot be run."""
    cell = m.at(c)
    path = play(planned(c).table, FINE, cell.flexure.p_FT, machine.start_angles(), CYCLE)
    n = (len(path.t) - 1) // round(CYCLE / FINE) + 1
    noise, chance = np.zeros((n, 12)), np.full((n, 2), 0.5)
    if random is None:
        chance = np.random.default_rng(m.seed).random((n, 2))
    else:
        chance = random.random((n, 2))
        noise[:, :6] = random.standard_normal((n, 6)) * np.repeat([NOISE_F, NOISE_M], 3)
        tau = 0.05 * 4.0 ** random.random()
        for i in range(6):
            noise[:, 6 + i] = (INSIDE_F if i < 3 else INSIDE_M) * logs.coloured(n, tau, random)
        cell = cell._replace(
            cut=cell.cut._replace(
                p_BP=cell.cut.p_BP + PLACED * random.standard_normal(3),
                runout_angle=float(2.0 * np.pi * random.random()),
                start_angle=float(2.0 * np.pi * random.random()),
            )
        )
    late = followed(cell.drive, path.q, FINE)
    log = simulate(cell, path, late, float(cell.cut.size[2] - BLOCK[2]), noise, chance, _load(c, path.t))
    if not np.all(np.isfinite(log.tip)) or float(np.abs(log.tip - path.p[:: round(CYCLE / FINE)]).max()) > 0.02:
        raise RunError(
            f"condition {c.name!r}: the tool leaves its path by more than 20 mm; the loop of force and deflection has run away"
            "; choose a smaller depth of cut or feed",
            "compliance",
            path.t[-1],
        )
    return path.t[:: round(CYCLE / FINE)], _columns(cell, path, log, c)


def _columns(cell: Cell, path: Played, log: Log, c: Condition) -> Columns:
    """The logged columns under the names of the nominal cell."""
    rows = slice(None, None, round(CYCLE / FINE))
    found: Columns = {}
    arrays = {
        "path.p_BT_B": path.p[rows],
        "path.quat_BT": path.quaternion[rows],
        "path.q_ref": path.q[rows],
        "path.v_BT_B": path.v[rows],
        "drive.q_motor": log.q_motor,
        "drive.torque_motor": shaft_torques(cell, log),
        "sensor.f_S_raw": log.raw[:, :3],
        "sensor.m_S_raw": log.raw[:, 3:],
        "sensor.f_T_T": log.cleaned[:, :3],
        "sensor.m_T_T": log.cleaned[:, 3:],
        "controller.correction_B": log.correction,
        "controller.correction_q": np.zeros((len(log.tip), 6)),
        TRACKER: log.tip,
    }
    for name, values in arrays.items():
        for i in range(values.shape[1]):
            found[f"{name}[{i + 1}]"] = values[:, i].copy()
    found |= {"path.spindle_speed": path.spindle[rows], "path.block": path.block[rows], "path.path_time": path.time[rows]}
    if c.cuts:
        found["milling.spindle_torque"] = log.spindle_torque
    return found


def write_case(folder: Path, plan: Plan, seed: int, tier: str, attempt: int = 0) -> Truth:
    """Simulate a case and write its runs below cases/NNNN/runs; returns its truth. What only the generator knows goes to sealed/NNNN.

    RunError: a machine on which the program cannot be run; another `attempt` draws another one.
    """
    key = (VERSION, 2, seed, plan.number, attempt)
    random = np.random.default_rng([*key, 1])
    conditions = draw(seed, plan.shape, plan.number)
    truth, change, fault = _subject(plan, tier, random)
    m = Machine((*key, 0), truth.effects, change)
    off, hidden = m.numbers(conditions[0])
    truth = replace(
        truth, case=plan.number, tier=tier, generator="second", repeats=plan.repeats, machine=off, hidden=hidden, conditions=conditions
    )
    truth = _oracle(folder / "sealed" / f"{plan.number:04d}", truth, m, fault)
    runs = folder / "cases" / f"{plan.number:04d}" / "runs"
    shutil.rmtree(runs, ignore_errors=True)
    for c in conditions:
        _write_condition(runs, c, plan, m, (tier, fault, c is conditions[0]), random)
    return truth


def _write_condition(
    runs: Path, c: Condition, plan: Plan, m: Machine, how: tuple[str, logs.LogFault | None, bool], random: np.random.Generator
) -> None:
    """All runs of a condition; `how`: tier, fault of the log, and whether it is the first condition, which has held-out repeats, too."""
    tier, fault, first = how
    diagnosed = OTHER_REPEATS if c.held_out else plan.repeats
    kept: tuple[FloatArray, Columns] | None = None
    tau = float(0.1 * 4.0 ** random.random())
    for i in range(diagnosed + (HELD_REPEATS if first else 0)):
        t, columns = run(m, c, random)
        late_clocks(columns, t, m.effects)
        columns = logs.measured(columns, tier, tau, random)
        stamped = logs.stamps(t, random)
        if fault is not None:
            fault.apply(columns, t)
        held = not c.held_out and i >= plan.repeats
        if fault is not None and fault.kind in logs.PER_SET and first and not held:
            kept = kept or (stamped, columns)
            if fault.kind == "copies":
                stamped, columns = kept
            elif i == diagnosed - 1:
                part = int(fault.value * len(stamped))
                stamped, columns = stamped[:part], {n: v[:part] for n, v in columns.items()}
        number = i + 1 - plan.repeats if held else i + 1
        name = c.name.replace(" ", "-") + ("-held" if held else "")
        labels = {"condition": c.name, "repeat": number, "held_out": c.held_out or held, "tier": tier}
        write_run(runs / f"{name}-{number}", stamped, columns, c, labels)


def late_clocks(columns: Columns, t: FloatArray, true: Sequence[TrueEffect]) -> None:
    """What late clocks among the effects do to the log, in place."""
    for e in true:
        if not e.physical:
            device = e.parameter.partition(" ")[2].rstrip("*")
            logs.shift(columns, t, [n for n in columns if n.startswith(device)], e.value)


def _subject(plan: Plan, tier: str, random: np.random.Generator) -> tuple[Truth, Callable[[Cell], Cell] | None, logs.LogFault | None]:
    """Truth, change outside of the catalogue and fault of the log.

    Kinds of the latter two are this generator's own, whatever the plan says.
    """
    truth = Truth(plan.kind)
    if plan.kind in ("outside", "formed"):
        kinds = outside.FORMED if plan.kind == "formed" else outside.OUTSIDE
        kind = kinds[int(random.integers(len(kinds)))]
        value, change = kind.draw(random)
        return replace(truth, outside=TrueOutside(kind.name, kind.component, value, kind.unit)), change, None
    if plan.kind == "bad_log":
        fault = logs.draw(str(random.choice([*logs.LOG_FAULTS])), tier, random)
        truth = replace(truth, bad_log=TrueFault(fault.kind, fault.channel, fault.value, fault.unit))
        if random.random() < EVEN:  # a bad log with something real in it must be stopped just the same
            e = EFFECTS[int(random.integers(len(EFFECTS)))]
            truth = replace(truth, effects=(_effect(f"{e.component}.{e.name}", plan, tier, random),))
        return truth, None, fault
    return replace(truth, effects=tuple(_effect(text, plan, tier, random) for text in plan.subject)), None, None


def _effect(text: str, plan: Plan, tier: str, random: np.random.Generator) -> TrueEffect:
    """An effect of the subject of a plan, at the element that it names, or at any."""
    component, _, parameter = text.partition(".")
    named = Named.of(component, parameter)
    if component == LOGGING:
        device = LATE_DEVICES[int(random.integers(len(LATE_DEVICES) - (tier == "T0")))]
        value = float(LATE[0] * (LATE[1] / LATE[0]) ** random.random())
        return TrueEffect(LOGGING, named.effect, f"{named.effect} {device}.*", 0, value, "s", "clock")
    effect = BY_KEY[named.key]
    if plan.shape == "campaign" and named.effect == "stiffness_error":
        effect = replace(effect, low=CAMPAIGN_STIFFNESS)
    e = draw_effect(effect, random, named.index or None)
    form = effects.FORMS.get(named.key, "definition")
    return TrueEffect(e.effect.component, e.effect.name, e.parameter, e.index, e.value, e.effect.unit, form)


def _oracle(sealed: Path, truth: Truth, m: Machine, fault: logs.LogFault | None) -> Truth:
    """The truth with what only the generator can know: how far everything stands out, and what adopting the true parameters would close.

    `<condition>.npy` in `sealed`: float32[n, 12], noise-free minus nominal; late clocks are not in it.
    """
    sealed.mkdir(parents=True, exist_ok=True)
    given = [c for c in truth.conditions if not c.held_out]
    bare = replace(m, effects=(), change=None)
    usual, without = [nominal(c).columns for c in given], [run(bare, c)[1] for c in given]

    def logged(who: Machine, c: Condition) -> tuple[FloatArray, Columns]:
        t, columns = run(who, c)
        late_clocks(columns, t, who.effects)
        return t, columns

    def ratios(what: Sequence[Columns], against: Sequence[Columns]) -> dict[str, float]:
        found: dict[str, float] = {}
        for a, b, u in zip(what, against, usual, strict=True):
            for array, ratio in detectability(a, b, u, truth.tier).items():
                found[array] = max(found.get(array, 0.0), ratio)
        return found

    everything = [logged(m, c) for c in given] if m.effects or m.change else [(np.zeros(0), w) for w in without]
    groups = ratios([w for _, w in everything], without)
    true = truth.effects
    if len(true) == 1:
        true = (replace(true[0], detectability=max(groups.values())),)
    elif len(true) > 1:
        alone = [[logged(replace(m, effects=(e,), change=None), c)[1] for c in given] for e in true]
        true = tuple(replace(e, detectability=max(ratios(a, without).values())) for e, a in zip(true, alone, strict=True))
    bad_log = truth.bad_log
    if fault is not None and bad_log is not None and fault.kind not in logs.PER_SET:
        faulty = [{n: v.copy() for n, v in w.items()} for _, w in everything]
        for columns in faulty:
            fault.apply(columns, CYCLE * np.arange(len(columns["path.path_time"]), dtype=np.float64))
        bad_log = replace(bad_log, detectability=max(ratios(faulty, [w for _, w in everything]).values()))
    ceiling = {}
    instances = [e.instance for e in true if e.physical]
    for c in truth.conditions:
        if c.held_out:
            _, clean = run(m, c)
            gap = difference(clean, nominal(c).columns)
            np.save(sealed / f"{c.name.replace(' ', '-')}.npy", gap.astype(np.float32))
            if truth.kind == "formed":  # what the law itself does to the nominal cell; not what else this world does otherwise
                usual_one, bent = (run(replace(m, tolerances=False, change=x), c)[1] for x in (None, m.change))
                after = gap - padded(difference(bent, usual_one), len(gap))
                ceiling[c.name] = {quantity: closure(gap[:, part], after[:, part]) for quantity, part in QUANTITIES.items()}
            elif instances:
                after = difference(clean, simulate_nominal(c, instances, truth.hidden).columns)
                ceiling[c.name] = {quantity: closure(gap[:, part], after[:, part]) for quantity, part in QUANTITIES.items()}
    largest = max(groups.values())
    return replace(truth, effects=true, bad_log=bad_log, detectability=largest, detectability_by_array=groups, ceiling=ceiling)
