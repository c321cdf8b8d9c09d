"""The workpiece that is really cut: one top height per cell (z-dexels), a flat end mill's cut, what its edges meet.

The block stands in frame P: origin at the centre of the nominal top surface, z up. It is divided into nx x ny equal
cells; cell (ix, iy) has its centre at ((ix + 1/2) dx - Lx/2, (iy + 1/2) dy - Ly/2) and its height in
`height[iy * nx + ix]`. A cell that the cutter covers in part is lowered in part (by the fraction of it that the wall
leaves, measured from the stock's top), so heights are area means and a wall between two cells is known to a fraction
of a cell. Engagement read by linear interpolation is then smooth in the position of the tool. The edges must not read cells
that the tool itself is lowering, so they read a second field that lags by a few millimetres of travel (`follow`).

All functions are kernels on the caller's arrays; lengths in m. Tool axis parallel to z of P.
"""

from __future__ import annotations

import math

from robomill.models.model.declaration import FloatArray, kernel

CAPACITY = 2**18
"""Cells that the height field holds (2 MB)."""

CLEAR = 2.0
"""Cells between the edges and the nearest cell that the cutter has touched in the map that they read: half a cell of partial cover
and the diagonal (1.41) of the cells between which is interpolated."""

TRAIL = 64
"""Places of the tool, about a cell apart, by which that map lags at most."""

OWN = 1e-3
"""Travel [m] of the tool that its edges do not look at, there and back: a tool that springs back by half of it stays in its cut."""

LEAST_DEPTH = 1e-9
"""Material standing less than this above the tip [m] is the roundoff of a floor already cut."""

_PROBES = 9
"""Points across the diameter at which the floor under the cutter is probed (69 within the disc)."""


@kernel
def cells(length: float, spacing: float) -> int:
    """Number of cells (2 or more) of at most `spacing` [m] along a block edge [m]; they fill it exactly."""
    count = math.floor(length / spacing)
    if count * spacing < length * (1.0 - 1e-12):
        count += 1
    return count if count > 2 else 2


@kernel
def finest_spacing(length: float, width: float, capacity: int) -> float:
    """Finest spacing [m], rounded up to a micrometre, with which a block of length x width needs no more than `capacity` cells."""
    spacing = math.floor(1e6 * math.sqrt(length * width / capacity)) * 1e-6
    while spacing <= 0.0 or cells(length, spacing) * cells(width, spacing) > capacity:
        spacing += 1e-6
    return spacing


@kernel
def fill(height: FloatArray, count: int, top: float) -> None:
    """Set the first `count` cells to the height `top` of the stock and the unused rest to zero."""
    for k in range(len(height)):
        height[k] = top if k < count else 0.0


@kernel
def touches(
    nx: int, ny: int, dx: float, dy: float, top: float, xa: float, ya: float, za: float, xb: float, yb: float, zb: float, reach: float
) -> bool:
    """Whether a cutter of radius `reach` moving from a to b can meet the block, by bounding boxes; `top` includes any gap in z."""
    hx = 0.5 * nx * dx + reach
    hy = 0.5 * ny * dy + reach
    if za >= top and zb >= top:
        return False
    if (xa > hx and xb > hx) or (xa < -hx and xb < -hx):
        return False
    return not ((ya > hy and yb > hy) or (ya < -hy and yb < -hy))


@kernel
def cut(
    height: FloatArray,
    nx: int,
    ny: int,
    dx: float,
    dy: float,
    top: float,
    bottom: float,
    xa: float,
    ya: float,
    za: float,
    xb: float,
    yb: float,
    zb: float,
    radius: float,
    cut_at_a: bool,
) -> float:
    """Lower the cells that a flat end mill sweeps on the straight way of its tip from a to b; the volume removed [m3].

    `cut_at_a`: the block has already been cut with the tool at a (the end of the last step), which saves most of the
    work while the tool does not go down. A slanted way is cut in pieces of a cell, each at its lower end.
    """
    length = math.sqrt((xb - xa) * (xb - xa) + (yb - ya) * (yb - ya))
    pieces = 1
    if za != zb:
        pieces = math.floor(length / (dx if dx < dy else dy)) + 1
    removed = 0.0
    done = cut_at_a
    for i in range(pieces):
        t0 = i / pieces
        t1 = (i + 1) / pieces
        removed += _cut_piece(
            height,
            nx,
            ny,
            dx,
            dy,
            top,
            bottom,
            xa + t0 * (xb - xa),
            ya + t0 * (yb - ya),
            za + t0 * (zb - za),
            xa + t1 * (xb - xa) if i + 1 < pieces else xb,
            ya + t1 * (yb - ya) if i + 1 < pieces else yb,
            za + t1 * (zb - za) if i + 1 < pieces else zb,
            radius,
            done,
        )
        done = True
    return removed * dx * dy


