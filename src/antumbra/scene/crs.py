"""Coordinate reference systems (CRS) of scenes, as texts that pyproj knows."""

import numpy as np

from ..checks import quoted
from ..errors import InputError
from ..extras import import_extra


def checked_crs(crs) -> str:
    """The text of a CRS: as it was given, or as pyproj writes it.

    crs : str, or all else that ``pyproj.CRS.from_user_input`` takes

    Raises
    ------
    InputError
        If pyproj is missing, or does not know the CRS.
    """
    pyproj = import_extra("pyproj", "crs", "gis")
    try:
        found = pyproj.CRS.from_user_input(crs)
    except Exception:  # wrong types raise whatever they happen to meet
        raise InputError(f"crs {quoted(crs)} is unknown; write an EPSG code such as EPSG:7415") from None
    return crs if isinstance(crs, str) else found.to_string()


def check_plan(name: str, crs: str | None, scene: str | None) -> None:
    """Raise an InputError if a file has other horizontal coordinates than a scene; None: its CRS is unknown.

    name : of the file
    crs, scene : their checked CRS
    """
    if crs and scene and not _plan(crs).equals(_plan(scene), ignore_axis_order=True):
        raise InputError(f"{name}: its CRS is {crs}, and the scene's is {scene}; reproject one of them")


def reproject(plan: np.ndarray, source: str, target: str) -> np.ndarray:
    """(n, 2) float64: places in the horizontal coordinates of another checked CRS, to the east and to the north.

    Raises
    ------
    InputError
        If a place has no such coordinates.
    """
    change = import_extra("pyproj", "crs", "gis").Transformer.from_crs(_plan(source), _plan(target), always_xy=True)
    found = np.stack(change.transform(*plan.T), -1)
    if not np.isfinite(found).all():
        raise InputError(f"places in {source} have no coordinates in {target}; check both")
    return found


def _plan(crs: str):
    made = import_extra("pyproj", "crs", "gis").CRS.from_user_input(crs)
    return made.sub_crs_list[0] if made.is_compound else made
