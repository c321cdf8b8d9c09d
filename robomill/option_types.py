"""Types of options on the command line."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from typing import Any

_PLAIN = re.compile(r"\s*[-+]?[\d.]+([eE][-+]?\d+)?\s*")


def in_unit(unit: str) -> Callable[[str], float]:
    """A number in `unit`, which the help of the option names, or a text with another unit."""

    def read(text: str) -> float:
        from robomill.models.model.units import convert  # with NumPy, which `--help` does without
        from robomill.orchestration.system.parameters import quantity

        try:
            return quantity(text, "1" if _PLAIN.fullmatch(text) else unit, convert)
        except ValueError as error:
            raise argparse.ArgumentTypeError(f"{error} (a plain number is in {unit})") from None

    return read


def probability(text: str) -> float:
    """A number between 0 and 1, both excluded."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no probability between 0 and 1, such as 0.02")
    return value


def add_overwrite(parser: Any, what: str = "results") -> None:
    """`--overwrite`: what is there is replaced only where somebody says so."""
    parser.add_argument("--overwrite", action="store_true", help=f"replace {what} that are there (default: that is refused)")


def add_machine(parser: Any) -> None:
    """`--robot` and `--tool` of what was measured."""
    parser.add_argument("--robot", metavar="NAME", help="name of models/data/robots or a .toml file (default: what the set or run says)")
    parser.add_argument("--tool", metavar="NAME", help="name of models/data/tools or a .toml file (default: what the set or run says)")
