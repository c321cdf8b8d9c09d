"""The generator: what is in a benchmark, and that it is what it says."""

from __future__ import annotations

import json
import math
from collections import Counter

import numpy as np
import pytest

from robomill.blind import bad_logs, generate, outside
from robomill.blind.conditions import _TRAINING as TRAINING
from robomill.blind.conditions import Condition, draw, planned
from robomill.blind.effects import BY_KEY, EFFECTS
from robomill.blind.effects import draw as draw_effect
from robomill.blind.force_averaging import felt
from robomill.blind.generate import PROPORTIONS, closure, detectability, difference, make, make_case, plans
from robomill.blind.outside import Changes
from robomill.blind.run import run_cases
from robomill.blind.score import score
from robomill.blind.sealing import BenchmarkError, hashes
from robomill.blind.world import MEASURED, TRACKER, Machine, coloured, draw_machine, jittered, measure, nominal, simulate
from robomill.fmus.components import COMPONENTS
from robomill.fmus.instance import ComponentError
from robomill.models.model.declaration import Model, record
from robomill.models.robot.kinematics import ROBOT_VARIABLES, jacobian
from robomill.orchestration.errors import RunError
from robomill.orchestration.runs.run import Run
from tests.tolerances import ROUNDOFF, chance, discretisation, of_mean, of_variance

SOURCES = {
    "drive": "robot_drive",
    "compliance": "robot_compliance",
    "milling": "milling_force",
    "sensor": "sensor_chain",
    "controller": "compensation_controller",
}
SHORT = Condition("short", (1.3, 0.0, 1.2), 180.0, 0.004, 0.06, reversals=False)


class TestEffects:
    def test_every_effect_parameter_of_every_component_is_in_the_table_and_nothing_else(self):
        declared = {f"{c}.{v.name}": v.shape for c, source in SOURCES.items() for v in COMPONENTS[source].variables if v.effect}
        assert {k: (e.size,) if e.size else () for k, e in BY_KEY.items()} == declared

    @pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: f"{e.component}.{e.name}")
    def test_units_and_bounds_are_those_of_the_component(self, effect):
        v = COMPONENTS[SOURCES[effect.component]].variable(effect.name)
        random = np.random.default_rng(1)
        values = [draw_effect(effect, random).value for _ in range(200)]
        assert v.unit == effect.unit
        assert v.minimum <= min(values)
        assert max(values) <= v.maximum

    def test_strengths_are_log_uniform(self):
        effect = BY_KEY["compliance.payload_error"]
        random = np.random.default_rng(2)
        logs = np.log([draw_effect(effect, random).value for _ in range(4000)])
        place = (logs - math.log(effect.low)) / math.log(effect.high / effect.low)
        # a uniform variable: mean 1/2, variance 1/12, fourth moment 9/5 of the squared variance (3 of a normal one)
        assert np.mean(place) == pytest.approx(0.5, abs=chance(math.sqrt(1 / 12) * of_mean(4000)))
        assert np.var(place) == pytest.approx(1 / 12, rel=chance(math.sqrt(0.8) * of_mean(4000)))

    def test_signs_are_even(self):
        effect = BY_KEY["compliance.stiffness_error"]
        random = np.random.default_rng(3)
        negative = np.mean([draw_effect(effect, random).value < 0.0 for _ in range(400)])
        assert negative == pytest.approx(0.5, abs=chance(0.5 * of_mean(400)))  # EVEN

    def test_the_wrist_begins_behind_the_third_axis(self):
        effect = BY_KEY["drive.friction_coulomb"]
        assert [effect.factor(i) for i in range(1, 7)] == [1.0, 1.0, 1.0, 0.3, 0.3, 0.3]  # ARM


class TestPlans:
    def test_proportions(self):
        counts = Counter(p.kind for p in plans(240, 1))
        assert counts.total() == 240
        assert all(abs(counts[kind] - share * 240) < 1.0 for kind, share in PROPORTIONS.items())

    def test_every_effect_comes_about_as_often_as_any_other(self):
        counts = Counter(p.subject[0] for p in plans(240, 1) if p.kind == "single")
        assert set(counts) == set(BY_KEY)
        assert max(counts.values()) - min(counts.values()) <= 1

    def test_every_kind_of_unknown_and_of_bad_log_comes(self):
        made = plans(240, 1)
        assert {p.subject[0] for p in made if p.kind == "outside"} == set(outside.OUTSIDE_BY_NAME)
        assert {p.subject[0] for p in made if p.kind == "bad_log"} == set(bad_logs.LOG_FAULTS)

    def test_the_number_of_a_case_says_nothing_and_the_seed_all(self):
        assert plans(60, 3) == plans(60, 3)
        assert [p.kind for p in plans(60, 3)] != [p.kind for p in plans(60, 4)]
        with pytest.raises(ValueError, match="expected at least 1"):
            plans(0, 1)

    def test_at_least_eight_kinds_lie_outside_of_the_catalogue(self):
        assert len(outside.OUTSIDE_BY_NAME) >= 8
        assert not set(outside.OUTSIDE_BY_NAME) & {e.name for e in EFFECTS}


