"""regenerative_milling: the cut of milling_force with modes between robot and edges, and the surface that they leave."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robomill.fmus.interface import Interface
from robomill.models.components.milling_force import MODEL as MILLING
from robomill.models.components.regenerative_milling import MAX_MODES, MODEL
from robomill.models.model.declaration import Model, record
from robomill.models.model.parameters import load
from robomill.models.process.cutting import CuttingCoefficients
from robomill.models.process.stability.modes import Modes, from_stiffness, load_modes
from robomill.models.process.stability.semi_discretisation import depth_limit, enough_intervals, periodic_matrices, spectral_radius
from robomill.models.process.stability.zero_order import Engagement
from tests.tolerances import EXACT, ROUNDOFF, physics

H = 0.004
RPM = math.pi / 30.0
MM, UM = 1e-3, 1e-6
FEED = 0.025
K = load(CuttingCoefficients, "materials/aw2017")
TEETH = 3
T_TO_CUT = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Tool axis down, feed along x of P: T in the axes of the cutting frame, as the defaults of the component stand."""
SPINDLE = load_modes("spindle_d16").turned(T_TO_CUT)
NO_MODES = [0.0] * MAX_MODES


class Slot:
    """An instance in the middle of a slot of depth `ap` [m], fed along x of P."""

    def __init__(self, ap: float, rpm: float = 13000.0, compiled: bool = True, model: Model = MODEL, **parameters: Any) -> None:
        self.model = model
        self.data = model.new()
        self.s = record(self.data)
        self.init, self.step = model.compiled() if compiled else model.plain()
        for name, value in {"helix": 0.2, **parameters}.items():
            self.data[name] = value
        self.data["spindle_speed"], self.data["v_BT_B"] = rpm * RPM, [FEED, 0.0, 0.0]
        self.start = self.data["p_BP_B"][0] + np.array([-0.03, 0.0, -ap])
        self.data["p_BT_B"] = self.start
        self.k = 0
        self.status = self.init(self.s)

    def go(self, steps: int, h: float = H) -> np.ndarray:
        """Results (steps, 12): force, moment, f_peak, torque, mean displacement in B, vibration, largest chip."""
        rows = []
        for _ in range(steps):
            self.k += 1
            self.data["p_BT_B"] = self.start + np.array([FEED * h * self.k, 0.0, 0.0])
            status = self.step(self.s, (self.k - 1) * h, h)
            assert status == 0, self.model.message(status, self.s, 0.0)
            rows.append(self.row())
        return np.array(rows)

    def row(self) -> list[float]:
        s = self.s
        own = [*s.u_T_B, s.vibration, s.chip_peak] if self.model is MODEL else []
        return [*s.f_T_B, *s.m_T_B, s.f_peak, s.spindle_torque, *own]


def limit(modes: Modes, rpm: float, largest: float = 0.02) -> float:
    """Limiting depth [m] of the slot by semi-discretisation."""
    period = 60.0 / rpm / TEETH
    matrices = periodic_matrices(K, TEETH, Engagement.between(0.0, math.pi), enough_intervals(modes, period))
    return depth_limit(modes, matrices, period, largest)


def wander(ap: float, rpm: float, tooth_periods: int = 0, **parameters: Any) -> np.ndarray:
    """Deflections (120, 2) [m] seen once per so many whole tooth periods (0: about 4 ms): a stable cut repeats itself."""
    period = 60.0 / rpm / TEETH
    h = (tooth_periods or max(round(H / period), 1)) * period
    one, seen = Slot(ap, rpm, **parameters), []
    for _ in range(120):
        one.go(1, h)
        seen.append(one.s.y[:2].copy())
    return np.array(seen)


def chatters(ap: float, rpm: float, **parameters: Any) -> bool:
    """Whether the deflection still differs from one tooth period to another by more than 1 % of a feed per tooth."""
    seen = wander(ap, rpm, **parameters)[-12:]
    return bool(np.ptp(seen, axis=0).max() > 0.01 * FEED * 60.0 / rpm / TEETH)


