"""Types of options on the command line."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable

from robomill.models.model.units import convert
from robomill.orchestration.system.parameters import quantity

_PLAIN = re.compile(r"\s*[-+]?[\d.]+([eE][-+]?\d+)?\s*")


def in_unit(unit: str) -> Callable[[str], float]:
    """A number in `unit`, which the help of the option names, or a text with another unit."""

    def read(text: str) -> float:
        try:
            return quantity(text, "1" if _PLAIN.fullmatch(text) else unit, convert)
        except ValueError as error:
            raise argparse.ArgumentTypeError(f"{error} (a plain number is in {unit})") from None

    return read
