"""Recycled memory for large arrays that are replaced again and again by arrays of about the same size.

Fresh memory costs a page fault for every 4 KB, about as much time as filling it. A pool hands out the memory of an
earlier array once nothing refers to that array or to a view of it, so no array is ever changed under its reader.

`recycled_empty` is for the arrays of trees and their builders. A scene that is built anew in each frame thus gets the
memory of the frame before.
"""

import weakref
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_ALIGNMENT = 64
_LEAST_RECYCLED = 1 << 17  # bytes: `malloc` keeps smaller memory itself
_STEPS = 8  # sizes that `recycled_empty` rounds up to, from one power of two to the next


class ArrayPool:
    """Hands out uninitialised arrays, aligned to 64 bytes, in recycled memory. It is thread-safe.

    The pool owns the memory that nothing refers to, and frees it when the pool is deleted. A pickle or a copy of a pool
    is empty.

    max_free : number of free blocks of one size that it keeps
    max_bytes : total size of the free blocks that it keeps; the sizes that were freed least recently go first
    """

    def __init__(self, max_free: int = 2, max_bytes: float = np.inf) -> None:
        self._max_free, self._max_bytes = max_free, max_bytes
        self._free: dict[int, list[NDArray[np.uint8]]] = {}  # bytes -> blocks; each operation on either is atomic

    def __reduce__(self) -> tuple[type["ArrayPool"], tuple[int, float]]:
        return ArrayPool, (self._max_free, self._max_bytes)

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, room: int = 0) -> NDArray[Any]:
        """An uninitialised C-contiguous array; room: bytes of its block, if more than the array needs."""
        kind = np.dtype(dtype)
        size = int(np.prod(shape)) * kind.itemsize
        room = max(room, size)
        try:
            block = self._free.setdefault(room, []).pop()
        except IndexError:
            block = np.empty(room + _ALIGNMENT, np.uint8)
        return np.asarray(_Lease(self, block, room, size)).view(kind).reshape(shape)

    def clear(self) -> None:
        """Free the memory that nothing refers to."""
        self._free.clear()

    def _recycle(self, block: NDArray[np.uint8], room: int) -> None:
        if room > self._max_bytes:
            return
        blocks = self._free.pop(room, [])
        if len(blocks) < self._max_free:
            blocks.append(block)
        self._free[room] = blocks  # behind all other sizes
        while sum(size * len(free) for size, free in self._free.copy().items()) > self._max_bytes:
            self._free.pop(next(iter(list(self._free)), 0), None)


class _Lease:
    """The base of an array from a pool, and of all its views. NumPy deletes it after the last of them."""

    def __init__(self, pool: ArrayPool, block: NDArray[np.uint8], room: int, size: int) -> None:
        self._pool, self._block, self._room = weakref.ref(pool), block, room
        start = block.ctypes.data
        address = start + -start % _ALIGNMENT
        self.__array_interface__ = {"shape": (size,), "typestr": "|u1", "data": (address, False), "version": 3}

    def __del__(self) -> None:
        pool = self._pool()
        if pool is not None:
            pool._recycle(self._block, self._room)


_recent = ArrayPool(4, 64 << 20)


def recycled_empty(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An uninitialised C-contiguous array, aligned to 64 bytes, in the memory of an earlier one if there is some.

    Its block is larger by an eighth at most, so that it also serves a scene of about as many triangles. The process
    keeps at most 64 MB of free blocks.
    """
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    if size < _LEAST_RECYCLED:
        return ArrayPool(0).empty(shape, dtype)
    step = (1 << (size - 1).bit_length()) // (2 * _STEPS)
    return _recent.empty(shape, dtype, -(-size // step) * step)


def release_recycled() -> None:
    """Free the blocks that wait for `recycled_empty`."""
    _recent.clear()
