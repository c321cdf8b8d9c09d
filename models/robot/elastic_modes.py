"""Natural modes of a robot on its virtual joints at a pose, and what a force at the tool tip makes of them.

Paper 004 (Englert 2011), Eqs. (2.1), (2.2) about a pose at rest: M x.. + D x. + K x = J^T [f; m] with the elastic coordinates x of
`elastic_bodies`. The modes are those without damping, K v = w^2 M v; the damping ratio of a mode is that of D in it alone,
v^T D v / (2 w), exact where D = t K with one t for all springs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.models.model.declaration import FloatArray, Model, Record, Variable, record
from robomill.models.robot.dynamics import DYNAMICS_VARIABLES, RobotDynamics, in_robot_frames, load_dynamics
from robomill.models.robot.elastic_bodies import ELASTIC_VARIABLES, elastic_coordinates, mass_matrix, place_bodies
from robomill.models.robot.kinematics import ROBOT_VARIABLES, Robot, Tool, load_robot, load_tool
from robomill.models.robot.virtual_joints import COMPLIANCE_VARIABLES, JOINTS, Compliance, load_compliance, tip_screws, virtual_joints

JOINT_NAMES = ("A1", "A2", "link arm", "A3", "arm", "A4", "A5", "A6", "sensor", "holder", "tool")
"""Virtual joints by their rows in the table of stiffness."""
_DRIVE_ROWS = (0, 1, 3, 5, 6, 7)
_MASSLESS = 1e-12
"""Part of the largest 1/w^2 below which a combination of springs moves no mass: that of roundoff in M."""


@dataclass(frozen=True, kw_only=True)
class ElasticMachine:
    """A robot with springs, rigid bodies and tool; `dataclasses.replace` changes one of them."""

    robot: Robot
    compliance: Compliance
    dynamics: RobotDynamics
    tool: Tool


@dataclass(frozen=True)
class TipModes:
    """Modes of an elastic robot in one pose, n of them by rising frequency, on m elastic coordinates."""

    frequency: FloatArray
    """Without damping [Hz], (n,)."""
    damping: FloatArray
    """Damping ratio [1], (n,)."""
    shape: FloatArray
    """Motion of the tool tip T in B per modal coordinate, mass-normalised, (6, n): m/sqrt(kg), then rad/sqrt(kg)/m."""
    coordinate_shape: FloatArray
    """Turn of the elastic coordinates per modal coordinate, (m, n); its columns v have v^T M v = 1."""
    coordinates: tuple[str, ...]
    """Names of the elastic coordinates: "A1 drive", "A3 tilt x", "holder y"."""
    stiffness: FloatArray
    """Stiffness of the elastic coordinates [N.m/rad], (m,)."""

    @property
    def energy_share(self) -> FloatArray:
        """Part of the spring energy of each mode that is in each elastic coordinate [1], (m, n); columns sum to 1."""
        energy = self.stiffness[:, None] * self.coordinate_shape**2
        return np.asarray(energy / energy.sum(axis=0))


def load_machine(robot: str | Path, tool: str | Path, compliance: str | None = None, dynamics: str | None = None) -> ElasticMachine:
    """The machine of data files by their names (models/data); compliance and dynamics go by the name of the robot unless named.

    FileNotFoundError lists what there is; ValueError names file, field, what was found, what is expected.
    """
    name = Path(robot).stem
    return ElasticMachine(
        robot=load_robot(robot),
        compliance=load_compliance(compliance or name),
        dynamics=load_dynamics(dynamics or name),
        tool=load_tool(tool),
    )


def machine_values(machine: ElasticMachine) -> dict[str, Any]:
    """Parameters of `ELASTIC_ROBOT`, and of components with the same names, that describe the machine; SI units."""
    robot, compliance, dynamics, tool = machine.robot, machine.compliance, machine.dynamics, machine.tool
    com, inertia = in_robot_frames(dynamics, robot)
    of_robot = ("dh_alpha", "dh_a", "dh_d", "dh_offset", "axis_sign", "axis_coupling", "q_min", "q_max")
    of_springs = ("stiffness", "sensor_stiffness_scale", "link_arm_position", "arm_position", "sensor_position", "holder_position")
    return {
        **{name: getattr(robot, name) for name in of_robot},
        **{name: getattr(compliance, name) for name in of_springs},
        "damping_time": np.broadcast_to(np.asarray(compliance.damping_time), (JOINTS, 3)),
        "body_mass": dynamics.body_mass,
        "body_com": com,
        "body_inertia": inertia,
        "payload_inertia": dynamics.payload_inertia,
        "gravity_B": dynamics.gravity_B,
        "p_FT_F": tool.p_FT_F,
        "quat_FT": tool.quat_FT,
        "tool_length": tool.length,
        "payload_mass": tool.mass,
        "payload_com_F": tool.p_FG_F,
    }


def _at_pose_init(s: Record) -> int:
    elastic_coordinates(s)
    return 0


def _at_pose_step(s: Record, t: float, h: float) -> int:
    virtual_joints(s, s.q)
    place_bodies(s)
    mass_matrix(s)
    tip_screws(s, s.tip)
    return 0


ELASTIC_ROBOT = Model(
    name="elastic_robot",
    description="Mass matrix of a robot on its virtual joints",
    variables=(
        Variable("q", "input", "Axis angles", "rad", (6,)),
        *ROBOT_VARIABLES,
        *COMPLIANCE_VARIABLES,
        *DYNAMICS_VARIABLES,
        *ELASTIC_VARIABLES,
        Variable("tip", "state", "Velocity and turn of T per turn of the virtual joints about x, y, z", "1", (JOINTS, 3, 6)),
    ),
    init=_at_pose_init,
    step=_at_pose_step,
)
"""The kernels of `elastic_bodies` as a model of their own; not a component."""


def elastic_robot(machine: ElasticMachine, values: Mapping[str, Any] | None = None) -> Record:
    """A record of `ELASTIC_ROBOT` for the machine with its elastic coordinates; `values` change parameters of it by name."""
    data = ELASTIC_ROBOT.new()
    for name, value in {**machine_values(machine), **(values or {})}.items():
        data[name] = value
    s = record(data)
    _at_pose_init(s)
    return s


def system_matrices(machine: ElasticMachine, q: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """M [kg.m2], D [N.m.s/rad], K [N.m/rad] (m, m) and J (6, m) of M x.. + D x. + K x = J^T [f; m] at the axis angles q (6,) rad.

    J is the motion of T in B per turn of the elastic coordinates: m/rad, rad/rad. ValueError for a q of other shape.
    """
    return _matrices(_at_pose(machine, q))


def _at_pose(machine: ElasticMachine, q: npt.ArrayLike) -> Record:
    angles = np.asarray(q, dtype=np.float64)
    if angles.shape != (6,) or not np.all(np.isfinite(angles)):
        raise ValueError(f"elastic modes: q is {np.asarray(q).tolist()}, expected six finite axis angles in rad")
    s = elastic_robot(machine)
    s.q[:] = angles
    _at_pose_step(s, 0.0, 0.0)
    return s


def _matrices(s: Record) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    n = int(s.elastic_count)
    M = np.array(s.elastic_M[:n, :n])
    K = np.diag(s.elastic_stiffness[:n])
    D = np.diag(s.elastic_damping[:n])
    J = np.array(s.tip[s.elastic_joint[:n], s.elastic_axis[:n]]).T
    return M, D, K, J


def _names(s: Record) -> tuple[str, ...]:
    names = []
    for j, c in zip(s.elastic_joint[: s.elastic_count], s.elastic_axis[: s.elastic_count], strict=True):
        kind = ("drive" if c == 2 else f"tilt {'xyz'[c]}") if j in _DRIVE_ROWS else "xyz"[c]
        names.append(f"{JOINT_NAMES[j]} {kind}")
    return tuple(names)


def elastic_modes(machine: ElasticMachine, q: npt.ArrayLike) -> TipModes:
    """All modes of the machine at the axis angles q (6,) rad; paper 004, Eqs. (2.1), (2.2) without motion.

    Solved as K^-1/2 M K^-1/2 u = w^-2 u: springs without mass between them, such as sensor and holder about the flange axis, have
    infinite frequency, move no tool tip and are left out. ValueError for a q of other shape and for a machine without masses.
    """
    s = _at_pose(machine, q)
    M, D, K, J = _matrices(s)
    soft = 1.0 / np.sqrt(np.diag(K))
    inverse_squares, turned = np.linalg.eigh(soft[:, None] * M * soft)
    kept = np.flatnonzero(inverse_squares > _MASSLESS * inverse_squares[-1])[::-1]
    if not len(kept) or not inverse_squares[-1] > 0.0:
        raise ValueError(
            f"elastic modes: the bodies of robot {machine.robot.name!r} weigh {np.sum(machine.dynamics.body_mass):g} kg; expected masses "
            "and inertias: name a file of models/data/dynamics"
        )
    omega = 1.0 / np.sqrt(inverse_squares[kept])
    coordinate_shape = soft[:, None] * turned[:, kept] * omega
    # sign of a shape: the largest turn is positive, so that neighbouring poses can be compared
    largest = np.abs(coordinate_shape).argmax(axis=0)
    coordinate_shape = coordinate_shape * np.sign(coordinate_shape[largest, np.arange(len(kept))])
    damping = (coordinate_shape**2 * np.diag(D)[:, None]).sum(axis=0) / (2.0 * omega)
    return TipModes(omega / (2.0 * np.pi), damping, J @ coordinate_shape, coordinate_shape, _names(s), np.diag(K).copy())


def frequency_response(modes: TipModes, frequencies_hz: npt.ArrayLike) -> npt.NDArray[np.complex128]:
    """Receptance at T, (nf, 6, 6): displacement and rotation in B per force and moment in B; m/N, rad/N, m/(N.m), rad/(N.m).

    H(w) = sum_i s_i s_i^T / (w_i^2 - w^2 + 2 j zeta_i w_i w), s_i the shape of mode i; at 0 Hz it is the static compliance.
    `frequencies_hz` (nf,) Hz. Inertance, what an accelerometer shows, is -w^2 times that.
    """
    w = 2.0 * np.pi * np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))[:, None]
    wn = 2.0 * np.pi * modes.frequency
    weight = 1.0 / (wn**2 - w**2 + 2j * modes.damping * wn * w)
    return np.asarray(np.einsum("an,fn,bn->fab", modes.shape, weight, modes.shape))
