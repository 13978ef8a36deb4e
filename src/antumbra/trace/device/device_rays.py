"""Rays on a device, one by index: those of a ray list, and the segments of a shadow query, made where they are traced.

A shadow query goes to a device as receivers of 16 bytes. Their light samples are computed there, by the functions that
compute them on the CPU, so that both give the same bits.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.exact.filters import UNSURE
from ...kernels.exact.predicate import Ray, ray_along, segment
from ...kernels.jit import formula, inlined, kernel, overload
from ...kernels.parallel import items
from ...kernels.simd import as_i32, f32_at, f64_at, get, i32_at, ptr, put
from ...query.light_samples import patch_at, sample_point
from ...query.receivers import NOTHING
from ...query.shadow_query import Horizon, above_horizon, face_horizon, set_of, three_at
from ...scene.lights import LightPatch

# --- One ray ----------------------------------------------------------------------------------------------------------


CLEAR, BLOCKED, TRACED, AGAIN = 0, 1, 2, -2
"""States of a ray: nothing blocks it; something does; to be traced; to be traced again, since the list was full."""

SIDE = 3  # bits of a receiver's tag that hold its side, plus one; its face is in the others


class DeviceRay(NamedTuple):
    """One ray on a device."""

    ray: Ray
    skip: int  # index of a triangle to ignore, or -1
    state: int  # TRACED; or CLEAR or BLOCKED, if its answer is known
    horizon: bool  # whether it is undecided if the receiver's own surface blocks it


def ray_at(rays, i):
    """In kernels: the `DeviceRay` i of a `RayBuffers` or a `SampleBuffers`."""


# --- Ray lists --------------------------------------------------------------------------------------------------------


class RayBuffers(NamedTuple):
    """A ray list: addresses on the device of arrays in the scene's frame, and numbers."""

    origins: int  # float32, 3 per ray
    ends: int  # float32, 3 per ray: directions, or the targets of segments
    tmin: int  # float64; 0: all rays share it
    tmax: int
    skip: int  # int32; 0: all rays share it
    segments: int  # 1: `ends` are targets, and tmin and tmax are not used
    shared_tmin: float
    shared_tmax: float
    shared_skip: int


@inlined
def listed_point(at, i):
    """Point or direction i of an address of float32, 3 each."""
    p = f32_at(at)
    return get(p, 3 * i), get(p, 3 * i + 1), get(p, 3 * i + 2)


@inlined
def _number(at, shared, i):
    return shared if at == 0 else get(f64_at(at), i)


@inlined
def _is_still(ray):
    return ray.dx == 0.0 and ray.dy == 0.0 and ray.dz == 0.0


@inlined
def _listed_ray(rays, i):
    o, e = listed_point(rays.origins, i), listed_point(rays.ends, i)
    skip = rays.shared_skip if rays.skip == 0 else np.int64(get(i32_at(rays.skip), i))
    if rays.segments != 0:
        ray = segment(o[0], o[1], o[2], e[0], e[1], e[2])
    else:
        tmin, tmax = _number(rays.tmin, rays.shared_tmin, i), _number(rays.tmax, rays.shared_tmax, i)
        ray = ray_along(o[0], o[1], o[2], e[0], e[1], e[2], tmin, tmax)
    return DeviceRay(ray, skip, CLEAR if _is_still(ray) else TRACED, False)


# --- Shadow queries ---------------------------------------------------------------------------------------------------


class DevicePatch(NamedTuple):
    """A `LightPatch` in plain numbers."""

    kind: int
    base: tuple[float, float, float]
    u: tuple[float, float, float]
    v: tuple[float, float, float]
    w: tuple[float, float, float]
    radius: float


def device_patch(light: LightPatch) -> DevicePatch:
    """The `DevicePatch` of a light."""
    base, u, v, w = (_three(vector) for vector in (light.base, light.u, light.v, light.w))
    return DevicePatch(int(light.kind), base, u, v, w, float(light.radius))


