"""Numbers of the model that the catalogue lacks: candidates in waiting.

Of a mass on a spring, a gain, a mass and a damper that are all a little too small do what one stiffness does that is too large. If that
stiffness is in the catalogue, it is likelier, as one number instead of three. If not, the three have no rival. So a real parameter that is
not zero, and that no effect is about, is asked, too (`inference.single_number`). Of a calibrated one it is asked whether its calibration
failed: it is farther off than its tolerance says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from robomill.diagnosis.candidates import Address, Candidate, Nuisance, Prior
from robomill.diagnosis.catalogue import Catalogue
from robomill.orchestration.slaves.protocol import base_name

OFF = 0.1
"""Standard deviation of a number that nobody doubts, or whose calibration failed, in parts of itself [1] (judgement). A tenth of that is
no finding. A number keeps its sign, and it is larger by no more than itself over OFF."""


def lacking(
    catalogue: Catalogue, nuisances: Sequence[Nuisance], values: Mapping[Address, float], units: Mapping[Address, str]
) -> tuple[Candidate, ...]:
    """A candidate for each of these parameters that the catalogue has no effect for; `values` in the system [`units`].

    Of an array that effects are about no element is one. Nor is a number whose tolerance is as wide as OFF, or that is zero: it has no size
    to try.
    """
    said = {(c.component, base_name(name)) for c in catalogue.candidates for name in (*c.named, *(s.parameter for s in c.shapes), c.start)}
    said |= {(component, base_name(name)) for component, given in catalogue.quiet.items() for name in given} | set(catalogue.seeds)
    known = {n.address: n.scale for n in nuisances}
    arrays: dict[Address, list[str]] = {}
    for (component, name), value in values.items():
        array = component, base_name(name)
        if array not in said and known.get((component, name), 0.0) < OFF * abs(value):
            arrays.setdefault(array, []).append(name)
    return tuple(
        Candidate(
            effect=f"{component}.{array}",
            component=component,
            location=name,
            parameters=(name,),
            minimum=OFF * OFF * abs(values[component, name]),
            maximum=abs(values[component, name]) / OFF,
            prior=Prior("normal", OFF * abs(values[component, name])),
            unit=units[component, name],
            both_signs=True,
            locations=len(names),
        ).limited(*sorted((-values[component, name], values[component, name] / OFF)))
        for (component, array), names in arrays.items()
        for name in names
    )
