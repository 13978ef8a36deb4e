"""Elementary functions with the same bits everywhere: sines, arc tangents, exponentials and logarithms in float64.

C libraries and NumPy compute these functions with different last bits on different systems and processors, and points
of lights, cameras and scenes depend on them. Here they are polynomials after exact argument reductions. They consist of
sums, products, quotients, square roots and powers of two, which IEEE 754 defines to the bit; nothing is contracted.
Errors are below 1 ulp unless a docstring says otherwise. The polynomials and their reductions are those of fdlibm:

    Copyright (C) 1993-2004 by Sun Microsystems, Inc. All rights reserved. Permission to use, copy, modify, and
    distribute this software is freely granted, provided that this notice is preserved.

Each function is one `formula` for kernels, numbers and arrays. It takes float32 or float64, and computes and returns
float64. There are no branches: choices are values, so LLVM can vectorise, and arrays need no masks.
"""

import math

import numpy as np

from .jit import formula, overload

# mypy: disable-error-code="no-untyped-def"

_INF, _NAN = np.inf, np.nan

# --- What kernels and arrays do differently ---------------------------------------------------------------------------


def choose(condition, a, b):
    """`a` where the condition holds, else `b`."""
    return np.where(condition, a, b)[()]


@overload(choose)
def _choose_scalar(condition, a, b):
    return lambda condition, a, b: a if condition else b


def as_float64(x):
    """`x` in float64."""
    return np.asarray(x, np.float64)[()]


@overload(as_float64)
def _scalar_as_float64(x):
    return lambda x: np.float64(x)


def power_of_two(n):
    """2**n for a whole number n in float64, -1022 <= n <= 1023."""
    return np.ldexp(1.0, np.asarray(n).astype(np.int32))


@overload(power_of_two)
def _scalar_power_of_two(n):
    return lambda n: ((np.int64(n) + 1023) << 52).view(np.float64)


def power_of_two_above(x: float) -> float:
    """The least power of two that is at least a positive, normal number."""
    mantissa, exponent = math.frexp(x)
    return math.ldexp(1.0, exponent - (mantissa == 0.5))


def _exponent(x):
    """The whole number n for which 2**n <= x < 2**(n + 1), as float64; x is normal and positive."""
    return (np.frexp(x)[1] - 1).astype(np.float64)


@overload(_exponent)
def _scalar_exponent(x):
    return lambda x: np.float64((x.view(np.int64) >> 52) - 1023)


def _in_range(x):
    """An angle of up to `MAX_ANGLE` with the sine of x, within 1e-16 |x|. In kernels, larger angles remain."""
    large = np.abs(x) > MAX_ANGLE
    return np.where(large, np.fmod(np.where(np.isfinite(x) & large, x, 0.0), 2.0 * np.pi), x)[()]


@overload(_in_range)
def _scalar_in_range(x):
    return lambda x: x


# --- Sines and cosines ------------------------------------------------------------------------------------------------

MAX_ANGLE = 2.0**20
"""Sines of larger angles are less accurate, and NaN in kernels."""

_PER_QUADRANT = 6.36619772367581382433e-01  # 2 / pi
# pi/2 in parts of 33 bits: multiples up to 2**20 are exact
_Q1, _Q2, _Q3 = 1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624871116645580e-21
_Q4 = 8.47842766036889956997e-32


@formula
def _quadrant(x):
    """(k, r, r_low): x = k pi/2 + r + r_low with |r| <= pi/4 [Cody and Waite 1980, Sec. 8]."""
    k = np.rint(x * _PER_QUADRANT)
    a = x - k * _Q1
    b = a - k * _Q2
    low = (a - b) - k * _Q2
    c = b - k * _Q3
    low += (b - c) - k * _Q3 - k * _Q4
    r = c + low
    return k, r, (c - r) + low


