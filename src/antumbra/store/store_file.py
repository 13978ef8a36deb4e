"""Store files: write chunks, directory and header; open a store, and read and check its chunks.

The directory at the end of the file, with the top tree over the chunks, stays in memory while the store is open.
"""

import hashlib
import os
import zlib
from io import FileIO
from pathlib import Path
from threading import Lock
from typing import BinaryIO, NamedTuple

import numpy as np

from ..bvh import binned_sah
from ..bvh.nodes import CHILDREN, EMPTY, Bvh, aligned_empty, boxes_of, bvh_leaf, bvh_link
from ..bvh.reinsertion import reinsert
from ..checks import quoted
from ..errors import InputError
from ..files import checked_file
from ..scene.camera import Camera
from ..scene.mesh import MeshInfo, ObjectInfo
from ..scene.scene_bounds import check_extent
from ..scene.scene_data import SceneData
from ..scene.triangles import Triangles
from .store_format import (
    COMPLETE,
    COUNTS,
    HEADER,
    HEADER_CRC,
    MAGIC,
    PAGE,
    STORE_SUFFIX,
    TABLE,
    VERSION,
    Chunk,
    Chunks,
    Meta,
    chunk_places,
    chunk_views,
    meta_from_json,
    meta_to_json,
    pages,
)

# --- The top tree, over the chunks. It stays in memory ----------------------------------------------------------------


class TopTree(NamedTuple):
    """A tree whose leaves are chunks. Nodes are as in `Bvh`, but a link < 0 is ``~(8 * chunk)``, or EMPTY."""

    nodes: np.ndarray  # (m, 16) float32, 64-byte aligned
    links: np.ndarray  # (m, 16) int32, the same memory


def top_tree(boxes: np.ndarray, threads: int) -> TopTree:
    """Build the tree over boxes of chunks, (k, 6) float32: binned SAH, then insertion-based optimisation
    [Bittner et al. 2013].

    Builders take triangles. So each box becomes a triangle without area that has the same bounds.
    """
    lower, upper = boxes[:, :3], boxes[:, 3:]
    bvh = binned_sah.build(np.stack([lower, upper, lower], axis=1), threads, max_leaf=1)
    bvh = reinsert(bvh, threads)
    ends = bvh.links[:, CHILDREN]
    leaf = (ends < 0) & (ends != EMPTY)
    ends[leaf] = bvh_link(bvh.prim_ids[bvh_leaf(ends[leaf]).first], 1)
    return TopTree(bvh.nodes, bvh.links)


# --- The directory at the end of a store. It stays in memory while the store is open ----------------------------------


class Directory(NamedTuple):
    """The contents of the directory."""

    meta: Meta  # the scene, besides its triangles
    chunks: Chunks  # the table of all chunks
    top: TopTree  # the tree over the chunks


def encode_directory(table: np.ndarray, top: TopTree, meta: Meta) -> bytes:
    """The bytes of a directory, filled up with zeros to a whole page; `table` is (k,) TABLE."""
    told = meta_to_json(meta)
    data = COUNTS.pack(len(table), len(top.nodes), len(told)) + table.tobytes() + top.nodes.tobytes() + told
    return data.ljust(pages(len(data)), b"\0")


def decode_directory(data: bytes) -> Directory:
    """The directory from the bytes that `encode` returned."""
    k, m, length = COUNTS.unpack_from(data)
    table = np.frombuffer(data, TABLE, k, COUNTS.size)
    chunks = Chunks(*(np.ascontiguousarray(table[name]) for name in Chunks._fields))
    at = COUNTS.size + table.nbytes
    nodes = aligned_empty((m, 16), "f4")
    nodes[:] = np.frombuffer(data, np.float32, 16 * m, at).reshape(m, 16)
    at += nodes.nbytes
    return Directory(meta_from_json(data[at : at + length]), chunks, TopTree(nodes, nodes.view(np.int32)))


# --- Writes a store: the chunks one after the other, then the directory, then the header ------------------------------


class Encoded(NamedTuple):
    """A chunk as bytes of the file."""

    data: np.ndarray  # (bytes,) uint8
    row: np.ndarray  # () TABLE: the chunk's row of the directory; the writer sets the offset


