"""`Shadow`: polygons with attributes, their CRS, and their files: GeoPackage, GeoJSON, GeoParquet and GeoTIFF."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import checked_output
from ...base.wording import counted
from ...engine.scene import AnyScene
from ...web.kernel_module import kernel_module
from ...web.scene_page import Page
from ...work.result_summary import Summary, SummaryTable, heading, text_of
from ..sheets.method_facts import position_text
from ..sheets.page import check_map
from ..sheets.sheet import save_report
from ..sheets.sheet_options import Sheet, checked_sheet
from ..tables.map_scale import range_scale
from ..tables.polygon_files import VECTORS, check_polygon_output, level_crs, write_polygons
from ..tables.qgis_style import VectorStyle, write_style
from ..tables.result_table import BANDS, Table, raster_style, writer_of
from .shadow_map import shadow_report
from .shadow_page import plane_page

if TYPE_CHECKING:
    import geopandas

SUFFIXES = *VECTORS, *BANDS, ".html"
"""Suffixes of the files that `Shadow.save` writes."""

_LAYER = "shadow"
_MOST_ROWS = 20  # most polygons in a summary


class Shadow(NamedTuple):
    """Shadows as polygons with attributes, in the coordinates of the scene."""

    polygons: np.ndarray  # (n,) object: shapely geometries, in easting and northing of the scene
    columns: dict[str, np.ndarray]  # name -> (n,) attributes: "area" in m2, and those of the study
    about: dict[str, Any]  # metadata of the study, in JSON types, such as "time", "sun_azimuth", "sun_elevation", "crs"
    table: Table | None  # the cells, if the shadow lies on a raster
    casters: np.ndarray | None = None  # (f, 3, 2) float64: faces that cast a shadow on a plane, easting and northing
    scene: AnyScene | None = None  # whose walls a map shows

    def __repr__(self) -> str:
        return f"Shadow({counted(len(self.polygons), 'polygon')}: {', '.join(self.columns)})"

    @property
    def area(self) -> float:
        """Square metres: the sum of the polygons' areas."""
        return float(self.columns["area"].sum())

    def summary(self, seconds: float) -> Summary:
        """The place, the sun or the days, and the polygons, if they are few; `seconds`: of the study."""
        about, n = self.about, len(self.polygons)
        values = {**about, "polygons": n, "area": self.area, "seconds": seconds}
        if "sun_elevation" in about:
            sun = f"azimuth {about['sun_azimuth']:.1f}, elevation {about['sun_elevation']:.1f} degrees"
            when = "sun", f"{about['time']}: {sun}"
        else:
            when = "days", f"{about['days']}, {about['hours']:.1f} h of daylight"
        lines = [("place", position_text(about)), when, ("area", f"{self.area:,.1f} m2 in {counted(n, 'polygon')}")]
        if n > _MOST_ROWS:
            return Summary(values, lines)
        columns = {name: column.tolist() for name, column in self.columns.items()}
        rows = [[text_of(cell) for cell in row] for row in zip(*columns.values())]
        table = SummaryTable([heading(name) for name in columns], rows) if len(columns) > 1 else None
        return Summary(values, lines, {"rows": columns}, table)

    def frame(self) -> "geopandas.GeoDataFrame":
        """The polygons as a GeoDataFrame with the CRS of the scene.

        Raises
        ------
        InputError
            If geopandas is missing.
        """
        geopandas = import_extra("geopandas", "frame", "gis")
        crs = self.about.get("crs")
        frame: Any = geopandas.GeoDataFrame(
            {**self._attributes(), **self.columns}, geometry=self.polygons, crs=None if crs is None else level_crs(crs)
        )
        return frame

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the polygons in the format of the suffix: .gpkg, .geojson or .parquet (GeoParquet).

        .tif is a GeoTIFF of the cells, .zarr a Zarr store of them, .html a `page`. GeoJSON is in WGS 84 if the CRS is
        known. All formats need ``antumbra[gis]``.
        If the CRS is known, a .qml file beside it is the style in which QGIS opens it.

        Raises
        ------
        InputError
            If the suffix is unknown, the path cannot be written, a package is missing, or there are no cells.
        """
        target = check_shadow_output(path, self.table is not None)
        suffix = target.suffix.lower()
        if suffix == ".html":
            self.page(target)
            return
        if suffix in BANDS:
            assert self.table is not None
            self.table.save(target)
            if suffix == ".tif":
                self._write_style(target)
            return
        frame = self.frame()
        write_polygons(target, frame, _LAYER)
        if frame.crs is not None:
            self._write_style(target)

    def save_map(self, path: str | os.PathLike[str], *, title: str | None = None, sheet: Sheet | None = None) -> None:
        """Write a map sheet for a report, as PDF, SVG or PNG.

        The polygons have north up, a round scale 1:N, a scale bar and an arrow to true north. On a plane, the objects
        that cast the shadow are drawn above it. Beside the map are the areas, the moment or the days, and the place. A
        .pdf file has further pages: the polygons, the method with the paths of the sun, and the sources of the data.
        Needs ``antumbra[plot]``.

        Parameters
        ----------
        path : str or path-like
            A .pdf, .svg or .png file; .svg and .png hold the map.
        title : str, optional
            None: that of the sheet, or "Shadow" or "Hours of shadow".
        sheet : Sheet, optional
            Paper, scale, extent and title block. None: A4 and a scale that fits.

        Raises
        ------
        InputError
            If the suffix is unknown, the path cannot be written, the map does not fit at the sheet's scale, or
            matplotlib is missing.
        """
        target, chosen = check_map(path), checked_sheet(sheet, title)
        save_report(target, shadow_report(self), chosen)

    def page(self, path: str | os.PathLike[str] | None = None, **options: Any) -> Page:
        """Make a page of the scene, which any browser opens offline, with the shadow in colours.

        On a plane, the polygons lie on a ground, 1 cm above the plane; cells lie on the surfaces. The shadows of the
        page itself, of any moment, are shown at the same time.

        Parameters
        ----------
        path : str or path-like, optional
            An .html file. None: the page is only returned, for a notebook.
        **options
            As in `antumbra.Scene.page`. The place and the moment, or the first day, are by default those of the study.

        Returns
        -------
        Page

        Raises
        ------
        InputError
            As `antumbra.Scene.page` does.
        """
        return plane_page(self, path, options) if self.table is None else self.table.page(path, **options)

    def _write_style(self, path: Path) -> None:
        """Write the QGIS style of polygons and cells: classes of hours, or one colour."""
        columns, table = self.columns, self.table
        style = VectorStyle("area", None, "fill")
        if "hours_from" in columns:
            scale = range_scale(columns["hours_from"], columns["hours_to"], "h")
            style = VectorStyle("hours_from", scale, "fill")
        write_style(path, style, None if table is None else raster_style(table, table.shown(None)))

    def _attributes(self) -> dict[str, Any]:
        """Metadata that each row repeats, since most formats have no other place for it."""
        return {
            name: self.about[name] for name in ("time", "sun_azimuth", "sun_elevation", "days") if name in self.about
        }


def check_shadow_output(path: str | os.PathLike[str], raster: bool) -> Path:
    """The path; an InputError, before long work, unless `Shadow.save` can write to it. `raster`: with cells."""
    target = checked_output(path, SUFFIXES)
    suffix = target.suffix.lower()
    if suffix in BANDS and not raster:
        raise InputError(f"{target.name}: a raster needs cells; give their size as cell, such as 1, or use .gpkg")
    if suffix in BANDS:
        writer_of(target, "raster")
        return target
    if suffix == ".html":
        kernel_module()
        return target
    return check_polygon_output(target)
