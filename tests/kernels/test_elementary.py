"""Elementary functions: accuracy, edges, and the same bits from kernels, numbers and arrays."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.kernels import elementary
from antumbra.kernels.jit import kernel

N = 100_000
INF, NAN = math.inf, math.nan
EDGES = np.array([0.0, -0.0, INF, -INF, NAN, 5e-324, -5e-324, 1e-310, 1.0, -1.0, 2.0, -2.0, 0.5, 1.8e308, -1.8e308])
NEAR_EDGES = np.array(
    [709.78, 709.79, -745.13, -745.14, 1023.9, 1024.0, -1074.0, -1080.0, 2.0**20, np.pi / 2, 0.41421356]
)
ONE = "sin", "cos", "tan", "asin", "acos", "atan", "exp", "exp2", "log", "log2", "log1p"
TWO = "atan2", "power"
MOST = {"tan": 2.5, "asin": 2.5, "acos": 2.0, "atan": 1.5, "atan2": 1.5}  # ulp; of all others 1
REFERENCES = {"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2}
long_double = pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 63, reason="long double is float64 here: the accuracy is NOT checked"
)


def spread(low, high, n=N):
    """Numbers of both signs with exponents of ten from low to high."""
    rng = np.random.default_rng(3)
    return rng.choice([-1.0, 1.0], n) * 10.0 ** rng.uniform(low, high, n)


def arguments(name):
    """Arguments for one function: a dense sweep, many magnitudes and hard cases."""
    rng = np.random.default_rng(4)
    if name in ("sin", "cos", "tan"):
        near_zeros = np.arange(1, N) * (np.pi / 2)  # where arguments lose most digits
        return np.concatenate([np.linspace(-8, 8, N), rng.uniform(-(2.0**20), 2.0**20, N), near_zeros, spread(-300, 0)])
    if name in ("asin", "acos"):
        return np.concatenate([np.linspace(-1, 1, N), spread(-300, 0), 1.0 - np.abs(spread(-16, 0))])
    if name in ("log", "log2"):
        return np.concatenate(
            [np.linspace(0.3, 3.0, N), 1.0 + spread(-15, -1), np.abs(spread(-307, 308)), [5e-324, 1e-310]]
        )
    if name == "log1p":
        near = [np.linspace(-0.9, 3.0, N), np.linspace(-0.3, -0.28, N), np.linspace(0.4, 0.42, N)]
        return np.concatenate([*near, np.abs(spread(-300, 300)), -np.abs(spread(-300, -0.01))])
    if name in ("exp", "exp2"):
        return np.concatenate([np.linspace(-2, 2, N), rng.uniform(-700, 709, N), spread(-300, 0)])
    return np.concatenate([np.linspace(-5, 5, N), spread(-300, 300)])


def ulps(found, truth):
    """The largest error in units of the last place of normal results."""
    rounded = truth.astype(np.float64)
    normal = (np.abs(rounded) > 1e-300) & np.isfinite(rounded)
    assert normal.sum() > N / 2
    error = np.abs(found.astype(np.longdouble) - truth)[normal] / np.spacing(np.abs(rounded[normal]))
    return float(error.max())


@long_double
@pytest.mark.parametrize("name", ONE)
def test_accuracy(name):
    x = arguments(name)
    truth = REFERENCES.get(name, getattr(np, name, None))(x.astype(np.longdouble))
    assert ulps(getattr(elementary, name)(x), truth) <= MOST.get(name, 1.0)


@long_double
def test_accuracy_of_atan2_and_power():
    y, x = spread(-300, 300), spread(-300, 300)[::-1]
    for a, b in ((y, x), (np.random.default_rng(5).normal(size=(2, N)))):
        truth = np.arctan2(a.astype(np.longdouble), b.astype(np.longdouble))
        assert ulps(elementary.atan2(a, b), truth) <= MOST["atan2"]
    base = np.random.default_rng(6).uniform(0.0, 2.0, N)
    for exponent in (1.0 / 2.4, 2.4, 0.75, 8.0):
        truth = np.power(base.astype(np.longdouble), np.longdouble(exponent))
        near = np.abs(np.log2(np.maximum(truth, np.longdouble(1e-30)))) <= 16.0
        assert ulps(elementary.power(base[near], exponent), truth[near]) <= 1.5
    wild, exponents = np.abs(spread(-4, 4)), np.random.default_rng(7).uniform(0.1, 64.0, N)
    truth = np.power(wild.astype(np.longdouble), exponents.astype(np.longdouble))
    assert ulps(elementary.power(wild, exponents), truth) <= 8.0


def test_edges():
    with np.errstate(all="raise", under="ignore"):
        sine, cosine = elementary.sin_cos(EDGES)
        assert np.isnan(sine[2:5]).all() and np.isnan(cosine[2:5]).all()
        assert np.signbit(sine[1]) and not np.signbit(sine[0]) and (cosine[:2] == 1.0).all() and sine[5] == 5e-324
        assert elementary.exp(EDGES)[[0, 2, 3, 13, 14]].tolist() == [1.0, INF, 0.0, INF, 0.0]
        assert elementary.exp2([3.0, -1022.0, -1074.0, 1023.0, 1024.0, -1080.0]).tolist() == [
            8.0, 2.0**-1022, 5e-324, 2.0**1023, INF, 0.0,
        ]  # fmt: skip
        assert elementary.log([0.0, -0.0, INF, 1.0]).tolist() == [-INF, -INF, INF, 0.0]
        assert elementary.log2([8.0, 5e-324, 2.0**1023, 0.0]).tolist() == [3.0, -1074.0, 1023.0, -INF]
        assert elementary.log1p([0.0, -1.0, INF, 5e-324]).tolist() == [0.0, -INF, INF, 5e-324]
        assert np.isnan(
            [*elementary.log([-1.0, NAN]), *elementary.log2([-1.0, NAN]), *elementary.log1p([-2.0, NAN])]
        ).all()
        assert np.isnan([*elementary.asin([1.1, NAN, INF]), *elementary.acos([-1.1, NAN]), elementary.exp(NAN)]).all()
        assert elementary.acos([1.0, -1.0, 0.0]).tolist() == [0.0, math.pi, math.pi / 2]
        assert elementary.power([0.0, 1.0, 4.0, 1e200], [2.4, 7.3, 0.5, 2.0]).tolist() == [0.0, 1.0, 2.0, INF]
        assert np.isnan(elementary.power([-1.0, NAN, INF], 0.5)).all()
        y, x = np.meshgrid(EDGES, EDGES)
        angle = elementary.atan2(y, x)
    for a, b, found in zip(y.flat, x.flat, angle.flat):
        expected = math.atan2(a, b)
        assert (math.isnan(expected) and math.isnan(found)) or abs(found - expected) <= 2 * math.ulp(expected)
        assert math.isnan(expected) or math.copysign(1.0, expected) == math.copysign(1.0, found)


def test_large_angles_are_reduced():
    x = np.array([1e7, -3e10, 1e15])
    assert (
        np.abs(elementary.sin(x) - np.sin(x)).max() < 1.0
        and (np.abs(elementary.sin(x) - np.sin(x)) <= 1e-16 * np.abs(x)).all()
    )
    assert (np.abs(elementary.cos(x) - np.cos(x)) <= 1e-16 * np.abs(x)).all()


def test_numbers_float32_and_shapes():
    for value in (0.75, np.float32(0.75), np.float64(0.75)):
        assert isinstance(elementary.sin(value), float) and elementary.sin(value) == elementary.sin([0.75])[0]
    assert elementary.exp(np.ones((2, 3), np.float32)).dtype == np.float64
    assert elementary.atan2(np.ones((2, 1)), np.ones(3)).shape == (2, 3)
    assert elementary.log(np.zeros((0, 3)) + 1.0).shape == (0, 3)


@kernel
def _all_functions(x, y, out):
    for i in range(len(x)):
        a, b = x[i], y[i]
        out[0, i], out[1, i] = elementary.sin_cos(a)
        out[2, i], out[3, i], out[4, i] = elementary.tan(a), elementary.asin(a), elementary.acos(a)
        out[5, i], out[6, i], out[7, i] = elementary.atan(a), elementary.exp(a), elementary.exp2(a)
        out[8, i], out[9, i], out[10, i] = elementary.log(a), elementary.log2(a), elementary.log1p(a)
        out[11, i], out[12, i] = elementary.atan2(a, b), elementary.power(a, b)


def in_arrays(x, y):
    one = [getattr(elementary, name)(x) for name in ONE]
    return np.array([*one, *(getattr(elementary, name)(x, y) for name in TWO)])


def bits(values):
    """The bits of float64 numbers; all NaN are one."""
    return np.where(np.isnan(values), NAN, values).view(np.int64)


def in_kernel(x, y):
    out = np.empty((len(ONE) + len(TWO), len(x)))
    _all_functions(x, y, out)
    return out


def test_kernels_and_arrays_give_the_same_bits():
    x, y = (
        each.ravel()
        for each in np.meshgrid(
            np.concatenate([EDGES[[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]], NEAR_EDGES]),
            np.abs(EDGES[[7, 8, 10, 12]]),
        )
    )
    x, y = (
        np.concatenate([x, spread(-12, 6), np.linspace(-1, 1, N)]),
        np.concatenate([y, np.abs(spread(-2, 1.5, 2 * N))]),
    )
    x = np.where(np.isfinite(x), np.clip(x, -(2.0**20), 2.0**20), x)
    with np.errstate(over="ignore"):
        assert (bits(in_kernel(x, y)) == bits(in_arrays(x, y))).all()


@given(st.floats(-(2.0**20), 2.0**20), st.floats(0.01, 60.0))
def test_numbers_are_as_accurate_as_the_c_library(x, y):
    pairs = [(elementary.sin(x), math.sin(x)), (elementary.cos(x), math.cos(x)), (elementary.atan(x), math.atan(x))]
    pairs += [
        (elementary.atan2(x, y), math.atan2(x, y)),
        (elementary.log(y), math.log(y)),
        (elementary.exp(-y), math.exp(-y)),
    ]
    pairs += [
        (elementary.log2(y), math.log2(y)),
        (elementary.log1p(y), math.log1p(y)),
        (elementary.power(y, 0.4), y**0.4),
    ]
    assert all(abs(found - expected) <= 3 * math.ulp(expected) for found, expected in pairs)
    assert (bits(in_kernel(np.array([x]), np.array([y]))) == bits(in_arrays(np.array([x]), np.array([y])))).all()
