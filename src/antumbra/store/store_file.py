"""Store files: open a store, and read and check its chunks.

A chunk is checked when it is first read, and again once the file has changed. The directory, with the tree over the
chunks, stays in memory while the store is open.
"""

import hashlib
import os
import zlib
from collections.abc import Callable, Iterator
from io import FileIO
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError, one_line
from ..base.files import checked_file
from ..base.remote_files import RemoteFile, url_of
from ..bvh.compact_tree import bvh_of
from ..bvh.nodes import Bvh, aligned_empty
from ..scene.triangle_setup import rows_with_area
from .store_checks import chunk_fault, counts_fault, directory_fault
from .store_directory import Directory, decode_directory
from .store_format import (
    COMPLETE,
    COUNTS,
    HEADER,
    HEADER_CRC,
    MAGIC,
    OLDEST,
    PAGE,
    STORE_SUFFIX,
    VERSION,
    Chunk,
    chunk_views,
)
from .stored_cutouts import CUTOUT_BYTES, StoredCutouts, read_cutouts
from .stored_heights import StoredHeights
from .stored_looks import LooksPart, SceneLooks, StoredLooks

_REMEDY = "copy the file again, or build it again"


class Bytes(Protocol):
    """A file that several threads read at a time."""

    size: int

    @property
    def closed(self) -> bool: ...

    def read(self, view: memoryview, offset: int) -> int:
        """Fill a view with the bytes from `offset` on, and return their number; fewer at the end of the file."""
        ...

    def state(self) -> object:
        """Equal to an earlier one if the bytes are those of then."""
        ...

    def close(self) -> None: ...


class _LocalFile:
    """The bytes of a file on this machine: `Bytes`."""

    def __init__(self, path: Path):
        self._stream, self._lock = FileIO(path), Lock()
        self.size = os.fstat(self._stream.fileno()).st_size

    @property
    def closed(self) -> bool:
        return self._stream.closed

    def read(self, view: memoryview, offset: int) -> int:
        n_done = 0
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

    def state(self) -> tuple[int, int]:
        """Time and size of the file."""
        status = os.fstat(self._stream.fileno())
        return status.st_mtime_ns, status.st_size

    def close(self) -> None:
        self._stream.close()


class FaceRange(NamedTuple):
    """Consecutive chunks of a store whose faces are numbered by int32, from the first one on."""

    chunks: slice
    first: int  # number of face 0 in the scene
    triangles: int
    total: int  # number of faces of the scene

    @property
    def is_all(self) -> bool:
        """Whether these are all faces of the scene, under the same numbers."""
        return self.triangles == self.total

    def faces(self, numbers: NDArray[np.int32]) -> NDArray[Any]:
        """The faces of the scene, int64 unless these are all, of numbers in the range; -1 stays."""
        return numbers if self.is_all else np.where(numbers >= 0, numbers + np.int64(self.first), np.int64(-1))

    def numbers(self, faces: NDArray[Any]) -> NDArray[Any]:
        """The int32 numbers in the range of faces of the scene; -1: none, or in another range."""
        if self.is_all:
            return faces
        numbers = faces.astype(np.int64) - self.first
        return np.where((numbers >= 0) & (numbers < self.triangles), numbers, -1).astype(np.int32)


