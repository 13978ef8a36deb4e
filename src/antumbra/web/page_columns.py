"""Columns of numbers in a page, as `page/unpack.mjs` reads them."""

import base64
import hashlib
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Columns:
    """Named arrays, byte 0 of all numbers first, then byte 1, and so on, which compresses best."""

    def __init__(self) -> None:
        self.listed: list[dict[str, Any]] = []
        self._parts: list[bytes] = []

    def add(self, name: str, values: np.ndarray, step: bool = False) -> None:
        """Add an array, flat; `step`: as differences between neighbours."""
        flat = np.ascontiguousarray(values).ravel()
        kind = f"{flat.dtype.kind.replace('b', 'u')}{flat.dtype.itemsize}"
        self.listed.append({"name": name, "type": kind, "length": flat.size, "step": step})
        if step:
            flat = np.diff(flat, prepend=flat.dtype.type(0))
        planes = flat.view(np.uint8).reshape(-1, flat.dtype.itemsize).T
        self._parts.append(np.ascontiguousarray(planes).tobytes())

    def add_distinct(self, name: str, rows: np.ndarray) -> None:
        """Add the distinct rows of an array, (n, k), and the index of each row among them."""
        kept, index = distinct_rows(rows)
        self.add(f"{name}s", kept)
        self.add(f"{name}Of", index, step=True)

    def packed(self) -> bytes:
        """Base64 of a zlib stream of all columns."""
        stream = zlib.compressobj(9)
        return base64.b64encode(b"".join([*map(stream.compress, self._parts), stream.flush()]))

    def digest(self) -> str:
        """SHA-256 of all columns, in hexadecimal."""
        digest = hashlib.sha256()
        for part in self._parts:
            digest.update(part)
        return digest.hexdigest()


def distinct_rows(rows: np.ndarray) -> tuple[np.ndarray, NDArray[np.int32]]:
    """Rows with different bits, in the order of their first use, and the index of each row among them."""
    flat = np.ascontiguousarray(rows)
    keys = flat.view(np.dtype((np.void, flat.shape[1] * flat.itemsize))).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    return flat[first[order]], rank[inverse.ravel()]
