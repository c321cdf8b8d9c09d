"""The terms that a form may have: factors of one variable, and products of two; each with its unit and its text."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robomill.diagnosis.forms.signals import Variable
from robomill.diagnosis.inference.time_varying import COMING_LATE
from robomill.models.components.correction import KINDS, TIME, factors
from robomill.models.model.units import unit_of
from robomill.orchestration.slaves.protocol import FloatArray, base_name

SLIDES = 0.002
"""Part of its largest size up to which a sign grows in proportion: at rest a sign is noise, and friction holds whatever it has to."""
TEXTS: Mapping[str, str] = {
    "value": "{x}",
    "sign": "sgn({x})",
    "size": "|{x}|",
    "signed_square": "{x} |{x}|",
    "square": "{x}^2",
    "cube": "{x}^3",
    "root": "sgn({x}) sqrt(|{x}|/({p:.3g} {u}))",
    "sine": "sin({p:.5g} {x})",
    "cosine": "cos({p:.5g} {x})",
    "decay": "exp(-{x}/({p:.3g} s))",
}
POWERS: Mapping[str, int] = {"value": 1, "size": 1, "signed_square": 2, "square": 2, "cube": 3}
"""Powers of the unit of the variable in that of the factor; the others have none."""


OF_ONE = ("value", "sign", "size", "signed_square", "square", "cube", "root")
"""Kinds of the terms of one variable."""


@dataclass(frozen=True)
class Factor:
    """A factor of a term: kind (`models.components.correction.KINDS`), variable, shape [SI]."""

    kind: str
    variable: Variable
    shape: float = 1.0

    @property
    def text(self) -> str:
        """As a formula has it."""
        x = self.variable.text
        if self.kind in ("square", "cube") and self.variable.rate:
            x = f"({x})"  # d(q)/dt^2 would be an acceleration
        return TEXTS[self.kind].format(x=x, p=self.shape, u=self.variable.unit)

    def pattern(self, index: str) -> str:
        """What is the same in all joints: the text with `index` as `i`, without the scale of a root, which its coefficient takes up."""
        variable = replace(self.variable, name=self.variable.name.replace(f"[{index}]", "[i]"))
        return f"sgn({variable.text}) sqrt(|{variable.text}|)" if self.kind == "root" else replace(self, variable=variable).text

    def plain(self) -> dict[str, Any]:
        """As the specification of a form has it."""
        return {
            "kind": self.kind,
            "variable": self.variable.name,
            "rate": self.variable.rate,
            "since_start": self.variable.since_start,
            "shape": self.shape,
        }


@dataclass(frozen=True)
class Term:
    """A product of factors; without any, it is 1."""

    factors: tuple[Factor, ...] = ()

    @property
    def text(self) -> str:
        """As a formula has it."""
        return " ".join(f.text for f in self.factors) or "1"

    def pattern(self, index: str) -> str:
        """The text of a law that is the same in all joints, where this is that of joint `index`."""
        return " ".join(f.pattern(index) for f in self.factors) or "1"

    def unit(self, port: str) -> str:
        """Unit of its coefficient, where the port has the unit `port`."""
        below = [f.variable.unit for f in self.factors for _ in range(POWERS.get(f.kind, 0))]
        below = [u for u in below if u != "1"]
        if not below:
            return port
        together = port + "".join(f"/({u})" for u in below)
        try:
            return unit_of(together).si
        except ValueError:  # a unit of the system's own
            return together

    def values(self, known: Mapping[Variable, FloatArray], n: int) -> FloatArray:
        """Series [n]."""
        made = np.ones(n)
        for f in self.factors:
            made = made * factors(KINDS.index(f.kind), known[f.variable], f.shape)
        return made


def library(
    found: Sequence[Mapping[Variable, FloatArray]],
    index: str,
    longest: float,
    others: Collection[str] = OF_ONE,
    unit: str = "",
    array: str = "",
) -> list[Term]:
    """All terms for a port with this index and unit, from the variables that are there in every condition; `longest` run [s].

    What a variable changed since the start is a term where it has the unit of the port: a motion that another one drags along.
    Products are those of variables of the same index (and of scalars): a port of an array of joints is about one joint first. Of
    variables with another index there are only the kinds in `others`, but for those of the `array`: its elements may talk to each other.
    A port without an index is about any of them.
    """
    shared = [v for v in found[0] if all(v in other for other in found)]
    sizes = {v: max(float(np.abs(known[v]).max()) for known in found) for v in shared}
    terms = [Term()]
    for v in shared:
        if v.name == TIME:
            terms += [Term((Factor("value", v),)), *(Term((Factor("decay", v, part * longest),)) for part in (*COMING_LATE, 1.0))]
            continue
        if v.since_start:
            terms += [Term((Factor("value", v),))] if v.unit == unit else []
            continue
        for kind in OF_ONE if not index or v.index in ("", index) or base_name(v.name) == array else others:
            if kind in ("size", "signed_square", "sign", "root") and _one_sign(found, v):
                continue  # the same as a value, a square, or a constant
            shape = {"sign": SLIDES * sizes[v], "root": sizes[v]}.get(kind, 1.0)
            terms.append(Term((Factor(kind, v, shape),)))
    own = [v for v in shared if v.index in ("", index) and not v.since_start]
    for a, b in itertools.combinations(own, 2):
        terms.append(Term((Factor("value", a), Factor("value", b))))
    for a, b in itertools.permutations(own, 2):
        if TIME not in (a.name, b.name) and not _one_sign(found, a) and a.name != b.name:
            terms.append(Term((Factor("sign", a, SLIDES * sizes[a]), Factor("size", b))))
    return terms


def _one_sign(found: Sequence[Mapping[Variable, FloatArray]], v: Variable) -> bool:
    """Whether a variable is never negative, or never positive."""
    return all((known[v] >= 0.0).all() for known in found) or all((known[v] <= 0.0).all() for known in found)


def periodic(v: Variable, k: float) -> tuple[Term, Term]:
    """Sine and cosine of k times an angle (or way)."""
    f = Factor("sine", v, k)
    return Term((f,)), Term((replace(f, kind="cosine"),))
