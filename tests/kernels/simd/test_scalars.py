"""The bit operations on int64."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import highest_bit, lowest_bit, popcount


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