class TestConditions:
    @pytest.mark.parametrize("number", range(len(TRAINING)))
    def test_held_out_conditions_differ_and_all_take_seconds(self, number):
        class Fixed:
            def integers(self, _):
                return number

        main, other_cut, other_place = draw(Fixed())
        assert other_cut.depth != main.depth
        assert min(c.depth for c in TRAINING) <= other_cut.depth <= max(c.depth for c in TRAINING)  # MIDDLE_DEPTH
        assert other_cut.feed != main.feed
        assert other_cut.turn != main.turn
        assert other_place.position != main.position
        assert all(3.0 < planned(c).duration < 10.0 for c in (main, other_cut, other_place))


class TestWorld:
    def test_a_machine_without_effects_is_close_to_the_nominal_one_but_not_equal(self):
        _, columns, _ = simulate(SHORT, draw_machine(np.random.default_rng(1)), (), Changes(), None)
        gap = difference(columns, nominal(SHORT).columns)[:, 1]
        assert 1e-7 < np.sqrt(np.mean(gap**2)) < 40e-6

    def test_the_finer_step_alone_changes_micrometres(self):
        _, columns, _ = simulate(SHORT, Machine({}), (), Changes(), None)
        gap = difference(columns, nominal(SHORT).columns)[:, 1]
        assert 1e-7 < np.sqrt(np.mean(gap**2)) < 10e-6

    def test_tier_t0_is_t1_without_the_tracker(self):
        t, columns, _ = simulate(SHORT, Machine({}), (), Changes(), None)
        full, less = (measure(columns, tier, np.random.default_rng(4)) for tier in ("T1", "T0"))
        assert {n.partition("[")[0] for n in full} == {*MEASURED, TRACKER}
        assert {n.partition("[")[0] for n in less} == set(MEASURED)
        assert all(np.array_equal(full[n], less[n]) for n in less)
        assert len(t) == len(less["path.block"])

    def test_coloured_noise_has_unit_variance_and_its_correlation_time(self):
        x = coloured(200_000, 0.2, np.random.default_rng(5))
        # effective sample size for products: n (1 - a^2)/(1 + a^2) with a = exp(-h/tau) = 0.98
        error = of_variance(200_000 * 0.02)
        assert np.var(x) == pytest.approx(1.0, abs=chance(error))
        assert np.mean(x[50:] * x[:-50]) == pytest.approx(math.exp(-1.0), abs=chance(error))  # at most (Bartlett)

    def test_timestamps_increase_from_zero(self):
        t = jittered(np.arange(2000) * 0.004, np.random.default_rng(6))
        assert t[0] == 0.0
        assert np.all(np.diff(t) > 0.0)
        # neighbouring differences are correlated by -1/2: n / 1.5 count
        assert np.std(np.diff(t)) == pytest.approx(math.sqrt(2) * 3e-5, rel=chance(0.5 * of_variance(2000 / 1.5)))


class TestFelt:
    def slave(self, noise=None):
        slave = felt(noise)()
        slave.initialise(0.0, 1.0, 0.002)
        return slave

    def test_the_sensor_gets_the_mean_of_two_steps_and_the_noise_of_the_step(self):
        noise = np.random.default_rng(3).standard_normal((4, 6))
        u, y, felt_values = np.random.default_rng(4).standard_normal((5, 6)), np.zeros(6), []
        slave = self.slave(noise)
        slave.set_inputs(u[0])
        slave.get_outputs(y)
        np.testing.assert_array_equal(y, u[0])
        for k in range(1, 5):
            slave.set_inputs(u[k])
            slave.step(0.002 * (k - 1), 0.002)
            slave.get_outputs(y)
            felt_values.append(y.copy())
        before = u[[1, 1, 2, 3]]  # a component begins with the inputs of its first step
        np.testing.assert_allclose(felt_values, (u[1:] + before) / 2.0 + noise, rtol=0, atol=4 * ROUNDOFF)

    def test_a_run_that_is_longer_than_its_noise_is_refused(self):
        slave = self.slave(np.zeros((1, 6)))
        slave.step(0.0, 0.002)
        with pytest.raises(ComponentError, match=r"the run is longer than its noise \(1 steps\)"):
            slave.step(0.002, 0.002)


