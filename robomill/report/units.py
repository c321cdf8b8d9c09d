"""Numbers as people read them: µrad, mm, ms instead of SI, with as many digits as the interval supports."""

from __future__ import annotations

import math
from collections.abc import Sequence

_SCALES: dict[str, tuple[tuple[float, float, str], ...]] = {
    "m": ((1e-3, 1e6, "µm"), (10.0, 1e3, "mm"), (math.inf, 1.0, "m")),
    "rad": ((2e-3, 1e6, "µrad"), (math.inf, 180.0 / math.pi, "°")),
    "s": ((1.0, 1e3, "ms"), (math.inf, 1.0, "s")),
    "m/N": ((1e-3, 1e6, "µm/N"), (math.inf, 1e3, "mm/N")),
    "rad/(N.m)": ((1e-6, 1e9, "nrad/(N m)"), (math.inf, 1e6, "µrad/(N m)")),
    "m/s": ((1.0, 1e3, "mm/s"), (math.inf, 1.0, "m/s")),
    "rad/s": ((math.inf, 30.0 / math.pi, "rpm"),),
    "N": ((1e4, 1.0, "N"), (math.inf, 1e-3, "kN")),
    "1": ((math.inf, 1.0, ""),),
    "%": ((1.0, 100.0, "%"), (math.inf, 1.0, "")),
}
"""unit -> sizes below which a factor and a symbol are used; "%" is a relative number that is shown as a percentage. Above all of it, it may
as well be a quantity whose unit nobody stated, as many FMUs do: then it is shown as a number."""

DECIMALS = 5
"""Behind the point, at most: a number that needs more is shown with an exponent."""
UNPARTED = 4
"""Digits before the point up to which a number is shown in one piece; those of a longer one are parted by threes."""
MANIFOLD = 10.0
"""Share from which the percentage says only that it is large: one of 1000 % is no share of something any more."""


def scale(unit: str, size: float) -> tuple[float, str]:
    """Factor and symbol for a quantity [unit] of that size; a unit that is not in the table stays, with spaces for its dots."""
    for bound, factor, symbol in _SCALES.get(unit, ()):
        if abs(size) < bound:
            return factor, symbol
    return 1.0, unit.replace(".", " ")


def relative(parameter: str, unit: str) -> str:
    """`%` for a parameter without a unit, which is an error or a share, unless it is an exponent."""
    return "%" if unit == "1" and "exponent" not in parameter else unit


def number(value: float, spacing: float | None = None) -> str:
    """A number with two digits of `spacing` (half an interval, say), or with three digits of its own."""
    if not math.isfinite(value):
        return "∞" if value > 0.0 else "−∞" if value < 0.0 else "–"
    if spacing is not None and 0.0 < spacing < math.inf:
        decimals = 1 - math.floor(math.log10(spacing) + 1e-9)
    else:
        decimals = 2 - (math.floor(math.log10(abs(value))) if value else 2)
    if decimals > DECIMALS:
        text = f"{value:.3g}"
    else:
        text = f"{value:.{max(decimals, 0)}f}"
    if not text.strip("-0."):
        text = text.lstrip("-")
    if "e" in text:  # the digits of an exponent are not parted
        return text.replace("-", "−")
    whole, point, rest = text.partition(".")
    digits = whole.lstrip("-")
    if len(digits) > UNPARTED:
        whole = whole[: len(whole) - len(digits)] + f"{int(digits):,}".replace(",", "\u202f")
    return (whole + point + rest).replace("-", "−")


def quantity(value: float, unit: str) -> str:
    """`0.0000802`, `rad` -> `80.2 µrad`."""
    factor, symbol = scale(unit, value)
    return join(number(factor * value), symbol)


def with_interval(value: float, interval: Sequence[float] | None, unit: str) -> tuple[str, str]:
    """Value and interval in the same unit with the same digits: (`80.2 µrad`, `79.1 to 81.3`)."""
    if interval is None:
        return quantity(value, unit), ""
    low, high = sorted(interval)
    factor, symbol = scale(unit, value)
    half = 0.5 * factor * (high - low)
    return join(number(factor * value, half), symbol), f"{number(factor * low, half)} to {number(factor * high, half)}"


def percent(share: float) -> str:
    """`0.937` -> `94 %`; a decimal where that is needed not to say 0 or 100 of something that is neither."""
    if abs(share) >= MANIFOLD:
        limit = f"{100.0 * MANIFOLD:.0f}"
        return join(f"over {limit}" if share > 0.0 else f"below −{limit}", "%")
    value = 100.0 * share
    plain, finer = f"{value:.0f}", f"{value:.1f}"
    if (plain == "100" and share < 1.0 and finer != "100.0") or (plain in ("0", "-0") and finer not in ("0.0", "-0.0")):
        plain = finer
    return join("0" if plain == "-0" else plain.replace("-", "−"), "%")


def percent_interval(interval: Sequence[float] | None) -> str:
    """`0.962, 0.984` -> `96 % to 98 %`; with a decimal where both ends are the same without; its width if they still are.

    Empty where there is none.
    """
    if interval is None:
        return ""
    low, high = (percent(x) for x in sorted(interval))
    if low == high and min(map(abs, interval)) >= MANIFOLD:
        return low
    if low == high:
        low, high = (join(f"{100.0 * x:.1f}".replace("-", "−"), "%") for x in sorted(interval))
    return join("within 0.1", "%") if low == high else f"{low} to {high}"


def join(text: str, symbol: str) -> str:
    """Number and symbol, not to be parted at the end of a line."""
    return f"{text}\u00a0{symbol}" if symbol and symbol != "°" else text + symbol
