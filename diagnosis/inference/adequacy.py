"""Whether a model is right, or the nearest thing in the catalogue to something that is not in it: from what it leaves of a gap."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import betainc, log_ndtr, logsumexp, voigt_profile
from scipy.stats import norm

from robomill.diagnosis.candidates import LOGGING
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.evidence import FORM, TRUST, Evidence
from robomill.orchestration.slaves.protocol import FloatArray

LEVEL, SPREAD, CONDITIONS = 1.3, 0.3, 2
"""Level [1] that a right model leaves (`outcome.verdict.over_noise`), its standard deviation, and of how many conditions it is the worst.
Fitted to eleven machines without effects (twelve cells of both generators, development seed 101): 0.7 to 1.7 in the worst channel."""
UNKNOWN = LEVEL + 3.0 * SPREAD
"""Level [1] from which there is a gap even if no candidate explains any of it (`over_noise`): LEVEL and three times SPREAD."""
FALSE_ALARM = 0.02
"""Probability [1] of an effect on a machine that has none, where the user asks for no other (DIAGNOSIS: at most 2 % of the nulls)."""
COHERENT = 0.6
"""Part that counts of what all candidates together explain beyond noise (`Search.explainable`) [1]: what two formulations leave is more
like effects than noise is. Fitted to eleven machines without effects (decision 73)."""
MISFIT = 0.05
"""Largest mean share [1] of a gap that a right model leaves, because its law is not quite that of the machine: a fifth of the amplitude.
The smallest is TRUST^2."""
KEEPS = 0.5
"""Standard deviation of the amplitude of a stand-in in other conditions [1]: it does there what it does here more or less by half."""
HOLDS = 0.5
"""Probability [1] that a stand-in does in all conditions what the right effect does, more or less by no more than a law is off. Fitted to
the withheld effects of two development seeds: of nine stand-ins with a known amplitude in new conditions five kept it (decision 85)."""
MISJUDGED = 0.1
"""Calibrated numbers of a right model that are farther off than their tolerances say, in the mean [1] (judgement). Of measured quantities
many are: their differences over their stated uncertainties are often almost Cauchy (Bailey, R. Soc. Open Sci. 4 (2017) 160600)."""
EXACT = 0.005
"""As MISFIT, of what a fault of the log does: that a clock is late is no law that could be wrong."""


_UNSEEN = 1.0 - 1e-9
"""Variance from which the data say nothing of a number whose variance was 1."""


def misfit(fit: Fit) -> float:
    """Largest mean share [1] of a gap that this model leaves where it is right: EXACT of what its faults of the log do, MISFIT of the rest.

    What an effect does is the square of its part of the signature (`Fit.signatures`); parts that are not known do alike.
    """
    does = {c: float(part @ part) for c, part in fit.signatures().items()} or dict.fromkeys(fit.model, 1.0)
    total = sum(does.values())
    share = sum(x for c, x in does.items() if c.component == LOGGING) / total if total > 0.0 else 0.0
    return EXACT * share + MISFIT * (1.0 - share)


def agreement(amplitudes: FloatArray, precisions: FloatArray, misfit: float = MISFIT) -> float:
    """Log Bayes factor for a right model against a stand-in, from the amplitudes a that its signature has in several conditions, [k] each.

    Right: a_i ~ N(m, 1 / precision_i + u), with the same m everywhere, which may be anything. A law that is off by a share u of what it
    does is off by the root of that in the amplitude; u is log-uniform between TRUST^2 and `misfit`, as in `left_by`. A stand-in: KEEPS^2
    in place of u.
    """

    def log_evidence(share: float) -> float:
        variance = 1.0 / precisions + share
        mean = float((amplitudes / variance).sum() / (1.0 / variance).sum())
        return -0.5 * float(np.log(variance).sum() + ((amplitudes - mean) ** 2 / variance).sum() + np.log((1.0 / variance).sum()))

    shown = precisions > 0.0
    amplitudes, precisions = amplitudes[shown], precisions[shown]
    if len(amplitudes) <= 1:
        return 0.0
    shares, weights = _shares(misfit)
    return float(logsumexp([log_evidence(u) for u in shares], b=weights)) - log_evidence(KEEPS * KEEPS)


def kept(odds: float) -> float:
    """Log Bayes factor for a right model against any stand-in, from that against one that does not hold elsewhere: `odds` [nats].

    A stand-in holds with probability HOLDS, see `unless`.
    """
    return unless(odds, HOLDS)


def unless(odds: float, chance: float) -> float:
    """Log Bayes factor for a right model against any stand-in, from that against one that does not do as well by chance: `odds` [nats].

    With this `chance` the data are as likely as with a right model: -log(chance + (1 - chance) exp(-odds)), at most -log chance.
    """
    return -float(np.logaddexp(math.log(chance), math.log1p(-chance) - odds)) if chance > 0.0 else odds


def by_chance(room: float, kinds: int = 1) -> float:
    """Probability [1] that a stand-in leaves no more than a right model may (MISFIT), beyond what `left_by` has of that.

    `room`: how many dimensions its numbers leave of those in which the effects of a system differ. Of a direction at random in these as
    much is left as Beta(room / 2, .) has. `left_by` has Beta(1, 2 `kinds` - 1): where the room is less than 2, the first 1 is room / 2.
    """
    others = 2 * kinds - 1
    narrow = betainc(min(0.5 * room, 1.0), others, MISFIT) if room > 0.0 else 1.0
    return float(narrow - betainc(1.0, others, MISFIT))


def in_common(values: FloatArray, deviations: FloatArray, scale: float) -> float:
    """Log Bayes factor for one number that all these [k] are estimates of, against one each; both N(0, scale^2) before the data.

    An estimate is off by its deviation, and by FORM of itself: a law is never quite the one that is fitted.
    """
    own = deviations**2 + (FORM * values) ** 2
    together = np.diag(own) + scale * scale
    apart = own + scale * scale
    one = values @ np.linalg.solve(together, values) + np.linalg.slogdet(together)[1]
    return 0.5 * float((values**2 / apart + np.log(apart)).sum() - one)


def unexplained(before: float, after: float) -> float:
    """Share of chi2 beyond that of a machine without effects that a model leaves: (after - LEVEL) / (before - LEVEL).

    `before`, `after`: what the nominal system and the model leave, over noise and discrepancy (`over_noise`); the share is not below 0.
    """
    return max(after - LEVEL, 0.0) / max(before - LEVEL, 1e-9)


def _shares(misfit: float) -> tuple[FloatArray, FloatArray]:
    """Shares by which laws are off, and their weights (Gauss-Legendre): log-uniform between TRUST^2 and `misfit`."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    return TRUST**2 * (misfit / TRUST**2) ** (0.5 * (nodes + 1.0)), 0.5 * weights


