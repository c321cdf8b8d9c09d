"""Modes of a structure as the cutting force sees them: frequency, damping and mass-normalised shape at the tool tip.

A force f [N] at the tool tip moves it by u [m]:

    q_i'' + 2 zeta_i w_i q_i' + w_i^2 q_i = s_i . f,    u = sum_i s_i q_i,    w_i = 2 pi frequency_i.

In the frequency domain u = H f with the receptance H = sum_i s_i s_i^T / (w_i^2 - w^2 + 2 j zeta_i w_i w)
(Altintas, "Manufacturing Automation", ch. 3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import load, quantity

ComplexArray = npt.NDArray[np.complex128]
TWO_PI = 2.0 * math.pi
AXES = 3


@dataclass(frozen=True)
class Modes:
    """n modes: frequency (n,) [Hz], damping (n,) [1], shape (3, n) [1/sqrt(kg)] in the axes of one frame."""

    frequency: FloatArray
    damping: FloatArray
    shape: FloatArray

    def __post_init__(self) -> None:
        """ValueError says which of the three does not fit."""
        n = len(self.frequency)
        if self.frequency.shape != (n,) or self.damping.shape != (n,) or self.shape.shape != (AXES, n):
            raise ValueError(
                f"modes: frequency {self.frequency.shape}, damping {self.damping.shape} and shape {self.shape.shape}; "
                "expected (n,), (n,) and (3, n)"
            )
        if not (np.all(self.frequency > 0.0) and np.all(self.damping >= 0.0) and np.all(np.isfinite(self.shape))):
            raise ValueError(
                f"modes: frequencies {self.frequency} Hz must be positive, dampings {self.damping} zero or more, shapes finite; "
                "correct the mode"
            )

    @property
    def circular(self) -> FloatArray:
        """Circular frequencies w (n,) [rad/s]."""
        return TWO_PI * self.frequency

    @property
    def compliance(self) -> FloatArray:
        """Static compliance (3, 3) [m/N]: the receptance at zero frequency."""
        return (self.shape / self.circular**2) @ self.shape.T

    def turned(self, R: FloatArray) -> Modes:
        """The modes in other axes: R (3, 3) takes components of this frame into those of the other."""
        return Modes(self.frequency, self.damping, R @ self.shape)

    def __add__(self, other: Modes) -> Modes:
        """Modes of two structures in series, as a tool in a spindle on a robot; both shapes in the same axes."""
        return Modes(
            np.concatenate([self.frequency, other.frequency]),
            np.concatenate([self.damping, other.damping]),
            np.hstack([self.shape, other.shape]),
        )


@dataclass(frozen=True)
class ModeFile:
    """A file of models/data/modes: one entry per mode."""

    name: str
    """Name for people."""
    frequency: FloatArray = field(metadata=quantity("Hz", 0.0))
    """Natural frequency of each mode."""
    damping: FloatArray = field(metadata=quantity("1", 0.0, 1.0))
    """Damping ratio of each mode."""
    stiffness: FloatArray = field(metadata=quantity("N/m", 0.0))
    """Modal stiffness of each mode."""
    direction: FloatArray = field(metadata=quantity("1", -1.0, 1.0))
    """Direction of each mode in the tool frame: x, y, z."""


def load_modes(name: str | Path) -> Modes:
    """Modes from a file, or from a name below models/data/modes; shapes in T (x = tool axis out of the spindle).

    ValueError names file, field, what was found and what is expected.
    """
    path = Path(name)
    found = load(ModeFile, path if path.suffix == ".toml" else f"modes/{name}")
    n = len(found.frequency)
    if found.damping.shape != (n,) or found.stiffness.shape != (n,) or found.direction.shape != (n, AXES):
        raise ValueError(
            f"{path.name}: {n} frequencies, {len(found.damping)} dampings, {len(found.stiffness)} stiffnesses, "
            f"directions {found.direction.shape}; expected one of each per mode, a direction being x, y, z"
        )
    return from_stiffness(found.frequency, found.damping, found.stiffness, found.direction)


def from_stiffness(
    frequency: Sequence[float] | FloatArray,
    damping: Sequence[float] | FloatArray,
    stiffness: Sequence[float] | FloatArray,
    direction: Sequence[Sequence[float]] | FloatArray,
) -> Modes:
    """Modes from modal stiffness [N/m] along a direction (n, 3): shape = direction/|direction| w/sqrt(k), as w^2 = k/m.

    ValueError for a stiffness that is not positive or a direction without length.
    """
    f, k, d = np.asarray(frequency, float), np.asarray(stiffness, float), np.asarray(direction, float)
    length = np.linalg.norm(d, axis=1)
    if not (np.all(k > 0.0) and np.all(length > 0.0)):
        raise ValueError(f"modes: stiffnesses {k} N/m and lengths of directions {length} must be positive; correct the mode")
    shape = (d / length[:, None] * (TWO_PI * f / np.sqrt(k))[:, None]).T
    return Modes(f, np.asarray(damping, float), shape)


def receptance(modes: Modes, frequencies_hz: FloatArray) -> ComplexArray:
    """Receptance H (nf, 3, 3) [m/N] at the tool tip: displacement per force, at frequencies (nf,) [Hz]."""
    w, wi = TWO_PI * np.asarray(frequencies_hz, float)[:, None], modes.circular[None, :]
    gain = 1.0 / (wi**2 - w**2 + 2j * modes.damping * wi * w)
    found: ComplexArray = np.einsum("in,fn,jn->fij", modes.shape, gain, modes.shape)
    return found


def frequency_grid(modes: Modes, points: int = 160, highest: float = 1.6) -> FloatArray:
    """Frequencies [Hz] for lobes, (m,): dense about each mode, where the phase turns, up to `highest` times the last mode.

    About a mode they stand at f (1 + zeta sinh(x)), so that points per half width of its peak do not depend on its damping.
    """
    x = np.linspace(-7.0, 7.0, points)
    about = [f * (1.0 + max(z, 1e-3) * np.sinh(x)) for f, z in zip(modes.frequency, modes.damping, strict=True)]
    low, high = 0.3 * modes.frequency.min(), highest * modes.frequency.max()
    grid = np.concatenate([*about, np.geomspace(low, high, 10 * points)])
    return np.unique(grid[(grid >= low) & (grid <= high)])
