"""The workpiece as tri-dexels: three fields of lines along x, y and z of P, each with the intervals in which it is in material.

The box of the stock has nx x ny x nz equal cells. Through the centre of every cell goes one line of each field, so
the three fields share their crossings, the cell centres. An interval is one whole number of 64 bits: where it begins in the
upper half, where it ends in the lower half, in ticks of TICKS to the longest edge (0.2 nm for 200 mm). 0 is no interval.

The pool holds all of them. Word 0 is the number of words in use. Line l begins at word 1 + l*segments with room for
`segments` intervals; the lines along x come first (y fastest), then those along y (z fastest), then those along z
(x fastest). A line that needs more moves to the end of the pool, to twice the room: its first word is then negative and
says where it is and how much room it has (MOVED).

All functions are kernels on the caller's arrays; lengths in m. `cells` (3,) number of cells,
`origin` (3,) lower corner of the box in P, `pitch` (3,) size of a cell.
"""

from __future__ import annotations

import math
from typing import Any

import numpy.typing as npt

from robomill.models.model.declaration import FloatArray, kernel
from robomill.models.model.table_access import cell
from robomill.models.process.cutter_body import chord

IntArray = npt.NDArray[Any]

CAPACITY = 2**21
"""Intervals that all lines together have room for (16.8 MB)."""

TICKS = 1073741824.0
"""Ticks to the longest edge of the box: 2^30."""

LOWER = 4294967295
"""The lower half of a word."""

THIN = 1e-7
"""Intervals and gaps thinner than this [m] are roundoff and vanish."""

SCALLOP = 1e-6
"""Height [m] of the ridges that the positions at which the cutter is taken out leave between them."""

MOVED = 65536
"""The first word of a line that has moved: -(place * MOVED + room)."""

FAR = 2.0
"""Distances beyond this many cells are not told apart."""

NONE = 1 << 40
"""Ticks to a surface that a line does not meet: more than any line has."""

COLUMNS = 9
"""A row of a stock table: x, y, z [m] in P of the three corners of a triangle."""


@kernel
def lines(cells: IntArray) -> int:
    """Number of lines of all three fields."""
    count: int = cells[0] * cells[1] + cells[1] * cells[2] + cells[2] * cells[0]
    return count


@kernel
def line_of(cells: IntArray, k: int, x: int, y: int, z: int) -> int:
    """Number of the line along axis k through cell x, y, z."""
    line: int = z * cells[1] + y
    if k == 1:
        line = cells[1] * cells[2] + x * cells[2] + z
    elif k == 2:
        line = cells[1] * cells[2] + cells[2] * cells[0] + y * cells[0] + x
    return line


@kernel
def word_of(line: int, segments: int) -> int:
    """Word at which a line begins, unless it has moved."""
    return 1 + line * segments


@kernel
def block(pool: IntArray, first: int, segments: int) -> tuple[int, int]:
    """Word at which the intervals of the line are that begins at word `first`, and the room for them."""
    word = pool[first]
    if word < 0:
        return -word // MOVED, -word % MOVED
    return first, segments


@kernel
def _grow(pool: IntArray, first: int, segments: int) -> bool:
    """Move a line to twice the room; False if the pool is full."""
    at, room = block(pool, first, segments)
    more = 2 * room
    new = pool[0]
    if new + more > len(pool) or more >= MOVED:
        return False
    pool[0] = new + more
    for n in range(room):
        pool[new + n] = pool[at + n]
        pool[at + n] = 0
    pool[first] = -(new * MOVED + more)
    return True


@kernel
def clear(pool: IntArray, cells: IntArray, segments: int) -> None:
    """Empty the pool and lay out the lines of so many cells."""
    for n in range(pool[0]):
        pool[n] = 0
    pool[0] = word_of(lines(cells), segments)


