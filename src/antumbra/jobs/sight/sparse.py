"""Visibility matrices as sparse matrices (CSR), as ``scipy.sparse.load_npz`` reads them."""

import zipfile
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from .bitrows import unpacked

_ROWS = 256  # rows that are unpacked at a time


def _index_type(counts: np.ndarray) -> type:
    return np.int32 if counts.sum() < 2**31 else np.int64


def _starts(counts: np.ndarray) -> np.ndarray:
    """(n + 1,): where each row begins in the indices."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(_index_type(counts))


def _indices(bits: np.ndarray, columns: int, kind: type) -> Iterator[np.ndarray]:
    """Yield the columns of the set bits of a few hundred rows, row by row."""
    for first in range(0, len(bits), _ROWS):
        yield np.nonzero(unpacked(bits[first : first + _ROWS], columns))[1].astype(kind)


def sparse_matrix(bits: np.ndarray, columns: int, counts: np.ndarray):
    """A ``scipy.sparse.csr_array`` of bool."""
    from scipy.sparse import csr_array

    kind = _index_type(counts)
    indices = np.concatenate([np.empty(0, kind), *_indices(bits, columns, kind)])
    return csr_array((np.ones(len(indices), bool), indices, _starts(counts)), shape=(len(bits), columns))


def write_sparse(file: BinaryIO, bits: np.ndarray, columns: int, counts: np.ndarray) -> None:
    """Write a .npz file of the set bits, a few hundred rows at a time."""
    total, kind = int(counts.sum()), _index_type(counts)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        small = {
            "format": np.array(b"csr"),
            "_is_array": np.array(True),
            "shape": np.array((len(bits), columns), np.int64),
            "indptr": _starts(counts),
        }
        for name, array in small.items():
            _write(archive, name, array.dtype, array.shape, [array])
        _write(archive, "indices", np.dtype(kind), (total,), _indices(bits, columns, kind))
        steps = range(0, total, 1 << 20)
        _write(archive, "data", np.dtype(bool), (total,), (np.ones(min(1 << 20, total - k), bool) for k in steps))


def _write(archive: zipfile.ZipFile, name: str, dtype: np.dtype, shape: tuple[int, ...], pieces) -> None:
    """Write an array, in pieces, as a member of an archive."""
    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
        about = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, about)
        for piece in pieces:
            member.write(piece.tobytes())
