"""Receivers: surface points offset from their surface once, before any tracing method, to prevent self-intersection.

A receiver is shifted along its geometric normal, towards the visible side, by a few units in the last place of its
coordinates. The amount follows from the float32 errors of the position and of its triangle's corners, without a scene
constant. It doubles until the receiver lies strictly on the visible side of its triangle's plane, in exact arithmetic.
Then its own triangle cannot meet a segment to a light sample above the plane. The surface itself occludes samples on or
below the plane.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, unit_vectors, vector
from ..base.errors import InputError
from ..kernels.exact.filters import UNSURE, max_magnitude, plane, quick_side, side_of
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import new_ticket, run, shares, thread_count
from ..kernels.simd import get, ptr, put
from ..scene.scene_bounds import flush_to_zero

NOTHING, FREE = 0, 2  # values of `sides` besides 1 and -1: no receiver; a point in free space

SHIFT = np.float64(2.0**-21)  # eight units of float32 roundoff: rounding of position and normal, and of neighbours
_ROUNDED_TO_INFINITY = 2.0**128 - 2.0**103  # the smallest such number, in float32
_MAX_DOUBLINGS = 60  # a zero-area triangle has no sides; it is never visible, but the loop must end


@inlined
def _magnitude(corners, face):
    m = np.float32(0.0)
    for k in range(9):
        c = abs(get(corners, 9 * face + k))
        m = c if c > m else m
    return np.float64(m)


class FacePlane(NamedTuple):
    """A triangle's plane, as from `predicate.filters.plane` relative to (0, 0, 0); float64."""

    v0: tuple[float, float, float]
    normal: tuple[float, float, float]
    error: float
    size: float  # largest coordinate magnitude of its corners


@inlined
def plane_of_face(corners, face):
    """The `FacePlane` of a triangle."""
    zero = np.float64(0.0)
    v0, normal, error = plane(corners, face, zero, zero, zero)
    return FacePlane(v0, normal, error, _magnitude(corners, face))


@inlined
def _first_shift(p, known):
    widest_point, widest_corner = max_magnitude(p), known.size
    return SHIFT * (widest_point if widest_point > widest_corner else widest_corner)  # Eq. (1) of receivers.md


@inlined
def _shifted(p, n, shift):
    return np.float32(p[0] + shift * n[0]), np.float32(p[1] + shift * n[1]), np.float32(p[2] + shift * n[2])


@inlined
def _offset_point(p, n, side, known, corners, face):
    """The float32 receiver of the float64 surface point p with unit normal n, on the visible side of `face`.

    known : the `FacePlane` of `face`
    """
    shift = _first_shift(p, known)
    x, y, z = _shifted(p, n, shift)
    for _ in range(_MAX_DOUBLINGS):
        if side_of(known.v0, known.normal, known.error, x, y, z, corners, face) == side:
            break
        shift *= 2.0
        x, y, z = _shifted(p, n, shift)
    return x, y, z


@inlined
def quick_offset(p, n, side, known):
    """The receiver of `_offset_point` without exact arithmetic: (the point, whether float64 has decided it)."""
    shift = _first_shift(p, known)
    x, y, z = _shifted(p, n, shift)
    for _ in range(_MAX_DOUBLINGS):
        found = quick_side(known.v0, known.normal, known.error, x, y, z)
        if found == side or found == UNSURE:
            return (x, y, z), found == side
        shift *= 2.0
        x, y, z = _shifted(p, n, shift)
    return (x, y, z), True


@kernel
def _move_kernel(ticket, positions, normals, faces, sides, corners, origins):
    positions, normals, faces, sides = ptr(positions), ptr(normals), ptr(faces), ptr(sides)
    corners, origins, zero = ptr(corners), ptr(origins), np.float64(0.0)
    for first, end in shares(ticket):
        last, known = -1, FacePlane((zero, zero, zero), (zero, zero, zero), zero, zero)
        for i in range(first, end):
            x, y, z = get(positions, 3 * i), get(positions, 3 * i + 1), get(positions, 3 * i + 2)
            if get(sides, i) != NOTHING:
                face = get(faces, i)
                if face != last:  # neighbouring pixels often see the same triangle
                    last, known = face, plane_of_face(corners, face)
                p = np.float64(x), np.float64(y), np.float64(z)
                n = (
                    np.float64(get(normals, 3 * i)),
                    np.float64(get(normals, 3 * i + 1)),
                    np.float64(get(normals, 3 * i + 2)),
                )
                x, y, z = _offset_point(p, n, get(sides, i), known, corners, face)
            put(origins, 3 * i, x)
            put(origins, 3 * i + 1, y)
            put(origins, 3 * i + 2, z)