def _three(v: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


class SampleBuffers(NamedTuple):
    """A `ShadowQuery`: addresses on the device, and numbers. Ray ``i spp + s`` goes from receiver i to its sample s."""

    receivers: int  # 16 bytes each: x, y, z in float32, and a tag in int32: ``face << 2 | side + 1``
    ids: int  # int32, the receivers' triangles in the tree; 0: they are their faces
    normals: int  # float64, 3 per receiver; 0: no light or surface needs them
    corners: int  # float32, 9 per triangle that faces index
    samples: int  # float64, (16, spp, 3)
    light: DevicePatch
    w: int  # receivers per row
    spp: int


@kernel
def pack_receivers(ticket, origins, faces, sides, out):
    """On the CPU: write receivers (origins, faces, sides) as `SampleBuffers` describes them; out: (n, 4) float32."""
    o, f, s, numbers = ptr(origins), ptr(faces), ptr(sides), ptr(out)
    words = as_i32(numbers)
    for i in items(ticket):
        for k in range(3):
            put(numbers, 4 * i + k, get(o, 3 * i + k))
        put(words, 4 * i + 3, np.int64(get(f, i)) << 2 | np.int64(get(s, i)) + 1)


class DeviceReceiver(NamedTuple):
    """A receiver of a `SampleBuffers`."""

    o: tuple[float, float, float]  # float32
    n: tuple[float, float, float]  # its normal
    side: int
    face: int
    id: int


@inlined
def receiver_at(query, i):
    """The `DeviceReceiver` i of a `SampleBuffers`."""
    numbers, z = f32_at(query.receivers), np.float64(0.0)
    tag = np.int64(get(i32_at(query.receivers), 4 * i + 3))
    o = get(numbers, 4 * i), get(numbers, 4 * i + 1), get(numbers, 4 * i + 2)
    n = (z, z, z) if query.normals == 0 else three_at(f64_at(query.normals), i)
    face = tag >> 2
    return DeviceReceiver(o, n, (tag & SIDE) - 1, face, face if query.ids == 0 else np.int64(get(i32_at(query.ids), i)))


@inlined
def _horizon_of(query, r):
    if r.face >= 0:
        return face_horizon(r.side, r.face, f32_at(query.corners))
    f = np.float64
    return Horizon(r.side, r.face, f(r.o[0]), f(r.o[1]), f(r.o[2]), r.n[0], r.n[1], r.n[2], f(0.0))


@inlined
def sample_state(query, r, i, s):
    """(sample s of receiver i, its state, whether the receiver's own surface leaves it undecided); r: the receiver."""
    samples, k = f64_at(query.samples), (set_of(query, i) * query.spp + s) * 3
    patch = patch_at(query.light, r.o[0], r.o[1], r.o[2], r.n[0], r.n[1], r.n[2])
    l = sample_point(patch, get(samples, k), get(samples, k + 1), get(samples, k + 2))
    if r.side == NOTHING:
        return l, CLEAR, False
    above = above_horizon(_horizon_of(query, r), l[0], l[1], l[2])
    still = l[0] == r.o[0] and l[1] == r.o[1] and l[2] == r.o[2]
    return l, BLOCKED if above == 0 else CLEAR if still else TRACED, above == UNSURE


@inlined
def _sampled_ray(query, at):
    i, s = at // query.spp, at % query.spp
    r = receiver_at(query, i)
    l, state, undecided = sample_state(query, r, i, s)
    return DeviceRay(segment(r.o[0], r.o[1], r.o[2], l[0], l[1], l[2]), r.id, state, undecided)


# --- Shadow queries by screen tiles -----------------------------------------------------------------------------------


class TileSegments(NamedTuple):
    """The segments of a `ShadowQuery` to some of its samples, those of one screen tile after those of another.

    A tile has ``rows * pixels`` receivers, row by row, each with `count` segments. Some may lie outside of the query.
    """

    query: SampleBuffers
    tiles: int  # int32: numbers of the tiles, row by row of the screen
    blocked: int  # int32: bits of the segments that are known to be blocked, in whole words per receiver
    pixels: int  # side of a tile
    rows: int  # rows of receivers in a tile: `pixels`, or as many as the query has
    across: int  # tiles per row of the screen
    h: int  # rows of receivers
    first: int  # the first sample
    count: int  # type: ignore[assignment]  # number of samples; hides tuple.count
    fresh: int  # 1: no segment has been tested yet; 0: what receivers' own surfaces block is known


class TilePlace(NamedTuple):
    """Where a segment of `TileSegments` is."""

    at: int  # place of its tile in the list
    row: int  # in the tile
    column: int
    sample: int  # counted from `TileSegments.first`


@formula
def place_in_tiles(segments, k):
    """The `TilePlace` of segment k."""
    receiver = k // segments.count
    row = receiver // segments.pixels
    return TilePlace(row // segments.rows, row % segments.rows, receiver % segments.pixels, k % segments.count)


@formula
def pixel_in_tile(segments, tile, place):
    """(y, x) of the receiver at a place in a tile; it may lie outside of the query."""
    pixels = segments.pixels
    return tile // segments.across * pixels + place.row, tile % segments.across * pixels + place.column


@inlined
def tile_receiver(segments, place):
    """The receiver at a place; -1: it lies outside of the query."""
    y, x = pixel_in_tile(segments, np.int64(get(i32_at(segments.tiles), place.at)), place)
    return y * segments.query.w + x if y < segments.h and x < segments.query.w else np.int64(-1)


@formula
def words_per_receiver(segments):
    """The number of int32 of a receiver's bits."""
    return (segments.count + 31) >> 5


@inlined
def _is_known(segments, receiver, s):
    word = get(i32_at(segments.blocked), receiver * words_per_receiver(segments) + (s >> 5))
    return word >> np.int32(s & 31) & np.int32(1) != 0


@inlined
def _tiled_ray(segments, k):
    """The `DeviceRay` of segment k: CLEAR where there is none, and where it is known to be blocked."""
    place = place_in_tiles(segments, k)
    receiver = tile_receiver(segments, place)
    i = receiver if receiver >= 0 else np.int64(0)
    r = _sampled_ray(segments.query, i * segments.query.spp + segments.first + place.sample)
    is_open = receiver >= 0 and not _is_known(segments, i, place.sample)
    return DeviceRay(r.ray, r.skip, r.state if is_open else CLEAR, r.horizon and is_open and segments.fresh != 0)


@overload(ray_at)
def _ray_at(rays, i):
    if rays.instance_class is RayBuffers:
        return lambda rays, i: _listed_ray(rays, i)
    if rays.instance_class is SampleBuffers:
        return lambda rays, i: _sampled_ray(rays, i)
    if rays.instance_class is TileSegments:
        return lambda rays, i: _tiled_ray(rays, i)
    return None
