"""A load that is applied on purpose: a weight that hangs from the tool, a push, a staircase, a tap. For experiments without cutting.

Force and moment on the tool at T, in B, linear in time between the rows of a table; before its first and after its last row that row.
"""

from __future__ import annotations

from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.model.table_access import cell, row_at

COLUMNS = 7


@kernel
def _profile(s: Record, row: int, column: int) -> float:
    """A number of the table."""
    return cell(s.profile_at, s.profile_rows, COLUMNS, row, column)


@kernel
def _look_up(s: Record, t: float) -> int:
    """Load at time t [s] from row `row` on; status 1 if the times do not increase."""
    last = int(s.profile_rows) - 1
    if last < 0:
        for i in range(3):
            s.f_T_B[i] = 0.0
            s.m_T_B[i] = 0.0
        return 0
    row = row_at(s.profile_at, s.profile_rows, COLUMNS, t, int(s.row))
    s.row = row
    weight = 0.0
    if row < last and t > _profile(s, row, 0):
        weight = (t - _profile(s, row, 0)) / (_profile(s, row + 1, 0) - _profile(s, row, 0))
    for i in range(3):
        s.f_T_B[i] = _profile(s, row, 1 + i)
        s.m_T_B[i] = _profile(s, row, 4 + i)
        if weight > 0.0:
            s.f_T_B[i] += weight * (_profile(s, row + 1, 1 + i) - _profile(s, row, 1 + i))
            s.m_T_B[i] += weight * (_profile(s, row + 1, 4 + i) - _profile(s, row, 4 + i))
    return 0


def init(s: Record) -> int:
    """Load at t = 0."""
    for row in range(int(s.profile_rows) - 1):
        if _profile(s, row + 1, 0) <= _profile(s, row, 0):
            s.row = row
            return 1
    s.row = 0
    return _look_up(s, 0.0)


def step(s: Record, t: float, h: float) -> int:
    """Load at t + h [s]."""
    return _look_up(s, t + h)


MODEL = Model(
    name="applied_load",
    description="Force and moment that are applied to the tool on purpose, from a table",
    variables=(
        Variable("f_T_B", "output", "Force on the tool at T, in B", "N", (3,), depends_on=()),
        Variable("m_T_B", "output", "Moment on the tool at T, in B", "N.m", (3,), depends_on=()),
        Variable("profile", "parameter", "Rows: time [s], force [N] and moment [N.m] in B", "1", (COLUMNS,), kind="table"),
        Variable("row", "state", "Row of the table that the time is behind", "1", kind="integer"),
    ),
    init=init,
    step=step,
    errors=("", "the times of the profile do not increase from row {row} (counted from zero) to the next"),
)
