"""The directory at the end of a store: the table of its chunks, the tree over them, and the scene without triangles."""

from typing import NamedTuple

import numpy as np

from ..bvh import binned_sah
from ..bvh.nodes import CHILDREN, EMPTY, aligned_empty, bvh_leaf, bvh_link
from ..bvh.reinsertion import reinsert
from .store_format import COUNTS, TABLE, Chunks, StoreMeta, TopTree, meta_from_json, meta_to_json, pages

# --- The top tree -----------------------------------------------------------------------------------------------------


def top_tree(boxes: np.ndarray, threads: int) -> TopTree:
    """Build the tree over (k, 6) float32 boxes by binned SAH and insertion-based optimisation [Bittner et al. 2013].

    Since builders take triangles, each box is replaced by a zero-area triangle with the same bounds.
    """
    lower, upper = boxes[:, :3], boxes[:, 3:]
    bvh = binned_sah.build(np.stack([lower, upper, lower], axis=1), threads, max_leaf=1)
    bvh = reinsert(bvh, threads)
    ends = bvh.links[:, CHILDREN]
    leaf = (ends < 0) & (ends != EMPTY)
    ends[leaf] = bvh_link(bvh.prim_ids[bvh_leaf(ends[leaf]).first], 1)
    return TopTree(bvh.nodes, bvh.links)


# --- The directory ----------------------------------------------------------------------------------------------------


class Directory(NamedTuple):
    """The contents of the directory."""

    meta: StoreMeta  # the scene without its triangles
    chunks: Chunks  # the table of all chunks
    top: TopTree  # the tree over the chunks


def encode_directory(table: np.ndarray, top: TopTree, meta: StoreMeta) -> bytes:
    """The bytes of a directory, padded with zeros to whole pages; `table` is (k,) TABLE."""
    meta_json = meta_to_json(meta)
    data = COUNTS.pack(len(table), len(top.nodes), len(meta_json)) + table.tobytes() + top.nodes.tobytes() + meta_json
    return data.ljust(pages(len(data)), b"\0")


def decode_directory(data: bytes) -> Directory:
    """The directory from the bytes that `encode_directory` returned."""
    k, m, length = COUNTS.unpack_from(data)
    table = np.frombuffer(data, TABLE, k, COUNTS.size)
    chunks = Chunks(*(np.ascontiguousarray(table[name]) for name in Chunks._fields))
    at = COUNTS.size + table.nbytes
    nodes = aligned_empty((m, 16), "f4")
    nodes[:] = np.frombuffer(data, np.float32, 16 * m, at).reshape(m, 16)
    at += nodes.nbytes
    return Directory(meta_from_json(data[at : at + length]), chunks, TopTree(nodes, nodes.view(np.int32)))
