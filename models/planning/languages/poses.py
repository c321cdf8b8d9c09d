"""The internal form of a robot program: poses in the workpiece frame, and what holds on the way to each. SI units.

KRL, RAPID and G-code are written from it (`write_krl`, `write_rapid`, `write_gcode`); `read_krl` and `read_rapid` return it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from robomill.models.model.declaration import FloatArray
from robomill.models.planning.gcode import Vector
from robomill.models.planning.trajectory import Placement
from robomill.models.robot.kinematics import Tool

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Quaternion = tuple[float, float, float, float]
MotionKind = Literal["linear", "spline"]
RPM = math.pi / 30.0
_UNIT_LENGTH = 1e-6
"""A quaternion may differ from unit length by so much: eight printed digits leave 2e-8."""


class LanguageError(ValueError):
    """A robot program that cannot be read: names file, line, what was found and the remedy."""

    def __init__(self, name: str, line: int, found: str, text: str, remedy: str) -> None:
        super().__init__(f"{name} line {line}: {found} in {text.strip()!r}; {remedy}")
        self.line = line


@dataclass(frozen=True)
class Frames:
    """Where workpiece and tool are for the controller: $BASE and $TOOL of KRL, wobjdata and tooldata of RAPID."""

    p_BP_B: Vector
    """Origin of the workpiece frame P in the robot base B [m]."""
    quat_BP: Quaternion
    """Orientation of P in B (w, x, y, z)."""
    p_FT_F: Vector
    """Tool tip T in the flange frame F [m]."""
    quat_FT: Quaternion
    """Orientation of T in F; x of T is the tool axis, pointing out of the spindle."""
    mass: float = 0.0
    """Mass of the end effector [kg]; 0 where it is not known."""
    p_FG_F: Vector = (0.0, 0.0, 0.0)
    """Its centre of gravity in F [m]."""
    q_start: tuple[float, ...] | None = None
    """Axis angles [rad] that the robot goes to before the first pose: they choose the branch. None: it comes from where it stands."""

    @property
    def abc_FT(self) -> FloatArray:
        """Orientation of T in F as A, B, C [rad] (3,)."""
        abc: FloatArray = np.deg2rad(abc_degrees(np.array([self.quat_FT]))[0])
        return abc

    @staticmethod
    def at(placement: Placement, tool: Tool, q_start: Sequence[float] | FloatArray | None = None) -> Frames:
        """The frames of a placement and an end effector."""
        p, q, g = (tuple(float(x) for x in v) for v in (tool.p_FT_F, tool.quat_FT, tool.p_FG_F))
        quat = tuple(np.roll(Rotation.from_matrix(placement.R_BP).as_quat(canonical=True), 1).tolist())
        start = None if q_start is None else tuple(float(x) for x in q_start)
        return Frames(placement.p_BP_B, quat, p, q, tool.mass, g, start)  # type: ignore[arg-type]  # three and four numbers


def frames_as_read(base: FloatArray, tool: FloatArray, load: Sequence[float], axes: Sequence[float] | None) -> Frames:
    """Frames from what files hold: base and tool (7,) as position [mm] and quaternion, mass [kg] and its centre [mm], axis angles [deg]."""
    mass, *centre = load
    pb, qb, pt, qt, g = (tuple(v.tolist()) for v in (1e-3 * base[:3], base[3:], 1e-3 * tool[:3], tool[3:], 1e-3 * np.array(centre)))
    return Frames(pb, qb, pt, qt, mass, g, None if axes is None else tuple(np.deg2rad(axes).tolist()))


@dataclass(frozen=True, eq=False)
class PoseProgram:
    """A sequence of n >= 2 poses of the tool T in the workpiece frame P. Make one with `pose_program`.

    What an array says of pose i holds on the way to it; feed and blend of the first pose are those of the way from wherever the
    robot comes.
    """

    name: str
    frames: Frames
    p: FloatArray
    """p_PT_P [m] (n, 3)."""
    quat: FloatArray
    """R_PT as (w, x, y, z) (n, 4)."""
    feed: FloatArray
    """m/s (n,)."""
    blend: FloatArray
    """Distance from the pose at which its corner is left and joined again [m] (n,); 0 = exact stop, as at the end, at a dwell and where
    tool or spindle speed change. All 0 in a spline."""
    spindle_speed: FloatArray
    """rad/s (n,); negative turns counterclockwise (M4), 0 stands."""
    tool: IntArray
    """T number in the spindle (n,); 0 = none named."""
    dwell: FloatArray
    """Standstill at the pose [s] (n,)."""
    rapid: BoolArray
    """Whether the way is one through air, G0 (n,)."""
    motion: MotionKind = "linear"
    """``linear``: straight between the poses, blended; ``spline``: the curve of the controller through them (KRL only), rapids straight."""
    comments: Mapping[int, str] = field(default_factory=dict)
    """Text that stands before the pose of this index."""
    header: tuple[str, ...] = ()
    """Lines that say from what and how the program was made."""
    lines: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Line (n,) of the file that each pose was read from; empty where there is none."""
    source: tuple[str, ...] = ()
    """Lines of the file, for messages."""

    @property
    def standing(self) -> BoolArray:
        """Whether the robot comes to rest at pose i (n,): no blend; in a spline its ends and rapids."""
        if self.motion == "linear":
            exact: BoolArray = self.blend == 0.0
            return exact
        ends: BoolArray = stops_at(self.dwell, self.spindle_speed, self.tool) | self.rapid | np.append(self.rapid[1:], True)
        ends[0] = True
        return ends


