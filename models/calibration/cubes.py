"""Springs of joints, linked arm and arm from cubes on the robot: Haehn & Weigold 2020 (paper 000), section 2.5, Figs. 5, 6, Table 1.

Cubes stand on the members of the robot, a load pulls at the last one, laser triangulation sensors on a frame beside the robot read spots
on the faces of the cubes. Six readings give the motion of a cube, reading = n . (u + theta x p) for a spot p with the face normal n.
The motion of a cube relative to the one before it is that of the virtual joint between them (Fig. 6). A spring is found in three ways:

- rotation: theta_b - theta_a = e c M about each axis e of the joint, M the moment of the load on it, c the compliance;
- lever: u_b - u_a - theta_a x (p_b - p_a) = e x (p_b - p_j) c M, the displacement of the next cube over its lever;
- chain: all readings of all cubes at once by least squares, every cube moved by all joints before it.

Everything in SI, in the base frame B; standard deviations are one sigma, from the noise of the readings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from robomill.models.calibration.stiffness import JOINT_NAMES, RIGID, Spring
from robomill.models.model.declaration import FloatArray, Model, Record, record
from robomill.models.robot.kinematics import SPINDLE_ACROSS, Robot, robot_variables
from robomill.models.robot.virtual_joints import (
    JOINTS,
    SENSOR,
    TABLE_1,
    Compliance,
    compliance_variables,
    joint_angles,
    joint_moments,
    virtual_joints,
)

MEMBERS = ("base", *JOINT_NAMES[:10])
"""What a cube may stand behind: nothing that yields, or the last virtual joint before it."""
RIGID_BODY = 6
"""Motions of a cube: three displacements, three turns."""
OPEN = 1e-10
"""Eigenvalue of the scaled normal equations, relative to the largest one, below which springs are told apart by roundoff only."""
SHARES = 1e-3
"""Share of a spring in such a direction from which on it belongs to it."""
LARGEST_CHANGE = 0.02
"""m: no load bends a robot by 20 mm; sensors of some um resolution do not reach so far."""
ROTATION, LEVER, CHAIN = range(3)
WAYS = ("rotation", "lever", "chain")


@dataclass(frozen=True)
class Spots:
    """Where the sensors point at a cube: `points` [n, 3] m from its centre, `directions` [n, 3] outward normals; axes of the cube."""

    points: FloatArray
    directions: FloatArray

    def __post_init__(self) -> None:
        """Refuse spots that cannot give the motion of a cube."""
        if self.points.shape != self.directions.shape or self.points.ndim != 2 or self.points.shape[1] != 3:
            raise ValueError(f"spots: points {self.points.shape} and directions {self.directions.shape}; expected both [n, 3]")
        if len(self.points) < RIGID_BODY or np.linalg.matrix_rank(self.design(np.eye(3)), 1e-6) < RIGID_BODY:
            raise ValueError(
                f"spots: {len(self.points)} spots do not give the six motions of a cube; expected six or more, such as three on one face, "
                "two on the next, one on the third"
            )

    def design(self, R_BC: FloatArray) -> FloatArray:
        """[n, 6] change of the readings per displacement and turn of a cube with the axes `R_BC` in B."""
        n, p = self.directions @ R_BC.T, self.points @ R_BC.T
        return np.hstack([n, np.cross(p, n)])


def three_two_one(edge: float = 0.1, apart: float = 0.08) -> Spots:
    """Three spots on the face z, two on the face y, one on the face x of a cube; `apart` [m] between spots of a face.

    Each turn is a difference of two readings over `apart`.
    """
    a, h = 0.5 * apart, 0.5 * edge
    points = np.array([[-a, -a, h], [a, -a, h], [-a, a, h], [-a, h, 0.0], [a, h, 0.0], [h, 0.0, 0.0]])
    return Spots(points, np.eye(3)[[2, 2, 2, 1, 1, 0]])


@dataclass(frozen=True)
class Triangulation:
    """Laser triangulation sensors. A change is the difference of two means, loaded and not."""

    noise: float = 5e-6
    """m, one reading, one sigma (FACTS10 10.7)."""
    averages: int = 250
    systematic: float = 0.5e-6
    """m, of a change, one sigma: linearity and the grain of the surface, which averaging leaves; other at each spot and load."""

    @property
    def deviation(self) -> float:
        """Standard deviation [m] of a change."""
        return math.sqrt(2.0 * self.noise**2 / self.averages + self.systematic**2)


@dataclass(frozen=True)
class Cube:
    """A cube on the robot, as the laser tracker finds it without a load."""

    name: str
    behind: int
    """Virtual joints between the base and the cube: those of rows 0 .. behind - 1."""
    position: FloatArray
    """[3] centre in B, m."""
    R_BC: FloatArray
    """[3, 3] its axes in B."""


@dataclass(frozen=True)
class Setup:
    """A robot at rest with its cubes, in the order of the chain. The loads act at the centre of the last cube."""

    robot: Robot
    q: FloatArray
    """[6] axis angles, rad."""
    cubes: tuple[Cube, ...]
    spots: Spots
    sensors: Triangulation

    def __post_init__(self) -> None:
        """Refuse what cannot be measured."""
        if np.any(self.robot.axis_coupling):
            raise ValueError(
                f"cubes: the axes of {self.robot.name} are coupled, so its drives turn joints beyond the next cube; expected a robot "
                "without coupled axes: use robomill identify stiffness"
            )
        order = [c.behind for c in self.cubes]
        if len(order) < 2 or order != sorted(order):
            raise ValueError(
                f"cubes: {', '.join(f'{c.name} behind {MEMBERS[c.behind]}' for c in self.cubes)}; expected two or more, from the base "
                "to the flange"
            )

    def frames(self, compliance: Compliance = TABLE_1) -> Record:
        """Record of `virtual_joints` at `q`, its tool tip where the loads act."""

        def unused(*_: object) -> int:
            return 0

        def made(p_FT_F: FloatArray) -> Record:
            tool = replace(SPINDLE_ACROSS, p_FT_F=p_FT_F, length=0.0)
            variables = (*robot_variables(self.robot, tool), *compliance_variables(compliance, tool))
            s = record(Model("cubes", self.robot.name, variables, unused, unused).new())
            virtual_joints(s, self.q)
            return s

        s = made(np.zeros(3))
        return made(s.link_R[5].T @ (self.cubes[-1].position - s.link_p[5]))


@dataclass(frozen=True)
class CubeLoads:
    """Loads on the last cube and what the sensors read."""

    force: FloatArray
    """[n, 3] N in B, at the centre of the last cube."""
    moment: FloatArray
    """[n, 3] N.m in B."""
    change: FloatArray
    """[n, cubes, spots] loaded minus unloaded, along the outward normal, m; NaN where there is no reading."""


@dataclass(frozen=True)
class CubeFit:
    """Springs found in each of `WAYS`."""

    springs: tuple[Spring, ...]
    compliance: FloatArray
    """[ways, springs] rad/(N.m); NaN where the way does not tell."""
    deviation: FloatArray
    """[ways, springs] standard deviations; infinite there."""
    turn: FloatArray
    """[springs] largest rotation of the spring, by the chain, rad."""
    scatter: float
    """Standard deviation of a change that the residuals of the chain speak for, m."""
    expected: float
    """That of the sensors, m."""
    worst: tuple[int, int, float]
    """Load, cube (from zero) with the largest residual, and that, m."""

    @property
    def relative_deviation(self) -> FloatArray:
        """[ways, springs] standard deviations over the values of the chain."""
        with np.errstate(divide="ignore", invalid="ignore"):
            found = self.deviation / np.abs(self.compliance[CHAIN])
        return np.asarray(np.where(np.isfinite(found), found, np.inf))


def simulate(setup: Setup, compliance: Compliance, force: FloatArray, moment: FloatArray, seed: int | None = None) -> CubeLoads:
    """Readings of the twin with these springs: finite turns of the virtual joints, beams that stay where they are.

    `force`, `moment` [n, 3]; `seed` of the noise, None for none.
    """
    s = setup.frames(compliance)
    change = np.zeros((len(force), len(setup.cubes), len(setup.spots.points)))
    for k, (f, m) in enumerate(zip(force, moment, strict=True)):
        joint_moments(s, f, m)
        joint_angles(s)
        for c, cube in enumerate(setup.cubes):
            change[k, c] = _beams(setup.spots, cube, *_moved(s, cube))
    if seed is not None:
        rng, sensors = np.random.default_rng(seed), setup.sensors
        for scale in (sensors.noise * math.sqrt(2.0 / sensors.averages), sensors.systematic):
            change += scale * rng.normal(size=change.shape)
    return CubeLoads(force, moment, change)


def _moved(s: Record, cube: Cube) -> tuple[FloatArray, FloatArray]:
    """Displacement [3] of the centre and rotation matrix [3, 3] of a cube: Eqs. (3), (4), joint by joint towards the base."""
    place, turned = cube.position.copy(), np.eye(3)
    for j in reversed(range(cube.behind)):
        F = s.frame_R[j]
        R = F @ Rotation.from_euler("ZYX", s.joint_angle[j, ::-1]).as_matrix() @ F.T
        place, turned = s.frame_p[j] + s.joint_shift[j] + R @ (place - s.frame_p[j]), R @ turned
    return place - cube.position, turned


def _beams(spots: Spots, cube: Cube, u: FloatArray, R: FloatArray) -> FloatArray:
    """Changes [n] along beams that do not move: where they meet the moved faces."""
    n, p = spots.directions @ cube.R_BC.T, spots.points @ cube.R_BC.T
    normal = n @ R.T
    return np.asarray(np.einsum("ni,ni->n", u + p @ R.T - p, normal) / np.einsum("ni,ni->n", n, normal))


def identify_cubes(setup: Setup, loads: CubeLoads, known: Compliance | None = None, given: Sequence[int] = ()) -> CubeFit:
    """Springs of the virtual joints between the cubes.

    `given`: rows of `known` that are taken from there, as of the sensor (paper 000: the value of axis 6 was measured with it). Errors:
    ValueError for a cube with too few readings, with more than one unknown joint between two cubes, without loads, and for changes
    that are none.
    """
    _check(setup, loads)
    rows = _between(setup, given)
    springs = tuple(Spring(f"{JOINT_NAMES[r]} {'xyz'[c]}", r, c) for r in rows for c in range(3))
    if not springs:
        raise ValueError("cubes: no joint with unknown springs between the cubes; take one out of those that are given")
    table = np.full((JOINTS, 3), RIGID)
    if known is not None:
        for row in given:
            table[row] = known.stiffness[row] * (known.sensor_stiffness_scale if row == SENSOR else 1.0)
    s = setup.frames()
    lever = s.frame_p[13] - s.frame_p[:10]
    moment = np.einsum("jrc,njr->njc", s.frame_R[:10], np.cross(lever[None], loads.force[:, None]) + loads.moment[:, None])
    from_given = sum(
        (_readings(setup, s, moment, row, axis) / table[row, axis] for row in given for axis in range(3)), np.zeros(loads.change.shape)
    )
    design = np.stack([_readings(setup, s, moment, p.row, p.column) for p in springs], axis=-1)
    found = _in_each_way(setup, s, moment, design, rows, loads.change - from_given)
    chain = found[0][CHAIN]
    if np.all(chain > 0.0):  # turns are small but finite: what they add to first order is that of the springs found
        for spring, c in zip(springs, chain, strict=True):
            table[spring.row, spring.column] = 1.0 / c
        bent = simulate(setup, replace(TABLE_1, stiffness=table, sensor_stiffness_scale=1.0), loads.force, loads.moment).change
        found = _in_each_way(setup, s, moment, design, rows, loads.change - bent + design @ chain)
        rest = loads.change - bent + design @ (chain - found[0][CHAIN])
    else:
        rest = loads.change - from_given - design @ np.nan_to_num(chain)
    compliance, deviation = found
    rest = np.nan_to_num(rest)
    scatter = float(np.sqrt(np.sum(rest**2) / max(int(np.isfinite(loads.change).sum()) - len(springs), 1)))
    deviation = deviation * max(scatter, setup.sensors.deviation)
    largest = np.abs(moment).max(axis=0)
    turn = np.array([largest[p.row, p.column] for p in springs]) * np.abs(compliance[CHAIN])
    at_load, at_cube, _ = np.unravel_index(int(np.argmax(np.abs(rest))), rest.shape)
    worst = (int(at_load), int(at_cube), float(np.abs(rest).max()))
    return CubeFit(springs, compliance, deviation, turn, scatter, setup.sensors.deviation, worst)


def _in_each_way(
    setup: Setup, s: Record, moment: FloatArray, design: FloatArray, rows: Mapping[int, tuple[int, int]], change: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compliances [ways, springs] and their deviations per deviation of a change, to first order."""
    read = np.isfinite(change)
    compliance, deviation = np.full((len(WAYS), design.shape[-1]), np.nan), np.full((len(WAYS), design.shape[-1]), np.inf)
    compliance[CHAIN], deviation[CHAIN] = _solved(design[read], change[read])
    motion, covariance = _motions(setup, change)
    for n, (row, (a, b)) in enumerate(rows.items()):
        at, pair, e, m = slice(3 * n, 3 * n + 3), (setup.cubes[a], setup.cubes[b]), s.frame_R[row], moment[:, row]
        for way, found in ((ROTATION, _by_rotation), (LEVER, _by_lever)):
            compliance[way, at], deviation[way, at] = found(pair, s.frame_p[row], e, m, motion[:, [a, b]], covariance[:, [a, b]])
    return compliance, deviation


