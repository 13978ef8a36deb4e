"""The other columns of the user's tables of points: they come through to the results, or a note names them."""

import csv
import re
import warnings
import zipfile
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...formats.array_files import npz_arrays
from ..gis.vector_files import check_columns, open_parquet

Attributes = dict[str, NDArray[Any]]
"""Name -> one value per point: numbers, times, bool, or object for texts."""

_WHOLE = re.compile(r"0|-?[1-9]\d{0,17}")  # texts with leading zeros are codes
_KINDS = "fiubM"  # and text
_ABOUT = "about"  # metadata in .npz files of results
_WIDE = {"i": np.int64, "u": np.int64, "f": np.float64}


def read_attributes(path: Path, used: Collection[str], n: int) -> Attributes:
    """The columns of a .csv, .parquet or .npz file, besides those with the lower-case names `used`.

    n : number of points in the file

    Columns that are no plain values per point, such as lists, are left out with a note.
    """
    reader = {".csv": _csv, ".parquet": _parquet, ".npz": _npz}.get(path.suffix.lower())
    if reader is None:
        return {}
    columns, left_out = reader(path, used)
    columns = {name: _plain(values) for name, values in columns.items()}
    left_out += [name for name, values in columns.items() if values.shape != (n,)]
    if left_out:
        note = f"{path.name}: left out {_names(left_out)}, without a plain value for each point"
        warnings.warn(note, UserWarning, stacklevel=3)
    return {name: values for name, values in columns.items() if name not in left_out}


def warn_of_lost(file: str, attributes: Iterable[str], used: Collection[str] = ()) -> None:
    """A note if columns of a table have no place in the results; `used`: those that the study reads."""
    names = [name for name in attributes if name not in used]
    if names:
        verb = "do" if len(names) > 1 else "does"
        warnings.warn(f"{file}: {_names(names)} {verb} not come through to the results", UserWarning, stacklevel=3)


IDS = "id", "name"
"""Columns that name the rows of a table."""


def names_of_rows(file: str, attributes: Attributes, n: int) -> list[str]:
    """The name of each row, for columns of results: that in the column id or name, else its number from 1.

    Raises
    ------
    InputError
        If two rows have the same name.
    """
    column = next((name for word in IDS for name in attributes if name.lower() == word), None)
    if column is None:
        return [str(k + 1) for k in range(n)]
    names = [str(value) for value in attributes[column].tolist()]
    twice = next((name for name in names if names.count(name) > 1), None) if len(set(names)) < n else None
    if twice is not None:
        raise InputError(f"{file}: the {column} {twice!r} is that of several rows; give each its own")
    return names


def with_attributes(own: Attributes, attributes: Attributes, results: Attributes) -> Attributes:
    """All columns of a table of results: the attributes stand before the results.

    An attribute whose name is taken, or has a meaning in files of points, gets ``_given`` after it.
    """
    taken = {name.lower() for name in (*own, *results, *_RESERVED)}
    columns = dict(own)
    for name, values in attributes.items():
        free = name
        while free.lower() in taken:
            free += "_given"
        taken.add(free.lower())
        columns[free] = values
    return columns | results


_RESERVED = "fid", "ogc_fid", "geom", "geometry"


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """Numbers in the types that all formats of tables have."""
    wide = _WIDE.get(values.dtype.kind)
    return values if wide is None else values.astype(np.float64 if values.dtype == np.uint64 else wide)


def _names(names: list[str]) -> str:
    return f"the column{'s' if len(names) > 1 else ''} {', '.join(names)}"


# --- Readers ----------------------------------------------------------------------------------------------------------


def _csv(path: Path, used: Collection[str]) -> tuple[Attributes, list[str]]:
    with open(path, newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        header = [name.strip() for name in next(rows, [])]
        places = {name: k for k, name in reversed(list(enumerate(header))) if name and name.lower() not in used}
        texts: dict[str, list[str]] = {name: [] for name in header if name in places}
        for row in rows if texts else ():
            if row:
                for name, values in texts.items():
                    values.append(row[places[name]].strip() if places[name] < len(row) else "")
    repeated = [name for k, name in enumerate(header) if name in places and places[name] != k]
    return {name: _values(values) for name, values in texts.items() if name not in repeated}, repeated


def _values(texts: list[str]) -> NDArray[Any]:
    """Whole numbers, numbers (NaN: empty), or the texts themselves."""
    if texts and all(_WHOLE.fullmatch(text) for text in texts):
        return np.array([int(text) for text in texts], np.int64)
    try:
        if not any(text[:1] == "0" and text[1:2].isdigit() for text in texts):
            return np.array([float(text) if text else np.nan for text in texts], np.float64)
    except ValueError:
        pass
    return np.array(texts, object)


def _parquet(path: Path, used: Collection[str]) -> tuple[Attributes, list[str]]:
    with open_parquet(path) as file:
        schema = file.schema_arrow
    import pyarrow  # after the check that it is installed

    geometries = b"geo" in (schema.metadata or {})  # points have a geometry of their own in the results
    names = [name for name in schema.names if name.lower() not in used]
    names = [name for name in names if not (geometries and pyarrow.types.is_binary(schema.field(name).type))]
    kinds = {name: _kind_of(schema.field(name).type) for name in names}
    texts = [name for name, kind in kinds.items() if kind is str]
    numbers = [name for name, kind in kinds.items() if kind is not str and _is_plain(kind)]
    columns = Attributes()
    with open_parquet(path, texts) as file:
        check_columns(file, texts + numbers, path)
        for name in texts + numbers:
            values = file.read(columns=[name])[name].unify_dictionaries().combine_chunks()
            columns[name] = _texts_of(values) if name in texts else np.asarray(values.to_numpy(zero_copy_only=False))
    plain = [name for name in names if name in texts or (name in numbers and _is_plain(columns[name].dtype))]
    return {name: columns[name] for name in plain}, [name for name in names if name not in plain]


def _kind_of(kind: Any) -> Any:
    """The NumPy type of an Arrow type; str for texts, None for other types that NumPy lacks."""
    import pyarrow

    if str(kind.value_type if pyarrow.types.is_dictionary(kind) else kind) in ("string", "large_string"):
        return str
    try:
        return kind.to_pandas_dtype()
    except NotImplementedError:
        return None


def _is_plain(kind: Any) -> bool:
    """Whether values of a type are numbers or times, unlike bool with missing values."""
    return isinstance(kind, type | np.dtype) and np.dtype(kind).kind in _KINDS


def _texts_of(values: Any) -> NDArray[Any]:
    """(n,) of texts in a dictionary of Arrow; missing ones are empty."""
    known = np.array([*(text or "" for text in values.dictionary.to_pylist()), ""], object)
    return np.asarray(known[values.indices.fill_null(-1).to_numpy(zero_copy_only=False)])


def _npz(path: Path, used: Collection[str]) -> tuple[Attributes, list[str]]:
    with zipfile.ZipFile(path) as archive:
        names = dict.fromkeys(name.removesuffix(".npy").lower() for name in archive.namelist())
    columns, left_out = Attributes(), list[str]()
    for name in names:
        if name in used or name == _ABOUT:
            continue
        try:
            columns |= npz_arrays(path, [name])
        except InputError:  # no numbers
            left_out.append(name)
    return columns, left_out
