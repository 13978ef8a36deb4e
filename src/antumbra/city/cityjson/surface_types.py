"""Types of surfaces without semantics, in the words of CityJSON: they follow from normals."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...kernels.elementary import cos

WALL, ROOF, GROUND = "WallSurface", "RoofSurface", "GroundSurface"

BUILT = "Building", "Bridge", "Tunnel", "OtherConstruction"
"""The beginnings of the types of city objects that have walls and roofs."""

_OTHER_TYPES = {"Road": "TrafficArea", "Railway": "TrafficArea", "Transport": "TrafficArea", "Water": "WaterSurface"}
_STEEP = float(cos(np.radians(60.0)))  # vertical component of the unit normal of a surface that is 60 degrees steep
_NAMES = np.array([WALL, ROOF, GROUND], object)


def types_of_normals(heights: ArrayLike) -> NDArray[np.object_]:
    """(n,) str: the types of surfaces from the vertical components of their unit normals, (n,) float.

    Surfaces steeper than 60 degrees are walls; others are roofs if they face up, and ground if they face down.
    """
    heights = np.asarray(heights, np.float64)
    return np.asarray(_NAMES[np.where(np.abs(heights) < _STEEP, 0, np.where(heights > 0.0, 1, 2))])


def surface_type(owner: str, height: float) -> str:
    """The type that CityJSON allows for a surface of a city object; "+Surface" marks an extension.

    owner : type of the object
    height : vertical component of the unit normal
    """
    if owner.startswith(BUILT):
        return str(types_of_normals([height])[0])
    return next((kind for begin, kind in _OTHER_TYPES.items() if owner.startswith(begin)), "+Surface")
