"""Ray lists: any-hit and closest-hit queries on arrays, as `Scene.occluded` and `Scene.closest_hit` ask them."""

from typing import NamedTuple

import numpy as np

from ..errors import InputError
from .shadow import CULL_FACES


class RayList(NamedTuple):
    """Rays in the recentred frame of a scene."""

    origins: np.ndarray  # (m, 3) float32
    directions: np.ndarray  # (m, 3) float32, any length but zero
    tmin: np.ndarray  # (m,) float32, >= 0, in lengths of the direction
    tmax: np.ndarray  # (m,) float32, may be inf
    skip: np.ndarray  # (m,) int32, a triangle index that does not count, or -1
    cull_faces: int  # a value of CULL_FACES


class HitArrays(NamedTuple):
    """Where kernels write hits; u and v only for closest hits."""

    face: np.ndarray  # (m,) int32, -1 on a miss
    t: np.ndarray  # (m,) float64
    u: np.ndarray  # (m,) float32
    v: np.ndarray  # (m,) float32


class Hit(NamedTuple):
    """Nearest hits of rays; leading shape (...) as the rays had."""

    t: np.ndarray  # (...) float64, in lengths of the direction; inf on a miss
    face: np.ndarray  # (...) int32, index of the face in the scene; -1 on a miss
    u: np.ndarray  # (...) float32, weight of the face's second corner; 0 on a miss
    v: np.ndarray  # (...) float32, weight of its third corner; 0 on a miss


def as_array(value, what: str) -> np.ndarray:
    """numpy view (or copy) of numbers, or of anything with DLPack in host memory."""
    if not isinstance(value, np.ndarray) and hasattr(value, "__dlpack__"):
        try:
            value = np.from_dlpack(value)
        except (BufferError, RuntimeError, TypeError) as error:
            raise InputError(f"{what} cannot be read through DLPack ({error}); copy it to host memory first") from None
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.asarray(None)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{what} must hold numbers (float32 or float64), not {array.dtype}")
    return array


def ray_list(origins, directions, tmin, tmax, skip_face, cull_faces, frame_origin) -> tuple[RayList, tuple[int, ...]]:
    """Check and convert the arguments of `Scene.occluded` and `Scene.closest_hit`: (RayList, leading shape).

    Float64 world coordinates are recentred (minus ``frame_origin``) before they are rounded to float32.
    """
    origins = as_array(origins, "origins")
    if directions is None:
        if origins.ndim < 1 or origins.shape[-1] != 6:
            raise InputError(
                f"rays must have shape (..., 6), or origins and directions (..., 3) each; got {origins.shape}"
            )
        origins, directions = origins[..., :3], origins[..., 3:]
    directions = as_array(directions, "directions")
    for array, what in ((origins, "origins"), (directions, "directions")):
        if array.ndim < 1 or array.shape[-1] != 3:
            raise InputError(f"{what} must have shape (..., 3), not {array.shape}")
    tmin, tmax = as_array(tmin, "tmin"), as_array(tmax, "tmax")
    skip = as_array(-1 if skip_face is None else skip_face, "skip_face")
    if skip.dtype.kind == "f":
        raise InputError(f"skip_face must hold integers, not {skip.dtype}")
    try:
        shape = np.broadcast_shapes(origins.shape[:-1], directions.shape[:-1], tmin.shape, tmax.shape, skip.shape)
    except ValueError:
        raise InputError(
            f"shapes do not broadcast: origins {origins.shape}, directions {directions.shape}, "
            f"tmin {tmin.shape}, tmax {tmax.shape}, skip_face {skip.shape}"
        ) from None
    with np.errstate(over="ignore"):  # what overflows is reported as not finite
        rays = RayList(
            _flat(origins.astype(np.float64) - frame_origin, (*shape, 3), np.float32),
            _flat(directions, (*shape, 3), np.float32),
            _flat(tmin, shape, np.float32),
            _flat(tmax, shape, np.float32),
            _flat(skip, shape, np.int32),
            cull_value(cull_faces),
        )
    _check(rays)
    return rays, shape


def cull_value(cull_faces) -> int:
    """The CULL_FACES value of None, "front" or "back"."""
    if cull_faces not in CULL_FACES:
        raise InputError(f'cull_faces is {cull_faces!r}; it must be None, "front" or "back"')
    return CULL_FACES[cull_faces]


def _flat(array, shape, dtype):
    flat = np.broadcast_to(array, shape).astype(dtype, order="C")
    return (
        flat.reshape(-1, 3)
        if len(shape) and shape[-1] == 3 and array.ndim and array.shape[-1] == 3
        else flat.reshape(-1)
    )


def _check(rays: RayList) -> None:
    if not np.isfinite(rays.origins).all():
        raise InputError(f"origins hold NaN or infinity (ray {_first(~np.isfinite(rays.origins).all(1))})")
    if not np.isfinite(rays.directions).all():
        raise InputError(f"directions hold NaN or infinity (ray {_first(~np.isfinite(rays.directions).all(1))})")
    zero = ~rays.directions.any(1)
    if zero.any():
        raise InputError(f"direction of ray {_first(zero)} is zero; give every ray a direction")
    if not (rays.tmin >= 0).all() or np.isinf(rays.tmin).any():
        raise InputError(
            f"tmin must be finite and not negative (ray {_first(~(rays.tmin >= 0) | np.isinf(rays.tmin))})"
        )
    if np.isnan(rays.tmax).any():
        raise InputError(f"tmax is NaN (ray {_first(np.isnan(rays.tmax))})")


def _first(mask) -> int:
    return int(np.argmax(mask))
