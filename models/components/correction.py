"""A component that sits on a connection and adds a sparse form to what passes: a law that was found in data.

Where forms come from: docs/explanation/unknown_forms.md.

    y_i = u_i + sum_k c_k a_k(z) b_k(z)     for the terms k of element i

u is what passes; z are the other signals, their rates, what each has changed since the start, and the time t since then; a and b are
factors of one variable each (KINDS). The rate of a signal is that over the last step, (z - z_before) / h; 0 at the start.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robomill.models.components.recording import literal_unroll
from robomill.models.maths.elementary import exp, sincos
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel

ONE, VALUE, SIGN, SIZE, SIGNED_SQUARE, SQUARE, CUBE, ROOT, SINE, COSINE, DECAY = range(11)
KINDS = ("one", "value", "sign", "size", "signed_square", "square", "cube", "root", "sine", "cosine", "decay")
"""Factors of a variable x with a shape p: 1, x, sgn x (x / p up to |x| = p), |x|, x |x|, x^2, x^3, sgn x sqrt(|x| / p), sin(p x), cos(p x),
exp(-x / p)."""
FACTORS = 2
"""Factors of a term."""
TIME = "t"
"""Name of the time among the variables."""


@kernel
def factor(kind: int, x: float, p: float) -> float:
    """Value of a factor (KINDS) at x with shape p."""
    if kind == VALUE:
        return x
    if kind == SIGN:
        return min(max(x / p, -1.0), 1.0)
    if kind == SIZE:
        return abs(x)
    if kind == SIGNED_SQUARE:
        return x * abs(x)
    if kind == SQUARE:
        return x * x
    if kind == CUBE:
        return x * x * x
    if kind == ROOT:
        return math.sqrt(x / p) if x >= 0.0 else -math.sqrt(-x / p)
    if kind in (SINE, COSINE):
        sine, cosine = sincos(p * x)
        return float(sine if kind == SINE else cosine)
    if kind == DECAY:
        return float(exp(-x / p))
    return 1.0


def factors(kind: int, x: FloatArray, p: float) -> FloatArray:
    """`factor` of a series [n]."""
    made: Mapping[int, Callable[[], FloatArray]] = {
        ONE: lambda: np.ones_like(x),
        VALUE: lambda: x,
        SIGN: lambda: np.clip(x / p, -1.0, 1.0),
        SIZE: lambda: np.abs(x),
        SIGNED_SQUARE: lambda: x * np.abs(x),
        SQUARE: lambda: x * x,
        CUBE: lambda: x**3,
        ROOT: lambda: np.sign(x) * np.sqrt(np.abs(x) / p),
        SINE: lambda: np.sin(p * x),
        COSINE: lambda: np.cos(p * x),
        DECAY: lambda: np.exp(-x / p),
    }
    return np.asarray(made[kind]())


@dataclass(frozen=True)
class CorrectionModel(Model):
    """A model made by `correction_model`; `specification` remakes it."""

    specification: dict[str, Any] = field(default_factory=dict, compare=False)


def correction_model(specification: Mapping[str, Any]) -> CorrectionModel:
    """Make the model of a form from plain data.

    ``name``; ``stands_for``, the component that it is about; ``signals`` and ``corrected``, arrays as {name, unit, count} with a count of 0
    for a scalar; ``terms`` as {element, coefficient, unit, text, factors}, each factor {kind, variable, rate, since_start, shape}, of
    which `since_start` may be left out. A variable is an element of a signal or of what passes (`qd[1]`), or `t`. ValueError names what
    is not there.
    """
    signals, corrected = list(specification["signals"]), list(specification["corrected"])
    passing = [{**c, "name": c["name"] + "_in"} for c in corrected]
    into = [*signals, *passing]
    places = {name: k for k, name in enumerate(_in_order(into))}
    at_all = {name: k for k, name in enumerate(_in_order(corrected))}
    terms = list(specification["terms"])
    n, m = len(terms), len(places)
    kinds, variables, shapes, at = np.zeros((n, FACTORS)), np.zeros((n, FACTORS)), np.zeros((n, FACTORS)), np.zeros(n)
    for k, term in enumerate(terms):
        at[k] = _place(term["element"], at_all)
        for i, f in enumerate(term["factors"]):
            kinds[k, i], shapes[k, i], variables[k, i] = kind_of(f), f["shape"], place_of(f, places, at_all)
    names = tuple(f"form_{k + 1}" for k in range(n))
    init, step = _functions(into, corrected, names)
    return CorrectionModel(
        specification["name"],
        f"What {specification['stands_for']} lacks, as a form that was found in data: it is added to what passes",
        (
            *(_variable(a, "input", "Signal of the form") for a in signals),
            *(_variable(a, "input", "What passes") for a in passing),
            *(_variable(a, "output", "What passes, and the form") for a in corrected),
            *(
                Variable(name, "parameter", f"{t['text']} in {t['element']}", t["unit"], start=t["coefficient"], tunable=True)
                for name, t in zip(names, terms, strict=True)
            ),
            Variable(
                "form_kind",
                "parameter",
                f"Kinds of the factors: {', '.join(KINDS)}",
                "1",
                (n, FACTORS),
                kinds,
                0,
                len(KINDS) - 1,
                "integer",
            ),
            Variable(
                "form_variable",
                "parameter",
                "Variables: signals, their rates, what they changed since the start, time",
                "1",
                (n, FACTORS),
                variables,
                0,
                3 * m,
                "integer",
            ),
            Variable("form_figure", "parameter", "Shapes of the factors, in SI", "1", (n, FACTORS), shapes),
            Variable("form_element", "parameter", "Elements that the terms are added to", "1", (n,), at, 0, len(at_all) - 1, "integer"),
            Variable("form_z", "state", "Signals, their rates, what they changed since the start, time", "1", (3 * m + 1,)),
            Variable("form_before", "state", "Signals at the last step", "1", (m,)),
            Variable("form_start", "state", "Signals at the start", "1", (m,)),
            Variable("form_added", "state", "The form", "1", (len(at_all),)),
        ),
        init,
        step,
        specification=dict(specification),
    )


def read_form(file: Path) -> CorrectionModel:
    """The model of a form in a file; LookupError says what is wrong with it."""
    try:
        return correction_model(json.loads(file.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise LookupError(f"no form {file}; `robomill diagnose --form` writes one where it finds an unknown law") from None
    except (ValueError, KeyError, TypeError) as error:
        raise LookupError(f"{file} is no form that a diagnosis has written: {type(error).__name__}: {error}") from None


def _in_order(arrays: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of all elements, in the order of `_functions`: scalars first."""
    found = [a["name"] for a in arrays if not a["count"]]
    return found + [f"{a['name']}[{i + 1}]" for a in arrays for i in range(a["count"])]


