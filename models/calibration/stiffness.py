"""Identify the springs of a robot from loads on its tool and the displacements that they make, at many poses.

Wang, Zhang & Fuhlbrigge (paper 003), Eq. (23) and Fig. 14: the displacement of a sphere tip under a weight or a pulley,
d = sum_i g_i (h_i . W) c_i, is linear in the compliances c_i = 1/k_i. h_i = [e x r; e] is the screw of spring i (axis e, lever r to the
tip) with what turns with it, g_i its upper half, W = [f; m] the load. "Only the first three equations", the displacement, are used.
Everything in SI, in the base frame B; rms values are those of vectors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robomill.models.model.declaration import FloatArray, Model, record
from robomill.models.robot.kinematics import Robot, Tool, robot_variables
from robomill.models.robot.virtual_joints import DRIVES, JOINTS, TABLE_1, compliance_variables, virtual_joints

SIGNIFICANT = 2.0
"""Standard deviations that a compliance must differ from zero by to be determined: 95 %."""
DEPENDENT = 1e-8
"""Singular value, relative to the largest of the scaled columns, below which springs are told apart by roundoff only."""
SHARES = 1e-3
"""Share of a spring in such a direction from which on it belongs to it."""
RIGID = 9.9e96
"""Stiffness of what is taken as rigid, N.m/rad, as in the other files."""
JOINT_NAMES = ("axis 1", "axis 2", "linked arm", "axis 3", "arm", "axis 4", "axis 5", "axis 6", "sensor", "spindle and holder", "tool")
VAGUE = 10.0
"""Prior standard deviation of a compliance for the choice of poses, in the largest one found: next to no knowledge."""


@dataclass(frozen=True)
class Loads:
    """Measured loads and displacements, one row per pose."""

    q: FloatArray
    """[n, 6] axis angles A1..A6 behind the gears, rad."""
    f_T_B: FloatArray
    """[n, 3] force on the tool at T, in B, N."""
    m_T_B: FloatArray
    """[n, 3] moment on the tool about T, in B, N.m."""
    d_T_B: FloatArray
    """[n, 3] displacement of T by the load, in B, m."""

    def __post_init__(self) -> None:
        """Refuse rows that do not belong together, and values that are none."""
        n = len(self.q)
        for name, width in (("q", 6), ("f_T_B", 3), ("m_T_B", 3), ("d_T_B", 3)):
            value = getattr(self, name)
            if np.shape(value) != (n, width):
                raise ValueError(f"loads: {name} has shape {np.shape(value)}, expected {(n, width)} like the axis angles of {n} poses")
            if not np.all(np.isfinite(value)):
                row = int(np.argwhere(~np.isfinite(value))[0, 0]) + 1
                raise ValueError(f"loads: {name} of pose {row} is {value[row - 1]}, expected finite numbers; leave that pose out")

    def __len__(self) -> int:
        return len(self.q)

    def only(self, rows: FloatArray | slice) -> Loads:
        """These rows of it."""
        return Loads(self.q[rows], self.f_T_B[rows], self.m_T_B[rows], self.d_T_B[rows])


@dataclass(frozen=True)
class Spring:
    """A place in the table of virtual joints (`models.robot.virtual_joints`): row of the joint, column x, y, z = 0, 1, 2 of its frame."""

    name: str
    row: int
    column: int


SPRINGS = tuple(Spring(f"A{i + 1}", row, 2) for i, row in enumerate(DRIVES))
"""The six drives, the variant `joint_1dof`."""


def tilts(axes: Sequence[int]) -> tuple[Spring, ...]:
    """Springs of link and bearing about x and y at these axes, 1..6. ValueError names another axis."""
    if wrong := sorted(set(axes) - set(range(1, 7))):
        raise ValueError(f"tilt at axis {', '.join(map(str, wrong))}: expected axes 1..6")
    return tuple(Spring(f"A{a} tilt {'xy'[c]}", DRIVES[a - 1], c) for a in axes for c in (0, 1))


def screws(robot: Robot, tool: Tool, q: FloatArray, springs: Sequence[Spring], coupled: bool = True) -> FloatArray:
    """Screws [n, springs, 6] of the tool tip, m/rad and rad/rad, for axis angles `q` [n, 6].

    `coupled`: the springs of the drives are at the axis angles and turn what is coupled to them, as a parallelogram does (paper 003:
    "at the motor angles"); else every spring turns its own joint only, for a controller that merely shows another angle.
    """

    def unused(*_: object) -> int:
        return 0

    s = record(Model("springs", robot.name, (*robot_variables(robot, tool), *compliance_variables(TABLE_1, tool)), unused, unused).new())
    found = np.zeros((len(q), len(springs), 6))
    for k, angles in enumerate(q):
        virtual_joints(s, angles)

        def screw(row: int, column: int) -> FloatArray:
            e = s.frame_R[row, :, column]
            return np.concatenate([np.cross(e, s.frame_p[13] - s.frame_p[row]), e])

        for i, spring in enumerate(springs):
            found[k, i] = screw(spring.row, spring.column)
            if coupled and spring.column == 2 and spring.row in DRIVES:
                axis = DRIVES.index(spring.row)
                for m in np.flatnonzero(robot.axis_coupling[:, axis]):
                    found[k, i] += robot.axis_sign[axis] * robot.axis_coupling[m, axis] * screw(DRIVES[m], 2)
    return found


def displacements(screw: FloatArray, f_T_B: FloatArray, m_T_B: FloatArray) -> FloatArray:
    """Design [n, 3, springs]: displacement of the tool tip by each spring, per compliance of one rad/(N.m)."""
    moment = np.einsum("nsi,ni->ns", screw, np.concatenate([f_T_B, m_T_B], axis=1))
    return np.asarray(np.swapaxes(screw[:, :, :3], 1, 2) * moment[:, None, :])


@dataclass(frozen=True)
class StiffnessFit:
    """Springs that explain the measured displacements best, and how well."""

    springs: tuple[Spring, ...]
    compliance: FloatArray
    """[springs] rad/(N.m); zero where nothing at all was measured of a spring."""
    covariance: FloatArray
    """[springs, springs] of the compliances, from the residuals; infinite where nothing was measured."""
    condition: float
    """Largest over smallest singular value of the design with columns scaled to one, without springs that were not loaded."""
    dependent: tuple[tuple[str, ...], ...]
    """Groups of springs that make the same displacements in all of these poses: only a sum of them is known."""
    unloaded: tuple[str, ...]
    """Springs that no load has turned."""
    scatter: float
    """Standard deviation of the measured components that the residuals speak for, m."""
    residual: float
    """What the springs leave, m rms."""
    left_out: float
    """What they leave of a pose that was not used, m rms: each pose once left out."""
    rigid: float
    """What a rigid robot leaves, m rms."""
    worst: tuple[int, float]
    """Pose (from zero) with the largest residual, and that, m."""
    per_pose: FloatArray
    """[n, 3] residuals, m."""

    @property
    def deviation(self) -> FloatArray:
        """[springs] standard deviations of the compliances, rad/(N.m)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def relative_deviation(self) -> FloatArray:
        """[springs] standard deviations over the values: of compliance and, to first order, of stiffness."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.where(self.compliance == 0.0, np.inf, np.abs(self.deviation / self.compliance)))

    @property
    def stiffness(self) -> FloatArray:
        """[springs] N.m/rad; infinite where the compliance is zero."""
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / self.compliance)

    def finding(self, i: int) -> str:
        """`determined`, `negative: something else is missing` or `not determined: why`."""
        name, together = self.springs[i].name, [group for group in self.dependent if self.springs[i].name in group]
        if name in self.unloaded:
            return "not determined: the loads have no moment about it in any pose (load point on its axis?)"
        if together:
            return f"not determined: the same displacements as {', '.join(n for n in together[0] if n != name)} in all poses"
        if not abs(self.compliance[i]) >= SIGNIFICANT * self.deviation[i]:
            sign = "negative, but " if self.compliance[i] < 0.0 else ""
            return f"not determined: {sign}no more than {SIGNIFICANT:g} standard deviations from zero"
        return "negative: something else is missing" if self.compliance[i] < 0.0 else "determined"

    @property
    def usable(self) -> tuple[Spring, ...]:
        """The springs that are determined and positive."""
        return tuple(s for i, s in enumerate(self.springs) if self.finding(i) == "determined")


def identify_stiffness(robot: Robot, tool: Tool, loads: Loads, springs: Sequence[Spring] = SPRINGS, coupled: bool = True) -> StiffnessFit:
    """Springs that explain the displacements of `loads` best: `fit_springs` on the design of `displacements`."""
    return fit_springs(springs, displacements(screws(robot, tool, loads.q, springs, coupled), loads.f_T_B, loads.m_T_B), loads.d_T_B)


def fit_springs(springs: Sequence[Spring], design: FloatArray, d_T_B: FloatArray) -> StiffnessFit:
    """Compliances by least squares over all poses, without weights and bounds: a negative one says that something else is missing.

    Springs that no load turns are left out; of springs that the poses do not tell apart the smallest solution is taken, and both are
    named. Parameters: `design` [n, 3, springs] N.m x m, `d_T_B` [n, 3] m. Errors: ValueError for too few poses and without any load.
    """
    n, needed = len(design), -(-(len(springs) + 1) // 3) + 1
    if n < needed:
        raise ValueError(
            f"identify_stiffness: {n} poses for {len(springs)} springs, at least {needed} needed (three components each, one "
            "pose to spare); measure more poses, or fewer springs"
        )
    A, y = design.reshape(-1, len(springs)), d_T_B.ravel()
    norm = np.linalg.norm(A, axis=0)
    turned = norm > DEPENDENT * norm.max()
    if not turned.any():
        raise ValueError("identify_stiffness: no load turns any spring; check forces and their unit")
    scaled = A[:, turned] / norm[turned]
    U, singular, Vt = np.linalg.svd(scaled, full_matrices=False)
    kept = singular > DEPENDENT * singular[0]
    names = np.array([s.name for s in springs])[turned]
    dependent = _groups(names, Vt[~kept])
    inverse = Vt[kept].T / singular[kept]
    compliance, covariance = np.zeros(len(springs)), np.full((len(springs), len(springs)), np.nan)
    compliance[turned] = inverse @ (U[:, kept].T @ y) / norm[turned]
    rest = (y - A @ compliance).reshape(-1, 3)
    scatter = float(np.sqrt(np.sum(rest**2) / (rest.size - int(kept.sum()))))
    covariance[np.ix_(turned, turned)] = scatter**2 * (inverse @ inverse.T) / np.outer(norm[turned], norm[turned])
    covariance[~turned, ~turned] = np.inf
    hat = U[:, kept].reshape(n, 3, -1)
    out = [np.linalg.solve(np.eye(3) - u @ u.T, r) for u, r in zip(hat, rest, strict=True)]  # exact for least squares
    size = np.linalg.norm(rest, axis=1)
    return StiffnessFit(
        tuple(springs),
        compliance,
        covariance,
        float(singular[0] / singular[kept][-1]) if kept.all() else np.inf,
        dependent,
        tuple(s.name for s, t in zip(springs, turned, strict=True) if not t),
        scatter,
        _rms(rest),
        _rms(np.array(out)),
        _rms(d_T_B),
        (int(np.argmax(size)), float(size.max())),
        rest,
    )


@dataclass(frozen=True)
class HelpfulPose:
    """A pose and a load that would help, with what is known once it and those before it are measured."""

    q: FloatArray
    """[6] rad."""
    f_T_B: FloatArray
    """[3] N."""
    relative_deviation: FloatArray
    """[springs] standard deviations then, over the compliances."""


def helpful_poses(
    robot: Robot, tool: Tool, loads: Loads, fit: StiffnessFit, count: int = 3, coupled: bool = True, candidates: int = 400, seed: int = 1
) -> tuple[HelpfulPose, ...]:
    """The poses that lower the uncertainty most, one after the other, of random `candidates` in the range that was measured.

    A-optimal: least sum of the squared relative standard deviations, P' = P - P B^T (s^2 I + B P B^T)^-1 B P for a pose with the
    design B. Axis angles between the least and the largest measured ones, widened by a quarter and within the limits; forces of any
    direction, as large as the largest measured.
    """
    rng = np.random.default_rng(seed)
    low, high = loads.q.min(axis=0), loads.q.max(axis=0)
    room = 0.25 * (high - low)
    q = rng.uniform(
        np.maximum(low - room, np.minimum(robot.q_min, low)), np.minimum(high + room, np.maximum(robot.q_max, high)), (candidates, 6)
    )
    force = rng.normal(size=(candidates, 3))
    force *= np.linalg.norm(loads.f_T_B, axis=1).max() / np.linalg.norm(force, axis=1, keepdims=True)
    size = np.abs(fit.compliance)
    scale = np.where(size > 0.0, np.maximum(size, 1e-3 * size.max()), size.max())
    known = displacements(screws(robot, tool, loads.q, fit.springs, coupled), loads.f_T_B, loads.m_T_B).reshape(-1, len(scale)) * scale
    noise = max(fit.scatter, np.finfo(float).tiny)
    vague = VAGUE * np.abs(fit.compliance).max() / scale
    P = np.linalg.inv(known.T @ known / noise**2 + np.diag(vague**-2.0))
    B = displacements(screws(robot, tool, q, fit.springs, coupled), force, np.zeros_like(force)) * scale
    chosen: list[HelpfulPose] = []
    for _ in range(count):
        PB = P @ np.swapaxes(B, 1, 2)
        gain = np.einsum("nij,njk->nik", PB, np.linalg.inv(noise**2 * np.eye(3) + B @ PB))
        best = int(np.argmax(np.einsum("nij,nij->n", gain, PB)))
        P = P - gain[best] @ PB[best].T
        chosen.append(HelpfulPose(q[best], force[best], np.sqrt(np.diag(P))))
        q, force, B = np.delete(q, best, axis=0), np.delete(force, best, axis=0), np.delete(B, best, axis=0)
    return tuple(chosen)


def compliance_file(robot: Robot, fit: StiffnessFit, used: StiffnessFit) -> str:
    """A file of models/data/compliance with the springs of `used`, the refit of those that `fit` found to be usable; all else rigid."""
    table = np.full((JOINTS, 3), RIGID)
    for s, k in zip(used.springs, used.stiffness, strict=True):
        table[s.row, s.column] = k
    relative = ", ".join(f"{s.name} {100.0 * r:.0f}" for s, r in zip(used.springs, used.relative_deviation, strict=True))
    left = ", ".join(s.name for s in fit.springs if s not in used.springs)
    rows = "\n".join(f"    [{', '.join(f'{k:.4g}' for k in row)}],    # {what}" for row, what in zip(table, JOINT_NAMES, strict=True))
    source = (
        f"least squares on {len(used.per_pose)} static loads: {1e3 * used.rigid:.3g} mm rms rigid, {1e3 * used.residual:.3g} mm with these "
    )
    source += f"springs, {1e3 * used.left_out:.3g} mm at poses left out"
    validity = f"relative standard deviations {relative} %" + (f"; rigid because not determined or negative: {left}" if left else "")
    places = "".join(
        f'\n[{name}]\nvalue = {value}\nunit = "{unit}"\nsource = "as kr300_r2500_ultra"\nvalidity = "without influence: rigid"\n'
        for name, value, unit in (
            ("sensor_stiffness_scale", 1.0, "1"),
            ("link_arm_position", 0.5, "1"),
            ("arm_position", 0.5, "1"),
            ("sensor_position", 28.0, "mm"),
            ("holder_position", 100.0, "mm"),
        )
    )
    places += '\n[damping_time]\nvalue = 0.4\nunit = "ms"\nsource = "as kr210_2"\nvalidity = "not measured; static loads do not show it"\n'
    return (
        f"# Virtual joints of the {robot.name}, written by robomill identify stiffness.\n\n[stiffness]\n"
        f'# columns k_C, k_B, k_A: about x, y, z of the frame\nvalue = [\n{rows}\n]\nunit = "N.m/rad"\n'
        f'source = "{source}"\nvalidity = "{validity}"\n{places}'
    )


def _groups(names: FloatArray, null: FloatArray) -> tuple[tuple[str, ...], ...]:
    """Names of the springs that directions `null` [m, springs] without displacement tie together, by group."""
    tied = np.abs(null.T @ null) > SHARES**2
    left, groups = {i for i in range(len(names)) if tied[i, i]}, []
    while left:
        group, new = set[int](), {min(left)}
        while new:
            group |= new
            new = {j for i in new for j in left if tied[i, j]} - group
        left -= group
        groups.append(tuple(str(names[i]) for i in sorted(group)))
    return tuple(groups)


def _rms(vectors: FloatArray) -> float:
    """Root mean square length of vectors [n, 3]."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
