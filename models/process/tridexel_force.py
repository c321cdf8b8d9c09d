"""Force of a cutter in tri-dexels: the edge forces summed over the elements that are in material and over the turn; the end face.

The record is that of the component `tridexel_milling_force`, whose states these kernels fill.
"""

from __future__ import annotations

import math

from robomill.models.maths.elementary import atan2, exp, power, tan
from robomill.models.maths.frames import cross, dot, normalise
from robomill.models.model.declaration import Record, kernel
from robomill.models.process import tridexels
from robomill.models.process.cutting import LEAST_LAG, chip_law
from robomill.models.process.tridexel_engagement import BINS, LEAST_SPEED, PI, TWO_PI, profile, reach_at, shares

PROBES = 9
"""Points across the flat of the end at which the floor under it is looked at."""
LEAST_CHIP = 1e-6
"""Chip thickness [m] below which the size effect grows no further."""


@kernel
def cutting_force(s: Record, turn: float, h: float) -> bool:
    """Mean force and moment in P, peak, torque and depth while the spindle turns by `turn` [rad] in the middle of the step of h [s].

    False where the feed per tooth is more than the radius of the cutter.
    """
    along = dot(s.v_P, s.axis_mid)
    for i in range(3):
        s.ahead[i] = s.v_P[i] - along * s.axis_mid[i]
    if dot(s.ahead, s.ahead) < LEAST_SPEED * LEAST_SPEED:
        for i in range(3):
            s.ahead[i] = s.side_mid[i]
    normalise(s.ahead)
    cross(s.axis_mid, s.ahead, s.left)
    cross(s.side_mid, s.axis_mid, s.point)  # z of T
    towards = atan2(dot(s.left, s.point), dot(s.left, s.side_mid))
    per_tooth = TWO_PI * h / (s.mill_teeth * turn)
    s.chip = math.sqrt(dot(s.v_P, s.v_P)) * per_tooth
    for b in range(BINS):
        s.bin_depth[b] = 0.0
    for k in range(s.substeps):
        for i in range(3):
            s.instant[k, i] = 0.0
    thrust, torque, rate = _end_face(s, -along * per_tooth, -dot(s.v_way, s.axis_mid), h)
    for i in range(3):
        s.f_P[i] = thrust * s.axis_mid[i]
        s.m_P[i] = torque * s.axis_mid[i]
    lag = max(2.0 * tan(s.mill_helix) / s.mill_diameter, LEAST_LAG)
    profile(s)
    any_cut = False
    if s.discs > 0:
        reach_at(s, 0, s.lower)
    for n in range(s.discs):
        reach_at(s, n + 1, s.upper)
        if shares(s, n):
            any_cut = True
            rate += _disc(s, n, per_tooth)
            _turned(s, n, s.spindle_angle - towards - lag * s.middle[n, 0], turn, per_tooth)
        for b in range(BINS + 1):
            s.lower[b] = s.upper[b]
    if any_cut and s.chip > 0.5 * s.mill_diameter:
        return False
    peak2 = 0.0
    for k in range(s.substeps):
        x = s.instant[k, 0] + thrust * s.axis_mid[0]
        y = s.instant[k, 1] + thrust * s.axis_mid[1]
        z = s.instant[k, 2] + thrust * s.axis_mid[2]
        peak2 = max(peak2, x * x + y * y + z * z)
    for b in range(BINS):
        s.depth = max(s.depth, s.bin_depth[b])
    s.f_peak = math.sqrt(peak2)
    s.spindle_torque = dot(s.m_P, s.axis_mid)
    s.spindle_power = s.spindle_torque * turn / h
    s.removal_rate = rate
    return True


