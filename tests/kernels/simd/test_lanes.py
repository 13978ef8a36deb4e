"""The bit operations on int64, and the error of a product."""

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import highest_bit, lowest_bit, popcount, product_error


@kernel
def _all(x):
    return popcount(x), lowest_bit(x), highest_bit(x)


@given(st.integers(-(2**63), 2**63 - 1))
def test_against_python(x):
    word = x % 2**64
    expected = word.bit_count(), (word & -word).bit_length() - 1 if word else 64, word.bit_length() - 1
    assert _all(np.int64(x)) == expected


def test_narrow_integers_keep_their_value():
    assert _all(np.uint32(2**31)) == (1, 31, 31)
    assert _all(np.int32(-1)) == (64, 0, 63)
    assert _all(np.uint8(0)) == (0, 64, -1)


@kernel
def _error(a, b):
    return product_error(a, b, a * b)


_numbers = st.floats(1e-100, 1e100).flatmap(lambda x: st.sampled_from([x, -x]))


@given(_numbers, _numbers)
def test_the_error_of_a_product_is_exact(a, b):
    assert Fraction(_error(a, b)) == Fraction(a) * Fraction(b) - Fraction(a * b)
