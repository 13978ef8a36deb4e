"""Ray lists: the checked arguments of `Scene.occluded` (any-hit) and `Scene.closest_hit`."""

from math import prod
from typing import NamedTuple

import numpy as np

from ..checks import as_array, choice
from ..errors import InputError
from ..kernels.marshalling import ArgumentForm, Packed, address_of
from ..scene.scene_bounds import flush_to_zero
from .ray_passes import RayPass
from .shadow_query import CULL_FACES


class Operand(NamedTuple):
    """An array of points in memory: number k of row i is at ``address + i * row + k * column``, in bytes."""

    address: int
    row: int  # 0: all rays share one row
    column: int
    double: int  # 1 for float64, 0 for float32


class Number(NamedTuple):
    """A number for each ray, at ``address + i * row``; or one for all, `shared`, if the address is 0."""

    address: int
    row: int
    double: int  # 1 for float64, 0 for float32 or int32
    shared: float


class RayList(NamedTuple):
    """Rays in the caller's arrays; `trace.rays.ray_batches` checks and converts the numbers while it traces."""

    origins: Operand
    directions: Operand  # targets, for segments
    tmin: Number
    tmax: Number
    skip: Number
    frame: tuple[float, float, float]  # world position of the zero of the scene's frame
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

    def packed(self) -> Packed:
        """The arrays as an argument of a kernel, which they must outlive."""
        blocked, face, t, u, v = self
        if not len(face):
            return _HITS.pack(address_of(blocked), len(blocked), 1, 0, 0, 4, 0, 0, 8, 0, 0, 4, 0, 0, 4)
        m = len(face)
        pointers = (address_of(face), m, 4, address_of(t), m, 8, address_of(u), m, 4, address_of(v), m, 4)
        return _HITS.pack(0, 0, 1, *pointers)


_NONE = HitArrays(*(np.empty(0, dtype) for dtype in (np.bool_, np.int32, np.float64, np.float32, np.float32)))
_HITS = ArgumentForm(_NONE)
_RAYS = ArgumentForm(
    RayList(*[Operand(0, 0, 0, 0)] * 2, *[Number(0, 0, 0, 0.0)] * 3, (0.0, 0.0, 0.0), 0, 0, False)  # type: ignore[arg-type]
)
_DOUBLE = {np.dtype(np.float32): 0, np.dtype(np.float64): 1}  # in the byte order of this machine


def hit_arrays(m: int, any_hit: bool) -> HitArrays:
    """`HitArrays` for m rays."""
    if any_hit:
        return _NONE._replace(blocked=np.empty(m, np.bool_))
    return HitArrays(_NONE.blocked, *(np.empty(m, array.dtype) for array in _NONE[1:]))


class RayArguments(NamedTuple):
    """The rays of a question: arguments whose shapes and dtypes are checked. The numbers are checked in tracing.

    World coordinates are recentred (minus `frame`, in float64) before they are rounded to float32.
    """

    origins: np.ndarray  # (..., 3) world
    directions: np.ndarray  # (..., 3) any length but zero; or, for segments, their targets, world
    tmin: np.ndarray | float  # >= 0, in lengths of the direction; hits need t > tmin
    tmax: np.ndarray | float  # may be inf; hits need t < tmax
    skip: np.ndarray | float  # index of a triangle that is not tested, or -1
    shape: tuple[int, ...]  # to which all of them broadcast
    cull_faces: int  # a value of CULL_FACES
    segments: bool
    frame: tuple[float, float, float]  # world position of the zero of the scene's frame

    @property
    def n(self) -> int:
        return prod(self.shape)

    def copied(self) -> "RayArguments":
        """The same rays in arrays of their own, which nobody else changes."""
        own = (np.array(value) if isinstance(value, np.ndarray) else value for value in self[:5])
        return RayArguments(*own, *self[5:])

    def packed(self) -> Packed:
        """The rays as a kernel's `RayList`. It keeps the memory that it names."""
        shape = self.shape
        origins, o = _operand(self.origins, shape)
        directions, d = _operand(self.directions, shape)
        tmin, a = _number(self.tmin, shape)
        tmax, b = _number(self.tmax, shape)
        skip, c = _number(self.skip, shape, np.int32)
        found = _RAYS.pack(
            *origins, *directions, *tmin, *tmax, *skip, *self.frame, prod(shape), self.cull_faces, self.segments
        )
        found.value = o, d, a, b, c
        return found

    def arrays(self) -> "RayArrays":
        """The rays as rows of arrays."""
        points, number = (*self.shape, 3), (*self.shape, 1)
        return RayArrays(
            _rows(self.origins, points), _rows(self.directions, points), _rows(np.asarray(self.tmin), number),
            _rows(np.asarray(self.tmax), number), _rows(np.asarray(self.skip), number, np.int32),
            np.array(self.frame), self.segments,
        )  # fmt: skip