@formula
def _sine(r, low):
    """sin(r + low) for |r| <= pi/4."""
    z = r * r
    p = 2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
    p = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * p)
    return r - ((z * (0.5 * low - z * r * p) - low) + z * r * 1.66666666666666324348e-01)


@formula
def _cosine(r, low):
    """cos(r + low) for |r| <= pi/4."""
    z = r * r
    p = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)
    p = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * p)
    p = z * (4.16666666666666019037e-02 + z * p)
    half = 0.5 * z
    w = 1.0 - half
    return w + (((1.0 - w) - half) + (z * p - r * low))


@formula
def sin_cos(x):
    """(sin x, cos x); see `MAX_ANGLE`."""
    x = as_float64(x)
    infinite = np.abs(x) == _INF
    x = choose(infinite, _NAN, _in_range(x))
    valid = np.abs(x) <= MAX_ANGLE
    k, r, low = _quadrant(choose(valid, x, 0.0))
    quarter = k - 4.0 * np.floor(0.25 * k)
    odd = (quarter == 1.0) | (quarter == 3.0)
    sine, cosine = _sine(r, low), _cosine(r, low)
    s, c = choose(odd, cosine, sine), choose(odd, sine, cosine)
    s = choose(quarter >= 2.0, -s, s)
    c = choose((quarter == 1.0) | (quarter == 2.0), -c, c)
    s = choose(np.abs(x) < 2.0**-27, x, s)  # also -0.0
    return choose(valid, s, _NAN), choose(valid, c, _NAN)


@formula
def sin(x):
    """sin x; see `MAX_ANGLE`."""
    return sin_cos(x)[0]


@formula
def cos(x):
    """cos x; see `MAX_ANGLE`."""
    return sin_cos(x)[1]


@formula
def tan(x):
    """tan x, within 3 ulp; see `MAX_ANGLE`."""
    s, c = sin_cos(x)
    return s / c


# --- Arc tangents -----------------------------------------------------------------------------------------------------

_PI, _PI_LOW = 3.14159265358979311600e00, 1.22464679914735317720e-16
_ATAN_HALF, _ATAN_HALF_LOW = 4.63647609000806093515e-01, 2.26987774529616870924e-17


@formula
def _first_octant(small, large):
    """atan(small / large) for 0 <= small <= large, large > 0."""
    middle, high = small >= 0.4375 * large, small >= 0.6875 * large
    below = choose(high, small - large, choose(middle, small - 0.5 * large, small))
    above = choose(high, small + large, choose(middle, large + 0.5 * small, large))
    x = below / above  # tan(a - b) = (tan a - tan b) / (1 + tan a tan b)
    z = x * x
    w = z * z
    p = 6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)
    p = z * (3.33333333333329318027e-01 + w * (1.42857142725034663711e-01 + w * (9.09088713343650656196e-02 + w * p)))
    q = -7.69187620504482999495e-02 + w * (-5.83357013379057348645e-02 - w * 3.65315727442169155270e-02)
    q = w * (-1.99999999998764832476e-01 + w * (-1.11111104054623557880e-01 + w * q))
    start = choose(high, 0.25 * _PI, choose(middle, _ATAN_HALF, 0.0))
    low = choose(high, 0.25 * _PI_LOW, choose(middle, _ATAN_HALF_LOW, 0.0))
    return start - ((x * (p + q) - low) - x)


@formula
def atan2(y, x):
    """The angle of the vector (x, y), -pi to pi, within 2 ulp; zeros and infinities as in C."""
    y, x = as_float64(y), as_float64(x)
    infinite = (np.abs(x) == _INF) & (np.abs(y) == _INF)
    across, up = choose(infinite, 1.0, np.abs(x)), choose(infinite, 1.0, np.abs(y))
    steep = up > across
    small, large = choose(steep, across, up), choose(steep, up, across)
    scale = choose(large > 2.0**1000, 2.0**-4, choose(large < 2.0**-1000, 2.0**60, 1.0))
    a = _first_octant(small * scale, choose(large == 0.0, 1.0, large) * scale)
    back = np.copysign(1.0, x) < 0.0
    a = choose(steep == back, a, -a)
    turn = choose(steep, 0.5, choose(back, 1.0, 0.0))
    return np.copysign(turn * _PI + (a + turn * _PI_LOW), y)


