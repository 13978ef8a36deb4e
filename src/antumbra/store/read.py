"""Opens a store, and reads its chunks into memory, checked each time."""

import hashlib
import os
import zlib
from io import FileIO
from pathlib import Path
from threading import Lock

import numpy as np

from ..bvh.nodes import aligned_empty
from ..errors import InputError
from ..scene.files import checked_file
from .directory import Directory, decode
from .layout import COMPLETE, HEADER, HEADER_CRC, MAGIC, PAGE, STORE_SUFFIX, VERSION, Chunk, views

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
        return views(data, int(c.triangles[k]), int(c.nodes[k]), int(c.colours[k]))

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
        return Store(path, stream, decode(directory), hashlib.sha256(directory).hexdigest())
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
