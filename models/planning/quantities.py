"""What the motion of an axis is measured by."""

from __future__ import annotations

from typing import Literal, get_args

Quantity = Literal["speed", "acceleration", "jerk"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
