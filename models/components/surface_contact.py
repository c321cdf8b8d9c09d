"""Component surface_contact: a stylus with its own stiffness against a surface that the robot does not know.

The surface is an edge: a polyline in the plane z = 0 of P, extruded along z, with the material on the left of its direction.
For the tip at p, the nearest point c of the edge and the unit normal n out of the material there::

    distance   d = (p - c) . n - r                      < 0: pressed in by -d
    normal     F = max(0, k (-d) + c_n (-d)')           only while d < 0
    friction   F_t = -mu F v_t / max(|v_t|, v_s)        v_t: velocity along the surface (Coulomb, straight through zero)

Pan et al. 2008 (paper 003), section 3.2: the tool fixture in constant contact with the real part. Forces act on the tool.
"""

from __future__ import annotations

import math

import numpy as np

from robomill.models.maths.frames import dot, mat_t_vec, mat_vec, quat_to_matrix
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.model.table_access import cell

COLUMNS = 2
TOO_SHORT, DOUBLE_POINT = 1, 2
_AT_ONCE = 256
"""Points whose distances are found at once."""
_TOUCHING = 1e-9
"""Distance [m] from the edge below which the normal is that of the edge: the direction to the nearest point is roundoff."""


@kernel
def _edge(s: Record, row: int, column: int) -> float:
    """Coordinate x (column 0) or y (column 1) [m] in P of a point of the edge."""
    return cell(s.contour_at, s.contour_rows, COLUMNS, row, column)


@kernel
def _outward(s: Record, i: int) -> tuple[float, float]:
    """Unit normal, out of the material, of the piece from point i to point i + 1."""
    dx, dy = _edge(s, i + 1, 0) - _edge(s, i, 0), _edge(s, i + 1, 1) - _edge(s, i, 1)
    length = math.sqrt(dx * dx + dy * dy)
    return dy / length, -dx / length


@kernel
def _square(s: Record, i: int, x: float, y: float) -> tuple[float, float]:
    """Squared distance [m2] of (x, y) from the piece behind point i, and where on it (0..1) the nearest place is."""
    ax, ay = _edge(s, i, 0), _edge(s, i, 1)
    dx, dy = _edge(s, i + 1, 0) - ax, _edge(s, i + 1, 1) - ay
    t = min(max(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0.0), 1.0)
    ex, ey = x - ax - t * dx, y - ay - t * dy
    return ex * ex + ey * ey, t


@kernel
def nearest(s: Record, x: float, y: float) -> float:
    """Signed distance [m] of (x, y) [m] in P from the edge, > 0 outside of the material; sets s.normal_P, unit, out of the material.

    The result depends on the place alone: the piece found last only says from which distance on pieces need no closer look.
    At a corner the sum of the two normals says which side it is.
    """
    last = int(s.contour_rows) - 1
    near = math.sqrt(_square(s, int(s.piece), x, y)[0]) + s.longest
    enough = near * near * (1.0 + _TOUCHING)
    best, piece, share = math.inf, 0, 0.0
    for i in range(last):
        ex, ey = x - _edge(s, i, 0), y - _edge(s, i, 1)
        if ex * ex + ey * ey <= enough:
            square, t = _square(s, i, x, y)
            if square < best:
                best, piece, share = square, i, t
    s.piece = piece
    ax, ay = _edge(s, piece, 0), _edge(s, piece, 1)
    ex = x - ax - share * (_edge(s, piece + 1, 0) - ax)
    ey = y - ay - share * (_edge(s, piece + 1, 1) - ay)
    nx, ny = _outward(s, piece)
    closed = _edge(s, 0, 0) == _edge(s, last, 0) and _edge(s, 0, 1) == _edge(s, last, 1)
    other = piece
    if share == 0.0 and (piece > 0 or closed):
        other = piece - 1 if piece > 0 else last - 1
    elif share == 1.0 and (piece < last - 1 or closed):
        other = piece + 1 if piece < last - 1 else 0
    if other != piece:
        mx, my = _outward(s, other)
        length = math.sqrt((nx + mx) * (nx + mx) + (ny + my) * (ny + my))
        if length > _TOUCHING:
            nx, ny = (nx + mx) / length, (ny + my) / length
    away = math.sqrt(best)
    side = 1.0 if ex * nx + ey * ny >= 0.0 else -1.0
    if away > _TOUCHING:
        nx, ny = side * ex / away, side * ey / away
    s.normal_P[0] = nx
    s.normal_P[1] = ny
    s.normal_P[2] = 0.0
    return side * away


@kernel
def _to_part(s: Record) -> None:
    """Set s.p_P [m]: the tip in P."""
    for i in range(3):
        s.work[i] = s.p_BT_B[i] - s.p_BP_B[i]
    mat_t_vec(s.R_BP, s.work, s.p_P)


@kernel
def _touch(s: Record) -> None:
    """Outputs for the tip at s.p_P that moves at s.v_P [m/s]."""
    s.distance = nearest(s, s.p_P[0], s.p_P[1]) - s.tip_radius
    for i in range(3):
        s.work[i] = 0.0
    if s.distance < 0.0:
        outward = dot(s.v_P, s.normal_P)
        force = max(0.0, -s.stiffness * s.distance - s.damping * outward)
        for i in range(3):
            s.work[i] = force * s.normal_P[i]
        if s.friction != 0.0:
            speed = 0.0
            for i in range(3):
                s.v_t[i] = s.v_P[i] - outward * s.normal_P[i]
                speed += s.v_t[i] * s.v_t[i]
            speed = max(math.sqrt(speed), s.friction_speed)
            for i in range(3):
                s.work[i] -= s.friction * force * s.v_t[i] / speed
    mat_vec(s.R_BP, s.work, s.f_T_B)


