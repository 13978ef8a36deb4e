"""Checked access to OGR and to tables of Arrow: which vector files are opened, and what they may refer to.

OGR chooses a driver by the content of a file, not by its suffix, and some drivers read descriptions that name other
files or addresses. A file is opened only if it starts as its suffix says. Two formats can refer to more than they
hold, and are checked: the CRS of GeoJSON may be a link, and the index of a shapefile may list records repeatedly.
"""

import json
import mmap
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import checked_file
from ...base.memory import LEAST_LIMIT, check_reading
from .raster_files import DESCRIPTIONS, HEAD

STARTS = {
    ".gpkg": rb"SQLite format 3\0",
    ".geojson": rb"(?:\xef\xbb\xbf)?\s*\{",
    ".shp": rb"\0\0\x27\x0a",
    ".fgb": rb"fgb\x03",
    ".parquet": rb"PAR1",
}
"""Suffix of a vector file -> a pattern of its first bytes."""

_CRS = re.compile(rb"[\"'](?:c|\\u00[46]3)(?:r|\\u00[57]2)(?:s|\\u00[57]3)[\"']", re.IGNORECASE)
_AFTER = re.compile(rb"\s*(?:[,}\]]|:\s*(?=[^\s/{])|:\s*(\{))")  # what may follow the text "crs"
_LONGEST = 1 << 12  # bytes of a CRS
_PLAIN = {"name", "epsg"}  # types of a CRS, in lower case, that are no links
_OF_TEXT, _OF_BINARY = 12, 2  # bytes of memory per byte of a file, of features with a few corners
_ROW_BYTES = 200  # least memory of a row


def check_vector_file(path: Path, whole: bool = True) -> None:
    """Raise an InputError unless a file is what its suffix says, and refers to nothing outside itself.

    whole : whether it will be in memory at once
    """
    checked_file(path, path.name)
    suffix = path.suffix.lower()
    if suffix not in STARTS:
        raise InputError(f"{path.name}: unknown format of vector files; use one of {', '.join(STARTS)}")
    with path.open("rb") as stream:
        head = stream.read(HEAD)
    if not re.match(STARTS[suffix], head) or DESCRIPTIONS.search(head):
        raise InputError(f"{path.name}: does not begin as a {suffix} file; is it one?")
    if whole:
        check_reading((_OF_TEXT if suffix == ".geojson" else _OF_BINARY) * path.stat().st_size, path.name)
    if suffix == ".geojson":
        _check_crs(path)
    if suffix == ".shp":
        _check_index(path)


def _check_crs(path: Path) -> None:
    """Raise an InputError if the CRS of a GeoJSON file is anything but a name, which needs no look-up."""
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as text:
        for match in _CRS.finditer(text):
            after = _AFTER.match(text, match.end())
            if after is None or (after[1] and not _is_plain(text[after.start(1) : after.start(1) + _LONGEST])):
                raise InputError(f'{path.name}: its "crs" is no name such as urn:ogc:def:crs:EPSG::28992; write one')


def _is_plain(text: bytes) -> bool:
    """Whether a text begins with a JSON object that describes a CRS by its name or its number."""
    pairs = list[tuple[str, Any]]()
    try:
        json.JSONDecoder(object_pairs_hook=pairs.extend).raw_decode(text.decode("utf-8", "replace"))
    except (ValueError, RecursionError):
        return False
    keys = {key.lower() for key, _ in pairs}
    kinds = {str(value).lower() for key, value in pairs if key.lower() == "type"}
    return keys <= {"type", "properties", "name", "code"} and kinds <= _PLAIN and len(kinds) == 1


def _check_index(path: Path) -> None:
    """Raise an InputError if the records that the index of a shapefile lists are larger than the file."""
    index = next((each for each in (path.with_suffix(".shx"), path.with_suffix(".SHX")) if each.exists()), None)
    if index is None:
        return
    data = checked_file(index, index.name).read_bytes()[100:]
    lengths = np.frombuffer(data, ">i4", len(data) // 8 * 2)[1::2].astype(np.int64)
    if (lengths < 0).any() or 2 * int(lengths.sum()) > path.stat().st_size:
        raise InputError(f"{path.name}: {index.name} lists more than the file holds; export it again")


@contextmanager
def library_errors(path: Path, things: str) -> Iterator[None]:
    """Turn the many kinds of errors of GDAL, pyarrow and geopandas into an InputError.

    things : what the rows of the file should be, such as "trees"
    """
    try:
        yield
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(f"{path.name}: not enough memory for its {things}; use a smaller file") from error
    except Exception as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path.name}: cannot be read ({reason}); is it a file of {things}?") from error


