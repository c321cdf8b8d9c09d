"""milling_force: the force that a flat end mill feels in the workpiece that it has cut so far."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.models.components.milling_force import BINS, MODEL
from robomill.models.model.declaration import record
from robomill.models.model.parameters import load
from robomill.models.process import tool_table
from robomill.models.process.cutting import CuttingCoefficients, EndMill, immersion, mean_force, mean_torque, slot_force
from tests.models.process.ideal_engagement import ideal_force
from tests.tolerances import EXACT, ROUNDOFF, discretisation, physics

H = 0.004
K = load(CuttingCoefficients, "materials/aw2017")
MILL = load(EndMill, "tools/endmill_d16_z3")
RADIUS = 0.008
DOWN = Rotation.from_matrix([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
"""Tool axis (x of T) straight down."""
REV_250 = 250 * 2 * math.pi
"""rad/s: one revolution per 4 ms step, so every step is a whole number of tooth periods."""
GROOVE = 13000 * 2 * math.pi / 60
"""rad/s: 13 revolutions in 15 steps."""
FEED = 0.025
PEAK = 0.01
"""Relative: what docs/components/milling_force.md says that the peak depends on `substeps` by at most."""
OUTPUTS = ("f_T_B", "m_T_B", "f_peak", "spindle_torque", "spindle_power", "removal_rate", "depth")
EFFECTS = {
    "cutting_coefficient_error": 0.2,
    "tool_wear": 0.4,
    "size_effect_exponent": 0.2,
    "runout": 2e-5,
    "stock_error": 5e-4,
    "engagement_error": 1e-3,
    "workpiece_compliance": 2e-7,
}


class Mill:
    """One instance; positions and velocities are given in P, the results read in P too."""

    def __init__(
        self, start: Any, compiled: bool = True, spindle: float = REV_250, velocity: Any = (0.0, 0.0, 0.0), **parameters: Any
    ) -> None:
        self.data = MODEL.new()
        self.s = record(self.data)
        self.init, self.step = MODEL.compiled() if compiled else MODEL.plain()
        for name, value in parameters.items():
            if name == "tools":
                MODEL.load_table(self.data, name, np.asarray(value, dtype=float))
            else:
                self.data[name] = value
        self.R_BP = Rotation.from_quat(self.data["quat_BP"][0], scalar_first=True)
        self.data["quat_BT"] = (self.R_BP * DOWN).as_quat(scalar_first=True)
        self.data["spindle_speed"] = spindle
        self.place(start, velocity)
        self.status = self.init(self.s)

    def place(self, position: Any, velocity: Any = (0.0, 0.0, 0.0)) -> None:
        """Set tool tip [m] and commanded feed [m/s], both in P."""
        self.data["p_BT_B"] = self.data["p_BP_B"][0] + self.R_BP.apply(np.asarray(position, dtype=float))
        self.data["v_BT_B"] = self.R_BP.apply(np.asarray(velocity, dtype=float))

    def go(self, position: Any, velocity: Any) -> np.ndarray:
        """One step; f and m in P (6), then the scalar outputs (5)."""
        self.place(position, velocity)
        status = self.step(self.s, 0.0, H)
        assert status == 0, MODEL.message(status, self.s, 0.0)
        vectors = [self.R_BP.inv().apply(self.data[name][0]) for name in ("f_T_B", "m_T_B")]
        return np.concatenate([*vectors, [float(self.data[name][0]) for name in OUTPUTS[2:]]])

    def line(self, start: Any, velocity: Any, steps: int) -> np.ndarray:
        """`steps` steps from `start` on with constant velocity; results (steps, 11)."""
        start, velocity = np.asarray(start, dtype=float), np.asarray(velocity, dtype=float)
        return np.array([self.go(start + (k + 1) * H * velocity, velocity) for k in range(steps)])


def slot(
    ap: float = 0.01, steps: int = 60, angle: float = 0.0, feed: float = FEED, spindle: float = REV_250, **parameters: Any
) -> np.ndarray:
    """Steps in the middle of a slot, the tool having started in the block; forces along feed, left of it, up."""
    a = math.radians(angle)
    direction = np.array([math.cos(a), math.sin(a), 0.0])
    mill = Mill([0.0, 0.0, -ap], spindle=spindle, velocity=feed * direction, **parameters)
    result = mill.line([0.0, 0.0, -ap], feed * direction, steps)
    turn = Rotation.from_euler("z", -angle, degrees=True)
    result[:, :3], result[:, 3:6] = turn.apply(result[:, :3]), turn.apply(result[:, 3:6])
    return result


def shoulder(side: float, width: float = 0.001, ap: float = 0.01, **parameters: Any) -> np.ndarray:
    """The cut of paper 001 (D 12 mm, 50 mm/s, here 250 rev/s): a wall at the right (side -1) or left (+1), `width` wide."""
    mill = Mill([-0.03, 0, -ap], block_size=[0.04, 0.03, 0.02], diameter=0.012, **parameters)
    wall = 0.0041234
    first, second = side * (wall - 0.006), side * (wall + width - 0.006)
    velocity = [0.05, 0.0, 0.0]
    mill.line([-0.03, first, -ap], velocity, 300)
    mill.go([0.03, first, 0.02], [0, 0, 0])
    mill.go([-0.03, second, 0.02], [0, 0, 0])
    result = mill.line([-0.03, second, -ap], velocity, 150)
    return result[110:]


# ---------------------------------------------------------------- physics: zero and limit cases
def test_in_air_everything_is_exactly_zero() -> None:
    mill = Mill([-0.08, 0.0, -0.01])
    assert not mill.line([-0.08, 0, -0.01], [FEED, 0, 0], 50).any()
    above = Mill([0.0, 0.0, 0.02])
    assert not above.line([0.0, 0.0, 0.02], [FEED, 0, -0.005], 20).any()


def test_a_slot_gone_through_again_gives_no_force_in_its_middle_and_removes_nothing() -> None:
    mill = Mill([-0.02, 0.0, -0.01])
    mill.line([-0.02, 0, -0.01], [FEED, 0, 0], 100)
    again = Mill.line(mill, [-0.02, 0, -0.01], [FEED, 0, 0], 80)
    first_slot = slot()
    # the walls just made are half a cell thick to the dexels: edges within a cell of them still rub (docs, "Validity")
    assert np.abs(again[:, :3]).max() < 0.05 * np.abs(first_slot[:, :3]).max()
    assert again[:, 9].max() == pytest.approx(0.0, abs=ROUNDOFF * first_slot[0, 9])


def test_spindle_off_means_no_force_and_no_cut() -> None:
    mill = Mill([-0.02, 0.0, -0.01])
    before = mill.data["height"].copy()
    mill.data["spindle_speed"] = 0.0
    assert not mill.line([-0.02, 0, -0.01], [FEED, 0, 0], 10).any()
    assert np.array_equal(mill.data["height"], before)
    mill.data["spindle_speed"] = REV_250  # what was passed without cutting is not taken for cut
    mill.go([-0.018, 0, -0.01], [FEED, 0, 0])
    assert mill.data["height"].min() == pytest.approx(-0.01, rel=ROUNDOFF)
    assert mill.data["removal_rate"][0] > 0.0


def test_without_feed_the_edges_run_free() -> None:
    mill = Mill([0.0, 0.0, -0.01])
    assert not mill.go([1e-4, 0, -0.01], [0, 0, 0])[:9].any()


def test_edge_forces_grow_with_the_feed_from_a_standstill() -> None:
    """Half of `edge_onset` (5 um): half of the edge forces."""
    chip = 2.5e-6
    half = CuttingCoefficients(K.Ktc, K.Krc, K.Kac, 0.5 * K.Kte, 0.5 * K.Kre, 0.5 * K.Kae)
    fx, fy, fa = slot_force(half, 3, 0.01, chip)
    assert slot(feed=chip * 750)[-1, :3] == pytest.approx((fx, fy, -fa), rel=1e3 * ROUNDOFF)


# ---------------------------------------------------------------- physics: published and closed-form numbers
@pytest.mark.parametrize("angle", [0.0, 90.0, 180.0, -90.0])
def test_slot_along_the_dexels_is_the_closed_form(angle: float) -> None:
    fx, fy, fa = slot_force(K, 3, 0.01, FEED / 750)
    f = slot(angle=angle)[10:]
    scale = ROUNDOFF * 1e3 * fy  # 90 bins, three teeth, differences of squares
    assert f[:, 0] == pytest.approx(fx, abs=scale)
    assert f[:, 1] == pytest.approx(fy, abs=scale)
    assert f[:, 2] == pytest.approx(-fa, abs=scale)  # down: a right-hand helix pulls the tool into the work


@pytest.mark.parametrize("angle", [17.0, 45.0, 110.0, -150.0])
@pytest.mark.parametrize("block", [0.0, 30.0])
def test_slot_across_the_dexels_in_any_block(angle: float, block: float) -> None:
    """Nothing of the dexels is left: the ring on which the front is read is clear of every cell that has been cut, half of it or all."""
    fx, fy, fa = slot_force(K, 3, 0.01, FEED / 750)
    quat = Rotation.from_euler("z", block, degrees=True).as_quat(scalar_first=True)
    f = slot(angle=angle, quat_BP=quat)[10:].mean(axis=0)
    assert f[:3] == pytest.approx((fx, fy, -fa), abs=ROUNDOFF * 1e3 * fy)


@pytest.mark.paper
def test_slot_of_the_paper() -> None:
    """FACTS 3.4: D16 z3, 13000 rpm, 25 mm/s, ap 11.8 mm gives a mean of 546 N in the plane; 15 steps are 13 revolutions."""
    f = slot(ap=11.8e-3, steps=45, spindle=GROOVE)[15:45].mean(axis=0)
    assert math.hypot(f[0], f[1]) == pytest.approx(546.0, abs=physics(546.0, relative=0.05 / 11.8))


@pytest.mark.parametrize(("side", "mode"), [(-1.0, "down"), (1.0, "up")])
def test_shoulder_climb_and_conventional(side: float, mode: str) -> None:
    """Clockwise spindle: a wall on the right is climb (down) milling and pulls the tool forward, on the left conventional.

    Bound: the radial width is known to a quarter of a cell (1 mm +- 0.05 mm).
    """
    chip = 0.05 / 750
    entry, exit_ = immersion(0.012, 0.001, mode)
    fx, fy, fa = mean_force(K, 3, 0.01, chip, entry, exit_)
    wider = np.array(mean_force(K, 3, 0.01, chip, *immersion(0.012, 0.00105, mode)))
    bound = np.abs(wider - [fx, fy, fa]).max()
    f = shoulder(side).mean(axis=0)
    assert f[:3] == pytest.approx((fx, fy, -fa), abs=bound)
    assert (f[0] > 0) == (mode == "down")


def test_finer_dexels_know_the_wall_better() -> None:
    entry, exit_ = immersion(0.012, 0.001, "up")
    reference = np.array(mean_force(K, 3, 0.01, 0.05 / 750, entry, exit_))
    errors = [np.abs(shoulder(1.0, spacing=h).mean(axis=0)[:2] - reference[:2]).max() for h in (8e-4, 4e-4, 2e-4)]
    assert errors[2] < 0.5 * errors[1] < 0.25 * errors[0]


def test_ramp_end_face_pushes_up() -> None:
    """Slope 1:10 down: c_z per tooth on three edges of the length R, Krc and Kre acting along the axis (docs, Eq. 8)."""
    mill = Mill([-0.02, 0, -0.004], contact_time=0.0)
    f = mill.line([-0.02, 0, -0.004], [FEED, 0, -0.1 * FEED], 100)
    chip_z = 0.1 * FEED / 750
    thrust = 3 * RADIUS * (K.Krc * chip_z + K.Kre * chip_z / 5e-6)
    depth = 0.004 + 0.1 * FEED * H * (np.arange(1, 101) - 0.5)
    axial = thrust - depth * slot_force(K, 3, 1.0, FEED / 750)[2]
    assert f[20:, 2] == pytest.approx(axial[20:], rel=1e3 * ROUNDOFF)
    torque = mean_torque(K, 0.016, 3, 1.0, FEED / 750, 0.0, math.pi) * depth + 3 * RADIUS**2 / 2 * (K.Ktc * chip_z + K.Kte * chip_z / 5e-6)
    assert f[20:, 7] == pytest.approx(torque[20:], rel=1e3 * ROUNDOFF)


def test_plunge_bites_gradually_and_to_the_full() -> None:
    mill = Mill([0, 0, 0.0005])
    f = mill.line([0, 0, 0.0005], [0, 0, -0.005], 200)
    chip_z = 0.005 / 750
    full = 3 * RADIUS * (K.Krc * chip_z + K.Kre)
    assert not f[:15].any()  # 0.3 mm down: still 0.2 mm above, more than the contact zone
    assert np.all(np.diff(f[25:, 2]) >= 0.0)
    # 167 steps in the material, time constant 60 + 4 ms
    assert f[-1, 2] == pytest.approx(full, abs=physics(full, relative=math.exp(-0.67 / 0.064)))
    assert f[-1, 9] == pytest.approx(math.pi * RADIUS**2 * 0.005, rel=discretisation(1.0, 2e-4 / RADIUS, 2))
    assert not f[:, [0, 1, 3, 4]].any()
    assert not mill.line([0, 0, -0.0035], [0, 0, 0.005], 5)[:, :9].any()  # on the way up nothing touches


# ---------------------------------------------------------------- physics: invariants
@pytest.mark.parametrize("helix", [0.0, 0.2, 0.7])
def test_helix_drops_out_of_the_mean(helix: float) -> None:
    reference, f = slot()[-1], slot(helix=helix)[-1]
    assert f[[0, 1, 2, 7]] == pytest.approx(reference[[0, 1, 2, 7]], rel=1e4 * ROUNDOFF)  # lag of 1e-6 rad/m when straight
    assert abs(f[6] - reference[6]) > 1.0  # but not out of the peak


def test_every_tooth_period_is_alike() -> None:
    """One revolution per step is the same as two, three: whole tooth periods; two thirds of one too."""
    reference = slot(spindle=REV_250, feed=0.03)[-1]
    faster = slot(spindle=2 * REV_250, feed=0.06)[-1]
    assert faster[:3] == pytest.approx(reference[:3], rel=1e3 * ROUNDOFF)
    slower = slot(spindle=REV_250 * 2 / 3, feed=0.02)[-1]
    assert slower[:3] == pytest.approx(reference[:3], rel=1e3 * ROUNDOFF)


def test_power_pays_for_the_volume_that_the_dexels_lose() -> None:
    """P = Ktc Q + edge work N ap Kte R omega/2: Q from the workpiece, P from the forces, two separate calculations."""
    for ap, angle in ((0.002, 0.0), (0.01, 25.0)):
        f = slot(ap=ap, angle=angle)[10:].mean(axis=0)
        edge = 3 * ap * K.Kte * RADIUS * REV_250 / 2
        cells = discretisation(1.0, 2e-4 / RADIUS, 2)  # as areas of discs of partly covered cells
        assert f[8] == pytest.approx(K.Ktc * f[9] + edge, rel=cells)
        assert f[9] == pytest.approx(2 * RADIUS * ap * FEED, rel=cells)
        assert f[8] == pytest.approx(f[7] * REV_250, rel=ROUNDOFF)


def test_moment_about_the_tip() -> None:
    """Lateral force acts at half the depth; the axial force off centre; torque against the rotation (about +z in P)."""
    ap = 0.01
    f = slot(ap=ap)[-1]
    fx, fy, _ = slot_force(K, 3, ap, FEED / 750)
    # mean of R Fa (-cos, sin) over the half turn: only the sine part is left
    sine = 3 * ap / (2 * math.pi) * (K.Kac * FEED / 750 * math.pi / 2 + K.Kae * 2.0)
    torque = mean_torque(K, 0.016, 3, ap, FEED / 750, 0.0, math.pi)
    assert f[3:6] == pytest.approx((-fy * ap / 2, fx * ap / 2 + RADIUS * sine, torque), rel=1e3 * ROUNDOFF)
    assert f[7] == pytest.approx(torque, rel=1e3 * ROUNDOFF)


def test_force_turns_with_the_feed_and_with_the_block() -> None:
    straight, turned = slot(), slot(quat_BP=Rotation.from_euler("z", 77, degrees=True).as_quat(scalar_first=True))
    assert turned == pytest.approx(straight, abs=ROUNDOFF * 1e4)


def test_entry_and_exit_follow_the_segment_in_the_block() -> None:
    """At the exit the force falls below one half within 1 mm once the front breaks out, and ends where the cutter's axis leaves.

    Reference: ideal arc between the exit face's two crossings, edges at phi in the block; bound half a cell of position.
    """
    mill = Mill([0.03, 0, -0.01], velocity=[FEED, 0, 0])
    f = mill.line([0.03, 0, -0.01], [FEED, 0, 0], 260)
    x = 0.03 + FEED * H * (np.arange(1, 261) - 0.5)
    full = f[20, 1]
    assert f[x > 0.05 + 4e-4, :3] == pytest.approx(0.0, abs=EXACT)
    assert np.all(f[x < 0.042 - 2e-4, 1] > 0.99 * full)
    assert f[np.searchsorted(x, 0.043), 1] < 0.5 * full

    def ideal(position: float) -> np.ndarray:
        if position + RADIUS <= 0.05:
            return np.array([*slot_force(K, 3, 0.01, FEED / 750)])
        out = math.asin((0.05 - position) / RADIUS)  # sin(phi) = distance of the face
        return np.array(mean_force(K, 3, 0.01, FEED / 750, 0.0, out)) + mean_force(K, 3, 0.01, FEED / 750, math.pi - out, math.pi)

    for i in np.flatnonzero((x > 0.0425) & (x < 0.0495))[::10]:
        bound = np.abs(ideal(x[i] - 2e-4) - ideal(x[i] + 2e-4)).max()
        assert f[i, :2] == pytest.approx(ideal(x[i])[:2], abs=bound)


def test_depth_counts_from_the_bottom_of_a_block_that_is_cut_through() -> None:
    """A block 5 mm high, the tip 3 mm below it: the edges from 3 to 8 mm cut; the mean is that of 5 mm, the lever arm 5.5 mm."""
    f = slot(ap=0.008, block_size=[0.1, 0.06, 0.005])[-1]
    fx, fy, fa = slot_force(K, 3, 0.005, FEED / 750)
    assert f[:3] == pytest.approx((fx, fy, -fa), rel=1e4 * ROUNDOFF)
    assert f[3] == pytest.approx(-fy * 0.0055, rel=1e4 * ROUNDOFF)
    assert f[10] == pytest.approx(0.005, rel=ROUNDOFF)


def test_second_pass_meets_the_wall_that_the_deflected_first_one_left() -> None:
    """A first pass displaced by 0.5 mm to the left leaves 0.5 mm at the right wall for the second: climb milling of that width."""
    mill = Mill([-0.03, 5e-4, -0.01])
    mill.line([-0.06, 5e-4, -0.01], [FEED, 0, 0], 800)
    mill.go([0.02, 5e-4, 0.01], [0, 0, 0])
    mill.go([-0.06, 0.0, 0.01], [0, 0, 0])
    f = mill.line([-0.06, 0.0, -0.01], [FEED, 0, 0], 700)[500:].mean(axis=0)
    chip = FEED / 750
    reference = np.array(mean_force(K, 3, 0.01, chip, *immersion(0.016, 5e-4, "down")))
    bound = np.abs(reference - mean_force(K, 3, 0.01, chip, *immersion(0.016, 6e-4, "down"))).max()  # half a cell
    assert f[:2] == pytest.approx(reference[:2], abs=bound)


def test_coupled_with_a_compliant_robot_it_is_stable_at_4_ms() -> None:
    """Quasi-static robot of 2.5 um/N across the feed, 2 um/N along the axis, one step delay; a slot that becomes a ramp."""
    compliance = np.diag([1.5e-6, 2.5e-6, 2e-6])
    mill = Mill([-0.06, 0, -0.006])
    force, deflections = np.zeros(3), []
    for k in range(600):
        slope = -0.1 if k > 300 else 0.0
        nominal = np.array([-0.06 + FEED * H * (k + 1), 0.0, -0.006 + min(0.0, -0.1 * FEED * H * (k - 300))])
        deflections.append(compliance @ force)
        force = mill.go(nominal + deflections[-1], [FEED, 0.0, slope * FEED])[:3]
    d = np.array(deflections)
    assert np.abs(np.diff(d, axis=0))[200:300].max() < 1e-8  # settled in the slot
    assert np.abs(np.diff(d, axis=0)[303:]).max() < 5e-5  # no chatter of the end face in the ramp
    assert np.abs(np.diff(d, n=2, axis=0)[450:]).max() < 1e-6  # steady at its end


# ---------------------------------------------------------------- numerics
def test_peak_against_fine_instants_and_with_half_and_double_the_substeps() -> None:
    """The mean does not depend on `substeps` at all; the peak by less than 1 %."""
    runs = {n: slot(ap=0.01, spindle=GROOVE, substeps=n)[20:40] for n in (12, 24, 48)}
    for n in (12, 48):
        assert np.array_equal(np.delete(runs[n], 6, axis=1), np.delete(runs[24], 6, axis=1))
        assert runs[n][:, 6] == pytest.approx(runs[24][:, 6], rel=PEAK)
    angles = np.linspace(0, 2 * math.pi / 3, 361)
    instants = [ideal_force(K, MILL, 0.01, FEED / 650, 0.0, math.pi, a, a + 1e-6)[:3] for a in angles]
    assert runs[24][:, 6].max() == pytest.approx(np.linalg.norm(instants, axis=1).max(), rel=PEAK)


def test_two_half_steps_are_one_step() -> None:
    """Same engagement, same rotation: the mean over 4 ms is the mean of two means over 2 ms, to roundoff, for any spindle speed."""
    whole, halves = (Mill([0, 0, -0.01], spindle=1000.0, velocity=[FEED, 0, 0]) for _ in range(2))
    for k in range(30):
        whole.place([FEED * H * (k + 1), 0, -0.01], [FEED, 0, 0])
        assert whole.step(whole.s, 0.0, H) == 0
        total = np.zeros(3)
        for i in (0.5, 1.0):
            halves.place([FEED * H * (k + i), 0, -0.01], [FEED, 0, 0])
            assert halves.step(halves.s, 0.0, H / 2) == 0
            total += 0.5 * halves.data["f_T_B"][0]
        assert total == pytest.approx(whole.data["f_T_B"][0], rel=1e4 * ROUNDOFF)
    assert whole.data["spindle_angle"][0] == pytest.approx(halves.data["spindle_angle"][0], rel=1e3 * ROUNDOFF)


def test_init_can_be_repeated_and_leaves_no_trace_of_a_run() -> None:
    mill = Mill([-0.02, 0, -0.01], runout=1e-5, workpiece_compliance=1e-7)
    fresh = mill.data.tobytes()
    mill.line([-0.02, 0, -0.01], [FEED, 0.001, -0.001], 50)
    mill.place([-0.02, 0, -0.01])
    for _ in range(2):
        assert mill.init(mill.s) == 0
        assert mill.data.tobytes() == fresh


# ---------------------------------------------------------------- effects
def test_effects_are_off_by_default() -> None:
    effects = {v.name: v for v in MODEL.variables if v.effect}
    assert set(effects) == set(EFFECTS)
    assert all(v.start == 0.0 for v in effects.values())
    reference = slot()
    for name in EFFECTS:
        assert np.array_equal(slot(**{name: 0.0}), reference), name


def test_cutting_coefficient_error_scales_what_grows_with_the_chip() -> None:
    k = CuttingCoefficients(1.2 * K.Ktc, 1.2 * K.Krc, 1.2 * K.Kac, K.Kte, K.Kre, K.Kae)
    fx, fy, fa = slot_force(k, 3, 0.01, FEED / 750)
    assert slot(cutting_coefficient_error=0.2)[-1, :3] == pytest.approx((fx, fy, -fa), rel=1e3 * ROUNDOFF)


def test_tool_wear_scales_the_edge_forces() -> None:
    k = CuttingCoefficients(K.Ktc, K.Krc, K.Kac, 1.4 * K.Kte, 1.4 * K.Kre, 1.4 * K.Kae)
    fx, fy, fa = slot_force(k, 3, 0.01, FEED / 750)
    assert slot(tool_wear=0.4)[-1, :3] == pytest.approx((fx, fy, -fa), rel=1e3 * ROUNDOFF)


def test_size_effect_is_a_power_of_the_chip_thickness() -> None:
    """Mean of Fy/Ktc part: N a c/(2 pi) (c/h_ref)^-m int sin^(2-m) dphi; bins of two degrees hold the power at their middle."""
    m, chip = 0.2, 0.1 / 750
    phi = (np.arange(100000) + 0.5) * math.pi / 100000
    edge = slot(feed=0.1, cutting_coefficient_error=-0.9)[-1], slot(feed=0.1)[-1]
    cutting = (edge[1] - edge[0]) / 0.9  # the part of the forces that the size effect acts on
    factor = (chip / 2.5e-5) ** -m * np.mean(np.sin(phi) ** (2 - m)) / np.mean(np.sin(phi) ** 2)
    change = slot(feed=0.1, size_effect_exponent=m)[-1] - edge[1]
    assert change[1] == pytest.approx((factor - 1) * cutting[1], rel=discretisation(10.0, math.pi / BINS, 2))


def test_runout_leaves_the_mean_cutting_force_and_adds_a_spindle_line() -> None:
    """Teeth hand on the chip: without edge forces the mean over a revolution is that without runout; the peak is higher."""
    sharp = {"Kte": 0.0, "Kre": 0.0, "Kae": 0.0}
    true, off = slot(**sharp)[-1], slot(runout=1e-5, **sharp)[-1]
    # bins in which a tooth stops cutting are counted whole or not at all
    assert off[:3] == pytest.approx(true[:3], rel=discretisation(1.0, math.pi / BINS, 2))
    assert off[6] > 1.1 * true[6]
    third = slot(runout=1e-5, spindle=REV_250 / 3, feed=FEED / 3)[-3:, 1]  # one tooth period per step
    assert np.ptp(third) > 10.0
    assert np.ptp(slot(spindle=REV_250 / 3, feed=FEED / 3)[-3:, 1]) < 1e-6


def test_what_changes_within_a_turn_is_the_force_less_the_mean_over_the_teeth() -> None:
    """Steps of one tooth period: three teeth, three forces; without the part that changes all are their mean, moments too."""
    one_tooth = {"spindle": REV_250 / 3, "feed": FEED / 3}
    for runout in (1e-5, 0.0):
        mill = Mill([0.0, 0.0, -0.01], velocity=[FEED / 3, 0, 0], runout=runout, spindle=REV_250 / 3)
        loads, turning = [], []
        for k in range(60):
            loads.append(mill.go([(k + 1) * H * FEED / 3, 0, -0.01], [FEED / 3, 0, 0])[:6])
            turning.append(np.concatenate([mill.R_BP.inv().apply(mill.data[name][0]) for name in ("f_turn_T_B", "m_turn_T_B")]))
        load, part = np.array(loads[-3:]), np.array(turning[-3:])
        if runout == 0.0:
            assert not np.any(turning)
            assert np.array_equal(load[:, :3], slot(**one_tooth)[-3:, :3])
        else:
            mean = load.mean(axis=0)
            assert load - part == pytest.approx(np.tile(mean, (3, 1)), rel=1e5 * ROUNDOFF, abs=1e5 * ROUNDOFF * np.abs(mean).max())
            assert np.abs(part[:, :3]).max() > 10.0


def test_runout_angle_turns_the_pattern() -> None:
    options = {"runout": 1e-5, "spindle": REV_250 / 3, "feed": FEED / 3}
    pattern = slot(**options)[-6:, 1]
    shifted = slot(runout_angle=2 * math.pi / 3, **options)[-6:, 1]
    assert pattern[:-3] == pytest.approx(pattern[3:], rel=1e4 * ROUNDOFF)
    assert sorted(pattern[:3]) == pytest.approx(sorted(shifted[:3]), rel=1e4 * ROUNDOFF)
    assert abs(pattern[0] - shifted[0]) > 1.0


def test_stock_error_is_extra_depth() -> None:
    f = slot(ap=0.01, stock_error=5e-4)[-1]
    fx, fy, fa = slot_force(K, 3, 0.0105, FEED / 750)
    assert f[:3] == pytest.approx((fx, fy, -fa), rel=1e4 * ROUNDOFF)
    assert f[10] == pytest.approx(0.0105, rel=ROUNDOFF)


def test_engagement_error_moves_the_side_faces() -> None:
    """A shoulder at the side face of the block, 3 mm wide, becomes 4 mm wide."""

    def at_the_side(**effect: float) -> np.ndarray:
        mill = Mill([-0.02, -0.035, -0.005], **effect)
        return mill.line([-0.02, -0.035, -0.005], [FEED, 0, 0], 100)[50:].mean(axis=0)

    chip = FEED / 750
    for width, effect in ((0.003, {}), (0.004, {"engagement_error": 1e-3})):
        reference = np.array(mean_force(K, 3, 0.005, chip, *immersion(0.016, width, "up")))
        wider = np.array(mean_force(K, 3, 0.005, chip, *immersion(0.016, width + 5e-5, "up")))
        assert at_the_side(**effect)[:2] == pytest.approx(reference[:2], abs=np.abs(wider - reference).max())


def test_yielding_workpiece_shifts_the_cut_by_compliance_times_force() -> None:
    """The block moves away under -f, so the slot comes out displaced by C f relative to it, and less deep by C fz (upward)."""
    c = 2e-7
    f = slot(ap=0.01, workpiece_compliance=c)
    assert not np.array_equal(f, slot(ap=0.01))
    mill = Mill([-0.06, 0, -0.01], workpiece_compliance=c)
    last = mill.line([-0.06, 0, -0.01], [FEED, 0, 0], 600)[-1]
    h = mill.data["height"][0][: int(mill.s.nx) * int(mill.s.ny)].reshape(int(mill.s.ny), int(mill.s.nx))
    profile = h[:, 150] / h.min()
    y = (np.arange(len(profile)) + 0.5 - 0.5 * len(profile)) * float(mill.s.dy)
    assert (profile * y).sum() / profile.sum() == pytest.approx(c * last[1], rel=1e3 * ROUNDOFF)  # centre of the slot
    assert h.min() == pytest.approx(-0.01 + c * last[2], rel=1e3 * ROUNDOFF)


# ---------------------------------------------------------------- several tools
TOOLS = [[1, 0.016, 3, math.radians(30), 0.032], [5, 0.010, 2, math.radians(45), 0.012], [12, 0.020, 4, 0.0, 0.040]]
"""A tool table: number, diameter, teeth, helix, cutting length in SI."""


def scalars(row: list[float]) -> dict[str, Any]:
    """A row of the table as the parameters that describe tool 0."""
    return dict(zip(tool_table.COLUMNS[1:], row[1:], strict=True))


@pytest.mark.parametrize("row", TOOLS)
def test_a_tool_of_the_table_is_the_one_with_these_parameters(row: list[float]) -> None:
    """Bit by bit, with runout: diameter, teeth, helix and the radii of the teeth all come from the row."""
    options = {"ap": 0.006, "spindle": GROOVE, "runout": 1e-5}
    assert np.array_equal(slot(tools=TOOLS, tool=row[0], **options), slot(**scalars(row), **options))


def test_tool_0_and_an_empty_table_mean_the_parameters() -> None:
    reference = slot(steps=10)
    assert np.array_equal(slot(steps=10, tools=TOOLS), reference)
    assert np.array_equal(slot(steps=10, tool=5), reference)


def test_a_change_of_tool_goes_on_as_if_the_new_one_had_always_been_there_but_for_the_block() -> None:
    """Half of a slot with T1, up, change, beside it with T5: force and cut are those of T5 alone in a fresh block at that spindle angle."""
    changed = Mill([-0.02, 0.005, -0.005], tools=TOOLS, tool=1, spindle=GROOVE, runout=1e-5)
    changed.line([-0.02, 0.005, -0.005], [FEED, 0, 0], 100)
    changed.go([-0.02, 0.005, 0.01], [0, 0, 0])
    alone = Mill([-0.02, 0.005, 0.01], spindle=GROOVE, runout=1e-5, spindle_start_angle=float(changed.s.spindle_angle), **scalars(TOOLS[1]))
    changed.data["tool"] = 5
    results = []
    for mill in (changed, alone):
        above = mill.line([-0.02, -0.02, 0.01], [0, 0, 0], 1)
        results.append(np.vstack([above, mill.line([-0.06, -0.015, -0.005], [FEED, 0, 0], 400)]))
    assert np.array_equal(*results)
    assert np.abs(results[0][-1, :3]).max() > 10.0
    assert int(changed.s.mill_teeth) == 2


def test_a_tool_that_is_not_in_the_table_names_those_that_are() -> None:
    mill = Mill([0, 0, 0.1], tools=TOOLS)
    mill.data["tool"] = 3
    text = message(mill, mill.step(mill.s, 0.1, H))
    assert "at t = 0.1 s tool T3 is not in the table 'tools', which has [1 5 12]; add it there or correct the program" in text
    wrong = Mill([0, 0, 0.1], tools=TOOLS, tool=4)
    assert "tool T4 is not in the table" in message(wrong, wrong.status)


def test_a_larger_tool_does_not_come_into_the_spindle_in_a_narrow_slot() -> None:
    mill = Mill([0, 0, -0.005], tools=TOOLS, tool=1)
    mill.line([0, 0, -0.005], [FEED, 0, 0], 10)
    mill.data["tool"] = 12
    text = message(mill, mill.step(mill.s, 0.1, H))
    assert "tool T12 (diameter 0.02 m) stands 0.005000 m deep in material when it comes into the spindle; change it clear" in text
    smaller = Mill([0, 0, -0.005], tools=TOOLS, tool=1)
    smaller.line([0, 0, -0.005], [FEED, 0, 0], 10)
    smaller.data["tool"] = 5
    assert smaller.step(smaller.s, 0.1, H) == 0
    same = Mill([0, 0, -0.005], tools=TOOLS)  # D16 by its parameters, then D16 of the table: stands in its own hole
    same.data["tool"] = 1
    assert same.step(same.s, 0.1, H) == 0


@pytest.mark.parametrize("row", [[1, 0.01, 2, 0.5, 0.01], [2, 0.0, 2, 0.5, 0.01], [2, 0.01, 13, 0.5, 0.01], [2.5, 0.01, 2, 0.5, 0.01]])
def test_a_row_that_is_no_tool_is_shown(row: list[float]) -> None:
    mill = Mill([0, 0, 0.1], tools=[TOOLS[0], row])
    text = message(mill, mill.status)
    assert f"the table 'tools' has a row with number {row[0]:g}, diameter {row[1]:g} m, {row[2]:g} teeth, helix 0.5 rad" in text
    assert "expected a whole number of 1 or more that no row before has, 1 to 12 teeth" in text


# ---------------------------------------------------------------- spindle start angle
def test_spindle_start_angle_is_the_rotation_that_the_tool_starts_with() -> None:
    """A whole number of steps of 1.5 rad later is the same as starting there: the pattern of the runout goes on, to roundoff."""
    options = {"spindle": 1.5 / H, "runout": 1e-5, "feed": 0.01}
    pattern = slot(steps=40, **options)[:, :9]
    shifted = slot(steps=36, spindle_start_angle=4 * 1.5, **options)[:, :9]
    assert shifted == pytest.approx(pattern[4:], rel=1e5 * ROUNDOFF, abs=1e3 * ROUNDOFF)
    assert np.abs(shifted[:, :3] - pattern[:36, :3]).max() > 10.0
    whole_turn = slot(steps=36, spindle_start_angle=4 * 1.5 - 2 * math.pi, **options)[:, :9]
    assert whole_turn == pytest.approx(shifted, rel=1e5 * ROUNDOFF, abs=1e3 * ROUNDOFF)


# ---------------------------------------------------------------- parity
@pytest.mark.parametrize("effect", [None, "actual_feed", *EFFECTS])
def test_plain_and_compiled_agree_in_every_bit(effect: str | None) -> None:
    """A wandering path that plunges, ramps and leaves the block, on coarse dexels; the whole record is compared."""
    rng = np.random.default_rng(3)
    steps = 200 if effect is None else 40
    parameters: dict[str, Any] = {"spacing": 2e-3, "block_size": [0.02, 0.016, 0.02], "substeps": 3}
    parameters["quat_BP"] = Rotation.from_euler("z", 20, degrees=True).as_quat(scalar_first=True)
    if effect:
        parameters[effect] = EFFECTS.get(effect, 1)
    velocity = np.column_stack([np.full(steps, 0.05), 0.03 * rng.normal(size=steps), np.where(np.arange(steps) % 40 < 20, -0.04, 0.035)])
    path = np.array([-0.012, 0.0, 0.0005]) + np.cumsum(velocity * H, axis=0) + 1e-4 * rng.normal(size=(steps, 3))
    path[:, 2] = np.maximum(path[:, 2], -0.015)
    plain, fast = (Mill(path[0], compiled=c, spindle=GROOVE, **parameters) for c in (False, True))
    forces = 0.0
    for k in range(steps):
        a, b = plain.go(path[k], velocity[k]), fast.go(path[k], velocity[k])
        assert np.array_equal(a, b), f"step {k}"
        forces += float(np.abs(a).sum())
    assert plain.data.tobytes() == fast.data.tobytes()
    assert forces > 100.0


# ---------------------------------------------------------------- errors
def message(mill: Mill, status: int) -> str:
    return MODEL.message(status, mill.s, 0.1)


@pytest.mark.parametrize(
    "bad", [{"diameter": 0.0}, {"teeth": 0}, {"teeth": 13}, {"substeps": 0}, {"block_size": [0.1, 0.0, 0.1]}, {"stock_error": -0.05}]
)
def test_parameters_out_of_bounds(bad: dict[str, Any]) -> None:
    mill = Mill([0, 0, 0.1], **bad)
    assert mill.status != 0
    assert "a parameter is out of bounds: diameter" in message(mill, mill.status)


def test_workpiece_orientation_must_be_a_rotation() -> None:
    data = MODEL.new()
    data["quat_BP"] = [1.0, 0.1, 0.0, 0.0]
    status = MODEL.plain()[0](record(data))
    assert "is not of unit length; give w, x, y, z of a rotation" in MODEL.message(status, record(data), 0.0)


@pytest.mark.parametrize("spacing", [1e-4, 1e-9])
def test_too_many_dexels_names_the_finest_spacing_that_fits(spacing: float) -> None:
    """A block of 100 x 60 mm in 262144 cells: sqrt(6000/262144) mm = 0.1513 mm."""
    mill = Mill([0, 0, 0.1], spacing=spacing)
    assert "needs more cells than the 262144 available" in message(mill, mill.status)
    assert "use a spacing of 0.000152 m or more" in message(mill, mill.status)
    assert Mill([0, 0, 0.1], spacing=0.000152).status == 0


@pytest.mark.parametrize("name", ["p_BT_B", "quat_BT", "v_BT_B", "spindle_speed"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_inputs_must_be_finite(name: str, value: float) -> None:
    mill = Mill([0, 0, 0.1])
    mill.data[name] = value
    for status in (mill.init(mill.s), mill.step(mill.s, 0.1, H)):
        assert "at t = 0.1 s an input is not finite: p_BT_B" in message(mill, status)


def test_the_spindle_turns_one_way() -> None:
    mill = Mill([0, 0, 0.1])
    mill.data["spindle_speed"] = -10.0
    assert "spindle_speed is -10.0 rad/s; expected 0 or more" in message(mill, mill.step(mill.s, 0.1, H))


def test_tilted_tool_is_refused_in_the_work_only() -> None:
    mill = Mill([-0.08, 0, -0.005])
    mill.data["quat_BT"] = (DOWN * Rotation.from_euler("y", 11, degrees=True)).as_quat(scalar_first=True)
    assert mill.step(mill.s, 0.0, H) == 0
    mill.place([0, 0, -0.005])
    assert "against z of the block: cosine of the angle 0.981627, expected 0.9848" in message(mill, mill.step(mill.s, 0.1, H))
    mill.data["quat_BT"] = (DOWN * Rotation.from_euler("y", 9, degrees=True)).as_quat(scalar_first=True)
    assert mill.step(mill.s, 0.0, H) == 0


def test_feed_too_fast_for_the_spindle() -> None:
    mill = Mill([0, 0, -0.005], spindle=1.0, velocity=[FEED, 0, 0])
    mill.place([1e-4, 0, -0.005], [FEED, 0, 0])
    assert "the feed per tooth is 0.052360 m, more than the radius of the cutter" in message(mill, mill.step(mill.s, 0.1, H))


def test_deeper_than_the_edges_are_long() -> None:
    mill = Mill([0, 0, -0.02], cutting_length=0.015)
    mill.place([1e-4, 0, -0.02], [FEED, 0, 0])
    assert "0.020000 m above the tool tip, more than the cutting edges (0.015 m)" in message(mill, mill.step(mill.s, 0.1, H))


def test_step_size_must_be_positive() -> None:
    mill = Mill([0, 0, 0.1])
    assert "the step size must be positive" in message(mill, mill.step(mill.s, 0.1, 0.0))