def init(s: Record) -> int:
    """Tip at rest where it is."""
    rows = int(s.contour_rows)
    if rows < 2:
        return TOO_SHORT
    s.longest = 0.0
    for i in range(rows - 1):
        if _edge(s, i, 0) == _edge(s, i + 1, 0) and _edge(s, i, 1) == _edge(s, i + 1, 1):
            s.row = i
            return DOUBLE_POINT
        dx, dy = _edge(s, i + 1, 0) - _edge(s, i, 0), _edge(s, i + 1, 1) - _edge(s, i, 1)
        s.longest = max(s.longest, math.sqrt(dx * dx + dy * dy))
    s.piece = 0
    quat_to_matrix(s.quat_BP, s.R_BP)
    for i in range(3):
        s.v_P[i] = 0.0
    _to_part(s)
    _touch(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Force at t + h with the tip where it is then; its velocity is the way since t over h."""
    for i in range(3):
        s.v_P[i] = s.p_P[i]
    _to_part(s)
    for i in range(3):
        s.v_P[i] = (s.p_P[i] - s.v_P[i]) / h
    _touch(s)
    return 0


def signed_distances(contour: FloatArray, points: FloatArray) -> FloatArray:
    """Signed distances [m] of `points` (n, 2) from the edge `contour` (m, 2), both [m] in P; > 0 outside of the material."""
    a, d = contour[:-1], np.diff(contour, axis=0)
    square = (d**2).sum(axis=1)
    longest = math.sqrt(square.max())
    normal = np.column_stack([d[:, 1], -d[:, 0]]) / np.sqrt(square)[:, None]
    closed = bool(np.all(contour[0] == contour[-1]))
    before, after = np.roll(normal, 1, axis=0), np.roll(normal, -1, axis=0)
    if not closed:
        before[0], after[-1] = normal[0], normal[-1]
    result = np.empty(len(points))
    for first in range(0, len(points), _AT_ONCE):
        some = points[first : first + _AT_ONCE]
        middle = some.mean(axis=0)
        far = np.hypot(*(a - middle).T)
        # the nearest piece of each point begins within this circle: points near to each other have few pieces to look at
        one = np.flatnonzero(far <= far.min() + 2.0 * np.hypot(*(some - middle).T).max() + longest)
        x, y = some[:, :1] - a[one, 0], some[:, 1:] - a[one, 1]
        share = np.clip((x * d[one, 0] + y * d[one, 1]) / square[one], 0.0, 1.0)
        x -= share * d[one, 0]
        y -= share * d[one, 1]
        k = np.argmin(x**2 + y**2, axis=1)
        row = np.arange(len(some))
        i, at = one[k], share[row, k, None]
        n = normal[i] + np.where(at == 0.0, before[i], np.where(at == 1.0, after[i], 0.0))
        away = np.column_stack([x[row, k], y[row, k]])
        result[first : first + _AT_ONCE] = np.copysign(np.hypot(*away.T), (away * n).sum(axis=1))
    return result


MODEL = Model(
    name="surface_contact",
    description="Stylus against an unknown surface: stiffness, damping, Coulomb friction (Pan et al. 2008, section 3)",
    variables=(
        Variable("p_BT_B", "input", "Position of the stylus tip", "m", (3,), display_unit="mm"),
        Variable("f_T_B", "output", "Force on the tool at T, in B", "N", (3,)),
        Variable("distance", "output", "From the surface of the tip to the part, negative where it is pressed in", "m", display_unit="mm"),
        Variable(
            "contour",
            "parameter",
            "The surface: rows x, y [m] in P of an edge along z of P, material on the left of its direction",
            "1",
            (COLUMNS,),
            kind="table",
        ),
        Variable("p_BP_B", "parameter", "Part frame P from base B", "m", (3,), display_unit="mm"),
        Variable("quat_BP", "parameter", "Orientation of P in B, unit quaternion (w, x, y, z)", "1", (4,), (1, 0, 0, 0), -1.0, 1.0),
        Variable("tip_radius", "parameter", "Radius of the stylus tip", "m", (), 1e-3, 0.0, 0.1, display_unit="mm"),
        Variable("stiffness", "parameter", "Stylus and surface in series, normal to the surface", "N/m", (), 1e5, 1.0, 1e9),
        Variable("damping", "parameter", "Damping of the contact, normal to the surface", "N.s/m", (), 0.0, 0.0),
        Variable("friction", "parameter", "Coefficient of Coulomb friction", "1", (), 0.0, 0.0, 2.0, effect=True),
        Variable("friction_speed", "parameter", "Speed below which friction goes straight through zero", "m/s", (), 5e-4, 1e-9),
        Variable("p_P", "state", "Tip in P", "m", (3,)),
        Variable("v_P", "state", "Velocity of the tip in P", "m/s", (3,)),
        Variable("v_t", "state", "Scratch: velocity along the surface", "m/s", (3,)),
        Variable("normal_P", "state", "Normal of the surface at the tip, out of the material", "1", (3,)),
        Variable("work", "state", "Scratch", "1", (3,)),
        Variable("R_BP", "state", "Orientation of P in B", "1", (3, 3)),
        Variable("longest", "state", "Longest piece of the contour", "m"),
        Variable("piece", "state", "Piece of the contour that is nearest", kind="integer"),
        Variable("row", "state", "Row of the contour, for the message", kind="integer"),
    ),
    init=init,
    step=step,
    errors=(
        "",
        "the contour has {contour_rows} points, expected at least 2: name a table of rows x, y [m] as parameter 'contour'",
        "the contour has the same point in row {row} (counted from zero) and in the next; expected different ones: drop one of them",
    ),
    default_tables={"contour": np.array([[-0.1, 0.0], [0.1, 0.0]])},
)
