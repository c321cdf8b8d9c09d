"""models.maths.rotation: one rotation, with the numbers of SciPy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation as Theirs

from robomill.models.maths.rotation import Rotation

RNG = np.random.default_rng(5)
SETS = [RNG.choice([0.0, 0.5 * np.pi, -0.5 * np.pi, np.pi, 0.3], 3) for _ in range(100)] + [RNG.uniform(-4.0, 4.0, 3) for _ in range(200)]


def same(ours: object, theirs: object) -> None:
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=4 * np.finfo(float).eps)


def test_angles_matrices_and_vectors_are_those_of_scipy() -> None:
    for abc in SETS:
        ours, theirs = Rotation.from_abc(abc), Theirs.from_euler("ZYX", abc)
        same(ours.as_quat(), theirs.as_quat())
        same(ours.as_quat(canonical=True), theirs.as_quat(canonical=True))
        same(ours.as_matrix(), theirs.as_matrix())
        same(ours.as_rotvec(), theirs.as_rotvec())
        same(ours.magnitude(), theirs.magnitude())
        matrix = theirs.as_matrix()
        same(Rotation.from_matrix(matrix).as_quat(), Theirs.from_matrix(matrix).as_quat())


def test_a_matrix_that_is_not_quite_orthogonal_is_made_so() -> None:
    matrix = Theirs.from_euler("ZYX", SETS[-1]).as_matrix() + 1e-7
    same(Rotation.from_matrix(matrix).as_quat(), Theirs.from_matrix(matrix).as_quat())


def test_turning_on_and_back_is_that_of_scipy() -> None:
    for first, second in itertools.pairwise(SETS):
        for size in (1.0, 1e-4):
            ours = Rotation.from_abc(first), Rotation.from_rotvec(size * second)
            theirs = Theirs.from_euler("ZYX", first), Theirs.from_rotvec(size * second)
            same(ours[1].as_quat(), theirs[1].as_quat())
            same((ours[0] * ours[1]).as_quat(), (theirs[0] * theirs[1]).as_quat())
            same((ours[1].inv() * ours[0]).as_rotvec(), (theirs[1].inv() * theirs[0]).as_rotvec())


def test_a_quaternion_of_any_length_is_taken_but_none_of_length_0() -> None:
    same(Rotation.from_quat([0.0, 0.0, 3.0, 4.0]).as_quat(), [0.0, 0.0, 0.6, 0.8])
    with pytest.raises(ValueError, match=r"quaternion \(0, 0, 0, 0\) is no orientation"):
        Rotation.from_quat([0.0, 0.0, 0.0, 0.0])
