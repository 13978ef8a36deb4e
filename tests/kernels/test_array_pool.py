"""Recycled arrays: memory returns to the pool only when nothing refers to it any more."""

import copy
import gc
import pickle

import numpy as np
import pytest

from antumbra.kernels.array_pool import ArrayPool


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
