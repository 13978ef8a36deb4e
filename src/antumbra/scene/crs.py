"""Coordinate reference systems (CRS) of scenes, as strings that pyproj accepts; reprojection between them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import quoted
from ..errors import InputError
from ..extras import import_extra


def checked_crs(crs: object) -> str:
    """A validated CRS as a string: a string unchanged, anything else as pyproj formats it.

    crs : str, or anything else that ``pyproj.CRS.from_user_input`` accepts

    Raises
    ------
    InputError
        If pyproj is missing, or cannot interpret the CRS.
    """
    pyproj = import_extra("pyproj", "crs", "gis")
    try:
        parsed = pyproj.CRS.from_user_input(crs)
    except Exception:  # wrong types raise all kinds of exceptions
        raise InputError(f"crs {quoted(crs)} is unknown; write an EPSG code such as EPSG:7415") from None
    return crs if isinstance(crs, str) else parsed.to_string()


def check_horizontal_crs(name: str, crs: str | None, scene: str | None) -> None:
    """Raise InputError if the horizontal CRS of a file differs from the scene's.

    name : the file, for the message
    crs, scene : the validated CRS of file and scene; None: unknown, which matches everything
    """
    if crs and scene and not _plan(crs).equals(_plan(scene), ignore_axis_order=True):
        raise InputError(f"{name}: its CRS is {crs}, and the scene's is {scene}; reproject one of them")


def reproject(plan: np.ndarray, source: str, target: str) -> NDArray[np.float64]:
    """(n, 2) float64: points transformed between the horizontal parts of two validated CRS, as (easting, northing).

    Raises
    ------
    InputError
        If a point has no coordinates in the target CRS.
    """
    transformer = import_extra("pyproj", "crs", "gis").Transformer.from_crs(
        _plan(source), _plan(target), always_xy=True
    )
    points = np.stack(transformer.transform(*plan.T), -1)
    if not np.isfinite(points).all():
        raise InputError(f"places in {source} have no coordinates in {target}; check both")
    return points


def _plan(crs: str) -> Any:
    """The horizontal part of a compound CRS; any other CRS unchanged."""
    full = import_extra("pyproj", "crs", "gis").CRS.from_user_input(crs)
    return full.sub_crs_list[0] if full.is_compound else full
