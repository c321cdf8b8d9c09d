"""Looking up the row of a time in the series of `playback`, for Python and for Numba alike.

One array holds all: the head (rows n, columns m, adds, clamps, row where the last search ended), then per column whether it is held, the
inputs and the outputs [m each], the times [n] and the rows [n, m].
"""

from __future__ import annotations

from typing import Any

HEAD = 5
"""Numbers before the columns."""
BEFORE, AFTER = 1, 2
"""Status: the time is before the first row, or after the last one."""
SAME_TIME = 0.5e-9
"""Times that differ by less [s] are the same: half a tick of the master's clock."""


def look_up(a: Any, t: float) -> int:
    """Set the outputs to those of time `t` [s]; returns 0, BEFORE or AFTER."""
    same = SAME_TIME
    n, m = int(a[0]), int(a[1])
    times = HEAD + 3 * m
    k = int(a[4])
    # mostly it is the row found last, or the one after it
    if not (a[times + k] <= t + same and (k + 1 == n or t + same < a[times + k + 1])):
        if k + 1 < n and a[times + k + 1] <= t + same and (k + 2 == n or t + same < a[times + k + 2]):
            k += 1
        else:
            k, end = -1, n
            while end - k > 1:
                middle = (k + end) // 2
                if a[times + middle] <= t + same:
                    k = middle
                else:
                    end = middle
    status = 0
    part = 0.0
    if k < 0:
        k, status = 0, BEFORE
    elif t - a[times + k] > same:
        if k + 1 == n:
            status = AFTER
        else:
            part = (t - a[times + k]) / (a[times + k + 1] - a[times + k])
    a[4] = k
    row = times + n + k * m
    for i in range(m):
        y = a[row + i]
        if part > 0.0 and a[HEAD + i] == 0.0:
            y += part * (a[row + m + i] - y)
        a[HEAD + 2 * m + i] = y + a[HEAD + m + i] if a[2] else y
    return 0 if a[3] else status