def left_by(before: float, after: float, misfit: float = MISFIT, kinds: int = 1, conditions: int = CONDITIONS) -> float:
    """Log Bayes factor for a right model against a stand-in, from what it leaves of a gap; both over noise.

    after ~ N(LEVEL + u (before - LEVEL), SPREAD^2), or the largest of `conditions` / CONDITIONS such levels. The share u that is left is
    Beta(1, 1 / m - 1) for a right model, of mean m. How far laws are off differs by orders of magnitude: m is log-uniform between TRUST^2
    and `misfit`. For a stand-in u could be anything between 0 and 1. Each further one of several `kinds` of effects that were fitted
    together does what two such shares would: it is the least of 2 kinds - 1, Beta(1, 2 kinds - 1) (measured, decision 111).
    """
    gap = max(before - LEVEL, 0.0)
    centre, width = (after - LEVEL) / (gap + 1e-12), SPREAD / (gap + 1e-12)
    finely = np.concatenate(
        [np.linspace(0.0, 1.0, 201), TRUST**2 * np.geomspace(1e-3, TRUST**-2, 401), centre + width * np.linspace(-8.0, 8.0, 201)]
    )
    u = np.unique(np.clip(finely, 0.0, 1.0))
    z = (centre - u) / width
    log_likelihood = -0.5 * z * z + max(conditions / CONDITIONS - 1.0, 0.0) * log_ndtr(z)
    step = np.log(np.convolve(np.diff(u), [0.5, 0.5]))  # of the trapezoidal rule
    shares, weights = _shares(misfit)
    b = 1.0 / shares[:, None] - 1.0
    rest = np.log(np.maximum(1.0 - u, 1e-300))
    right = logsumexp(np.log(weights[:, None] * b) + (b - 1.0) * rest, axis=0)
    other = math.log(2 * kinds - 1) + (2 * kinds - 2) * rest
    return float(logsumexp(log_likelihood + right + step) - logsumexp(log_likelihood + other + step))