@kernel
def fill_box(pool: IntArray, cells: IntArray, pitch: FloatArray, tick: float, segments: int) -> None:
    """All lines are in material from end to end; to be called after `clear`."""
    for k in range(3):
        full = math.floor(cells[k] * pitch[k] / tick + 0.5)
        i, j = (k + 1) % 3, (k + 2) % 3
        first = line_of(cells, k, 0, 0, 0)
        for n in range(cells[i] * cells[j]):
            pool[word_of(first + n, segments)] = full


@kernel
def fill_solid(
    pool: IntArray,
    cells: IntArray,
    origin: FloatArray,
    pitch: FloatArray,
    tick: float,
    segments: int,
    address: int,
    rows: int,
    lift: float,
) -> int:
    """Fill the lines with the inside of the triangles at `address`, raised by `lift` [m]; to be called after `clear`.

    Returns 0; 1 where the pool is full; 2 where a line goes in and not out: the surface is not closed.
    """
    for row in range(rows):
        for k in range(3):
            if not _cross_lines(pool, cells, origin, pitch, tick, segments, address, rows, row, k, lift):
                return 1
    # from crossings, two to a word and one more than their place, to intervals
    for n in range(lines(cells)):
        first, room = block(pool, word_of(n, segments), segments)
        kept = 0
        for i in range(room):
            word = pool[first + i]
            pool[first + i] = 0
            if word == 0:
                continue
            begin, end = (word >> 32) - 1, (word & LOWER) - 1
            if end < 0:
                return 2
            if (end - begin) * tick > THIN:
                pool[first + kept] = (begin << 32) | end
                kept += 1
    return 0


@kernel
def _cross_lines(
    pool: IntArray,
    cells: IntArray,
    origin: FloatArray,
    pitch: FloatArray,
    tick: float,
    segments: int,
    address: int,
    rows: int,
    row: int,
    k: int,
    lift: float,
) -> bool:
    """Note where the lines along k cross a triangle; False if the pool is full. An edge of two triangles counts in one."""
    i, j = (k + 1) % 3, (k + 2) % 3
    u0, v0, h0 = _corner(address, rows, row, 0, i, j, k, origin, lift)
    u1, v1, h1 = _corner(address, rows, row, 1, i, j, k, origin, lift)
    u2, v2, h2 = _corner(address, rows, row, 2, i, j, k, origin, lift)
    area = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)
    if area == 0.0:
        return True
    u_first = max(math.ceil(min(u0, u1, u2) / pitch[i] - 0.5), 0)
    u_last = min(math.floor(max(u0, u1, u2) / pitch[i] - 0.5), cells[i] - 1)
    v_first = max(math.ceil(min(v0, v1, v2) / pitch[j] - 0.5), 0)
    v_last = min(math.floor(max(v0, v1, v2) / pitch[j] - 0.5), cells[j] - 1)
    base = line_of(cells, k, 0, 0, 0)
    for b in range(v_first, v_last + 1):
        v = (b + 0.5) * pitch[j]
        for a in range(u_first, u_last + 1):
            u = (a + 0.5) * pitch[i]
            if _left_of(u, v, u0, v0, u1, v1) == (_left_of(u, v, u1, v1, u2, v2) == _left_of(u, v, u2, v2, u0, v0)):
                share1 = ((u - u0) * (v2 - v0) - (u2 - u0) * (v - v0)) / area
                share2 = ((u1 - u0) * (v - v0) - (u - u0) * (v1 - v0)) / area
                height = h0 + share1 * (h1 - h0) + share2 * (h2 - h0)
                place = math.floor(min(max(height, 0.0), cells[k] * pitch[k]) / tick + 0.5)
                first = word_of(base + b * cells[i] + a, segments)
                at, room = block(pool, first, segments)
                if pool[at + room - 1] & LOWER != 0:
                    if not _grow(pool, first, segments):
                        return False
                    at, room = block(pool, first, segments)
                _insert(pool, at, room, place + 1)
    return True