def _check(setup: Setup, loads: CubeLoads) -> None:
    """ValueError for what cannot be measured values."""
    shape = (len(loads.force), len(setup.cubes), len(setup.spots.points))
    if loads.change.shape != shape or loads.force.shape != loads.moment.shape:
        raise ValueError(f"cubes: readings {loads.change.shape}; expected {shape}: loads, cubes, spots")
    if not np.any(loads.force) and not np.any(loads.moment):
        raise ValueError("cubes: all loads are zero; expected forces or moments on the last cube")
    for k, row in enumerate(loads.change):
        for cube, change in zip(setup.cubes, row, strict=True):
            seen = np.isfinite(change)
            rank = np.linalg.matrix_rank(setup.spots.design(cube.R_BC)[seen], 1e-6) if seen.any() else 0
            if rank < RIGID_BODY:
                raise ValueError(
                    f"cubes: load {k + 1}: cube {cube.name} has {int(seen.sum())} of {len(change)} readings, which tell {rank} of its six "
                    "motions: occluded? Clear the view or point another sensor at it and repeat the load, or leave the load out"
                )
            if np.any(np.abs(change[seen]) > LARGEST_CHANGE):
                raise ValueError(
                    f"cubes: load {k + 1}: cube {cube.name} moves by {1e3 * np.abs(change[seen]).max():.3g} mm; expected less than "
                    f"{1e3 * LARGEST_CHANGE:g} mm: check the unit, and that readings are differences, loaded minus unloaded"
                )


