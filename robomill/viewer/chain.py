"""A robot as a tree of frames that turn or slide, with simple bodies on them: from its Denavit-Hartenberg table, or from a URDF.

The page moves the same tree with the same numbers; `Tree.poses` is what it does, for the deflections and the tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from robomill.models.model.declaration import FloatArray, Record
from robomill.models.robot.kinematics import forward
from robomill.report.robot import pose

BASE = -1
"""Number of the frame that does not move."""
AXES = 6
TIP = 6
"""Number of the tool's frame in the tree of `from_dh`: after the six axes."""
USUAL_REACH = 2.7
"""|a2| + |a3| + |d4| [m] of the robots for which the thicknesses below are drawn (KR 300 R2500 ultra)."""
SINGULAR = 1e-3
"""Singular values of the Jacobian below this part of the largest count as zero: the arm cannot move there."""


@dataclass(frozen=True)
class Body:
    """A capsule or cylinder from `start` to `end` [m], of `radius` [m], in the frame `frame`; or, in place of them, a mesh."""

    frame: int
    part: str
    """What it is: base, arm, spindle, cutter or mesh."""
    start: FloatArray = field(default_factory=lambda: np.zeros(3))
    end: FloatArray = field(default_factory=lambda: np.zeros(3))
    radius: float = 0.0
    round: bool = True
    mesh: FloatArray | None = None
    """Triangles [n, 3, 3] m in the frame."""


@dataclass(frozen=True)
class Frame:
    """A frame: where it stands in its parent, and the axis that it then turns about, or slides along."""

    parent: int
    fixed: FloatArray
    """[4, 4]."""
    axis: FloatArray | None = None
    """Unit vector [3]; None: it is fixed."""
    slides: bool = False
    row: FloatArray = field(default_factory=lambda: np.zeros(AXES))
    """Turn of the frame by each axis angle [rad/rad], or slide [m/rad]."""
    offset: float = 0.0
    """Turn [rad] at axis angles zero."""


@dataclass(frozen=True)
class Tree:
    """Frames, each after its parent, and the bodies on them."""

    frames: tuple[Frame, ...]
    bodies: tuple[Body, ...]

    def poses(self, q: npt.ArrayLike) -> FloatArray:
        """Poses in B [n, frames, 4, 4] at axis angles q [n, 6] rad."""
        angles = np.atleast_2d(np.asarray(q, dtype=np.float64))
        T = np.empty((len(angles), len(self.frames), 4, 4))
        for i, f in enumerate(self.frames):
            parent: FloatArray = T[:, f.parent] if f.parent != BASE else np.eye(4)[None]
            T[:, i] = parent @ f.fixed
            if f.axis is not None:
                moved = np.broadcast_to(np.eye(4), (len(angles), 4, 4)).copy()
                value = angles @ f.row + f.offset
                if f.slides:
                    moved[:, :3, 3] = value[:, None] * f.axis
                else:
                    moved[:, :3, :3] = Rotation.from_rotvec(value[:, None] * f.axis).as_matrix()
                T[:, i] = T[:, i] @ moved
        return T


def deflections(tree: Tree, q: FloatArray, p: FloatArray, R: FloatArray) -> FloatArray:
    """Turns of the axes [n, 6] rad that move the tool of `from_dh` from where the axis angles q put it to the pose p [n, 3] m, R [n, 3, 3].

    One step of Newton with the geometric Jacobian: what is left is second order in a deflection of millimetres.
    """
    T = tree.poses(q)
    tip = T[:, TIP, :3, 3]
    along = T[:, :AXES, :3, 2]  # the frames of from_dh turn about their z
    reach = tip[:, None] - T[:, :AXES, :3, 3]
    per_joint = np.concatenate([np.cross(along, reach), along], axis=2).transpose(0, 2, 1)
    J = per_joint @ np.array([f.row for f in tree.frames[:AXES]])
    turn = Rotation.from_matrix(R @ T[:, TIP, :3, :3].transpose(0, 2, 1)).as_rotvec()
    gap = np.concatenate([p - tip, turn], axis=1)
    result: FloatArray = np.einsum("nij,nj->ni", np.linalg.pinv(J, rcond=SINGULAR), gap)
    return result


