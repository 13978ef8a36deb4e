"""Beams: segments of a query that share one ray hierarchy and one traversal of the triangles.

Apexes. All segments to a point light end there, so it is the common apex of their cones [Olsson and Assarsson 2011,
Sec. 4.3]. Other lights have a blurred apex: the samples of a quad lie in a ball, the directions to the sun in a cone,
and the ends of ambient segments in a ball around each receiver. A triangle's planes are tilted or moved by the same
amount (`shadow_planes`), so that one traversal serves all samples. Alternatively, each sample is a point light with its
own beam.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.exact.filters import dot, max_magnitude, plane
from ...kernels.jit import U64Ptr, inlined, kernel
from ...kernels.simd import (
    as_i32,
    bits,
    fma,
    gather,
    get,
    load16,
    lowest_bit,
    maximum,
    popcount,
    ptr,
    put,
    splat16,
    stack_i32,
    store,
)
from ...kernels.vec3 import Vec3, scale3
from ...query.query_bounds import bounds
from ...query.receivers import NOTHING
from ...query.shadow_query import (
    QueryPointers,
    ShadowQuery,
    horizon_of,
    is_above,
    patch_of,
    query_pointers,
    sample_of,
    set_bit,
    set_of,
    three_at,
)
from ...scene.light_lists import N_SETS
from ...scene.lights import AMBIENT, DIRECTIONAL, FIXED, SPHERE, LightPatch, is_list, tangents
from ...trace.counters import BELOW_HORIZON, RAYS, count

# --- Beams ------------------------------------------------------------------------------------------------------------

PERSPECTIVE, PARALLEL, AROUND = 0, 1, 2
"""Kinds of `Beam`: ends in a point or ball; ends far away; ends all around each receiver."""

_BEAM_MARGIN = 1.0 + 2.0**-18  # exceeds the rounding error of float32 samples and of planes
_NARROW = 1e-3  # minimum cosine to the axis of a cone of distant lights; below it, the beam is AROUND
_WIDE = 1e5  # tangent of an angle; for wider disks, the distance is lost in the rounding of samples


class Beam(NamedTuple):
    """The samples and receivers of a beam, and its apex or direction.

    A beam has its own frame, in which receivers are at most 1 away and most are not much nearer. Its numbers therefore
    fit into float32 for every unit of the scene.
    """

    kind: int  # PERSPECTIVE, PARALLEL or AROUND
    first: int  # the first sample
    n_samples: int  # number of samples
    set: int  # the sample set of the beam's receivers; -1: all sets
    common: bool  # all these receivers have the same ends
    apex: np.ndarray  # (3,) float64, recentred frame; PERSPECTIVE: the middle of all ends, a float32 point
    axes: np.ndarray  # (3, 3) float64: rows u, v and, PARALLEL, towards the light
    unit: float  # a power of two: scale factor from the scene to the beam's frame
    # In the beam's frame:
    radius: float  # PERSPECTIVE: largest distance of an end from the apex; PARALLEL: sine of the largest angle of a
    # direction to the third axis; AROUND: largest distance of an end from its receiver
    lower: np.ndarray  # (3,) float64: bounds of the receivers along the axes; unused by PERSPECTIVE
    upper: np.ndarray  # (3,) float64
    scale: float  # largest absolute coordinate of the receivers; unused by PERSPECTIVE


def fixed_points(query: ShadowQuery) -> NDArray[np.float32]:
    """(16, n, 3) float32: the ends of a light that does not move with the receiver, computed as in `sample_point`."""
    light, a = query.light, query.samples
    ends: NDArray[np.float64] = ((light.base + a[..., :1] * light.u) + a[..., 1:2] * light.v) + a[..., 2:] * light.w
    return ends.astype(np.float32)


def beams_of(query: ShadowQuery, each_sample: bool = False, threads: int | None = None) -> list[Beam]:
    """The beams of a ShadowQuery; ``each_sample``: one beam for each sample of a light that does not move.

    The lights of a list always have one beam each, because they may be far apart.
    """
    light, n = query.light, query.samples.shape[1]
    if not query.sides.size:
        return []
    low, high = (corner.astype(np.float64) for corner in bounds(query.origins, threads))
    if light.kind == SPHERE:
        return [_beam_of_ball(0, n, -1, light.base, light.radius, low, high)]
    if light.kind == DIRECTIONAL:
        return [_distant_list(query, low, high) if is_list(light) else _distant_disk(light, n, low, high)]
    if light.kind == AMBIENT:
        return [_beam_without_apex(AROUND, n, np.eye(3), light.radius * _BEAM_MARGIN, low, high)]
    ends = fixed_points(query)
    if light.kind == FIXED and not each_sample:
        return [_beam_of_ends(ends, 0, n, -1, low, high)]
    same = (ends == ends[:1]).all((0, 2))
    return [
        _beam_of_ends(ends[:, s : s + 1] if which < 0 else ends[which : which + 1, s : s + 1], s, 1, which, low, high)
        for s in range(n)
        for which in ([-1] if same[s] else range(N_SETS))
    ]


def _beam_of_ends(
    ends: NDArray[np.float32], first: int, count: int, which: int, low: NDArray[np.float64], high: NDArray[np.float64]
) -> Beam:
    """The beam of segments to these ends."""
    points = ends.reshape(-1, 3).astype(np.float64)
    if (points == points[0]).all():
        return _beam_of_ball(first, count, which, points[0], 0.0, low, high)._replace(common=True, radius=0.0)
    centre = (points.min(0) + points.max(0)) / 2.0
    common = bool((ends == ends[:1]).all())
    beam = _beam_of_ball(first, count, which, centre, float(np.linalg.norm(points - centre, axis=1).max()), low, high)
    return beam._replace(common=common)


def _beam_of_ball(
    first: int,
    count: int,
    which: int,
    centre: NDArray[np.float64],
    radius: float,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> Beam:
    """The beam of segments from the box from `low` to `high`, (3,) float64 each, to a ball.

    Its apex is a float32 point, so that differences to it are rounded once.
    """
    apex, none = centre.astype(np.float32).astype(np.float64), np.zeros(3)
    radius = (radius + float(np.linalg.norm(centre - apex))) * _BEAM_MARGIN + 2.0**-22 * float(
        np.abs(apex).max() + radius
    )
    unit = _unit(float(np.linalg.norm(np.maximum(np.abs(low - apex), np.abs(high - apex)))))
    return Beam(PERSPECTIVE, first, count, which, False, apex, np.eye(3), unit, radius * unit, none, none, 0.0)


def _beam_without_apex(
    kind: int, n: int, axes: NDArray[np.float64], radius: float, low: NDArray[np.float64], high: NDArray[np.float64]
) -> Beam:
    """The beam without an apex for receivers in the box from `low` to `high`."""
    corners = np.where(np.arange(8)[:, None] >> np.arange(3) & 1, high, low) @ axes.T
    unit = _unit(np.abs(corners).max() * _BEAM_MARGIN)
    corners *= unit
    scale = float(np.abs(corners).max()) * _BEAM_MARGIN
    if kind == AROUND:
        radius *= unit
    return Beam(kind, 0, n, -1, False, np.zeros(3), axes, unit, radius, corners.min(0), corners.max(0), scale)


def _distant_disk(light: LightPatch, n: int, low: NDArray[np.float64], high: NDArray[np.float64]) -> Beam:
    """The beam of a distant disk. Because of rounding, directions vary even for a light without extent."""
    distance = float(np.linalg.norm(light.base))
    towards = light.base / distance
    length = float(max(np.linalg.norm(light.u), np.linalg.norm(light.v)))
    if length > _WIDE * distance:
        return _beam_without_apex(AROUND, n, np.eye(3), (distance + length) * _BEAM_MARGIN, low, high)
    slope = length / distance * _BEAM_MARGIN
    sine = slope / math.sqrt(1.0 + slope * slope) + 2.0**-20
    return _beam_without_apex(PARALLEL, n, np.stack([*tangents(towards), towards]), min(sine, 1.0), low, high)


def _distant_list(query: ShadowQuery, low: NDArray[np.float64], high: NDArray[np.float64]) -> Beam:
    """The beam of a list of distant lights: of the cone around their mean direction, if it is narrow."""
    distance, towards = float(np.linalg.norm(query.light.u)), query.samples.reshape(-1, 3)
    middle = towards.mean(0)
    length = float(np.linalg.norm(middle))
    n = query.samples.shape[1]
    if length > 0.0:
        middle /= length
        cosine = float((towards @ middle).min())
        if cosine > _NARROW:
            sine = float(np.linalg.norm(np.cross(towards, middle), axis=1).max()) * _BEAM_MARGIN + 2.0**-20
            return _beam_without_apex(PARALLEL, n, np.stack([*tangents(middle), middle]), min(sine, 1.0), low, high)
    return _beam_without_apex(AROUND, n, np.eye(3), distance * _BEAM_MARGIN, low, high)


def _unit(distance: float) -> float:
    """The power of two that scales a distance to between 1 / 2 and 1, limited to exponents of float32."""
    return 2.0 ** -min(max(int(np.frexp(distance)[1]), -100), 100)


# --- Projection of points: onto the six faces of a cube around the apex, or parallel for distant lights ---------------

FACES = 6  # of the cube around an apex: +x, -x, +y, -y, +z, -z


class BeamView(NamedTuple):
    """A `Beam` in kernels; all scalars except `kind` are float64."""

    kind: int
    unit: float  # scale factor from the scene to the beam's frame
    x: float  # the apex
    y: float
    z: float
    u: tuple[float, float, float]  # three axes of the beam's frame; unused by PERSPECTIVE
    v: tuple[float, float, float]
    w: tuple[float, float, float]
    radius: float  # as in `Beam`
    scale: float  # largest absolute coordinate of a receiver in the beam's frame; unused by PERSPECTIVE
    lowest: float  # lowest last coordinate of a receiver


@inlined
def view_of(beam):
    """The `BeamView` of a `Beam`."""
    p, a = beam.apex, beam.axes
    u, v, w = (a[0, 0], a[0, 1], a[0, 2]), (a[1, 0], a[1, 1], a[1, 2]), (a[2, 0], a[2, 1], a[2, 2])
    return BeamView(beam.kind, beam.unit, p[0], p[1], p[2], u, v, w, beam.radius, beam.scale, beam.lower[2])


@inlined
def relative(view, p):
    """A float64 point in the beam's frame, relative to the apex or along the axes."""
    s = view.unit
    if view.kind == PERSPECTIVE:
        return (p[0] - view.x) * s, (p[1] - view.y) * s, (p[2] - view.z) * s
    return dot(view.u, p) * s, dot(view.v, p) * s, dot(view.w, p) * s


