"""A naive rival out of core: a store's tree in files that the operating system maps into memory.

The ordinary tracer traces the flat arrays of `numpy.memmap` like any others, and page faults read what it touches. The
operating system decides what stays in memory, which may be everything: no limit applies.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....bvh.block_tree import BlockTree, block_tree
from ....bvh.nodes import Bvh
from ....engine.sources.paged_source import joined_tree
from ....store.store_file import Store
from ....store.system_resources import drop_cached_pages

NAME = "memory-mapped"
TRACER = "multifrusta"
"""The ordinary tracer: frusta, packets for ambient occlusion, and single rays to nearest hits."""

_SHARED = "prim_ids", "corners"  # arrays of a `Bvh` that its `BlockTree` also has
_BLOCKS = "nodes", "blocks", "bounds", "slots"


class MappedTree(NamedTuple):
    """The same tree in both forms that the ordinary tracer needs."""

    bvh: Bvh
    blocks: BlockTree


def whole_tree(store: Store) -> Bvh:
    """The tree of a store, in memory; `prim_ids` index the whole scene."""
    bvh, ids = joined_tree(store, np.arange(len(store)))
    return bvh._replace(prim_ids=ids[bvh.prim_ids])


def write_tree(bvh: Bvh, folder: Path, threads: int) -> None:
    """Write the arrays of a tree to a folder, a file each."""
    blocks = block_tree(bvh, threads)
    np.save(folder / "bvh_nodes.npy", bvh.nodes)
    for name in (*_BLOCKS, *_SHARED):
        np.save(folder / f"{name}.npy", getattr(blocks, name))


def files_of(folder: Path) -> Iterator[Path]:
    """The files of a tree."""
    yield from (folder / f"{name}.npy" for name in ("bvh_nodes", *_BLOCKS, *_SHARED))


def map_tree(folder: Path) -> MappedTree:
    """Map a tree into memory, after its pages have been dropped from the cache of the operating system."""
    for path in files_of(folder):
        drop_cached_pages(path)
    array = {path.stem: np.asarray(np.load(path, mmap_mode="c")) for path in files_of(folder)}
    shared = {name: array[name] for name in _SHARED}
    nodes, links = array["nodes"], array["nodes"].view(np.int32)
    blocks = BlockTree(nodes, links, array["blocks"], array["bounds"], array["slots"], **shared)
    return MappedTree(Bvh(array["bvh_nodes"], array["bvh_nodes"].view(np.int32), **shared), blocks)
