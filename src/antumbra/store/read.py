"""Opens a store. Chunks are views of the memory-mapped file; the system reads a page when it is first touched."""

import mmap
import zlib
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..scene.files import checked_file
from .directory import Directory, decode
from .layout import COMPLETE, HEADER, HEADER_CRC, MAGIC, PAGE, STORE_SUFFIX, VERSION, Chunk, views

_AGAIN = "copy the file again, or build it again"


class _Mapping:
    """A file's bytes as an array that keeps the mapping alive.

    The array claims to be writable, though the pages are not. In Numba a read-only array has another type, so every
    kernel would be compiled again for it.
    """

    def __init__(self, mapped: mmap.mmap):
        self._export = memoryview(mapped)  # keeps the mapping from being closed
        address = np.frombuffer(mapped, np.uint8).ctypes.data
        self.__array_interface__ = {"version": 3, "shape": (len(mapped),), "typestr": "|u1", "data": (address, False)}


class Store:
    """A store that is open for reading. Many processes and threads may read a store at the same time.

    Attributes
    ----------
    path : Path
    meta : Meta
    chunks : Chunks
    top : Top
        The tree over the chunks. It is in memory, like `chunks`.
    """

    def __init__(self, path: Path, mapped: mmap.mmap, directory: Directory):
        self.path, (self.meta, self.chunks, self.top) = path, directory
        self._mapped: mmap.mmap | None = mapped
        self._data = np.asarray(_Mapping(mapped))

    @property
    def n_triangles(self) -> int:
        return self.meta.n_triangles

    def __len__(self) -> int:
        """The number of chunks."""
        return len(self.chunks.offset)

    def chunk(self, k: int) -> Chunk:
        """Chunk `k` as views of the file. This reads and checks nothing. The views stay valid after `close`."""
        c = self.chunks
        return views(self._bytes(k), int(c.triangles[k]), int(c.nodes[k]), int(c.colours[k]))

    def check(self, k: int) -> None:
        """Raise an InputError that names the file and chunk `k` if a byte has changed. Reads all pages of the chunk."""
        if zlib.crc32(self._bytes(k)) != self.chunks.crc[k]:
            first, end = int(self.chunks.offset[k]), int(self.chunks.offset[k] + self.chunks.bytes[k])
            raise InputError(
                f"{self.path.name}: chunk {k} of {len(self)} (bytes {first} to {end - 1}) is damaged; {_AGAIN}"
            )

    def release(self, k: int) -> None:
        """Release the memory of chunk `k`'s pages. Its views stay valid; touching them reads the file again."""
        if self._mapped is None or not hasattr(mmap, "MADV_DONTNEED"):
            return
        first = int(self.chunks.offset[k])
        end = (first + int(self.chunks.bytes[k])) // mmap.PAGESIZE * mmap.PAGESIZE  # pages may be larger than PAGE
        first = -(-first // mmap.PAGESIZE) * mmap.PAGESIZE
        if first < end:
            self._mapped.madvise(mmap.MADV_DONTNEED, first, end - first)

    def close(self) -> None:
        """Close the file. It stays mapped as long as there are views of chunks."""
        self._mapped = None
        self._data = np.empty(0, np.uint8)

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, {self.n_triangles} triangles in {len(self)} chunks)"

    def _bytes(self, k: int) -> np.ndarray:
        if self._mapped is None:
            raise InputError(f"{self.path.name}: is closed; open it again")
        return self._data[self.chunks.offset[k] : self.chunks.offset[k] + self.chunks.bytes[k]]


def open_store(path) -> Store:
    """Open a store. This reads and checks its header and its directory, and touches no chunk.

    Raises
    ------
    InputError
        If the file is missing, is no store, has another version, or its build was not finished. Also if it is cut
        short, or if its header or directory is damaged.
    """
    path = Path(path)
    checked_file(path, path.name or str(path))
    with path.open("rb") as stream:
        place, size, crc = _read_header(stream.read(PAGE), path.stat().st_size, path.name)
        mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    directory = mapped[place : place + size]
    if zlib.crc32(directory) != crc:
        raise InputError(f"{path.name}: the directory of its chunks is damaged; {_AGAIN}")
    return Store(path, mapped, decode(directory))


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
