"""Probabilities in words."""

from __future__ import annotations

from robomill.diagnosis.inference.machines import MACHINES
from robomill.report.units import percent

LIKELIHOOD = (
    (0.99, "practically certain"),
    (0.9, "very likely"),
    (0.66, "likely"),
    (0.33, "about as likely as not"),
    (0.1, "unlikely"),
    (0.01, "very unlikely"),
    (0.0, "practically excluded"),
)
"""Least probability [1] of each word: the scale of the IPCC (Mastrandrea et al. 2010, guidance note on uncertainties)."""
RARE = 0.1
"""Probability [1] below which `1 in 20` is easier to read than a percentage: a choice of words, no decision rests on it."""


def likelihood(p: float) -> str:
    """`very likely (94 %)`."""
    return f"{next(word for least, word in LIKELIHOOD if p >= least)} ({percent(p)})"


def one_in(p: float) -> str:
    """`1 in 50` of something rare, a percentage otherwise."""
    return f"1 in {1.0 / p:.0f}" if 0.0 < p < RARE else percent(p)


def rank(p: float) -> str:
    """The part of the simulated machines that look like this one: `1 in 50`, or that there was none among them."""
    return f"fewer than 1 in {MACHINES}" if round(p * (MACHINES + 1)) <= 1 else one_in(p)
