"""Where a cutter was, sample by sample: its tip and axis in the frame P of the workpiece, and the radius of the tool in the spindle.

P: origin at the centre of the block's top surface, z up. Lengths in m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from robomill.models.maths.frames import quat_to_matrix
from robomill.models.model.declaration import FloatArray


@dataclass(frozen=True)
class ToolPath:
    """Time [s] (n,), tip in P [m] (n, 3), tilt (n, 2) = x and y of the unit vector from tip to spindle in P, radius [m] (n,)."""

    time: FloatArray
    position: FloatArray
    tilt: FloatArray
    radius: FloatArray

    def __post_init__(self) -> None:
        """Refuse paths that do not fit together."""
        n = len(self.time)
        if self.time.shape != (n,) or self.position.shape != (n, 3) or self.tilt.shape != (n, 2) or self.radius.shape != (n,):
            raise ValueError(
                f"tool path: time {self.time.shape}, position {self.position.shape}, tilt {self.tilt.shape}, radius {self.radius.shape}; "
                "expected (n,), (n, 3), (n, 2), (n,)"
            )
        if n < 2:
            raise ValueError(f"tool path: {n} positions; at least 2 are needed")
        for name in ("time", "position", "tilt", "radius"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise ValueError(f"tool path: {name} holds values that are not finite")
        if not np.all(self.radius > 0.0):
            raise ValueError(f"tool path: radius {self.radius.min()} m; expected more than 0")

    @classmethod
    def upright(cls, time: npt.ArrayLike, position: npt.ArrayLike, radius: npt.ArrayLike) -> ToolPath:
        """A path with the tool axis along z of P; `radius` [m] is one number or one per sample."""
        p = np.ascontiguousarray(position, dtype=np.float64)
        return cls(np.ascontiguousarray(time, dtype=np.float64), p, np.zeros((len(p), 2)), _column(radius, len(p)))

    @classmethod
    def from_poses(
        cls,
        time: npt.ArrayLike,
        p_BT_B: npt.ArrayLike,
        quat_BT: npt.ArrayLike,
        p_BP_B: npt.ArrayLike,
        quat_BP: npt.ArrayLike,
        radius: npt.ArrayLike,
    ) -> ToolPath:
        """From tool poses in B (n, 3), (n, 4) and the pose of the workpiece in B; x of T points out of the spindle."""
        R_BP = np.empty((3, 3))
        quat_to_matrix(np.asarray(quat_BP, dtype=np.float64), R_BP)
        position = (np.asarray(p_BT_B, dtype=np.float64) - np.asarray(p_BP_B, dtype=np.float64)) @ R_BP
        w, x, y, z = np.asarray(quat_BT, dtype=np.float64).T
        axis = np.column_stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]) @ R_BP
        tilt = np.ascontiguousarray(-axis[:, :2])
        return cls(np.ascontiguousarray(time, dtype=np.float64), np.ascontiguousarray(position), tilt, _column(radius, len(position)))


def _column(radius: npt.ArrayLike, n: int) -> FloatArray:
    return np.ascontiguousarray(
        np.broadcast_to(np.asarray(radius, dtype=np.float64), (n,)) if np.ndim(radius) == 0 else radius, dtype=np.float64
    )
