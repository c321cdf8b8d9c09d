"""Elementary functions that give the same bits everywhere.

C libraries differ in the last bit of sin, exp and their like, and a closed loop makes two
trajectories of it. These are written in plain arithmetic (IEEE 754 operations and sqrt only), so
plain Python, Numba and a native FMU on any platform agree exactly. Error below one unit in the
last place for sin, cos, exp, log, atan; a few for the rest (tests/models/maths/test_elementary.py).
Polynomial coefficients: the classic minimax sets of the public-domain-like fdlibm (Sun, 1993).
"""

from __future__ import annotations

import math

from robomill.models.model.declaration import kernel

PI = 3.141592653589793
TWO_PI = 6.283185307179586
_TWO_OVER_PI = 0.6366197723675814
# pi/2 in three parts of 33 bits, so that n * part is exact for |n| < 2**20 (Cody and Waite)
_PIO2_1 = 1.57079632673412561417e00
_PIO2_2 = 6.07710050630396597660e-11
_PIO2_3 = 2.02226624879595063154e-21
_LN2_HIGH = 6.93147180369123816490e-01
_LN2_LOW = 1.90821492927058770002e-10
_INV_LN2 = 1.44269504088896338700


@kernel
def _sin_kernel(x: float, y: float) -> float:
    """sin(x + y) for |x| <= pi/4 and a tail y."""
    z = x * x
    v = z * x
    r = 8.33333333332248946124e-03 + z * (
        -1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))
    )
    return x - ((z * (0.5 * y - v * r) - y) - v * -1.66666666666666324348e-01)


@kernel
def _cos_kernel(x: float, y: float) -> float:
    """cos(x + y) for |x| <= pi/4 and a tail y."""
    z = x * x
    r = z * (
        4.16666666666666019037e-02
        + z
        * (
            -1.38888888888741095749e-03
            + z
            * (
                2.48015872894767294178e-05
                + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))
            )
        )
    )
    hz = 0.5 * z
    w = 1.0 - hz
    return w + (((1.0 - w) - hz) + (z * r - x * y))


@kernel
def sincos(x: float) -> tuple[float, float]:
    """sin(x) and cos(x) [x in rad, |x| < 1e6]."""
    n = math.floor(x * _TWO_OVER_PI + 0.5)
    fn = float(n)
    r = x - fn * _PIO2_1
    w = fn * _PIO2_2
    t = r
    r = t - w
    w = fn * _PIO2_3 - ((t - r) - w)
    y = r - w
    tail = (r - y) - w
    s = _sin_kernel(y, tail)
    c = _cos_kernel(y, tail)
    quadrant = n & 3
    if quadrant == 0:
        return s, c
    if quadrant == 1:
        return c, -s
    if quadrant == 2:
        return -s, -c
    return -c, s


@kernel
def sin(x: float) -> float:
    """Sine of x [rad]."""
    return sincos(x)[0]


@kernel
def cos(x: float) -> float:
    """Cosine of x [rad]."""
    return sincos(x)[1]


@kernel
def tan(x: float) -> float:
    """Tangent of x [rad]."""
    s, c = sincos(x)
    return s / c


@kernel
def atan(x: float) -> float:
    """Arc tangent [rad]."""
    a = abs(x)
    if a > 1e18:
        return math.copysign(1.57079632679489655800, x)
    if a < 0.4375:
        high, low, u = 0.0, 0.0, a
    elif a < 0.6875:
        high, low, u = 4.63647609000806093515e-01, 2.26987774529616870924e-17, (2.0 * a - 1.0) / (2.0 + a)
    elif a < 1.1875:
        high, low, u = 7.85398163397448278999e-01, 3.06161699786838301793e-17, (a - 1.0) / (a + 1.0)
    elif a < 2.4375:
        high, low, u = 9.82793723247329054082e-01, 1.39033110312309984516e-17, (a - 1.5) / (1.0 + 1.5 * a)
    else:
        high, low, u = 1.57079632679489655800e00, 6.12323399573676603587e-17, -1.0 / a
    z = u * u
    w = z * z
    s1 = z * (
        3.33333333333329318027e-01
        + w
        * (
            1.42857142725034663711e-01
            + w
            * (
                9.09088713343650656196e-02
                + w * (6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02))
            )
        )
    )
    s2 = w * (
        -1.99999999998764832476e-01
        + w
        * (
            -1.11111104054623557880e-01
            + w * (-7.69187620504482999495e-02 + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02))
        )
    )
    result = high - ((u * (s1 + s2) - low) - u)
    return math.copysign(result, x)


