"""Ray lists: the checked arguments of `Scene.occluded` (any-hit) and `Scene.closest_hit`.

Shapes and dtypes are checked before tracing; numbers are checked while rays are traced. World coordinates are recentred
in float64 before they are rounded to float32.
"""

from collections.abc import Callable
from functools import lru_cache
from math import prod
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from ..base.checks import as_array, choice
from ..base.errors import InputError
from ..kernels.marshalling import ArgumentForm, Packed, address_of, flatten, packed, struct_of
from ..scene.scene_bounds import flush_to_zero
from ..scene.triangles import HitFilter, Triangles
from .ray_passes import RayPass
from .shadow_query import CULL_FACES


class Operand(NamedTuple):
    """An array of points in memory: coordinate k of row i is at ``address + i * row + k * column``, in bytes."""

    address: int
    row: int  # 0: all rays share one row
    column: int
    double: int  # 1 for float64, 0 for float32


class Number(NamedTuple):
    """One number per ray, at ``address + i * row``; or one for all rays, `shared`, if the address is 0."""

    address: int
    row: int
    double: int  # 1 for float64, 0 for float32 or int32
    shared: float


class RayList(NamedTuple):
    """Rays in the caller's arrays; `trace.rays.ray_batches` checks and converts the numbers during tracing."""

    origins: Operand
    directions: Operand  # targets, for segments
    tmin: Number
    tmax: Number
    skip: Number
    frame: tuple[float, float, float]  # world position of the origin of the scene's frame
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
        """The arrays as a kernel argument, which they must outlive."""
        return _HITS.of_words(self.words(), None)

    def words(self) -> bytes:
        """The words of `packed`."""
        blocked, face, t, u, v = self
        m = len(face)
        if not m:
            return _BOOLS.pack(address_of(blocked), len(blocked), 1) + _NO_HIT_WORDS
        pointers = (address_of(face), m, 4, address_of(t), m, 8, address_of(u), m, 4, address_of(v), m, 4)
        return _HIT_STRUCT.pack(0, 0, 1, *pointers)


FoundTriangles: TypeAlias = Callable[[], tuple[Triangles, np.ndarray]]
"""Returns triangles, and for each ray the index (int) of the one that it hits, or -1, in the shape of the rays."""


class TracedRays(NamedTuple):
    """Hits of rays."""

    hits: HitArrays
    find: FoundTriangles | None  # the triangles hit, which may be made only then; None: for any-hit


def failing(traced: TracedRays, failed: NDArray[np.intp]) -> TracedRays:
    """Closest hits, with the rays of these indices marked as failed; changes the arrays in place."""
    hits, find = traced
    hits.t[failed], hits.face[failed], hits.u[failed], hits.v[failed] = np.nan, -1, 0.0, 0.0

    def find_others() -> tuple[Triangles, np.ndarray]:
        assert find is not None
        triangles, index = find()
        index = index.copy()
        index.reshape(-1)[failed] = -1
        return triangles, index

    return TracedRays(hits, find_others)


_NONE = HitArrays(*(np.empty(0, dtype) for dtype in (np.bool_, np.int32, np.float64, np.float32, np.float32)))
_NO_HITS = _NONE[1:]
_HITS = ArgumentForm(_NONE)
_POINTS, _NUMBERS, _ORIGIN = Operand(0, 0, 0, 0), Number(0, 0, 0, 0.0), (0.0, 0.0, 0.0)
NO_RAYS = RayList(_POINTS, _POINTS, _NUMBERS, _NUMBERS, _NUMBERS, _ORIGIN, 0, 0, False)
_RAYS = ArgumentForm(NO_RAYS)
_OPERAND, _NUMBER, _ROWS, _FRAME, _REST = (
    struct_of(flatten(each)[0]) for each in (_POINTS, _NUMBERS, (*_POINTS, *_POINTS), _ORIGIN, (0, 0, False))
)
_HIT_STRUCT = struct_of(flatten((_NONE,))[0])
_BOOLS, _NO_HIT_WORDS = (
    struct_of(flatten((_NONE.blocked,))[0]),
    packed(_NONE).words[24:],
)  # of one array, and the others
_I32, _F32, _F64 = np.dtype(np.int32), np.dtype(np.float32), np.dtype(np.float64)  # in the byte order of this machine


def hit_arrays(m: int, any_hit: bool) -> HitArrays:
    """`HitArrays` for m rays."""
    if any_hit:
        return HitArrays(np.empty(m, np.bool_), *_NO_HITS)
    empty = np.empty
    return HitArrays(_NONE.blocked, empty(m, np.int32), empty(m), empty(m, np.float32), empty(m, np.float32))


