"""The bit operations on int64."""

import numba
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from antumbra.simd import lowest_bit, popcount


@numba.njit
def _both(x):
    return popcount(x), lowest_bit(x)


@given(st.integers(-(2**63), 2**63 - 1))
def test_against_python(x):
    word = x % 2**64
    expected = word.bit_count(), (word & -word).bit_length() - 1 if word else 64
    assert _both(np.int64(x)) == expected


def test_narrow_integers_keep_their_value():
    assert _both(np.uint32(2**31)) == (1, 31)
    assert _both(np.int32(-1)) == (64, 0)
    assert _both(np.uint8(0)) == (0, 64)
