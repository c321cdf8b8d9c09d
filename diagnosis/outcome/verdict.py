"""Which of the answers it is, from what the best model leaves and where it holds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

from robomill.diagnosis.catalogue import Candidate
from robomill.diagnosis.inference.estimation import Fit, log_priors
from robomill.diagnosis.inference.search import SUBSTANTIAL, Search
from robomill.diagnosis.inference.time_varying import Changing
from robomill.diagnosis.inference.transfer import Transfer

Verdict = Literal["none", "identified", "ambiguous", "unknown", "bad_log"]

CLEAR, FIRM = 3.0, 8.0
"""Log of the odds that there is an effect at all, from which that is believed; below FIRM what new conditions gain or lose counts."""
FAINT = 0.4
"""Part of an expected gain above FIRM that an answer of such odds must have in new conditions, be it chance or not."""
LIKE_NOISE, AT_MOST = 1.2, 1.28
"""chi2, over that of noise, that two systems which are the same but for calibration usually leave, and that a model may leave whatever
its share is."""
UNKNOWN = 1.4
"""chi2, over that of noise, from which there is a gap even if no candidate explains any of it (in new conditions: any more of it)."""
UNEXPLAINED = 0.3
"""Share of chi2 beyond noise (calibration fitted) that an adequate model may leave, in diagnosed runs and in new conditions."""
KEPT = 0.4
"""Part of its gain in evidence that a model must keep in parts of the time that it is not fitted to, where more than noise is left; and
as much more as the share that it leaves."""
WEAK, KEPT_BY_WEAK = 100.0, 0.5
"""Gain in evidence [nats] up to which a model must keep this part of it there, whatever is left, if new conditions do not tell."""
CHANGES, AS_LIKELY = 10.0, 3.0
"""Gain [nats] by which something must change with time to be believed to, and log of the odds that the best model may have against it."""
IDENTIFIED = 0.8
"""Probability from which one answer is given."""


def over_noise(search: Search, fit: Fit) -> float:
    """chi2 that a model leaves, over that which noise alone is expected to leave."""
    return fit.chi2 / float(search.evidence.expected.sum())


def unexplained(before: float, after: float) -> float:
    """Share of chi2 beyond that of a machine without effects that a model leaves: (after - LIKE_NOISE) / (before - LIKE_NOISE).

    `before`, `after`: what the nominal system and the model leave, over that of noise (`over_noise`); the share is not below 0.
    """
    return max(after - LIKE_NOISE, 0.0) / max(before - LIKE_NOISE, 1e-9)


def judged(
    search: Search,
    nominal: Fit,
    best: Fit,
    nothing: float,
    moved: Transfer | None,
    other: Changing | None,
    probabilities: Mapping[Candidate, float],
    faulty: bool,
) -> Verdict:
    """The verdict; `nothing`: probability of the nominal model, `moved`: what the best one is worth in new conditions.

    `other`: an effect that changes with time. `faulty`: a fault of the log is part of the best one.
    """
    if not best.model or not believed(nothing, moved):
        return "unknown" if over_noise(search, nominal) > UNKNOWN else "none"
    if not _adequate(search, nominal, best, moved):
        return "unknown"
    if faulty:
        return "bad_log"
    if other is not None and changes(search, best, other):
        return "unknown"
    return "identified" if all(probabilities[c] >= IDENTIFIED for c in best.model) else "ambiguous"


def changes(search: Search, best: Fit, other: Changing) -> bool:
    """Whether something changes with time, which the best model does not: by its gain (CHANGES, SUBSTANTIAL) and its odds (AS_LIKELY)."""
    odds = best.log_evidence + log_priors([best.model], search.candidates)[0]
    beyond = best.chi2 - float(search.evidence.expected.sum())  # of what a strong effect leaves, something always goes with time
    return other.by_change > max(CHANGES, 0.5 * SUBSTANTIAL * beyond) and other.log_odds > odds - AS_LIKELY


def believed(nothing: float, moved: Transfer | None) -> bool:
    """Whether there is an effect at all: by the diagnosed runs, if that is not much together with new conditions, where it must hold."""
    odds = math.log((1.0 - nothing) / nothing) if nothing > 0.0 else math.inf
    if moved is None or odds >= FIRM:
        return odds >= CLEAR
    # where they could make an answer firm, one that rests on little else must not gain a small part of that only
    faint = moved.expected_gain > FIRM and moved.gain < FAINT * moved.expected_gain
    return moved.holds and not faint and odds + moved.gain >= CLEAR


def _adequate(search: Search, nominal: Fit, best: Fit, moved: Transfer | None) -> bool:
    """Whether the best model leaves little, and is the same everywhere."""
    before, after = over_noise(search, nominal), over_noise(search, best)
    share, kept = unexplained(before, after), search.kept(best)
    if after > AT_MOST and (share > UNEXPLAINED or kept < KEPT + share):
        return False
    stood = None if moved is None else stands(moved)
    return stood if stood is not None else best.log_evidence >= WEAK or kept >= KEPT_BY_WEAK


def stands(moved: Transfer) -> bool | None:
    """Whether a model stands the test of new conditions: it has its expected gain there, and leaves no large share.

    None where the effect would hardly show there: too little for a yes, but what is lost can still be a no.
    """
    if not moved.holds:
        return False
    if not moved.tells:
        return None
    return moved.after <= UNKNOWN or unexplained(moved.before, moved.after) <= UNEXPLAINED