def elements(arrays: Sequence[Mapping[str, Any]], suffix: str = "") -> list[tuple[str, str]]:
    """Name and unit of all elements of arrays, each array called with a suffix."""
    return [(f"{a['name']}{suffix}" + (f"[{i + 1}]" if a["count"] else ""), a["unit"]) for a in arrays for i in range(max(a["count"], 1))]


def passed(name: str, corrected: Collection[str]) -> str:
    """The name of what passes where a variable is an element that is corrected."""
    base, bracket, index = name.partition("[")
    return f"{base}_in{bracket}{index}" if name in corrected else name


def kind_of(given: Mapping[str, Any]) -> int:
    """Number of the kind of a factor; ValueError lists the kinds."""
    if given["kind"] not in KINDS:
        raise ValueError(f"unknown kind {given['kind']!r} of a factor; kinds: {', '.join(KINDS)}")
    return KINDS.index(given["kind"])


def place_of(given: Mapping[str, Any], places: Mapping[str, int], corrected: Collection[str]) -> int:
    """Place of the variable of a factor among the signals, their rates, what they changed since the start, and the time.

    `places`: signals and what passes -> place. ValueError names what is not there.
    """
    if given["variable"] == TIME:
        return 3 * len(places)
    block = 1 if given["rate"] else 2 if given.get("since_start", False) else 0
    return _place(passed(given["variable"], corrected), places) + block * len(places)


def _place(name: str, known: Mapping[str, int]) -> int:
    if name not in known:
        raise ValueError(f"a form has no {name!r}; it has {', '.join(known)}")
    return known[name]


def _variable(array: Mapping[str, Any], causality: Any, description: str) -> Variable:
    return Variable(array["name"], causality, description, array["unit"], (array["count"],) if array["count"] else ())


