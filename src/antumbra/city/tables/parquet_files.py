"""Tables as Parquet: one file, or a folder of parts with a manifest.

A folder NAME.parquets has files part-00000.parquet and so on, in the order of the rows, as Arrow, Dask and GeoPandas
expect. Each part records what it belongs to and a digest of its pages, so that any process can write it, and any other
check it. `_manifest.json`, which these readers pass over, lists the parts. Tables are `result_table.Table`, or its
`TableBlocks`.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ...base.extras import import_extra
from ...base.files import PARTS_MANIFEST, atomic_folder, atomic_output
from ...scene.crs import checked_crs
from ...scene.units import METRE
from ..gis.vector_files import open_parquet

# --- Files ------------------------------------------------------------------------------------------------------------


_GROUP = 1 << 17  # rows of a group
_POINT_Z = 1001  # well-known binary: a point with three coordinates
_KEY = "antumbra"  # of the metadata of a table
_PART = "antumbra_part"  # of the record of a part
_PAGES = "pages"  # in this record: SHA-256 of all bytes before the footer


def save_parquet(table: Any, path: Path) -> None:
    """Write a table, or one made by block, as a file."""
    with atomic_output(path) as temporary:
        write_parquet(table, temporary)


def write_parquet(table: Any, path: Path, part: dict[str, Any] | None = None) -> None:
    """Write a table, or one made by block, at a path.

    part : record of a part, in JSON types; None: the file is the whole table, and has its metadata
    """
    import_extra("pyarrow", ".parquet", "gis")
    import pyarrow
    import pyarrow.parquet

    first, box = next(table.blocks()), _MapBounds()
    columns = {name: _arrow_type(values) for name, values in first.rows().items()}
    if table.about.get("crs"):
        columns["geometry"] = pyarrow.binary()
    about = {"columns": units_of(first)} if part is not None else {"about": table.about, "columns": units_of(first)}
    metadata, schema = {_KEY: json.dumps(about)}, pyarrow.schema(columns)
    with open(path, "wb") as file:
        sink = _HashedFile(file)
        with pyarrow.parquet.ParquetWriter(
            pyarrow.PythonFile(sink, "w"), schema, compression="zstd", store_schema=False
        ) as writer:  # a stored schema would hide the metadata, which are known last
            for group in _row_groups(_arrow_blocks(table, schema, box)):
                writer.write_table(group)
            if "geometry" in columns:
                metadata["geo"] = json.dumps(_geo(table.about["crs"], box))
            if part is not None:
                metadata[_PART] = json.dumps({**part, _PAGES: sink.digest.hexdigest()})
            writer.add_key_value_metadata(metadata)


class _HashedFile:
    """A file that is written, with a digest of what has been written."""

    closed = False  # the owner of the file closes it

    def __init__(self, file: BinaryIO):
        self._file, self.digest = file, hashlib.sha256()

    def write(self, data: Any) -> int:
        self.digest.update(data)
        return self._file.write(data)

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        """No-op."""


def units_of(table: Any) -> dict[str, dict[str, str]]:
    """The unit and the meaning of each column, also of those of the sensors."""
    length = table.about.get("length_unit", METRE.name)
    known = {name: (length, f"{name} of the sensor") for name in "xyz"}
    known |= {f"n{name}": ("", f"{name} of its normal") for name in "xyz"}
    known |= {"area": (f"{length}2", "area that it represents"), "face": ("", "the face on which it lies; -1: none")}
    known |= {name: (column.unit, column.about) for name, column in table.columns.items()}
    of_user = "", "of the table of sensors"
    columns = {name: known.get(name, of_user) for name in table.rows()}
    return {name: {"unit": unit, "about": about} for name, (unit, about) in columns.items()}


class _MapBounds:
    """The bounds of points, on the map."""

    low = high = None

    def add(self, at: NDArray[np.float64]) -> None:
        if len(at):
            self.low = at.min(0) if self.low is None else np.minimum(self.low, at.min(0))
            self.high = at.max(0) if self.high is None else np.maximum(self.high, at.max(0))


def _arrow_type(values: np.ndarray) -> Any:
    """The type of a column, which does not depend on its values, since blocks and parts have the same."""
    import pyarrow

    return pyarrow.string() if values.dtype.kind in "OU" else pyarrow.array(in_milliseconds(values[:0])).type


def _arrow_blocks(table: Any, schema: Any, box: _MapBounds) -> Iterator[Any]:
    """The rows of a table as tables of Arrow, with their points if the schema has them, which are added to the box."""
    import pyarrow

    for block in table.blocks():
        columns: list[Any] = [in_milliseconds(values) for values in block.rows().values()]
        if "geometry" in schema.names:
            at = on_map(block)
            box.add(at)
            columns.append(well_known(at))
        arrays = [pyarrow.array(values, kind) for values, kind in zip(columns, schema.types)]
        yield pyarrow.Table.from_arrays(arrays, schema=schema)


def _row_groups(blocks: Iterator[Any]) -> Iterator[Any]:
    """Tables of Arrow in groups of `_GROUP` rows, whatever the blocks, so that equal rows give equal bytes."""
    import pyarrow

    held: Any = None
    for block in blocks:
        held = block if held is None else pyarrow.concat_tables([held, block])
        while len(held) > _GROUP:
            yield held.slice(0, _GROUP).combine_chunks()
            held = held.slice(_GROUP)
    if held is not None:
        yield held.combine_chunks()


def in_milliseconds(values: np.ndarray) -> np.ndarray:
    """Times in milliseconds, since Parquet has no minutes; other values unchanged."""
    return values.astype("datetime64[ms]") if values.dtype.kind == "M" else values


def on_map(table: Any) -> NDArray[np.float64]:
    """(n, 3) float64: easting, northing and height of the sensors."""
    points: NDArray[np.float64] = table.sensors.points
    return points[:, [0, 2, 1]] * [1.0, -1.0, 1.0] if table.scene is not None and table.scene.up == "y" else points


def well_known(points: np.ndarray) -> list[bytes]:
    """Points in well-known binary."""
    rows = np.empty(len(points), [("order", "u1"), ("kind", "<u4"), ("xyz", "<f8", 3)])
    rows["order"], rows["kind"], rows["xyz"] = 1, _POINT_Z, points
    data, size = rows.tobytes(), rows.itemsize
    return [data[k : k + size] for k in range(0, len(data), size)]


def _geo(crs: str, box: _MapBounds) -> dict[str, Any]:
    """GeoParquet 1.1 metadata."""
    from pyproj import CRS

    column: dict[str, Any] = {"encoding": "WKB", "geometry_types": ["Point Z"]}
    if box.low is not None and box.high is not None:
        column["bbox"] = [*box.low.tolist(), *box.high.tolist()]
    column["crs"] = CRS.from_user_input(checked_crs(crs)).to_json_dict()
    return {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}


# --- Folders of parts -------------------------------------------------------------------------------------------------


PARTITIONED = ".parquets"
"""Suffix of a folder. It names the format, as of Zarr, where a slash at the end is lost in `Path`."""

_FORMAT = 1  # of the manifest
_BYTES = 1 << 20  # read at a time


def save_parts(table: Any, path: Path) -> None:
    """Write a table, or one made by block, as a folder with a part for each block."""
    with atomic_folder(path) as temporary:
        temporary.mkdir()
        files = list[Path]()
        for k, block in enumerate(table.blocks()):
            files.append(temporary / f"part-{k:05d}.parquet")
            write_parquet(block, files[-1], {"rows": len(block)})
        write_manifest(temporary, files, table.about)


def save_files(files: list[Path], path: Path, about: dict[str, Any]) -> None:
    """Make a folder of parts that are written. They are linked, so they take no more room where the disk knows links.

    about : metadata of the study
    """
    digits = max(5, len(str(len(files) - 1)))
    with atomic_folder(path) as temporary:
        temporary.mkdir()
        names = [temporary / f"part-{k:0{digits}d}.parquet" for k in range(len(files))]
        for file, name in zip(files, names):
            _link(file, name)
        write_manifest(temporary, names, about)


def _link(file: Path, name: Path) -> None:
    try:
        os.link(file, name)
    except OSError:  # another disk, or one without links
        name.write_bytes(file.read_bytes())


def write_manifest(folder: Path, files: Iterable[Path], about: dict[str, Any]) -> None:
    """Write the metadata of the study, the columns, and the rows, bytes and SHA-256 of each part."""
    parts, columns = list[dict[str, Any]](), {}
    for file in files:
        with open_parquet(file, whole=False) as opened:
            footer = opened.metadata
        columns = json.loads(footer.metadata[_KEY.encode()])["columns"]
        with open(file, "rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        size = file.stat().st_size
        parts.append({"file": file.name, "rows": footer.num_rows, "bytes": size, "sha256": digest})
    rows = sum(part["rows"] for part in parts)
    manifest = {"format": _FORMAT, "about": about, "columns": columns, "rows": rows, "parts": parts}
    (folder / PARTS_MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")


def part_record(path: Path) -> dict[str, Any] | None:
    """The record of a part; None if the file is missing, no part, or its pages are not those that were written."""
    with suppress(Exception):  # pyarrow raises many kinds of errors for damaged files
        with open_parquet(path, whole=False) as opened:
            record: dict[str, Any] = json.loads(opened.metadata.metadata[_PART.encode()])
        digest = hashlib.sha256()
        with open(path, "rb") as file:
            file.seek(-8, os.SEEK_END)
            left = file.tell() - int.from_bytes(file.read(4), "little")
            file.seek(0)
            while data := file.read(min(left, _BYTES)):
                digest.update(data)
                left -= len(data)
        if record.pop(_PAGES) == digest.hexdigest():
            return record
    return None


def part_columns(path: Path, names: Iterable[str]) -> tuple[list[np.ndarray], list[tuple[str, str]]]:
    """The values of columns of a part, and the unit and the meaning of each."""
    names = list(names)
    with open_parquet(path) as file:
        table = file.read(names)
    about = json.loads(table.schema.metadata[_KEY.encode()])["columns"]
    values = [table[name].to_numpy() for name in names]
    return values, [(about[name]["unit"], about[name]["about"]) for name in names]
