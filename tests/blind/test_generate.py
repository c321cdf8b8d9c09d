"""The first generator: conditions, effects, machines, logs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robomill.blind import bad_logs, outside
from robomill.blind.conditions import GRAVITY, MIDDLE_DEPTH, POOL, SHAPES, Condition, draw, known, load_table, planned
from robomill.blind.effects import BY_KEY, EFFECTS, Instance
from robomill.blind.effects import draw as draw_effect
from robomill.blind.force_averaging import felt
from robomill.blind.generate import closure, detectability, difference
from robomill.blind.outside import Changes
from robomill.blind.world import (
    MEASURED,
    TRACKER,
    Machine,
    coloured,
    draw_hidden,
    draw_machine,
    jittered,
    measure,
    nominal,
    simulate,
)
from robomill.blind_command import CATALOGUE
from robomill.diagnosis.catalogue import Catalogue
from robomill.fmus.components import COMPONENTS
from robomill.fmus.instance import ComponentError
from robomill.models.model.declaration import Model, record
from robomill.models.robot.kinematics import ROBOT_VARIABLES, jacobian
from tests.tolerances import ROUNDOFF, chance, discretisation, of_mean, of_variance

SOURCES = {
    "drive": "robot_drive",
    "compliance": "robot_compliance",
    "milling": "milling_force",
    "sensor": "sensor_chain",
    "controller": "compensation_controller",
}
SEEN_BY_THE_NEXT = 1e-3
"""Relative: axes that were moved by 1e-4 rad change a torque of hundreds of N m by less than 0.1."""
LEFT_OUT = {
    ("compliance", "mode_direction"): "three numbers, of which the answer is no sum: a grid that is fine enough would be too large",
    ("sensor", "zero_drift_time"): "longer than the runs, in which the drift is a line",
}
"""Hidden constants that no shape or phase of the catalogue stands for, and why."""
TRAINING = Condition("training", (1.3, 0.0, 1.2), 180.0, 4e-3, 0.04)
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


class TestConditions:
    @pytest.mark.parametrize("shape", SHAPES)
    def test_conditions_belong_to_the_seed_and_all_take_seconds(self, shape):
        for number in range(POOL):
            found = draw(3, shape, number)
            assert found == draw(3, shape, number + POOL)
            assert all(3.0 < planned(c).duration < 15.0 for c in found)
            assert [c.held_out for c in found] == sorted(c.held_out for c in found)
            assert len({c.name for c in found}) == len(found)
            assert sum(not c.held_out for c in found) in (2, 3, 7)
        assert draw(3, shape, 0) != draw(4, shape, 0)

    def test_the_other_cut_is_at_the_same_place_and_differs_in_depth_turn_and_side(self):
        for number in range(POOL):
            main, second, other, third = draw(5, "cuts", number)
            assert other.position == main.position
            assert (other.depth, other.turn, other.mirrored) != (main.depth, main.turn, main.mirrored)
            assert abs(other.depth - main.depth) == pytest.approx(1e-3, abs=ROUNDOFF)  # MIDDLE_DEPTH
            assert (other.depth > main.depth) is (main.depth < MIDDLE_DEPTH)
            assert second.position != main.position != third.position
            assert (third.mode, third.held_out) == (0, True)

    def test_a_campaign_pushes_in_three_directions_at_three_places_hangs_a_weight_cuts_air_and_a_deep_slot(self):
        found = {c.name: c for c in draw(6, "campaign", 0)}
        pushed = [c for c in found.values() if c.push and not c.held_out]
        assert len({c.position for c in pushed}) == 3
        for c in pushed:
            table = load_table(c)
            assert np.all(np.diff(table[:, 0]) > 0.0)
            np.testing.assert_allclose(np.abs(table[:, 1:4]).max(axis=0), 750.0, rtol=ROUNDOFF)
            np.testing.assert_allclose(table[:, 1:4].max(axis=0), -table[:, 1:4].min(axis=0), rtol=ROUNDOFF)
            assert planned(c).duration >= table[-1, 0]
        weight = found["hanging weight"]
        np.testing.assert_allclose(load_table(weight)[:, 3], -GRAVITY * weight.weight, rtol=ROUNDOFF)
        assert found["deep slot"].depth >= 8e-3
        assert not found["air cut"].cuts
        assert "milling" not in known(found["air cut"], "a", "b")
        assert known(found["air cut"], "a", "b")["load"] == {"profile": "b"}


class TestWorld:
    def test_a_machine_without_effects_is_close_to_the_nominal_one_but_not_equal(self):
        _, columns, _ = simulate(SHORT, draw_machine(np.random.default_rng(1)), (), Changes(), None)
        gap = difference(columns, nominal(SHORT).columns)[:, 1]
        assert 1e-7 < np.sqrt(np.mean(gap**2)) < 40e-6

    def test_the_finer_step_alone_changes_micrometres(self):
        _, columns, _ = simulate(SHORT, Machine({}), (), Changes(), None)
        gap = difference(columns, nominal(SHORT).columns)[:, 1]
        assert 1e-7 < np.sqrt(np.mean(gap**2)) < 10e-6

    def test_hidden_constants_change_nothing_without_their_effect(self):
        hidden = draw_hidden(np.random.default_rng(8))
        _, columns, _ = simulate(SHORT, Machine({}, hidden), (), Changes(), None)
        _, usual, _ = simulate(SHORT, Machine({}), (), Changes(), None)
        np.testing.assert_allclose(difference(columns, usual), 0.0, rtol=ROUNDOFF, atol=1e3 * ROUNDOFF)

    def test_the_catalogue_takes_no_hidden_constant_for_known(self):
        known = {(c.component, p) for c in Catalogue.load(CATALOGUE).candidates for p in (*(s.parameter for s in c.shapes), c.named[-1])}
        names = {(c, p.partition("[")[0]) for c, p in known}
        hidden = {(c, p) for c, drawn in draw_hidden(np.random.default_rng(8)).items() for p in drawn}
        assert hidden - names == LEFT_OUT.keys()

    def test_the_phase_of_a_gear_error_is_that_of_the_machine(self):
        effect = [Instance(BY_KEY["drive.transmission_error"], 2, 50e-6)]
        _, one, _ = simulate(SHORT, Machine({}), effect, Changes(), None)
        _, other, _ = simulate(SHORT, Machine({}, draw_hidden(np.random.default_rng(8))), effect, Changes(), None)
        assert np.abs(difference(one, other)[:, :3]).max() > 10e-6

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
    @pytest.mark.parametrize("kind", dict.fromkeys((*outside.OUTSIDE, *outside.FORMED)), ids=lambda k: k.name)
    def test_each_changes_what_is_measured_clearly_at_the_middle_of_its_range(self, kind):
        c = TRAINING
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

    def test_two_inserts_at_one_place_act_one_behind_the_other(self):
        both = outside.merged([outside.bouc_wen(0, 1e-4, 94.0), outside.bouc_wen(1, 2e-4, 94.0)]).link()
        alone = [outside.bouc_wen(0, 1e-4, 94.0).link(), outside.bouc_wen(1, 2e-4, 94.0).link()]
        u = np.array([0.0, -1.6, 2.0, 0.0, -0.4, 0.0, 50.0, 300.0, -200.0])
        moved = both(0.0, 0.002, u)
        assert moved.shape == (6,)
        np.testing.assert_allclose(moved[0], alone[0](0.0, 0.002, u)[0], rtol=ROUNDOFF)
        # the second one sees the axes that the first has moved by 1e-4 rad: its torque, hundreds of N m, by less than 0.1
        np.testing.assert_allclose(moved[1] - u[1], alone[1](0.0, 0.002, u)[1] - u[1], rtol=SEEN_BY_THE_NEXT)

    def test_a_late_clock_shifts_the_columns_of_its_device_and_no_other(self):
        t = np.arange(100) * 0.004
        columns = {"sensor.f_T_T[1]": t.copy(), "drive.q_motor[1]": t.copy()}
        outside.late_clock("sensor.*", 0.01).after(columns, t, 0.004)
        np.testing.assert_allclose(columns["sensor.f_T_T[1]"][3:], t[3:] - 0.01, rtol=ROUNDOFF, atol=ROUNDOFF)
        np.testing.assert_array_equal(columns["drive.q_motor[1]"], t)


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


def test_closure_is_one_minus_the_ratio_of_mean_squares():
    assert closure(np.array([2.0, -2.0]), np.array([1.0, 1.0])) == 0.75
    assert closure(np.zeros(3), np.zeros(3)) == 0.0
