"""Ray lists: the checked arguments of `Scene.occluded` (any-hit) and `Scene.closest_hit`."""

from typing import NamedTuple

import numpy as np

from ..checks import as_array, choice
from ..errors import InputError
from ..scene.recentre import settled
from .diffuse import RayPass
from .shadow import CULL_FACES


class RayList(NamedTuple):
    """Rays in the caller's arrays; `trace.rays.batch` checks and converts the numbers while it traces.

    Element (i, k) of an argument is at ``address + i * row + k * column``, in bytes; row is 0 if all rays share it.
    """

    layout: np.ndarray  # (5, 4) int64: address, row, column, 1 for float64 and 0 for float32 or int32, of each argument
    frame: np.ndarray  # (3,) float64, world position of the zero of the scene's frame
    n: int
    cull_faces: int  # a value of CULL_FACES
    segments: bool  # directions are targets: the rays are segments


class HitArrays(NamedTuple):
    """Output arrays of kernels: `blocked` for any-hit, the others for closest hit; unused arrays are empty."""

    blocked: np.ndarray  # (m,) bool
    face: np.ndarray  # (m,) int32, -1 on a miss
    t: np.ndarray  # (m,) float64, rounded to nearest; inf on a miss
    u: np.ndarray  # (m,) float32, 0 on a miss
    v: np.ndarray  # (m,) float32


def hit_arrays(m: int, any_hit: bool) -> HitArrays:
    """`HitArrays` for m rays."""
    n = 0 if any_hit else m
    return HitArrays(
        np.empty(m - n, np.bool_), np.empty(n, np.int32), np.empty(n), np.empty(n, np.float32), np.empty(n, np.float32)
    )


def ray_arguments(
    origins, directions, tmin, tmax, skip_face, cull_faces, frame_origin, n_faces: int, targets=None
) -> tuple["Arguments", tuple[int, ...], int]:
    """The arguments of `Scene.occluded` and `Scene.closest_hit`: (Arguments, leading shape, value of CULL_FACES).

    Shapes and dtypes are checked here, the numbers during tracing. World coordinates are recentred (minus
    ``frame_origin``, in float64) before they are rounded to float32.

    n_faces : number of faces of the scene
    """
    origins, ways = as_array(origins, "origins"), "directions" if targets is None else "targets"
    if targets is not None:
        directions, tmax = _segment_ends(directions, tmin, tmax, targets)
    elif directions is None:
        if origins.ndim < 1 or origins.shape[-1] != 6:
            raise InputError(
                f"rays must have shape (..., 6), or origins and directions (..., 3) each; got {origins.shape}"
            )
        origins, directions = origins[..., :3], origins[..., 3:]
    directions = as_array(directions, ways)
    for array, what in ((origins, "origins"), (directions, ways)):
        if array.ndim < 1 or array.shape[-1] != 3:
            raise InputError(f"{what} must have shape (..., 3), not {array.shape}")
    tmin, tmax = as_array(tmin, "tmin"), as_array(tmax, "tmax")
    skip = as_array(-1 if skip_face is None else skip_face, "skip_face")
    if skip.dtype.kind == "f":
        raise InputError(f"skip_face must hold integers, not {skip.dtype}")
    if skip.size and (skip.min() < -1 or skip.max() >= n_faces):
        raise InputError(f"skip_face must lie between -1 and {n_faces - 1}, the scene's last face")
    try:
        shape = np.broadcast_shapes(origins.shape[:-1], directions.shape[:-1], tmin.shape, tmax.shape, skip.shape)
    except ValueError:
        raise InputError(
            f"shapes do not broadcast: origins {origins.shape}, {ways} {directions.shape}, "
            f"tmin {tmin.shape}, tmax {tmax.shape}, skip_face {skip.shape}"
        ) from None
    arrays = Arguments(
        _rows(origins, (*shape, 3)), _rows(directions, (*shape, 3)), _rows(tmin, (*shape, 1)),
        _rows(tmax, (*shape, 1)), _rows(skip, (*shape, 1), np.int32), np.asarray(frame_origin, np.float64),
        targets is not None,
    )  # fmt: skip
    return arrays, shape, cull_value(cull_faces)


