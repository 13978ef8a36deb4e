"""The file of a store, version 1: where everything stands, to the byte. All numbers are little-endian.

::

    header      one page of 4096 bytes: `HEADER`, zeros, and the CRC-32 of all that in the last four bytes
    chunks      each begins on a page: nodes, corners, prim_ids, palette, index, zeros up to the next page
    directory   begins on a page: `COUNTS`, a `TABLE` row for each chunk, the top tree's nodes, metadata (JSON), zeros

CRC-32 sums run over zeros too, so a byte that changes anywhere is found. The header is written last: a file whose
writing was interrupted begins with zeros.
"""

import struct
from typing import NamedTuple

import numpy as np

from ..bvh.nodes import Bvh

STORE_SUFFIX = ".antumbra"
PAGE = 4096
MAGIC = b"ANTUMBRA"
VERSION = 1
COMPLETE = 1
HEADER = struct.Struct("<8sIIQQQI")
"""Magic, version, COMPLETE, size of the file, where the directory begins, its bytes, its CRC-32."""
HEADER_CRC = PAGE - 4  # where the header's own CRC-32 stands, in every version
COUNTS = struct.Struct("<QQQ")
"""Chunks, nodes of the top tree, bytes of metadata."""

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
"""A row of the directory; `Chunks` says what the words mean."""


class Chunks(NamedTuple):
    """The chunks of a store, all in memory."""

    offset: np.ndarray  # (k,) int64: where each begins in the file, a multiple of PAGE
    bytes: np.ndarray  # (k,) int64: its length with the zeros behind it, a multiple of PAGE
    triangles: np.ndarray  # (k,) int64
    nodes: np.ndarray  # (k,) int64: of its BVH
    colours: np.ndarray  # (k,) int64: rows of its palette
    crc: np.ndarray  # (k,) uint32: CRC-32 of all its bytes
    box: np.ndarray  # (k, 6) float32: lowest, then highest corner; the exact bounds of its triangles
    root: np.ndarray  # (k, 16) float32: a copy of its root node


class Chunk(NamedTuple):
    """A chunk of a scene: views on the file, which must not be written to."""

    bvh: Bvh  # of its triangles; prim_ids are indices in the whole scene
    palette: np.ndarray  # (p, 3) float32: the base colours that occur, each once
    index: np.ndarray  # (n,) uint8, uint16 or uint32: slot -> row of the palette


class Place(NamedTuple):
    """Where the arrays of a chunk begin and end, in bytes from its first."""

    nodes: int
    corners: int
    prim_ids: int
    palette: int
    index: int
    end: int  # without the zeros behind it


def pages(n_bytes: int) -> int:
    """The bytes of as many whole pages as `n_bytes` need."""
    return -(-n_bytes // PAGE) * PAGE


def index_dtype(colours: int) -> np.dtype:
    """Of the index into a palette of so many rows."""
    return np.dtype("u1" if colours <= 1 << 8 else "<u2" if colours <= 1 << 16 else "<u4")


def places(triangles: int, nodes: int, colours: int) -> Place:
    """The places of a chunk's arrays."""
    corners = 64 * nodes
    prim_ids = corners + 36 * triangles
    palette = prim_ids + 4 * triangles
    index = palette + 12 * colours
    return Place(0, corners, prim_ids, palette, index, index + triangles * index_dtype(colours).itemsize)


def views(data: np.ndarray, triangles: int, nodes: int, colours: int) -> Chunk:
    """The arrays of a chunk in its bytes, (m,) uint8."""
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
