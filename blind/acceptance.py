"""What DIAGNOSIS.md asks for, key by key."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Bound:
    """Least and largest value that is accepted."""

    low: float | None = None
    high: float | None = None

    def __str__(self) -> str:
        if self.low is not None and self.high is not None:
            return f"{self.low:g} .. {self.high:g}"
        return f"at least {self.low:g}" if self.low is not None else f"at most {self.high:g}"

    def holds(self, value: float) -> bool:
        """Whether a value is within."""
        return (self.low is None or value >= self.low) and (self.high is None or value <= self.high)


BOUNDS: Mapping[str, Bound] = {
    "null_false_alarm": Bound(high=0.02),
    "bad_log_stopped": Bound(0.95),
    "detection": Bound(0.95),
    "component_top1": Bound(0.90),
    "location_top1": Bound(0.85),
    "effect_top1": Bound(0.90),
    "effect_top3": Bound(0.97),
    "ambiguity_holds_truth": Bound(0.95),
    "ambiguity_median_size": Bound(high=2.0),
    "next_run_separates": Bound(0.90),
    "unknown_recall": Bound(0.85),
    "false_unknown": Bound(high=0.05),
    "confident_wrong_on_unknown": Bound(high=0.05),
    "doubles_exact": Bound(0.65),
    "doubles_one_right": Bound(0.95),
    "doubles_nothing_invented": Bound(0.85),
    "parameter_error_median": Bound(high=0.10),
    "parameter_error_p90": Bound(high=0.30),
    "interval_coverage": Bound(0.85, 0.95),
    "closure_over_ceiling_median": Bound(0.90),
    "closure_over_ceiling_p10": Bound(0.75),
    "claimed_closure_error_median": Bound(high=0.05),
    "ece": Bound(high=0.05),
}
"""Tier T1."""
T0: Mapping[str, Bound] = {"effect_top1": Bound(0.80), "ambiguity_median_size": Bound(high=4.0)}
"""Where tier T0 differs."""

MARGIN = 15
"""Points by which the best of the baselines is to be beaten."""


def bound(key: str, tier: str) -> Bound | None:
    """What is asked for at a tier; None: nothing."""
    return T0.get(key, BOUNDS.get(key)) if tier == "T0" else BOUNDS.get(key)


def met(key: str, value: float | None, tier: str) -> bool | None:
    """Whether the value of a figure is accepted; None where nothing is asked for, or there were no cases."""
    asked = bound(key, tier)
    return None if asked is None or value is None else asked.holds(value)