def pose_program(
    name: str,
    frames: Frames,
    p: npt.ArrayLike,
    quat: npt.ArrayLike,
    feed: npt.ArrayLike,
    blend: npt.ArrayLike = 0.0,
    spindle_speed: npt.ArrayLike = 0.0,
    tool: npt.ArrayLike = 0,
    dwell: npt.ArrayLike = 0.0,
    rapid: npt.ArrayLike = False,
    motion: MotionKind = "linear",
    comments: Mapping[int, str] | None = None,
    header: Sequence[str] = (),
    lines: npt.ArrayLike = (),
    source: Sequence[str] = (),
) -> PoseProgram:
    """A program of n poses from p_PT_P [m] (n, 3) and R_PT (n, 4) or (4,), scalar first; the rest as `PoseProgram`, each one value or (n,).

    ValueError where a shape does not fit, a number is not finite, a feed is not positive, a blend or dwell is negative, a
    quaternion is not of unit length, a spline has blends, or a comment has more than one line.
    """
    points = np.array(p, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
        raise ValueError(f"{name}: positions have shape {points.shape}; expected (n, 3) with n >= 2")
    n = len(points)
    try:
        quats = np.array(np.broadcast_to(np.asarray(quat, dtype=np.float64), (n, 4)))
        given: dict[str, Any] = {"feed": feed, "blend": blend, "spindle_speed": spindle_speed, "dwell": dwell}
        each = {key: np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), n)) for key, value in given.items()}
        tools, fast = np.array(np.broadcast_to(np.asarray(tool, dtype=np.int64), n)), np.array(np.broadcast_to(np.asarray(rapid, bool), n))
    except ValueError as error:
        raise ValueError(f"{name}: {error}; expected one value or one for each of the {n} poses") from None
    for key, values in {"position": points, "quaternion": quats, **each}.items():
        if not np.all(np.isfinite(values)):
            raise ValueError(f"{name}: {key} of pose {int(np.argwhere(~np.isfinite(values))[0][0])} is not finite")
    off = np.abs(np.linalg.norm(quats, axis=1) - 1.0)
    if np.max(off) > _UNIT_LENGTH:
        i = int(np.argmax(off))
        raise ValueError(
            f"{name}: quaternion {quats[i].tolist()} of pose {i} is not of unit length; divide it by {np.linalg.norm(quats[i])}"
        )
    for key, least, wanted in (("feed", math.ulp(0.0), "positive"), ("blend", 0.0, "not negative"), ("dwell", 0.0, "not negative")):
        if np.min(each[key]) < least:
            i = int(np.argmin(each[key]))
            raise ValueError(f"{name}: {key} of pose {i} is {each[key][i]:g}; it must be {wanted}")
    if motion == "spline" and np.any(each["blend"] > 0.0):
        raise ValueError(f"{name}: a spline goes through its poses and has no blends; give blend = 0, or motion = 'linear'")
    said = dict(comments or {})
    for text in (*said.values(), *header):
        if "\n" in text or "\r" in text:
            raise ValueError(f"{name}: comment {text!r} has more than one line; give one text per line")
    each["blend"][stops_at(each["dwell"], each["spindle_speed"], tools)] = 0.0
    numbers = np.array(lines, dtype=np.int64)
    return PoseProgram(
        name, frames, points, quats, **each, tool=tools, rapid=fast, motion=motion,
        comments=said, header=tuple(header), lines=numbers, source=tuple(source),
    )  # fmt: skip


def stops_at(dwell: FloatArray, spindle_speed: FloatArray, tool: IntArray) -> BoolArray:
    """Where a path cannot go through (n,): dwells, changes of tool or spindle speed, the end."""
    stops: BoolArray = (dwell > 0.0) | np.append((np.diff(spindle_speed) != 0.0) | (np.diff(tool) != 0), True)
    return stops


def abc_degrees(quat: FloatArray) -> FloatArray:
    """A, B, C [deg] (n, 3), R = Rz(A) Ry(B) Rx(C), of quaternions (n, 4) (Englert 2011, appendix A: roll, pitch, yaw).

    At B = +-90 deg only A - C or A + C is determined: C is 0 there. That is the case where the tool axis x is upright.
    """
    R = Rotation.from_quat(np.roll(quat, -1, axis=1)).as_matrix()
    level = np.hypot(R[:, 0, 0], R[:, 1, 0])
    locked = level < _LOCKED
    B = np.arctan2(-R[:, 2, 0], np.where(locked, 0.0, level))
    A = np.where(locked, np.arctan2(-R[:, 0, 1], R[:, 1, 1]), np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    C = np.where(locked, 0.0, np.arctan2(R[:, 2, 1], R[:, 2, 2]))
    abc: FloatArray = np.rad2deg(np.column_stack([A, B, C]))
    return abc


_LOCKED = math.radians(0.6e-5)
"""cos B below which B is printed as 90.00000 deg."""


def quaternions(abc: FloatArray) -> FloatArray:
    """Quaternions (n, 4), scalar first and not negative, of A, B, C [deg] (n, 3)."""
    quat: FloatArray = np.roll(Rotation.from_euler("ZYX", abc, degrees=True).as_quat(canonical=True), 1, axis=1)
    return quat


def number(value: float, digits: int) -> str:
    """A number with so many decimals, never with a minus before zeros."""
    text = f"{value:.{digits}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def angle(degrees: float) -> str:
    """An angle with five decimals, above -180 and up to 180 deg."""
    text = number(degrees, 5)
    return "180.00000" if text == "-180.00000" else text


def comment(text: str) -> str:
    """A comment as controllers take it: ASCII, no blanks at the ends."""
    return text.encode("ascii", "replace").decode().strip()