@inlined
def turned(d, face):
    """(u, v, depth) of a direction, with depth along the face's axis. The map is linear, and also valid for normals."""
    if face < 2:
        return d[1], d[2], (d[0] if face == 0 else -d[0])
    if face < 4:
        return d[2], d[0], (d[1] if face == 2 else -d[1])
    return d[0], d[1], (d[2] if face == 4 else -d[2])


@inlined
def relative16(view, o):
    """16 points in the beam's frame, a `Vec` of f32x16. Apexes are float32, so differences are rounded only once."""
    s = np.float32(view.unit)
    if view.kind == PERSPECTIVE:
        return scale3(Vec3(o.x - np.float32(view.x), o.y - np.float32(view.y), o.z - np.float32(view.z)), s)
    o = scale3(o, s)
    return Vec3(_component(o, view.u), _component(o, view.v), _component(o, view.w))


@inlined
def _component(o, axis):
    f = np.float32
    return fma(o.x, f(axis[0]), fma(o.y, f(axis[1]), o.z * f(axis[2])))


@inlined
def projected16(view, o, face):
    """(u, v, q) of 16 points; planes are linear in these coordinates.

    PERSPECTIVE: u and v are divided by the depth, and q = 1 / depth. Otherwise: coordinates along the frame's axes.
    """
    d = relative16(view, o)
    if view.kind == PERSPECTIVE:
        u, v, depth = turned((d.x, d.y, d.z), face)
        q = np.float32(1.0) / depth
        return u * q, v * q, q
    return d.x, d.y, d.z