def surface_receivers(
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    faces: NDArray[np.int32],
    sides: NDArray[np.int8],
    corners: NDArray[np.float32],
    threads: int | None = None,
) -> NDArray[np.float32]:
    """(m, 3) float32: the receivers of m points on known triangles.

    positions, normals : (m, 3) float32; normals have unit length and point to the visible side
    faces : (m,) int32 triangle indices
    sides : (m,) int8, visible side of the triangle's plane; NOTHING: leave out the point
    corners : (n, 9) float32
    """
    origins = np.empty_like(positions)
    ticket = new_ticket(len(positions), 8192)
    run(_move_kernel, thread_count(threads), ticket, positions, normals, faces, sides, corners, origins)
    return origins


def point_receivers(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    world: NDArray[np.float64],
    single: bool,
    middle: NDArray[np.float64] | None = None,
) -> NDArray[np.float32]:
    """(m, 3) float32: the receivers of points on surfaces that are known only by their normals.

    points : (m, 3) float64, recentred
    normals : (m, 3) float64, unit length
    world : (m, 3) float64, world positions
    single : whether the world positions were passed as float32, so that their rounding error counts too
    middle : (3,) float64, world: of the scene; None: the origin of its frame
    """
    shift = SHIFT * _size(points, world, middle)  # Eq. (2) of docs/design/receivers.md
    if single:
        shift = shift + SHIFT / 4 * _largest(world)
    return np.ascontiguousarray(flush_to_zero(points + shift * normals).astype(np.float32))


