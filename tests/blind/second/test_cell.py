"""The whole cell of the second generator beside robomill's nominal simulation, its effects, and the cases that it writes."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from robomill.blind.conditions import Condition
from robomill.blind.effects import BY_KEY
from robomill.blind.generate import ARRAYS
from robomill.blind.make import Request, make
from robomill.blind.second import effects, generate, logs, outside
from robomill.blind.second.kernel import folder_of
from robomill.blind.second.machine import INERTIA_STEPS
from robomill.blind.sets import Plan
from robomill.blind.truth import TrueEffect
from robomill.blind.world import TRACKER, nominal
from robomill.orchestration.runs.run import Run
from tests.tolerances import EXACT, chance, of_mean

SHORT = Condition("short", (1.3, 0.0, 1.2), 180.0, 0.004, 0.06, reversals=False)
AIR = Condition("air", (1.45, 0.25, 1.05), 90.0, feed=0.04, program="air")
PUSH = Condition("push", (1.3, 0.0, 1.2), 180.0, mode=0, program="hold", push=700.0)
POSES = Condition("poses", (1.25, -0.35, 1.10), 180.0, mode=0, program="poses", weight=30.0)
AGREES = {
    TRACKER: 20e-6,
    "drive.q_motor": 25e-6,
    "drive.torque_motor": 0.1,
    "sensor.f_S_raw": 8.0,
    "sensor.m_S_raw": 1.5,
    "sensor.f_T_T": 6.0,
    "sensor.m_T_T": 0.2,
    "controller.correction_B": 10e-6,
    "milling.spindle_torque": 0.1,
}
"""Rms by which a cell without tolerances may differ from robomill's: the force reaches the arm 3 to 7 ms after it acts, there 4 to 8 ms
(2 um/N at 1 N/ms: 10 um); the backlash compensation takes its sign from motions of single micrometres (30 urad for a part of the time);
a slice of the cut at the rim of the block is half a cell of 0.5 mm."""


OLDER = 1e-3
"""Relative: the mean torque of a slot whose arm yields 3 ms later; only where it enters and leaves the block is that seen."""


def column(columns, array):
    return np.stack([v for n, v in columns.items() if n.partition("[")[0] == array], axis=1)


def true(key, value, index=0):
    e = BY_KEY[key]
    name = f"{e.name}[{index}]" if e.size else e.name
    return TrueEffect(e.component, e.name, name, index if e.size else 0, value, e.unit)


def bare(seed=1):
    return generate.Machine((seed,))


def slot(steps, *true_effects):
    """Columns of a slot without tolerances, whose arm takes the mean of the force over so many fine steps."""
    machine = generate.Machine((1,), true_effects, lambda cell: cell._replace(inertia_steps=steps), tolerances=False)
    return generate.run(machine, SHORT)[1]


@pytest.mark.slow
def test_arms_of_any_inertia_show_the_same_tip():
    usual = column(slot(INERTIA_STEPS[0]), TRACKER)
    away = {steps: float(np.sqrt(np.mean((column(slot(steps), TRACKER) - usual) ** 2))) for steps in (*INERTIA_STEPS, 3)}
    assert max(away[steps] for steps in INERTIA_STEPS) < 10e-6  # the force is 3 ms older: 2 um/N at 1 N/ms for a part of the time
    assert away[3] > 15e-6  # one and a half teeth: logged every 4 ms, they show one phase of them


@pytest.mark.slow
def test_arms_of_any_inertia_follow_no_turn_of_the_spindle():
    """With a runout teeth differ: an arm that follows each of them swings in the cut, and cuts less."""
    runout = true("milling.runout", 20e-6)
    torque = {steps: slot(steps, runout)["milling.spindle_torque"].mean() for steps in (*INERTIA_STEPS, 2)}
    usual = torque[INERTIA_STEPS[0]]
    assert all(torque[steps] == pytest.approx(usual, rel=OLDER) for steps in INERTIA_STEPS)
    assert torque[2] < 0.98 * usual


def test_the_load_of_the_sensor_has_stood_before_the_run_begins():
    """It has no acceleration as if it came from the origin of the base, 1.5 m in a cycle: that would be 1e5 m/s2."""
    heavy, light = (
        column(generate.run(generate.Machine((1,), some, tolerances=False), AIR)[1], "sensor.f_S_raw")
        for some in ((true("sensor.inertia", 0.4),), ())
    )
    away = np.abs(heavy - light).max(axis=1)
    assert away[0] < 1e-2
    assert 1.0 < away.max() < 200.0  # 0.4 of 20 kg or so at 20 m/s2: axes jump across their gaps, 0.1 mm at the tool in a cycle


class TestNominal:
    @pytest.mark.slow
    @pytest.mark.parametrize("c", [SHORT, AIR, PUSH, POSES], ids=lambda c: c.name)
    def test_the_cell_agrees_with_the_nominal_simulation(self, c):
        _, columns = generate.run(generate.Machine((1,), tolerances=False), c)
        reference = nominal(c).columns
        for array, bound in AGREES.items():
            if array == "milling.spindle_torque" and not c.cuts:
                continue
            ours, theirs = column(columns, array), column(reference, array)
            n = min(len(ours), len(theirs))
            assert np.sqrt(np.mean((ours[:n] - theirs[:n]) ** 2, axis=0)).max() < bound, array
        assert abs(len(ours) - len(theirs)) <= 1

    @pytest.mark.slow
    def test_the_path_is_the_planned_one(self):
        _, columns = generate.run(bare(), SHORT)
        reference = nominal(SHORT).columns
        for array in ("path.p_BT_B", "path.quat_BT", "path.path_time", "path.block"):
            ours, theirs = column(columns, array), column(reference, array)
            assert np.abs(ours - theirs).max() < 1e-12, array


CHANGES = {
    "compliance": (TRACKER,),
    "drive": ("drive.q_motor", "drive.torque_motor", TRACKER),
    "sensor": ("sensor.f_S_raw", "sensor.m_S_raw", "sensor.f_T_T"),
    "controller": ("controller.correction_B", TRACKER),
    "milling": ("sensor.f_S_raw", "milling.spindle_torque", TRACKER),
}
"""Channels of which an effect of a component changes at least one."""
LITTLE = {
    TRACKER: 2e-6,
    "drive.q_motor": 5e-6,
    "drive.torque_motor": 0.02,
    "sensor.f_S_raw": 1.0,
    "sensor.m_S_raw": 0.1,
    "sensor.f_T_T": 1.0,
}
LITTLE |= {"controller.correction_B": 2e-6, "milling.spindle_torque": 0.02}
"""A change that is seen: largest over the run."""
WHERE = {
    "drive.friction_stribeck": SHORT,
    "compliance.mode_compliance": PUSH,
    "compliance.gear_friction": PUSH,
    "compliance.gear_hysteresis": PUSH,
}


class TestEffects:
    def test_every_effect_of_the_benchmark_is_made(self):
        assert set(effects.SWITCHES) == set(BY_KEY)
        assert set(effects.FORMS) <= set(BY_KEY)
        assert len(effects.FORMS) * 2 >= len(BY_KEY)

    @pytest.mark.slow
    @pytest.mark.parametrize("key", BY_KEY)
    def test_an_effect_changes_the_channels_of_its_component(self, key):
        e = BY_KEY[key]
        c = WHERE.get(key, SHORT)
        c = replace(c, depth=0.009, feed=0.03) if key in ("controller.correction_limit", "sensor.clipping") else c
        _, without = generate.run(bare(), c)
        _, with_it = generate.run(replace(bare(), effects=(true(key, e.high, 2 if e.size else 0),)), c)
        seen = {a: np.abs(column(with_it, a) - column(without, a)).max() for a in CHANGES[e.component]}
        assert any(seen[a] > LITTLE[a] for a in seen), seen

    @pytest.mark.slow
    def test_a_static_push_bends_a_softer_joint_by_its_share(self):
        _, without = generate.run(bare(), PUSH)
        _, soft = generate.run(replace(bare(), effects=(true("compliance.stiffness_error", -0.2, 1),)), PUSH)
        # along x, to and fro, and back; then 700 N along y are held
        k = int((0.3 + 0.25 + 0.35 + 0.25 + 0.35 + 0.5 + 0.25 + 0.2) / 0.004)
        change = column(soft, TRACKER)[k] - column(without, TRACKER)[k]
        f, q = 700.0, column(without, "drive.q_motor")[k]
        lever = math.hypot(*column(without, TRACKER)[k][:2])
        x = column(without, TRACKER)[k][0]
        stiffness = 7.5e6
        expected = f * x * lever * (1.0 / 0.8 - 1.0) / stiffness  # moment f x about the column, way lever
        assert np.linalg.norm(change[:2]) == pytest.approx(expected, rel=TOLERANCE)
        assert q[0] == pytest.approx(column(soft, "drive.q_motor")[k][0], abs=EXACT)

    def test_an_effect_that_is_not_made_is_an_error(self):
        e = replace(true("drive.backlash", 1e-4, 1), effect="wobble")
        with pytest.raises(LookupError, match=r"effect 'drive.wobble': the second generator makes compliance.base_compliance"):
            effects.switched_on(bare().at(SHORT), [e])


TOLERANCE = 0.04
"""A machine's stiffness is off by 1 %, and three standard deviations of it and of the load at the sample are looked at."""