@kernel
def _corner(
    address: int, rows: int, row: int, corner: int, i: int, j: int, k: int, origin: FloatArray, lift: float
) -> tuple[float, float, float]:
    """Coordinates i, j, k [m] of a corner of a triangle from the lower corner of the box."""
    return (
        cell(address, rows, COLUMNS, row, 3 * corner + i) + (lift if i == 2 else 0.0) - origin[i],
        cell(address, rows, COLUMNS, row, 3 * corner + j) + (lift if j == 2 else 0.0) - origin[j],
        cell(address, rows, COLUMNS, row, 3 * corner + k) + (lift if k == 2 else 0.0) - origin[k],
    )


@kernel
def _left_of(u: float, v: float, ua: float, va: float, ub: float, vb: float) -> bool:
    """Whether a ray from (u, v) towards larger u crosses the edge a-b; the same for b-a, to the last bit."""
    if (va <= v) == (vb <= v):
        return False
    if va > vb or (va == vb and ua > ub):
        ua, va, ub, vb = ub, vb, ua, va
    return u < ua + (v - va) / (vb - va) * (ub - ua)


@kernel
def _insert(pool: IntArray, first: int, room: int, place: int) -> None:
    """Insert a crossing into the ascending ones of a line, two to a word (first in the upper half)."""
    carried = place
    for i in range(room):
        word = pool[first + i]
        upper, lower = word >> 32, word & LOWER
        if upper == 0 or carried < upper:
            upper, carried = carried, upper
        if carried != 0 and (lower == 0 or carried < lower):
            lower, carried = carried, lower
        pool[first + i] = (upper << 32) | lower
        if carried == 0:
            return


@kernel
def depth_in_line(pool: IntArray, first: int, segments: int, place: int) -> int:
    """Ticks from a place on a line to the nearest end of an interval; positive inside of material, negative outside."""
    at, room = block(pool, first, segments)
    gap = NONE
    for i in range(room):
        word = pool[at + i]
        if word == 0:
            break
        begin, end = word >> 32, word & LOWER
        if place <= end:
            depth: int = min(place - begin, end - place) if place >= begin else -min(gap, begin - place)
            return depth
        gap = place - end
    return -gap


@kernel
def centre_distance(pool: IntArray, cells: IntArray, pitch: FloatArray, tick: float, segments: int, x: int, y: int, z: int) -> float:
    """Signed distance [m] of a cell centre to the surface, positive inside, from the three lines through it; exact for a plane.

    With distances d_x, d_y, d_z along the lines to a plane, 1/d^2 = 1/d_x^2 + 1/d_y^2 + 1/d_z^2. The centre may lie outside
    of the box, where only lines that go through the box count.
    """
    total = 0.0
    signed = 0.0
    per_tick = 1.0 / tick
    for k in range(3):
        if k != 0 and (x < 0 or x >= cells[0]):
            continue
        if k != 1 and (y < 0 or y >= cells[1]):
            continue
        if k != 2 and (z < 0 or z >= cells[2]):
            continue
        n = x if k == 0 else (y if k == 1 else z)
        place = math.floor((n + 0.5) * pitch[k] * per_tick + 0.5)
        d = depth_in_line(pool, word_of(line_of(cells, k, x, y, z), segments), segments, place)
        reach = (abs(d) if d != 0 else 1) * tick
        weight = 1.0 / (reach * reach)
        total += weight
        signed += weight if d > 0 else -weight
    far = FAR * max(pitch[0], pitch[1], pitch[2])
    size = far if total * far * far <= 1.0 else 1.0 / math.sqrt(total)
    return size if signed > 0.0 else -size