def _size(
    points: NDArray[np.float64], world: NDArray[np.float64], middle: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """(n, 1) float64: the magnitude of points for their rounding errors.

    Where surfaces pass near the origin of the frame, their corners lie farther from it than the points do. So the
    distance from the middle of the scene counts too, where it is not the origin.
    """
    size = _largest(points)
    return size if middle is None else np.maximum(size, _largest(world - middle))


def _apart(middle: NDArray[np.float64] | None, frame: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The middle of a scene; None if it is the origin of the frame, from which points are measured anyway."""
    return None if middle is None or np.array_equal(middle, frame) else middle


def _largest(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 1) float64: the largest magnitude of the components of (n, 3) vectors; NumPy reduces short rows slowly."""
    x, y, z = np.abs(vectors.T)
    out: NDArray[np.float64] = np.maximum(np.maximum(x, y), z)[:, None]
    return out


class Receivers(NamedTuple):
    """Query points, in an array shaped like a picture: a list of n points has the shape (1, n).

    Constructed by `on_surface` or `in_space`, and reusable for any number of queries.
    """

    origins: np.ndarray  # (h, w, 3) float32, moved off their surfaces, recentred frame
    sides: np.ndarray  # (h, w) int8: 1, FREE, or NOTHING where there is no receiver
    normals: np.ndarray  # (h, w, 3) float64 unit, towards the tested side; (0, 0, 3) for points in free space

    @classmethod
    def in_space(cls, points: ArrayLike, frame: ArrayLike) -> "Receivers":
        """Points in free space, without an offset.

        Parameters
        ----------
        points : (..., 3) of any floating point or integer dtype, world
        frame : (3,) float64, world position of the origin of the scene's frame

        Raises
        ------
        InputError
            If a coordinate is NaN, infinite, or beyond float32 in the scene's frame.
        """
        origins = flush_to_zero(_in_frame(_points(points), frame))[None]
        sides = np.empty(origins.shape[:2], np.int8)
        sides.fill(FREE)  # faster than np.full
        return cls(origins, sides, _NO_NORMALS)

    @classmethod
    def on_surface(
        cls, points: ArrayLike, normals: ArrayLike, frame: ArrayLike, middle: ArrayLike | None = None
    ) -> "Receivers":
        """Points on surfaces, offset from them by a few units in the last place.

        Parameters
        ----------
        points : (..., 3) of any floating point or integer dtype, world
        normals : (..., 3) float, towards the tested side, of any length; they broadcast against the points
        frame : (3,) float64, world position of the origin of the scene's frame
        middle : (3,) float64, optional
            `Scene.middle`, where it is not the origin. None: the origin.

        Raises
        ------
        InputError
            As for `in_space`; and if the normals do not broadcast, or one is zero, NaN or infinite.
        """
        array = _points(points)
        _in_frame(array, frame)
        unit = _unit_normals(normals, array.shape)
        world = array.astype(np.float64).reshape(1, -1, 3)
        centre = None if middle is None else vector(middle, "middle")
        return cls.moved_off(world, unit[None], np.asarray(frame), array.dtype == np.float32, centre)

    @classmethod
    def of(
        cls, points: ArrayLike, normals: ArrayLike | None, frame: ArrayLike, middle: ArrayLike | None = None
    ) -> "Receivers":
        """Points `in_space` if `normals` is None, otherwise `on_surface`."""
        return cls.in_space(points, frame) if normals is None else cls.on_surface(points, normals, frame, middle)

    @classmethod
    def moved_off(
        cls,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
        frame: np.ndarray,
        single: bool = False,
        middle: NDArray[np.float64] | None = None,
    ) -> "Receivers":
        """`on_surface` for (h, w, 3) float64 points and unit normals that are already checked.

        single : whether the points were passed as float32
        """
        flat = points.reshape(-1, 3)
        moved = point_receivers(flat - frame, normals.reshape(-1, 3), flat, single, _apart(middle, frame))
        origins = moved.reshape(points.shape)
        return cls(origins, np.ones(points.shape[:2], np.int8), np.ascontiguousarray(normals))

    @property
    def n(self) -> int:
        """The number of receivers, including missing ones."""
        return self.sides.size

    def take(self, places: slice | np.ndarray) -> "Receivers":
        """A subset of a list of receivers; `places`: a slice, or (m,) indices or flags."""
        normals = self.normals[:, places] if self.normals.size else self.normals
        return Receivers(np.ascontiguousarray(self.origins[:, places]), self.sides[:, places], normals)

    def seeing_all_around(self) -> "Receivers":
        """The same points in free space, without a surface that occludes what is below it."""
        return Receivers(self.origins, np.full_like(self.sides, FREE), _NO_NORMALS)


_NO_NORMALS = np.empty((0, 0, 3))


def receivers_above(
    points: NDArray[np.float64], axis: int, frame: NDArray[np.float64], middle: NDArray[np.float64]
) -> Receivers:
    """Points offset along an axis as those on a surface are, but in free space: without a horizon.

    points : (n, 3) float64, world
    axis : 0, 1 or 2: the normal of the surface points along it
    frame, middle : (3,) float64, world position of the origin of the scene's frame, and of its middle

    Raises
    ------
    InputError
        As for `Receivers.in_space`.
    """
    local = points - frame
    local[:, axis] += SHIFT * _size(local, points, _apart(middle, frame))[:, 0]
    with np.errstate(over="ignore"):
        origins = flush_to_zero(local).astype(np.float32)[None]
    if not np.isfinite(origins).all():
        _in_frame(points, frame)
    return Receivers(origins, np.full(origins.shape[:2], FREE, np.int8), _NO_NORMALS)


def _points(values: ArrayLike) -> np.ndarray:
    points = as_array(values, "points")
    if points.ndim < 1 or points.shape[-1] != 3:
        raise InputError(f"points must have shape (..., 3), not {points.shape}")
    return points


def _in_frame(points: np.ndarray, frame: ArrayLike) -> NDArray[np.float32]:
    """(n, 3) float32, finite, in the scene's frame."""
    origin = frame if type(frame) is np.ndarray and frame.dtype.char == "d" else as_array(frame, "frame")
    if origin.shape != (3,):
        raise InputError(f"frame must have shape (3,), not {origin.shape}; pass Scene.origin")
    local = points.astype(np.float64, copy=False).reshape(-1, 3) - origin
    if not np.abs(local).max(initial=0.0) < _ROUNDED_TO_INFINITY:
        if not np.isfinite(local).all():
            raise InputError("points hold NaN or infinity")
        raise InputError("points lie beyond float32, farther than 3.4e38 from the scene; move them closer")
    single: NDArray[np.float32] = local.astype(np.float32)
    return single


def _unit_normals(normals: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    vectors = as_array(normals, "normals").astype(np.float64)
    if vectors.ndim < 1 or vectors.shape[-1] != 3:
        raise InputError(f"normals must have shape (..., 3), not {vectors.shape}")
    try:
        vectors = np.broadcast_to(vectors, shape).reshape(-1, 3)
    except ValueError:
        raise InputError(f"normals {vectors.shape} do not broadcast to the points {shape}") from None
    unit = unit_vectors(vectors, "the normal of point", "leave normals out for points in free space")
    return np.ascontiguousarray(unit)