@kernel
def _disc(s: Record, n: int, per_tooth: float) -> float:
    """Chip of every bin of element n into s.share and s.engaged [m]: the way of the envelope per tooth; the volume per time [m3/s]."""
    height, radius, up, down = s.middle[n, 0], s.middle[n, 1], s.middle[n, 2], s.middle[n, 3]
    rate = 0.0
    for b in range(BINS):
        s.engaged[b] = 0.0
        if s.share[b] <= 0.0:
            continue
        sine, cosine = s.bin_sine[b], s.bin_cosine[b]
        ox = sine * s.ahead[0] + cosine * s.left[0]
        oy = sine * s.ahead[1] + cosine * s.left[1]
        oz = sine * s.ahead[2] + cosine * s.left[2]
        ax, ay, az = s.axis_mid[0], s.axis_mid[1], s.axis_mid[2]
        rx, ry, rz = radius * ox + height * ax, radius * oy + height * ay, radius * oz + height * az
        vx = s.v_P[0] + s.swing[1] * rz - s.swing[2] * ry
        vy = s.v_P[1] + s.swing[2] * rx - s.swing[0] * rz
        vz = s.v_P[2] + s.swing[0] * ry - s.swing[1] * rx
        advance = up * (vx * ox + vy * oy + vz * oz) - down * (vx * ax + vy * ay + vz * az)
        if advance > 0.0:
            s.engaged[b] = advance * per_tooth
            s.bin_depth[b] += s.share[b] * (s.level[n + 1, 0] - s.level[n, 0])
            # what is really removed follows the actual way
            for i in range(3):
                normal = up * (sine * s.ahead[i] + cosine * s.left[i]) - down * s.axis_mid[i]
                advance += (s.v_way[i] - s.v_P[i]) * normal
            rate += s.share[b] * max(advance, 0.0) * radius * TWO_PI / BINS * s.edge[n]
    return rate


@kernel
def _turned(s: Record, n: int, start: float, turn: float, per_tooth: float) -> None:
    """Add element n to mean force, mean moment and instants while tooth 1 turns from `start` (against the feed's left) on by `turn`."""
    for j in range(s.mill_teeth):
        if j == 0 or s.runout > 0.0:
            _densities(s, n, j)
        first = start - TWO_PI * j / s.mill_teeth
        for i in range(6):
            mean = (_up_to(s, first + turn, i) - _up_to(s, first, i)) / turn
            if i < 3:
                s.f_P[i] += mean
            else:
                s.m_P[i - 3] += mean
        for k in range(s.substeps):
            angle = first + turn * (k + 0.5) / s.substeps
            b = math.floor((angle / TWO_PI - math.floor(angle / TWO_PI)) * BINS)
            b = min(b, BINS - 1)
            for i in range(3):
                s.instant[k, i] += s.density[b, i]


@kernel
def _up_to(s: Record, angle: float, i: int) -> float:
    """Integral of a density over the angle from 0 to `angle` [rad], whole turns included."""
    turns = math.floor(angle / TWO_PI)
    place = (angle / TWO_PI - turns) * BINS
    b = min(math.floor(place), BINS - 1)
    result: float = turns * s.sums[BINS, i] + s.sums[b, i] + (place - b) * (s.sums[b + 1, i] - s.sums[b, i])
    return result


