"""Tables of vector files, such as footprints and vegetation: layers of files, and columns that describe rows."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.checks import as_array, is_number, number, spelling_hint, text
from ...base.errors import InputError
from ...base.wording import counted
from .vector_files import layers_of, read_vectors

MOST_NAMES = 12
"""Columns that an error lists."""


class NamedRows(NamedTuple):
    """The rows of a table, as errors name them."""

    file: str
    thing: str  # what a row is, such as "tree"
    n: int


def read_layer(path: Path, layer: str | None, things: str, fits: Callable[[str], bool]) -> Any:
    """The GeoDataFrame of a layer.

    layer : None: the only layer that fits
    things : what its rows are, such as "trees", for errors
    fits : whether a layer's kind of geometry, such as "Multi Polygon", may be that of such rows
    """
    if path.suffix.lower() == ".parquet":
        return read_vectors(path, things)
    return read_vectors(path, things, _layer_of(path, layer, things, fits))


def _layer_of(path: Path, layer: str | None, things: str, fits: Callable[[str], bool]) -> str:
    kinds = layers_of(path, things)
    if layer is not None:
        if layer not in kinds:
            hint = spelling_hint(layer, kinds)
            raise InputError(f"{path.name}: has no layer {layer!r}; {hint}there are {', '.join(kinds)}")
        return layer
    fitting = [name for name, kind in kinds.items() if fits(kind)]
    if len(fitting) != 1:
        there = f"has the layers {', '.join(kinds)}" if kinds else "has no layers"
        raise InputError(f"{path.name}: {there}; name the one with {things}: layer=NAME, or FILE?layer=NAME")
    return fitting[0]


def given_numbers(value: Any, what: str, columns: Mapping[str, Any], rows: NamedRows) -> NDArray[np.float64] | None:
    """(n,) float64 from a number or an array; None if `value` names a column, which there is."""
    if not isinstance(value, str) and np.ndim(value) == 0 and is_number(value):
        return np.full(rows.n, number(value, what))
    if not isinstance(value, str):
        values = as_array(value, what)
        if values.shape != (rows.n,) or values.dtype.kind not in "fiu":
            raise InputError(f"{what} must be a column, a number, or {counted(rows.n, 'number')}, one per {rows.thing}")
        return values.astype(np.float64)
    if value not in columns:
        numeric = [name for name, column in columns.items() if column.dtype.kind in "fiu"]
        there = f"columns of numbers: {', '.join(numeric[:MOST_NAMES])}" if numeric else "it has no numbers"
        raise InputError(f"{rows.file}: has no column {value!r} for {what}; {spelling_hint(value, columns)}{there}")
    return None


def id_column(name: str | None, columns: Mapping[str, Any], usual: Sequence[str], rows: NamedRows) -> str | None:
    """The column that names rows: a given one, or the first usual one that there is; None: there is none."""
    if name is None:
        return next((each for each in usual if each in columns), None)
    if text(name, "id") not in columns:
        hint = spelling_hint(name, columns)
        raise InputError(f"{rows.file}: has no column {name!r} for id; {hint}it names {rows.thing}s")
    return name