# ---------------------------------------------------------------- physics
def test_without_modes_it_is_milling_force() -> None:
    """250 rev/s, whole tooth periods per step: the mean over sub-steps is that over the rotation but for the trapezoidal rule."""
    ours = Slot(5 * MM, 15000.0, mode_frequency=NO_MODES, resolution=200).go(30)[-1]
    theirs = Slot(5 * MM, 15000.0, model=MILLING).go(30)[-1]
    # angular bins of 2 deg by their middle: an error of (2 deg)^2/24, 5e-5
    assert ours[:6] == pytest.approx(theirs[:6], rel=physics(1.0, relative=1e-3), abs=physics(np.abs(theirs[:3]).max(), relative=1e-3))
    assert ours[7] == pytest.approx(theirs[7], rel=physics(1.0, relative=1e-3))
    # milling_force looks at 24 instants per step: docs/components/milling_force.md, 1 %
    assert ours[6] == pytest.approx(theirs[6], rel=physics(1.0, relative=0.01))
    assert np.all(ours[8:12] == EXACT)


@pytest.mark.parametrize("rpm", [9000, 11000, 13000, 20000])
def test_time_domain_agrees_with_the_lobes_on_both_sides(rpm: int) -> None:
    """Against semi-discretisation, 5 % either side of its limit, in valleys and on a peak of the lobes."""
    at = limit(SPINDLE, rpm)
    assert not chatters(0.95 * at, rpm)
    assert chatters(1.05 * at, rpm)


def test_vibration_dies_out_at_the_rate_of_the_monodromy_matrix() -> None:
    """10 % below the limit; oracle: its largest eigenvalue per tooth period, 0.965."""
    rpm = 13000.0
    depth, period = 0.9 * limit(SPINDLE, rpm), 60.0 / rpm / TEETH
    matrices = periodic_matrices(K, TEETH, Engagement.between(0.0, math.pi), 120)
    seen = wander(depth, rpm, 3, resolution=60)
    apart = np.hypot(*(seen - seen[-1]).T)[10:50]
    rate = math.exp(np.polyfit(np.arange(40), np.log(apart), 1)[0] / 3)
    # both schemes are of second order: what 40 sub-steps per tooth leave of a decay of 0.035 per tooth
    assert rate == pytest.approx(spectral_radius(SPINDLE, matrices, depth, period), abs=physics(0.035, relative=0.05))


def test_the_tool_bends_by_its_compliance_under_the_mean_force() -> None:
    """On the average of many steps of a stable cut."""
    rows = Slot(1 * MM, 11000.0).go(120)[60:].mean(axis=0)
    k = 20e6
    assert rows[9] == pytest.approx(rows[1] / k, rel=physics(1.0, relative=0.01))
    assert rows[8] == pytest.approx(rows[0] / k, rel=physics(1.0, relative=0.01))
    assert abs(rows[10]) <= ROUNDOFF * abs(rows[9])  # there is no axial mode


def test_a_free_mode_rings_at_its_frequency_and_dies_out_with_its_damping() -> None:
    """In air: y(t) = y0 exp(-zeta w t) cos(wd t) + ..., whatever the number of sub-steps."""
    w, zeta = 2 * math.pi * 43.0, 0.02
    wd = w * math.sqrt(1 - zeta * zeta)
    modes = {"mode_frequency": [43.0, *NO_MODES[1:]], "mode_damping": [zeta, *NO_MODES[1:]]}
    air = Slot(-0.02, **modes, resolution=4)
    air.data["y"][0, 0] = 1e-5
    for n in range(1, 60):
        air.go(1)
        t = n * H
        expected = 1e-5 * math.exp(-zeta * w * t) * (math.cos(wd * t) + zeta * w / wd * math.sin(wd * t))
        assert air.s.y[0] == pytest.approx(expected, abs=1e3 * ROUNDOFF * 1e-5)