@kernel
def _densities(s: Record, n: int, tooth: int) -> None:
    """Force [N] and moment about the tip [N.m] in P on the edge of a tooth in element n, bin by bin, and their sums over angle."""
    height, radius, up, down = s.middle[n, 0], s.middle[n, 1], s.middle[n, 2], s.middle[n, 3]
    onset = 1.0
    if s.chip < s.edge_onset:
        onset = s.chip / s.edge_onset
    edge = (1.0 + s.tool_wear) * onset
    ax, ay, az = s.axis_mid[0], s.axis_mid[1], s.axis_mid[2]
    for b in range(BINS):
        for i in range(6):
            s.density[b, i] = 0.0
        h = s.engaged[b]
        if h > 0.0 and s.runout > 0.0 and up > 0.0:
            a, slope = chip_law(tooth, s.mill_teeth, h / up, 1.0, s.radii)
            h = (a + slope) * up
        if h > 0.0:
            gain = 1.0 + s.cutting_coefficient_error
            if s.size_effect_exponent > 0.0:
                gain *= power((h if h > LEAST_CHIP else LEAST_CHIP) / s.size_reference, -s.size_effect_exponent)
            length = s.edge[n] * s.share[b]
            ft = (s.Ktc * gain * h + s.Kte * edge) * length
            fr = (s.Krc * gain * h + s.Kre * edge) * length
            fa = (s.Kac * gain * h + s.Kae * edge) * length
            sine, cosine = s.bin_sine[b], s.bin_cosine[b]
            outward = -fr * up - fa * down
            upward = fr * down - fa * up
            for i in range(3):
                out = sine * s.ahead[i] + cosine * s.left[i]
                with_turn = cosine * s.ahead[i] - sine * s.left[i]
                s.density[b, i] = -ft * with_turn + outward * out + upward * s.axis_mid[i]
            rx = radius * (sine * s.ahead[0] + cosine * s.left[0]) + height * ax
            ry = radius * (sine * s.ahead[1] + cosine * s.left[1]) + height * ay
            rz = radius * (sine * s.ahead[2] + cosine * s.left[2]) + height * az
            fx, fy, fz = s.density[b, 0], s.density[b, 1], s.density[b, 2]
            s.density[b, 3] = ry * fz - rz * fy
            s.density[b, 4] = rz * fx - rx * fz
            s.density[b, 5] = rx * fy - ry * fx
        for i in range(6):
            s.sums[b + 1, i] = s.sums[b, i] + s.density[b, i] * (TWO_PI / BINS)


@kernel
def _end_face(s: Record, plunge: float, speed: float, h: float) -> tuple[float, float, float]:
    """Thrust [N], torque [N.m], volume per time [m3/s] of the flat of the end, going down by `plunge` [m] per tooth.

    Its contact builds up over contact_time, as in `milling_force`.
    """
    flat = 0.5 * s.mill_diameter - s.mill_corner
    target = 0.0
    if plunge > 0.0 and flat > 0.0:
        target = _contact(s, flat)
    share, mean = target, target
    if s.contact_time > 0.0:
        periods = h / s.contact_time
        decay = exp(-periods)
        share = target + (s.contact_share - target) * decay
        mean = target + (s.contact_share - target) * (1.0 - decay) / periods
    s.contact_share = 0.0 if target == 0.0 and share < 1e-3 else share
    if not (plunge > 0.0 and mean > 0.0):
        return 0.0, 0.0, 0.0
    cutting = (1.0 + s.cutting_coefficient_error) * plunge
    edge = (1.0 + s.tool_wear) * (plunge / s.edge_onset if plunge < s.edge_onset else 1.0)
    length = s.mill_teeth * mean * s.bottom_edge * flat
    arm = (1.0 - 0.5 * s.bottom_edge) * flat
    return (
        length * (s.Krc * cutting + s.Kre * edge),
        length * arm * (s.Ktc * cutting + s.Kte * edge),
        target * PI * flat * flat * max(speed, 0.0),
    )


@kernel
def _contact(s: Record, flat: float) -> float:
    """Share of the flat of the end that stands on material, 0..1: 1 where the floor reaches it, 0 where it is contact_zone lower."""
    hits = 0.0
    points = 0
    pitch = 2.0 * flat / PROBES
    for i in range(PROBES):
        u = (i - PROBES // 2) * pitch
        for j in range(PROBES):
            v = (j - PROBES // 2) * pitch
            if u * u + v * v > flat * flat:
                continue
            points += 1
            gap = tridexels.distance(
                s.pool,
                s.cells,
                s.origin,
                s.pitch,
                s.tick,
                s.segments,
                s.p_mid[0] + u * s.ahead[0] + v * s.left[0],
                s.p_mid[1] + u * s.ahead[1] + v * s.left[1],
                s.p_mid[2] + u * s.ahead[2] + v * s.left[2],
            )
            hits += min(max(1.0 + gap / s.contact_zone, 0.0), 1.0)
    return hits / points
