"""Result tables: one row per sensor, columns with units, and a CRS; with writers for all output formats.

The formats are CSV, JSON, NPZ, Parquet, GeoPackage, GeoTIFF, Zarr, PNG, GLB and HTML. A writer takes a `Table`, the
path, and the name of the column that pictures show. A style of QGIS is written beside files with a CRS.
"""

import io
import json
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.checks import checked_instance, points, quoted, spelling_hint
from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import atomic_output, check_disk_space, checked_output, temporary_name
from ...base.wording import counted
from ...engine.scene import AnyScene
from ...engine.scene_loading import scene_of
from ...picture.image_files import save_png
from ...scene.camera import Camera
from ...scene.crs import checked_crs
from ...scene.raster import Raster
from ...web.kernel_module import kernel_module
from ...web.scene_page import Page, make_page
from ..sensors.point_attributes import with_attributes
from ..sensors.sensors import Sensors, check_on_scene
from ..sheets.page import check_map
from ..sheets.sheet_options import Sheet, checked_sheet
from .column_totals import ColumnTotals, totals_of
from .false_colours import coloured_model, false_colours
from .map_legend import scale_of
from .map_sheet import save_map
from .page_layer import moment_in, place_in, table_layer
from .parquet_files import PARTITIONED, in_milliseconds, on_map, save_parquet, save_parts, units_of, well_known
from .qgis_style import RasterStyle, VectorStyle, write_style
from .raster_arrays import dataset_of, zarr_of_bands
from .table_html import table_html

# --- Writers ----------------------------------------------------------------------------------------------------------


_ROWS = 1 << 16  # rows converted to text at a time
_TILE = 256  # cells along the sides of the tiles of a GeoTIFF
_IN_MEMORY = 1 << 26  # bytes of a raster that is made in memory, where a full disk is an error of Python
_COG = ".cog.tif"
_CACHE = 1 << 26  # bytes that GDAL holds while it copies a raster
_NO_UNIT = "1"  # in GeoTIFF, where readers fill in the unit of heights of a compound CRS if there is none
_NO_CRS = 'LOCAL_CS["Undefined Cartesian SRS"]'  # in GeoPackage
_DATE = "OGR_CURRENT_DATE"


def _csv(table: "Table", path: Path, column: str) -> None:
    with atomic_output(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        for k, block in enumerate(table.blocks()):
            columns = block.rows()
            if k == 0:
                file.write(",".join(columns) + "\n")
            for first in range(0, len(block), _ROWS):
                texts = [csv_texts(values[first : first + _ROWS]) for values in columns.values()]
                file.writelines(",".join(row) + "\n" for row in zip(*texts))


def csv_texts(values: np.ndarray) -> list[str]:
    """Values as CSV fields: the shortest text that round-trips, empty for NaN and NaT; names quoted where needed."""
    if values.dtype.kind in "UO":
        return ['"' + text.replace('"', '""') + '"' if set(text) & set(',"\r\n') else text for text in values.tolist()]
    if values.dtype.kind == "M":
        return ["" if text == "NaT" else text for text in np.datetime_as_string(values).tolist()]
    return ["" if value != value else str(value) for value in values.tolist()]


def _json(table: "Table", path: Path, column: str) -> None:
    rows = {name: plain_values(values) for name, values in table.rows().items()}
    document = {"about": table.about, "columns": units_of(table), "rows": rows}
    with atomic_output(path) as temporary:
        temporary.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")


def plain_values(values: np.ndarray) -> list[Any]:
    """Values for JSON: None for NaN."""
    if values.dtype.kind == "M":
        return [text or None for text in csv_texts(values)]
    return [None if value != value else value for value in values.tolist()]


def _npz(table: "Table", path: Path, column: str) -> None:
    metadata = json.dumps({"about": table.about, "columns": units_of(table)})
    rows = {name: values.astype("U") if values.dtype.kind == "O" else values for name, values in table.rows().items()}
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, about=np.array(metadata), **rows)


def _parquet(table: "Table", path: Path, column: str) -> None:
    save_parquet(table, path)
    if table.about.get("crs"):
        _write_style(table, path, column)


def _partitions(table: "Table", path: Path, column: str) -> None:
    save_parts(table, path)