# --- Active receivers of a beam: those with a sample above their own surface ------------------------------------------

_SLANT = np.float64(2.0**-16)  # sine of an angle: a distant light must be this far above a plane to be on one side
_SHALLOW = np.float64(2.0**-18)  # relative to the light's distance: receivers near a plane are no farther from it
_MORE = np.float64(1.000001)


class ConeSamples(NamedTuple):
    """The samples of a `Beam`."""

    first: int  # the first sample
    n_samples: int  # number of samples
    set: int  # sample set; -1: all sets


class QueryBits(NamedTuple):
    """A query and its answer bits."""

    query: QueryPointers
    bits: U64Ptr  # uint64 *


class SixteenReceivers(NamedTuple):
    """16 receivers of a query, i32x16 each."""

    ids: Any  # their indices
    sides: Any  # NOTHING: none of the beam's receivers
    faces: Any


@inlined
def query_bits_of(query, bits):
    """The `QueryBits` of a ShadowQuery and the array of its answer bits."""
    return QueryBits(query_pointers(query), ptr(bits))


@kernel
def _light_side(query_bits, view, face):
    """The side of a triangle's plane that all segment ends of the receivers near it are on; 0: unknown."""
    z = np.float64(0.0)
    if view.kind == AROUND:
        return 0
    at = (view.x, view.y, view.z) if view.kind == PERSPECTIVE else (z, z, z)
    p, n, error = plane(query_bits.query.corners, face, z, z, z)
    length = np.sqrt(dot(n, n)) * _MORE
    if view.kind == PERSPECTIVE:
        to = at[0] - p[0], at[1] - p[1], at[2] - p[2]
        h, slack = dot(n, to), view.radius / view.unit * length + error * max_magnitude(to)
    elif view.scale > 64.0 * view.unit * _distance(query_bits):  # rounding of ends is significant
        return 0
    else:
        h, slack = dot(n, view.w), (view.radius + _SLANT) * length + error
    if not abs(h) > slack:
        return 0
    return 1 if h > z else -1


