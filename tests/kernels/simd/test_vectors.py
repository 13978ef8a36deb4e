"""Every operation and number of lanes against numpy, bit for bit."""

from fractions import Fraction

import numpy as np
import pytest

import vector_operations as ops


def assert_same(name, got, want, unspecified=None):
    """Check equality bit for bit. Any NaN equals any other; unspecified results are ignored."""
    assert got.dtype == want.dtype and got.shape == want.shape, name
    equal = got == want
    if got.dtype == np.float32:
        equal = (got.view(np.int32) == want.view(np.int32)) | (np.isnan(got) & np.isnan(want))
    if unspecified is not None:
        assert not unspecified.all()
        equal |= unspecified
    wrong = np.flatnonzero(~equal)
    assert wrong.size == 0, f"{name}: {got[wrong[:4]]} instead of {want[wrong[:4]]} at {wrong[:4]}"


def merged(dicts):
    vectors, masks, scalars = dicts
    assert not (vectors.keys() & masks.keys() or vectors.keys() & scalars.keys())
    return vectors | masks | scalars


@pytest.mark.parametrize("lanes", ops.LANES)
def test_f32(lanes):
    a, b, c = ops.f32_inputs()
    got, want = ops.compute_f32(lanes), merged(ops.expect_f32(lanes))
    assert got.keys() == want.keys()
    extrema = ("minimum", "maximum")
    unspecified = np.isnan(a) | np.isnan(b) | ((a == 0) & (b == 0))  # NaN, and the sign of a zero from two zeros
    assert unspecified.sum() > 50
    for name in got.keys() - {"fma"}:
        assert_same(name, got[name], want[name], unspecified if name in extrema else None)
    for name in extrema:  # two zeros still give a zero
        assert not np.any(got[name][(a == 0) & (b == 0)])
    assert_fused_or_not(got["fma"], c, want["fma"])


def assert_fused_or_not(got, c, rounded_twice):
    """Check fma(c, c, -0.1): all lanes are rounded twice, or all are rounded once."""
    if np.array_equal(got, rounded_twice):
        return
    addend = Fraction(float(np.float32(-0.1)))
    for x, y in zip(got, c):
        exact = Fraction(float(y)) ** 2 + addend
        error = abs(Fraction(float(x)) - exact)
        for neighbour in (np.nextafter(x, np.float32(np.inf)), np.nextafter(x, np.float32(-np.inf))):
            assert error <= abs(Fraction(float(neighbour)) - exact)


@pytest.mark.parametrize("lanes", ops.LANES)
def test_i32(lanes):
    got, want = ops.compute_i32(lanes), merged(ops.expect_i32(lanes))
    want["to_f32"] = ops.i32_inputs()[0].astype(np.float32)
    assert got.keys() == want.keys()
    for name in got:
        assert_same(name, got[name], want[name])


@pytest.mark.parametrize("lanes", ops.LANES)
def test_masks(lanes):
    got, want = ops.compute_mask(lanes), ops.expect_mask(lanes)
    assert got.keys() == want.keys()
    for name in got:
        assert_same(name, got[name], want[name])


@pytest.mark.parametrize("lanes", [4, 8])
@pytest.mark.parametrize("inputs", [ops.f32_inputs, ops.i32_inputs], ids=["f32", "i32"])
def test_join(lanes, inputs):
    a, b = inputs()[:2]
    out = np.empty(2 * len(a), a.dtype)
    ops.joined(lanes)(a, b, out)
    assert_same("join", out, np.stack([a.reshape(-1, lanes), b.reshape(-1, lanes)], 1).ravel())


@pytest.mark.parametrize("lanes", ops.LANES)
@pytest.mark.parametrize("inputs", [ops.f32_inputs, ops.i32_inputs], ids=["f32", "i32"])
def test_permute(lanes, inputs):
    a = inputs()[0]
    order = np.random.default_rng(1).integers(0, lanes, a.shape).astype(np.int32)
    out = np.empty_like(a)
    ops.permuted(lanes)(a, order, out)
    assert_same("permute", out, np.take_along_axis(a.reshape(-1, lanes), order.reshape(-1, lanes), 1).ravel())


def test_f32_bits():
    a, out = ops.f32_inputs()[0], np.empty(ops.f32_inputs()[0].shape, np.int32)
    ops.bits_of_f32(a, out)
    assert_same("f32_bits", out, a.view(np.int32))


def test_inputs_are_hard():
    a, b, _ = ops.f32_inputs()
    for array in (a, b):
        assert np.isnan(array).any() and np.isinf(array).any()
        assert np.any((array == 0) & np.signbit(array)) and np.any((array == 0) & ~np.signbit(array))
        assert np.any((array != 0) & (abs(array) < np.finfo(np.float32).smallest_normal))
    i, j, shifts = ops.i32_inputs()
    for operation in (np.add, np.subtract, np.multiply):
        wide = operation(i, j, dtype=np.int64)
        assert np.any(wide != wide.astype(np.int32))
    assert shifts.min() == 0 and shifts.max() == 31
