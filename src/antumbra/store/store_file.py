"""Store files: write chunks, directory and header; open a store, and read and check its chunks.

The directory at the end of the file holds the top tree, whose leaves are the chunks. It stays in memory while the store
is open.
"""

import hashlib
import os
import zlib
from collections.abc import Callable, Iterator
from io import FileIO
from pathlib import Path
from threading import Lock
from typing import BinaryIO, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.checks import quoted
from ..base.errors import InputError, one_line
from ..base.files import checked_file
from ..bvh import binned_sah
from ..bvh.nodes import CHILDREN, EMPTY, Bvh, aligned_empty, boxes_of, bvh_leaf, bvh_link
from ..bvh.reinsertion import reinsert
from ..scene.camera import Camera
from ..scene.lights import Light
from ..scene.mesh import MeshInfo, ObjectInfo, Source
from ..scene.scene_bounds import check_extent, frame_origin
from ..scene.scene_data import SceneData
from ..scene.triangles import Triangles
from .store_checks import chunk_fault, counts_fault, directory_fault
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
    StoreMeta,
    TopTree,
    chunk_places,
    chunk_views,
    meta_from_json,
    meta_to_json,
    pages,
)

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


# --- Writing: the chunks one after the other, then the directory, then the header -------------------------------------


class EncodedChunk(NamedTuple):
    """A chunk as bytes of the file."""

    data: NDArray[np.uint8]  # (bytes,)
    row: np.ndarray  # () TABLE: the chunk's row of the directory; the writer sets the offset


def encode_chunk(bvh: Bvh, palette: np.ndarray, index: np.ndarray) -> EncodedChunk:
    """Encode a chunk: a BVH, whose prim_ids are indices in the whole scene, and the colours of its slots.

    `palette` is (p, 3) float32; `index` is (n,) of any integer type.
    """
    n, m, p = len(bvh.prim_ids), len(bvh.nodes), len(palette)
    data = np.zeros(pages(chunk_places(n, m, p).end), np.uint8)
    chunk = chunk_views(data, n, m, p)
    for target, source in zip((*chunk.bvh[:1], *chunk.bvh[2:], *chunk[1:]), (bvh.nodes, *bvh[2:], palette, index)):
        target[...] = source
    row = np.zeros((), TABLE)
    row["bytes"], row["triangles"], row["nodes"], row["colours"] = len(data), n, m, p
    row["crc"], row["root"] = zlib.crc32(data.data), bvh.nodes[0]
    row["box"] = boxes_of(bvh.nodes[:1])[0].reshape(6)
    return EncodedChunk(data, row)


class StoreWriter:
    """Writes a store to an empty file."""

    def __init__(self, stream: BinaryIO):
        self._stream, self._end = stream, PAGE
        self._rows: list[np.ndarray] = []
        stream.seek(PAGE)  # the header stays zeros until `finish`

    def add(self, chunk: EncodedChunk) -> None:
        """Write the next chunk."""
        chunk.row["offset"] = self._end
        self._stream.write(chunk.data.data)
        self._rows.append(chunk.row)
        self._end += len(chunk.data)

    @property
    def table(self) -> np.ndarray:
        """(k,) TABLE: the directory rows of the chunks written so far."""
        return np.stack(self._rows)

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


# --- Reading: chunks are checked each time they are read --------------------------------------------------------------


_REMEDY = "copy the file again, or build it again"


