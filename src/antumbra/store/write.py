"""Writes a store: the chunks one after the other, then the directory, then the header."""

import os
import zlib
from typing import BinaryIO, NamedTuple

import numpy as np

from ..bvh.nodes import Bvh, boxes_of
from .directory import encode
from .layout import COMPLETE, HEADER, HEADER_CRC, MAGIC, PAGE, TABLE, VERSION, pages, places, views
from .meta import Meta
from .top import Top


class Encoded(NamedTuple):
    """A chunk as bytes of the file."""

    data: np.ndarray  # (bytes,) uint8
    row: np.ndarray  # () TABLE: the chunk's row of the directory; the writer sets the offset


def encode_chunk(bvh: Bvh, palette: np.ndarray, index: np.ndarray) -> Encoded:
    """Encode a chunk: a BVH and the colours of its slots. Its prim_ids are indices in the whole scene.

    `palette` is (p, 3) float32, `index` is (n,) of any integer type.
    """
    n, m, p = len(bvh.prim_ids), len(bvh.nodes), len(palette)
    data = np.zeros(pages(places(n, m, p).end), np.uint8)
    chunk = views(data, n, m, p)
    for target, source in zip((*chunk.bvh[:1], *chunk.bvh[2:], *chunk[1:]), (bvh.nodes, *bvh[2:], palette, index)):
        target[...] = source
    row = np.zeros((), TABLE)
    row["bytes"], row["triangles"], row["nodes"], row["colours"] = len(data), n, m, p
    row["crc"], row["root"] = zlib.crc32(data), bvh.nodes[0]
    row["box"] = boxes_of(bvh.nodes[:1])[0].reshape(6)
    return Encoded(data, row)


class Writer:
    """Writes a store to an empty file that is open for writing."""

    def __init__(self, stream: BinaryIO):
        self._stream, self._end = stream, PAGE
        self._rows: list[np.ndarray] = []
        stream.seek(PAGE)  # the header stays zeros until `finish`

    def add(self, chunk: Encoded) -> None:
        """Write the next chunk."""
        chunk.row["offset"] = self._end
        self._stream.write(chunk.data)
        self._rows.append(chunk.row)
        self._end += len(chunk.data)

    @property
    def table(self) -> np.ndarray:
        """(k,) TABLE: the directory's rows of all chunks so far."""
        return np.stack(self._rows)

    def finish(self, top: Top, meta: Meta) -> int:
        """Write the directory, then the header, which completes the store. Return the size of the file."""
        directory = encode(self.table, top, meta)
        self._stream.write(directory)
        self._sync()
        size = self._end + len(directory)
        crc = zlib.crc32(directory)
        header = HEADER.pack(MAGIC, VERSION, COMPLETE, size, self._end, len(directory), crc).ljust(HEADER_CRC, b"\0")
        self._stream.seek(0)
        self._stream.write(header + zlib.crc32(header).to_bytes(4, "little"))
        self._sync()
        return size

    def _sync(self) -> None:
        """Wait until the disk has all data. Some systems report a full disk only then."""
        self._stream.flush()
        os.fsync(self._stream.fileno())
