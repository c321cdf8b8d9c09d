"""Units that an FMU names as it likes and defines by base units (FMI 2.0, 2.2.2; FMI 3.0, 2.4.4)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robomill.orchestration.system.parameters import Convert

_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


def by_definition(convert: Convert, definitions: Mapping[str, Any]) -> Convert:
    """`convert`, and where it cannot express a value in a wanted unit, the way over the base units that `definitions` give for that one.

    Definitions are those of FMPy by name of the unit: value in base units = factor * value + offset. One without base units says nothing.
    """

    def converted(value: float, unit: str, wanted: str) -> float:
        try:
            return convert(value, unit, wanted)
        except ValueError as error:
            base: Any = getattr(definitions.get(wanted), "baseUnit", None)
            powers = {name: int(getattr(base, name, None) or 0) for name in _BASE}
            product = ".".join(f"{name}{power}" for name, power in powers.items() if power)
            if not unit or not product:
                raise
            try:
                si = convert(value, unit, product)
            except ValueError:
                raise error from None
            return (si - float(base.offset or 0.0)) / float(base.factor or 1.0)

    return converted if definitions else convert