class TestOutside:
    @pytest.mark.parametrize("kind", outside.OUTSIDE, ids=lambda k: k.name)
    def test_each_changes_what_is_measured_clearly_at_the_middle_of_its_range(self, kind):
        c = TRAINING[0]
        changes = kind.make(math.sqrt(kind.low * kind.high), np.random.default_rng(7))
        _, with_it, _ = simulate(c, Machine({}), (), changes, None)
        _, without, _ = simulate(c, Machine({}), (), Changes(), None)
        assert max(detectability(with_it, without, nominal(c).columns, "T1").values()) > 1.0

    @pytest.mark.parametrize(("back", "rings"), [(0.7e-6, False), (1.5e-6, True)])
    def test_an_axis_that_goes_back_by_noise_does_not_ring(self, back, rings):
        link = outside.OUTSIDE_BY_NAME["reversal_ringing"].make(1e-4, np.random.default_rng(1)).link()
        there, reversed_ = np.full(9, 1e-3), np.full(9, 1e-3 - back)
        for k, u in enumerate((np.zeros(9), there, reversed_)):
            link(0.004 * k, 0.004, u)
        assert bool(np.any(link(0.02, 0.004, reversed_) != reversed_[:6])) is rings  # MOVES

    @pytest.mark.parametrize(("force", "packs"), [(15.0, False), (30.0, True)])
    def test_chips_pack_only_where_they_are_made(self, force, packs):
        cut = outside.OUTSIDE_BY_NAME["chip_packing"].make(0.3, np.random.default_rng(1)).cut()
        u = np.array([0.0, -force, 0.0, 0.0, 0.0, 0.0])
        assert bool(np.any(cut(0.0, 0.004, u) != u)) is packs  # CHIPS

    def test_joint_torques_are_those_of_the_jacobian_of_the_models(self):
        model = Model("robot", "kinematics", ROBOT_VARIABLES, lambda s: 0, lambda s, t, h: 0)
        s = record(model.new())
        random = np.random.default_rng(8)
        for _ in range(20):
            q, f, J = random.uniform(-1.0, 1.0, 6), random.normal(size=3), np.zeros((6, 6))
            jacobian(s, q, J)
            np.testing.assert_allclose(outside.joint_torques(q, f), J[:3].T @ f, rtol=0, atol=1e3 * ROUNDOFF)

    def test_bouc_wen_has_the_lost_motion_that_it_is_given(self):
        width, torque = 100e-6, 94.0
        link = outside.bouc_wen(0, width, torque).link()
        q = np.array([0.0, -1.6, 2.0, 0.0, -0.4, 0.0])
        direction = np.array([0.0, 1.0, 0.0])
        lever = outside.joint_torques(q, direction)[0]
        force = np.concatenate([np.linspace(0, 6, 300), np.linspace(6, -6, 600), np.linspace(-6, 6, 600)]) * torque / lever
        moved = np.array([link(0.0, 0.002, np.concatenate([q, direction * f]))[0] for f in force])
        down, up = moved[600], moved[1200]  # zero torque on the way down and up
        # of the derivative 1 / (cosh(1)^2 tanh(1)) = 0.55: the force is half a step of 0.02 beside zero, z is exp(-5) short of 1
        near = discretisation(0.6, 0.01 + math.exp(-5.0), 1)
        assert down == pytest.approx(width, rel=near)
        assert up == pytest.approx(-width, rel=near)

    def test_dahl_goes_over_into_coulomb_friction(self):
        t = np.arange(500) * 0.004
        columns = {"drive.q_motor[2]": 0.1 * t, "drive.torque_motor[2]": np.zeros(500)}
        changes = outside.dahl(1, 300.0)
        changes.after(columns, t, 0.004)
        assert columns["drive.torque_motor[2]"][-1] * outside.GEAR[1] == pytest.approx(300.0, rel=ROUNDOFF)

    def test_two_inserts_at_one_place_are_refused(self):
        with pytest.raises(ValueError, match="two inserts at 'link'"):
            outside.merged([outside.bouc_wen(0, 1e-4, 94.0), outside.bouc_wen(1, 1e-4, 94.0)])