@inlined
def _distance(query_bits):
    """The distance of a distant light."""
    base = query_bits.query.light.base
    return np.sqrt(dot(base, base))


@kernel
def _is_near(query_bits, view, i):
    """Whether a receiver is near its triangle's plane, so that all samples beyond the plane are below its surface."""
    z = np.float64(0.0)
    p, n, error = plane(query_bits.query.corners, get(query_bits.query.faces, i), z, z, z)
    o = three_at(query_bits.query.origins, i)
    to = o[0] - p[0], o[1] - p[1], o[2] - p[2]
    return abs(dot(n, to)) + error * max_magnitude(to) < _SHALLOW * _distance(query_bits) * np.sqrt(dot(n, n))


@kernel
def _is_active(query_bits, samples, i, counters):
    """Whether a sample of a beam lies above the receiver's own surface. Sets the bits of the samples below it."""
    patch, horizon, active = patch_of(query_bits.query, i), horizon_of(query_bits.query, i), False
    for s in range(samples.first, samples.first + samples.n_samples):
        l = sample_of(query_bits.query, patch, i, s)
        if is_above(horizon, l[0], l[1], l[2], query_bits.query.corners):
            active = True
        else:
            count(counters, BELOW_HORIZON, 1)
            set_bit(query_bits.query, query_bits.bits, i, s)
    return active


@kernel
def _set_below_horizon(query_bits, samples, ids, lanes, counters):
    """Set the bits of all samples of a beam for some lanes; ids: pointer to int32."""
    count(counters, BELOW_HORIZON, samples.n_samples * popcount(lanes))
    while lanes != 0:
        i = get(ids, lowest_bit(lanes))
        lanes &= lanes - 1
        for s in range(samples.first, samples.first + samples.n_samples):
            set_bit(query_bits.query, query_bits.bits, i, s)


@kernel
def sides_of(query_bits, samples, ids, lanes):
    """i32x16: the sides of 16 receivers, NOTHING for receivers outside `lanes` (bits) or of another sample set.

    ids : i32x16, indices of the receivers
    """
    at, sides = stack_i32(16), stack_i32(16)
    store(at, 0, ids)
    for lane in range(16):
        i = get(at, lane)
        others = lanes >> lane & 1 == 0 or (samples.set >= 0 and set_of(query_bits.query, i) != samples.set)
        put(sides, lane, NOTHING if others else get(query_bits.query.sides, i))
    return load16(sides, 0)