@kernel
def _cut_piece(
    height: FloatArray,
    nx: int,
    ny: int,
    dx: float,
    dy: float,
    top: float,
    bottom: float,
    xa: float,
    ya: float,
    za: float,
    xb: float,
    yb: float,
    zb: float,
    radius: float,
    done: bool,
) -> float:
    """Cut the stadium a-b at the lower of both heights; the sum of the heights removed [m]."""
    z = za if za < zb else zb
    if z >= top:
        return 0.0
    z = max(z, bottom)
    idle = done and zb >= za  # what was covered at a needs no second visit
    half = 0.5 * (dx if dx > dy else dy)
    outer = radius + half
    inner = radius - half
    inner = max(inner, 0.0)
    x0 = 0.5 * dx - 0.5 * nx * dx
    y0 = 0.5 * dy - 0.5 * ny * dy
    ux = xb - xa
    uy = yb - ya
    length2 = ux * ux + uy * uy
    if length2 < 1e-30:
        ux, uy, length2 = 0.0, 0.0, 0.0
    length = math.sqrt(length2)
    removed = 0.0
    if idle and length2 == 0.0:
        return removed
    first_row = math.ceil(((ya if ya < yb else yb) - outer - y0) / dy)
    last_row = math.floor(((ya if ya > yb else yb) + outer - y0) / dy)
    first_row = max(first_row, 0)
    last_row = min(last_row, ny - 1)
    side = outer / length if length2 > 0.0 else 0.0
    ahead = _row(first_row, nx, dx, dy, x0, y0, xa, ya, xb, yb, ux, uy, side, outer, inner)
    for iy in range(first_row, last_row + 1):
        # a row ahead: where the loops over the cells end is then known before they begin
        first, core_first, core_end, end = ahead
        ahead = _row(iy + 1, nx, dx, dy, x0, y0, xa, ya, xb, yb, ux, uy, side, outer, inner)
        va = y0 + iy * dy - ya
        row = iy * nx
        for part in range(2):
            # before the core and behind it: partly covered, or not covered all the way from a to b
            begin, stop = first, core_first
            if part == 1:
                begin, stop = core_end, end
                if not idle and core_first < core_end:
                    removed = _lower(height[row + core_first : row + core_end], z, removed)
            for ix in range(begin, stop):
                # the nearest place of the axis on its way
                vx = x0 + ix * dx - xa
                along = vx * ux + va * uy
                t = 0.0
                if along >= length2 > 0.0:
                    t = 1.0
                elif along > 0.0:
                    t = along / length2
                elif idle:
                    continue
                wx = vx - t * ux
                wy = va - t * uy
                cover = (outer - math.sqrt(wx * wx + wy * wy)) / (outer - inner)
                if cover > 0.0:
                    lowered = z
                    if cover < 1.0:
                        lowered = z + (1.0 - cover) * (top - z)
                    k = row + ix
                    # without a branch: which cells change is hard to foretell
                    before = height[k]
                    after = min(before, lowered)
                    removed += before - after
                    height[k] = after
    return removed


