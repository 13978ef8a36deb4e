"""The end of a store: what stays in memory while it is open."""

from typing import NamedTuple

import numpy as np

from ..bvh.nodes import aligned_empty
from .layout import COUNTS, TABLE, Chunks, pages
from .meta import Meta, as_json, from_json
from .top import Top


class Directory(NamedTuple):
    """What is in it."""

    meta: Meta
    chunks: Chunks
    top: Top


def encode(table: np.ndarray, top: Top, meta: Meta) -> bytes:
    """Its bytes, filled up to a whole page; `table` is (k,) TABLE."""
    told = as_json(meta)
    data = COUNTS.pack(len(table), len(top.nodes), len(told)) + table.tobytes() + top.nodes.tobytes() + told
    return data.ljust(pages(len(data)), b"\0")


def decode(data: bytes) -> Directory:
    """What `encode` was given."""
    k, m, length = COUNTS.unpack_from(data)
    table = np.frombuffer(data, TABLE, k, COUNTS.size)
    chunks = Chunks(*(np.ascontiguousarray(table[name]) for name in Chunks._fields))
    at = COUNTS.size + table.nbytes
    nodes = aligned_empty((m, 16), "f4")
    nodes[:] = np.frombuffer(data, np.float32, 16 * m, at).reshape(m, 16)
    at += nodes.nbytes
    return Directory(from_json(data[at : at + length]), chunks, Top(nodes, nodes.view(np.int32)))