def _geopackage(table: "Table", path: Path, column: str) -> None:
    """A layer of points, named like the file."""
    raw = import_extra("pyogrio.raw", ".gpkg", "gis")
    rows, memory = table.rows(), io.BytesIO()
    geometry = np.empty(len(table), object)
    geometry[:] = well_known(on_map(table))
    crs = table.about.get("crs")
    with undated():
        raw.write(
            memory, geometry, [in_milliseconds(values) for values in rows.values()], list(rows), driver="GPKG",
            layer=path.stem, geometry_type="Point Z", crs=checked_crs(crs) if crs else _NO_CRS,
        )  # fmt: skip
    with atomic_output(path) as temporary:
        temporary.write_bytes(memory.getvalue())
    _write_style(table, path, column)


@contextmanager
def undated() -> Iterator[None]:
    """Let GDAL write a fixed date instead of that of today, so that equal results have equal bytes."""
    pyogrio = import_extra("pyogrio", ".gpkg", "gis")
    before = pyogrio.get_gdal_config_option(_DATE)
    pyogrio.set_gdal_config_options({_DATE: "1970-01-01T00:00:00.000Z"})
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options({_DATE: before})


def _write_style(table: "Table", path: Path, column: str) -> None:
    """Write the QGIS style of a column beside a raster or a layer of points."""
    scale = scale_of(table, column)
    write_style(path, VectorStyle(column, scale, "marker"), raster_style(table, column))


def raster_style(table: "Table", column: str) -> RasterStyle | None:
    """The QGIS style of a column in a GeoTIFF; None if the sensors form no raster."""
    if table.raster is None:
        return None
    return RasterStyle(scale_of(table, column), list(table.totals).index(column) + 1)


def _raster(table: "Table", path: Path, column: str) -> None:
    start, suffix = next(table.blocks()), path.suffix.lower()
    raster, names = start.sensors.raster, bands_of(start)
    assert raster is not None
    with BANDS[suffix](path, raster, {name: start.columns[name].unit for name in names}, table.about) as write:
        for first, values in _strips(table, raster, names):
            write(first, values)
    if suffix == ".tif":
        _write_style(table, path, column)


@contextmanager
def tiff_of_bands(
    path: Path, raster: Raster, units: dict[str, str], about: dict[str, Any]
) -> Iterator[Callable[[int, NDArray[np.float32]], None]]:
    """Write a GeoTIFF in tiles; the context is a function that writes rows.

    It takes the first row, a multiple of 256, and (bands, rows, columns) float32, NaN: no data. A name that ends in
    .cog.tif is written as a Cloud Optimized GeoTIFF, which also has overviews.

    units : name of each band -> its unit
    about : metadata of the study
    """
    import_extra("rasterio", ".tif", "gis")
    import rasterio
    from rasterio.windows import Window

    shape = {"width": raster.columns, "height": raster.rows, "count": len(units)}
    place = rasterio.transform.from_origin(raster.west, raster.north, raster.spacing, raster.spacing)
    options = {"driver": "GTiff", "dtype": "float32", "nodata": np.nan, "transform": place, "bigtiff": "IF_SAFER"}
    options |= {"tiled": True, "blockxsize": _TILE, "blockysize": _TILE, "interleave": "band"}
    options |= {"compress": "deflate", "zlevel": 1}  # twice as fast as the default level, and 4 % larger
    options |= {"sparse_ok": True}  # tiles without data are left out
    if about.get("crs"):
        options["crs"] = checked_crs(about["crs"])  # as text, so that rasterio keeps the code of a compound CRS
    size, is_cog = 4 * len(units) * raster.n_cells, path.name.lower().endswith(_COG)
    with atomic_output(path) as temporary, ExitStack() as stack:
        if size <= _IN_MEMORY:
            memory = stack.enter_context(rasterio.MemoryFile())
            file = stack.enter_context(memory.open(**shape, **options))
        else:
            # On a full disk, GDAL leaves a part of the file without an error.
            check_disk_space(path, tiff_bytes(path, raster, len(units)))
            tiff = stack.enter_context(temporary_name(temporary.parent)) if is_cog else temporary
            file = stack.enter_context(rasterio.open(tiff, "w", **shape, **options))

        def write(first: int, values: NDArray[np.float32]) -> None:
            for band, rows in enumerate(values, 1):
                if not (np.isnan(rows[0, 0]) and np.isnan(rows).all()):
                    file.write(rows, band, window=Window(0, first, raster.columns, len(rows)))

        yield write
        for band, (name, unit) in enumerate(units.items(), 1):
            file.set_band_description(band, name)
            file.set_band_unit(band, unit or _NO_UNIT)
        file.update_tags(antumbra=json.dumps(about))
        file.close()
        if is_cog and size <= _IN_MEMORY:
            plain, memory = memory, stack.enter_context(rasterio.MemoryFile())
            _copy_as_cog(plain.name, memory.name)
        elif is_cog:
            _copy_as_cog(tiff, temporary)
        if size <= _IN_MEMORY:
            temporary.write_bytes(memory.read())


