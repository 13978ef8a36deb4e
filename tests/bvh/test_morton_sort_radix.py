"""The radix sort against numpy's stable sort."""

import numpy as np
import pytest

from antumbra.bvh.morton_sort import radix_sort


def keys_of(kind, n, bits):
    rng = np.random.default_rng(n)
    if kind == "random":
        return rng.integers(0, 2**bits, n)
    if kind == "few values":
        return rng.integers(0, 2**bits, 5)[rng.integers(0, 5, n)]
    if kind == "one value":
        return np.full(n, 2**bits - 1)
    if kind == "descending":
        return np.arange(n)[::-1] * ((2**bits - 1) // n)
    return rng.integers(0, 2**9, n) << (bits - 12)  # "one digit": all other digits are the same in all keys


@pytest.mark.parametrize("kind", ["random", "few values", "one value", "descending", "one digit"])
@pytest.mark.parametrize("bits, dtype", [(30, np.int32), (63, np.int64), (13, np.int32)])
def test_sorts_and_is_stable(kind, bits, dtype):
    for n in (1, 2, 1000, 70_000):
        keys = keys_of(kind, n, bits).astype(dtype)
        values = np.random.default_rng(1).permutation(n).astype(np.int32)
        order = np.argsort(keys, kind="stable")
        for threads in (1, 2, 5):
            got = radix_sort(keys.copy(), values.copy(), bits, threads)
            assert got[0].dtype == dtype and np.array_equal(got[0], keys[order])
            assert got[1].dtype == np.int32 and np.array_equal(got[1], values[order])


@pytest.mark.parametrize("copies", [1, 1000])
def test_32_bits_are_read_without_sign(copies):
    keys = np.repeat(np.array([5, -1, 0, -(2**31), 2**31 - 1], np.int32), copies)
    got = radix_sort(keys.copy(), np.arange(5 * copies, dtype=np.int32), 32, 1)
    assert (got[1][::copies] // copies).tolist() == [2, 0, 4, 3, 1] and (np.diff(got[1].reshape(5, -1)) == 1).all()
