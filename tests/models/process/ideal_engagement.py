"""The kernels of the milling force in an exact arc of engagement, without a workpiece."""

from __future__ import annotations

import math

import numpy as np

from robomill.models.model.declaration import FloatArray
from robomill.models.process.cutting import DENSITIES, CuttingCoefficients, EndMill, edge_density, mean_over_rotation


def ideal_force(
    coefficients: CuttingCoefficients,
    mill: EndMill,
    depth: float,
    chip: float,
    entry: float,
    exit_: float,
    theta0: float,
    theta1: float,
    bins: int = 180,
) -> FloatArray:
    """Mean of (Fx, Fy, Fa, torque, z Fx, z Fy) [N, N.m] while the cutter turns from theta0 to theta1 in an exact arc of engagement.

    Equal `bins` between entry and exit [rad]; over whole revolutions the result is the closed form for any number of bins.
    """
    bounds = np.linspace(entry, exit_, bins + 1)
    density = np.zeros((1, bins, DENSITIES))
    k = coefficients
    for b in range(bins):
        s0, c0, s1, c1 = math.sin(bounds[b]), math.cos(bounds[b]), math.sin(bounds[b + 1]), math.cos(bounds[b + 1])
        width = float(bounds[b + 1] - bounds[b])
        edge_density(s0, c0, s1, c1, width, 0.0, chip, k.Ktc, k.Krc, k.Kac, k.Kte, k.Kre, k.Kae, 0, b, density)
    out = np.zeros(8)
    mean_over_rotation(theta0, theta1, round(mill.teeth), 1, bounds, bins, mill.lag, 0.0, depth, np.full(bins, depth), density, out)
    return np.array([out[0], out[1], out[3], 0.5 * mill.diameter * out[2], out[6], out[7]])
