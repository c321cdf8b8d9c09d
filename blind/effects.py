"""What the generator may switch on: every effect parameter of the components, with the range of strengths it is drawn from.

The table is the generator's own (it does not read the catalogue of the diagnosis): an effect is known by component and
parameter name, and by these the scorer compares. Ranges: DIAGNOSIS.md; where it is silent, the pages of the components.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

EVEN = 0.5
"""Probability of one of two things that are as likely as each other."""
ARM = 3
"""Axes A1 to A3, which carry the arm; those behind them are the wrist's."""


@dataclass(frozen=True)
class Effect:
    """A catalogue effect: parameter `name` of `component`, at one element of an array (`size` elements, 0 = scalar)."""

    component: str
    name: str
    low: float
    high: float
    """Range of the magnitude in SI; the strength is log-uniform in it."""
    unit: str
    size: int = 0
    signed: bool = False
    """Whether the sign is drawn, too."""
    wrist: float = 1.0
    """Factor on the range for A4..A6."""

    def factor(self, index: int) -> float:
        """On the range, at element `index` (from 1, 0 = scalar)."""
        return self.wrist if index > ARM else 1.0


@dataclass(frozen=True)
class Instance:
    """One effect as it is switched on: element `index` (from 1, 0 = scalar) at `value`."""

    effect: Effect
    index: int
    value: float

    @property
    def parameter(self) -> str:
        """Name of the element: `stiffness_error[2]`."""
        return f"{self.effect.name}[{self.index}]" if self.index else self.effect.name

    @property
    def key(self) -> str:
        """`component.effect`."""
        return f"{self.effect.component}.{self.effect.name}"


_UM = 1e-6
EFFECTS = (
    Effect("compliance", "stiffness_error", 0.05, 0.30, "1", 6, signed=True),
    Effect("compliance", "stiffness_hardening", 0.10, 0.60, "1", 6),
    Effect("compliance", "stiffness_asymmetry", 0.05, 0.30, "1", 6, signed=True),
    Effect("compliance", "gear_hysteresis", 20e-6, 150e-6, "rad", 6),
    Effect("compliance", "gear_friction", 10.0, 60.0, "N.m", 6, wrist=0.3),
    Effect("compliance", "tilt_compliance", 2e-8, 1e-7, "rad/(N.m)", 6, wrist=5.0),
    Effect("compliance", "base_compliance", 0.02 * _UM, 0.15 * _UM, "m/N", 3),
    Effect("compliance", "tool_compliance", 0.1 * _UM, 0.6 * _UM, "m/N"),
    Effect("compliance", "payload_error", 3.0, 25.0, "kg"),
    Effect("compliance", "counterbalance_error", 0.02, 0.10, "1", signed=True),
    Effect("compliance", "thermal_growth", 30e-6, 300e-6, "m"),
    Effect("compliance", "mode_compliance", 0.05 * _UM, 0.5 * _UM, "m/N"),
    Effect("drive", "backlash", 20e-6, 150e-6, "rad", 6),
    Effect("drive", "transmission_error", 15e-6, 80e-6, "rad", 6),
    Effect("drive", "joint_offset", 50e-6, 400e-6, "rad", 6, signed=True),
    Effect("drive", "geometry_error", 100e-6, 800e-6, "m", 2, signed=True),
    Effect("drive", "tracking_lag", 2e-3, 20e-3, "s"),
    Effect("drive", "reversal_friction", 20e-6, 150e-6, "rad", 6),
    Effect("drive", "friction_viscous", 200.0, 3000.0, "N.m.s/rad", 6, wrist=0.3),
    Effect("drive", "friction_coulomb", 50.0, 500.0, "N.m", 6, wrist=0.3),
    Effect("drive", "friction_stribeck", 50.0, 400.0, "N.m", 6, wrist=0.3),
    Effect("sensor", "sensor_gain_error", 0.03, 0.15, "1", signed=True),
    Effect("sensor", "sensor_gain_error_axis", 0.03, 0.15, "1", 6, signed=True),
    Effect("sensor", "cross_talk", 0.01, 0.05, "1", signed=True),
    Effect("sensor", "zero_drift", 3.0, 25.0, "N", 3, signed=True),
    Effect("sensor", "misalignment", 0.0175, 0.105, "rad", 3, signed=True),
    Effect("sensor", "extra_lag", 20e-3, 120e-3, "s"),
    Effect("sensor", "weight_error", 0.3, 3.0, "kg"),
    Effect("sensor", "inertia", 0.2, 1.0, "1"),
    Effect("sensor", "hose_force", 5.0, 40.0, "N"),
    Effect("sensor", "clipping", 0.75, 0.9, "1"),
    Effect("sensor", "cutoff_error", 0.15, 0.6, "1", signed=True),
    Effect("controller", "extra_delay", 20e-3, 120e-3, "s"),
    Effect("controller", "dead_band", 10.0, 60.0, "N"),
    Effect("controller", "correction_limit", 0.9, 0.97, "1"),
    Effect("controller", "stiffness_table_error", 0.10, 0.50, "1", 6, signed=True),
    Effect("controller", "frame_error", 0.035, 0.35, "rad", 3, signed=True),
    Effect("controller", "lost_packets", 0.1, 0.6, "1"),
    Effect("milling", "cutting_coefficient_error", 0.05, 0.30, "1", signed=True),
    Effect("milling", "tool_wear", 0.10, 0.60, "1"),
    Effect("milling", "size_effect_exponent", 0.05, 0.25, "1"),
    Effect("milling", "runout", 5e-6, 40e-6, "m"),
    Effect("milling", "stock_error", 0.1e-3, 0.8e-3, "m"),
    Effect("milling", "engagement_error", 0.2e-3, 2e-3, "m", signed=True),
    Effect("milling", "workpiece_compliance", 0.02 * _UM, 0.2 * _UM, "m/N"),
)
"""All of them; the withheld effect of a single case goes through this list in a random order, again and again."""

BY_KEY = {f"{e.component}.{e.name}": e for e in EFFECTS}


def draw(effect: Effect, random: np.random.Generator, index: int | None = None) -> Instance:
    """An instance: element uniform where it is not given, magnitude log-uniform over the range, sign even where the effect has one."""
    if index is None:
        index = int(random.integers(1, effect.size + 1)) if effect.size else 0
    value = effect.factor(index) * effect.low * (effect.high / effect.low) ** random.random()
    if effect.signed and random.random() < EVEN:
        value = -value
    return Instance(effect, index, float(value))
