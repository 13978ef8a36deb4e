"""The directory at the end of a store. It stays in memory while the store is open."""

from typing import NamedTuple

import numpy as np

from ..bvh.nodes import aligned_empty
from .layout import COUNTS, TABLE, Chunks, pages
from .meta import Meta, as_json, from_json
from .top import Top


class Directory(NamedTuple):
    """The contents of the directory."""

    meta: Meta  # the scene, besides its triangles
    chunks: Chunks  # the table of all chunks
    top: Top  # the tree over the chunks


def encode(table: np.ndarray, top: Top, meta: Meta) -> bytes:
    """The bytes of a directory, filled up with zeros to a whole page; `table` is (k,) TABLE."""
    told = as_json(meta)
    data = COUNTS.pack(len(table), len(top.nodes), len(told)) + table.tobytes() + top.nodes.tobytes() + told
    return data.ljust(pages(len(data)), b"\0")


def decode(data: bytes) -> Directory:
    """The directory from the bytes that `encode` returned."""
    k, m, length = COUNTS.unpack_from(data)
    table = np.frombuffer(data, TABLE, k, COUNTS.size)
    chunks = Chunks(*(np.ascontiguousarray(table[name]) for name in Chunks._fields))
    at = COUNTS.size + table.nbytes
    nodes = aligned_empty((m, 16), "f4")
    nodes[:] = np.frombuffer(data, np.float32, 16 * m, at).reshape(m, 16)
    at += nodes.nbytes
    return Directory(from_json(data[at : at + length]), chunks, Top(nodes, nodes.view(np.int32)))