@kernel
def distance(
    pool: IntArray,
    cells: IntArray,
    origin: FloatArray,
    pitch: FloatArray,
    tick: float,
    segments: int,
    px: float,
    py: float,
    pz: float,
) -> float:
    """Signed distance [m] of a point of P to the surface, positive inside: linear between cell centres, at most FAR cells."""
    u = (px - origin[0]) / pitch[0] - 0.5
    v = (py - origin[1]) / pitch[1] - 0.5
    w = (pz - origin[2]) / pitch[2] - 0.5
    if not (u > -FAR and v > -FAR and w > -FAR and u < cells[0] + 1.0 and v < cells[1] + 1.0 and w < cells[2] + 1.0):
        outside: float = -FAR * max(pitch[0], pitch[1], pitch[2])
        return outside
    x, y, z = math.floor(u), math.floor(v), math.floor(w)
    u -= x
    v -= y
    w -= z
    result = 0.0
    for c in range(2):
        for b in range(2):
            for a in range(2):
                share = (u if a == 1 else 1.0 - u) * (v if b == 1 else 1.0 - v) * (w if c == 1 else 1.0 - w)
                if share > 0.0:
                    result += share * centre_distance(pool, cells, pitch, tick, segments, x + a, y + b, z + c)
    return result


@kernel
def cut(
    pool: IntArray,
    cells: IntArray,
    origin: FloatArray,
    pitch: FloatArray,
    tick: float,
    segments: int,
    tip: FloatArray,
    axis: FloatArray,
    radius: float,
    corner: float,
    point: FloatArray,
    found: FloatArray,
) -> bool:
    """Take what the cutter fills with its tip at `tip` out of the lines; False if the pool is full.

    `found[0]` becomes the greatest height [m] above the tip, along the tool axis, at which material was met, if it is more;
    `found[1 + k]` grows by the volume [m3] that the lines along axis k lose. `point` (3,) is scratch.
    """
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        # the box of the cutter: beside its axis by the radius, and up the axis as far as it goes
        u_first, u_last = shadow(i, cells, origin, pitch, tip, axis, radius)
        v_first, v_last = shadow(j, cells, origin, pitch, tip, axis, radius)
        base = line_of(cells, k, 0, 0, 0)
        length = cells[k] * pitch[k]
        lost = 0
        thin = math.floor(THIN / tick)
        point[k] = origin[k]
        for b in range(v_first, v_last + 1):
            point[j] = origin[j] + (b + 0.5) * pitch[j]
            for a in range(u_first, u_last + 1):
                first = word_of(base + b * cells[i] + a, segments)
                if pool[first] == 0:
                    continue
                point[i] = origin[i] + (a + 0.5) * pitch[i]
                low, high = chord(k, point, length, tip, axis, radius, corner)
                if low >= high:
                    continue
                begin, end = math.floor(low / tick + 0.5), math.floor(high / tick + 0.5)
                at, room = block(pool, first, segments)
                taken, first_taken, last_taken = _subtract(pool, at, room, begin, end, thin)
                if taken < 0:
                    if not _grow(pool, first, segments):
                        return False
                    at, room = block(pool, first, segments)
                    taken, first_taken, last_taken = _subtract(pool, at, room, begin, end, thin)
                if taken > 0:
                    lost += taken
                    w = 0.0
                    for c in range(3):
                        w += (point[c] - tip[c]) * axis[c]
                    found[0] = max(found[0], w + max(axis[k] * first_taken * tick, axis[k] * last_taken * tick))
        found[1 + k] += lost * tick * pitch[i] * pitch[j]
    return True


@kernel
def sweep(
    pool: IntArray,
    cells: IntArray,
    origin: FloatArray,
    pitch: FloatArray,
    tick: float,
    segments: int,
    tip_a: FloatArray,
    axis_a: FloatArray,
    tip_b: FloatArray,
    axis_b: FloatArray,
    cut_at_a: bool,
    radius: float,
    corner: float,
    reach: float,
    tip: FloatArray,
    axis: FloatArray,
    point: FloatArray,
    found: FloatArray,
) -> bool:
    """Take out of the lines what the cutter fills on its way from a to b; False if the pool is full.

    The cutter is taken out at positions so close that the ridges between them stay below SCALLOP, up to `reach` [m] along its
    axis if that turns. `cut_at_a`: this has been done at a, the end of the last step. tip, axis, point (3,) are scratch; `found`
    is set to zero and filled as in `cut`.
    """
    way = 0.0
    tilt = 0.0
    for i in range(3):
        way += (tip_b[i] - tip_a[i]) * (tip_b[i] - tip_a[i])
        tilt += (axis_b[i] - axis_a[i]) * (axis_b[i] - axis_a[i])
    way = math.sqrt(way) + reach * math.sqrt(tilt)
    pieces = math.floor(way / math.sqrt(8.0 * radius * SCALLOP)) + 1
    for i in range(4):
        found[i] = 0.0
    for n in range(1 if cut_at_a else 0, pieces + 1):
        share = n / pieces
        length = 0.0
        for i in range(3):
            tip[i] = tip_b[i] if n == pieces else tip_a[i] + share * (tip_b[i] - tip_a[i])
            axis[i] = axis_b[i] if n == pieces else axis_a[i] + share * (axis_b[i] - axis_a[i])
            length += axis[i] * axis[i]
        if n < pieces and length > 0.0:
            for i in range(3):
                axis[i] /= math.sqrt(length)
        if not cut(pool, cells, origin, pitch, tick, segments, tip, axis, radius, corner, point, found):
            return False
    return True