class TestBadLogs:
    @pytest.mark.parametrize("kind", bad_logs.LOG_FAULTS)
    def test_each_touches_the_channel_it_names_and_no_other(self, kind):
        random = np.random.default_rng(9)
        for _ in range(5):
            t = np.arange(1000) * 0.004
            columns = {f"{a}[{i}]": np.sin(t * (i + 1) + k) for k, a in enumerate(bad_logs.VECTORS) for i in (1, 2, 3)}
            before = {n: v.copy() for n, v in columns.items()}
            fault = bad_logs.draw(kind, "T1", random)
            fault.apply(columns, t)
            changed = {n for n in columns if not np.array_equal(columns[n], before[n])}
            assert changed
            assert all(n.partition("[")[0] == fault.channel.partition("[")[0] for n in changed)

    def test_at_t0_no_fault_is_in_the_tracker(self):
        random = np.random.default_rng(10)
        assert all(not bad_logs.draw(kind, "T0", random).channel.startswith(TRACKER) for kind in bad_logs.LOG_FAULTS for _ in range(20))


def test_a_machine_that_cannot_run_is_drawn_five_times(monkeypatch, tmp_path):
    """ATTEMPTS"""
    tried = []

    def fails(*_):
        tried.append(1)
        raise RunError("out of reach", "drive", 0.0)

    monkeypatch.setattr(generate, "_attempt", fails)
    with pytest.raises(RunError, match="out of reach"):
        make_case(tmp_path, generate.Plan(1, "null"), 1, "T1")
    assert len(tried) == 5


def test_closure_is_one_minus_the_ratio_of_mean_squares():
    assert closure(np.array([2.0, -2.0]), np.array([1.0, 1.0])) == 0.75
    assert closure(np.zeros(3), np.zeros(3)) == 0.0


def test_a_folder_of_another_benchmark_and_an_unknown_tier_are_refused(tmp_path):
    (tmp_path / "request.json").write_text(json.dumps({"seed": 1}))
    with pytest.raises(ValueError, match="holds another benchmark"):
        make(tmp_path, 2, 1, "T1")
    with pytest.raises(ValueError, match="'T2': expected one of T0, T1"):
        make(tmp_path, 2, 1, "T2")


@pytest.mark.slow
def test_a_benchmark_from_making_to_score_and_the_same_bits_again(tmp_path):
    first, again = tmp_path / "a", tmp_path / "b"
    made = make(first, 2, 11, "T1")
    for plan in plans(2, 11):
        make_case(again, plan, 11, "T1")
    assert hashes(again / "cases") == made.files
    assert hashes(again / "sealed") == json.loads((first / "sealed" / "manifest.json").read_text())

    case = first / "cases" / "0001"
    runs = [Run.load(f) for f in sorted((case / "runs").iterdir())]
    assert Counter((r.info["labels"]["condition"], r.info["labels"]["held_out"]) for r in runs) == {
        ("training", False): 6,
        ("training", True): 2,
        ("other cut", True): 2,
        ("other place", True): 2,
    }
    assert not any("sealed" in f.name or "effect" in f.read_text() for f in case.rglob("*.toml"))

    report = run_cases(first, say_none, workers=1)
    assert (report["done"], report["failed"]) == (2, {})
    assert run_cases(first, say_none, workers=1)["before"] == 2
    result = score(first, isolability=False, baselines=False)
    assert result.predictions_as_first_unsealed
    assert result.cases == 2
    with pytest.raises(BenchmarkError, match="has been unsealed"):
        run_cases(first, say_none)


def say_none(case, out):
    """A diagnosis that never finds anything."""
    assert (case / "system.toml").is_file()
    (out / "diagnosis.json").write_text(json.dumps({"verdict": "none", "which": []}))


def test_a_diagnosis_that_fails_is_reported_and_tried_again(tmp_path):
    (tmp_path / "cases" / "0001").mkdir(parents=True)
    (tmp_path / "benchmark.json").write_text("{}")
    for _ in range(2):
        report = run_cases(tmp_path, fail, workers=1)
        assert report["failed"] == {"0001": "RuntimeError: no idea"}
        assert "Traceback" in (tmp_path / "predictions" / "0001" / "error.txt").read_text()


def fail(case, out):
    """A diagnosis that raises."""
    raise RuntimeError("no idea")
