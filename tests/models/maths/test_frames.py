"""Rotations, quaternions and the small linear solver, against numpy and scipy at 100 seeded states."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from scipy.spatial.transform import Rotation

from robomill.models.maths import frames
from robomill.models.model.kernels import COMPILER_OPTIONS
from tests.tolerances import EXACT, ROUNDOFF, physics

SEEDS = range(100)


def rotation(rng: np.random.Generator) -> np.ndarray:
    return Rotation.random(random_state=rng.integers(2**31)).as_matrix()


def scalar_first(rotation: Rotation) -> np.ndarray:
    """Scipy's quaternion in our order, w >= 0."""
    quat = np.roll(rotation.as_quat(), 1)
    return quat if quat[0] >= 0.0 else -quat


@pytest.mark.parametrize("seed", SEEDS)
def test_products_are_those_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(2, 3, 3))
    a, b = rng.normal(size=(2, 3))
    C, c = np.zeros((3, 3)), np.zeros(3)
    frames.mat_mul(A, B, C)
    assert np.abs(C - A @ B).max() < 10 * ROUNDOFF
    frames.mat_vec(A, a, c)
    assert np.abs(c - A @ a).max() < 10 * ROUNDOFF
    frames.mat_t_vec(A, a, c)
    assert np.abs(c - A.T @ a).max() < 10 * ROUNDOFF
    frames.cross(a, b, c)
    assert np.abs(c - np.cross(a, b)).max() < 10 * ROUNDOFF
    assert abs(frames.dot(a, b) - a @ b) < 10 * ROUNDOFF
    assert abs(frames.norm(a) - np.linalg.norm(a)) < 10 * ROUNDOFF
    unit = a / np.linalg.norm(a)
    frames.normalise(a)
    assert np.abs(a - unit).max() < 10 * ROUNDOFF
    nothing = np.zeros(3)
    frames.normalise(nothing)
    assert not nothing.any()


def test_vector_products_may_overwrite_their_input() -> None:
    A, a, b = np.arange(9.0).reshape(3, 3), np.array([1.0, 2.0, 3.0]), np.array([3.0, -1.0, 2.0])
    y = a.copy()
    frames.mat_vec(A, y, y)
    assert np.abs(y - A @ a).max() == EXACT
    y = a.copy()
    frames.mat_t_vec(A, y, y)
    assert np.abs(y - A.T @ a).max() == EXACT
    y = a.copy()
    frames.cross(y, b, y)
    assert np.abs(y - np.cross(a, b)).max() == EXACT


