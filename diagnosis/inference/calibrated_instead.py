"""Models that have calibrated numbers in the place of one of their effects.

Slopes of calibrated numbers are those of the nominal system. Beside an effect that turns them, what a number does within its tolerance
would be given to another effect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robomill.diagnosis.candidates import Candidate, Nuisance, Prior
from robomill.diagnosis.inference.adequacy import FALSE_ALARM, beyond
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.fitting import SHARPENED, Fitting
from robomill.diagnosis.inference.sensitivities import WORTH


def calibrated_instead(fitting: Fitting, best: Fit) -> list[Fit]:
    """`best` without one of its effects, and with a calibrated number in its place, simulated; none where it has only one."""
    found = []
    for c in best.model if len(best.model) > 1 else ():
        rest = without_effect(best, c)
        found += [*_alike(fitting, best, c, rest), *_farthest(fitting, best, rest)]
    return found


def without_effect(fit: Fit, candidate: Candidate) -> Fit:
    """The model without one of its effects, as sensitivities have it: nothing is fitted again."""
    assert fit.signature is not None
    assert fit.sensitivities is not None
    order = [(c, a) for c in fit.model for a in c.addresses]
    here = [i for i, (c, _) in enumerate(order) if c == candidate]
    kept = [i for i, (c, _) in enumerate(order) if c != candidate]
    x = np.array([fit.values[a] / c.prior.scale for c, a in order])
    model = tuple(c for c in fit.model if c != candidate)
    values, deviations = ({a: known[a] for c in model for a in c.addresses} for known in (fit.values, fit.deviations))
    signature = fit.signature - fit.sensitivities[:, here] @ x[here]
    return Fit(model, values, deviations, -np.inf, np.inf, signature, fit.sensitivities[:, kept], form=fit.form)


def _alike(fitting: Fitting, best: Fit, c: Candidate, rest: Fit) -> list[Fit]:
    """A number that does the same as the effect, as far off as that does as much. Its law may be off as much as that of the effect."""
    found = []
    numbers = {n.address: n for n in fitting.nuisances if n.address not in best.calibrated}
    alike = fitting.evidence.space.alike.get(c.addresses[0], {}) if len(c.addresses) == 1 else {}
    for n, deviation in ((numbers[a], d) for a, d in alike.items() if a in numbers and d > 0.0):
        off = best.values[c.addresses[0]] / deviation * n.scale  # the same effect, or the opposite one
        for calibrated in ({**best.calibrated, n.address: sign * off} for sign in (1.0, -1.0)):
            signature = fitting.mean_signature(rest.values, calibrated)
            if signature is not None and rest.sensitivities is not None:
                found.append(fitting.about(replace(rest, calibrated=calibrated), signature, rest.sensitivities, best.form))
    return found


def _farthest(fitting: Fitting, best: Fit, rest: Fit) -> list[Fit]:
    """A number that is far off without the effect, within its tolerance, fitted as an effect is: with slopes of its own place.

    None is tried in the place of an effect without which the others explain little (WORTH).
    """
    (refitted,) = fitting.refine([rest])
    if refitted.signature is None or refitted.log_evidence < WORTH * best.log_evidence:
        return []
    numbers, means, covariance = fitting.numbers(refitted)
    far = beyond(len(numbers), FALSE_ALARM)
    within = [int(i) for i in np.argsort(-np.abs(means)) if abs(means[i]) < far]
    found = [
        _with_number(fitting, best, refitted, numbers[i], (float(means[i]), float(covariance[i, i]) ** 0.5), far)
        for i in within[:SHARPENED]
    ]
    return [f for f in found if f is not None]


def _with_number(fitting: Fitting, best: Fit, rest: Fit, n: Nuisance, seen: tuple[float, float], far: float) -> Fit | None:
    """A model fitted again with a calibrated number; None where the system cannot run.

    `seen`: how far off it is and how sure that is, as it begins [standard deviations]; `far`: most that it may be off.
    """
    space = fitting.evidence.space
    column = space.nuisances.along(np.array([name == n.address for name in space.names], dtype=np.float64))
    space.find_alike({n.address: column}, {n.address: n.scale})
    (component, parameter), prior = n.address, Prior("normal", n.scale)
    c = Candidate("tolerance", component, parameter, (parameter,), 0.0, far * n.scale, prior, n.unit, both_signs=True, locations=1)
    values, deviations = ({**known, n.address: x * n.scale} for known, x in zip((rest.values, rest.deviations), seen, strict=True))
    fit = fitting.fitted((*rest.model, c), values, deviations)
    if fit is None or fit.sensitivities is None:
        return None
    values, deviations = ({a: x for a, x in known.items() if a != n.address} for known in (fit.values, fit.deviations))
    moved = replace(rest, values=values, deviations=deviations, calibrated={n.address: fit.values[n.address]})
    signature = fitting.mean_signature(moved.values, moved.calibrated)
    return None if signature is None else fitting.about(moved, signature, fit.sensitivities[:, :-1], best.form)