def _between(setup: Setup, given: Sequence[int]) -> dict[int, tuple[int, int]]:
    """Row of each unknown joint -> the cubes before and behind it. ValueError where two cubes have more than one between them."""
    found = {}
    for a, (first, second) in enumerate(zip(setup.cubes, setup.cubes[1:], strict=False)):
        rows = [r for r in range(first.behind, second.behind) if r not in given]
        if len(rows) > 1:
            raise ValueError(
                f"cubes: between {first.name} and {second.name} there are {', '.join(JOINT_NAMES[r] for r in rows)}; expected one joint: "
                "put another cube between them, or give the springs of the others"
            )
        if rows:
            found[rows[0]] = (a, a + 1)
    return found


def _readings(setup: Setup, s: Record, moment: FloatArray, row: int, axis: int) -> FloatArray:
    """Changes [n, cubes, spots] per compliance of one rad/(N.m) of a spring."""
    e = s.frame_R[row, :, axis]
    found = np.zeros((len(moment), len(setup.cubes), len(setup.spots.points)))
    for c, cube in enumerate(setup.cubes):
        if cube.behind > row:
            turn = setup.spots.design(cube.R_BC) @ np.concatenate([np.cross(e, cube.position - s.frame_p[row]), e])
            found[:, c] = np.outer(moment[:, row, axis], turn)
    return found