@kernel
def _row(
    iy: int,
    nx: int,
    dx: float,
    dy: float,
    x0: float,
    y0: float,
    xa: float,
    ya: float,
    xb: float,
    yb: float,
    ux: float,
    uy: float,
    side: float,
    outer: float,
    inner: float,
) -> tuple[int, int, int, int]:
    """Cells of a row in the stadium a-b of radius `outer` [m]: the first one, the core (wholly covered at a and at b) from and to, the end.

    Each is one behind the last, and without a core it is at the end. (ux, uy) = b - a [m]; `side` = outer / length.
    """
    y = y0 + iy * dy
    va = y - ya
    vb = y - yb
    # the extremes of both discs and of the tangents between them
    low = 1e30
    high = -1e30
    r2 = outer * outer - va * va
    if r2 >= 0.0:
        r = math.sqrt(r2)
        low = xa - r
        high = xa + r
    r2 = outer * outer - vb * vb
    if r2 >= 0.0:
        r = math.sqrt(r2)
        low = min(low, xb - r)
        high = max(high, xb + r)
    if uy != 0.0:
        for _ in range(2):
            # t from 0 to 1 without the division, which few rows need: rounding does not change on which side of both it is
            along = va - side * ux
            if (along >= 0.0 and along <= uy) or (along <= 0.0 and along >= uy):
                x = xa + along / uy * ux - side * uy
                low = min(low, x)
                high = max(high, x)
            side = -side
    if low > high:
        return 0, 0, 0, 0
    first = math.ceil((low - x0) / dx) if low > x0 else 0
    end = math.floor((high - x0) / dx) + 1 if high < x0 + nx * dx else nx
    end = min(end, nx)
    ra = inner * inner - va * va
    rb = inner * inner - vb * vb
    if ra > 0.0 and rb > 0.0:
        ra = math.sqrt(ra)
        rb = math.sqrt(rb)
        low = xa - ra if xa - ra > xb - rb else xb - rb
        high = xa + ra if xa + ra < xb + rb else xb + rb
        if low <= high:
            core_first = math.ceil((low - x0) / dx) if low > x0 else 0
            core_end = math.floor((high - x0) / dx) + 1 if high < x0 + nx * dx else nx
            core_end = min(core_end, end)
            if core_first < core_end:
                return first, core_first, core_end, end
    return first, end, end, end


@kernel
def _lower(heights: FloatArray, z: float, removed: float) -> float:
    """Lower the heights to z [m]; `removed` plus what was above [m]. Most often nothing is, which is seen without looking one by one."""
    above = 0
    for k in range(len(heights)):
        above += 1 if heights[k] > z else 0
    if above > 0:
        for k in range(len(heights)):
            if heights[k] > z:
                removed += heights[k] - z
                heights[k] = z
    return removed


@kernel
def covered_depth(
    height: FloatArray, nx: int, ny: int, dx: float, dy: float, bottom: float, x: float, y: float, z: float, radius: float
) -> float:
    """How far material stands above the tip [m] in the cells that a tool of that radius at (x, y, z) wholly covers; 0 if it is clear."""
    half = 0.5 * (dx if dx > dy else dy)
    inner = radius - half
    depth = 0.0
    if inner <= 0.0:
        return depth
    x0 = 0.5 * dx - 0.5 * nx * dx
    y0 = 0.5 * dy - 0.5 * ny * dy
    first_row = max(math.ceil((y - inner - y0) / dy), 0)
    last_row = min(math.floor((y + inner - y0) / dy), ny - 1)
    for iy in range(first_row, last_row + 1):
        v = y0 + iy * dy - y
        r = math.sqrt(max(inner * inner - v * v, 0.0))
        first = max(math.ceil((x - r - x0) / dx), 0)
        last = min(math.floor((x + r - x0) / dx), nx - 1)
        for ix in range(first, last + 1):
            top = height[iy * nx + ix]
            if top > bottom and top - z > LEAST_DEPTH:
                depth = max(depth, top - z)
    return depth


@kernel
def height_at(height: FloatArray, nx: int, ny: int, dx: float, dy: float, x: float, y: float) -> float:
    """Height [m] at a point by bilinear interpolation between cell centres; outside the block that of the nearest edge."""
    u = x / dx + 0.5 * nx - 0.5
    v = y / dy + 0.5 * ny - 0.5
    if u < 0.0:
        u = 0.0
    elif u > nx - 1.0:
        u = nx - 1.0
    if v < 0.0:
        v = 0.0
    elif v > ny - 1.0:
        v = ny - 1.0
    ix = math.floor(u)
    iy = math.floor(v)
    ix = min(ix, nx - 2)
    iy = min(iy, ny - 2)
    k = iy * nx + ix
    u -= ix
    v -= iy
    result: float = (1.0 - v) * ((1.0 - u) * height[k] + u * height[k + 1]) + v * ((1.0 - u) * height[k + nx] + u * height[k + nx + 1])
    return result