def encode_chunk(bvh: Bvh, palette: np.ndarray, index: np.ndarray) -> Encoded:
    """Encode a chunk: a BVH and the colours of its slots. Its prim_ids are indices in the whole scene.

    `palette` is (p, 3) float32, `index` is (n,) of any integer type.
    """
    n, m, p = len(bvh.prim_ids), len(bvh.nodes), len(palette)
    data = np.zeros(pages(chunk_places(n, m, p).end), np.uint8)
    chunk = chunk_views(data, n, m, p)
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

    def finish(self, top: TopTree, meta: Meta) -> int:
        """Write the directory, then the header, which completes the store. Return the size of the file."""
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
        """Wait until the disk has all data. Some systems report a full disk only then."""
        self._stream.flush()
        os.fsync(self._stream.fileno())


# --- Opens a store, and reads its chunks into memory, checked each time -----------------------------------------------


_AGAIN = "copy the file again, or build it again"


class Store:
    """A store that is open for reading. Many processes and threads may read a store at the same time.

    A pickle holds the path. To read it opens the file again, which must have the same contents.

    Attributes
    ----------
    path : Path
    meta : Meta
    chunks : Chunks
    top : Top
        The tree over the chunks. It is in memory, like `chunks`.
    """

    def __init__(self, path: Path, stream: FileIO, directory: Directory, digest: str):
        self.path, (self.meta, self.chunks, self.top) = path, directory
        self._stream, self._lock = stream, Lock()
        self._absolute, self._digest = path.absolute(), digest

    @property
    def n_triangles(self) -> int:
        return self.meta.n_triangles

    def __len__(self) -> int:
        """The number of chunks."""
        return len(self.chunks.offset)

    def chunk(self, k: int, memory: np.ndarray | None = None) -> Chunk:
        """Read chunk `k` and check it. The arrays are views of `memory`, and stay valid after `close`.

        Parameters
        ----------
        memory : (n,) uint8 or None
            At least as large as the chunk; None: new memory.

        Raises
        ------
        InputError
            If a byte has changed, the file ends too early, or it cannot be read. It names the file and the chunk.
        """
        c = self.chunks
        size = int(c.bytes[k])
        data = aligned_empty((size,), "u1") if memory is None else memory[:size]
        try:
            got = self._read(data, int(c.offset[k]))
        except OSError as error:
            raise self._damaged(k, f"cannot be read ({error.strerror or error})") from None
        if got < size:
            raise self._damaged(k, "is cut short")
        if zlib.crc32(data) != c.crc[k]:
            raise self._damaged(k, "is damaged")
        return chunk_views(data, int(c.triangles[k]), int(c.nodes[k]), int(c.colours[k]))

    def check(self, k: int, memory: np.ndarray | None = None) -> None:
        """Raise the InputError of `chunk` if chunk `k` is damaged."""
        self.chunk(k, memory)

    def memory(self) -> np.ndarray:
        """(n,) uint8: memory for any chunk."""
        return aligned_empty((int(self.chunks.bytes.max(initial=0)),), "u1")

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def __reduce__(self):
        return _opened_again, (self._absolute, self.path, self._digest)

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, {self.n_triangles} triangles in {len(self)} chunks)"

    def _read(self, data: np.ndarray, offset: int) -> int:
        """Fill `data` with the bytes of the file from `offset` on. Return how many there were."""
        if self._stream.closed:
            raise InputError(f"{self.path.name}: is closed; open it again")
        view, done = memoryview(data), 0
        while done < len(view):
            got = self._read_some(view[done:], offset + done)
            if not got:
                break
            done += got
        return done

    def _read_some(self, view: memoryview, offset: int) -> int:
        if hasattr(os, "preadv"):
            return os.preadv(self._stream.fileno(), [view], offset)
        with self._lock:  # the file has one position
            self._stream.seek(offset)
            return self._stream.readinto(view) or 0

    def _damaged(self, k: int, what: str) -> InputError:
        first, end = int(self.chunks.offset[k]), int(self.chunks.offset[k] + self.chunks.bytes[k])
        return InputError(f"{self.path.name}: chunk {k} of {len(self)} (bytes {first} to {end - 1}) {what}; {_AGAIN}")