def _segment_ends(directions, tmin, tmax, targets):
    """(targets, tmax) of segments, which have no other ends."""
    if directions is not None or np.any(as_array(tmin, "tmin")) or np.any(as_array(tmax, "tmax") != np.inf):
        raise InputError("targets end the rays: give either targets, or directions, tmin and tmax")
    return targets, 1.0


class Arguments(NamedTuple):
    """The arrays of a ray list, of any strides: float32 or float64, `skip` int32."""

    origins: np.ndarray  # (m, 3) world
    directions: np.ndarray  # (m, 3) any length but zero; or, for segments, their targets, world
    tmin: np.ndarray  # (m, 1) >= 0, in lengths of the direction; hits need t > tmin
    tmax: np.ndarray  # (m, 1) may be inf; hits need t < tmax
    skip: np.ndarray  # (m, 1) index of a triangle that is not tested, or -1
    frame: np.ndarray  # (3,) float64
    segments: bool = False

    def ray_list(self, cull_faces: int) -> RayList:
        """The `RayList` for kernels; valid while this object lives."""
        layout = [(a.ctypes.data, *a.strides, a.dtype == np.float64) for a in self[:5]]
        return RayList(np.array(layout, np.int64), self.frame, len(self.origins), cull_faces, self.segments)

    def part(self, places) -> "Arguments":
        """Some of the rays; a copy for an array of indices."""
        return self._replace(**{name: getattr(self, name)[places] for name in self._fields[:5]})

    def local(self) -> tuple[np.ndarray, np.ndarray]:
        """The origins in the scene's frame, and the directions or the targets in it: (m, 3) float32 each."""
        ways = self.directions.astype(np.float64) - self.frame if self.segments else self.directions
        with np.errstate(over="ignore", invalid="ignore"):  # `check` names them
            origins = settled((self.origins.astype(np.float64) - self.frame).astype(np.float32))
            ways = np.ascontiguousarray(ways, np.float32)
        return origins, settled(ways) if self.segments else ways

    def rays(self) -> RayPass:
        """The rays in the scene's frame. Directions of segments are rounded differences of their ends."""
        origins, ways = self.local()
        if self.segments:
            with np.errstate(over="ignore"):
                ways = (ways.astype(np.float64) - origins).astype(np.float32)
        return RayPass(origins, ways, np.ascontiguousarray(self.skip[:, 0]))

    def check(self) -> None:
        """Raise an InputError that names the first problem of the rays, if there is one."""
        origins, directions = self.local()
        for array, name in ((origins, "origins"), (directions, "targets" if self.segments else "directions")):
            _demand(np.isfinite(array).all(1), f"{name} hold NaN or infinity (ray {{}})")
        _demand(directions.any(1) | self.segments, "direction of ray {} is zero; give every ray a direction")
        _demand((self.tmin >= 0).all(1) & (self.tmin < np.inf).all(1), "tmin must be finite and not negative (ray {})")
        _demand(~np.isnan(self.tmax).any(1), "tmax is NaN (ray {})")


def changed() -> InputError:
    """The error for rays that were wrong while they were traced, and are right afterwards, or the other way round."""
    return InputError("the arrays of rays changed while they were traced; give copies of what other threads write")


def _rows(array, shape, dtype=None) -> np.ndarray:
    """The array broadcast to `shape`, as rows, in float32 or float64, or in `dtype`; a view if possible."""
    if shape[-1] == 1:
        array = array[..., None]
    if dtype is None:
        dtype = array.dtype if array.dtype in (np.float32, np.float64) else np.float64
    native = array.astype(np.dtype(dtype).newbyteorder("="), copy=False)
    return np.broadcast_to(native, shape).reshape(-1, shape[-1])


def _demand(good: np.ndarray, message: str) -> None:
    if not good.all():
        raise InputError(message.format(int(np.argmin(good))))


def cull_value(cull_faces) -> int:
    """The CULL_FACES value of None, "front" or "back"."""
    return CULL_FACES[choice(cull_faces, "cull_faces", CULL_FACES)]