def most_left(looks: Sequence[tuple[float, float]], elsewhere: float = 0.0) -> float:
    """Log Bayes factor for a right model against a stand-in [nats], from several looks at what it leaves of one gap.

    Each look has its log Bayes factor, and that which it would have if nothing were left (`left_by`). The look with the largest gap is
    the sharpest. The share that is left is the largest that any of them sees: what the others close is no merit, where a catalogue has
    nothing for the rest. `elsewhere`: what the look in new conditions loses, 0 or less (`Transfer.loses`).
    """
    return max(most for _, most in looks) + min(elsewhere, *(odds - most for odds, most in looks))


def worsened(evidence: Evidence, nominal: FloatArray, left: FloatArray, signature: FloatArray) -> float:
    """Log Bayes factor for a right model against a stand-in [nats], from the channel that the model makes worse by most.

    `nominal`, `left` [n]: what the nominal system and the model leave; `signature` [n]: what the model does.

    A law that is a little off leaves a share of what it does in a channel, as in `left_by`. Where the nominal system has no gap, that is
    all that is there. A stand-in may do there whatever it must do to explain the other channels. What both leave is no part of it: a gap
    between two formulations does not count.
    """
    more = evidence.levels(left) - np.maximum(evidence.levels(nominal), LEVEL)
    worst = float(np.max(more, initial=0.0))
    if worst <= 0.0:
        return 0.0
    does = float(evidence.does(signature)[np.unravel_index(int(more.argmax()), more.shape)])
    return left_by(does, LEVEL + worst, conditions=len(evidence.space.blocks))


def together(overall: float, worse: float) -> float:
    """Log Bayes factor [nats] from what is left over all and from what is made worse: the latter may only refute.

    A gap that is closed is one thing, another that is made is a second one; what is left of it, where it is that, counts once.
    """
    return max(overall, 0.0) + min(overall, worse, 0.0)


def beyond(count: int, probability: float) -> float:
    """Standard deviations beyond which one of `count` standard normal numbers is with at most this probability (Bonferroni)."""
    return float(norm.isf(0.5 * probability / max(count, 1)))


def within_tolerances(means: FloatArray, covariance: FloatArray, guess: float = 1.0) -> float:
    """Log Bayes factor for a right model against a stand-in [nats], from how far its calibrated numbers are off.

    `means` [k], `covariance` [k, k]: posterior of these numbers in standard deviations of their tolerances, by a prior N(0, I). A number
    that is farther off than is said of it is Cauchy. A stand-in moves about one number so far, a right model MISJUDGED. `guess`: factor on
    the variance of the data, where noise is a guess (`Evidence.guess`).

    Each of the k numbers is off with these odds over k. Where one explains what several seem to be off by, that counts once: the likeliest
    is set free, then the likeliest beside it, while Cauchy is likelier than normal. With S_j the sum of the ratios of these two, where
    j - 1 are free, j numbers that are off have the ratio S_1 S_2 ... S_j / j!. The others are as if each were alone.
    """
    seen = np.diag(covariance) < _UNSEEN
    means, covariance, k = means[seen], covariance[np.ix_(seen, seen)], int(seen.sum())
    data = np.linalg.inv(covariance) - np.eye(k)  # what the data alone say
    towards, precision = (data @ means + means) / guess, data / guess + np.eye(k)
    off, ratios = [0.0], np.zeros(0)
    free = np.zeros(k, dtype=bool)
    while not free.all():
        inverse = np.linalg.inv(precision)
        there, unknown = (inverse @ towards)[~free], np.diag(inverse)[~free]
        known = unknown < _UNSEEN
        ratios = np.zeros(len(there))
        ratios[known] = _cauchy(there[known] / (1.0 - unknown[known]), unknown[known] / (1.0 - unknown[known]))
        likeliest = int(ratios.argmax())
        if ratios[likeliest] <= 0.0:
            break
        off.append(off[-1] + float(logsumexp(ratios)) - math.log(len(off)))
        place = np.flatnonzero(~free)[likeliest]
        free[place] = True
        precision[place, place] -= 1.0
        ratios = np.delete(ratios, likeliest)

    def log_evidence(odds: float) -> float:
        terms = [x + j * math.log(odds / k) for j, x in enumerate(off)]
        terms[-1] += float(np.log1p(odds / k * np.exp(ratios)).sum())
        return float(logsumexp(terms)) - k * math.log1p(odds / k)

    return log_evidence(MISJUDGED) - log_evidence(1.0) if k else 0.0


def _cauchy(values: FloatArray, variances: FloatArray) -> FloatArray:
    """Log Bayes factor for Cauchy against N(0, 1), of numbers that were found to be these, with these variances: [k]."""
    return np.asarray(np.log(voigt_profile(values, np.sqrt(variances), 1.0)) - norm.logpdf(values, scale=np.sqrt(variances + 1.0)))
