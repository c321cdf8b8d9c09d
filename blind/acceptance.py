"""What DIAGNOSIS.md and DIAGNOSIS2.md ask for: which figures of which set, and their bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    "withheld_unknown_or_equivalent": Bound(0.85),
    "withheld_confident_wrong": Bound(high=0.05),
    "null_false_alarm": Bound(high=0.02),
    "null_false_alarm_1": Bound(high=0.02),
    "null_false_alarm_2": Bound(high=0.02),
    "null_false_alarm_3": Bound(high=0.02),
    "null_false_alarm_6": Bound(high=0.02),
    "bad_log_stopped": Bound(0.95),
    "good_log_stopped": Bound(high=0.01),
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
    "effects_with_detectable_cases": Bound(0.80),
    "machine_found": Bound(0.80),
    "machine_true": Bound(0.85),
    "machine_closure_over_ceiling_median": Bound(0.90),
    "form_closure_over_ceiling_median": Bound(0.60),
    "confident_wrong": Bound(high=0.05),
    "stiffness_placed": Bound(0.85),
    "ece": Bound(high=0.05),
}
"""Tier T1."""
T0: Mapping[str, Bound] = {"effect_top1": Bound(0.80), "ambiguity_median_size": Bound(high=4.0)}
"""Where tier T0 differs."""

_SINGLE = (
    "good_log_stopped",
    "detection",
    "component_top1",
    "location_top1",
    "effect_top1",
    "effect_top3",
    "ambiguity_holds_truth",
    "ambiguity_median_size",
    "next_run_separates",
    "false_unknown",
    "parameter_error_median",
    "parameter_error_p90",
    "interval_coverage",
    "closure_over_ceiling_median",
    "closure_over_ceiling_p10",
    "claimed_closure_error_median",
)
_UNKNOWN = ("unknown_recall", "confident_wrong_on_unknown")
ASKED: Mapping[str, Sequence[str]] = {
    "withheld": ("withheld_unknown_or_equivalent", "withheld_confident_wrong", "good_log_stopped"),
    "null": ("null_false_alarm", *(f"null_false_alarm_{n}" for n in (1, 2, 3, 6)), "good_log_stopped"),
    "single": (*_SINGLE, "effects_with_detectable_cases"),
    "machine": ("machine_found", "machine_true", "machine_closure_over_ceiling_median"),
    "few": ("confident_wrong", "interval_coverage", "good_log_stopped"),
    "campaign": ("stiffness_placed", "good_log_stopped"),
    "bad_log": ("bad_log_stopped",),
    "outside": (*_UNKNOWN, "good_log_stopped"),
    "formed": ("form_closure_over_ceiling_median", "good_log_stopped"),
    "mixed": (
        "null_false_alarm",
        "bad_log_stopped",
        *_SINGLE,
        *_UNKNOWN,
        "doubles_exact",
        "doubles_one_right",
        "doubles_nothing_invented",
    ),
}
"""Set -> figures with a bound. `ece` is asked for over all sets together."""
MARGIN = 15
"""Points by which the best of the baselines is to be beaten."""


def bound(key: str, tier: str) -> Bound | None:
    """What is asked for at a tier; None: nothing."""
    return T0.get(key, BOUNDS.get(key)) if tier == "T0" else BOUNDS.get(key)


def met(key: str, value: float | None, tier: str) -> bool | None:
    """Whether the value of a figure is accepted; None where nothing is asked for, or there were no cases."""
    asked = bound(key, tier)
    return None if asked is None or value is None else asked.holds(value)
