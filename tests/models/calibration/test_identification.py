"""Identification of weight, offset, centre of gravity and hose pack: exact on exact data, honest on noisy data."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.models.calibration.features import FEATURES
from robomill.models.calibration.identification import (
    THREE_POSES,
    Load,
    PayloadFit,
    fit_orientation_polynomial,
    identify_payload,
    identify_poses,
    identify_three_poses,
    orientation_features,
    quaternion_from_abc,
)
from tests.tolerances import ROUNDOFF, chance, of_variance, physics

WEIGHT = 60 * 9.81
TRUE = Load(np.array([0.0, 0.0, -WEIGHT]), np.array([0.012, -0.02, 0.135]), np.array([12.0, -7.0, 25.0]), np.array([1.5, -2.0, 0.7]))


def orientation_with_up(up: np.ndarray) -> np.ndarray:
    """Some R_BS [3, 3] whose third row, the upward direction in S, is `up`."""
    first = np.cross([0.3, 0.5, -0.8], up)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first), up])


def poses(n: int, seed: int = 4) -> np.ndarray:
    return Rotation.random(n, random_state=seed).as_matrix()


def quaternions(n: int, seed: int = 5) -> np.ndarray:
    q = Rotation.random(n, random_state=seed).as_quat()
    return q[:, [3, 0, 1, 2]]


def distance(a: Load, b: Load) -> float:
    """Largest relative deviation; moments and levers relative to 1 N m and 0.1 m."""
    return max(
        float(np.abs(a.weight_B - b.weight_B).max()) / WEIGHT,
        float(np.abs(a.cog_S - b.cog_S).max()) / 0.1,
        float(np.abs(a.offset_f - b.offset_f).max()) / 25.0,
        float(np.abs(a.offset_m - b.offset_m).max()),
    )


# ------------------------------------------------------------------------------------------- physics


def test_wrench_of_a_load_is_weight_times_lever() -> None:
    """Flange level, CoG 135 mm below along z of S: force and moment by hand."""
    force, moment = Load(np.array([0, 0, -100.0]), np.array([0.2, 0, 0.135]), np.zeros(3), np.zeros(3)).wrench(np.eye(3)[None])
    assert np.array_equal(force, [[0, 0, -100.0]])
    assert np.allclose(moment, [[0, 20.0, 0]], rtol=ROUNDOFF, atol=0.0)


def test_three_poses_recover_everything() -> None:
    """Eqs. (12)-(15) with the corrected Eq. (13); the example of check_facts.py, section ft."""
    force, moment = TRUE.wrench(np.array([orientation_with_up(up) for up in THREE_POSES]))
    # the gravity directions that the equations imply, FACTS 8.2
    expected = np.array([[-WEIGHT / math.sqrt(2), -WEIGHT / math.sqrt(2), 0], [0, 0, WEIGHT], [0, -WEIGHT, 0]]) + TRUE.offset_f
    assert np.abs(force - expected).max() < ROUNDOFF * WEIGHT
    assert distance(identify_three_poses(force, moment), TRUE) < 100 * ROUNDOFF  # differences of numbers 100 times as large


def test_equation_13_as_printed_would_be_416_newton_wrong() -> None:
    """FACTS 0.4: why the factor is 1/sqrt(2) and not sqrt(2)."""
    force, _ = TRUE.wrench(np.array([orientation_with_up(up) for up in THREE_POSES]))
    weight = force[0, 2] - force[1, 2]
    printed = force[0, 0] - math.sqrt(2) * weight
    assert abs((printed - TRUE.offset_f[0]) - 416.0) <= physics(416.0, absolute=0.5)


def test_least_squares_recovers_everything_and_the_tilt_of_the_base() -> None:
    tilted = Load(Rotation.from_euler("xy", [1.0, -0.5], degrees=True).apply([0, 0, -WEIGHT]), TRUE.cog_S, TRUE.offset_f, TRUE.offset_m)
    R = poses(27)
    found = identify_poses(R, *tilted.wrench(R))
    assert distance(found, tilted) < 100 * ROUNDOFF
    assert abs(found.weight - WEIGHT) < 100 * ROUNDOFF * WEIGHT


def test_least_squares_agrees_with_three_poses() -> None:
    R = np.array([orientation_with_up(up) for up in THREE_POSES])
    force, moment = TRUE.wrench(R)
    assert distance(identify_poses(R, force, moment), identify_three_poses(force, moment)) < 100 * ROUNDOFF


def test_noise_leaves_the_published_errors() -> None:
    """FACTS 8.3: 12 poses, 0.5 N and 0.05 N m noise, 60 kg: errors of 0.06 N, 0.15 N, 0.02 mm, 0.04 N m.

    Those are one draw; here the rms of 50 draws must stay within four times that and above a quarter.
    """
    rng = np.random.default_rng(3)
    errors = []
    for draw in range(50):
        R = poses(12, seed=draw)
        force, moment = TRUE.wrench(R)
        found = identify_poses(R, force + rng.normal(0, 0.5, force.shape), moment + rng.normal(0, 0.05, moment.shape))
        errors.append(
            [
                found.weight - WEIGHT,
                *(found.offset_f - TRUE.offset_f),
                *(found.cog_S - TRUE.cog_S) * 1e3,
                *(found.offset_m - TRUE.offset_m),
            ]
        )
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    published = np.array([0.06, *[0.15] * 3, *[0.02] * 3, *[0.04] * 3])
    assert np.all(rms < 4 * published)
    assert np.all(rms > published / 4)


def test_quaternion_of_the_published_angles() -> None:
    """FACTS 8.1: A = 30, B = 20, C = 10 deg (its last number is printed to eight digits only)."""
    quat = quaternion_from_abc(*np.deg2rad([30.0, 20.0, 10.0]))
    published = np.array([0.951548525, 0.038134577, 0.189307857, 0.239298341])
    assert np.abs(quat - published).max() <= physics(1.0, absolute=5e-9)


def test_quaternion_is_that_of_scipy_and_its_scalar_part_is_never_negative() -> None:
    """Eq. (16) against scipy's z-y'-x'' at 100 seeded triples over all quadrants."""
    for a, b, c in np.random.default_rng(0).uniform(-math.pi, math.pi, (100, 3)):
        quat = quaternion_from_abc(a, b, c)
        expected = Rotation.from_euler("ZYX", [a, b, c]).as_quat()[[3, 0, 1, 2]]
        assert quat[0] >= 0.0
        assert np.abs(quat - math.copysign(1.0, expected[0]) * expected).max() < ROUNDOFF


def test_basis_has_rank_14_and_both_signs_of_a_quaternion_give_the_same_terms() -> None:
    q = quaternions(200)
    features = orientation_features(q)
    assert features.shape == (200, FEATURES)
    assert np.linalg.matrix_rank(features) == 14
    assert np.array_equal(orientation_features(-q), features)


def test_polynomial_reproduces_a_polynomial_at_other_orientations() -> None:
    """27 poses as in the paper determine Eq. (17): its values everywhere, though not its 15 coefficients."""
    truth = np.random.default_rng(6).normal(0.0, 20.0, (FEATURES, 3))
    q, other = quaternions(27), quaternions(100, seed=8)
    found = fit_orientation_polynomial(q, orientation_features(q) @ truth)
    # conditioning of 27 random poses amplifies the rounding by some hundreds
    assert np.abs(orientation_features(other) @ (found - truth)).max() < 1e4 * ROUNDOFF * 20.0
    assert np.linalg.norm(found) <= np.linalg.norm(truth) * (1 + ROUNDOFF)  # the smallest of all solutions


def test_rigid_gravity_is_a_quadratic_form_of_the_quaternion() -> None:
    """So the polynomial alone would remove the weight as well, and the model must be subtracted first (FACTS 8.1)."""
    q = quaternions(40)
    gravity = Rotation.from_quat(q[:, [1, 2, 3, 0]]).inv().apply([0, 0, -WEIGHT])
    coefficients = fit_orientation_polynomial(q, gravity)
    assert np.abs(orientation_features(q) @ coefficients - gravity).max() < 1e3 * ROUNDOFF * WEIGHT
    assert np.abs(coefficients[1:5]).max() < 1e3 * ROUNDOFF * WEIGHT  # no linear terms


def test_without_linear_terms_the_polynomial_is_continuous_everywhere() -> None:
    """Across scalar part 0 the linear terms change sign; the quadratic ones do not."""
    before, after = quaternion_from_abc(math.pi - 1e-9, 0.3, 0.0), quaternion_from_abc(math.pi + 1e-9, 0.3, 0.0)
    assert before[3] * after[3] < 0.0  # the same orientation but for 2e-9 rad, and yet the other quaternion
    truth = np.random.default_rng(11).normal(0.0, 20.0, (FEATURES, 3))
    truth[1:5] = 0.0
    q = quaternions(27)
    found = fit_orientation_polynomial(q, orientation_features(q) @ truth, linear=False)
    assert not np.any(found[1:5])
    assert np.abs(orientation_features(quaternions(100, seed=8)) @ (found - truth)).max() < 1e3 * ROUNDOFF * 20.0
    assert np.abs(np.diff(orientation_features(np.array([before, after])) @ found, axis=0)).max() < 1e-6


def test_ridge_keeps_the_coefficients_small_where_the_poses_are_clustered() -> None:
    q = np.array([quaternion_from_abc(*np.deg2rad(abc)) for abc in np.random.default_rng(9).uniform(-4, 4, (27, 3))])
    force = np.random.default_rng(10).normal(0.0, 1.0, (27, 3))  # nothing but noise
    damped = fit_orientation_polynomial(q, force, ridge=1e-3)
    assert np.abs(orientation_features(quaternions(100)) @ damped).max() < 50.0
    assert np.abs(orientation_features(quaternions(100)) @ fit_orientation_polynomial(q, force)).max() > 500.0


# ------------------------------------------------------------------------------------- uncertainties


def noisy_fits(R: np.ndarray, draws: int, noise_f: float = 1.0, seed: int = 0) -> list[PayloadFit]:
    """The load TRUE measured at the orientations R, 1 N and 0.1 N m noise, so many times."""
    rng, (force, moment) = np.random.default_rng(seed), TRUE.wrench(R)
    return [
        identify_payload(R, force + noise_f * rng.normal(0, 1.0, force.shape), moment + rng.normal(0, 0.1, moment.shape))
        for _ in range(draws)
    ]


def test_covariances_are_those_of_repeated_measurements() -> None:
    """Scatter of 1000 draws at 15 orientations, that of the lever with what the weight adds."""
    R, draws = poses(15), 1000
    fits = noisy_fits(R, draws)
    for value, deviation in (
        (lambda f: f.load.weight_B, lambda f: f.deviation_weight_B),
        (lambda f: f.load.offset_f, lambda f: f.deviation_offset_f),
        (lambda f: f.load.cog_S, lambda f: f.deviation_cog_S),
        (lambda f: f.load.offset_m, lambda f: f.deviation_offset_m),
        (lambda f: f.tilt, lambda f: f.deviation_tilt),
        (lambda f: np.array([f.load.weight]), lambda f: np.array([f.deviation_weight])),
    ):
        scatter = np.std([value(f) for f in fits], axis=0)
        stated = np.sqrt(np.mean(np.square([deviation(f) for f in fits]), axis=0))
        assert np.abs(scatter / stated - 1.0).max() < chance(of_variance(draws) / 2.0) + chance(of_variance(draws * 39) / 2.0)
    assert np.mean([f.residual_f**2 for f in fits]) == pytest.approx(1.0, abs=chance(of_variance(39 * draws)))
    # what the error of the weight leaves in the moments is not in their noise
    fits = noisy_fits(R, draws, noise_f=0.0)
    assert np.mean([f.residual_m**2 for f in fits]) == pytest.approx(0.01, abs=chance(0.01 * of_variance(39 * draws)))


@pytest.mark.paper
def test_weight_from_15_configurations() -> None:
    """Paper 003, sec. 5.3, 15 configurations; FACTS10 10.1: 1 N noise, 60 kg, +-0.28 N for random orientations, +-1 N within 30 deg.

    That is the component of the weight vector; a third beside it, since 15 random orientations are one draw.
    """
    anywhere = np.mean([identify_at(poses(15, seed)) for seed in range(40)])
    assert abs(anywhere - 0.28) < physics(0.28, relative=0.33)
    down = Rotation.from_euler("x", np.pi)
    near = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        axis = rng.normal(size=(15, 3))
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis, axis=1, keepdims=True) * rng.uniform(0, np.pi / 6, (15, 1)))
        near.append(identify_at((turn * down).as_matrix()))
    assert abs(np.mean(near) - 1.0) < physics(1.0, relative=0.5)


def identify_at(R: np.ndarray) -> float:
    """Standard deviation of a component of the weight vector, 1 N noise, from the design alone (mean of the three)."""
    design = np.concatenate([R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape)], axis=2).reshape(-1, 6)
    return float(np.sqrt(np.mean(np.diag(np.linalg.inv(design.T @ design))[:3])))


def test_tilt_of_the_base_is_found_with_its_sign() -> None:
    """A base turned by +1 deg about x and -0.5 deg about y: the weight in B turns the other way, to first order (angles squared)."""
    base = Rotation.from_euler("xy", [1.0, -0.5], degrees=True).inv()
    load = Load(base.apply([0, 0, -WEIGHT]), TRUE.cog_S, TRUE.offset_f, TRUE.offset_m)
    fit = identify_payload(poses(15), *load.wrench(poses(15)))
    assert np.abs(np.rad2deg(fit.tilt) - [1.0, -0.5]).max() < physics(1.0, relative=1e-3)
    assert fit.residual_f < 1e2 * ROUNDOFF * WEIGHT


# -------------------------------------------------------------------------------------------- errors


def test_poses_that_leave_something_open_are_refused() -> None:
    about_z = Rotation.from_euler("z", [[0.0], [0.5], [1.0], [2.0]]).as_matrix()
    with pytest.raises(ValueError, match="gravity must point along all three axes of the sensor"):
        identify_poses(about_z, *TRUE.wrench(about_z))


def test_errors_name_what_is_wrong() -> None:
    force, moment = TRUE.wrench(poses(4))
    with pytest.raises(ValueError, match="4 poses given, exactly 3 expected; use identify_poses"):
        identify_three_poses(force, moment)
    with pytest.raises(ValueError, match="must be O1, O2, O3"):
        identify_three_poses(np.zeros((3, 3)), np.zeros((3, 3)))
    with pytest.raises(ValueError, match="2 poses given, at least 3 needed"):
        identify_poses(poses(2), force[:2], moment[:2])
    with pytest.raises(ValueError, match=r"must both have the shape \(poses, 3\)"):
        identify_poses(poses(4), force, moment[:3])
    with pytest.raises(ValueError, match=r"R_BS has shape \(3, 3, 3\)"):
        identify_poses(poses(3), force, moment)
    with pytest.raises(ValueError, match="not finite"):
        identify_poses(poses(4), force * math.nan, moment)
    with pytest.raises(ValueError, match="without weight the centre of gravity is unknown"):
        identify_poses(poses(4), np.zeros((4, 3)), np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"rank 10, needed is 14; add orientations .* or set ridge"):
        fit_orientation_polynomial(quaternions(10), np.zeros((10, 3)))
    with pytest.raises(ValueError, match="9 orientations of rank 9, needed is 10"):
        fit_orientation_polynomial(quaternions(9), np.zeros((9, 3)), linear=False)
    with pytest.raises(ValueError, match="ridge is -1"):
        fit_orientation_polynomial(quaternions(30), np.zeros((30, 3)), ridge=-1)
    with pytest.raises(ValueError, match=r"expected \(30, 3\)"):
        fit_orientation_polynomial(quaternions(30), np.zeros((29, 3)))
    with pytest.raises(ValueError, match="expected unit quaternions"):
        orientation_features(np.ones((2, 4)))