class Store:
    """A store that is open for reading. Any number of processes and threads may read a store at the same time.

    A pickle holds the path; unpickling opens the file again, which must have the same contents. Of a store at a URL,
    only the chunks that are needed are fetched.

    Attributes
    ----------
    path : Path
    size : int
        Bytes of the file.
    meta : Meta
    chunks : Chunks
    top : TopTree
        The tree over the chunks; in memory, like `chunks`.
    ranges : tuple of FaceRange
        One, of all faces; several only for tiles of more than 2^31 - 1 faces.
    digest : str
        SHA-256 of the directory, which has the checksums of all chunks.
    version : int
        That of the file format.
    """

    def __init__(self, path: Path, file: Bytes, directory: Directory, digest: str, version: int = VERSION):
        self.path, (self.meta, self.chunks, self.top) = path, directory
        self._file, self.size, self.version = file, file.size, version
        self.ranges: tuple[FaceRange, ...] = (FaceRange(slice(0, len(self)), 0, self.n_triangles, self.n_triangles),)
        self._absolute, self.digest = path if url_of(path) else path.absolute(), digest
        self._state: object = None  # of the file whose chunks have been checked
        self._checked = np.zeros(len(self.chunks.offset), np.bool_)

    @property
    def n_triangles(self) -> int:
        return self.meta.n_triangles

    @property
    def has_cutouts(self) -> bool:
        """Whether some faces let light pass."""
        return self.meta.cutouts is not None

    @property
    def face_dtype(self) -> type[np.signedinteger]:
        """int32, or int64 for more faces than int32 can number."""
        return np.int32 if self.ranges[0].is_all else np.int64

    def __len__(self) -> int:
        """The number of chunks."""
        return len(self.chunks.offset)

    def chunk(self, k: int, memory: np.ndarray | None = None) -> Chunk:
        """Read chunk `k`. The arrays are views of `memory` and stay valid after `close`.

        The chunk is checked when it is first read, and again once the size of the file or its time has changed.

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
        state = self._file_state()
        try:
            n_read = self.read(data.data, int(c.offset[k]))
        except OSError as error:
            raise self._damaged(k, f"cannot be read ({error.strerror or error})") from None
        if n_read < size:
            raise self._damaged(k, "is cut short")
        chunk = chunk_views(data, int(c.triangles[k]), int(c.nodes[k]), int(c.colours[k]))
        is_unchanged = self._file_state() == state
        if not (is_unchanged and self._checked[k]):
            if zlib.crc32(data.data) != c.crc[k]:
                raise self._damaged(k, "is damaged")
            if fault := chunk_fault(chunk, c.root[k], self.n_triangles):
                raise self._damaged(k, f"is not consistent ({fault})")
            self._checked[k] = is_unchanged
        return chunk

    def check(self, k: int, memory: np.ndarray | None = None) -> None:
        """Raise the InputError of `chunk` if chunk `k` is damaged, whether or not it has been checked before."""
        self._checked[k] = False
        self.chunk(k, memory)

    def heights(self) -> StoredHeights | None:
        """The heights of the terrain that is the scene; None: it is another scene, or an earlier version built it."""
        if (section := self.meta.heights) is None:
            return None
        damaged = lambda what: InputError(f"{self.path.name}: its heights {what}; {_REMEDY}")
        return StoredHeights(self.meta.name, self.meta.crs, section, self.read, damaged)

    def cutouts(self) -> StoredCutouts | None:
        """Read the faces that let light pass; None: all faces are solid. InputError if they are damaged."""
        if (section := self.meta.cutouts) is None:
            return None
        damaged = lambda what: InputError(f"{self.path.name}: its cut-outs {what}; {_REMEDY}")
        return read_cutouts(section, self.read, self.meta.box, self.n_triangles, damaged)

    def looks(self) -> SceneLooks | None:
        """What reads the looks of faces; None: all have plain colours."""
        return None if (looks := self.own_looks()) is None else SceneLooks([LooksPart(0, looks)])

    def own_looks(self) -> StoredLooks | None:
        """The looks of the faces of this file."""
        if (section := self.meta.looks) is None:
            return None
        damaged = lambda what: InputError(f"{self.path.name}: its looks {what}; {_REMEDY}")
        return StoredLooks(section, self.n_triangles, self.read, damaged)

    def cutout_bytes(self) -> int:
        """The memory that tracing of the cut-outs takes."""
        section = self.meta.cutouts
        return 0 if section is None else CUTOUT_BYTES * section.faces + 2 * section.texels

    def trees(self) -> Iterator[Bvh]:
        """The trees of the chunks, one after the other; each is valid until the next one is requested.

        The first face of a file is in a chunk even if it has no area; another one of the chunk takes its place, if any.
        """
        memory = self.memory()
        for k in range(len(self)):
            bvh = bvh_of(self.chunk(k, memory).tree)
            rows = rows_with_area(bvh.corners.reshape(-1, 3, 3), 1)
            if rows is None:
                yield bvh
            elif len(rows):
                corners = np.repeat(bvh.corners[rows[:1]], len(bvh.corners), 0)
                corners[rows] = bvh.corners[rows]
                yield bvh._replace(corners=corners)

    def memory(self) -> np.ndarray:
        """(n,) uint8: a new buffer, large enough for any chunk."""
        return aligned_empty((int(self.chunks.bytes.max(initial=0)),), "u1")

    def content(self) -> Iterator[bytes]:
        """Bytes that change with the scene: the first page, which has the checksum of the checksums of all chunks."""
        page = bytearray(PAGE)
        self.read(memoryview(page), 0)
        yield bytes(page)

    def read(self, view: memoryview, offset: int) -> int:
        """Fill a view with bytes of the file from `offset` on. Return the number of bytes read."""
        if self._file.closed:
            raise InputError(f"{self.path.name}: is closed; open it again")
        return self._file.read(view, offset)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __reduce__(self) -> tuple[Callable[..., "Store"], tuple[object, ...]]:
        return _reopen, (self._opener(), self._absolute, self.path, self.digest)

    def _opener(self) -> "Callable[[Path], Store]":
        return open_store

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, {self.n_triangles} triangles in {len(self)} chunks)"

    def _file_state(self) -> object:
        """The state of the file. If it has changed, no chunk counts as checked any more."""
        if self._file.closed:
            raise InputError(f"{self.path.name}: is closed; open it again")
        state = self._file.state()
        if state != self._state:
            self._checked, self._state = np.zeros(len(self), np.bool_), state
        return state

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
    file = open_bytes(path)
    try:
        version, offset, size, crc = _read_header(_bytes_of(file, 0, PAGE), file.size, path.name)
        if fault := counts_fault(_bytes_of(file, offset, COUNTS.size), offset, size):
            raise InputError(f"{path.name}: its chunk directory is damaged ({fault}); {_REMEDY}")
        directory = _bytes_of(file, offset, size)
        if zlib.crc32(directory) != crc:
            raise InputError(f"{path.name}: its chunk directory is damaged; {_REMEDY}")
        digest = hashlib.sha256(directory).hexdigest()
        return Store(path, file, _directory_of(path.name, directory, offset), digest, version)
    except BaseException:
        file.close()
        raise


def open_bytes(path: Path) -> Bytes:
    """The bytes of a file on this machine or at a URL; InputError if it is missing."""
    url, name = url_of(path), path.name or str(path)
    return RemoteFile(url, name) if url else _LocalFile(checked_file(path, name))


def _bytes_of(file: Bytes, offset: int, size: int) -> bytes:
    """Up to `size` bytes of a file."""
    data = bytearray(max(0, min(size, file.size - offset)))
    return bytes(memoryview(data)[: file.read(memoryview(data), offset)])


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


def _reopen(opener: Callable[[Path], Store], absolute: Path, path: Path, digest: str) -> Store:
    """Open the store of a pickle. Raises InputError if its file is missing or its contents have changed."""
    store = opener(absolute)
    if store.digest != digest:
        store.close()
        raise InputError(f"{path.name}: was written again after it was pickled; load it again")
    store.path = path
    return store


def _read_header(header: bytes, actual: int, name: str) -> tuple[int, int, int, int]:
    """The version; offset, size and CRC-32 of the directory. InputError unless the file is complete."""
    if not any(header[: len(MAGIC)]):
        raise InputError(f"{name}: its build was not finished; build it again")
    if not header.startswith(MAGIC):
        raise InputError(f"{name}: is not a store; make one by antumbra build SCENE -o FILE{STORE_SUFFIX}")
    if len(header) < PAGE:
        raise InputError(f"{name}: is cut short in the header; {_REMEDY}")
    if zlib.crc32(header[:HEADER_CRC]) != int.from_bytes(header[HEADER_CRC:], "little"):
        raise InputError(f"{name}: the header is damaged; {_REMEDY}")
    _, version, complete, size, offset, length, crc = HEADER.unpack_from(header)
    if not OLDEST <= version <= VERSION:
        cure = "build it again" if version < OLDEST else "upgrade antumbra, or build it again"
        known = f"versions {OLDEST} to {VERSION}"
        raise InputError(f"{name}: is a store of version {version}, and this antumbra reads {known}; {cure}")
    if complete != COMPLETE:
        raise InputError(f"{name}: its build was not finished; build it again")
    if actual != size:
        wrong = "is cut short" if actual < size else "has extra bytes after its end"
        raise InputError(f"{name}: {wrong} ({actual} bytes instead of {size}); {_REMEDY}")
    if offset % PAGE or offset < 2 * PAGE or offset + length != size:
        raise InputError(f"{name}: its header places the directory at {offset}, {length} bytes long; {_REMEDY}")
    return version, offset, length, crc