def test_a_mode_along_the_axis_takes_depth_away() -> None:
    """The helix pulls the tool down by F/k, and the cut is that much deeper; no regeneration is involved."""
    axial = {
        "mode_frequency": [200.0, *NO_MODES[1:]],
        "mode_damping": [0.5, *NO_MODES[1:]],
        "mode_stiffness": [2e5, *NO_MODES[1:]],
        "mode_direction": [[1.0, 0, 0], *[[0.0] * 3] * (MAX_MODES - 1)],
    }
    rigid, soft = Slot(2 * MM, 15000.0, mode_frequency=NO_MODES).go(60)[-1], Slot(2 * MM, 15000.0, **axial).go(60)[-1]
    deeper = -soft[10]
    assert deeper == pytest.approx(-soft[2] / 2e5, rel=physics(1.0, relative=1e-3))
    assert soft[1] == pytest.approx(rigid[1] * (1 + deeper / (2 * MM)), rel=physics(1.0, relative=2e-3))
    assert deeper > 0.01 * MM


def test_chatter_is_bounded_by_teeth_that_leave_the_cut() -> None:
    """Three times the limit: the chip between zero and a few feeds per tooth, the vibration of the order of the feed per tooth."""
    chip = FEED / (13000 / 60 * TEETH)
    rows = Slot(3 * limit(SPINDLE, 13000.0), 13000.0).go(150)[-30:]
    assert rows[:, 12].max() > 2 * chip
    assert chip / 4 < rows[:, 11].max() < 10 * chip


def test_regenerative_gain_error_moves_the_limit_and_nothing_else() -> None:
    """With gain g the limit is a/g: 30 % more gain chatters at 85 % of the depth, 30 % less is calm at 120 %."""
    at = limit(SPINDLE, 13000.0)
    assert chatters(0.85 * at, 13000.0, regenerative_gain_error=0.3)
    assert not chatters(1.20 * at, 13000.0, regenerative_gain_error=-0.3)
    assert not chatters(3.0 * at, 13000.0, regenerative_gain_error=-1.0)
    without = [Slot(3 * MM, mode_frequency=NO_MODES, regenerative_gain_error=e).go(10) for e in (0.0, 0.3)]
    assert np.array_equal(*without)


def test_edges_that_lift_lower_the_limit() -> None:
    """An edge force that goes to nothing where a thin chip is lost is a stiff regeneration there: chatter at 90 % of the limit."""
    at = limit(SPINDLE, 13000.0)
    assert chatters(0.9 * at, 13000.0, edge_lifts=True)
    assert not chatters(0.9 * at, 13000.0, edge_lifts=True, Kte=0.0, Kre=0.0)


# ---------------------------------------------------------------- numerics
def test_of_second_order_in_the_sub_step() -> None:
    """Deflection after 40 steps of a stable cut, against 32 times the sub-steps.

    Edges enter and leave between sub-steps, so single errors scatter about the order: it is taken over a factor of 16.
    """
    depth = 0.7 * limit(SPINDLE, 15000.0)

    def at(resolution: int) -> np.ndarray:
        one = Slot(depth, 15000.0, resolution=resolution)
        one.go(40)
        return np.array(one.s.y[:2])

    best = at(640)
    coarse, fine = (float(np.hypot(*(at(r) - best))) for r in (20, 320))
    assert coarse < physics(float(np.hypot(*best)), relative=0.03)
    assert math.log(coarse / fine) / math.log(16.0) > 1.5


@pytest.mark.parametrize("step", [0.004, 0.0005])
def test_the_limit_does_not_move_with_the_communication_step(step: float) -> None:
    """The loop of force and vibration is closed inside the component: 4 ms and 0.5 ms agree on both sides of the limit."""
    at, period = limit(SPINDLE, 15000.0), 60.0 / 15000.0 / TEETH
    h = step / 0.004 * 3 * period
    for share, grows in ((0.95, False), (1.05, True)):
        one, seen = Slot(share * at, 15000.0), []
        for k in range(round(120 * 0.004 / step)):
            one.go(1, h)
            if k % round(0.004 / step) == 0:
                seen.append(one.s.y[:2].copy())
        assert (np.ptp(seen[-12:], axis=0).max() > 0.01 * FEED * period) == grows