@kernel
def surface_between(pool: IntArray, first: int, segments: int, low: int, high: int) -> int:
    """Place of an end of an interval of a line between two places, the nearest to their middle; the middle if there is none."""
    middle = (low + high) // 2
    best = high - low
    place = middle
    at, room = block(pool, first, segments)
    for i in range(room):
        word = pool[at + i]
        if word == 0:
            break
        for side in range(2):
            end = word >> 32 if side == 0 else word & LOWER
            if end >= low and end <= high and abs(end - middle) < best:
                best = abs(end - middle)
                place = end
    return place


@kernel
def shadow(
    i: int, cells: IntArray, origin: FloatArray, pitch: FloatArray, tip: FloatArray, axis: FloatArray, radius: float
) -> tuple[int, int]:
    """First and last cell along axis i of P in which the part of the cutter within the box can be; first > last if there is none."""
    reach = 0.0  # how far up its axis the cutter can meet the box
    for c in range(3):
        edge = origin[c] + cells[c] * pitch[c] if axis[c] > 0.0 else origin[c]
        reach += max((edge - tip[c]) * axis[c], 0.0)
    side = radius * math.sqrt(max(1.0 - axis[i] * axis[i], 0.0))
    low = tip[i] + min(reach * axis[i], 0.0) - side - origin[i]
    high = tip[i] + max(reach * axis[i], 0.0) + side - origin[i]
    width = cells[i] * pitch[i]
    if high < 0.0 or low > width:
        return 0, -1
    low, high = max(low, 0.0), min(high, width)
    return max(math.ceil(low / pitch[i] - 0.5), 0), min(math.floor(high / pitch[i] - 0.5), cells[i] - 1)


@kernel
def _subtract(pool: IntArray, first: int, room: int, begin: int, end: int, thin: int) -> tuple[int, int, int]:
    """Take begin..end out of a line: ticks removed, where they begin and end. -1 and the line as it was if it has no room."""
    taken = 0
    low, high = end, begin
    i = 0
    while i < room:
        word = pool[first + i]
        if word == 0:
            break
        start, stop = word >> 32, word & LOWER
        if stop <= begin:
            i += 1
            continue
        if start >= end:
            break
        left = begin - start > thin
        right = stop - end > thin
        if left and right:
            if pool[first + room - 1] != 0:
                return -1, 0, 0
            for n in range(first + room - 1, first + i, -1):
                pool[n] = pool[n - 1]
            pool[first + i] = (start << 32) | begin
            pool[first + i + 1] = (end << 32) | stop
            return end - begin, begin, end
        low, high = min(low, max(start, begin)), max(high, min(stop, end))
        if left:
            pool[first + i] = (start << 32) | begin
            taken += stop - begin
            i += 1
        elif right:
            pool[first + i] = (end << 32) | stop
            taken += end - start
            i += 1
        else:
            taken += stop - start
            for n in range(first + i, first + room - 1):
                pool[n] = pool[n + 1]
            pool[first + room - 1] = 0
    return taken, low, high
