"""Pairs of points from files."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ..readsensors import SUFFIXES, check_point_file, read_array, read_columns
from ..sensors import Sensors

_ENDS = "x1", "y1", "z1", "x2", "y2", "z2"
_NORMALS = "nx1", "ny1", "nz1", "nx2", "ny2", "nz2"
_FACES = "face1", "face2"
_INDICES = "from", "to"


class PairList(NamedTuple):
    """Pairs of points, as `line_of_sight` takes them."""

    observers: np.ndarray  # (n, 3) float64
    targets: np.ndarray  # (n, 3) float64
    normals: np.ndarray | None  # (n, 3) float64
    target_normals: np.ndarray | None
    faces: np.ndarray | None  # (n,) int64
    target_faces: np.ndarray | None


def check_pairs(text: str) -> None:
    """Raise an InputError, before a scene is read, unless `--pairs` is "all", "zip" or a file that can be read."""
    if text in ("all", "zip"):
        return
    check_point_file(text, "--pairs", f"all, zip, or a {', '.join(SUFFIXES)} file")


def read_pairs(path: Path) -> PairList:
    """Pairs from a file that has both points of each.

    - CSV with a header, Parquet, NPZ: columns x1, y1, z1, x2, y2, z2, and optionally nx1 to nz1, nx2 to nz2 (normals of
      ends on surfaces) and face1, face2 (the faces on which ends lie, -1: none)
    - NPY: (n, 6)

    Raises
    ------
    InputError
        If the file cannot be read, or a column is missing or holds anything but numbers.
    """
    if path.suffix.lower() == ".npy":
        array = read_array(path)
        if array.ndim != 2 or array.shape[1] != 6 or array.dtype.kind not in "fiu":
            raise InputError(
                f"{path.name}: the array is {array.dtype} {array.shape}; pairs of points are (n, 6) numbers"
            )
        ends = array.astype(np.float64)
        return PairList(ends[:, :3], ends[:, 3:], None, None, None, None)
    columns = read_columns(path, (*_ENDS, *_NORMALS, *_FACES))
    missing = [name for name in _ENDS if name not in columns]
    if missing:
        raise InputError(f"{path.name}: column {missing[0]!r} is missing; pairs need the columns {', '.join(_ENDS)}")
    three = lambda names: np.stack([columns[n] for n in names], 1) if all(n in columns for n in names) else None
    first, second = (columns[n].astype(np.int64) if n in columns else None for n in _FACES)
    observers, targets = three(_ENDS[:3]), three(_ENDS[3:])
    assert observers is not None and targets is not None
    return PairList(observers, targets, three(_NORMALS[:3]), three(_NORMALS[3:]), first, second)


def paired(text: str, observers: Sensors, targets: Sensors) -> PairList:
    """Pairs of two lists of points: "all", "zip" (one by one), or a file of their indices.

    The file has the columns ``from`` and ``to``, or is a .npy file of (n, 2) whole numbers; the first point is 0.
    """
    if text == "all":
        first, second = (index.ravel() for index in np.indices((len(observers), len(targets))))
    elif text == "zip":
        if len(observers) != len(targets):
            raise InputError(f"--pairs zip: there are {len(observers)} observers and {len(targets)} targets; use all")
        first = second = np.arange(len(observers))
    else:
        first, second = _indices(Path(text), len(observers), len(targets))
    cut = lambda array, places: None if array is None else array[places]
    return PairList(
        observers.points[first], targets.points[second], cut(observers.normals, first), cut(targets.normals, second),
        cut(observers.faces, first), cut(targets.faces, second),
    )  # fmt: skip


def _indices(path: Path, observers: int, targets: int) -> tuple[np.ndarray, np.ndarray]:
    if path.suffix.lower() == ".npy":
        array = read_array(path)
        columns = dict(zip(_INDICES, array.T)) if array.ndim == 2 and array.shape[1] == 2 else {}
    else:
        columns = read_columns(path, _INDICES)
    if len(columns) < 2:
        raise InputError(f"{path.name}: pairs of points need the columns from and to, indices from 0")
    for name, count in zip(_INDICES, (observers, targets)):
        values = columns[name]
        if (values != np.floor(values)).any() or (values < 0).any() or (values >= count).any():
            raise InputError(f"{path.name}: column {name!r} must hold whole numbers from 0 to {count - 1}")
    return columns["from"].astype(np.int64), columns["to"].astype(np.int64)
