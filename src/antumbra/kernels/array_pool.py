"""Recycled memory for large arrays that are replaced again and again by arrays of the same size.

Fresh memory costs a page fault for every 4 KB, about as much time as filling it. A pool hands out the memory of an
earlier array once nothing refers to that array or to a view of it, so no array is ever changed under its reader.
"""

import weakref
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_ALIGNMENT = 64
_MAX_FREE = 2  # blocks of one size that wait for reuse


class ArrayPool:
    """Hands out uninitialised arrays, aligned to 64 bytes, in recycled memory. It is thread-safe.

    The pool owns the memory that nothing refers to, and frees it when the pool is deleted. A pickle or a copy of a pool
    is empty.
    """

    def __init__(self) -> None:
        self._free: dict[int, list[NDArray[np.uint8]]] = {}  # bytes -> blocks; pop and append are atomic

    def __reduce__(self) -> tuple[type["ArrayPool"], tuple[()]]:
        return ArrayPool, ()

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """An uninitialised C-contiguous array."""
        kind = np.dtype(dtype)
        size = int(np.prod(shape)) * kind.itemsize
        try:
            block = self._free.setdefault(size, []).pop()
        except IndexError:
            block = np.empty(size + _ALIGNMENT, np.uint8)
        return np.asarray(_Lease(self, block, size)).view(kind).reshape(shape)

    def _recycle(self, block: NDArray[np.uint8], size: int) -> None:
        blocks = self._free.setdefault(size, [])
        if len(blocks) < _MAX_FREE:
            blocks.append(block)


class _Lease:
    """The base of an array from a pool, and of all its views. NumPy deletes it after the last of them."""

    def __init__(self, pool: ArrayPool, block: NDArray[np.uint8], size: int) -> None:
        self._pool, self._block, self._size = weakref.ref(pool), block, size
        start = block.ctypes.data
        address = start + -start % _ALIGNMENT
        self.__array_interface__ = {"shape": (size,), "typestr": "|u1", "data": (address, False), "version": 3}

    def __del__(self) -> None:
        pool = self._pool()
        if pool is not None:
            pool._recycle(self._block, self._size)