def from_dh(s: Record, q: npt.ArrayLike, cutter: float) -> Tree:
    """The tree of a robot whose geometry is in the record `s` (`robomill.joints.geometry`), with bodies as thick as such arms are.

    `q` [6] rad: a pose of it; `cutter` [m]: radius of the tool. Its frames are those of axes 1..6 and the tool's.
    """
    frames = []
    for i in range(AXES):
        row = np.array(s.axis_coupling[i], dtype=np.float64)
        row[i] = s.axis_sign[i]
        fixed = np.eye(4)
        fixed[:3, :3] = Rotation.from_euler("x", s.dh_alpha[i]).as_matrix()
        fixed[:3, 3] = np.array([s.dh_a[i], 0.0, 0.0]) + fixed[:3, 2] * s.dh_d[i]
        frames.append(Frame(i - 1, fixed, np.array([0.0, 0.0, 1.0]), row=row, offset=float(s.dh_offset[i])))
    tool = np.eye(4)
    tool[:3, :3] = Rotation.from_quat(s.quat_FT, scalar_first=True).as_matrix()
    tool[:3, 3] = s.p_FT_F
    frames.append(Frame(AXES - 1, tool))
    bare = Tree(tuple(frames), ())
    return Tree(bare.frames, tuple(_bodies(s, bare, np.asarray(q, dtype=np.float64), cutter)))


def _bodies(s: Record, tree: Tree, q: FloatArray, cutter: float) -> Sequence[Body]:
    """Capsules between the joints, where the side view of the report has them, and the spindle."""
    now = pose(s, q)
    forward(s, q)
    inverse = np.linalg.inv(tree.poses(q)[0])
    k = float(abs(s.dh_a[2]) + abs(s.dh_a[3]) + abs(s.dh_d[3])) / USUAL_REACH

    def body(frame: int, part: str, a: FloatArray, b: FloatArray, radius: float, **more: Any) -> Body:
        start, end = (a, b) if frame == BASE else (inverse[frame, :3, :3] @ v + inverse[frame, :3, 3] for v in (a, b))
        return Body(frame, part, start, end, radius, **more)

    shoulder, elbow, wrist = now.joints[1], now.joints[2], now.joints[4]
    axis_1 = np.array([0.0, 0.0, 1.0])
    middle = now.elbow + 0.5 * (wrist - now.elbow)
    height = float(shoulder[2])
    down = (now.tip - now.spindle) / max(float(np.linalg.norm(now.tip - now.spindle)), 1e-9)
    return [
        body(BASE, "base", 0.0 * axis_1, 0.55 * height * axis_1, 0.36 * k, round=False),
        body(0, "arm", 0.6 * height * axis_1, height * axis_1, 0.21 * k),
        body(0, "arm", height * axis_1, shoulder, 0.17 * k),
        body(1, "link", shoulder, elbow, 0.13 * k),
        body(2, "arm", elbow, now.elbow, 0.12 * k),
        body(2, "arm", now.elbow, middle, 0.12 * k),
        body(3, "link", middle, wrist, 0.095 * k),
        body(4, "arm", wrist, wrist + 0.5 * (now.flange - wrist), 0.08 * k),
        body(5, "link", wrist + 0.5 * (now.flange - wrist), now.flange, 0.075 * k, round=False),
        body(TIP, "spindle", now.flange, now.spindle, 0.065 * k),
        body(TIP, "spindle", now.spindle, now.nose - 0.055 * k * down, 0.055 * k),
        body(TIP, "cutter", now.nose, now.tip, cutter, round=False),
    ]
