"""The exact shadow of triangles on a horizontal plane: their projections along the sun, joined by shapely.

The part of a triangle above the plane is a triangle or a quadrilateral. An edge that crosses the plane is cut at a
point that depends only on the edge, so the projections of adjacent triangles share their edges, and their union has no
gaps.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.extras import import_extra


class Projection(NamedTuple):
    """A projection to a horizontal plane."""

    height: float
    across: tuple[float, float]  # shift in easting and northing per unit of height above the plane


def projection_of(towards: NDArray[np.float64], height: float) -> Projection:
    """The projection along the light.

    towards : (3,) easting, northing and height of the direction to the light, which lies above the horizon
    """
    return Projection(height, (-float(towards[0] / towards[2]), -float(towards[1] / towards[2])))


def shadow_union(corners: NDArray[np.float64], projection: Projection) -> Any:
    """The union of the projections of the parts of triangles above the plane: a shapely MultiPolygon.

    corners : (n, 3, 3) easting, northing and height
    """
    shapely = import_extra("shapely", "shadow", "gis")
    parts = _parts_above(corners, projection.height)
    return union_of(np.concatenate([shapely.polygons(_projected(part, projection)) for part in parts]))


def union_of(polygons: Iterable[Any]) -> Any:
    """The union of polygons: a shapely MultiPolygon."""
    shapely = import_extra("shapely", "shadow", "gis")
    rows = np.asarray(polygons, object)
    return polygons_of(shapely.union_all(rows[shapely.area(rows) > 0.0]))


def polygons_of(shape: Any) -> Any:
    """The polygons of a shapely geometry, as a MultiPolygon. Lines and points, which have no area, are dropped."""
    shapely = import_extra("shapely", "shadow", "gis")
    return shapely.MultiPolygon([each for each in shapely.get_parts(shape) if each.geom_type == "Polygon"])


def _projected(corners: NDArray[np.float64], projection: Projection) -> NDArray[np.float64]:
    """(n, k, 2): corners (n, k, 3) on the plane, as easting and northing."""
    above = corners[..., 2:] - projection.height
    return np.asarray(corners[..., :2] + above * np.array(projection.across))


def _parts_above(corners: NDArray[np.float64], height: float) -> list[NDArray[np.float64]]:
    """Triangles and quadrilaterals, (n, 3, 3) and (n, 4, 3): the parts of triangles above a plane."""
    above = corners[..., 2] > height
    count = above.sum(1)
    # The corner that lies alone on its side of the plane comes first.
    one, two = corners[count == 1], corners[count == 2]
    one = _turned(one, above[count == 1].argmax(1))
    two = _turned(two, above[count == 2].argmin(1))
    tips = np.stack([one[:, 0], _cut(one[:, 0], one[:, 1], height), _cut(one[:, 0], one[:, 2], height)], 1)
    first, last = _cut(two[:, 1], two[:, 0], height), _cut(two[:, 2], two[:, 0], height)
    return [corners[count == 3], tips, np.stack([first, two[:, 1], two[:, 2], last], 1)]


def _turned(corners: NDArray[np.float64], first: NDArray[np.integer]) -> NDArray[np.float64]:
    """The corners of triangles in their order, from the one with the given index."""
    return np.asarray(np.take_along_axis(corners, (first[:, None] + np.arange(3))[..., None] % 3, 1))


def _cut(upper: NDArray[np.float64], lower: NDArray[np.float64], height: float) -> NDArray[np.float64]:
    """(n, 3): where edges meet the plane; `upper` lies above it, `lower` does not."""
    share = (upper[:, 2:] - height) / (upper[:, 2:] - lower[:, 2:])
    points = upper + share * (lower - upper)
    points[:, 2] = height
    return points
