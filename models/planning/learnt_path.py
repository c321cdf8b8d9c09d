"""From a recorded contact motion to a program: filtered, corrected, reduced, written as RAPID and as G-code.

Pan et al. 2008 (paper 003), section 3.3: force threshold filtering and the deviation height method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from robomill.models.model.declaration import FloatArray
from robomill.models.planning.point_path import PathPoint, PointPath

THRESHOLDS = (0.3, 2.5)
"""Least and largest contact force of a point that is kept, over the desired force (FACTS10 10.4)."""
DEVIATION_HEIGHT = 2e-4
"""m; paper 003, section 3.4."""
_UP = 1e-12
"""Length [m] below which two points are one."""


class LearntPathError(ValueError):
    """A record that no path can be made of."""


@dataclass(frozen=True)
class LearntPath:
    """Points that the tool tip went through, in order."""

    position: FloatArray
    """(n, 3) m in the part frame P."""
    quaternion: FloatArray
    """(n, 4) orientation of the tool in P, (w, x, y, z)."""

    def __len__(self) -> int:
        """Number of points."""
        return len(self.position)


def learn(
    position: FloatArray,
    quaternion: FloatArray,
    force: FloatArray,
    normal_force: FloatArray,
    desired: float,
    stiffness: float = math.inf,
    samples: int = 1,
) -> LearntPath:
    """Points of a record that were taken in contact, freed of what the stylus gave way.

    `position` (n, 3) m, `quaternion` (n, 4) and `force` (n, 3) N on the tool, in one frame; `normal_force` (n,) N against the approach,
    by whose ratio to `desired` [N] points are kept (`THRESHOLDS`); p + F/k with the `stiffness` k [N/m] of all that gives way
    (infinite: no correction), averaged over `samples`, an odd number, within each stretch without gaps; shorter stretches, in
    which contact flickers, are left out. LearntPathError if nothing is left.
    """
    low, high = (factor * desired for factor in THRESHOLDS)
    kept = (normal_force > low) & (normal_force < high)
    if np.count_nonzero(kept) < 2:
        raise LearntPathError(
            f"the record has {np.count_nonzero(kept)} points with a contact force between {low:g} and {high:g} N, expected at least 2 of "
            f"{len(position)}; largest force {float(np.max(normal_force, initial=0.0)):.3g} N: the part was not touched, or far too hard"
        )
    index = np.flatnonzero(kept)
    stretches = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
    long = [i for i in stretches if len(i) >= samples]
    if not long:
        raise LearntPathError(
            f"the longest stretch of the record with a contact force between {low:g} and {high:g} N has {max(map(len, stretches))} points, "
            f"expected at least {samples}, over which they are averaged: contact was lost again and again"
        )
    edge = samples // 4  # at the ends of a stretch the mean is of few points, and of those in which contact was got or lost
    corrected = position + force / stiffness
    inner = np.concatenate([i[edge : len(i) - edge] for i in long])
    return LearntPath(np.vstack([smoothed(corrected[i], samples)[edge : len(i) - edge] for i in long]), quaternion[inner])


def smoothed(points: FloatArray, samples: int) -> FloatArray:
    """Moving average (n, 3) m of the `points` over an odd number of `samples`, centred, shorter towards the ends."""
    n = len(points)
    index = np.arange(n)
    width = np.minimum(np.minimum(index, n - 1 - index), samples // 2)
    total = np.vstack([np.zeros(points.shape[1]), np.cumsum(points - points[0], axis=0)])
    mean: FloatArray = points[0] + (total[index + width + 1] - total[index - width]) / (2 * width + 1)[:, None]
    return mean


def reduced(path: LearntPath, height: float = DEVIATION_HEIGHT) -> LearntPath:
    """The points that straight lines between them need to come within `height` [m] of all the others: deviation height method.

    Greedy, as in the paper: from a starting point on the current one moves along until a point between them is further than `height` from
    the chord; the one before it is kept and starts the next.
    """
    kept = reduce(path.position, height)
    return LearntPath(path.position[kept], path.quaternion[kept])


def reduce(points: FloatArray, height: float) -> list[int]:
    """Indices of the `points` (n, d) [m] that the deviation height method keeps."""
    kept, start = [0], 0
    while start < len(points) - 1:
        start = _reach(points, start, height)
        kept.append(start)
    return kept


def _reach(points: FloatArray, start: int, height: float) -> int:
    """The last index that the chord from `start` may go to: the one before the first whose chord leaves a point further than `height`."""
    end = start + 2
    while end < len(points):
        chord = points[end] - points[start]
        between = points[start + 1 : end] - points[start]
        length = math.sqrt(float(chord @ chord))
        if length < _UP:
            away = np.sqrt((between**2).sum(axis=1))
        else:
            along = between @ chord / length
            away = np.sqrt(np.maximum((between**2).sum(axis=1) - along**2, 0.0))
        if float(away.max()) > height:
            return end - 1
        end += 1
    return len(points) - 1


def points_needed(points: FloatArray, height: float = DEVIATION_HEIGHT) -> float:
    """Number N of chords of deviation height h that a smooth curve needs: N = integral sqrt(|kappa| / (8 h)) ds.

    `points` (n, 2 or 3) m, close together; the curvature kappa is that of the circle through neighbours.
    """
    before, after = np.diff(points[:-1], axis=0), np.diff(points[1:], axis=0)
    a, b = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
    c = np.linalg.norm(before + after, axis=1)
    cosine = np.clip(np.einsum("ij,ij->i", before, after) / (a * b), -1.0, 1.0)
    curvature = 2.0 * np.sqrt(1.0 - cosine**2) / c
    return float(np.sum(np.sqrt(curvature / (8.0 * height)) * 0.5 * (a + b)))


def point_path(path: LearntPath, name: str, feed: float, upright: FloatArray, blend: float = 0.0) -> PointPath:
    """Path of points for the planner; `feed` [m/s], `blend` [m], `upright` (3, 3) the orientation of the upright tool in P."""
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_matrix(upright).inv() * Rotation.from_quat(np.roll(path.quaternion, -1, axis=1))
    points = tuple(
        PathPoint((float(p[0]), float(p[1]), float(p[2])), (float(r[0]), float(r[1]), float(r[2])), blend, feed, 0.0)
        for p, r in zip(path.position, turned.as_euler("ZYX"), strict=True)
    )
    return PointPath(name, points, "path", tuple(f"point {i}" for i in range(1, len(points) + 1)))


def rapid(path: LearntPath, name: str, feed: float, zone: str = "z0") -> str:
    r"""A RAPID module (ABB IRC5) with one MoveL per point: positions in mm and orientations as quaternions in the work object `part`.

    `feed` [m/s]; the axis configuration is the one that is nearest (ConfL \Off).
    """
    if not name.isidentifier():
        raise LearntPathError(f"name of the program: {name!r}; expected letters, digits and underscores, no digit first")
    lines = [
        f"MODULE {name}",
        "  ! learnt path: positions in mm, orientations (q1, q2, q3, q4) in the work object",
        "  PERS tooldata stylus := [TRUE, [[0, 0, 0], [1, 0, 0, 0]], [1, [0, 0, 1], [1, 0, 0, 0], 0, 0, 0]];",
        '  TASK PERS wobjdata part := [FALSE, TRUE, "", [[0, 0, 0], [1, 0, 0, 0]], [[0, 0, 0], [1, 0, 0, 0]]];',
        f"  CONST speeddata feed := [{1e3 * feed:.10g}, 500, 5000, 1000];",
        f"  PROC {name}_path()",
        "    ConfL \\Off;",
    ]
    for p, q in zip(1e3 * path.position, path.quaternion, strict=True):
        place = ", ".join(f"{x:.4f}" for x in p)
        turn = ", ".join(f"{x:.8f}" for x in q)
        lines.append(f"    MoveL [[{place}], [{turn}], [0, 0, 0, 0], [9E9, 9E9, 9E9, 9E9, 9E9, 9E9]], feed, {zone}, stylus \\WObj:=part;")
    return "\n".join([*lines, "  ENDPROC", "ENDMODULE", ""])


def gcode(path: LearntPath, feed: float, tolerance: float = 0.0) -> str:
    """The positions as G-code in P: G1 in mm, `feed` [m/s], G64 P `tolerance` [m] where it is given.

    Three axes only: LearntPathError if the orientation changes along the path, which RAPID and paths of points can say.
    """
    turn = np.abs(np.abs(path.quaternion @ path.quaternion[0]) - 1.0).max()
    if turn > _SAME_TURN:
        angle = math.degrees(2.0 * math.acos(1.0 - float(turn)))
        raise LearntPathError(f"the orientation turns by {angle:.3g} deg along the path; G-code of three axes cannot say that: write RAPID")
    lines = ["G21 G90 G17", f"G64 P{1e3 * tolerance:.4f}" if tolerance > 0.0 else "G61"]
    for i, p in enumerate(1e3 * path.position):
        x, y, z = (f"{v:.4f}" for v in p)
        lines.append(f"G0 X{x} Y{y} Z{z}" if i == 0 else f"G1 X{x} Y{y} Z{z}" + (f" F{6e4 * feed:.6g}" if i == 1 else ""))
    return "\n".join([*lines, "M30", ""])


_SAME_TURN = 1e-6
"""1 - cos(angle/2) up to which two orientations are one: 0.16 deg, above the noise of encoders and far below what cutting shows."""


def guiding_orientations(path: LearntPath, guiding: LearntPath) -> LearntPath:
    """The path with the orientations of the guiding points, which are kept in the final program (paper 003, section 3.1).

    Between two guiding points the orientation turns evenly with the way along the chord; a point belongs to the nearest chord.
    """
    from scipy.spatial.transform import Rotation, Slerp

    chords = np.diff(guiding.position, axis=0)
    length = np.linalg.norm(chords, axis=1)
    along = np.concatenate([[0.0], np.cumsum(length)])
    turns = Slerp(along, Rotation.from_quat(np.roll(guiding.quaternion, -1, axis=1)))
    away = path.position[:, None, :] - guiding.position[None, :-1, :]
    share = np.clip((away * chords).sum(axis=2) / length**2, 0.0, 1.0)
    nearest = np.argmin(np.linalg.norm(away - share[:, :, None] * chords, axis=2), axis=1)
    at = along[nearest] + share[np.arange(len(path)), nearest] * length[nearest]
    quaternion = np.roll(turns(np.minimum(at, along[-1])).as_quat(canonical=True), 1, axis=1)
    return replace(path, quaternion=quaternion)
