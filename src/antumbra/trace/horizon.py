"""Horizon tests: a receiver's own surface blocks the samples below it before tracing.

Planes are tested in float32 against the bounds of the whole light first, then against each sample. Undecided tests are
deferred.
"""

from typing import NamedTuple

import numpy as np

from ..bvh.nodes import middle_and_half
from ..kernels.jit import inlined, kernel
from ..kernels.simd import (
    absolute,
    bits,
    get,
    iota16,
    load16,
    lowest_bit,
    maximum,
    popcount,
    put,
    select,
    splat16,
    store,
)
from ..kernels.vec3 import Vec3, get3
from ..query.receivers import FREE
from .counters import BELOW_HORIZON, RAYS, count
from .light_table import ALL_GROUPS
from .tile import place_of
from .triangle_tests import defer, triangle_in

_F = np.float32
_U = _F(64 * 2.0**-24)
_TINY = _F(1e-37)
PLANES = 8 * 16  # float32 of scratch memory


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


@inlined
def _put_plane(planes, lane, p):
    """Write a plane to a lane of the rows."""
    for k in range(3):
        put(planes, 16 * k + lane, p.point[k])
        put(planes, 48 + 16 * k + lane, p.normal[k])
    put(planes, 112 + lane, p.size)


@inlined
def _put_everywhere(planes, p):
    """Write a plane to all lanes."""
    for k in range(3):
        store(planes, 16 * k, splat16(p.point[k]))
        store(planes, 48 + 16 * k, splat16(p.normal[k]))
    store(planes, 112, splat16(p.size))


@kernel
def _gather_planes(chunk, y0, x0, valid, tile, planes):
    """Write the rows of `planes`: a point on each receiver's plane (3), normal (3), visible side, and `size`."""
    first = get(tile.faces, lowest_bit(valid))
    together = first >= 0 and bits(load16(tile.faces, 0) == first) & valid == valid
    if together:
        face = get(chunk.query.faces, place_of(chunk, y0, x0, lowest_bit(valid)))
        _put_everywhere(planes, _plane_of_face(chunk.query.corners, face))
    lanes = valid
    while lanes != 0:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        at = place_of(chunk, y0, x0, lane)
        side, face = get(chunk.query.sides, at), get(chunk.query.faces, at)
        put(planes, 96 + lane, _F(0.0) if side == FREE else _F(side))
        if not together:
            plane = _plane_of_face(chunk.query.corners, face) if face >= 0 else _plane_at(chunk, at, side == FREE)
            _put_plane(planes, lane, plane)


@inlined
def _height(planes, lx, ly, lz):
    """(height of light points above the lanes' planes on the visible side, error bound of the height)."""
    ax, ay, az = lx - load16(planes, 0), ly - load16(planes, 16), lz - load16(planes, 32)
    h = load16(planes, 48) * ax + load16(planes, 64) * ay + load16(planes, 80) * az
    reach = maximum(maximum(absolute(ax), absolute(ay)), absolute(az))
    error = load16(planes, 112) * reach * _U  # in this order, the bound is infinite wherever the height could overflow
    return h * load16(planes, 96), error + _TINY * (reach + _F(1.0))


@inlined
def _whole_light(tile, k):
    return middle_and_half(get(tile.groups, k * ALL_GROUPS + 1), get(tile.groups, (3 + k) * ALL_GROUPS + 1))


@inlined
def _by_whole_light(tile, planes, sided):
    """(receivers in `sided` with all samples surely below their plane, those to be tested sample by sample); bits."""
    lx, rx = _whole_light(tile, 0)
    ly, ry = _whole_light(tile, 1)
    lz, rz = _whole_light(tile, 2)
    h, error = _height(planes, splat16(lx), splat16(ly), splat16(lz))
    reach = absolute(load16(planes, 48)) * rx + absolute(load16(planes, 64)) * ry + absolute(load16(planes, 80)) * rz
    far = reach * _F(1.0001) + error + load16(planes, 112) * (_U * (rx + ry + rz))
    under = bits(h < -far) & sided
    return under, sided & ~under & ~bits(h > far)


@kernel
def apply_horizon(chunk, y0, x0, valid, tile, planes, deferred, counters):
    """Initialise `dead`: a receiver's own surface blocks the segments to samples that are not above it.

    Defer the tests that float32 cannot decide.
    """
    count(counters, RAYS, chunk.n_samples * popcount(valid))
    _gather_planes(chunk, y0, x0, valid, tile, planes)
    under, crossing = _by_whole_light(tile, planes, bits(load16(planes, 96) != _F(0.0)) & valid)
    has_sample = iota16() < splat16(np.int32(chunk.n_samples))
    store(tile.dead, 0, select(has_sample, splat16(np.int32(under)), splat16(np.int32(-1))))
    count(counters, BELOW_HORIZON, chunk.n_samples * popcount(under))
    if crossing == 0:
        return
    for s in range(chunk.n_samples):
        at = s * 48
        h, error = _height(planes, load16(tile.points, at), load16(tile.points, at + 16), load16(tile.points, at + 32))
        below = bits(h < -error) & crossing
        defer(deferred, -1, tile.number << 8 | s << 4, 1, crossing & ~below & ~bits(h > error))
        count(counters, BELOW_HORIZON, popcount(below))
        put(tile.dead, s, below | under)