@kernel
def footprint(nx: int, ny: int, dx: float, dy: float, x: float, y: float) -> float:
    """1 inside the block, 0 outside, linear over one cell across its side faces."""
    u = (0.5 * nx * dx - abs(x)) / dx + 0.5
    v = (0.5 * ny * dy - abs(y)) / dy + 0.5
    if u <= 0.0 or v <= 0.0:
        return 0.0
    u = min(u, 1.0)
    v = min(v, 1.0)
    return u * v


@kernel
def follow(
    lagging: FloatArray,
    nx: int,
    ny: int,
    dx: float,
    dy: float,
    top: float,
    bottom: float,
    trail: FloatArray,
    places: int,
    x: float,
    y: float,
    z: float,
    radius: float,
) -> int:
    """Note that the tool has cut at (x, y, z) [m]; cut into `lagging` what is further behind than it lags. Returns the places in `trail`.

    `lagging` is the height field without the last places of the tool, which are in `trail`, shape (TRAIL, 3), oldest first.
    It lags by so much travel that the edges, even at the sides of the cutter, are CLEAR cells from what has been cut into it.
    """
    spacing = dx if dx > dy else dy
    clear = radius + CLEAR * spacing
    lag = math.sqrt(clear * clear - radius * radius)
    apart = max(spacing, lag / (len(trail) - 2.0))
    if places == 0:
        # twice: the way of no length between the two cuts the whole disc
        places = 1
        for i in range(2):
            trail[i, 0], trail[i, 1], trail[i, 2] = x, y, z
    else:
        wx = x - trail[places - 1, 0]
        wy = y - trail[places - 1, 1]
        if wx * wx + wy * wy < apart * apart:
            trail[places - 1, 2] = min(trail[places - 1, 2], z)
            return places
    if places > lag / apart + 1.0:
        _cut_way(lagging, nx, ny, dx, dy, top, bottom, trail, 0, radius)
        for k in range(places - 1):
            trail[k, 0], trail[k, 1], trail[k, 2] = trail[k + 1, 0], trail[k + 1, 1], trail[k + 1, 2]
        places -= 1
    trail[places, 0], trail[places, 1], trail[places, 2] = x, y, z
    return places + 1


@kernel
def settle(
    lagging: FloatArray,
    nx: int,
    ny: int,
    dx: float,
    dy: float,
    top: float,
    bottom: float,
    trail: FloatArray,
    places: int,
    x: float,
    y: float,
    z: float,
    radius: float,
) -> None:
    """Cut all places of the trail into `lagging`, up to (x, y, z) [m], where the tool has cut last: it leaves, or another one comes."""
    for k in range(places - 1):
        _cut_way(lagging, nx, ny, dx, dy, top, bottom, trail, k, radius)
    last = places - 1
    cut(lagging, nx, ny, dx, dy, top, bottom, trail[last, 0], trail[last, 1], trail[last, 2], x, y, z, radius, True)


@kernel
def _cut_way(
    lagging: FloatArray, nx: int, ny: int, dx: float, dy: float, top: float, bottom: float, trail: FloatArray, k: int, radius: float
) -> None:
    """Cut the way from place k of the trail to the next."""
    xa, ya, za = trail[k, 0], trail[k, 1], trail[k, 2]
    xb, yb, zb = trail[k + 1, 0], trail[k + 1, 1], trail[k + 1, 2]
    cut(lagging, nx, ny, dx, dy, top, bottom, xa, ya, za, xb, yb, zb, radius, xa != xb or ya != yb)