class Store:
    """A store that is open for reading. Any number of processes and threads may read a store at the same time.

    A pickle holds the path; unpickling opens the file again, which must have the same contents.

    Attributes
    ----------
    path : Path
    meta : Meta
    chunks : Chunks
    top : TopTree
        The tree over the chunks; in memory, like `chunks`.
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
        """Read chunk `k` and check it. The arrays are views of `memory` and stay valid after `close`.

        Parameters
        ----------
        memory : (n,) uint8 or None
            A buffer at least as large as the chunk; None: a new one.

        Raises
        ------
        InputError
            If a byte has changed, the file is truncated, it cannot be read, or its arrays contradict each other. The
            message names the file and the chunk.
        """
        c = self.chunks
        size = int(c.bytes[k])
        data = aligned_empty((size,), "u1") if memory is None else memory[:size]
        try:
            n_read = self._read(data, int(c.offset[k]))
        except OSError as error:
            raise self._damaged(k, f"cannot be read ({error.strerror or error})") from None
        if n_read < size:
            raise self._damaged(k, "is cut short")
        if zlib.crc32(data.data) != c.crc[k]:
            raise self._damaged(k, "is damaged")
        chunk = chunk_views(data, int(c.triangles[k]), int(c.nodes[k]), int(c.colours[k]))
        if fault := chunk_fault(chunk, c.root[k], self.n_triangles):
            raise self._damaged(k, f"is not consistent ({fault})")
        return chunk

    def check(self, k: int, memory: np.ndarray | None = None) -> None:
        """Raise the InputError of `chunk` if chunk `k` is damaged."""
        self.chunk(k, memory)

    def memory(self) -> np.ndarray:
        """(n,) uint8: a new buffer, large enough for any chunk."""
        return aligned_empty((int(self.chunks.bytes.max(initial=0)),), "u1")

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def __reduce__(self) -> tuple[Callable[[Path, Path, str], "Store"], tuple[Path, Path, str]]:
        return _reopen, (self._absolute, self.path, self._digest)

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, {self.n_triangles} triangles in {len(self)} chunks)"

    def _read(self, data: np.ndarray, offset: int) -> int:
        """Fill `data` with bytes of the file from `offset` on. Return the number of bytes read."""
        if self._stream.closed:
            raise InputError(f"{self.path.name}: is closed; open it again")
        view, n_done = data.data, 0
        while n_done < len(view):
            n_read = self._read_some(view[n_done:], offset + n_done)
            if not n_read:
                break
            n_done += n_read
        return n_done

    def _read_some(self, view: memoryview, offset: int) -> int:
        if hasattr(os, "preadv"):
            return os.preadv(self._stream.fileno(), [view], offset)
        with self._lock:  # the file has one position
            self._stream.seek(offset)
            return self._stream.readinto(view) or 0

    def _damaged(self, k: int, what: str) -> InputError:
        first, end = int(self.chunks.offset[k]), int(self.chunks.offset[k] + self.chunks.bytes[k])
        return InputError(f"{self.path.name}: chunk {k} of {len(self)} (bytes {first} to {end - 1}) {what}; {_REMEDY}")


def open_store(path: str | os.PathLike[str]) -> Store:
    """Open a store: read and check its header and directory, but no chunk.

    Raises
    ------
    InputError
        If the file is missing, is not a store, has another version, is incomplete or truncated, or has a header or a
        directory that is damaged or contradicts itself.
    """
    path = Path(path)
    checked_file(path, path.name or str(path))
    stream = FileIO(path)
    try:
        offset, size, crc = _read_header(stream.read(PAGE), os.fstat(stream.fileno()).st_size, path.name)
        stream.seek(offset)
        if fault := counts_fault(stream.read(COUNTS.size), offset, size):
            raise InputError(f"{path.name}: its chunk directory is damaged ({fault}); {_REMEDY}")
        stream.seek(offset)
        directory = stream.read(size)
        if zlib.crc32(directory) != crc:
            raise InputError(f"{path.name}: its chunk directory is damaged; {_REMEDY}")
        return Store(path, stream, _directory_of(path.name, directory, offset), hashlib.sha256(directory).hexdigest())
    except BaseException:
        stream.close()
        raise


def _directory_of(name: str, data: bytes, offset: int) -> Directory:
    """The checked directory, which is at `offset`, from its bytes.

    InputError if it contradicts itself or the file, or describes the scene with fields that this release lacks.
    """
    try:
        directory = decode_directory(data)
        fault = directory_fault(directory.meta, directory.chunks, directory.top, offset)
    except (AttributeError, KeyError, TypeError):  # of a later release, since the checksum is right
        line = "describes its scene in a way that this antumbra does not know; upgrade antumbra, or build it again"
        raise InputError(f"{name}: {line}") from None
    except (ValueError, OverflowError, RecursionError) as error:
        fault = str(error)
    if fault:
        raise InputError(f"{name}: its directory is not consistent ({one_line(fault)}); {_REMEDY}")
    return directory


def _reopen(absolute: Path, path: Path, digest: str) -> Store:
    """Open the store of a pickle. Raises InputError if its file is missing or its contents have changed."""
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
        raise InputError(f"{name}: is cut short in the header; {_REMEDY}")
    if zlib.crc32(header[:HEADER_CRC]) != int.from_bytes(header[HEADER_CRC:], "little"):
        raise InputError(f"{name}: the header is damaged; {_REMEDY}")
    _, version, complete, size, offset, length, crc = HEADER.unpack_from(header)
    if version != VERSION:
        cure = "build it again" if version < VERSION else "upgrade antumbra, or build it again"
        raise InputError(f"{name}: is a store of version {version}, and this antumbra reads version {VERSION}; {cure}")
    if complete != COMPLETE:
        raise InputError(f"{name}: its build was not finished; build it again")
    if actual != size:
        wrong = "is cut short" if actual < size else "has extra bytes after its end"
        raise InputError(f"{name}: {wrong} ({actual} bytes instead of {size}); {_REMEDY}")
    if offset % PAGE or offset < 2 * PAGE or offset + length != size:
        raise InputError(f"{name}: its header places the directory at {offset}, {length} bytes long; {_REMEDY}")
    return offset, length, crc


# --- Scene data -------------------------------------------------------------------------------------------------------


class StoreData(SceneData):
    """Name, bounds, cameras and lights of a scene whose triangles are in a store. It is static."""

    resident: ClassVar[bool] = False

    def __init__(self, store: Store):
        if not isinstance(store, Store):
            raise InputError(f"store is {quoted(store)}; antumbra.load opens a store by its path")
        meta = store.meta
        check_extent(meta.bounds, store.path.name)  # earlier versions built stores of narrower scenes
        self.store, self.name, self.up, self.notes, self.duration = store, meta.name, meta.up, meta.notes, 0.0
        self.meshes: list[MeshInfo] = []
        self.objects = [ObjectInfo(meta.name, -1, 0)]
        self.bounds, self.origin, self.crs = meta.bounds, meta.origin, meta.crs
        self.middle = frame_origin(*meta.bounds)
        self.raster, self.given_unit = meta.raster, meta.unit
        self._cameras, self._lights = list(meta.cameras), list(meta.lights)

    @property
    def n_triangles(self) -> int:
        return self.store.n_triangles

    @property
    def object_of_face(self) -> np.ndarray:
        """(n,) int32, all 0, a read-only broadcast array: a store is one object."""
        return np.broadcast_to(np.int32(0), self.n_triangles)

    @property
    def colours(self) -> np.ndarray:
        """Always raises InputError: the colours are in the chunks of the store."""
        raise self.refusal()

    @property
    def source(self) -> Source:
        """Always raises InputError: what the store was built from is not known."""
        raise self.refusal()

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """Always raises InputError: the triangles are never all in memory."""
        raise self.refusal()

    def content(self, time: float, threads: int | None = None) -> Iterator[memoryview | bytes]:
        """The first page of the file, which contains the checksum of the checksums of all chunks."""
        with self.store.path.open("rb") as stream:
            yield stream.read(PAGE)

    def refusal(self) -> InputError:
        """The error raised by methods that need all triangles."""
        return InputError(
            f"{self.store.path.name}: is a store, and its {self.n_triangles:,} triangles are never all in memory; "
            "use a scene in memory for this"
        )

    def _cameras_at(self, time: float) -> list[Camera]:
        return self._cameras

    def _lights_at(self, time: float) -> list[Light]:
        return self._lights


def load_store(path: Path) -> StoreData:
    """Open the scene of a store."""
    return StoreData(open_store(path))
