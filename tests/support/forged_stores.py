"""Stores with changed fields and correct checksums, as a forger writes them."""

import json
import zlib

import numpy as np

from antumbra.store.store_format import COUNTS, HEADER, HEADER_CRC, NODE_BYTES, PAGE, TABLE, chunk_views, pages

HEADER_FIELDS = "magic", "version", "complete", "size", "offset", "length", "crc"
COUNT_FIELDS = "chunks", "nodes", "metadata"
ARRAYS = "nodes", "links", "corners", "prim_ids", "palette", "palette_rows"


class ForgedStore:
    """The parts of a store, which may be changed before `data` joins them.

    header, counts : fields with other values than the correct ones
    chunks : (bytes,) uint8 arrays; `arrays` has views of each chunk's arrays by name
    table : (k,) TABLE; top : (m, 16) float32; meta : dict
    """

    def __init__(self, data: bytes):
        self._words = dict(zip(HEADER_FIELDS, HEADER.unpack_from(data)))
        directory = data[self._words["offset"] :]
        k, m, size = COUNTS.unpack_from(directory)
        start = COUNTS.size + k * TABLE.itemsize
        self.header, self.counts = {}, {}
        self.table = np.frombuffer(directory, TABLE, k, COUNTS.size).copy()
        self.top = np.frombuffer(directory, np.float32, 16 * m, start).reshape(m, 16).copy()
        self.meta = json.loads(directory[start + m * NODE_BYTES :][:size])
        rows = self.table[["offset", "bytes", "triangles", "nodes", "colours"]].tolist()
        self.chunks = [np.frombuffer(data, np.uint8, size, at).copy() for at, size, *_ in rows]
        offset, size, *_ = self.meta.get("heights") or (0, 0)
        self.heights = data[offset : offset + size]
        offset, size, *_ = self.meta.get("cutouts") or (0, 0)
        self.cutouts = data[offset : offset + size]
        looks = self.meta.get("looks") or {"offset": 0, "bytes": 0}
        self.looks = data[looks["offset"] : looks["offset"] + looks["bytes"]]
        self.arrays = []
        for chunk, (_, _, *numbers) in zip(self.chunks, rows):
            tree, palette, palette_rows = chunk_views(chunk, *numbers)
            self.arrays.append(
                dict(zip(ARRAYS, (tree.nodes, tree.links, tree.corners, tree.prim_ids, palette, palette_rows)))
            )

    def seal(self):
        """Correct the checksums of the chunks, and the copies of their roots in the table."""
        for k, chunk in enumerate(self.chunks):
            self.table["crc"][k], self.table["root"][k] = zlib.crc32(chunk), self.arrays[k]["nodes"][0]
        return self

    def change_heights(self, change):
        """Replace float32 heights by others, with correct checksums."""
        _, _, (*_, rows, columns), _, crcs = self.meta["heights"]
        z = np.frombuffer(self.heights, np.float32, rows * columns).reshape(rows, columns)
        changed = np.asarray(change(z), np.float32).tobytes()
        self.heights = changed + self.heights[len(changed) :]
        size = 256 * columns * 4
        crcs[:] = [zlib.crc32(self.heights[k * size : (k + 1) * size]) for k in range(len(crcs))]

    @property
    def data(self) -> bytes:
        """The bytes of the file, with the header's and the directory's correct checksums."""
        body = b"".join(chunk.tobytes() for chunk in self.chunks) + self.heights + self.cutouts + self.looks
        meta = json.dumps(self.meta).encode()
        counts = {"chunks": len(self.table), "nodes": len(self.top), "metadata": len(meta)} | self.counts
        directory = COUNTS.pack(*counts.values()) + self.table.tobytes() + self.top.tobytes() + meta
        directory = directory.ljust(pages(len(directory)), b"\0")
        place = PAGE + len(body)
        words = self._words | {"size": place + len(directory), "offset": place, "length": len(directory)}
        words |= {"crc": zlib.crc32(directory)} | self.header
        header = HEADER.pack(*words.values()).ljust(HEADER_CRC, b"\0")
        return header + zlib.crc32(header).to_bytes(4, "little") + body + directory