def rays_of(
    origins, directions, tmin, tmax, skip_face, cull_faces, frame: tuple[float, float, float], n_faces: int,
    targets=None,
) -> RayArguments:  # fmt: skip
    """The checked arguments of `Scene.occluded` and `Scene.closest_hit`.

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
    tmin, tmax, skip = _number_or_array(tmin, "tmin"), _number_or_array(tmax, "tmax"), _skip(skip_face, n_faces)
    shape = _shape(origins.shape[:-1], directions.shape[:-1], tmin, tmax, skip)
    if shape is None:
        sizes = ", ".join(f"{name} {np.shape(x)}" for name, x in (("tmin", tmin), ("tmax", tmax), ("skip_face", skip)))
        raise InputError(f"shapes do not broadcast: origins {origins.shape}, {ways} {directions.shape}, {sizes}")
    facing = 0 if cull_faces is None else cull_value(cull_faces)
    return RayArguments(origins, directions, tmin, tmax, skip, shape, facing, targets is not None, frame)


def _number_or_array(value, what: str) -> np.ndarray | float:
    return value if type(value) is float else as_array(value, what)


def _skip(skip_face, n_faces: int) -> np.ndarray | float:
    if skip_face is None:
        return -1.0
    skip = as_array(skip_face, "skip_face")
    if skip.dtype.kind == "f":
        raise InputError(f"skip_face must hold integers, not {skip.dtype}")
    if skip.size and (skip.min() < -1 or skip.max() >= n_faces):
        raise InputError(f"skip_face must lie between -1 and {n_faces - 1}, the scene's last face")
    return skip


def _shape(origins: tuple[int, ...], directions: tuple[int, ...], *numbers) -> tuple[int, ...] | None:
    """The shape to which rays broadcast; None: there is none. `numpy.broadcast_shapes` takes longer than a ray."""
    shapes = {origins, directions, *(x.shape for x in numbers if isinstance(x, np.ndarray))} - {()}
    if len(shapes) <= 1:
        return next(iter(shapes), ())
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        return None


def _segment_ends(directions, tmin, tmax, targets):
    """(targets, tmax) of segments, which have no other ends."""
    if directions is not None or np.any(as_array(tmin, "tmin")) or np.any(as_array(tmax, "tmax") != np.inf):
        raise InputError("targets end the rays: give either targets, or directions, tmin and tmax")
    return targets, 1.0


def _operand(array: np.ndarray, shape: tuple[int, ...]) -> tuple[tuple[int, int, int, int], np.ndarray]:
    """The `Operand` of points that broadcast to a shape, and the array whose memory it names."""
    double = _DOUBLE.get(array.dtype)
    if double is None:
        array, double = array.astype(np.float64), 1
    if array.ndim == 1:
        return (address_of(array), 0, array.strides[0], double), array
    if array.ndim > 2 or array.shape[:-1] != shape:
        array = _rows(array, (*shape, 3))
    row, column = array.strides
    return (address_of(array), row, column, double), array


def _number(value, shape: tuple[int, ...], dtype=None) -> tuple[tuple[int, int, int, float], np.ndarray | None]:
    """The `Number` of numbers that broadcast to a shape, and the array whose memory it names."""
    if type(value) is float:
        return (0, 0, 0, value), None
    if not isinstance(value, np.ndarray) or value.ndim == 0:
        return (0, 0, 0, float(value)), None
    rows = _rows(value, (*shape, 1), dtype)
    return (address_of(rows), rows.strides[0], _DOUBLE.get(rows.dtype, 0), 0.0), rows


class RayArrays(NamedTuple):
    """The arrays of a ray list, of any strides: float32 or float64, `skip` int32."""

    origins: np.ndarray  # (m, 3) world
    directions: np.ndarray  # (m, 3) or, for segments, their targets, world
    tmin: np.ndarray  # (m, 1)
    tmax: np.ndarray  # (m, 1)
    skip: np.ndarray  # (m, 1)
    frame: np.ndarray  # (3,) float64
    segments: bool = False

    def part(self, places) -> "RayArrays":
        """Some of the rays; a copy for an array of indices."""
        return self._replace(**{name: getattr(self, name)[places] for name in self._fields[:5]})

    def local(self) -> tuple[np.ndarray, np.ndarray]:
        """The origins in the scene's frame, and the directions or the targets in it: (m, 3) float32 each."""
        ways = self.directions.astype(np.float64) - self.frame if self.segments else self.directions
        with np.errstate(over="ignore", invalid="ignore"):  # `check` names them
            origins = flush_to_zero((self.origins.astype(np.float64) - self.frame).astype(np.float32))
            ways = np.ascontiguousarray(ways, np.float32)
        return origins, flush_to_zero(ways) if self.segments else ways

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
