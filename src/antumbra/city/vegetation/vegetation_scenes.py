"""`from_trees`: vegetation from geographic data, alone or added to a scene."""

import warnings
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from ...base.checks import text
from ...base.errors import InputError
from ...engine.scene import AnyScene, Scene
from ...engine.scene_loading import SceneLike, scene_of
from ...scene.crs import checked_crs, in_one_unit
from ...scene.joined_scenes import join_data
from ...scene.map_degrees import check_no_degrees
from ...scene.scene_bounds import plan_bounds
from ...scene.scene_data import MemoryData, group_notes
from ...scene.units import checked_unit
from .crowns import CrownMeshes
from .vegetation_table import Plants, VegetationLike, VegetationOptions, read_vegetation

if TYPE_CHECKING:
    from ...engine.paged_scene import PagedScene


def from_trees(
    trees: VegetationLike,
    height: Any = "height",
    radius: Any = None,
    transmittance: Any = 0.0,
    *,
    scene: "SceneLike | None" = None,
    shape: str = "ellipsoid",
    base: Any = None,
    crown_base: Any = None,
    trunk_radius: Any = None,
    id: str | None = None,
    layer: str | None = None,
    crs: str | None = None,
    unit: str | None = None,
    name: str | None = None,
) -> "Scene | PagedScene":
    """Plants as closed crowns on trunks, which let a share of the light pass; alone, or added to a scene.

    Lengths are in the unit of the coordinates. Each of `height`, `radius`, `base`, `crown_base` and `trunk_radius` is a
    number, the name of a column, or (n,) numbers.

    Parameters
    ----------
    trees : str, path-like, or GeoDataFrame
        Points, the feet of the trunks; or outlines of crowns, whose centroids are these feet. A GeoPackage, GeoJSON,
        shapefile, FlatGeobuf or GeoParquet file, a CSV file with the columns x and y, or a GeoDataFrame of geopandas.
    height : number, str, or (n,) float
        Height of the top above the foot.
    radius : number, str, or (n,) float, optional
        Largest radius of the crown. None: the column ``radius``; for outlines, that of a circle with the same area.
    transmittance : float, three floats, twelve of these, or str
        The share of the light that a whole crown lets pass, from 0 to 1; shares of red, green and blue; one of these
        for each month from January to December; or the name of a column of shares.
    scene : Scene, or anything that `load` takes, optional
        The scene to which the plants are added; it stays unchanged. It must have no instances. A store keeps its frame,
        to which the plants, in memory, are rounded. Its default camera differs: it fits all plants and what the store
        recorded, while that of a scene in memory fits a sample of all faces. Name a camera to compare both.
    shape : "ellipsoid" or "cone"
        Shape of the crowns: 48 or 14 triangles.
    base : number, str, or (n,) float, optional
        Height of the feet. None: the highest surface of the scene at each place, or 0 without a scene.
    crown_base : number, str, or (n,) float, optional
        Height of the lowest part of the crown above the foot. None: a quarter of the height.
    trunk_radius : number, str, or (n,) float, optional
        Radius of the trunk, which is opaque and ends in the middle of the crown. 0: no trunk. None: height / 60.
    id : str, optional
        The column that names the plants. None: ``id``, ``gml_id``, ``osm_id`` or ``fid``, else "tree 0" and so on.
    layer : str, optional
        The layer of the file. None: the only one.
    crs : str, optional
        CRS of the plants, if the table names none, or to which points in degrees are projected. None: the scene's.
    unit : str, optional
        Length unit of the coordinates, such as "ft". None: that of the CRS or of `scene`, or metres; see `Scene.unit`.
    name : str, optional
        Name of the scene. None: that of `scene`, or of the file.

    Returns
    -------
    Scene, or PagedScene for a store
        Each plant is an object of the type "SolitaryVegetationObject", after those of `scene`. Without a scene, +Z is
        up.

    Raises
    ------
    InputError
        If the table cannot be read, a column is missing, a number is missing or out of range, a tree has no surface
        under it, a CRS differs from the scene's, or the scene has instances.

    Notes
    -----
    A line that enters and leaves a crown crosses two surfaces, each of which lets the square root of the share pass.
    So the share does not depend on the distance inside the crown; a point inside one is behind half of it, in terms of
    logarithms. The shares of several crowns multiply. Sections at the widest place have the area of the circle.
    """
    below = None if scene is None else scene_of(scene)
    given = below.data.given_unit if below is not None and unit is None else unit
    of_length = None if given is None else checked_unit(given)
    options = VegetationOptions(
        height, radius, transmittance, shape, base, crown_base, trunk_radius, id, layer, crs, of_length
    )
    if below is not None and below.data.instanced:
        raise InputError(f"{below.name}: trees are not added to instances; load it with instances=False")
    table = read_vegetation(trees, options, None if below is None else below.crs)
    up = "z" if below is None else below.up
    if below is not None:
        bounds = plan_bounds(below.bounds, up)
        check_no_degrees(table.plan, f"the trees of {table.file}", below.name, below.crs, bounds)
    source = CrownMeshes(_feet(table, below, up), table.shapes, table.ids, table.file, up)
    title = table.file.rpartition(".")[0] or "trees"
    title = (title if below is None else below.name) if name is None else text(name, "name")
    system = None if table.crs is None else in_one_unit(checked_crs(table.crs))[0]  # heights are in the plan's unit
    data = MemoryData(source, name=title, up=up, crs=system, unit=of_length)
    if below is None:
        return Scene.of_data(data)
    for note in group_notes(data.notes):
        warnings.warn(note, UserWarning, stacklevel=2)
    if below.data.resident:
        return Scene.of_data(join_data(cast(MemoryData, below.data), data, title))
    from ...engine.paged_scene import PagedScene  # imported late: scenes in memory start sooner without it
    from ...store.extended_store import ExtendedStoreData

    return PagedScene.of_data(ExtendedStoreData(cast(PagedScene, below).data, data, title))


def _feet(table: Plants, scene: AnyScene | None, up: str) -> NDArray[np.float64]:
    """(n, 3) float64, world: the feet of the trunks."""
    east, north = table.plan.T
    heights = np.zeros(len(east)) if table.bases is None else table.bases
    if table.bases is None and scene is not None:
        heights = _surface_heights(table, scene, up)
    return np.stack([east, north, heights] if up == "z" else [east, heights, -north], 1)


def _surface_heights(table: Plants, scene: AnyScene, up: str) -> NDArray[np.float64]:
    """(n,) float64: heights of the highest surface at each place."""
    axis = "xyz".index(up)
    low, high = scene.bounds[:, axis]
    begin, down = np.zeros((len(table.plan), 3)), -np.eye(3)[axis]
    begin[:, 0], begin[:, 3 - axis] = table.plan[:, 0], table.plan[:, 1] * (1.0 if up == "z" else -1.0)
    begin[:, axis] = high + max(high - low, 1.0)
    hit = scene.closest_hit(begin, down)
    if not hit.mask.all():
        k, off = int(np.argmin(hit.mask)), int((~hit.mask).sum())
        more = f" (and {off - 1} more)" if off > 1 else ""
        raise InputError(
            f"{table.file}: tree {table.ids[k]!r}{more} has no surface of {scene.name} under it; give base"
        )
    heights: NDArray[np.float64] = begin[:, axis] - hit.t
    return heights
