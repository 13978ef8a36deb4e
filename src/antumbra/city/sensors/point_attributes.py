"""The other columns of the user's tables of points: they come through to the results, or a note names them."""

import re
import warnings
from collections.abc import Collection, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError

Attributes = dict[str, NDArray[Any]]
"""Name -> one value per point: numbers, times, bool, or object for texts."""

_END = "\x1e"  # of a text among joined ones, which are matched ten times faster than one by one
_WHOLE = re.compile(rf"(?:(?:0|-?[1-9]\d{{0,17}}){_END})+")
_CODE = re.compile(rf"(?:^|{_END})0\d")  # a text with leading zeros


def left_out_note(file: str, names: list[str]) -> str:
    """The note on columns that do not come through."""
    return f"{file}: left out {_names(names)}, without a plain value for each point"


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


def _names(names: list[str]) -> str:
    return f"the column{'s' if len(names) > 1 else ''} {', '.join(names)}"


# --- Types of texts ---------------------------------------------------------------------------------------------------


def kind_of_texts(texts: Sequence[str]) -> np.dtype[Any]:
    """The type of the values that texts stand for: int64, float64, or object for the texts themselves."""
    joined = _END.join((*texts, ""))
    if joined.count(_END) == len(texts) and _WHOLE.fullmatch(joined):
        return np.dtype(np.int64)
    try:
        if not _CODE.search(joined):
            for _ in map(float, filter(None, texts)):
                pass
            return np.dtype(np.float64)
    except ValueError:
        pass
    return np.dtype(object)


def of_kind(texts: Sequence[str], kind: np.dtype[Any]) -> NDArray[Any]:
    """(n,) values of texts, in a type of `kind_of_texts` for them and perhaps others; NaN: empty."""
    if kind == np.float64:
        return np.array([float(text) if text else np.nan for text in texts], np.float64)
    return np.array([int(text) for text in texts] if kind == np.int64 else texts, kind)
