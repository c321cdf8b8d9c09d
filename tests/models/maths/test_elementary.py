"""Elementary functions: error in units of the last place against 60-digit arithmetic, special values, parity.

The reference is Python's decimal module (exp, ln, sqrt built in; sine and arc tangent by their series), so
it shares nothing with the functions under test or with the platform's maths library.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from numba import njit

from robomill.models.maths import elementary
from robomill.models.model.kernels import COMPILER_OPTIONS
from tests.tolerances import EXACT

DIGITS = 60
FINITE = (
    (elementary.sin, math.sin, -20.0, 20.0),
    (elementary.cos, math.cos, -20.0, 20.0),
    (elementary.tan, math.tan, -1.5, 1.5),
    (elementary.atan, math.atan, -30.0, 30.0),
    (elementary.asin, math.asin, -1.0, 1.0),
    (elementary.acos, math.acos, -1.0, 1.0),
    (elementary.exp, math.exp, -700.0, 700.0),
    (elementary.log, math.log, 1e-12, 1e12),
    (elementary.tanh, math.tanh, -25.0, 25.0),
)


def machin_pi() -> Decimal:
    """Pi from 16 atan(1/5) - 4 atan(1/239)."""

    def inverse_atan(n: int) -> Decimal:
        total, k, term = Decimal(0), 0, Decimal(1) / n
        while abs(term) > Decimal(10) ** -(DIGITS + 10):
            total += term / (2 * k + 1) * (-1) ** k
            term /= n * n
            k += 1
        return total

    return 16 * inverse_atan(5) - 4 * inverse_atan(239)


def sine(x: Decimal) -> Decimal:
    x = x % (2 * machin_pi())
    term = total = x
    k = 1
    while abs(term) > Decimal(10) ** -(DIGITS + 5):
        term *= -x * x / ((2 * k) * (2 * k + 1))
        total += term
        k += 1
    return total


def arc_tangent(x: Decimal) -> Decimal:
    halvings = 0
    while abs(x) > Decimal("0.05"):
        x = x / (1 + (1 + x * x).sqrt())
        halvings += 1
    term, total, k = x, Decimal(0), 0
    while abs(term) > Decimal(10) ** -(DIGITS + 5):
        total += term / (2 * k + 1)
        term *= -x * x
        k += 1
    return total * 2**halvings


def ulps(result: float, truth: Decimal) -> float:
    """Distance of `result` from `truth` in units of the last place of `truth`."""
    return float(abs(Fraction(result) - Fraction(truth)) / Fraction(math.ulp(float(truth))))


def worst(function: Callable[[float], float], truth: Callable[[Decimal], Decimal], arguments: np.ndarray) -> float:
    with localcontext() as context:
        context.prec = DIGITS + 15
        return max(ulps(function(float(x)), truth(Decimal(float(x)))) for x in arguments)


def seeded(low: float, high: float, n: int = 150) -> np.ndarray:
    return np.random.default_rng(1).uniform(low, high, n)


def test_sine_and_cosine_err_by_less_than_one_unit_in_the_last_place() -> None:
    arguments = np.r_[seeded(-0.8, 0.8), seeded(-20.0, 20.0), seeded(-1e4, 1e4, 40), [1e-300, 0.5, 3.0]]
    assert worst(elementary.sin, sine, arguments) < 1.0
    assert worst(elementary.cos, lambda x: sine(x + machin_pi() / 2), arguments) < 1.0


def test_sine_keeps_its_precision_next_to_multiples_of_pi() -> None:
    """The reduction by pi/2 in three parts must not cancel: the remainder of n pi is all that is left."""
    arguments = np.array([math.pi * n for n in (1, 2, 3, 10, 113, 355)])
    assert worst(elementary.sin, sine, arguments) < 1.0


def test_arc_tangent_errs_by_less_than_one_unit_in_the_last_place() -> None:
    arguments = np.r_[seeded(-3.0, 3.0), 10.0 ** seeded(-8.0, 8.0, 80), [0.4375, 0.6875, 1.1875, 2.4375]]
    assert worst(elementary.atan, arc_tangent, arguments) < 1.0


def test_exponential_and_logarithm_err_by_less_than_one_unit_in_the_last_place() -> None:
    assert worst(elementary.exp, Decimal.exp, np.r_[seeded(-1.0, 1.0), seeded(-700.0, 700.0)]) < 1.0
    assert worst(elementary.log, Decimal.ln, np.r_[seeded(0.3, 3.0), 10.0 ** seeded(-300.0, 300.0)]) < 1.0


def test_derived_functions_err_by_a_few_units_in_the_last_place() -> None:
    """Tangent, arc sine and arc cosine are quotients and roots of the others: bound three units."""

    def tangent(x: Decimal) -> Decimal:
        return sine(x) / sine(x + machin_pi() / 2)

    def arc_sine(x: Decimal) -> Decimal:
        return arc_tangent(x / (1 - x * x).sqrt())

    assert worst(elementary.tan, tangent, seeded(-1.5, 1.5)) < 3.0
    assert worst(elementary.asin, arc_sine, seeded(-0.99, 0.99)) < 3.0
    assert worst(elementary.acos, lambda x: machin_pi() / 2 - arc_sine(x), seeded(-0.99, 0.9)) < 3.0


def test_hyperbolic_tangent_errs_by_less_than_3e_16() -> None:
    """Absolute, as its docstring says (1e-16 and half a unit of the rounded result)."""
    with localcontext() as context:
        context.prec = DIGITS
        for x in np.r_[seeded(-25.0, 25.0), seeded(-1e-3, 1e-3)]:
            e = (2 * Decimal(float(x))).exp()
            assert abs(Decimal(elementary.tanh(float(x))) - (e - 1) / (e + 1)) < Decimal("3e-16"), x


def test_power_grows_in_error_with_the_exponent_only() -> None:
    """x**y = exp(y log x): the error of the product, |y log x| half units, passes to the result."""
    rng = np.random.default_rng(2)
    with localcontext() as context:
        context.prec = DIGITS
        for x, y in zip(rng.uniform(0.01, 100.0, 100), rng.uniform(-3.0, 3.0, 100), strict=True):
            truth = (Decimal(float(y)) * Decimal(float(x)).ln()).exp()
            bound = 2.0 + 2.0 * abs(float(y) * math.log(float(x)))
            assert ulps(elementary.power(float(x), float(y)), truth) < bound, (x, y)
    assert elementary.power(0.0, 0.0) == 1.0
    assert elementary.power(0.0, 0.5) == 0.0


@pytest.mark.parametrize("n", range(16))
def test_arc_tangent_of_a_point_finds_every_direction(n: int) -> None:
    angle = (n - 7) * math.pi / 8
    result = elementary.atan2(3.0 * math.sin(angle), 3.0 * math.cos(angle))
    assert abs(result - angle) <= 4.0 * math.ulp(math.pi)


def test_arc_tangent_of_a_point_on_the_axes() -> None:
    assert elementary.atan2(0.0, 0.0) == 0.0
    assert elementary.atan2(0.0, 2.0) == 0.0
    assert elementary.atan2(0.0, -2.0) == math.pi
    assert elementary.atan2(2.0, 0.0) == math.pi / 2
    assert elementary.atan2(-2.0, 0.0) == -math.pi / 2
    assert elementary.atan2(1e-300, 1e300) == 0.0


def test_special_values() -> None:
    assert elementary.sincos(0.0) == (0.0, 1.0)
    assert elementary.exp(0.0) == 1.0
    assert elementary.exp(710.0) == math.inf
    assert elementary.exp(-746.0) == 0.0
    assert elementary.log(1.0) == 0.0
    assert elementary.log(0.0) == -math.inf
    assert math.isnan(elementary.log(-1.0))
    assert elementary.log(math.inf) == math.inf
    assert elementary.atan(math.inf) == math.pi / 2
    assert elementary.tanh(30.0) == 1.0
    assert elementary.tanh(-30.0) == -1.0
    assert elementary.acos(1.0) == 0.0
    assert elementary.acos(-1.0) == math.pi


@pytest.mark.parametrize(("function", "platform", "low", "high"), FINITE, ids=lambda a: getattr(a, "__name__", None))
def test_the_platform_agrees(function: Callable[[float], float], platform: Callable[[float], float], low: float, high: float) -> None:
    """Both err by few units in the last place, so they may differ by few: a blunder anywhere in the range shows."""
    for x in seeded(low, high, 1000):
        difference = abs(function(float(x)) - platform(float(x)))
        assert difference <= 4.0 * max(math.ulp(platform(float(x))), math.ulp(0.5)), x


def test_compiled_gives_the_same_bits_as_plain_python() -> None:
    functions = [f for f, *_ in FINITE]
    e_sin, e_cos, e_tan, e_atan, e_asin, e_acos, e_exp, e_log, e_tanh = functions
    e_atan2, e_power = elementary.atan2, elementary.power

    def all_of(x: float, out: np.ndarray) -> None:
        fraction = x / 30.0
        out[0] = e_sin(x)
        out[1] = e_cos(x)
        out[2] = e_tan(x)
        out[3] = e_atan(x)
        out[4] = e_asin(fraction)
        out[5] = e_acos(fraction)
        out[6] = e_exp(x)
        out[7] = e_log(abs(x))
        out[8] = e_tanh(x)
        out[9] = e_atan2(x, fraction - 0.3)
        out[10] = e_power(abs(x), fraction)

    compiled = njit(**COMPILER_OPTIONS)(all_of)
    plain_result, compiled_result = np.zeros(11), np.zeros(11)
    for x in seeded(-30.0, 30.0, 500):
        all_of(float(x), plain_result)
        compiled(float(x), compiled_result)
        assert np.max(np.abs(plain_result - compiled_result)) == EXACT, x
