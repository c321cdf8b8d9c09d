"""The four classes of tolerance that tests may use; there are no loose numbers."""

EXACT = 0.0
"""Parity and determinism: the same bits."""

ROUNDOFF = 1e-12
"""Relative: two ways of writing the same arithmetic."""


def discretisation(constant: float, h: float, order: int) -> float:
    """Bound C * h**p of a scheme of order p; state where the constant comes from."""
    return constant * h**order


def physics(value: float, relative: float = 0.0, absolute: float = 0.0) -> float:
    """Half-width of the band that a published figure allows; state the source beside the call."""
    return abs(value) * relative + absolute
