"""The file format of a store, version 1. All numbers are little-endian.

::

    header      one page of 4096 bytes: `HEADER`, zeros, and the CRC-32 of all this in the last four bytes
    chunks      each begins on a page: nodes, corners, prim_ids, palette, index, zeros up to the next page
    directory   begins on a page: `COUNTS`, a `TABLE` row for each chunk, the top tree's nodes, metadata (JSON), zeros

CRC-32 sums include the zeros, so they find a changed byte anywhere. The header is written last. So a file whose writing
was interrupted begins with zeros.
"""

import struct
from typing import NamedTuple

import numpy as np

from ..bvh.nodes import Bvh

STORE_SUFFIX = ".antumbra"
PAGE = 4096
NODE_BYTES = 64  # of a node in a chunk
MAGIC = b"ANTUMBRA"
VERSION = 1
COMPLETE = 1
HEADER = struct.Struct("<8sIIQQQI")
"""Magic, version, COMPLETE, size of the file, and the directory's offset, size and CRC-32."""
HEADER_CRC = PAGE - 4  # offset of the header's own CRC-32, in every version
COUNTS = struct.Struct("<QQQ")
"""Numbers of chunks, of nodes of the top tree, and of bytes of metadata."""

TABLE = np.dtype(
    [
        ("offset", "<i8"),
        ("bytes", "<i8"),
        ("triangles", "<i8"),
        ("nodes", "<i8"),
        ("colours", "<i8"),
        ("crc", "<u4"),
        ("box", "<f4", 6),
        ("root", "<f4", 16),
    ]
)
"""A row of the directory; see `Chunks` for the fields."""


class Chunks(NamedTuple):
    """The table of all chunks of a store, a column for each field. It is always in memory."""

    offset: np.ndarray  # (k,) int64: where the chunk begins in the file, a multiple of PAGE
    bytes: np.ndarray  # (k,) int64: length of the chunk with its padding, a multiple of PAGE
    triangles: np.ndarray  # (k,) int64: number of triangles
    nodes: np.ndarray  # (k,) int64: number of nodes of the chunk's BVH
    colours: np.ndarray  # (k,) int64: number of rows of the chunk's palette
    crc: np.ndarray  # (k,) uint32: CRC-32 of all bytes of the chunk
    box: np.ndarray  # (k, 6) float32: lower, then upper corner; the exact bounds of the chunk's triangles
    root: np.ndarray  # (k, 16) float32: a copy of the chunk's root node


class Chunk(NamedTuple):
    """A chunk of a scene: views of the memory that it was read into."""

    bvh: Bvh  # BVH of the chunk's triangles; prim_ids are indices in the whole scene
    palette: np.ndarray  # (p, 3) float32: the base colours that occur, each once
    index: np.ndarray  # (n,) uint8, uint16 or uint32: slot -> row of the palette


class ChunkPlace(NamedTuple):
    """Offsets of a chunk's arrays, in bytes from the chunk's first byte. An array ends where the next one begins."""

    nodes: int
    corners: int
    prim_ids: int
    palette: int
    index: int
    end: int  # end of the index, without the padding


def pages(n_bytes: int) -> int:
    """`n_bytes`, rounded up to whole pages."""
    return -(-n_bytes // PAGE) * PAGE


def index_dtype(colours: int) -> np.dtype:
    """The dtype of an index into a palette of `colours` rows."""
    return np.dtype("u1" if colours <= 1 << 8 else "<u2" if colours <= 1 << 16 else "<u4")


def places(triangles: int, nodes: int, colours: int) -> ChunkPlace:
    """The offsets of a chunk's arrays."""
    corners = NODE_BYTES * nodes
    prim_ids = corners + 36 * triangles
    palette = prim_ids + 4 * triangles
    index = palette + 12 * colours
    return ChunkPlace(0, corners, prim_ids, palette, index, index + triangles * index_dtype(colours).itemsize)


def views(data: np.ndarray, triangles: int, nodes: int, colours: int) -> Chunk:
    """The arrays of a chunk as views of its bytes, (m,) uint8."""
    at = places(triangles, nodes, colours)
    lines = data[at.nodes : at.corners]
    bvh = Bvh(
        lines.view(np.float32).reshape(nodes, 16),
        lines.view(np.int32).reshape(nodes, 16),
        data[at.prim_ids : at.palette].view(np.int32),
        data[at.corners : at.prim_ids].view(np.float32).reshape(triangles, 9),
    )
    palette = data[at.palette : at.index].view(np.float32).reshape(colours, 3)
    return Chunk(bvh, palette, data[at.index : at.end].view(index_dtype(colours)))
