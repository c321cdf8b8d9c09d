"""Random numbers without a generator: a hash of (seed, counter, channel).

A component that draws noise keeps only a seed and a step counter in its record, so a restored
state continues with the same numbers, two instances do not disturb each other, and plain Python,
compiled code and every FMU draw the same bits. All products stay below 2**63, so that no integer
overflows in compiled code.
"""

from __future__ import annotations

import math

from robomill.models.maths.elementary import TWO_PI, log, sincos
from robomill.models.model.declaration import kernel

_MASK = 0xFFFFFFFF


@kernel
def mix(x: int) -> int:
    """A bijection of 32-bit integers in which every input bit changes every output bit with odds near 1/2.

    Shift-multiply mixer; both multipliers are below 2**31 (see the module's text). `x` in 0 .. 2**32 - 1.
    """
    x = ((x ^ (x >> 16)) * 0x21F0AAAD) & _MASK
    x = ((x ^ (x >> 15)) * 0x735A2D97) & _MASK
    return x ^ (x >> 15)


@kernel
def uniform(seed: int, counter: int, channel: int) -> float:
    """A number in the open interval (0, 1), uniform with 32 bits; all arguments non-negative integers."""
    x = mix((seed + 0x9E3779B9) & _MASK)
    x = mix((x + counter + 0x3C6EF372) & _MASK)
    x = mix((x + channel + 0x1B873593) & _MASK)
    return (float(x) + 0.5) / 4294967296.0


@kernel
def normal_pair(seed: int, counter: int, channel: int) -> tuple[float, float]:
    """Two independent standard normal numbers (Box & Muller 1958); |value| < 6.8."""
    radius = math.sqrt(-2.0 * log(uniform(seed, counter, 2 * channel)))
    sine, cosine = sincos(TWO_PI * uniform(seed, counter, 2 * channel + 1))
    return radius * cosine, radius * sine
