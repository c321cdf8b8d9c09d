"""Mechanistic milling forces: chip, edge and helix of an end mill, and their closed-form means.

Convention (Altintas, "Manufacturing Automation", ch. 2; FACTS 3.2). The cutting frame has x along the feed, z from
the work towards the spindle, y = z x x to the left of the feed. The immersion angle phi of an edge runs clockwise
from +y seen from the spindle (spindle M3), so the edge is at n = (sin phi, cos phi) and cuts where sin phi > 0. Per
length of edge, with chip thickness h, the force ON the tool is

    Ft = Ktc h + Kte   against the cutting velocity (cos phi, -sin phi)
    Fr = Krc h + Kre   against n
    Fa = Kac h + Kae   along the tool axis OUT of the spindle: a right-hand helix pulls the tool into the work

    Fx = -Ft cos(phi) - Fr sin(phi),  Fy = Ft sin(phi) - Fr cos(phi).

The edge lags by psi(z) = kappa z, kappa = 2 tan(helix)/D. There are no axial layers: the length of the helical edge
within an interval of phi, and its mean over an interval of rotation, have closed forms (`edge_length`, `passed`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from robomill.models.maths.elementary import cos
from robomill.models.model.declaration import FloatArray, kernel
from robomill.models.model.parameters import quantity

PI = math.pi
TWO_PI = 2.0 * math.pi
MAX_TEETH = 12
LEAST_LAG = 1e-6
"""Smallest helix lag [rad/m]: a straight edge is a helix of 1e-6 rad/m (1e-8 rad over 10 mm), which keeps the formulas regular."""

DENSITIES = 6
"""Force density of an edge: Fx, Fy [N/m], Ft, Fa [N/m], Fa sin(phi), Fa cos(phi) [N/m]; see `edge_density`."""


@dataclass(frozen=True)
class CuttingCoefficients:
    """Cutting coefficients [Pa] and edge coefficients [N/m] of a material and tool pairing (models/data/materials)."""

    Ktc: float = field(metadata=quantity("Pa", 0.0))
    """Tangential cutting coefficient: force per area of chip."""
    Krc: float = field(metadata=quantity("Pa", 0.0))
    """Radial cutting coefficient."""
    Kac: float = field(metadata=quantity("Pa", 0.0))
    """Axial cutting coefficient."""
    Kte: float = field(metadata=quantity("N/m", 0.0))
    """Tangential edge coefficient: force per length of edge in the cut."""
    Kre: float = field(metadata=quantity("N/m", 0.0))
    """Radial edge coefficient."""
    Kae: float = field(metadata=quantity("N/m", 0.0))
    """Axial edge coefficient."""


@dataclass(frozen=True)
class EndMill:
    """A flat end mill (models/data/tools): diameter [m], number of teeth, helix angle [rad], length of the cutting edges [m]."""

    diameter: float = field(metadata=quantity("m", 1e-4))
    """Diameter."""
    teeth: float = field(metadata=quantity("1", 1.0, MAX_TEETH))
    """Number of teeth."""
    helix: float = field(metadata=quantity("rad", 0.0, 1.2))
    """Helix angle."""
    cutting_length: float = field(metadata=quantity("m", 0.0))
    """Length of the cutting edges."""

    @property
    def lag(self) -> float:
        """Lag angle of the edge per height above the tip [rad/m]: kappa = 2 tan(helix)/D."""
        return max(2.0 * math.tan(self.helix) / self.diameter, LEAST_LAG)


@dataclass(frozen=True)
class CutResolution:
    """How milling_force looks at the cut (models/data/process); the fields are parameters of that component."""

    spacing: float = field(metadata=quantity("m", 1e-5))
    substeps: float = field(metadata=quantity("1", 1.0))
    edge_onset: float = field(metadata=quantity("m", 0.0))
    bottom_edge: float = field(metadata=quantity("1", 0.0, 1.0))
    contact_zone: float = field(metadata=quantity("m", 1e-6))
    contact_time: float = field(metadata=quantity("s", 0.0))
    size_reference: float = field(metadata=quantity("m", 1e-7))


# ---------------------------------------------------------------- closed forms (analysis, identification, tests)
def immersion(diameter: float, width: float, mode: str) -> tuple[float, float]:
    """Entry and exit angle [rad] for a radial width of cut [m]; mode "slot", "up" or "down" (FACTS 3.2).

    ValueError for an unknown mode or a width outside (0, diameter].
    """
    if mode == "slot":
        return 0.0, PI
    if mode not in ("up", "down"):
        raise ValueError(f"unknown mode {mode!r}; there are 'slot', 'up', 'down'")
    if not 0.0 < width <= diameter:
        raise ValueError(f"radial width {width} m is outside (0, {diameter}] m, the diameter of the cutter")
    angle = math.acos(1.0 - 2.0 * width / diameter)
    return (0.0, angle) if mode == "up" else (PI - angle, PI)


def mean_force(
    coefficients: CuttingCoefficients, teeth: float, depth: float, chip: float, entry: float, exit_: float
) -> tuple[float, float, float]:
    """Mean force over a revolution (Fx, Fy, Fa) [N] for depth [m], feed per tooth [m], entry and exit angle [rad].

    Altintas, mean milling forces; FACTS 3.2. Helix and diameter drop out.
    """
    k = coefficients
    a = teeth * depth

    def x(phi: float) -> float:
        cutting = k.Ktc * math.cos(2 * phi) - k.Krc * (2 * phi - math.sin(2 * phi))
        return a * chip / (8 * PI) * cutting + a / TWO_PI * (-k.Kte * math.sin(phi) + k.Kre * math.cos(phi))

    def y(phi: float) -> float:
        cutting = k.Ktc * (2 * phi - math.sin(2 * phi)) + k.Krc * math.cos(2 * phi)
        return a * chip / (8 * PI) * cutting - a / TWO_PI * (k.Kte * math.cos(phi) + k.Kre * math.sin(phi))

    def axial(phi: float) -> float:
        return a / TWO_PI * (-k.Kac * chip * math.cos(phi) + k.Kae * phi)

    return x(exit_) - x(entry), y(exit_) - y(entry), axial(exit_) - axial(entry)


def mean_torque(
    coefficients: CuttingCoefficients, diameter: float, teeth: float, depth: float, chip: float, entry: float, exit_: float
) -> float:
    """Mean spindle torque [N.m]: D/2 times the mean tangential force, arguments as `mean_force`."""
    cutting = coefficients.Ktc * chip * (math.cos(entry) - math.cos(exit_))
    return 0.5 * diameter * teeth * depth / TWO_PI * (cutting + coefficients.Kte * (exit_ - entry))


def slot_force(coefficients: CuttingCoefficients, teeth: float, depth: float, chip: float) -> tuple[float, float, float]:
    """Mean force of a full slot (Fx, Fy, Fa) [N]; linear in the feed per tooth (FACTS 3.2)."""
    k, a = coefficients, teeth * depth
    return (
        -a / 4 * k.Krc * chip - a / PI * k.Kre,
        a / 4 * k.Ktc * chip + a / PI * k.Kte,
        a / PI * k.Kac * chip + a / 2 * k.Kae,
    )


def coefficients_from_slots(chips: Sequence[float], forces: FloatArray, teeth: float, depth: float) -> CuttingCoefficients:
    """Cutting coefficients from mean forces (n, 3) [N] (Fx, Fy, Fa) of slots at n >= 2 feeds per tooth [m]: `slot_force` inverted.

    Least squares per direction. ValueError if the feeds do not differ or a coefficient comes out negative.
    """
    c, f = np.asarray(chips, dtype=np.float64), np.asarray(forces, dtype=np.float64)
    if c.ndim != 1 or f.shape != (len(c), 3) or len(np.unique(c)) < 2:
        raise ValueError(
            f"slots: {c.shape} feeds and forces of shape {f.shape}; expected (n,) with two different feeds or more, and (n, 3)"
        )
    solution = np.linalg.lstsq(np.column_stack([c, np.ones_like(c)]), f, rcond=None)[0]
    a = teeth * depth
    (x1, y1, z1), (x0, y0, z0) = solution
    values = {
        "Ktc": 4 * y1 / a,
        "Krc": -4 * x1 / a,
        "Kac": PI * z1 / a,
        "Kte": PI * y0 / a,
        "Kre": -PI * x0 / a,
        "Kae": 2 * z0 / a,
    }
    negative = sorted(name for name, value in values.items() if value < 0.0)
    if negative:
        raise ValueError(f"slots: {', '.join(negative)} came out negative; check the signs of the forces (on the tool, x along the feed)")
    return CuttingCoefficients(**{name: float(value) for name, value in values.items()})


# ---------------------------------------------------------------- kernels
@kernel
def tooth_radii(teeth: int, runout: float, angle: float, radii: FloatArray) -> None:
    """Deviation of the radius of each tooth [m] of a cutter off centre by `runout` [m] towards `angle` [rad] from tooth 0."""
    for j in range(teeth):
        radii[j] = runout * cos(angle + TWO_PI * j / teeth)


@kernel
def chip_law(tooth: int, teeth: int, chip: float, sine: float, radii: FloatArray) -> tuple[float, float]:
    """(A, B) [m] of the chip thickness h = A + B sin(phi) of a tooth near an angle of that sine.

    Each tooth cuts what those before it left: h = min over m = 1..N of (m c sin(phi) + r_j - r_(j-m)) (Kline & DeVor
    1983); the minimum carries what a short tooth left over to the next one. May be negative: no chip.
    """
    least = chip * sine + radii[tooth] - radii[(tooth - 1) % teeth]
    a = radii[tooth] - radii[(tooth - 1) % teeth]
    b = chip
    for m in range(2, teeth + 1):
        difference = radii[tooth] - radii[(tooth - m) % teeth]
        h = m * chip * sine + difference
        if h < least:
            least = h
            a = difference
            b = m * chip
    return a, b


@kernel
def edge_density(
    s0: float,
    c0: float,
    s1: float,
    c1: float,
    width: float,
    a: float,
    b: float,
    Ktc: float,
    Krc: float,
    Kac: float,
    Kte: float,
    Kre: float,
    Kae: float,
    table: int,
    bin_: int,
    out: FloatArray,
) -> None:
    """Mean force per length of edge [N/m] over the interval phi0..phi1 for h = a + b sin(phi): exact integrals / width.

    s0, c0, s1, c1 are sine and cosine of the ends, `width` = phi1 - phi0 [rad]. out[table, bin] = Fx, Fy, Ft, Fa,
    Fa sin(phi), Fa cos(phi).
    """
    sin1 = (c0 - c1) / width
    cos1 = (s1 - s0) / width
    sin_cos = 0.5 * (s1 * s1 - s0 * s0) / width
    sin2 = 0.5 * (1.0 - (s1 * c1 - s0 * c0) / width)
    at, bt = Ktc * a + Kte, Ktc * b
    ar, br = Krc * a + Kre, Krc * b
    aa, ba = Kac * a + Kae, Kac * b
    out[table, bin_, 0] = -(at * cos1 + bt * sin_cos) - (ar * sin1 + br * sin2)
    out[table, bin_, 1] = (at * sin1 + bt * sin2) - (ar * cos1 + br * sin_cos)
    out[table, bin_, 2] = at + bt * sin1
    out[table, bin_, 3] = aa + ba * sin1
    out[table, bin_, 4] = aa * sin1 + ba * sin2
    out[table, bin_, 5] = aa * cos1 + ba * sin_cos


@kernel
def _clip(w: float, low: float, high: float) -> float:
    if w < low:
        return low
    if w > high:
        return high
    return w


@kernel
def edge_length(first: float, last: float, low: float, high: float) -> float:
    """Axial length [m] of an edge between heights low..high [m] that stands between two angles, where it is at heights first > last [m].

    With its tip at theta an edge is at the height (theta - phi) / lag where it stands at the angle phi.
    """
    return _clip(first, low, high) - _clip(last, low, high)


@kernel
def _area(w: float, low: float, high: float) -> float:
    """Integral of clip(x, low, high) - low from low to w."""
    if w <= low:
        return 0.0
    if w < high:
        return 0.5 * (w - low) * (w - low)
    return 0.5 * (high - low) * (high - low) + (high - low) * (w - high)


@kernel
def _moment(w: float, low: float, high: float) -> float:
    """Integral of (clip(x, low, high)**2 - low**2)/2 from low to w."""
    if w <= low:
        return 0.0
    if w < high:
        return (w * w * w - low * low * low) / 6.0 - 0.5 * low * low * (w - low)
    return (high * high * high - low * low * low) / 6.0 - 0.5 * low * low * (high - low) + 0.5 * (high * high - low * low) * (w - high)


@kernel
def passed(start: float, stop: float, low: float, high: float) -> tuple[float, float]:
    """Integrals of clip(w, low, high) [m2] and of half its square [m3], but for a constant, while w goes from `start` to `stop` [m].

    The difference of two, of an edge at the bounds of an interval of phi, over the way stop - start: the means of `edge_length` and of the
    integral of z over that length. Exact.
    """
    return _area(stop, low, high) - _area(start, low, high), _moment(stop, low, high) - _moment(start, low, high)


@kernel
def _turns(angle: float) -> float:
    """Whole turns in an angle [rad], rounded down; without a division where it is less than one."""
    if angle >= 0.0 and angle < TWO_PI:
        return 0.0
    if angle < 0.0 and angle >= -TWO_PI:
        return -1.0
    return float(math.floor(angle / TWO_PI))


@kernel
def mean_over_rotation(
    theta0: float,
    theta1: float,
    teeth: int,
    tables: int,
    bounds: FloatArray,
    bins: int,
    lag: float,
    low: float,
    highest: float,
    depth: FloatArray,
    density: FloatArray,
    out: FloatArray,
) -> None:
    """Mean forces of all edges while tooth 0 turns from theta0 to theta1 [rad], without discretisation in time.

    Tooth j stands at theta - 2 pi j/N. Bin b is bounds[b]..bounds[b+1] (ascending, within 0..2 pi) and is engaged from
    height `low` to depth[b] [m] (`highest` = the largest); density (tables, bins, 6) as `edge_density`, tables = 1 (all teeth alike) or N.
    out[0..5] = the integrals of the six densities [N]; out[6], out[7] = first moments z Fx, z Fy [N.m].
    """
    # sums in scalars: in an array each addition would wait for the one before to be stored
    fx, fy, ft, fa, fs, fc, mx, my = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(teeth if highest > low else 0):
        table = j if tables > 1 else 0
        # bring the start of this tooth into 0..2 pi, then visit every turn in which its edge meets the bins
        start = theta0 - TWO_PI * j / teeth
        start -= TWO_PI * _turns(start)
        stop = start + (theta1 - theta0)
        turn = TWO_PI * _turns(bounds[bins] - start + lag * highest)
        while stop + turn > bounds[0]:
            begin = start + turn
            end = stop + turn
            scale = lag / (end - begin)
            area, moment = 0.0, 0.0
            # the next bin begins where the last one ends: what has passed there is known, if it is as deep
            known, known_depth = -1, 0.0
            for b in range(bins):
                deep = depth[b]
                if deep <= low or bounds[b] >= end or bounds[b + 1] <= begin - lag * deep:
                    continue
                if known != b or known_depth != deep:
                    area, moment = passed((begin - bounds[b]) / lag, (end - bounds[b]) / lag, low, deep)
                behind_area, behind_moment = passed((begin - bounds[b + 1]) / lag, (end - bounds[b + 1]) / lag, low, deep)
                length = (area - behind_area) * scale
                first_moment = (moment - behind_moment) * scale
                area, moment, known, known_depth = behind_area, behind_moment, b + 1, deep
                force = density[table, b]
                fx += force[0] * length
                fy += force[1] * length
                ft += force[2] * length
                fa += force[3] * length
                fs += force[4] * length
                fc += force[5] * length
                mx += force[0] * first_moment
                my += force[1] * first_moment
            turn -= TWO_PI
    out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7] = fx, fy, ft, fa, fs, fc, mx, my


@kernel
def at_angle(
    theta: float,
    teeth: int,
    tables: int,
    bounds: FloatArray,
    bins: int,
    lag: float,
    low: float,
    highest: float,
    depth: FloatArray,
    density: FloatArray,
    out: FloatArray,
) -> None:
    """Forces at one angle of rotation: out[0..2] = Fx, Fy, Fa [N]; arguments as `mean_over_rotation`, with bins of equal width."""
    fx, fy, fa = 0.0, 0.0, 0.0
    width = (bounds[bins] - bounds[0]) / bins
    reach = lag * highest
    ahead = _last_turn(theta, 0, teeth, bounds[bins], reach)
    for j in range(teeth if highest > low else 0):
        table = j if tables > 1 else 0
        # a tooth ahead: which bins are visited is then known before they are
        angle = ahead
        ahead = _last_turn(theta, j + 1, teeth, bounds[bins], reach)
        while angle - lag * low > bounds[0]:
            first = math.floor((angle - reach - bounds[0]) / width) - 1
            last = math.floor((angle - lag * low - bounds[0]) / width) + 1
            first = max(first, 0)
            last = min(last, bins - 1)
            before = (angle - bounds[first]) / lag
            for b in range(first, last + 1):
                behind = (angle - bounds[b + 1]) / lag
                if depth[b] > low:
                    length = edge_length(before, behind, low, depth[b])
                    force = density[table, b]
                    fx += force[0] * length
                    fy += force[1] * length
                    fa += force[3] * length
                before = behind
            angle -= TWO_PI
    out[0], out[1], out[2] = fx, fy, fa


@kernel
def _last_turn(theta: float, tooth: int, teeth: int, last: float, reach: float) -> float:
    """Largest angle of the tip of a tooth, whole turns from theta, at which its edge, which lags by up to `reach`, meets `last` [rad]."""
    start = theta - TWO_PI * tooth / teeth
    start -= TWO_PI * _turns(start)
    return start + TWO_PI * _turns(last - start + reach)
