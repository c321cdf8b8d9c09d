"""What counts as right, case by case. The first effect of a case is the one that is asked for."""

from __future__ import annotations

from robomill.blind.case import Case
from robomill.blind.prediction import Candidate, Named

AXES = ("x", "y", "z")
WRENCH_CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def component_right(c: Case) -> bool:
    """Whether the component is named first."""
    return c.prediction.component == c.effects[0].component


def location_right(c: Case) -> bool:
    """Component and element: by `where`, if it gives a location, else by the first effect's element."""
    true, p = c.effects[0], c.prediction
    if not component_right(c):
        return False
    if p.location:
        return p.location in location_names(true)
    return bool(p.which) and any(n.index == true.index for n in p.which[0].names)


def location_names(true: Named) -> tuple[str, ...]:
    """What an element of an effect may be called."""
    if true.effect == "sensor_gain_error_axis":
        return (WRENCH_CHANNELS[true.index - 1],)
    if true.effect == "geometry_error":
        return (("link arm", "forearm")[true.index - 1],)
    if true.effect in ("base_compliance", "zero_drift", "misalignment", "frame_error"):
        return (AXES[true.index - 1],)
    return (f"joint {true.index}", f"axis {true.index}", f"A{true.index}")


def effect_in_top(c: Case, n: int) -> bool:
    """Whether the effect is among the first n of a case that is said to have one."""
    return c.prediction.found and any(e.is_effect(c.effects[0]) for e in c.prediction.which[:n])


def named_exactly(c: Case) -> bool:
    """Whether what is claimed first is the effect, at its element; never where there is no catalogue effect."""
    return bool(c.effects and c.prediction.claimed) and c.prediction.claimed[0].is_exactly(c.effects[0])


def set_holds_truth(c: Case) -> bool:
    """Whether the set of an ambiguous answer has the true effect in it: listed, or named as not to be told from a listed one."""
    true = c.effects[0]
    names = {
        true.effect,
        f"{true.effect}[{true.index}]",
        *(f"{true.effect} {at} {n}" for at in ("at", "@") for n in location_names(true) if true.index),
    }
    return any(e.is_effect(true) or names & set(e.confusable) for e in c.prediction.listed)


def estimate(c: Case, said: Candidate, i: int = 0) -> tuple[float, bool | None] | None:
    """Relative error of the parameter of effect `i`, and whether its interval covers the truth (None: none given); None without a value."""
    true, value = c.effects[i], c.truth.effects[i].value
    for name, given in said.parameters.items():
        if Named.of(true.component, name) == true and given.get("value") is not None:
            interval = given.get("interval")
            covered = None if interval is None else bool(interval[0] <= value <= interval[1])
            return abs(float(given["value"]) - value) / abs(value), covered
    return None


def fault_said(c: Case) -> bool:
    """Whether the fault of a bad log is said and does no harm.

    The log is stopped; or the repeat that was aborted, and no other, is named as such and left out: the rest is a good log.
    """
    aborted = c.truth.aborted_run
    return c.prediction.stopped or bool(aborted and c.prediction.left_out == {aborted})


def answer_right(c: Case) -> bool:
    """Whether a null is `none`, what is in no catalogue `unknown`, and of an effect the first that is named."""
    said = {"null": "none", "outside": "unknown", "formed": "unknown"}.get(c.kind)
    return c.prediction.verdict == said if said else effect_in_top(c, 1)
