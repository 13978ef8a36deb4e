"""Horizon tests: a receiver's own surface blocks the samples below it before tracing.

Planes are tested in float32 against the bounds of the whole light first, then against each sample. Undecided tests are
deferred.
"""

from typing import NamedTuple

import numpy as np

from ..bvh.nodes import middle_and_half
from ..kernels.jit import F32x16, inlined, kernel
from ..kernels.simd import (
    absolute,
    bits,
    get,
    iota16,
    load16,
    lowest_bit,
    mask_from_bits16,
    popcount,
    put,
    select,
    splat16,
    store,
)
from ..kernels.vec3 import Vec3, get3, largest, rows, select3, splats, subtract3
from .counters import BELOW_HORIZON, RAYS, count
from .light_table import ALL_GROUPS
from .tile import place_of
from .triangle_tests import defer, triangle_in

_F = np.float32
_U = _F(64 * 2.0**-24)
_TINY = _F(1e-37)


class SurfacePlane(NamedTuple):
    """The plane of a receiver's own surface; float32."""

    point: Vec3
    normal: Vec3
    size: float  # scale of the error of a height above the plane


@inlined
def _plane_of_face(corners, face):
    """The `SurfacePlane` of a triangle."""
    v, p, q, n, _ = triangle_in(corners, face)
    size = abs(p.x) + abs(p.y) + abs(p.z) + abs(q.x) + abs(q.y) + abs(q.z)
    return SurfacePlane(v, n, size * size)


@inlined
def _plane_at(chunk, at, is_free):
    """The `SurfacePlane` of a receiver without a triangle, perpendicular to its normal; zero normal if it is free."""
    n = Vec3(_F(0.0), _F(0.0), _F(0.0))
    if not is_free:
        x, y, z = get3(chunk.query.normals, 3 * at, 1)
        n = Vec3(_F(x), _F(y), _F(z))
    return SurfacePlane(get3(chunk.query.origins, 3 * at, 1), n, abs(n.x) + abs(n.y) + abs(n.z))


class SurfacePlanes(NamedTuple):
    """The planes of 16 receivers; f32x16."""

    point: Vec3
    normal: Vec3
    size: F32x16


@inlined
def _everywhere(p):
    """`SurfacePlanes` with one plane in all lanes."""
    return SurfacePlanes(splats(p.point), splats(p.normal), splat16(p.size))


@inlined
def _with_plane(planes, lanes, p):
    """`SurfacePlanes` with another plane in some lanes (bits)."""
    there = mask_from_bits16(lanes)
    return SurfacePlanes(
        select3(there, splats(p.point), planes.point),
        select3(there, splats(p.normal), planes.normal),
        select(there, splat16(p.size), planes.size),
    )


@inlined
def _plane_of_receiver(chunk, y0, x0, lane, is_free):
    """The `SurfacePlane` of the receiver in a lane."""
    at = place_of(chunk, y0, x0, lane)
    face = get(chunk.query.faces, at)
    return _plane_of_face(chunk.query.corners, face) if face >= 0 else _plane_at(chunk, at, is_free)


@inlined
def _planes_of_receivers(chunk, y0, x0, valid, tile):
    """The `SurfacePlanes` of the `valid` receivers (bits). Each triangle's plane is computed once."""
    first, faces, sided = lowest_bit(valid), load16(tile.faces, 0), bits(load16(tile.sides, 0) != _F(0.0))
    planes = _everywhere(_plane_of_receiver(chunk, y0, x0, first, sided >> first & 1 == 0))
    face = get(tile.faces, first)
    remaining = valid & ~(bits(faces == face) if face >= 0 else 1 << first)
    while remaining != 0:
        lane = lowest_bit(remaining)
        face = get(tile.faces, lane)
        lanes = bits(faces == face) if face >= 0 else 1 << lane
        remaining &= ~lanes
        planes = _with_plane(planes, lanes, _plane_of_receiver(chunk, y0, x0, lane, sided >> lane & 1 == 0))
    return planes


@inlined
def _height(planes, sides, l):
    """(height of light points l above the lanes' planes on the visible side, error bound of the height)."""
    a = subtract3(l, planes.point)
    h = planes.normal.x * a.x + planes.normal.y * a.y + planes.normal.z * a.z
    reach = largest(a)
    error = planes.size * reach * _U  # in this order, the bound is infinite wherever the height could overflow
    return h * sides, error + _TINY * (reach + _F(1.0))


@inlined
def _whole_light(tile, k):
    return middle_and_half(get(tile.groups, k * ALL_GROUPS + 1), get(tile.groups, (3 + k) * ALL_GROUPS + 1))


@inlined
def _by_whole_light(tile, planes, sides, sided):
    """(receivers in `sided` with all samples surely below their plane, those to be tested sample by sample); bits."""
    lx, rx = _whole_light(tile, 0)
    ly, ry = _whole_light(tile, 1)
    lz, rz = _whole_light(tile, 2)
    h, error = _height(planes, sides, Vec3(splat16(lx), splat16(ly), splat16(lz)))
    n = planes.normal
    reach = absolute(n.x) * rx + absolute(n.y) * ry + absolute(n.z) * rz
    far = reach * _F(1.0001) + error + planes.size * (_U * (rx + ry + rz))
    under = bits(h < -far) & sided
    return under, sided & ~under & ~bits(h > far)


@kernel
def apply_horizon(chunk, y0, x0, valid, tile, deferred, counters):
    """Initialise `dead`: a receiver's own surface blocks the segments to samples that are not above it.

    Defer the tests that float32 cannot decide.
    """
    count(counters, RAYS, chunk.n_samples * popcount(valid))
    planes, sides = _planes_of_receivers(chunk, y0, x0, valid, tile), load16(tile.sides, 0)
    under, crossing = _by_whole_light(tile, planes, sides, bits(sides != _F(0.0)) & valid)
    has_sample = iota16() < splat16(np.int32(chunk.n_samples))
    store(tile.dead, 0, select(has_sample, splat16(np.int32(under)), splat16(np.int32(-1))))
    count(counters, BELOW_HORIZON, chunk.n_samples * popcount(under))
    if crossing == 0:
        return
    for s in range(chunk.n_samples):
        h, error = _height(planes, sides, rows(tile.points, s * 48, 16))
        below = bits(h < -error) & crossing
        defer(deferred, -1, tile.number << 8 | s << 4, 1, crossing & ~below & ~bits(h > error))
        count(counters, BELOW_HORIZON, popcount(below))
        put(tile.dead, s, below | under)