class RayArguments(NamedTuple):
    """Rays as arguments with checked shapes and dtypes. Their numbers are checked during tracing.

    World coordinates are recentred (minus `frame`, in float64) before they are rounded to float32.
    """

    origins: np.ndarray  # (..., 3) world
    directions: np.ndarray  # (..., 3) any non-zero length; for segments, their targets, world
    tmin: np.ndarray | float  # >= 0, in lengths of the direction; hits have t > tmin
    tmax: np.ndarray | float  # may be inf; hits have t < tmax
    skip: np.ndarray | float  # index of a triangle that is not tested, or -1
    shape: tuple[int, ...]  # to which all of them broadcast
    cull_faces: int  # a value of CULL_FACES
    segments: bool
    frame: tuple[float, float, float]  # world position of the origin of the scene's frame
    time: float = 0.0  # at which they are traced, within 0 .. `duration`

    @property
    def n(self) -> int:
        return prod(self.shape)

    def without_failed(self) -> "tuple[RayArguments, NDArray[np.intp]]":
        """The rays with another in the place of each that fails alone; and the indices of those, in C order.

        A ray fails if a coordinate is NaN, infinite or beyond float32, or its direction is zero. If no ray fails, or
        all do, they stay as they are.
        """
        good = self.arrays().traceable()
        if good.all() or not good.any():
            return self, np.empty(0, np.intp)
        first, points = int(good.argmax()), (*self.shape, 3)
        rows = [np.broadcast_to(array, points).reshape(-1, 3) for array in (self.origins, self.directions)]
        origins, directions = (np.where(good[:, None], row, row[first]).reshape(points) for row in rows)
        return self._replace(origins=origins, directions=directions), np.flatnonzero(~good)

    def copied(self) -> "RayArguments":
        """The same rays in copied arrays, which the caller cannot change."""
        names = self._fields[:5]
        changes: dict[str, Any] = {name: _copied(getattr(self, name)) for name in names}
        return self._replace(**changes)

    def packed(self) -> Packed:
        """The rays as a kernel's `RayList`, which keeps the arrays alive."""
        return _RAYS.of_words(*self.words())

    def words(self) -> tuple[bytes, object]:
        """The words of `packed`, and the arrays that they point to."""
        o, d, tmin, tmax, skip, shape, facing, segments, frame, _ = self
        shared = type(tmin) is type(tmax) is type(skip) is float
        if shared and len(shape) == 1 and _are_rows(o, *shape) and _are_rows(d, *shape):
            rows = _ROWS.pack(address_of(o), *o.strides, o.itemsize == 8, address_of(d), *d.strides, d.itemsize == 8)
            numbers = _shared_words(tmin, tmax, skip, frame)  # type: ignore[arg-type]
            return rows + numbers + _REST.pack(*shape, facing, segments), (o, d)
        (o, origins), (d, directions) = _operand(o, shape), _operand(d, shape)
        (tmin, begin), (tmax, end) = _number(tmin, shape), _number(tmax, shape)
        skip, face = _number(skip, shape, _I32)
        general = _FRAME.pack(*frame) + _REST.pack(prod(shape), facing, segments)
        words = b"".join((origins, directions, begin, end, face, general))
        return words, (o, d, tmin, tmax, skip)

    def arrays(self) -> "RayArrays":
        """The rays as rows of arrays."""
        points, number = (*self.shape, 3), (*self.shape, 1)
        return RayArrays(
            _rows(self.origins, points),
            _rows(self.directions, points),
            _rows(np.asarray(self.tmin), number),
            _rows(np.asarray(self.tmax), number),
            _rows(np.asarray(self.skip), number, np.int32),
            np.array(self.frame),
            self.segments,
        )


def _copied(value: np.ndarray | float) -> np.ndarray | float:
    return np.array(value) if isinstance(value, np.ndarray) else value


