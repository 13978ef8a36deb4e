"""Writes store files: the chunks one after the other, then the directory, then the header."""

import os
import shutil
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh.compact_tree import CompactTree
from ..bvh.nodes import boxes_of
from ..scene.alpha_masks import TexelMask
from .staging_files import CutoutColumns
from .store_directory import encode_directory
from .store_format import (
    COMPLETE,
    HEADER,
    HEADER_CRC,
    MAGIC,
    PAGE,
    TABLE,
    VERSION,
    CutoutSection,
    HeightSection,
    LookSection,
    StoreMeta,
    TopTree,
    chunk_places,
    chunk_views,
    pages,
)
from .stored_cutouts import write_cutouts


class EncodedChunk(NamedTuple):
    """A chunk as bytes of the file."""

    data: NDArray[np.uint8]  # (bytes,)
    row: np.ndarray  # () TABLE: the chunk's row of the directory, without its offset


def encode_chunk(tree: CompactTree, palette: np.ndarray, index: np.ndarray) -> EncodedChunk:
    """Encode a chunk: a tree, whose prim_ids are indices in the whole scene, and the colours of its slots.

    `palette` is (p, 3) float32; `index` is (n,) of any integer type.
    """
    n, m, p = len(tree.prim_ids), len(tree.nodes), len(palette)
    data = np.zeros(pages(chunk_places(n, m, p).end), np.uint8)
    chunk = chunk_views(data, n, m, p)
    for target, source in zip((*chunk.tree[:1], *chunk.tree[2:], *chunk[1:]), (tree.nodes, *tree[2:], palette, index)):
        target[...] = source
    row = np.zeros((), TABLE)
    row["bytes"], row["triangles"], row["nodes"], row["colours"] = len(data), n, m, p
    row["crc"], row["root"] = zlib.crc32(data.data), tree.nodes[0]
    row["box"] = boxes_of(tree.nodes[:1])[0].reshape(6)
    return EncodedChunk(data, row)


_COPIED = 1 << 22  # bytes copied at a time


class StoreWriter:
    """Writes a store to an empty file."""

    def __init__(self, stream: BinaryIO):
        self._stream, self._end = stream, PAGE
        self._tables: list[np.ndarray] = []
        stream.seek(PAGE)  # the header stays zeros until `finish`

    def add(self, path: Path, table: np.ndarray) -> None:
        """Write the chunks of a file, one after another; `table`: (k,) TABLE, their rows, with offsets in the file."""
        table = table.copy()
        table["offset"] += self._end
        with path.open("rb") as chunks:
            shutil.copyfileobj(chunks, self._stream, _COPIED)
        self._tables.append(table)
        self._end += int(table["bytes"].sum())

    def add_heights(self, path: Path, heights: HeightSection) -> HeightSection:
        """Write the heights in a file, after all chunks; return their place in the store."""
        with path.open("rb") as stream:
            shutil.copyfileobj(stream, self._stream, _COPIED)
        begin, self._end = self._end, self._end + heights.bytes
        return heights._replace(offset=begin)

    def add_cutouts(self, parts: Callable[[], Iterable[CutoutColumns]], masks: Sequence[TexelMask]) -> CutoutSection:
        """Write cut-outs, after the heights; the arguments are those of `write_cutouts`."""
        section = write_cutouts(self._stream, self._end, parts, masks)
        self._end += section.bytes
        return section

    def add_looks(self, path: Path, looks: LookSection) -> LookSection:
        """Write the looks in a file, after all else; return their place in the store."""
        with path.open("rb") as stream:
            shutil.copyfileobj(stream, self._stream, _COPIED)
        begin, self._end = self._end, self._end + looks.bytes
        return looks._replace(offset=begin)

    @property
    def table(self) -> np.ndarray:
        """(k,) TABLE: the directory rows of the chunks written so far."""
        return np.concatenate(self._tables)

    def finish(self, top: TopTree, meta: StoreMeta) -> int:
        """Write the directory, then the header, which marks the store as complete. Return the size of the file."""
        directory = encode_directory(self.table, top, meta)
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
        """Flush all data to the disk. Some systems do not report a full disk before."""
        self._stream.flush()
        os.fsync(self._stream.fileno())