class TestOutside:
    @pytest.mark.slow
    @pytest.mark.parametrize("kind", outside.OUTSIDE, ids=lambda k: k.name)
    def test_every_kind_changes_something_that_is_measured(self, kind):
        _, change = replace(kind, low=kind.high).draw(np.random.default_rng(4))
        c = PUSH if kind.name in ("stiction", "two_stage_creep", "lobed_gear") else SHORT
        _, without = generate.run(bare(), c)
        _, with_it = generate.run(replace(bare(), change=change), c)
        assert any(np.abs(column(with_it, a) - column(without, a)).max() > little for a, little in LITTLE.items() if a in _arrays(without))


def _arrays(columns):
    return {n.partition("[")[0] for n in columns} & set(ARRAYS)


class TestLogs:
    def test_stamps_of_good_logs_grow_and_begin_at_zero_or_late(self):
        t = 0.004 * np.arange(2000)
        first = []
        for seed in range(40):
            stamped = logs.stamps(t, np.random.default_rng(seed))
            assert np.all(np.diff(stamped) > 0.0)
            assert np.abs(stamped[1:] - t[1:]).max() < 1.5e-3
            first.append(stamped[0])
        assert max(first) <= logs.LATE_START
        assert sum(f > 0.0 for f in first) == pytest.approx(20, abs=chance(40 * 0.5 * of_mean(40)))

    def test_coloured_noise_has_unit_variance_and_its_memory(self):
        x = logs.coloured(200_000, 0.04, np.random.default_rng(1))
        independent = 200_000 / 20  # two correlation times of ten samples
        assert np.var(x) == pytest.approx(1.0, abs=chance(math.sqrt(2.0 / independent)))
        assert np.mean(x[10:] * x[:-10]) == pytest.approx(math.exp(-1.0), abs=chance(of_mean(independent)))

    @pytest.mark.parametrize("kind", [k for k in logs.LOG_FAULTS if k not in logs.PER_SET])
    @pytest.mark.parametrize("tier", ["T0", "T1"])
    def test_a_fault_changes_its_array_and_nothing_else(self, kind, tier):
        t = 0.004 * np.arange(500)
        for seed in range(8):
            fault = logs.draw(kind, tier, np.random.default_rng(seed))
            arrays = logs.ARRAYS if tier == "T1" else logs.ARRAYS[1:]
            columns = {f"{a}[{i}]": np.sin(3.0 * t + i) + i for a in arrays for i in (1, 2, 3)}
            before = {n: v.copy() for n, v in columns.items()}
            fault.apply(columns, t)
            changed = {n for n in columns if not np.array_equal(columns[n], before[n])}
            assert changed
            device = fault.channel.partition("[")[0]
            assert all(n.startswith(device) for n in changed)

    def test_an_unknown_fault_is_an_error(self):
        with pytest.raises(LookupError, match=r"fault 'gremlin' of the log: expected one of lag, late_clock, sign"):
            logs.draw("gremlin", "T1", np.random.default_rng(1))