@formula
def atan(x):
    """atan x, -pi/2 to pi/2."""
    return atan2(x, 1.0)


@formula
def asin(x):
    """asin x, -pi/2 to pi/2, within 3 ulp; NaN if |x| > 1."""
    x = as_float64(x)
    x = choose(np.abs(x) <= 1.0, x, _NAN)
    return atan2(x, np.sqrt((1.0 - x) * (1.0 + x)))


@formula
def acos(x):
    """acos x, 0 to pi, within 2 ulp; NaN if |x| > 1."""
    x = as_float64(x)
    x = choose(np.abs(x) <= 1.0, x, _NAN)
    return atan2(np.sqrt((1.0 - x) * (1.0 + x)), x)


# --- Logarithms -------------------------------------------------------------------------------------------------------

_LN2, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # 33 bits, and the rest
_PER_LN2, _PER_LN2_LOW = 1.44269504072144627571e00, 1.67517131648865118353e-10  # 1 / ln 2, as well
_SQRT2 = 1.41421356237309504880
_TO_21_BITS = 2.0**32 + 1.0


@formula
def _normalized(x):
    """(f, k): x = (1 + f) 2**k with 1 + f from sqrt(1/2) to sqrt(2); x is positive and finite."""
    shift = choose(x < 2.0**-1000, 60.0, choose(x > 2.0**1000, -60.0, 0.0))
    x = x * power_of_two(shift)
    k = _exponent(x)
    m = x * power_of_two(-k)
    large = m > _SQRT2
    return choose(large, 0.5 * m, m) - 1.0, k + choose(large, 1.0, 0.0) - shift


@formula
def _log1p_rest(f):
    """log(1 + f) - f + f^2 / 2, for 1 + f from sqrt(1/2) to sqrt(2)."""
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    p = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01))
    q = 2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)
    q = z * (6.666666666666735130e-01 + w * q)
    return s * (0.5 * f * f + (p + q))


@formula
def _at_ends(x, valid, value):
    """A logarithm whose value is valid for 0 < x < inf, extended to all x."""
    return choose(valid, value, choose(x > 0.0, x, choose(x == 0.0, -_INF, _NAN)))


@formula
def log(x):
    """The natural logarithm; -inf at 0, NaN below."""
    x = as_float64(x)
    valid = (x > 0.0) & (x < _INF)
    f, k = _normalized(choose(valid, x, 1.0))
    value = k * _LN2 - ((0.5 * f * f - (_log1p_rest(f) + k * _LN2_LOW)) - f)
    return _at_ends(x, valid, value)


@formula
def log1p(x):
    """log(1 + x); -inf at -1, NaN below."""
    x = as_float64(x)
    total = 1.0 + x
    valid = (total > 0.0) & (total < _INF)
    x, u = choose(valid, x, 0.0), choose(valid, total, 1.0)
    lost = choose(u > 2.0, 1.0 - (u - x), x - (u - 1.0)) / u  # by rounding 1 + x
    f, k = _normalized(u)
    near = (x > -0.29) & (x < 0.41)
    f, k, lost = choose(near, x, f), choose(near, 0.0, k), choose(near, 0.0, lost)
    value = k * _LN2 - ((0.5 * f * f - (_log1p_rest(f) + (k * _LN2_LOW + lost))) - f)
    return _at_ends(total, valid, choose(np.abs(x) < 2.0**-54, x, value))


@formula
def _truncated(x):
    """`x` to 21 bits, so that its product with a number of 32 bits is exact [Dekker 1971]."""
    c = x * _TO_21_BITS
    return c - (c - x)


