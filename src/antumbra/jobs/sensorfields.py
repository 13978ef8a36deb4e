"""Checked fields of `Sensors`."""

import numpy as np

from ..checks import as_array, unit_vectors
from ..engine.scene import AnyScene
from ..errors import InputError

NEEDED = {"face": "faces", "grid": "faces", "vertex": "corners", "raster": "raster"}
"""Kind of sensors -> the field that it needs."""

_UNIT = 1e-5  # how far a length may be from 1, as float32 rounds it


def checked_normals(values, n: int) -> np.ndarray:
    """(n, 3) float64 of length 1, of finite vectors of any length."""
    normals = _checked(values, (n, 3), "normals").astype(np.float64, copy=False)
    different = normals[:1] if normals.strides[0] == 0 else normals  # all are one, if they were broadcast
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.einsum("ij,ij->i", different, different)
        if (np.abs(squares - 1.0) <= 2.0 * _UNIT).all():
            return normals
    return unit_vectors(normals, "the normal of sensor", "leave normals out for points in free space")


def checked_areas(values, n: int) -> np.ndarray:
    """(n,) float64, finite and not negative."""
    areas = _checked(values, (n,), "areas").astype(np.float64, copy=False)
    if not (np.isfinite(areas) & (areas >= 0.0)).all():
        raise InputError("areas of sensors must be finite and not negative")
    return areas


def checked_indices(values, shape: tuple[int, ...], name: str, low: int, count: int | None = None) -> np.ndarray:
    """int64 indices of a shape, from `low` to `count` - 1; None: of any number of things."""
    found = _checked(values, shape, name)
    if found.dtype.kind == "f":
        raise InputError(f"{name} of sensors must be whole numbers, not {found.dtype}")
    if found.size and (found.min() < low or (count is not None and found.max() >= count)):
        wrong = found.min() if found.min() < low else found.max()
        end = f"at least {low}" if count is None else f"from {low} to {count - 1}" if count else "left out"
        raise InputError(f"{name} of sensors hold {wrong}; they must be {end}")
    return found.astype(np.int64, copy=False)


def checked_corners(values, n: int) -> np.ndarray:
    """(faces, 3) int64, from -1 to n - 1."""
    corners = as_array(values, "corners of sensors")
    if corners.ndim != 2 or corners.shape[1] != 3:
        raise InputError(f"corners of sensors must be whole numbers (faces, 3), not {corners.shape}")
    return checked_indices(corners, corners.shape, "corners", -1, n)


def check_on_scene(sensors, scene: AnyScene) -> None:
    """Raise an InputError if sensors lie on faces that a scene does not have: they belong to another scene."""
    n, faces, corners = scene.n_triangles, sensors.faces, sensors.corners
    last = -1 if faces is None or not len(faces) else int(faces.max())
    if last >= n:
        raise InputError(f"sensors lie on face {last}, and {scene.name} has {n} faces; make them for this scene")
    if corners is not None and len(corners) != n:
        raise InputError(f"corners of sensors are of {len(corners)} faces, and {scene.name} has {n}; make them for it")


def _checked(values, shape: tuple[int, ...], name: str) -> np.ndarray:
    array = as_array(values, f"{name} of sensors")
    if array.shape != shape:
        raise InputError(f"{name} of {shape[0]} sensors must be numbers {shape}, not {array.dtype} {array.shape}")
    return array