def open_store(path) -> Store:
    """Open a store. This reads and checks its header and its directory, and reads no chunk.

    Raises
    ------
    InputError
        If the file is missing, is no store, has another version, or its build was not finished. Also if it is cut
        short, or if its header or directory is damaged.
    """
    path = Path(path)
    checked_file(path, path.name or str(path))
    stream = FileIO(path)
    try:
        place, size, crc = _read_header(stream.read(PAGE), os.fstat(stream.fileno()).st_size, path.name)
        stream.seek(place)
        directory = stream.read(size)
        if zlib.crc32(directory) != crc:
            raise InputError(f"{path.name}: the directory of its chunks is damaged; {_AGAIN}")
        return Store(path, stream, decode_directory(directory), hashlib.sha256(directory).hexdigest())
    except BaseException:
        stream.close()
        raise


def _opened_again(absolute: Path, path: Path, digest: str) -> Store:
    """The store of a pickle. Raises InputError if its file is missing, or has other contents by now."""
    store = open_store(absolute)
    if store._digest != digest:  # the directory has the checksums of all chunks
        store.close()
        raise InputError(f"{path.name}: was written again after it was pickled; load it again")
    store.path = path
    return store


def _read_header(header: bytes, actual: int, name: str) -> tuple[int, int, int]:
    """Offset, size and CRC-32 of the directory; InputError unless the file is complete."""
    if not any(header[: len(MAGIC)]):
        raise InputError(f"{name}: its build was not finished; build it again")
    if not header.startswith(MAGIC):
        raise InputError(f"{name}: is not a store; make one by antumbra build SCENE -o FILE{STORE_SUFFIX}")
    if len(header) < PAGE:
        raise InputError(f"{name}: is cut short in the header; {_AGAIN}")
    if zlib.crc32(header[:HEADER_CRC]) != int.from_bytes(header[HEADER_CRC:], "little"):
        raise InputError(f"{name}: the header is damaged; {_AGAIN}")
    _, version, complete, size, place, length, crc = HEADER.unpack_from(header)
    if version != VERSION:
        raise InputError(f"{name}: is a store of version {version}, and only {VERSION} is read; build it again")
    if complete != COMPLETE:
        raise InputError(f"{name}: its build was not finished; build it again")
    if actual != size:
        wrong = "is cut short" if actual < size else "has something behind its end"
        raise InputError(f"{name}: {wrong} ({actual} bytes instead of {size}); {_AGAIN}")
    return place, length, crc


# --- What a scene in a store holds; only the chunks in use are in memory ----------------------------------------------


class StoreData(SceneData):
    """Name, bounds, cameras and lights of a scene whose triangles are in a store. It is static."""

    def __init__(self, store: Store):
        if not isinstance(store, Store):
            raise InputError(f"store is {quoted(store)}; antumbra.load opens a store by its path")
        meta = store.meta
        check_extent(meta.bounds, store.path.name)  # earlier versions built stores of narrower scenes
        self.store, self.name, self.up, self.notes, self.duration = store, meta.name, meta.up, meta.notes, 0.0
        self.meshes: list[MeshInfo] = []
        self.objects = [ObjectInfo(meta.name, -1, 0)]
        self.bounds, self.origin, self.crs = meta.bounds, meta.origin, meta.crs
        self._cameras, self._lights = list(meta.cameras), list(meta.lights)

    @property
    def n_triangles(self) -> int:
        return self.store.n_triangles

    @property
    def object_of_face(self) -> np.ndarray:
        """(n,) int32, all 0, read-only and without memory of its own: a store is one object."""
        return np.broadcast_to(np.int32(0), self.n_triangles)

    @property
    def colours(self) -> np.ndarray:
        """Always raises InputError: the colours are in the chunks of the store."""
        raise self.refusal()

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """Always raises InputError: the triangles are never all in memory."""
        raise self.refusal()

    def refusal(self) -> InputError:
        """The error raised by methods that need all triangles."""
        return InputError(
            f"{self.store.path.name}: is a store, and its {self.n_triangles:,} triangles are never all in memory; "
            "ask a scene in memory for this"
        )

    def _cameras_at(self, time: float) -> list[Camera]:
        return self._cameras

    def _lights_at(self, time: float) -> list:
        return self._lights


def load_store(path: Path) -> StoreData:
    """Open the scene of a store."""
    return StoreData(open_store(path))
