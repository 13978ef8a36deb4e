"""Recycled arrays: memory returns to the pool only when nothing refers to it any more."""

import copy
import gc
import pickle

import numpy as np
import pytest

from antumbra.kernels import array_pool
from antumbra.kernels.array_pool import ArrayPool, recycled_empty


def address(array):
    return array.ctypes.data


@pytest.mark.parametrize("dtype", [np.float32, np.int64, np.bool_])
@pytest.mark.parametrize("shape", [(7,), (5, 3, 3), (0, 9), ()])
def test_arrays_are_like_new_ones(shape, dtype):
    array = ArrayPool().empty(shape, dtype)
    assert array.shape == shape and array.dtype == dtype
    assert array.flags.c_contiguous and array.flags.aligned and array.flags.writeable and address(array) % 64 == 0
    array[...] = 1
    assert (array == 1).all()


def test_memory_is_reused_once_the_array_and_all_views_are_gone():
    pool = ArrayPool()
    first = pool.empty((1000, 3), np.float32)
    place, view = address(first), first[1:, 0].view(np.int32)
    assert address(pool.empty((1000, 3), np.float32)) != place
    del first
    others = [pool.empty((1000, 3), np.float32) for _ in range(4)]
    assert place not in map(address, others)  # the view still refers to it
    del view, others
    gc.collect()
    again = [pool.empty((3000,), np.int32) for _ in range(2)]  # other shape and dtype, but as many bytes
    assert len({address(each) for each in again}) == 2
    assert len(pool._free[12000]) <= 2


def test_arrays_outlive_their_pool():
    pool = ArrayPool()
    array = pool.empty((100,), np.float64)
    array[:] = 3.0
    del pool
    gc.collect()
    assert (array == 3.0).all()


def test_copies_are_empty():
    pool = ArrayPool()
    pool.empty((100,), np.float64)
    assert pool._free[800]
    assert not pickle.loads(pickle.dumps(pool))._free and not copy.deepcopy(pool)._free
    assert copy.copy(ArrayPool(3, 5))._max_bytes == 5


@pytest.fixture
def recent(monkeypatch):
    pool = ArrayPool(4, 1 << 20)
    monkeypatch.setattr(array_pool, "_recent", pool)
    return pool


@pytest.mark.parametrize("n", [0, 1, 1000, 40_000, 1 << 18])
def test_recycled_arrays_are_like_new_ones(recent, n):
    for _ in range(2):
        array = recycled_empty((n, 2), np.float32)
        assert array.shape == (n, 2) and array.dtype == np.float32 and address(array) % 64 == 0
        array[...] = 1
        assert (array == 1).all()


def test_an_array_of_about_the_size_gets_the_memory(recent):
    first = recycled_empty((100_000,), "f4")
    place = address(first)
    first[...] = 1
    other = recycled_empty((100_000,), "f4")
    assert address(other) != place
    view = first[5:].view(np.int32)
    del first
    assert address(recycled_empty((100_000,), "f4")) != place  # the view still refers to it
    kept = view.copy()
    del view, other
    gc.collect()
    again = [recycled_empty((n,), "f4") for n in (98_000, 97_999, 99_000)]
    assert place in map(address, again) and len(set(map(address, again))) == 3
    assert (kept == np.float32(1).view(np.int32)).all()
    assert address(recycled_empty((60_000,), "f4")) not in map(address, again)


def test_free_memory_is_bounded(recent):
    for n in (*range(140_000, 1_000_000, 10_000), 1 << 21):
        recycled_empty((n,), np.uint8)
        total = sum(size * len(blocks) for size, blocks in recent._free.items())
        assert (n > 1 << 20 or total >= n) and total <= 1 << 20
    arrays = [recycled_empty((1 << 17,), np.uint8) for _ in range(9)]
    del arrays
    assert len(recent._free[1 << 17]) == 4


def test_the_memory_of_builders_is_bounded():
    assert array_pool._recent._max_bytes == 64 << 20