class TestCases:
    @pytest.mark.slow
    def test_a_case_is_read_as_any_other_and_the_same_again(self, tmp_path):
        for name in ("a", "b"):
            make(tmp_path / name, Request(2, 3, set="few", generator="second"))
        one, two = ((tmp_path / name / "benchmark.json").read_text() for name in ("a", "b"))
        assert json.loads(one) == json.loads(two)
        truth = json.loads((tmp_path / "a" / "sealed" / "0001.json").read_text())
        assert truth["generator"] == "second"
        run = Run.load(tmp_path / "a" / "cases" / "0001" / "runs" / "training-1")
        assert set(run.columns) >= {"compliance.p_BT_B[1]", "milling.spindle_torque", "path.quat_BT[4]", "controller.correction_q[6]"}

    @pytest.mark.slow
    @pytest.mark.parametrize("kind", ["copies", "aborted"])
    def test_faults_of_a_set_of_runs(self, tmp_path, kind):
        seed = next(s for s in range(200) if drawn(s) == kind)
        truth = generate.write_case(tmp_path, Plan(1, "bad_log", ("lag",), 2, "cuts", "second"), seed, "T1")
        assert truth.aborted_run == ("training-2" if kind == "aborted" else "")
        runs = tmp_path / "cases" / "0001" / "runs"
        first, last = (Run.load(runs / f"training-{i}") for i in (1, 2))
        if kind == "copies":
            assert all(np.array_equal(v, last.columns[n]) for n, v in first.columns.items())
        else:
            assert 0.25 < len(last.t) / len(first.t) < 0.85


def drawn(seed):
    """The fault of a bad log of that seed."""
    plan = Plan(1, "bad_log", ("lag",), 2, "cuts", "second")
    truth, _, _ = generate._subject(plan, "T1", np.random.default_rng([generate.VERSION, 2, seed, 1, 0, 1]))
    return truth.bad_log.kind


def test_other_sources_are_compiled_into_another_folder(tmp_path):
    (tmp_path / "a.py").write_text("x = 1\n")
    first = folder_of(tmp_path)
    assert folder_of(tmp_path) == first
    (tmp_path / "a.py").write_text("x = 2\n")
    assert folder_of(tmp_path) != first
