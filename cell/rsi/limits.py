"""What is sent is bounded, whatever a controller wants: compiled loops over the values of one answer, and of the force that came."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from robomill.models.model.declaration import FloatArray

WholeArray = npt.NDArray[np.int64]
TOO_LARGE, FROZEN = 1, 2


def bound(
    wanted: FloatArray, held: FloatArray, failed: bool, share: float, limit: FloatArray, change: FloatArray, sent: FloatArray
) -> int:  # fmt: skip
    """Set `sent` [wire] from what is wanted, and return how many values were cut.

    After a fault: share * held instead, with what was sent when the fault came in `held`. Then each within +-limit and within `change` of
    what was sent before. A value that is not finite keeps what was sent before.
    """
    cut = 0
    for i in range(len(sent)):
        value = wanted[i]
        if failed:
            value = share * held[i]
        if not math.isfinite(value):
            value = sent[i]
            cut += 1
        given = max(-limit[i], min(limit[i], value))
        given = max(sent[i] - change[i], min(sent[i] + change[i], given))
        if given != value:
            cut += 1
        sent[i] = given
    return cut


def watch(values: FloatArray, first: WholeArray, most: FloatArray, frozen: WholeArray, still: WholeArray, last: FloatArray) -> int:
    """Look at vectors of sensors: values[first[k]:first[k + 1]] is vector k. Returns 0, or 2 k + TOO_LARGE or 2 k + FROZEN.

    Too large: its magnitude is above most[k]. Frozen: not zero and unchanged for frozen[k] calls; `still` counts them, `last` keeps it.
    """
    for k in range(len(most)):
        square = 0.0
        same = True
        for i in range(first[k], first[k + 1]):
            square += values[i] * values[i]
            if values[i] != last[i]:
                same = False
            last[i] = values[i]
        if not math.sqrt(square) <= most[k]:
            return 2 * k + TOO_LARGE
        still[k] = still[k] + 1 if same and square > 0.0 else 0
        if frozen[k] > 0 and still[k] >= frozen[k]:
            return 2 * k + FROZEN
    return 0