@kernel
def _active_below_plane(query_bits, view, samples, ids, lanes, counters):
    """`active_receivers` for receivers that their triangle's plane separates from the light; ids: pointer to int32."""
    if view.kind == PERSPECTIVE:  # all receivers have the same ends
        _set_below_horizon(query_bits, samples, ids, lanes, counters)
        return 0
    active, below = 0, 0
    while lanes != 0:
        lane, i = lanes & -lanes, get(ids, lowest_bit(lanes))
        lanes ^= lane
        if _is_near(query_bits, view, i):
            below |= lane
        elif _is_active(query_bits, samples, i, counters):
            active |= lane
    _set_below_horizon(query_bits, samples, ids, below, counters)
    return active


_NO_SIDE = 3  # of a plane that may pass between the ends


def new_light_sides(query: ShadowQuery) -> NDArray[np.int8]:
    """(n + 4,) int8, zeros: per triangle of a query, `_light_side` of a beam once it is known, 3 if there is none.

    Threads share it: they write equal numbers. Only triangles with receivers are computed, and their memory is used.
    """
    return np.zeros(len(query.corners) + 4, np.int8)


@inlined
def _known_sides(light_sides, faces):
    """i32x16: the numbers of 16 triangles in `new_light_sides`."""
    at, three = maximum(faces, np.int32(0)), splat16(np.int32(3))
    words = gather(as_i32(light_sides), at >> np.int32(2))
    return words << (three - (at & three) << three) >> np.int32(24)  # one byte of each word, with its sign


@kernel
def _find_sides(query_bits, view, faces, lanes, light_sides):
    """Write the light's sides of the triangles in some lanes (bits); faces: i32x16."""
    # In: query_bits, view, as in `active_receivers`. Out: light_sides
    of = stack_i32(16)
    store(of, 0, faces)
    while lanes != 0:
        face = get(of, lowest_bit(lanes))
        lanes &= ~bits(faces == np.int32(face))
        side = _light_side(query_bits, view, face)
        put(light_sides, face, side if side != 0 else _NO_SIDE)


@kernel
def _active_one_by_one(query_bits, samples, ids, lanes, counters):
    """`active_receivers`, receiver by receiver; ids: pointer to int32."""
    active = 0
    while lanes != 0:
        lane, i = lanes & -lanes, get(ids, lowest_bit(lanes))
        lanes ^= lane
        active |= lane if _is_active(query_bits, samples, i, counters) else 0
    return active


@kernel
def active_receivers(query_bits, view, samples, receivers, light_sides, counters):
    """Bits of the active ones among 16 receivers; sets the answer bits of samples below a receiver's surface.

    query_bits, view : from `query_bits_of` and `view_of`
    receivers : `SixteenReceivers`
    light_sides : pointer to int8, from `new_light_sides`
    """
    (ids, sides, faces), at = receivers, stack_i32(16)
    valid = bits(sides != np.int32(NOTHING))
    count(counters, RAYS, samples.n_samples * popcount(valid))
    on_face, known = valid & bits(faces >= np.int32(0)), _known_sides(light_sides, faces)
    unknown = on_face & bits(known == np.int32(0))
    if unknown != 0:
        _find_sides(query_bits, view, faces, unknown, light_sides)
        known = _known_sides(light_sides, faces)
    active, below = on_face & bits(known == sides), on_face & bits(known == -sides)
    others = valid & ~(active | below)
    if below | others != 0:
        store(at, 0, ids)
        active |= _active_below_plane(query_bits, view, samples, at, below, counters)
        active |= _active_one_by_one(query_bits, samples, at, others, counters)
    return active


@inlined
def origins_of(query_bits, ids):
    """The positions of 16 receivers, a `Vec` of f32x16."""
    at, p = ids * 3, query_bits.query.origins
    return Vec3(gather(p, at), gather(p, at + 1), gather(p, at + 2))