def test_quaternion_of_the_published_angles() -> None:
    """Eq. (16) of Haehn & Weigold 2020 with its lost signs: A = 30, B = 20, C = 10 deg.

    Expected: the half-angle products of NASA TM-74839 (its reference 10), here worked out by scipy to 9 digits.
    """
    quat = np.zeros(4)
    frames.quat_from_abc(*np.deg2rad([30.0, 20.0, 10.0]), quat)
    assert np.abs(quat - [0.951548525, 0.038134577, 0.189307857, 0.239298338]).max() < physics(0.0, absolute=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_euler_angles_are_kukas(seed: int) -> None:
    """A about z, B about y', C about x'': intrinsic ZYX of scipy; back again inside |B| < 90 deg."""
    a, b, c = np.random.default_rng(seed).uniform([-np.pi, -1.5, -np.pi], [np.pi, 1.5, np.pi])
    reference = Rotation.from_euler("ZYX", [a, b, c])
    R, quat, abc = np.zeros((3, 3)), np.zeros(4), np.zeros(3)
    frames.rotation_abc(a, b, c, R)
    assert np.abs(R - reference.as_matrix()).max() < ROUNDOFF
    frames.quat_from_abc(a, b, c, quat)
    assert np.abs(quat - scalar_first(reference)).max() < ROUNDOFF
    frames.matrix_to_abc(R, abc)
    assert np.abs(abc - [a, b, c]).max() < 1e3 * ROUNDOFF  # 1/cos(B) <= 14 magnifies roundoff


@pytest.mark.parametrize("b", [np.pi / 2, -np.pi / 2])
def test_euler_angles_at_the_pole_still_give_the_rotation(b: float) -> None:
    R, again, abc = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    frames.rotation_abc(0.4, b, -0.7, R)
    frames.matrix_to_abc(R, abc)
    assert abc[0] == 0.0
    frames.rotation_abc(*abc, again)
    assert np.abs(again - R).max() < ROUNDOFF


@pytest.mark.parametrize("seed", SEEDS)
def test_quaternion_and_matrix_are_inverse_to_each_other(seed: int) -> None:
    R = rotation(np.random.default_rng(seed))
    quat, again = np.zeros(4), np.zeros((3, 3))
    frames.matrix_to_quat(R, quat)
    assert np.abs(quat - scalar_first(Rotation.from_matrix(R))).max() < ROUNDOFF
    assert quat[0] >= 0.0
    frames.quat_to_matrix(quat, again)
    assert np.abs(again - R).max() < ROUNDOFF


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("angle", [np.pi, np.pi - 1e-9, 0.999 * np.pi])
def test_quaternion_of_half_a_turn(axis: int, angle: float) -> None:
    """Where w vanishes, the largest of the other components must be the divisor."""
    vector = np.zeros(3)
    vector[axis] = angle
    quat, again = np.zeros(4), np.zeros((3, 3))
    R = Rotation.from_rotvec(vector).as_matrix()
    frames.matrix_to_quat(R, quat)
    frames.quat_to_matrix(quat, again)
    assert np.abs(again - R).max() < ROUNDOFF
    assert abs(abs(quat[axis + 1]) - np.sin(angle / 2)) < ROUNDOFF


@pytest.mark.parametrize("seed", SEEDS)
def test_quaternion_product_is_that_of_the_rotations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, B = rotation(rng), rotation(rng)
    a, b = np.zeros(4), np.zeros(4)
    frames.matrix_to_quat(A, a)
    frames.matrix_to_quat(B, b)
    R, expected = np.zeros((3, 3)), np.zeros(4)
    frames.quat_multiply(a, b, expected)
    frames.quat_to_matrix(expected, R)
    assert np.abs(R - A @ B).max() < ROUNDOFF
    frames.quat_multiply(a, b, a)
    assert np.abs(a - expected).max() == EXACT, "the result may overwrite a factor"


@pytest.mark.parametrize("seed", SEEDS)
def test_rotation_vector_is_axis_times_angle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    theta = axis / np.linalg.norm(axis) * 10.0 ** rng.uniform(-12.0, 0.45)
    quat, again, applied, scratch = np.zeros(4), np.zeros(3), np.zeros((3, 3)), np.zeros(4)
    frames.rotation_vector_to_quat(theta, quat)
    assert np.abs(quat - scalar_first(Rotation.from_rotvec(theta))).max() < ROUNDOFF
    frames.quat_to_rotation_vector(quat, again)
    assert np.abs(again - theta).max() < 10 * ROUNDOFF * np.linalg.norm(theta)
    frames.quat_to_rotation_vector(-quat, again)
    assert np.abs(again - theta).max() < 10 * ROUNDOFF * np.linalg.norm(theta), "-q is the same rotation"
    R = rotation(rng)
    frames.rotation_vector_apply(theta, R, scratch, applied)
    assert np.abs(applied - Rotation.from_rotvec(theta).as_matrix() @ R).max() < ROUNDOFF


def test_no_rotation_is_exactly_none() -> None:
    quat, theta, R, scratch = np.zeros(4), np.ones(3), np.eye(3), np.zeros(4)
    frames.rotation_vector_to_quat(np.zeros(3), quat)
    assert quat.tolist() == [1.0, 0.0, 0.0, 0.0]
    frames.quat_to_rotation_vector(quat, theta)
    assert theta.tolist() == [0.0, 0.0, 0.0]
    frames.rotation_vector_apply(theta, R, scratch, R)
    assert np.abs(R - np.eye(3)).max() == EXACT


def test_a_rotation_vector_beyond_half_a_turn_keeps_the_scalar_part_positive() -> None:
    quat, R = np.zeros(4), np.zeros((3, 3))
    theta = np.array([0.0, 4.0, 0.0])
    frames.rotation_vector_to_quat(theta, quat)
    assert quat[0] > 0.0
    frames.quat_to_matrix(quat, R)
    assert np.abs(R - Rotation.from_rotvec(theta).as_matrix()).max() < ROUNDOFF


@pytest.mark.parametrize("angle", [0.0, 1e-3, 1.0, 3.0])
def test_angle_between_rotations(angle: float) -> None:
    """Near zero the arc cosine resolves sqrt(2 eps) = 3e-8 rad only."""
    a, b = np.zeros(4), np.zeros(4)
    frames.rotation_vector_to_quat(np.array([0.3, -0.2, 0.9]), a)
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    frames.rotation_vector_to_quat(angle * axis, b)
    frames.quat_multiply(b, a, b)
    assert abs(frames.angle_between(a, b) - angle) < physics(0.0, absolute=1e-7)
    assert abs(frames.angle_between(a, -b) - angle) < physics(0.0, absolute=1e-7)


@pytest.mark.parametrize("n", range(1, 7))
@pytest.mark.parametrize("seed", range(20))
def test_linear_systems_are_solved_as_by_lapack(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, b, x = np.zeros((6, 6)), np.zeros(6), np.full(6, np.nan)
    A[:n, :n], b[:n] = rng.normal(size=(n, n)), rng.normal(size=n)
    expected = np.linalg.solve(A[:n, :n], b[:n])
    condition = np.linalg.cond(A[:n, :n])
    assert frames.solve(A.copy(), b.copy(), x, n) == 0
    assert np.abs(x[:n] - expected).max() < ROUNDOFF * condition * np.abs(expected).max()
    assert np.all(np.isnan(x[n:])), "only the leading part is touched"


def test_a_zero_on_the_diagonal_needs_the_pivot() -> None:
    A, b, x = np.array([[0.0, 2.0], [4.0, 1.0]]), np.array([6.0, 11.0]), np.zeros(2)
    assert frames.solve(A, b, x, 2) == 0
    assert x.tolist() == [2.0, 3.0]


@pytest.mark.parametrize("A", [np.zeros((2, 2)), np.array([[1.0, 2.0], [2.0, 4.0]]), np.array([[1.0, 1.0], [1.0, 1.0 + 1e-16]])])
def test_a_singular_system_is_reported_and_leaves_x_alone(A: np.ndarray) -> None:
    x = np.array([7.0, 8.0])
    assert frames.solve(A.copy(), np.ones(2), x, 2) == 1
    assert x.tolist() == [7.0, 8.0]


def test_compiled_gives_the_same_bits_as_plain_python() -> None:
    mat_mul, mat_vec, mat_t_vec, cross = frames.mat_mul, frames.mat_vec, frames.mat_t_vec, frames.cross
    quat_to_matrix, matrix_to_quat, quat_multiply = frames.quat_to_matrix, frames.matrix_to_quat, frames.quat_multiply
    quat_from_abc, rotation_abc, matrix_to_abc = frames.quat_from_abc, frames.rotation_abc, frames.matrix_to_abc
    to_quat, to_vector, apply = frames.rotation_vector_to_quat, frames.quat_to_rotation_vector, frames.rotation_vector_apply
    angle_between, solve = frames.angle_between, frames.solve

    def everything(v: np.ndarray, R: np.ndarray, S: np.ndarray, q: np.ndarray, p: np.ndarray, u: np.ndarray, A: np.ndarray) -> float:
        rotation_abc(v[0], v[1], v[2], R)
        matrix_to_quat(R, q)
        quat_from_abc(v[2], v[0], v[1], p)
        quat_multiply(q, p, p)
        quat_to_matrix(p, S)
        mat_mul(R, S, A)
        matrix_to_abc(A, u)
        mat_vec(S, u, u)
        mat_t_vec(R, u, u)
        cross(u, v, u)
        to_quat(u, q)
        to_vector(p, u)
        apply(u, R, q, S)
        angle: float = angle_between(p, q)
        return angle + solve(S, u, v, 3)

    compiled = njit(**COMPILER_OPTIONS)(everything)
    for seed in SEEDS:
        v = np.random.default_rng(seed).uniform(-3.0, 3.0, 3)
        plain_arrays, compiled_arrays = (
            [v.copy(), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(4), np.zeros(4), np.zeros(3), np.zeros((3, 3))] for _ in range(2)
        )
        assert everything(*plain_arrays) == compiled(*compiled_arrays), seed
        for a, b in zip(plain_arrays, compiled_arrays, strict=True):
            assert np.abs(a - b).max() == EXACT, seed