@kernel
def engagement(
    lagging: FloatArray,
    nx: int,
    ny: int,
    dx: float,
    dy: float,
    trail: FloatArray,
    places: int,
    x: float,
    y: float,
    z: float,
    radius: float,
    ux: float,
    uy: float,
    loss: float,
    low: float,
    bins: int,
    sines: FloatArray,
    cosines: FloatArray,
    depth: FloatArray,
) -> float:
    """Height of the material above the tip [m] that the edges meet in each of `bins` angular bins of 0..pi; returns the largest.

    0 in bins where the material reaches no higher than `low` [m] above the tip (the bottom of a block that is cut through).

    (ux, uy) is the feed direction; `sines`, `cosines` belong to the middle of the bins, clockwise from the left of the feed.
    Material is read where the edge is, from the field and the trail of `follow`: walls are right to a fraction of a cell,
    what the tool itself has cut lately to (1 - `loss`) CLEAR cells. Without loss a tool that swings sideways by less has the whole arc,
    as the chip comes from the commanded feed and would not damp it. With a loss of 1 an edge that has moved back meets nothing.
    Edges outside the block meet nothing.
    """
    spacing = dx if dx > dy else dy
    within = max(radius - (1.0 - loss) * CLEAR * spacing, 0.0)
    # a whole cell from the side faces the footprint is 1
    inside = abs(x) + radius + spacing <= 0.5 * nx * dx and abs(y) + radius + spacing <= 0.5 * ny * dy
    for b in range(bins):
        left = radius * cosines[b]
        ahead = radius * sines[b]
        px = x + ahead * ux - left * uy
        py = y + ahead * uy + left * ux
        depth[b] = 0.0
        if inside or footprint(nx, ny, dx, dy, px, py) > 0.0:
            depth[b] = height_at(lagging, nx, ny, dx, dy, px, py) - z
    travel = 0.0
    lx, ly = x, y
    for i in range(places):
        k = places - 1 - i
        wx = trail[k, 0] - x
        wy = trail[k, 1] - y
        travel += math.sqrt((trail[k, 0] - lx) * (trail[k, 0] - lx) + (trail[k, 1] - ly) * (trail[k, 1] - ly))
        lx, ly = trail[k, 0], trail[k, 1]
        if travel < OWN:
            continue
        # the edge at phi is that far in the disc about the place where
        # behind sin(phi) - aside cos(phi) < (within^2 - R^2 - behind^2 - aside^2) / 2 R
        behind = -(wx * ux + wy * uy)
        aside = wy * ux - wx * uy
        bound = 0.5 * (within * within - radius * radius - behind * behind - aside * aside) / radius
        if behind >= 0.0 and abs(aside) <= -bound:
            continue
        floor = trail[k, 2] - z
        for b in range(bins):
            if behind * sines[b] - aside * cosines[b] < bound and depth[b] > floor:
                depth[b] = floor
    largest = 0.0
    for b in range(bins):
        a = depth[b]
        if not inside:
            left = radius * cosines[b]
            ahead = radius * sines[b]
            a *= footprint(nx, ny, dx, dy, x + ahead * ux - left * uy, y + ahead * uy + left * ux)
        depth[b] = 0.0
        if a > low + LEAST_DEPTH:
            depth[b] = a
            largest = max(largest, a)
    return largest


@kernel
def contact(
    height: FloatArray, nx: int, ny: int, dx: float, dy: float, x: float, y: float, z: float, radius: float, bottom: float, zone: float
) -> float:
    """Share of the cutter's end face that stands on material, 0..1: 1 where the floor reaches the tip, 0 where it is `zone` [m] lower."""
    hits = 0.0
    points = 0
    step = 2.0 * radius / _PROBES
    middle = _PROBES // 2
    for i in range(_PROBES):
        px = (i - middle) * step
        for j in range(_PROBES):
            py = (j - middle) * step
            if px * px + py * py > radius * radius:
                continue
            points += 1
            inside = footprint(nx, ny, dx, dy, x + px, y + py)
            if inside > 0.0:
                floor = height_at(height, nx, ny, dx, dy, x + px, y + py)
                if floor > bottom:
                    near = 1.0 + (floor - z) / zone
                    near = min(near, 1.0)
                    if near > 0.0:
                        hits += near * inside
    return hits / points
