"""sensor_chain: what the force sensor shows, and what the signal processing makes of it."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.models.calibration.identification import fit_orientation_polynomial, identify_poses, orientation_features
from robomill.models.components.sensor_chain import CONFERENCE_MATRIX, HOSE, LAG_CAPACITY, MODEL, MOUNTING, OMEGA160, ForceSensor
from robomill.models.model.declaration import record
from robomill.models.model.parameters import load
from robomill.models.robot.kinematics import SPINDLE_ACROSS
from tests.tolerances import EXACT, ROUNDOFF, physics

H = 0.004
SCALE = 1000.0
"""N, N m: size of the numbers that are added and cancelled; ROUNDOFF is relative to it."""
POSE = np.deg2rad([10.0, -80.0, 85.0, 15.0, 20.0, -30.0])
QUIET = {"noise_f": 0, "noise_m": 0, "walk_f": 0, "walk_m": 0, "resolution_f": 0, "resolution_m": 0}
"""An ideal sensor: no noise, no drift of the zero, continuous reading."""
FORCE, MOMENT = np.array([120.0, -300.0, 80.0]), np.array([2.0, -1.0, 3.0])
EFFECTS = {
    "sensor_gain_error": 0.05,
    "sensor_gain_error_axis": [0.05, -0.03, 0.1, 0.02, 0.04, -0.05],
    "cross_talk": 0.02,
    "zero_drift": [5.0, -10.0, 20.0],
    "misalignment": [0.03, -0.02, 0.05],
    "extra_lag": 0.05,
    "weight_error": 8.0,
    "inertia": 1.0,
    "hose_force": 60.0,
    "clipping": 0.9,
    "cutoff_error": 0.5,
}


class Chain:
    """One instance, with parameters set and initialised under a constant load."""

    def __init__(self, compiled: bool = False, force: Any = 0.0, moment: Any = 0.0, q: Any = POSE, **parameters: Any) -> None:
        self.data = MODEL.new()
        self.s = record(self.data)
        self.init, self.step = MODEL.compiled() if compiled else MODEL.plain()
        for name, value in parameters.items():
            self.data[name] = value
        self.put(force, moment, q)
        self.k = 0
        assert self.init(self.s) == 0

    def put(self, force: Any = 0.0, moment: Any = 0.0, q: Any = POSE) -> None:
        """Set the inputs: force N, moment N m in B, axis angles rad."""
        self.data["f_T_B"], self.data["m_T_B"], self.data["q"] = force, moment, q

    def run(self, steps: int) -> np.ndarray:
        """Outputs [steps, 12]: f_S_raw, m_S_raw, f_T_T, m_T_T."""
        rows = np.zeros((steps, 12))
        for row in rows:
            assert self.step(self.s, self.k * H, H) == 0
            self.k += 1
            row[:] = self.outputs
        return rows

    @property
    def outputs(self) -> np.ndarray:
        """f_S_raw, m_S_raw, f_T_T, m_T_T as they stand."""
        return np.concatenate([self.s.f_S_raw, self.s.m_S_raw, self.s.f_T_T, self.s.m_T_T])

    @property
    def R_BS(self) -> np.ndarray:
        """Orientation of the nominal sensor in B."""
        return np.array(self.s.R_BS)

    @property
    def R_BT(self) -> np.ndarray:
        """Orientation of the tool tip in B."""
        return np.array(self.s.link_R[6])


def poses(n: int, seed: int = 0) -> np.ndarray:
    """Axis angles [n, 6] that turn the sensor into all directions."""
    low, high = np.array([-1.0, -2.0, 0.5, -3.0, -2.0, -3.0]), np.array([1.0, -1.0, 2.0, 3.0, 2.0, 3.0])
    return np.random.default_rng(seed).uniform(low, high, (n, 6))


def process(scale: float = 200.0, n: int = 1, seed: int = 1) -> np.ndarray:
    """Some wrenches [n, 6] at the tool tip, N and N m."""
    return np.random.default_rng(seed).normal(0.0, scale, (n, 6)) * np.array([1, 1, 1, 0.02, 0.02, 0.02])


# ------------------------------------------------------------------------------------------- physics


def test_no_force_in_no_force_out_in_any_pose() -> None:
    """Nominally weight, offsets and hose pack are removed completely, whatever the sensor itself shows."""
    for q in poses(20):
        chain = Chain(q=q, **QUIET)
        assert np.linalg.norm(chain.s.f_S_raw) > 300.0  # 60 kg hang on it
        assert np.abs(chain.outputs[6:]).max() < ROUNDOFF * SCALE


def test_the_force_at_the_tool_comes_back_as_it_went_in() -> None:
    """Statically, over the sensor and back: f_T_T = R_BT^T f_T_B and the same for the moment, at 100 poses and loads."""
    for q, load_ in zip(poses(100), process(n=100), strict=True):
        chain = Chain(force=load_[:3], moment=load_[3:], q=q, **QUIET)
        assert np.abs(chain.s.f_T_T - chain.R_BT.T @ load_[:3]).max() < ROUNDOFF * SCALE
        assert np.abs(chain.s.m_T_T - chain.R_BT.T @ load_[3:]).max() < ROUNDOFF * SCALE


def test_the_raw_wrench_is_weight_plus_hose_plus_offset_plus_process() -> None:
    """By hand in a pose with the flange level and the sensor upright: A = (0, -90, 90, 0, 90, 0), z of S down, 60 kg.

    The process force of 100 N along z of B acts at T, 0.237 m along x and 0.222 m along z of S.
    """
    chain = Chain(force=[0, 0, 100.0], q=np.deg2rad([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]), hose_coefficients=0, **QUIET)
    assert np.allclose(chain.R_BS[:, 2], [0, 0, -1], rtol=0.0, atol=ROUNDOFF)
    weight = 60.0 * 9.81
    assert np.allclose(chain.s.f_S_raw, [12.0, -7.0, 25.0 + weight - 100.0], rtol=0, atol=ROUNDOFF * SCALE)
    # r x f with r = (0.237, 0, 0.222) and f = (0, 0, -100): (0, 23.7, 0); the weight acts through the sensor axis
    assert np.allclose(chain.s.m_S_raw, [1.5, -2.0 + 23.7, 0.7], rtol=0, atol=ROUNDOFF * SCALE)


def test_hose_polynomial_is_the_fit_to_the_elastic_hose_of_its_file() -> None:
    """The coefficients are calibrated data: computed again here from the hose that the file describes."""
    upright = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # flange forward, spindle down
    tip = np.array([1.595, -0.018, 1.099])  # position 4 of Fig. 9
    angles = np.deg2rad([-60.0, 0.0, 60.0])
    R = np.array([upright @ Rotation.from_euler("ZYX", abc).as_matrix() for abc in itertools.product(angles, angles, angles)])
    arm = HOSE.anchor_B - tip - R @ (HOSE.p_FH_F - SPINDLE_ACROSS.p_FT_F)
    length = np.linalg.norm(arm, axis=1, keepdims=True)
    pull = arm / length * (HOSE.pull + HOSE.rate * (length - HOSE.free_length))
    force = np.einsum("nji,nj->ni", R, pull)
    quat = Rotation.from_matrix(R).as_quat()[:, [3, 0, 1, 2]]
    fitted = fit_orientation_polynomial(quat, force, linear=False)
    assert np.abs(fitted - HOSE.coefficients).max() <= physics(1.0, absolute=5e-5)  # the file has four decimals
    residual = np.sqrt(np.mean((orientation_features(quat) @ HOSE.coefficients - force) ** 2))
    assert abs(residual - 0.5) <= physics(0.5, absolute=0.05)  # as the file says; FACTS section 6 allows 5 N


def test_identification_of_the_simulated_sensor_removes_everything_at_other_poses() -> None:
    """The whole procedure of sec. 2.6 on this sensor: 27 poses, then Eqs. (12)-(18) at 20 new ones, noise off."""
    chains = [Chain(q=q, **QUIET) for q in poses(27, seed=3)]
    R = np.array([c.R_BS for c in chains])
    force, moment = (np.array([getattr(c.s, name) for c in chains]) for name in ("f_S_raw", "m_S_raw"))
    found = identify_poses(R, force, moment)
    quat = np.array([c.s.quat_BS for c in chains])
    rest = force - found.wrench(R)[0]
    polynomial = fit_orientation_polynomial(quat, rest, linear=False)
    model = {"model_weight_B": found.weight_B, "model_offset_f": found.offset_f, "model_hose": polynomial}
    for q in poses(20, seed=4):
        chain = Chain(q=q, **QUIET, **model)
        assert np.abs(chain.s.f_T_T).max() < 1e3 * ROUNDOFF * SCALE  # conditioning of the 27 poses
    # without hose pack the moments are identified exactly as well
    chains = [Chain(q=q, hose_coefficients=0, **QUIET) for q in poses(27, seed=3)]
    found = identify_poses(R, *(np.array([getattr(c.s, name) for c in chains]) for name in ("f_S_raw", "m_S_raw")))
    assert np.abs(found.weight_B - MODEL.variable("model_weight_B").start_values).max() < 100 * ROUNDOFF * SCALE
    assert np.abs(found.cog_S - MODEL.variable("model_cog_S").start_values).max() < 100 * ROUNDOFF
    assert np.abs(found.offset_m - MOUNTING.offset_m).max() < 100 * ROUNDOFF * SCALE


def test_step_of_force_arrives_half_after_50_ms() -> None:
    """FACTS section 7: filter alone t50 = 50 ms, t90 = 77 ms; DC gain 1."""
    chain = Chain(compiled=True, **QUIET)
    chain.put(force=chain.R_BT @ [400.0, 0, 0])
    y = chain.run(200)[:, 6] / 400.0
    t = np.arange(200) * H  # counted from the first sample that sees the step, as in check_facts.py
    assert abs(np.interp(0.5, y[:40], t[:40]) - 0.050) <= physics(0.050, absolute=0.0005)
    assert abs(np.interp(0.9, y[:40], t[:40]) - 0.077) <= physics(0.077, absolute=0.0005)
    assert abs(y[-1] - 1.0) < 1e-9


def test_spindle_line_of_13000_rpm_does_not_get_through() -> None:
    """216.67 Hz appears at 33.33 Hz; the window of 15 removes it (FACTS 7: more than 100 dB)."""
    chain = Chain(compiled=True, **QUIET)
    amplitudes = []
    for k in range(400):
        chain.put(force=[0, 100.0 * math.sin(2 * math.pi * 13000 / 60 * (k + 1) * H), 0])
        amplitudes.append(np.abs(chain.run(1)[0, 6:9]).max())
    assert max(amplitudes[200:]) < 1e-3


def test_noise_has_its_variance_before_and_after_the_filters() -> None:
    """White noise of sigma: s^2 (n-1)/sigma^2 is chi-square distributed; 99.9 % interval, normal approximation.

    Filtered, its variance is sigma^2 times the sum of the squared impulse response of the chain.
    """
    n = 8000
    sensor = {**QUIET, "noise_f": 1.0, "noise_m": 0.1, "p_FS_F": SPINDLE_ACROSS.p_FT_F}  # no lever: S at T, so moments do not mix
    rows = Chain(compiled=True, **sensor).run(n)
    raw = rows[:, :6] / np.repeat([1.0, 0.1], 3)
    assert np.abs(raw.var(axis=0, ddof=1) - 1.0).max() < 3.3 * math.sqrt(2.0 / n)
    assert np.abs(np.corrcoef(raw.T) - np.eye(6)).max() < 4.0 / math.sqrt(n)
    impulse = Chain(compiled=True, **QUIET)
    impulse.put(force=impulse.R_BT @ [1.0, 0, 0])
    first = impulse.run(1)
    impulse.put()
    gain = float(np.sum(np.concatenate([first, impulse.run(300)])[:, 6] ** 2))
    filtered = rows[100:, 6:] / np.repeat([1.0, 0.1], 3)
    # successive samples are correlated: the effective number is n times the noise bandwidth, about gain
    assert np.abs(filtered.var(axis=0) / gain - 1.0).max() < 3.3 * math.sqrt(2.0 / (n * gain))


def test_zero_walks_randomly_and_another_seed_is_another_repeat() -> None:
    """0.1 N per square root of a minute: over 80 seeds, one second each, three axes, the variance of the bias is 0.01/60 N^2."""
    quiet = {**QUIET, "walk_f": 0.1}
    ends = []
    for seed in range(80):
        chain = Chain(compiled=True, seed=seed, **quiet)
        start = chain.outputs[:3]
        ends.append(chain.run(250)[-1, :3] - start)
    variance = np.var(np.array(ends))
    assert abs(variance * 60.0 / 0.01 - 1.0) < 4.0 * math.sqrt(2.0 / 240)


def test_reading_is_quantised_and_clipped_to_the_range() -> None:
    chain = Chain(force=[1e5, 0, 0])
    rows = chain.run(5)
    full = np.concatenate([OMEGA160.range_f, OMEGA160.range_m])
    assert np.all(np.abs(rows[:, :6]) <= full)
    assert np.any(np.abs(rows[:, :6]) == full)
    chain.put()
    rows = chain.run(50)
    for column, step in enumerate([*OMEGA160.resolution_f, *OMEGA160.resolution_m]):
        assert np.abs(rows[:, column] - step * np.round(rows[:, column] / step)).max() < ROUNDOFF * SCALE
        assert len(np.unique(rows[:, column])) > 1  # the noise moves it by more than a step now and then


@pytest.mark.parametrize(("name", "saturated"), [("si1000", True), ("si1500", True), ("si2500", False)])
def test_only_the_largest_calibration_holds_the_nominal_cut(name: str, saturated: bool) -> None:
    """546 N at the tool (sec. 3.2) in the worst direction, 325 mm from the sensor, adds 177 N m to the 101 N m of 60 kg."""
    sensor = load(ForceSensor, f"sensors/ati_omega160_{name}")
    level = Chain(q=np.deg2rad([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]))
    lever = np.array(level.s.p_ST_S)
    assert abs(np.linalg.norm(lever) - 0.325) <= physics(0.325, absolute=0.0005)
    force = level.R_BS @ np.cross([0, 546.0, 0], lever) / np.linalg.norm(lever)
    chain = Chain(force=force, q=level.s.q, range_f=sensor.range_f, range_m=sensor.range_m, **QUIET)
    assert np.abs(chain.s.f_T_T - chain.R_BT.T @ force).max() < ROUNDOFF * SCALE
    assert (np.abs(chain.s.m_T_T).max() > 1.0) == saturated


def test_all_sensor_files_load() -> None:
    """FACTS 5.1: ranges of the three calibrations."""
    for name, force, moment in (("si1000", 1000.0, 120.0), ("si1500", 1500.0, 240.0), ("si2500", 2500.0, 400.0)):
        sensor = load(ForceSensor, f"sensors/ati_omega160_{name}")
        assert np.array_equal(sensor.range_f, [force, force, 2.5 * force])
        assert np.array_equal(sensor.range_m, [moment] * 3)


# ------------------------------------------------------------------------------------------- effects


def raw_and_tool(**parameters: Any) -> tuple[np.ndarray, np.ndarray]:
    """Static readings [6] and tool wrench [6] under the test load."""
    chain = Chain(force=FORCE, moment=MOMENT, **{**QUIET, **parameters})
    return chain.outputs[:6], chain.outputs[6:]


def true_wrench() -> np.ndarray:
    """What acts on the sensor under the test load: the raw reading without offsets."""
    return raw_and_tool()[0] - np.concatenate([MOUNTING.offset_f, MOUNTING.offset_m])


def test_gain_error_scales_what_acts_but_not_the_offset() -> None:
    common = raw_and_tool(sensor_gain_error=0.05)[0] - raw_and_tool()[0]
    assert np.allclose(common, 0.05 * true_wrench(), rtol=0, atol=ROUNDOFF * SCALE)
    axes = np.array(EFFECTS["sensor_gain_error_axis"])
    each = raw_and_tool(sensor_gain_error_axis=axes)[0] - raw_and_tool()[0]
    assert np.allclose(each, axes * true_wrench(), rtol=0, atol=ROUNDOFF * SCALE)


def test_cross_talk_mixes_channels_relative_to_full_scale() -> None:
    full = np.concatenate([OMEGA160.range_f, OMEGA160.range_m])
    change = raw_and_tool(cross_talk=0.02)[0] - raw_and_tool()[0]
    assert np.allclose(change, 0.02 * full * (CONFERENCE_MATRIX @ (true_wrench() / full)), rtol=0, atol=ROUNDOFF * SCALE)
    assert np.array_equal(CONFERENCE_MATRIX @ CONFERENCE_MATRIX.T, 5.0 * np.eye(6))


def test_zero_drift_grows_with_its_time_constant() -> None:
    chain = Chain(compiled=True, zero_drift=[0, 0, 20.0], zero_drift_time=0.5, zero_age=0.0, **QUIET)
    rows = chain.run(500)
    t = (np.arange(500) + 1) * H
    still = Chain(**QUIET).outputs
    assert np.abs(rows[:, 2] - still[2] - 20.0 * (1 - np.exp(-t / 0.5))).max() < ROUNDOFF * SCALE
    assert np.abs(rows[:, [0, 1, 3, 4, 5]] - still[[0, 1, 3, 4, 5]]).max() == EXACT
    old = Chain(zero_drift=[0, 0, 20.0], **QUIET).outputs  # an hour after zeroing: all of it is there from the start
    assert abs(old[2] - still[2] - 20.0) < 20.0 * math.exp(-3600 / 600) * 1.001


def test_misalignment_turns_force_and_moment_against_the_rotation_of_the_sensor() -> None:
    turn = Rotation.from_rotvec(EFFECTS["misalignment"]).inv()
    raw = raw_and_tool(misalignment=EFFECTS["misalignment"])[0]
    offsets = np.concatenate([MOUNTING.offset_f, MOUNTING.offset_m])
    expected = np.concatenate([turn.apply(true_wrench()[:3]), turn.apply(true_wrench()[3:])]) + offsets
    assert np.allclose(raw, expected, rtol=0, atol=ROUNDOFF * SCALE)


def test_weight_error_hangs_at_the_centre_of_gravity() -> None:
    chain = Chain(weight_error=8.0, **QUIET)
    force = chain.R_BS.T @ [0, 0, -8.0 * 9.81]
    change = chain.outputs[:6] - Chain(**QUIET).outputs[:6]
    expected = np.concatenate([force, np.cross(MODEL.variable("load_cog_S").start_values, force)])
    assert np.allclose(change, expected, rtol=0, atol=ROUNDOFF * SCALE)


def test_hose_force_pulls_towards_its_anchor_from_its_fixing_point() -> None:
    chain = Chain(hose_force=60.0, **QUIET)
    change = chain.outputs[:6] - Chain(**QUIET).outputs[:6]
    point = MODEL.variable("hose_point_S").start_values
    arm = HOSE.anchor_B - chain.s.p_BS_B - chain.R_BS @ point
    force = chain.R_BS.T @ (60.0 * arm / np.linalg.norm(arm))
    assert np.allclose(change, np.concatenate([force, np.cross(point, force)]), rtol=0, atol=ROUNDOFF * SCALE)


def test_clipping_takes_away_range_from_the_reading() -> None:
    raw = raw_and_tool(clipping=0.9)[0]
    full = 0.1 * np.concatenate([OMEGA160.range_f, OMEGA160.range_m])
    assert np.allclose(raw, np.clip(raw_and_tool()[0], -full, full), rtol=0, atol=ROUNDOFF * SCALE)
    assert np.any(raw != raw_and_tool()[0])


@pytest.mark.parametrize("lag", [0.004, 0.05, 0.1])
def test_extra_lag_delays_the_reading_by_whole_and_by_broken_samples(lag: float) -> None:
    inputs = process(n=120)
    late, prompt = Chain(extra_lag=lag, **QUIET), Chain(**QUIET)
    rows = []
    for chain in (late, prompt):
        rows.append([])
        for load_ in inputs:
            chain.put(load_[:3], load_[3:])
            rows[-1].append(chain.run(1)[0])
    a, b = np.array(rows)
    whole = math.floor(lag / H + 1e-9)
    part = lag / H - whole
    n = whole + 1
    expected = (1 - part) * b[n - whole : len(b) - whole] + part * b[n - whole - 1 : len(b) - whole - 1]
    assert np.abs(a[n:, :6] - expected[:, :6]).max() < 10 * ROUNDOFF * SCALE


def test_extra_lag_may_be_of_first_order() -> None:
    """A ramp of force at 100 N/s: a part of the lag of first order is as late as a dead time, after 20 of its time constants.

    A step of 100 N: (1 - exp(-t/T)) of it after the dead time, exact between samples as the input runs straight over one.
    """
    rate, lag = 100.0, 0.04
    chains = [Chain(extra_lag=lag, extra_lag_first_order=part, **QUIET) for part in (0.0, 0.5, 1.0)]
    for k in range(1, 201):
        for chain in chains:
            chain.put([rate * k * H, 0.0, 0.0])
            chain.run(1)
    dead, half, first = (np.array(chain.s.wrench[:3]) for chain in chains)
    np.testing.assert_allclose(half, dead, rtol=0.0, atol=1e2 * ROUNDOFF * SCALE)
    assert np.abs(first - dead).max() < physics(rate * lag, math.exp(-0.8 / lag)) + 1e2 * ROUNDOFF * SCALE  # what is left after 0.8 s
    step = Chain(extra_lag=lag, extra_lag_first_order=1.0, **QUIET)
    before = np.array(step.s.wrench[:3])
    way = np.array([100.0, 0.0, 0.0])
    step.put(way)
    step.run(1)
    # the input rises over the first sample, the lag follows: u - T/h (1 - exp(-h/T)) u
    share = 1.0 - lag / H * (1.0 - np.exp(-H / lag))
    moved = np.linalg.norm(np.array(step.s.wrench[:3]) - before)
    assert abs(moved - share * 100.0) < 1e2 * ROUNDOFF * SCALE
    step.run(10)
    moved = np.linalg.norm(np.array(step.s.wrench[:3]) - before)
    assert abs(moved - (100.0 - (100.0 - share * 100.0) * np.exp(-10 * H / lag))) < 1e2 * ROUNDOFF * SCALE


def test_inertia_is_mass_times_acceleration_of_the_centre_of_gravity() -> None:
    """Axis 1 turning at a constant rate: centripetal acceleration w^2 r of the centre of gravity, known in closed form."""
    rate = 2.0
    chain = Chain(compiled=True, inertia=1.0, q=[0.0, *POSE[1:]], **QUIET)
    still = Chain(compiled=True, q=[0.0, *POSE[1:]], **QUIET)
    for k in range(3):
        for c in (chain, still):
            c.put(q=[rate * (k + 1) * H, *POSE[1:]])
            c.run(1)
    p = np.array(chain.s.p_last) * [1, 1, 0]  # second differences belong to the sample before the last
    expected = chain.R_BS.T @ (60.0 * rate**2 * p)
    change = chain.outputs[:3] - still.outputs[:3]
    # second difference of a circle: relative error (w h)^2 / 12; roundoff m eps |p| / h^2
    assert np.abs(change - expected).max() < np.linalg.norm(expected) * (rate * H) ** 2 / 12 * 1.01 + 60 * 4e-16 * 3 / H**2
    assert np.linalg.norm(expected) > 100.0


def test_wrong_cutoff_leaves_the_reading_alone_and_speeds_up_the_filter() -> None:
    a, b = Chain(cutoff_error=0.5, **QUIET), Chain(filter_cutoff=15.0, **QUIET)
    for chain in (a, b):
        chain.put(force=FORCE)
    assert np.abs(a.run(40) - b.run(40)).max() == EXACT


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_changes_something_and_is_nothing_at_zero(effect: str) -> None:
    """Bitwise: with the effect at zero the run is that of an untouched instance, although its neighbours differ."""

    def run(value: Any) -> np.ndarray:
        chain = Chain(compiled=True, **{effect: value})
        rows = []
        for k, load_ in enumerate(process(n=60)):
            chain.put(load_[:3], load_[3:], POSE + 1e-3 * math.sin(0.3 * k))
            rows.append(chain.run(1)[0])
        return np.array(rows)

    untouched = run(np.zeros_like(EFFECTS[effect]))
    assert MODEL.variable(effect).effect
    assert np.abs(run(EFFECTS[effect])[:, 6:] - untouched[:, 6:]).max() > 0.1
    assert {v.name for v in MODEL.variables if v.effect} == set(EFFECTS)


# ------------------------------------------------------------------------------------ numerics, parity


def test_init_is_idempotent_and_holds_a_steady_state() -> None:
    chain = Chain(force=FORCE, moment=MOMENT, **QUIET)
    once = chain.data.tobytes()
    assert chain.init(chain.s) == 0
    assert chain.data.tobytes() == once
    start = chain.outputs
    assert np.abs(chain.run(50) - start).max() < ROUNDOFF * SCALE
    assert chain.init(chain.s) == 0
    assert np.array_equal(chain.outputs, start)


@pytest.mark.parametrize("parameters", [{}, EFFECTS, {"quat_FS": [0.5, 0.5, 0.5, 0.5], "filter_cutoff": 0.0, "filter_window": 1}])
def test_plain_and_compiled_are_the_same_bits(parameters: dict[str, Any]) -> None:
    """All variables, states and scratch included, over 200 steps with noise."""
    plain, compiled = Chain(**parameters), Chain(compiled=True, **parameters)
    assert plain.data.tobytes() == compiled.data.tobytes()
    for k, load_ in enumerate(process(n=200)):
        for chain in (plain, compiled):
            chain.put(load_[:3], load_[3:], POSE + 0.01 * math.sin(0.05 * k))
            chain.run(1)
        assert plain.data.tobytes() == compiled.data.tobytes(), f"step {k}"


def test_state_saved_and_put_back_continues_with_the_same_noise() -> None:
    chain = Chain(compiled=True)
    chain.run(37)
    saved, k = chain.data.copy(), chain.k
    first = chain.run(20)
    chain.data[:] = saved
    chain.k = k
    assert np.array_equal(chain.run(20), first)


# -------------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        (
            {"filter_cutoff": 130.0},
            "the low-pass cannot have its cut-off at 130 Hz when sampled every 0.004 s; filter_cutoff must stay below",
        ),
        ({"filter_window": 0}, "filter_window is 0, expected 1 to 250 samples"),
        ({"filter_window": 251}, "filter_window is 251, expected 1 to 250 samples"),
        ({"extra_lag": 0.6}, f"extra_lag is 0.6 s, the delay line holds {LAG_CAPACITY - 2} samples of sample_time = 0.004 s; shorten"),
        (
            {"quat_FS": [1.0, 1.0, 0.0, 0.0]},
            "quat_FS (1, 1, 0, 0) has not the length 1; give the orientation of S in F as a unit quaternion",
        ),
    ],
)
def test_wrong_parameters_are_refused_with_a_remedy(parameters: dict[str, Any], text: str) -> None:
    data = MODEL.new()
    for name, value in parameters.items():
        data[name] = value
    s = record(data)
    status = MODEL.init(s)
    assert status != 0
    assert text in MODEL.message(status, s, 0.0)


def test_another_step_size_is_refused() -> None:
    chain = Chain()
    status = chain.step(chain.s, 0.0, 0.001)
    expected = "the step size is 0.001 s at t = 0 s, but the filters are designed for sample_time = 0.004 s; set the parameter sample_time"
    assert expected in MODEL.message(status, chain.s, 0.0)
    fast = Chain(sample_time=0.001)
    assert fast.step(fast.s, 0.0, 0.001) == 0