def test_compiled_and_plain_have_the_same_bits() -> None:
    runs = [Slot(1 * MM, compiled=c, resolution=6, runout=1e-5, size_effect_exponent=0.2).go(6) for c in (True, False)]
    assert np.array_equal(*runs)


def test_the_spindle_may_change_its_speed() -> None:
    """The past surface is looked up by angle: after the change the cut is that of the new speed."""
    one, other = Slot(1 * MM, 9000.0), Slot(1 * MM, 15000.0)
    one.go(30)
    one.data["spindle_speed"] = 15000 * RPM
    changed, straight = one.go(90)[-20:].mean(axis=0), other.go(120)[-20:].mean(axis=0)
    assert changed[:2] == pytest.approx(straight[:2], rel=physics(1.0, relative=5e-3))
    assert changed[11] == pytest.approx(straight[11], rel=physics(1.0, relative=0.02))


# ---------------------------------------------------------------- ports and errors
def test_it_takes_the_place_of_milling_force() -> None:
    ours, theirs = Interface(MODEL), Interface(MILLING)
    assert [(p.name, p.type, p.unit) for p in ours.inputs] == [(p.name, p.type, p.unit) for p in theirs.inputs]
    outputs = {(p.name, p.type, p.unit) for p in ours.outputs}
    assert {(p.name, p.type, p.unit) for p in theirs.outputs} < outputs


def test_files_of_modes_are_parameters_of_the_component() -> None:
    """The defaults are spindle_d16 of models/data/modes."""
    data = MODEL.new()[0]
    assert data["mode_frequency"][:3].tolist() == [1100.0, 1150.0, 0.0]
    assert data["mode_stiffness"][:2] == pytest.approx([20e6, 20e6], rel=10 * ROUNDOFF)
    modes = from_stiffness([1100.0, 1150.0], [0.03, 0.03], [20e6, 20e6], data["mode_direction"][:2])
    assert modes.shape == pytest.approx(load_modes("spindle_d16").shape, rel=10 * ROUNDOFF)


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"mode_stiffness": [0.0] * MAX_MODES}, "mode 1 is not sound"),
        ({"mode_direction": [[2.0, 0, 0]] + [[0.0, 0, 1]] * (MAX_MODES - 1)}, "directions of unit length (this one: 2.000000)"),
        ({"mode_damping": [0.01, 0.995, *NO_MODES[2:]]}, "mode 2 is not sound"),
    ],
)
def test_modes_that_are_none_are_refused(parameters: dict[str, Any], text: str) -> None:
    one = Slot(1 * MM, **parameters)
    assert text in MODEL.message(one.status, one.s, 0.0)


def _failing(one: Slot, steps: int = 60) -> str:
    for k in range(steps):
        one.data["p_BT_B"] = one.start + np.array([FEED * H * (k + 1), 0.0, 0.0])
        status = one.step(one.s, k * H, H)
        if status != 0:
            return MODEL.message(status, one.s, k * H)
    return ""


def test_errors_of_a_step() -> None:
    stiff = [20e6] * MAX_MODES
    fast = Slot(1 * MM, mode_frequency=[9e4, *NO_MODES[1:]], resolution=1000, mode_stiffness=stiff)
    assert "at most 20000 can be taken: use a shorter communication step" in _failing(fast)
    assert "the past surface holds 8192: the spindle" in _failing(Slot(1 * MM, 300.0, resolution=1000))
    soft = Slot(8 * MM, mode_stiffness=[500.0] * MAX_MODES, mode_frequency=[5.0, 5.0, *NO_MODES[2:]])
    assert "more than the radius of the cutter (diameter 0.016 m): the cut is unstable (robomill stability" in _failing(soft)
    # what milling_force refuses is refused here with its own words
    backwards = Slot(1 * MM)
    backwards.data["spindle_speed"] = -1.0
    assert "expected 0 or more: the cutter is right-hand" in _failing(backwards)
