"""How stiff a contact a force-controlled robot stands: stability of the admittance x' = g (F_d - F) (FACTS10 10.4).

Loop of position x over force F = k x, opened at the integrator::

    L(s) = g k / s . 1 / (1 + s / w_c) . exp(-s T) . w_0^2 / (s^2 + 2 zeta w_0 s + w_0^2)

with the force filter w_c, the transport T (its steps, and half a step for the hold) and the drive (w_0, zeta).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.optimize import brentq

MARGIN = 3.0
"""Critical gain over the one that is used (FACTS10 10.4)."""


@dataclass(frozen=True)
class ForceLoop:
    """What delays the force control."""

    drive_frequency: float = 2.0 * math.pi * 4.5
    """rad/s."""
    drive_damping: float = 0.9
    filter_frequency: float = 2.0 * math.pi * 10.0
    """rad/s."""
    step: float = 0.004
    """s."""
    transport_steps: float = 3.0

    @property
    def dead_time(self) -> float:
        """Transport and half of the hold [s]."""
        return (self.transport_steps + 0.5) * self.step

    def phase(self, w: float) -> float:
        """Phase [rad] of L at w [rad/s], unwrapped."""
        r = w / self.drive_frequency
        drive = math.atan2(2.0 * self.drive_damping * r, 1.0 - r * r)
        return -math.pi / 2.0 - math.atan(w / self.filter_frequency) - w * self.dead_time - drive

    def magnitude(self, w: float) -> float:
        """|L| [1] at w [rad/s] for g k = 1 1/s."""
        r = w / self.drive_frequency
        drive = math.hypot(1.0 - r * r, 2.0 * self.drive_damping * r)
        return 1.0 / (w * math.hypot(1.0, w / self.filter_frequency) * drive)

    @property
    def critical(self) -> float:
        """Product g k [1/s] at which the loop is on the limit of stability: 1/|L| where the phase of L passes -180 deg."""
        return 1.0 / self.magnitude(
            float(brentq(lambda w: self.phase(w) + math.pi, 1e-3 * self.drive_frequency, 10.0 * self.drive_frequency))
        )

    def gain(self, stiffness: float) -> float:
        """Admittance g [m/(N s)] with the margin `MARGIN` against contact and robot in series of `stiffness` [N/m]."""
        return self.critical / MARGIN / stiffness

    def stiffest(self, damping: float) -> float:
        """Stiffness [N/m] up to which hand guiding with `damping` [N s/m] (v = F/damping) keeps the margin."""
        return self.critical / MARGIN * damping

    def contact_damping(self, stiffness: float) -> float:
        """Damping [N s/m] that hand guiding must have in contact with `stiffness` [N/m]."""
        return stiffness * MARGIN / self.critical


def followed_slope(gain: float, desired: float, feed: float) -> float:
    """Steepest slope of the part away from the guiding chord that is followed: retreat g F_d over feed v (FACTS10 10.4)."""
    return gain * desired / feed