@kernel
def atan2(y: float, x: float) -> float:
    """Angle of the point (x, y) [rad], in (-pi, pi]; 0 for the origin."""
    if x == 0.0 and y == 0.0:
        return 0.0
    if abs(y) <= abs(x):
        a = atan(y / x)
        if x > 0.0:
            return a
        return a + PI if y >= 0.0 else a - PI
    a = atan(x / y)
    return 0.5 * PI - a if y > 0.0 else -0.5 * PI - a


@kernel
def asin(x: float) -> float:
    """Arc sine [rad] of x in [-1, 1]."""
    return atan2(x, math.sqrt((1.0 - x) * (1.0 + x)))


@kernel
def acos(x: float) -> float:
    """Arc cosine [rad] of x in [-1, 1]."""
    return atan2(math.sqrt((1.0 - x) * (1.0 + x)), x)


@kernel
def exp(x: float) -> float:
    """Exponential; inf above 709.78, 0 below -745."""
    if x > 709.782712893384:
        return math.inf
    if x < -745.0:
        return 0.0
    k = math.floor(_INV_LN2 * x + 0.5)
    fk = float(k)
    high = x - fk * _LN2_HIGH
    low = fk * _LN2_LOW
    r = high - low
    t = r * r
    c = r - t * (
        1.66666666666666019037e-01
        + t
        * (
            -2.77777777770155933842e-03
            + t * (6.61375632143793436117e-05 + t * (-1.65339022054652515390e-06 + t * 4.13813679705723846039e-08))
        )
    )
    y = 1.0 - ((low - (r * c) / (2.0 - c)) - high)
    return _scale(y, k)


@kernel
def _scale(y: float, k: int) -> float:
    """Return y * 2**k by exact multiplications."""
    factor = 2.0
    n = k
    if n < 0:
        factor = 0.5
        n = -n
    while n > 0:
        if n & 1:
            y *= factor
        factor *= factor
        n >>= 1
    return y


@kernel
def log(x: float) -> float:
    """Natural logarithm; -inf at 0, nan below."""
    if x == 0.0:
        return -math.inf
    if not x > 0.0:
        return math.nan
    if x > 1.7976931348623157e308:
        return x
    k = 0
    while x >= 18446744073709551616.0:
        x *= 5.421010862427522e-20
        k += 64
    while x < 5.421010862427522e-20:
        x *= 18446744073709551616.0
        k -= 64
    while x >= 1.4142135623730951:
        x *= 0.5
        k += 1
    while x < 0.7071067811865476:
        x *= 2.0
        k -= 1
    f = x - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    t1 = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01))
    t2 = z * (6.666666666666735130e-01 + w * (2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)))
    r = t1 + t2
    half = 0.5 * f * f
    dk = float(k)
    return dk * _LN2_HIGH - ((half - (s * (half + r) + dk * _LN2_LOW)) - f)


@kernel
def power(x: float, y: float) -> float:
    """x**y for x >= 0."""
    if x == 0.0:
        return 1.0 if y == 0.0 else 0.0
    return exp(y * log(x))


@kernel
def tanh(x: float) -> float:
    """Hyperbolic tangent (absolute error below 1e-16)."""
    a = abs(x)
    if a > 22.0:
        return math.copysign(1.0, x)
    if a < 1e-4:
        return x - x * x * x / 3.0
    e = exp(2.0 * a)
    return math.copysign(1.0 - 2.0 / (e + 1.0), x)