def _functions(
    into: Sequence[Mapping[str, Any]], corrected: Sequence[Mapping[str, Any]], coefficients: tuple[str, ...]
) -> tuple[Callable[[Record], int], Callable[[Record, float, float], int]]:
    """`init` and `step` for arrays of these names."""
    m = len(_in_order(into))
    first = m - len(_in_order(corrected))
    read = _reader(tuple(a["name"] for a in into if not a["count"]), tuple(a["name"] for a in into if a["count"]))
    # what passes stands behind the signals among the scalars, and again among the vectors
    scalars, vectors = (tuple(a["name"] for a in corrected if bool(a["count"]) is v) for v in (False, True))
    singles = sum(not a["count"] for a in into)
    place_scalars = singles - len(scalars)
    place_vectors = first + len(scalars)
    write = _writer(scalars, vectors, place_scalars, place_vectors)
    sum_up = _adder(coefficients, m)

    def init(s: Record) -> int:
        read(s)
        for k in range(m):
            s.form_before[k] = s.form_z[k]
            s.form_start[k] = s.form_z[k]
            s.form_z[m + k] = 0.0
            s.form_z[2 * m + k] = 0.0
        s.form_z[3 * m] = 0.0
        sum_up(s)
        write(s)
        return 0

    def step(s: Record, t: float, h: float) -> int:
        read(s)
        for k in range(m):
            s.form_z[m + k] = (s.form_z[k] - s.form_before[k]) / h
            s.form_z[2 * m + k] = s.form_z[k] - s.form_start[k]
            s.form_before[k] = s.form_z[k]
        s.form_z[3 * m] = t + h
        sum_up(s)
        write(s)
        return 0

    return init, step


def _reader(scalars: tuple[str, ...], vectors: tuple[str, ...]) -> Callable[[Record], None]:
    """From the inputs to z."""

    def read_scalars(s: Record) -> None:
        k = 0
        for name in literal_unroll(scalars):
            s.form_z[k] = s[name]
            k += 1  # noqa: SIM113  # compiled code unrolls no enumerate

    def read_vectors(s: Record) -> None:
        k = len(scalars)
        for name in literal_unroll(vectors):
            v = s[name]
            for i in range(len(v)):
                s.form_z[k] = v[i]
                k += 1

    one, other = _or_nothing(read_scalars, scalars), _or_nothing(read_vectors, vectors)

    def read(s: Record) -> None:
        one(s)
        other(s)

    return kernel(read)


def _writer(scalars: tuple[str, ...], vectors: tuple[str, ...], at_scalars: int, at_vectors: int) -> Callable[[Record], None]:
    """From z (what passes, from these places on) and the form to the outputs."""

    def write_scalars(s: Record) -> None:
        k = 0
        for name in literal_unroll(scalars):
            s[name] = s.form_z[at_scalars + k] + s.form_added[k]
            k += 1  # noqa: SIM113

    def write_vectors(s: Record) -> None:
        k = 0
        for name in literal_unroll(vectors):
            v = s[name]
            for i in range(len(v)):
                v[i] = s.form_z[at_vectors + k] + s.form_added[len(scalars) + k]
                k += 1

    one, other = _or_nothing(write_scalars, scalars), _or_nothing(write_vectors, vectors)

    def write(s: Record) -> None:
        one(s)
        other(s)

    return kernel(write)


def _adder(names: tuple[str, ...], m: int) -> Callable[[Record], None]:
    """From z to the form."""

    def sum_up(s: Record) -> None:
        for i in range(len(s.form_added)):
            s.form_added[i] = 0.0
        k = 0
        for name in literal_unroll(names):
            value = s[name]
            for i in range(FACTORS):
                value *= factor(s.form_kind[k, i], s.form_z[s.form_variable[k, i]], s.form_figure[k, i])
            s.form_added[s.form_element[k]] += value
            k += 1  # noqa: SIM113

    return kernel(_or_nothing(sum_up, names))


@kernel
def _nothing(s: Record) -> None:
    """No variables of that kind."""


def _or_nothing(function: Callable[[Record], None], names: tuple[str, ...]) -> Callable[[Record], None]:
    return kernel(function) if names else _nothing