def _motions(setup: Setup, change: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Motions [n, cubes, 6] of the cubes and their covariances [n, cubes, 6, 6] per variance of a change."""
    n, cubes, _ = change.shape
    motion, covariance = np.zeros((n, cubes, RIGID_BODY)), np.zeros((n, cubes, RIGID_BODY, RIGID_BODY))
    for k in range(n):
        for c, cube in enumerate(setup.cubes):
            seen = np.isfinite(change[k, c])
            inverse = np.linalg.pinv(setup.spots.design(cube.R_BC)[seen])
            motion[k, c], covariance[k, c] = inverse @ change[k, c, seen], inverse @ inverse.T
    return motion, covariance


def _by_rotation(
    _pair: tuple[Cube, Cube], _p: FloatArray, e: FloatArray, m: FloatArray, motion: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compliances [3] of a joint with the axes `e` from the relative turns, and their deviations per deviation of a change."""
    turn = (motion[:, 1, 3:] - motion[:, 0, 3:]) @ e
    weight = m / np.einsum("ri,nrc,ci->ni", e, covariance[:, 0, 3:, 3:] + covariance[:, 1, 3:, 3:], e)
    size = np.sum(m * weight, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        loaded = size > OPEN * size.max()
        return np.where(loaded, np.sum(weight * turn, axis=0) / size, np.nan), np.where(loaded, 1.0 / np.sqrt(size), np.inf)


def _by_lever(
    pair: tuple[Cube, Cube], p: FloatArray, e: FloatArray, m: FloatArray, motion: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Likewise from the displacement of the next cube over its lever from the joint at `p`; the noise of the turn before it counts."""
    before = np.hstack([-np.eye(3), np.cross(pair[1].position - pair[0].position, np.eye(3)).T])
    moved = np.cross(e.T, pair[1].position - p).T
    rows, right = [], []
    for k in range(len(m)):
        W = covariance[k, 1, :3, :3] + before @ covariance[k, 0] @ before.T
        white = np.linalg.inv(np.linalg.cholesky(W))
        rows.append(white @ (moved * m[k]))
        right.append(white @ (motion[k, 1, :3] + before @ motion[k, 0]))
    return _solved(np.concatenate(rows), np.concatenate(right))


def _solved(design: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares: values, and deviations per deviation of a row; NaN and infinite where the rows do not tell."""
    found, deviation = np.full(design.shape[1], np.nan), np.full(design.shape[1], np.inf)
    norm = np.linalg.norm(design, axis=0)
    used = norm > math.sqrt(OPEN) * norm.max()
    scaled = design[:, used] / norm[used]
    value, vector = np.linalg.eigh(scaled.T @ scaled)
    kept = value > OPEN * value[-1]
    told = np.all(np.abs(vector[:, ~kept]) < SHARES, axis=1)
    inverse = (vector[:, kept] / value[kept]) @ vector[:, kept].T
    solved, spread = inverse @ (scaled.T @ right) / norm[used], np.sqrt(np.diag(inverse)) / norm[used]
    found[used], deviation[used] = np.where(told, solved, np.nan), np.where(told, spread, np.inf)
    return found, deviation
