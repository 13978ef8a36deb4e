"""Memory for chunks, used again when a chunk leaves: the system would clear new pages for longer than a read takes."""

import mmap
from threading import Lock

import numpy as np


class Pool:
    """Pieces of memory that no chunk uses now. Several threads may use it at the same time."""

    def __init__(self):
        self._free: list[np.ndarray] = []
        self._lock = Lock()

    @property
    def bytes(self) -> int:
        """Bytes of the free memory."""
        return sum(map(len, self._free))

    def take(self, size: int, most: int) -> np.ndarray:
        """(n,) uint8 with `size` <= n <= `most`: a free piece, or new memory; then as much free memory is released."""
        with self._lock:
            fits = [i for i, piece in enumerate(self._free) if size <= len(piece) <= most]
            if fits:
                return self._free.pop(min(fits, key=lambda i: len(self._free[i])))
            released = 0
            while self._free and released < size:
                released += len(self._free.pop())
        return np.frombuffer(mmap.mmap(-1, max(size, 1)), np.uint8)

    def give(self, piece: np.ndarray) -> None:
        """Keep a piece for a chunk that comes later."""
        with self._lock:
            self._free.append(piece)

    def clear(self) -> None:
        """Release all free memory."""
        with self._lock:
            self._free.clear()