@formula
def _log2_parts(x):
    """(high, low) with high + low = log2 x to about 60 bits, for positive finite x."""
    f, k = _normalized(x)
    half = 0.5 * f * f
    high = _truncated(f - half)
    low = (f - high) - half + _log1p_rest(f)
    part = high * _PER_LN2
    total = k + part
    return total, (low + high) * _PER_LN2_LOW + low * _PER_LN2 + ((k - total) + part)


@formula
def log2(x):
    """The binary logarithm; exact for powers of two; -inf at 0, NaN below."""
    x = as_float64(x)
    valid = (x > 0.0) & (x < _INF)
    high, low = _log2_parts(choose(valid, x, 1.0))
    return _at_ends(x, valid, high + low)


# --- Exponentials and powers ------------------------------------------------------------------------------------------

_LARGEST, _SMALLEST = 709.782712893384, -745.1332191019412  # of the exponents of finite numbers above 0
_TO_26_BITS = 2.0**27 + 1.0


@formula
def _scaled_exp(n, high, low):
    """exp(high - low) 2**n, for a whole number n from -1080 to 1024 and |high| <= 0.35."""
    r = high - low
    t = r * r
    p = 6.61375632143793436117e-05 + t * (-1.65339022054652515390e-06 + t * 4.13813679705723846039e-08)
    c = r - t * (1.66666666666666019037e-01 + t * (-2.77777777770155933842e-03 + t * p))
    m = np.floor(0.5 * n)  # one power of two would overflow
    return (1.0 - ((low - (r * c) / (2.0 - c)) - high)) * power_of_two(m) * power_of_two(n - m)


@formula
def exp(x):
    """e**x; subnormal results are off by up to 1 ulp."""
    x = as_float64(x)
    inside = choose(x < _LARGEST, choose(x > _SMALLEST, x, _SMALLEST), _LARGEST)
    n = np.rint(inside * 1.44269504088896338700)
    value = _scaled_exp(n, inside - n * _LN2, n * _LN2_LOW)
    value = choose(x > _LARGEST, _INF, choose(x < _SMALLEST, 0.0, value))
    return choose(x == x, value, x)


@formula
def _exp2_of_sum(high, low):
    """2**(high + low), for |low| < 1e-3; `high` is finite."""
    inside = choose(high < 1024.0, choose(high > -1080.0, high, -1080.0), 1023.0)
    n = np.rint(inside)
    f = (inside - n) + low
    part = _truncated(f)
    value = _scaled_exp(n, part * _LN2, -((f - part) * _LN2 + f * _LN2_LOW))
    return choose(high >= 1024.0, _INF, choose(high < -1080.0, 0.0, value))


@formula
def exp2(x):
    """2**x; exact for whole numbers whose power is normal."""
    x = as_float64(x)
    finite = np.abs(x) < _INF
    value = _exp2_of_sum(choose(finite, x, 0.0), 0.0)
    return choose(finite, value, choose(x < 0.0, 0.0, x))


@formula
def power(x, y):
    """x**y for finite x >= 0 and 0 < y <= 64; NaN for other x. Within 8 ulp, and 2 ulp of results 2**-16 to 2**16."""
    x, y = as_float64(x), as_float64(y)
    valid = (x > 0.0) & (x < _INF)
    high, low = _log2_parts(choose(valid, x, 1.0))
    high, rest = high + low, (high - (high + low)) + low
    cx, cy = high * _TO_26_BITS, y * _TO_26_BITS
    hx, hy = cx - (cx - high), cy - (cy - y)
    product = high * y
    error = ((hx * hy - product) + hx * (y - hy) + (high - hx) * hy) + (high - hx) * (y - hy)
    value = _exp2_of_sum(product, error + rest * y)
    return choose(valid, value, choose(x == 0.0, 0.0, _NAN))