def layers_of(path: Path, things: str, whole: bool = True) -> dict[str, str]:
    """The layers of a file that have geometries, and the kind of each, such as "Multi Polygon".

    whole : as for `check_vector_file`
    """
    check_vector_file(path, whole)
    with library_errors(path, things):
        layers = import_extra("pyogrio", things, "gis").list_layers(path)
    return {str(name): str(kind) for name, kind in layers if kind is not None}


def read_vectors(path: Path, things: str, layer: str | None = None) -> Any:
    """The GeoDataFrame of a layer of a vector file.

    things : what its rows are, for errors
    layer : None: the first one

    Raises
    ------
    InputError
        If the file is not what its suffix says, refers to others, takes too much memory, or cannot be read.
    """
    geopandas = import_extra("geopandas", things, "gis")
    check_vector_file(path)
    with library_errors(path, things):
        if path.suffix.lower() == ".parquet":
            check_columns(open_parquet(path), None, path)
            return geopandas.read_parquet(path)
        layer = next(iter(layers_of(path, things)), None) if layer is None else layer
        rows = max(int(import_extra("pyogrio", things, "gis").read_info(path, layer=layer)["features"]), 0)
        check_reading(_ROW_BYTES * rows, path.name, path.stat().st_size)
        return geopandas.read_file(path, engine="pyogrio", layer=layer)


def read_features(path: Path, things: str, layer: str, after: int | None, most: int) -> Any:
    """The GeoDataFrame of some features of a GeoPackage, whose index is their numbers.

    after : the number after which they begin; None: all numbers
    most : how many are read

    Raises
    ------
    InputError
        As for `read_vectors`.
    """
    pyogrio = import_extra("pyogrio", things, "gis")
    check_vector_file(path, whole=False)
    with library_errors(path, things):
        where = None
        if after is not None:
            name = pyogrio.read_info(path, layer=layer)["fid_column"]
            where = f'"{name}" > {after}'
        return pyogrio.read_dataframe(path, layer=layer, where=where, max_features=most, fid_as_index=True)


# --- Parquet ----------------------------------------------------------------------------------------------------------


_NUMBER_BYTES = 16  # of a number: as stored in memory, and as float64
_BATCH = 64  # rows that are read to measure them
_BUFFER = 1 << 20  # bytes of a column that are read at a time

BATCH = 1 << 16
"""Rows of a table that are read at a time."""


def open_parquet(path: Path, dictionaries: Sequence[str] = (), whole: bool = True) -> Any:
    """The ParquetFile of a file that begins as one.

    dictionaries : columns whose equal values are stored once
    whole : whether all rows will be in memory at once
    """
    check_vector_file(path, whole)
    import_extra("pyarrow", ".parquet", "gis")
    import pyarrow.parquet

    return pyarrow.parquet.ParquetFile(path, read_dictionary=list(dictionaries), buffer_size=0 if whole else _BUFFER)


def check_groups(file: Any, columns: int, path: Path) -> None:
    """Raise an InputError if a row group takes too much memory while its rows are read in batches."""
    groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
    size = max((each.total_byte_size for each in groups), default=0) + _NUMBER_BYTES * columns * BATCH
    check_reading(size, path.name, path.stat().st_size)


def check_columns(file: Any, names: list[str] | None, path: Path) -> None:
    """Raise an InputError if columns take too much memory.

    A dictionary stores repeated values once. Texts and shapes that could take too much are therefore read in small
    batches, and counted.

    names : None: all columns
    """
    import pyarrow

    # only sums of row groups: Arrow ends the process when it is asked for columns with odd statistics
    groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
    schema, stored = file.schema_arrow, path.stat().st_size
    chosen = schema.names if names is None else names
    size = sum(each.total_byte_size + _NUMBER_BYTES * each.num_rows * len(chosen) for each in groups)
    plain = all(pyarrow.types.is_primitive(schema.field(name).type) for name in set(chosen) & set(schema.names))
    most = 0 if plain else sum(each.num_rows * each.total_byte_size for each in groups)
    check_reading(size, path.name, stored)
    if size + most > LEAST_LIMIT:
        for batch in file.iter_batches(_BATCH, columns=names):
            size += batch.nbytes
            check_reading(size, path.name, stored)