def rays_of(
    origins: ArrayLike,
    directions: ArrayLike | None,
    hits: HitFilter,
    frame: tuple[float, float, float],
    n_faces: int,
    targets: ArrayLike | None = None,
    time: float = 0.0,
) -> RayArguments:
    """The checked arguments of `Scene.occluded` and `Scene.closest_hit`.

    n_faces : number of faces of the scene
    time : within 0 .. `duration`
    """
    tmin, tmax, skip_face, cull_faces = hits
    origins, target_name = as_array(origins, "origins", strided=True), "directions" if targets is None else "targets"
    if targets is not None:
        directions, tmax = _segment_ends(directions, tmin, tmax, targets)
    elif directions is None:
        if origins.ndim < 1 or origins.shape[-1] != 6:
            raise InputError(
                f"rays must have shape (..., 6), or origins and directions (..., 3) each; got {origins.shape}"
            )
        origins, directions = origins[..., :3], origins[..., 3:]
    directions = as_array(directions, target_name, strided=True)
    if origins.shape[-1:] != (3,) or directions.shape[-1:] != (3,):
        array, name = (directions, target_name) if origins.shape[-1:] == (3,) else (origins, "origins")
        raise InputError(f"{name} must have shape (..., 3), not {array.shape}")
    tmin = tmin if type(tmin) is float else as_array(tmin, "tmin", strided=True)
    tmax = tmax if type(tmax) is float else as_array(tmax, "tmax", strided=True)
    skip = -1.0 if skip_face is None else _skip(skip_face, n_faces)
    shape: tuple[int, ...] | None = origins.shape[:-1]
    if directions.shape != origins.shape or not type(tmin) is type(tmax) is type(skip) is float:
        shape = _shape(origins.shape[:-1], directions.shape[:-1], tmin, tmax, skip)
        if shape is None:
            others = {"tmin": np.shape(tmin), "tmax": np.shape(tmax), "skip_face": np.shape(skip)}
            sizes = "".join(f", {name} {size}" for name, size in others.items() if size)
            raise InputError(
                f"shapes do not broadcast: origins {origins.shape}, {target_name} {directions.shape}{sizes}; "
                "origins[:, None] tests all pairs"
            )
    assert shape is not None
    facing = 0 if cull_faces is None else cull_value(cull_faces)
    return RayArguments(origins, directions, tmin, tmax, skip, shape, facing, targets is not None, frame, time)


def rays_in_frame(rays: RayPass) -> RayArguments:
    """The rays of a pass, whose origins are in the scene's frame."""
    shape = (len(rays.origins),)
    return RayArguments(rays.origins, rays.directions, 0.0, np.inf, rays.skip, shape, 0, False, (0.0, 0.0, 0.0))


def rays_along(
    points: np.ndarray, direction: np.ndarray, frame: tuple[float, float, float] = _ORIGIN, time: float = 0.0
) -> RayArguments:
    """Rays from checked points, (..., 3), along one direction, (3,) float32 or float64.

    frame : world position of the origin of the frame that the points are recentred in
    """
    return RayArguments(points, direction, 0.0, np.inf, -1.0, points.shape[:-1], 0, False, frame, time)


def segments_between(
    begin: np.ndarray, end: np.ndarray, skip: np.ndarray | float, time: float, facing: int = 0
) -> RayArguments:
    """Segments between points in the scene's frame, (n, 3) float32 each.

    skip : (n,) int, or -1.0 for no face
    facing : a value of CULL_FACES
    """
    return RayArguments(begin, end, 0.0, 1.0, skip, (len(begin),), facing, True, (0.0, 0.0, 0.0), time)


def _skip(skip_face: ArrayLike, n_faces: int) -> np.ndarray:
    skip = as_array(skip_face, "skip_face", strided=True)
    if skip.dtype.kind == "f":
        raise InputError(f"skip_face must hold integers, not {skip.dtype}")
    if skip.size and (skip.min() < -1 or skip.max() >= n_faces):
        raise InputError(f"skip_face must lie between -1 and {n_faces - 1}, the scene's last face")
    return skip


def _shape(
    origins: tuple[int, ...], directions: tuple[int, ...], *numbers: np.ndarray | float
) -> tuple[int, ...] | None:
    """The shape to which rays broadcast; None if there is none. `numpy.broadcast_shapes` takes longer than one ray."""
    shapes = {origins, directions, *(x.shape for x in numbers if isinstance(x, np.ndarray))} - {()}
    if len(shapes) <= 1:
        return next(iter(shapes), ())
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        return None


def _segment_ends(
    directions: ArrayLike | None, tmin: ArrayLike, tmax: ArrayLike, targets: ArrayLike
) -> tuple[ArrayLike, float]:
    """(targets, tmax) of segments, which take no directions, tmin or tmax."""
    if type(tmin) is type(tmax) is float and directions is None and tmin == 0.0 and tmax == np.inf:
        return targets, 1.0
    if directions is not None or np.any(as_array(tmin, "tmin")) or np.any(as_array(tmax, "tmax") != np.inf):
        raise InputError("give either targets, which end the rays, or directions, tmin and tmax")
    return targets, 1.0


def _are_rows(array: np.ndarray, n: int) -> bool:
    """Whether points have a row for each of n rays, in memory that kernels read."""
    return array.shape == (n, 3) and (array.dtype is _F64 or array.dtype is _F32)


@lru_cache(64)
def _shared_words(tmin: float, tmax: float, skip: float, frame: tuple[float, float, float]) -> bytes:
    """The words of a `RayList` from `tmin` to `frame`, where all rays share its numbers."""
    numbers = (_NUMBER.pack(0, 0, False, each) for each in (tmin, tmax, skip))
    return b"".join((*numbers, _FRAME.pack(*frame)))


