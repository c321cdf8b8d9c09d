"""Effects that no entry of the catalogue expresses, written for the second generator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from robomill.blind.second.cell import Cell
from robomill.blind.second.kernel import FloatArray


@dataclass(frozen=True)
class Outside:
    """One kind: the component that it is in (None: no one), its range, and what it does to the cell."""

    name: str
    component: str | None
    low: float
    high: float
    unit: str
    part: str
    number: str
    joints: int = 0
    """How many joints it may be in; 0: it is in none."""
    text: str = ""

    def draw(self, random: np.random.Generator) -> tuple[float, Callable[[Cell], Cell]]:
        """Strength, log-uniform, and the change of the cell."""
        value = float(self.low * (self.high / self.low) ** random.random())
        joint = int(random.integers(max(self.joints, 1)))
        other = (joint + int(random.integers(1, 6))) % 6

        def change(c: Cell) -> Cell:
            group = getattr(c, self.part)
            old = getattr(group, self.number)
            new: float | FloatArray = value
            if isinstance(old, np.ndarray):
                place = (joint, other) if old.ndim == 2 else (joint,)
                new = old + value * (np.indices(old.shape) == np.reshape(place, (-1, *[1] * old.ndim))).all(axis=0)
            return c._replace(**{self.part: group._replace(**{self.number: new})})

        return value, change


OUTSIDE = (
    Outside("lobed_gear", "compliance", 2e-7, 1e-6, "rad/(N.m)", "flexure", "lobed", 3, "compliance periodic in the angle of the joint"),
    Outside("two_stage_creep", "compliance", 2e-7, 1e-6, "rad/(N.m)", "flexure", "creep", 3, "deflection that grows on, fast and slowly"),
    Outside("stiction", "compliance", 30.0, 150.0, "N.m", "flexure", "stiction", 3, "a joint that gives way beyond a torque only"),
    Outside("shaking_floor", None, 20e-6, 120e-6, "m", "flexure", "floor", 0, "a sinusoid of the whole robot"),
    Outside("dragged_axis", "drive", 2e-4, 2e-3, "1", "drive", "coupling", 6, "an axis that moves with another one"),
    Outside("root_windup", "drive", 1e-4, 1e-3, "rad(s/rad)^0.5", "drive", "windup", 6, "behind with the root of the speed"),
    Outside("reversal_ringing", "drive", 50e-6, 300e-6, "rad", "drive", "ringing", 6, "a decaying oscillation after a reversal"),
    Outside("cogging", "drive", 0.2, 1.5, "N.m", "dynamics", "cogging", 6, "motor torque periodic in the rotor angle"),
    Outside("load_friction", "drive", 0.03, 0.15, "1", "dynamics", "load_friction", 6, "friction that grows with the torque"),
    Outside("warming_sensor", "sensor", 0.05, 0.25, "1", "sensor", "warming", 0, "a gain that grows during the run"),
    Outside("bowed_sensor", "sensor", 0.2, 1.0, "1/kN", "sensor", "bow", 0, "a reading that falls short of large forces"),
    Outside("sensor_play", "sensor", 5.0, 30.0, "N", "sensor", "play", 0, "mechanical hysteresis of the sensor"),
    Outside("grain", "milling", 0.08, 0.35, "1", "cut", "grain", 0, "force that depends on the direction in the material"),
    Outside("packing", "milling", 0.05, 0.3, "1/s", "cut", "packing", 0, "force that grows with the time in the cut"),
    Outside("spindle_droop", "milling", 0.02, 0.10, "1/(N.m)", "cut", "droop", 0, "a spindle that slows down under torque"),
    Outside("greedy_controller", "controller", 200.0, 1000.0, "1/m", "control", "greed", 0, "a correction that grows with its square"),
)
"""Sixteen kinds."""

OUTSIDE_BY_NAME: Mapping[str, Outside] = {o.name: o for o in OUTSIDE}
FORMED = tuple(OUTSIDE_BY_NAME[name] for name in ("dragged_axis", "root_windup", "cogging", "load_friction", "bowed_sensor"))
"""Five kinds that a short formula expresses: those of the set `formed`."""
