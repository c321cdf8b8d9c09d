"""Identify what the force sensor shows without a process: weight, offset, centre of gravity, hose pack.

Haehn & Weigold 2020, sec. 2.6. Three-pose identification (Eqs. 12-15, with the misprint of Eq. (13)
corrected), the general least squares over any set of poses, and the quadratic polynomial in the
quaternion for what remains (Eq. 17). Everything in SI; S is the sensor frame, B the base (z up),
R_BS turns S components into B components.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from robomill.models.calibration.features import FEATURES
from robomill.models.maths.frames import quat_from_abc
from robomill.models.model.declaration import FloatArray

_SQRT2 = math.sqrt(2.0)

THREE_POSES = np.array([[_SQRT2 / 2, _SQRT2 / 2, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rows: the upward unit vector in S at the orientations O1, O2, O3 of Fig. 7, inferred from Eqs. (12)-(15).

Gravity there is (1, 1, 0) F_G,z / sqrt(2), (0, 0, -F_G,z) and (0, F_G,z, 0) with F_G,z = -m g."""


NEAR = math.radians(1.0)
"""Angle [rad] within which a row is at one of `THREE_POSES`: 10 N of a weight of 600 N are across it then."""


@dataclass(frozen=True)
class Load:
    """What the end effector does to the sensor: f = R_BS^T weight_B + offset_f, m = cog_S x (R_BS^T weight_B) + offset_m."""

    weight_B: FloatArray
    """Weight vector [3] in B, N; (0, 0, -m g) for a levelled base."""
    cog_S: FloatArray
    """Centre of gravity [3] from the sensor origin, in S, m."""
    offset_f: FloatArray
    """Sensor-internal force offset F_SI [3], N."""
    offset_m: FloatArray
    """Sensor-internal moment offset M_SI [3], N m."""

    @property
    def weight(self) -> float:
        """Magnitude of the weight, N."""
        return float(np.linalg.norm(self.weight_B))

    def wrench(self, R_BS: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Force [N, 3] and moment [N, 3] that the sensor shows at the orientations `R_BS` [N, 3, 3] without a process."""
        force = np.einsum("nji,j->ni", R_BS, self.weight_B)
        return force + self.offset_f, np.cross(self.cog_S, force) + self.offset_m


@dataclass(frozen=True)
class PayloadFit:
    """A load with what is known of it; standard deviations are one sigma, from the residuals."""

    load: Load
    covariance_f: FloatArray
    """[6, 6] of weight_B and offset_f, N2."""
    covariance_m: FloatArray
    """[6, 6] of cog_S (m) and offset_m (N.m): from the moments, and from the weight that the levers are found with."""
    residual_f: float
    """What is left of a force component, N rms, degrees of freedom counted."""
    residual_m: float
    """What is left of a moment component, N.m rms, likewise."""
    condition_f: float
    """Condition number of the forces' design with columns scaled to one."""
    condition_m: float
    """That of the moments' design."""

    @property
    def deviation_weight_B(self) -> FloatArray:
        """[3] N."""
        return np.asarray(np.sqrt(np.diag(self.covariance_f)[:3]))

    @property
    def deviation_offset_f(self) -> FloatArray:
        """[3] N."""
        return np.asarray(np.sqrt(np.diag(self.covariance_f)[3:]))

    @property
    def deviation_cog_S(self) -> FloatArray:
        """[3] m."""
        return np.asarray(np.sqrt(np.diag(self.covariance_m)[:3]))

    @property
    def deviation_offset_m(self) -> FloatArray:
        """[3] N.m."""
        return np.asarray(np.sqrt(np.diag(self.covariance_m)[3:]))

    @property
    def deviation_weight(self) -> float:
        """Magnitude of the weight, N: along the weight found."""
        along = self.load.weight_B / self.load.weight
        return float(np.sqrt(along @ self.covariance_f[:3, :3] @ along))

    @property
    def tilt(self) -> FloatArray:
        """[2] turns of the base about its x and y against a levelled one, rad, to first order: the weight is w (b, -a, -1) in B."""
        x, y, _ = self.load.weight_B / self.load.weight
        return np.array([-y, x])

    @property
    def deviation_tilt(self) -> FloatArray:
        """[2] rad."""
        x, y, _ = self.deviation_weight_B / self.load.weight
        return np.array([y, x])


def identify_three_poses(force: FloatArray, moment: FloatArray) -> Load:
    """Weight, centre of gravity and offsets from the orientations O1, O2, O3 (Eqs. 12-15, corrected).

    Eq. (13) as printed has the factor sqrt(2) where 1/sqrt(2) belongs: 416 N per axis wrong at 60 kg.
    In Eqs. (14) and (15) the vector r_G points from the centre of gravity to the sensor, hence `cog_S` = -r_G.

    Parameters: `force` [3, 3] N and `moment` [3, 3] N m, row i measured in S at O(i+1) (`THREE_POSES`).
    Errors: ValueError for another shape, values that are not finite, or a weight below 1 N.
    """
    force, moment = _wrenches(force, moment, 3)
    if len(force) != 3:
        raise ValueError(f"identify_three_poses: {len(force)} poses given, exactly 3 expected; use identify_poses for more")
    (f1, f2, _), (m1, m2, m3) = force, moment
    weight = f1[2] - f2[2]  # Eq. (12): F_G,z, negative
    if abs(weight) < 1.0:
        raise ValueError(
            f"identify_three_poses: F_O1,z - F_O2,z = {weight:.3g} N is no weight; the poses must be O1, O2, O3 of Fig. 7 in this order"
        )
    offset_f = np.array([f1[0] - weight / _SQRT2, f1[1] - weight / _SQRT2, f1[2]])  # Eq. (13), corrected
    r_z = _SQRT2 * (m3[0] - m1[0]) / ((_SQRT2 - 1.0) * weight)  # Eq. (15), third row
    offset_m = np.array([m3[0] - r_z * weight, m1[1] + r_z * weight / _SQRT2, m2[2]])  # Eq. (14)
    r_x = (offset_m[2] - m3[2]) / weight  # Eq. (15), first and second row
    r_y = r_x + _SQRT2 * (m1[2] - offset_m[2]) / weight
    return Load(np.array([0.0, 0.0, weight]), -np.array([r_x, r_y, r_z]), offset_f, offset_m)


def three_poses(R_BS: FloatArray, force: FloatArray, moment: FloatArray) -> PayloadFit:
    """`identify_three_poses` on the means of the rows in which the sensor stands at O1, O2, O3 within `NEAR`; other rows are not used.

    Standard deviations are those of `identify_payload` on the three means. Errors: ValueError names an orientation that no row has.
    """
    up = np.asarray(R_BS, dtype=np.float64)[:, 2, :]
    rows = [np.flatnonzero(up @ target > math.cos(NEAR)) for target in THREE_POSES]
    for number, (found, target) in enumerate(zip(rows, THREE_POSES, strict=True), start=1):
        if not len(found):
            nearest = math.degrees(math.acos(min(1.0, float((up @ target).max()))))
            raise ValueError(
                f"three_poses: no row is within {math.degrees(NEAR):g} deg of O{number}, up = {np.round(target, 3).tolist()} in the "
                f"sensor; the nearest is {nearest:.1f} deg away: measure there, or use least squares over all orientations"
            )
    first = [r[0] for r in rows]
    means = [np.array([np.mean(v[r], axis=0) for r in rows]) for v in (force, moment)]
    fit = identify_payload(np.asarray(R_BS)[first], *means)
    load = identify_three_poses(*means)
    left = np.concatenate([m - w for m, w in zip(means, load.wrench(np.asarray(R_BS)[first]), strict=True)], axis=1)
    rms = [float(np.sqrt(np.mean(left[:, part] ** 2))) for part in (slice(0, 3), slice(3, 6))]
    return replace(fit, load=load, residual_f=rms[0], residual_m=rms[1])


def identify_poses(R_BS: FloatArray, force: FloatArray, moment: FloatArray) -> Load:
    """Weight vector, centre of gravity and offsets by least squares over N >= 3 poses: `identify_payload` without the uncertainties."""
    return identify_payload(R_BS, force, moment).load


def identify_payload(R_BS: FloatArray, force: FloatArray, moment: FloatArray) -> PayloadFit:
    """Weight vector, centre of gravity and offsets by least squares over N poses; a tilted base is included.

    f_i = R_i^T w + F_SI is linear in (w, F_SI); then m_i = r x (R_i^T w) + M_SI is linear in (r, M_SI).
    Zhang et al. 2005 (paper 003, sec. 5.3) use 15 poses, Haehn & Weigold 27.

    Parameters: `R_BS` [N, 3, 3], `force` [N, 3] N, `moment` [N, 3] N m, N >= 3.
    Errors: ValueError for shapes, values that are not finite, poses that do not determine the parameters.
    """
    force, moment = _wrenches(force, moment, 3)
    R_BS = np.asarray(R_BS, dtype=np.float64)
    if R_BS.shape != (len(force), 3, 3):
        raise ValueError(f"identify_poses: R_BS has shape {R_BS.shape}, expected {(len(force), 3, 3)} like the forces")
    R_SB = R_BS.transpose(0, 2, 1)
    unit = np.broadcast_to(np.eye(3), R_SB.shape)
    forces = _solve("orientations", np.concatenate([R_SB, unit], axis=2), force)
    weight_B, offset_f = forces.solution[:3], forces.solution[3:]
    if float(np.linalg.norm(weight_B)) < 1.0:
        raise ValueError(f"identify_poses: the weight is {np.linalg.norm(weight_B):.3g} N; without weight the centre of gravity is unknown")
    moments = _solve("gravity directions", np.concatenate([-_skew(R_SB @ weight_B), unit], axis=2), moment)
    lever, offset_m = moments.solution[:3], moments.solution[3:]
    # an error of the weight is one of the levers: dm_i = r x (R_i^T dw) goes through the second least squares
    by_weight = moments.inverse @ (_skew(np.broadcast_to(lever, (len(force), 3))) @ R_SB).reshape(-1, 3)
    covariance_m = moments.covariance + by_weight @ forces.covariance[:3, :3] @ by_weight.T
    load = Load(weight_B, lever, offset_f, offset_m)
    return PayloadFit(load, forces.covariance, covariance_m, forces.residual, moments.residual, forces.condition, moments.condition)


def quaternion_from_abc(a: float, b: float, c: float) -> FloatArray:
    """Eq. (16), with its lost signs restored: quaternion [4], scalar first and >= 0, of R = Rz(a) Ry(b) Rx(c).

    The paper calls the angles gamma = a (about z), beta = b (about y'), alpha = c (about x''); rad.
    """
    quat = np.zeros(4)
    quat_from_abc(a, b, c, quat)
    return quat


def orientation_features(quat: FloatArray) -> FloatArray:
    """The 15 terms of Eq. (17), [N, 15], for quaternions [N, 4] (scalar first).

    q and -q are the same orientation but give other linear terms: the sign is set so that the scalar part is >= 0.
    """
    quat = np.atleast_2d(np.asarray(quat, dtype=np.float64))
    if quat.ndim != 2 or quat.shape[1] != 4 or not np.allclose(np.linalg.norm(quat, axis=1), 1.0, atol=1e-6):
        raise ValueError(f"orientation_features: expected unit quaternions [N, 4], found shape {quat.shape}")
    quat = np.where(quat[:, :1] < 0.0, -quat, quat)
    q1, q2, q3, q4 = quat.T
    columns = [np.ones(len(quat)), q1, q2, q3, q4, q1 * q1, q2 * q2, q3 * q3, q4 * q4, q1 * q2, q1 * q3, q1 * q4, q2 * q3, q2 * q4, q3 * q4]
    return np.stack(columns, axis=1)


def fit_orientation_polynomial(quat: FloatArray, force: FloatArray, ridge: float = 0.0, linear: bool = True) -> FloatArray:
    """Coefficients [15, 3] of Eq. (17) for the remaining force of the hose pack, N.

    The basis has rank 14, because the squares of a unit quaternion add up to 1: the smallest of all solutions is
    taken (pseudo-inverse), or with `ridge` > 0 the coefficients are damped by it (useful with few or clustered poses).
    Rigid gravity is itself a quadratic form in q, so subtract `Load.wrench` first.
    Without the `linear` terms (a2..a5 = 0, rank 10) the polynomial is continuous over all orientations; with them it
    jumps where the scalar part of the quaternion changes sign.

    Parameters: `quat` [N, 4] orientation of S in B, `force` [N, 3] N in S. 27 poses are enough, the rank is the least.
    Errors: ValueError for fewer poses than that without `ridge`, and for shapes.
    """
    features = orientation_features(quat)
    force = np.asarray(force, dtype=np.float64)
    if force.shape != (len(features), 3):
        raise ValueError(f"fit_orientation_polynomial: force has shape {force.shape}, expected {(len(features), 3)}")
    if ridge < 0.0:
        raise ValueError(f"fit_orientation_polynomial: ridge is {ridge}, expected 0 or more")
    if not linear:
        features[:, 1:5] = 0.0
    if ridge == 0.0:
        rank, needed = int(np.linalg.matrix_rank(features)), FEATURES - 1 if linear else FEATURES - 5
        if rank < needed:
            raise ValueError(
                f"fit_orientation_polynomial: {len(features)} orientations of rank {rank}, needed is {needed}; "
                "add orientations that differ in all three angles, or set ridge > 0"
            )
        coefficients = np.asarray(np.linalg.pinv(features) @ force)
    else:
        coefficients = np.asarray(np.linalg.solve(features.T @ features + ridge * np.eye(FEATURES), features.T @ force))
    if not linear:
        coefficients[1:5] = 0.0
    return coefficients


def _wrenches(force: FloatArray, moment: FloatArray, least: int) -> tuple[FloatArray, FloatArray]:
    force, moment = np.asarray(force, dtype=np.float64), np.asarray(moment, dtype=np.float64)
    if force.ndim != 2 or force.shape[1] != 3 or force.shape != moment.shape:
        raise ValueError(f"identification: force {force.shape} and moment {moment.shape} must both have the shape (poses, 3)")
    if len(force) < least:
        raise ValueError(f"identification: {len(force)} poses given, at least {least} needed")
    if not (np.all(np.isfinite(force)) and np.all(np.isfinite(moment))):
        raise ValueError("identification: the measured wrenches hold values that are not finite")
    return force, moment


@dataclass(frozen=True)
class _Solved:
    """Least squares of [N, 3, 6] x [6] = [N, 3]."""

    solution: FloatArray
    covariance: FloatArray
    inverse: FloatArray
    """[6, 3 N] pseudo-inverse of the design."""
    residual: float
    condition: float


def _solve(what: str, design: FloatArray, right: FloatArray) -> _Solved:
    """Least squares; ValueError if the poses leave a direction open. With three poses nothing is left to judge the noise by but rank."""
    matrix = design.reshape(-1, 6)
    solution, _, rank, singular = np.linalg.lstsq(matrix, right.ravel(), rcond=1e-9)
    if rank < 6:
        raise ValueError(
            f"identify_poses: the {what} of the {len(design)} poses leave {6 - rank} of 6 parameters undetermined "
            f"(singular values {np.array2string(singular, precision=2)}); gravity must point along all three axes of the sensor"
        )
    values: FloatArray = np.asarray(solution, dtype=np.float64)
    inverse: FloatArray = np.asarray(np.linalg.pinv(matrix), dtype=np.float64)
    variance = float(np.sum((right.ravel() - matrix @ values) ** 2)) / (len(matrix) - 6)
    scaled = matrix / np.linalg.norm(matrix, axis=0)
    return _Solved(values, variance * (inverse @ inverse.T), inverse, math.sqrt(variance), float(np.linalg.cond(scaled)))


def _skew(v: FloatArray) -> FloatArray:
    """Cross-product matrices [N, 3, 3] of vectors [N, 3]."""
    matrix = np.zeros((len(v), 3, 3))
    matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return matrix - matrix.transpose(0, 2, 1)