def _copy_as_cog(tiff: str | Path, path: str | Path) -> None:
    """Copy a GeoTIFF as a Cloud Optimized one. Overviews hold values of cells: numbers of observers have no mean."""
    from rasterio import Env, shutil

    options = {"compress": "deflate", "bigtiff": "IF_SAFER", "sparse_ok": True, "overview_resampling": "nearest"}
    with Env(GDAL_CACHEMAX=_CACHE):  # else GDAL holds a large part of the raster, as far as there is memory
        shutil.copy(tiff, path, driver="COG", **options)


def tiff_bytes(path: Path, raster: Raster, bands: int) -> int:
    """Bytes of a raster without compression; a Cloud Optimized one is a copy, whose overviews take a third."""
    size = 4 * bands * raster.n_cells
    return size * 7 // 3 if path.name.lower().endswith(_COG) else size


BANDS = {".tif": tiff_of_bands, ".zarr": zarr_of_bands}
"""Suffix of a raster -> the context that writes its bands."""


def _strips(table: "Table", raster: Raster, names: list[str]) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield (first row, (bands, rows, columns) values) of each row of tiles; cells without a value are NaN."""
    size, strip, next_row = _TILE * raster.columns, None, 0
    for block in table.blocks():
        sensors = block.sensors
        cells = np.arange(len(sensors)) if sensors.cells is None else sensors.cells
        known = np.flatnonzero(sensors.covered)
        known = known[np.argsort(cells[known], kind="stable")]
        cells = cells[known]
        columns = [block[name] for name in names]
        for start in range(next_row * raster.columns, int(cells[-1]) + 1 if len(cells) else 0, size):
            first, last = np.searchsorted(cells, [start, start + size])
            if strip is None:
                strip = np.full((len(names), min(_TILE, raster.rows - next_row), raster.columns), np.nan, np.float32)
            for values, out in zip(columns, strip.reshape(len(names), -1)):
                out[cells[first:last] - start] = values[known[first:last]]
            if last < len(cells) or cells[-1] == start + size - 1:
                yield next_row, strip
                next_row, strip = next_row + _TILE, None
    while next_row < raster.rows:
        if strip is None:
            strip = np.full((len(names), min(_TILE, raster.rows - next_row), raster.columns), np.nan, np.float32)
        yield next_row, strip
        next_row, strip = next_row + _TILE, None


def bands_of(table: "Table") -> list[str]:
    """The columns that a GeoTIFF holds, a band each."""
    return [name for name, candidate in table.columns.items() if candidate.values.dtype.kind in "fiub"]


def _png(table: "Table", path: Path, column: str) -> None:
    save_png(false_colours(table, column), path)


def _glb(table: "Table", path: Path, column: str) -> None:
    data = coloured_model(table, column)
    with atomic_output(path) as temporary:
        temporary.write_bytes(data)


def _html(table: "Table", path: Path, column: str) -> None:
    table.page(path, column)


Writer: TypeAlias = "Callable[[Table, Path, str], None]"

WRITERS: dict[str, Writer] = {
    ".csv": _csv,
    ".json": _json,
    ".npz": _npz,
    ".parquet": _parquet,
    PARTITIONED: _partitions,
    ".gpkg": _geopackage,
    ".tif": _raster,
    ".zarr": _raster,
    ".png": _png,
    ".glb": _glb,
    ".html": _html,
}
"""Suffix -> writer(table, path, column)."""

STREAMED = _csv, _parquet, _partitions, _raster
"""Writers of tables by block."""

_EXTRA = dict.fromkeys((".parquet", PARTITIONED), ("pyarrow", "gis"))
_EXTRA |= {".gpkg": ("pyogrio", "gis"), ".tif": ("rasterio", "gis")}
_EXTRA |= {".zarr": ("zarr", "xarray")}


def writer_of(path: str | os.PathLike[str], kind: str) -> Writer:
    """The function that writes a table to this path; call it before long work begins, to check the path.

    kind : the kind of the sensors

    Raises
    ------
    InputError
        If the suffix is unknown, the path cannot be written, a package is missing, or a raster is requested for sensors
        that form none.
    """
    target = checked_output(path, tuple(WRITERS))
    suffix = target.suffix.lower()
    if suffix in BANDS and kind != "raster":
        what = "a GeoTIFF" if suffix == ".tif" else "Zarr"
        raise InputError(f"{target.name}: {what} holds a raster, and the sensors are of kind {kind!r}; use .csv")
    if suffix in _EXTRA:
        package, extra = _EXTRA[suffix]
        import_extra(package, suffix, extra)
    if suffix == ".html":
        kernel_module()
    return WRITERS[suffix]


# --- Tables -----------------------------------------------------------------------------------------------------------


class Column(NamedTuple):
    """One value per sensor."""

    values: np.ndarray  # (n,) float, int, bool, datetime64, or object for names
    unit: str  # such as "h" or "kWh/m2"; empty: dimensionless
    about: str  # one-line description


class MadeFrom(NamedTuple):
    """How the rows of a table were made from a table with a row per sensor."""

    table: "Table"
    make: "Callable[[Table], Table]"


@dataclass(eq=False)
class Table:
    """The results of a study, one row per sensor.

    sensors : Sensors
        One for each row.
    columns : dict of str to Column
        Pictures show the first one by default.
    about : dict
        Metadata of the study, in JSON types: "job", its name; "timezone"; settings; "length_unit", the unit of
        coordinates and lengths; "up", the axis of the scene that points up; and "crs", the CRS of the scene or else of
        the raster file that defines the cells.
    scene : Scene or None
        The scene of the sensors; pictures need it.
    camera : Camera or None
        For pictures other than maps. None: one that shows the whole scene.
    marks : (k, 3) float or None
        World positions that pictures show as dots.
    row_of_face : (faces,) int or None
        For rows that stand for several faces, such as buildings: the row of each face, -1: none. Pictures and models
        show its values on these faces.
    made_from : MadeFrom or None
        The table of sensors whose verdicts and groups these rows are. None: these are the rows of the study.

    Examples
    --------
    >>> wall = at.Scene.from_arrays([[-9, 5, 0], [9, 5, 0], [9, 5, 3], [-9, 5, 3]], [[0, 1, 2], [0, 2, 3]], up="z")
    >>> table = at.sky_view(wall, [[0, 4, 1], [0, 4, 3]])
    >>> table
    Table(2 rows: sky_view, sky_share)
    >>> table["sky_view"].round(2)
    array([0.65, 1.  ])
    >>> table.save("sky.csv")  # doctest: +SKIP
    """

    sensors: Sensors
    columns: dict[str, Column]
    about: dict[str, Any] = field(default_factory=dict)
    scene: AnyScene | None = None
    camera: Camera | None = None
    marks: np.ndarray | None = None
    row_of_face: np.ndarray | None = None
    made_from: MadeFrom | None = None

    def __post_init__(self) -> None:
        checked_instance(self.sensors, Sensors, "sensors")
        if not isinstance(self.columns, dict) or not all(isinstance(name, str) for name in self.columns):
            raise InputError(f"columns are {quoted(self.columns)}; they must be a dict of names to antumbra.Column")
        for name, column in self.columns.items():
            values = checked_instance(column, Column, f"column {name!r}").values
            if not isinstance(values, np.ndarray) or values.shape != (len(self.sensors),):
                raise InputError(
                    f"column {name!r} must be an array of {counted(len(self.sensors), 'value')}, one for each sensor"
                )
        if not isinstance(self.about, dict):
            raise InputError(f"about is {quoted(self.about)}; it must be a dict")
        if self.scene is not None:
            self.scene = scene_of(self.scene)
            check_on_scene(self.sensors, self.scene)
        if self.camera is not None:
            checked_instance(self.camera, Camera, "camera")
        self.marks = None if self.marks is None else points(self.marks, "marks")
        raster = self.sensors.raster
        if self.scene is not None:
            self.about = {"length_unit": self.scene.unit.name, "up": self.scene.up, **self.about}
        crs = (self.scene and self.scene.crs) or (raster and raster.crs)
        if crs:
            self.about = {"crs": crs, **self.about}

    def blocks(self) -> Iterator["Table"]:
        """The table itself, as the only one of its `TableBlocks`."""
        yield self

    def whole(self) -> "Table":
        """The table itself."""
        return self

    def close(self) -> None:
        """No-op."""

    @property
    def totals(self) -> "dict[str, ColumnTotals]":
        """The totals of the columns of numbers."""
        return totals_of(self)

    @property
    def kind(self) -> str:
        """The kind of the sensors."""
        return self.sensors.kind

    @property
    def raster(self) -> Raster | None:
        """The raster that the sensors form."""
        return self.sensors.raster

    def __len__(self) -> int:
        return len(self.sensors)

    def __getitem__(self, name: str) -> np.ndarray:
        """The values of a column. Raises InputError with the names of all columns if there is none of this name."""
        if not isinstance(name, str) or name not in self.columns:
            names = ", ".join(self.columns)
            raise InputError(f"there is no column {quoted(name)}; {spelling_hint(name, self.columns)}there are {names}")
        return self.columns[name].values

    def __repr__(self) -> str:
        return f"Table({counted(len(self), 'row')}: {', '.join(self.columns)})"

    def _repr_html_(self) -> str:
        """A picture and the first rows, for notebooks."""
        return table_html(self)

    def save(self, path: str | os.PathLike[str], column: str | None = None) -> None:
        """Write the table in the format of the suffix.

        .csv, .json, .npz, .parquet and .gpkg hold all columns; .parquet is GeoParquet if the CRS is known, .gpkg a
        layer of points. .png is a false-colour picture with a legend, .glb a model in the same colours, .tif a GeoTIFF
        of a raster, .zarr a Zarr store of one, .html a `page`. .parquet, .gpkg and .tif need ``antumbra[gis]``, .zarr
        ``antumbra[xarray]``.

        Beside GeoParquet, GeoPackage and GeoTIFF, a .qml file is the style in which QGIS opens them: classes for yes
        and no, else colours up to the greatest value. A style there that was saved by QGIS stays.

        Parameters
        ----------
        path : str or path-like
        column : str, optional
            The column that a picture, model or page shows. None: the first one.

        Raises
        ------
        InputError
            If the suffix is unknown, the format cannot hold this table, or the path cannot be written.
        """
        writer_of(path, self.sensors.kind)(self, Path(path), self.shown(column))

    def to_xarray(self) -> Any:
        """The columns of numbers as a Dataset of xarray, over the cells of the raster that the sensors form.

        Cells without a value are NaN. If the scene was made from a DataArray and its cells are the sensors, the Dataset
        has its dimensions and coordinates, in the same order. Needs ``antumbra[xarray]``.

        Raises
        ------
        InputError
            If the sensors form no raster.
        """
        raster, names = self.raster, bands_of(self)
        if raster is None:
            raise InputError(f"a Dataset holds a raster, and the sensors are of kind {self.kind!r}; use raster:SPACING")
        values = np.concatenate([strip for _, strip in _strips(self, raster, names)], 1)
        units = {name: self.columns[name].unit for name in names}
        axes = self.scene.data.axes if self.scene is not None and self.scene.raster == raster else None
        return dataset_of(raster, axes, dict(zip(names, values)), units, self.about)

    def save_map(
        self, path: str | os.PathLike[str], column: str | None = None, *, title: str | None = None,
        sheet: Sheet | None = None,
    ) -> None:  # fmt: skip
        """Write a map sheet for a report, as PDF, SVG or PNG.

        The map has north up, a round scale 1:N, coordinates, a scale bar in the unit of the scene, and an arrow to true
        north. Rasters are drawn as maps, continuous quantities smoothly; faces are seen from above; points have labels
        from the user's table. Walls are drawn as outlines. The legend has classes for yes and no, is centred on zero
        for losses, and otherwise ends at the greatest value. A .pdf file has further pages: the table, the method with
        the paths of the sun, and the sources of the data. Needs ``antumbra[plot]``. The same table gives the same file.

        Parameters
        ----------
        path : str or path-like
            A .pdf, .svg or .png file; .svg and .png hold the map.
        column : str, optional
            The column of the map. None: the first one.
        title : str, optional
            None: that of the sheet, or what the column holds.
        sheet : Sheet, optional
            Paper, scale, extent, labels and title block. None: A4 and a scale that fits.

        Raises
        ------
        InputError
            If the suffix or the column is unknown, the path cannot be written, the map does not fit at the sheet's
            scale, there are no rows, or matplotlib is missing.
        """
        save_map(self, check_map(path), self.shown(column), checked_sheet(sheet, title))

    def page(self, path: str | os.PathLike[str] | None = None, column: str | None = None, **options: Any) -> Page:
        """Make a page of the scene, which any browser opens offline, with a column in colours on its surfaces.

        A click tells the value. The scale and its colours are those of `save_map`.

        Parameters
        ----------
        path : str or path-like, optional
            An .html file. None: the page is only returned, for a notebook.
        column : str, optional
            None: the first one.
        **options
            As in `antumbra.Scene.page`. The place, and the day of the first picture, are by default those of the study.

        Returns
        -------
        Page

        Raises
        ------
        InputError
            As `antumbra.Scene.page` does; or if the table has no scene, or the column is unknown or not numeric.
        """
        name = self.shown(column)
        if self.scene is None:
            raise InputError("the table has no scene, which a page shows; give the table a scene")
        given = {"place": place_in(self.about), "when": moment_in(self.about), "camera": self.camera} | options
        return make_page(self.scene, path, layer=table_layer(self, name), **given)

    def shown(self, column: str | None) -> str:
        """The name of the column that a picture shows. Raises InputError if it is unknown or not numeric."""
        if not self.columns:
            raise InputError("the table has no columns; there is nothing to show")
        name = next(iter(self.columns)) if column is None else column
        if self[name].dtype.kind not in "fiub":
            what = "names" if self[name].dtype.kind in "UO" else "times"
            raise InputError(f"column {name!r} holds {what}, and a picture shows numbers; name another column")
        return name

    def of_faces(self, name: str) -> NDArray[np.float64]:
        """(faces,) float64: the area-weighted mean of a column on each face; NaN for faces without a sensor.

        Raises
        ------
        InputError
            If the sensors do not lie on faces.
        """
        sensors, scene = self.sensors, self.scene
        if self.row_of_face is not None:
            return np.asarray(np.append(self[name].astype(np.float64), np.nan)[self.row_of_face])
        if sensors.faces is None or scene is None or sensors.kind == "vertex":
            raise InputError("values of faces need sensors on faces; use the sensors face or grid:SPACING")
        on = sensors.faces >= 0
        faces, areas = sensors.faces[on], np.ones(on.sum()) if sensors.areas is None else sensors.areas[on]
        total = np.bincount(faces, areas, scene.n_triangles)
        with np.errstate(invalid="ignore"):
            return np.bincount(faces, areas * self[name][on], scene.n_triangles) / total

    def rows(self) -> dict[str, np.ndarray]:
        """Name -> (n,) values: the sensors' columns (x, y, z, nx, ny, nz, area, face), attributes, then the results.

        An attribute whose name is that of another column gets ``_given`` after it.
        """
        sensors = self.sensors
        columns = dict(zip("xyz", sensors.points.T))
        if sensors.normals is not None:
            columns |= dict(zip(("nx", "ny", "nz"), sensors.normals.T))
        if sensors.areas is not None:
            columns["area"] = sensors.areas
        if sensors.faces is not None:
            columns["face"] = sensors.faces
        results = {name: column.values for name, column in self.columns.items()}
        return with_attributes(columns, sensors.attributes, results)
