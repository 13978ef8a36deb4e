"""Arrays of numbers from .npy and .npz files of any origin: sizes are checked before data are read."""

import math
import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from ..errors import InputError
from .files import checked_file

_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_METHODS = zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED
_MOST, _RATIO = 1 << 30, 20  # bytes that any file may expand to; and times its size, if that is more
_ENCRYPTED = 1  # a flag of an entry


def mapped_array(path: Path, where: str) -> np.ndarray:
    """A .npy file, memory-mapped after a check of its header against its size. Nothing is unpickled."""
    checked_file(path, where)
    with path.open("rb") as stream:
        shape, fortran, dtype = _header(stream, where)
        offset = stream.tell()
    needed = _checked_size(shape, dtype, path.stat().st_size - offset, where)
    if needed == 0:
        return np.empty(shape, dtype)
    return np.memmap(path, dtype, "r", offset, shape, "F" if fortran else "C")


def npz_arrays(path: Path, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Those of the arrays with these names, in lower case, that a .npz file has. Nothing is unpickled.

    Raises
    ------
    InputError
        If an entry is not an array of numbers, or the arrays expand to far more than the size of the file.
    Exception
        Of many kinds, if the archive is damaged: of zipfile, zlib and others.
    """
    wanted, found = set(names), {}
    with zipfile.ZipFile(path) as archive:
        entries = {entry.filename.removesuffix(".npy").lower(): entry for entry in archive.infolist()}
        entries = {name: entry for name, entry in entries.items() if name in wanted}
        check_expansion(path, sum(entry.file_size for entry in entries.values()))
        for name, entry in entries.items():
            found[name] = _array_of(archive, entry, f"{path.name}, array {name!r}")
    return found


def check_expansion(path: Path, size: int) -> None:
    """Raise an InputError if a file says that it expands to `size` bytes, and that is far more than it has."""
    real = path.stat().st_size
    if size > max(_MOST, _RATIO * real):
        raise InputError(f"{path.name}: its {real / 1e6:,.1f} MB expand to {size / 1e9:,.1f} GB; divide it")


def _array_of(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, where: str) -> np.ndarray:
    if entry.compress_type not in _METHODS or entry.flag_bits & _ENCRYPTED:
        raise InputError(f"{where} is compressed by another method, or encrypted; write it with numpy.savez")
    with archive.open(entry) as stream:
        shape, fortran, dtype = _header(stream, where)
        needed = _checked_size(shape, dtype, entry.file_size - stream.tell(), where)
        data = stream.read(needed)
        if len(data) < needed or stream.read(1):  # its end tells whether the checksum is right
            raise InputError(f"{where} has another size than it says; copy it again")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def _header(stream, where: str) -> tuple[tuple[int, ...], bool, np.dtype]:
    try:
        shape, fortran, dtype = _HEADERS[npy.read_magic(stream)](stream)
    except Exception as error:  # the header is Python source, whose parser raises many kinds of errors
        raise InputError(f"{where}: not a numpy array file; write it with numpy.save") from error
    if dtype.hasobject or dtype.kind not in "fiu":
        raise InputError(f"{where} holds {dtype}; only plain numbers are read")
    if any(n < 0 for n in shape):
        raise InputError(f"{where} has shape {shape}; write it again with numpy.save")
    return shape, fortran, dtype


def _checked_size(shape: tuple[int, ...], dtype: np.dtype, real: int, where: str) -> int:
    """Bytes of an array; InputError if there are fewer in the file."""
    needed = math.prod(shape) * dtype.itemsize
    if needed > real:
        raise InputError(f"{where} says {needed} bytes of data, but has {real}; it is cut short, copy it again")
    return needed
