"""The receivers' own surfaces against a tile's samples: those below them are blocked before anything is traced."""

import numpy as np

from ..bvh.nodes import middle_and_half
from ..jit import inlined, kernel
from ..query.receivers import FREE
from ..simd import absolute, bits, get, iota16, load16, lowest_bit, maximum, popcount, put, select, splat16, store
from .aside import put_aside
from .asked import place_of
from .counters import BELOW_HORIZON, RAYS, count
from .lighttable import ALL_GROUPS

_F = np.float32
_U = _F(64 * 2.0**-24)
_TINY = _F(1e-37)
PLANES = 8 * 16  # float32 of scratch memory


@kernel
def _gather_planes(asked, y0, x0, valid, planes):
    """Rows of `planes`: a point of each receiver's plane (3), a normal (3), the side seen, what scales its error."""
    corners, lanes = asked.corners, valid
    while lanes != 0:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        at = place_of(asked, y0, x0, lane)
        side, face = np.int64(get(asked.sides, at)), np.int64(get(asked.faces, at))
        nx, ny, nz, size = _F(0.0), _F(0.0), _F(0.0), _F(0.0)
        k = face * 9
        if face >= 0:
            vx, vy, vz = get(corners, k), get(corners, k + 1), get(corners, k + 2)
            px, py, pz = get(corners, k + 3) - vx, get(corners, k + 4) - vy, get(corners, k + 5) - vz
            qx, qy, qz = get(corners, k + 6) - vx, get(corners, k + 7) - vy, get(corners, k + 8) - vz
            nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
            size = abs(px) + abs(py) + abs(pz) + abs(qx) + abs(qy) + abs(qz)
            size *= size
        else:
            k = at * 3
            vx, vy, vz = get(asked.origins, k), get(asked.origins, k + 1), get(asked.origins, k + 2)
            if side != FREE:
                nx, ny, nz = _F(get(asked.normals, k)), _F(get(asked.normals, k + 1)), _F(get(asked.normals, k + 2))
                size = abs(nx) + abs(ny) + abs(nz)
        put(planes, lane, vx)
        put(planes, 16 + lane, vy)
        put(planes, 32 + lane, vz)
        put(planes, 48 + lane, nx)
        put(planes, 64 + lane, ny)
        put(planes, 80 + lane, nz)
        put(planes, 96 + lane, _F(0.0) if side == FREE else _F(side))
        put(planes, 112 + lane, size)


@inlined
def _height(planes, lx, ly, lz):
    """(height of light points over the lanes' planes on the seen side, bound of its error)."""
    ax, ay, az = lx - load16(planes, 0), ly - load16(planes, 16), lz - load16(planes, 32)
    h = load16(planes, 48) * ax + load16(planes, 64) * ay + load16(planes, 80) * az
    reach = maximum(maximum(absolute(ax), absolute(ay)), absolute(az))
    return h * load16(planes, 96), load16(planes, 112) * _U * reach + _TINY * (reach + _F(1.0))


@inlined
def _whole_light(tile, k):
    return middle_and_half(get(tile.groups, k * ALL_GROUPS + 1), get(tile.groups, (3 + k) * ALL_GROUPS + 1))


@kernel
def apply_horizon(asked, y0, x0, valid, tile, planes, aside, counters):
    """Start `dead`: segments to samples that are not above the receiver's own surface are blocked by it.

    What float32 cannot say is put aside.
    """
    store(tile.dead, 0, select(iota16() < splat16(np.int32(asked.count)), splat16(np.int32(0)), splat16(np.int32(-1))))
    count(counters, RAYS, asked.count * popcount(valid))
    _gather_planes(asked, y0, x0, valid, planes)
    sided = bits(load16(planes, 96) != _F(0.0)) & valid
    if sided == 0:
        return
    lx, rx = _whole_light(tile, 0)
    ly, ry = _whole_light(tile, 1)
    lz, rz = _whole_light(tile, 2)
    h, error = _height(planes, splat16(lx), splat16(ly), splat16(lz))
    reach = absolute(load16(planes, 48)) * rx + absolute(load16(planes, 64)) * ry + absolute(load16(planes, 80)) * rz
    spread = rx + ry + rz
    far = reach * _F(1.0001) + error + load16(planes, 112) * (_U * spread)
    crossing = sided & ~bits(h > far)
    if crossing == 0:
        return
    for s in range(asked.count):
        at = s * 48
        h, error = _height(planes, load16(tile.points, at), load16(tile.points, at + 16), load16(tile.points, at + 32))
        below = bits(h < -error) & crossing
        put_aside(aside, np.int64(-1), tile.number << 8 | s << 4, 1, crossing & ~below & ~bits(h > error))
        count(counters, BELOW_HORIZON, popcount(below))
        put(tile.dead, s, below)