def _operand(array: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, bytes]:
    """Points that broadcast to a shape, in memory that kernels read, and their `Operand` in words."""
    if array.dtype is not _F64 and array.dtype is not _F32:
        array = _rows(array, array.shape).reshape(array.shape)
    if array.ndim == 1:
        return array, _OPERAND.pack(address_of(array), 0, array.strides[0], array.itemsize == 8)
    if array.ndim > 2 or array.shape[:1] != shape:
        array = _rows(array, (*shape, 3))
    return array, _OPERAND.pack(address_of(array), *array.strides, array.itemsize == 8)


def _number(
    value: np.ndarray | float, shape: tuple[int, ...], dtype: DTypeLike | None = None
) -> tuple[np.ndarray | float, bytes]:
    """Numbers that broadcast to a shape, in memory that kernels read, and their `Number` in words."""
    if type(value) is not float:
        if isinstance(value, np.ndarray) and value.ndim:
            rows = _rows(value, (*shape, 1), dtype)
            return rows, _NUMBER.pack(address_of(rows), rows.strides[0], rows.itemsize == 8, 0.0)
        value = float(value)
    return value, _NUMBER.pack(0, 0, False, value)


class RayArrays(NamedTuple):
    """The arrays of a ray list, of any strides: float32 or float64, `skip` int32."""

    origins: np.ndarray  # (m, 3) world
    directions: np.ndarray  # (m, 3) or, for segments, their targets, world
    tmin: np.ndarray  # (m, 1)
    tmax: np.ndarray  # (m, 1)
    skip: np.ndarray  # (m, 1)
    frame: np.ndarray  # (3,) float64
    segments: bool = False

    def part(self, places: slice | np.ndarray) -> "RayArrays":
        """A subset of the rays; a copy for an array of indices."""
        return self._replace(**{name: getattr(self, name)[places] for name in self._fields[:5]})

    def local(self) -> tuple[np.ndarray, np.ndarray]:
        """The origins in the scene's frame, and the directions, or the targets in this frame: (m, 3) float32 each."""
        vectors = self.directions.astype(np.float64) - self.frame if self.segments else self.directions
        with np.errstate(over="ignore", invalid="ignore"):  # `check` reports these rays
            origins = flush_to_zero((self.origins.astype(np.float64) - self.frame).astype(np.float32))
            vectors = np.ascontiguousarray(vectors, np.float32)
        return origins, flush_to_zero(vectors) if self.segments else vectors

    def rays(self) -> RayPass:
        """The rays in the scene's frame. The direction of a segment is the rounded difference of its ends."""
        origins, directions = self.local()
        if self.segments:
            with np.errstate(over="ignore"):
                directions = (directions.astype(np.float64) - origins).astype(np.float32)
        return RayPass(origins, directions, np.ascontiguousarray(self.skip[:, 0]))

    def traceable(self) -> NDArray[np.bool_]:
        """(m,) bool: whether the coordinates are finite, also in float32, and the direction is not zero."""
        origins, directions = self.local()
        good: NDArray[np.bool_] = np.isfinite(origins).all(1) & np.isfinite(directions).all(1)
        return good & (directions.any(1) | self.segments)

    def check(self) -> None:
        """Raise an InputError for the first invalid ray, if there is one."""
        origins, directions = self.local()
        for array, name in ((origins, "origins"), (directions, "targets" if self.segments else "directions")):
            _require(np.isfinite(array).all(1), f"{name} hold NaN or infinity, or are beyond float32 (ray {{}})")
        _require(
            directions.any(1) | self.segments, "direction of ray {} is zero in float32; give every ray a direction"
        )
        _require((self.tmin >= 0).all(1) & (self.tmin < np.inf).all(1), "tmin must be finite and not negative (ray {})")
        _require(~np.isnan(self.tmax).any(1), "tmax is NaN (ray {})")


def changed_error() -> InputError:
    """The error for rays whose validity differs between tracing and the check afterwards."""
    return InputError("the ray arrays changed during tracing; pass copies of arrays that other threads write")


def _rows(array: np.ndarray, shape: tuple[int, ...], dtype: DTypeLike | None = None) -> np.ndarray:
    """The array broadcast to `shape`, as rows, in float32 or float64, or in `dtype`; a view if possible."""
    if shape[-1] == 1:
        array = array[..., None]
    if dtype is None:
        dtype = array.dtype if array.dtype in (np.float32, np.float64) else np.float64
    native = array.astype(np.dtype(dtype).newbyteorder("="), copy=False)
    return np.broadcast_to(native, shape).reshape(-1, shape[-1])


def _require(good: np.ndarray | np.bool_, message: str) -> None:
    if not good.all():
        raise InputError(message.format(int(np.argmin(good))))


def cull_value(cull_faces: str | None) -> int:
    """The CULL_FACES value of None, "front" or "back"."""
    return 0 if cull_faces is None else CULL_FACES[choice(cull_faces, "cull_faces", CULL_FACES)]
