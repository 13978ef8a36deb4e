"""`added_shadow`: the shadows before and after a change of the scene as one, with what is new in it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.extras import import_extra
from ..changes.before_and_after import BEFORE, before_and_after
from ..sensors.sensors import Sensors
from ..tables.polygon_files import outlines
from ..tables.result_table import Table
from .plane_projection import polygons_of
from .shadow_polygons import Shadow

NEW, GONE, BOTH = "new", "gone", "both"
"""Values of the column "change"."""

_LEAST = 1e-6  # square metres: smaller parts are rounding, along edges that both states share
_HALF = 0.5  # share of the sun's light that is blocked in shadow
_ROUNDING = 1e-9  # hours: sums of intervals may fall short of a whole number


def added_shadow(
    before: Shadow, after: Shadow, limits: NDArray[np.float64], square: float, exposed: Sensors | None
) -> Shadow:
    """The polygons of both states as one `Shadow`.

    At a moment, the column "change" is "new" where only the state after is in shadow, "gone" where only the state
    before is, and "both". For days, a row is a class of added hours of shadow.

    limits : of the classes of hours
    square : square metres per square unit
    exposed : the cells that no added or removed object covers; None: the shadow falls on a plane
    """
    table = None
    if exposed is not None:
        assert before.table is not None and after.table is not None
        table = before_and_after(_on(before.table, exposed), _on(after.table, exposed))
    if table is None:
        shapes, columns = _on_plane(before, after, square)
    else:
        shapes, columns = _of_days(table, limits) if "days" in after.about else _on_cells(table)
    polygons = np.empty(len(shapes), object)
    polygons[:] = shapes
    areas = np.array([shape.area for shape in shapes], np.float64) * square
    return after._replace(polygons=polygons, columns={**columns, "area": areas}, table=table)


def _on(table: Table, exposed: Sensors) -> Table:
    """The rows of a table of all cells that are those of some of its sensors."""
    cells = np.arange(len(table)) if table.sensors.cells is None else table.sensors.cells
    rows = np.arange(len(table)) if exposed.cells is None else np.flatnonzero(np.isin(cells, exposed.cells))
    columns = {name: column._replace(values=column.values[rows]) for name, column in table.columns.items()}
    return Table(table.sensors.take(rows), columns, table.about, table.scene)


def _on_plane(before: Shadow, after: Shadow, square: float) -> tuple[list[Any], dict[str, np.ndarray]]:
    """The connected parts of the shadow of either state, and which state has them."""
    shapely = import_extra("shapely", "shadow", "gis")
    earlier, later = (shapely.union_all(list(each.polygons)) for each in (before, after))
    parts = {NEW: later.difference(earlier), GONE: earlier.difference(later), BOTH: later.intersection(earlier)}
    rows = [(name, each) for name, shape in parts.items() for each in polygons_of(shape).geoms]
    rows = [(name, each) for name, each in rows if each.area * square > _LEAST]
    return [each for _, each in rows], {"change": np.array([name for name, _ in rows], object)}


def _on_cells(table: Table) -> tuple[list[Any], dict[str, np.ndarray]]:
    """The connected cells in the shadow of either state at a moment, and which state has them."""
    assert table.sensors.raster is not None
    earlier, later = (table.sensors.on_raster(table[name]) >= _HALF for name in (f"shadow{BEFORE}", "shadow"))
    states = np.select([later & ~earlier, earlier & ~later, later & earlier], [0, 1, 2], -1)
    shapes = outlines(states.astype(np.int16), table.sensors.raster)
    rows = [((NEW, GONE, BOTH)[k], part) for k, shape in shapes for part in shape.geoms]
    return [part for _, part in rows], {"change": np.array([name for name, _ in rows], object)}


def _of_days(table: Table, limits: NDArray[np.float64]) -> tuple[list[Any], dict[str, np.ndarray]]:
    """The outlines of classes of added hours of shadow."""
    added = table.sensors.on_raster(-table["shadow_hours_loss"])
    classes = np.searchsorted(limits, added + _ROUNDING, side="right") - 1
    classes[np.isnan(added) | (added <= _ROUNDING)] = -1
    assert table.sensors.raster is not None
    shapes = outlines(classes.astype(np.int16), table.sensors.raster)
    which = np.array([k for k, _ in shapes], np.int64)
    most = max(float(table.about["hours"]), float(limits[-1]))
    return [shape for _, shape in shapes], {"hours_from": limits[which], "hours_to": np.append(limits[1:], most)[which]}
