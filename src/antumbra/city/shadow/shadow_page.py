"""The page of a shadow on a plane: its polygons on a ground below the scene, in the colours of the map."""

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ...base.extras import import_extra
from ...engine.scene import Scene
from ...scene.joined_scenes import join_data
from ...scene.scene_data import MemoryData
from ...web.scene_page import Page, make_page
from ...web.value_layer import Stop, ValueLayer
from ..tables.page_layer import moment_in, place_in
from .shadow_map import CASTERS, groups_of

_MARGIN = 0.1  # of the ground around the polygons and the scene, as a share of their size
_LIFT = 0.01  # metres: of the ground above the plane, where the scene may have faces
_OPEN = Stop(0.0, "no shadow", (236, 234, 226))


def plane_page(shadow: Any, path: Any, options: dict[str, Any]) -> Page:
    """The page of a `Shadow` without cells; options as in `antumbra.Scene.page`."""
    groups, scene = groups_of(shadow), shadow.scene
    corners, rows = _ground(shadow, [group.shapes for group in groups])
    joined = Scene.of_data(join_data(cast(MemoryData, scene.data), _ground_data(scene, corners, shadow), scene.name))
    stops = [_OPEN, *(Stop(float(k), each.name, _bytes_of(each.colour)) for k, each in enumerate(groups, 1))]
    stops.append(Stop(float(len(stops)), "the scene", _bytes_of(CASTERS)))
    faces = np.concatenate([np.full(scene.n_triangles, len(stops) - 1), rows])
    layer = ValueLayer("Shadow", "", np.arange(float(len(stops))), stops, [], classes=True, faces=faces)
    given = {"place": place_in(shadow.about), "when": moment_in(shadow.about), "title": scene.name} | options
    return make_page(joined, path, layer=layer, **given)


def _ground(shadow: Any, groups: list[list[Any]]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(n, 3, 2) triangles, easting and northing; (n,) the group of each from 1, 0: no shadow."""
    shapely = import_extra("shapely", "the page of a shadow", "gis")
    drawn = [shapely.union_all(shapes) for shapes in groups]
    ends = [shapely.get_coordinates(drawn), shadow.casters.reshape(-1, 2)]
    low, high = np.concatenate(ends).min(0), np.concatenate(ends).max(0)
    margin = _MARGIN * float((high - low).max())
    rest = shapely.box(*(low - margin), *(high + margin)).difference(shapely.union_all(drawn))
    corners, rows = list[Any](), list[int]()
    for row, shape in enumerate([rest, *drawn]):
        for triangle in shapely.get_parts(shapely.constrained_delaunay_triangles(shape)):
            corners.append(shapely.get_coordinates(triangle)[:3])
            rows.append(row)
    return np.array(corners), np.array(rows)


def _ground_data(scene: Scene, plan: NDArray[np.float64], shadow: Any) -> MemoryData:
    """The triangles as a scene, that face up."""
    height = np.full(plan.shape[:2], shadow.about["height"] + scene.unit.of_metres(_LIFT))
    (ax, ay), (bx, by) = ((plan[:, k] - plan[:, 0]).T for k in (1, 2))
    plan = np.where((ax * by < ay * bx)[:, None, None], plan[:, ::-1], plan)
    east, north = plan[..., 0], plan[..., 1]
    vertices = np.stack([east, height, -north] if scene.up == "y" else [east, north, height], -1)
    unit = None if scene.data.given_unit is None else scene.data.given_unit.name
    return cast(MemoryData, Scene.from_arrays(vertices, name="ground", up=scene.up, crs=scene.crs, unit=unit).data)


def _bytes_of(colour: Any) -> tuple[int, int, int]:
    """A colour of matplotlib, ``#rrggbb`` or shares of 1, in bytes."""
    if isinstance(colour, str):
        return cast(tuple[int, int, int], tuple(bytes.fromhex(colour[1:])))
    return cast(tuple[int, int, int], tuple(round(255 * part) for part in colour[:3]))
