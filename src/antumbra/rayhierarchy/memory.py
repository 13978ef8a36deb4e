"""Scratch memory that is reused from call to call.

The system clears every new page of a process, which takes longer than most kernels work on the page. Memory released
between frames would be cleared again in every frame.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

KEPT = 64 << 20
"""Maximum number of bytes kept for later calls."""

_spare: list[np.ndarray] = []  # most recently used first
_lock = threading.Lock()

Empty = Callable[[int, Any], np.ndarray]
"""Function of a number of elements and their dtype, such as ``numpy.empty``."""


def _take(size: int) -> np.ndarray:
    """A buffer of at least the given number of bytes: the smallest spare one that is not far too large."""
    with _lock:
        fit = [i for i, spare in enumerate(_spare) if size <= len(spare) <= 2 * size]
        if fit:
            return _spare.pop(min(fit, key=lambda i: len(_spare[i])))
    return np.empty(size, np.uint8)


def _give_back(buffers: list[np.ndarray]) -> None:
    with _lock:
        kept = 0
        for i, buffer in enumerate(all_ := buffers + _spare):
            kept += len(buffer)
            if kept > KEPT:
                del all_[i:]
                break
        _spare[:] = all_


@contextmanager
def borrowed() -> Iterator[Empty]:
    """Yield a function like ``numpy.empty``; its arrays must not be used after the ``with`` block."""
    taken: list[np.ndarray] = []

    def empty(n: int, dtype: Any) -> np.ndarray:
        size = n * np.dtype(dtype).itemsize
        buffer = _take(size)
        taken.append(buffer)
        return buffer[:size].view(dtype)

    try:
        yield empty
    finally:
        _give_back(taken)
