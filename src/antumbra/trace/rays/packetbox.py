"""A packet of coherent rays against boxes: all rays at once by interval arithmetic, or each of sixteen rays.

Ray i meets the plane x = c at t = (c - x0) / d_i + (x0 - o_i) / d_i, for any x0. Over the packet, 1 / d_i and
(x0 - o_i) / d_i are intervals. Interval arithmetic bounds the t at which any ray may enter and leave each of eight
boxes [Boulos et al. 2006]. The second interval is short where all rays are close to x0. So x0 is the first ray's
origin or end.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.wide import WIDTH
from ...kernels.jit import inlined
from ...kernels.simd import (
    absolute,
    bits,
    broadcast16,
    extract,
    fma,
    get,
    load8,
    load16,
    maximum,
    minimum,
    reduce_max,
    reduce_min,
    splat8,
    splat16,
)
from .rayblock import BLOCK_WORDS, DX, FAR, INVERSE, LANES, LARGE, LIMIT, NEAR, OX, TMIN, first_block, rays_of_block

_PAD = np.float32(2.0**-19)  # moves planes outwards as `rayblock.prepare` does, for the roundings of intervals
_INF = np.float32(np.inf)


class Focus(NamedTuple):
    """The point x0 of a packet; scalars."""

    x: np.float32
    y: np.float32
    z: np.float32
    size: np.float32  # largest magnitude of a coordinate of the point and of the origins


class PacketAxis(NamedTuple):
    """A packet's intervals along one axis; scalars."""

    origin: np.float32  # coordinate of x0
    low: np.float32  # least inverse; 0 if the inverses differ in sign, and then the axis does not restrict t
    high: np.float32  # greatest inverse; 0 in the same case
    near: np.float32  # least offset of a plane through which rays enter
    far: np.float32  # greatest offset of a plane through which rays leave
    word: int  # word in a node of the planes through which rays enter


class Packet(NamedTuple):
    """The intervals of a packet."""

    x: PacketAxis
    y: PacketAxis
    z: PacketAxis
    tmin: np.float32  # least tmin of the rays
    mixed: bool  # along some axis, rays go both ways


@inlined
def _end(rows, at, k):
    """Coordinate k of the ends of the rays of the block at word `at`."""
    return fma(load16(rows, DX + LANES * k + at), load16(rows, LIMIT + at), load16(rows, OX + LANES * k + at))


@inlined
def _focus_of(rows, alive):
    """The `Focus` of the blocks that hold the rays in `alive` (bits): the first origin, or else the first end.

    It is the end where ends are closer together than origins are, and no quotient of it can overflow.
    """
    first = first_block(alive) * BLOCK_WORDS
    starts, ends, sizes = splat16(np.float32(0.0)), splat16(np.float32(0.0)), splat16(np.float32(0.0))
    x, y, z = get(rows, first + OX), get(rows, first + OX + LANES), get(rows, first + OX + 2 * LANES)
    ex, ey, ez = extract(_end(rows, first, 0), 0), extract(_end(rows, first, 1), 0), extract(_end(rows, first, 2), 0)
    o, e = (x, y, z), (ex, ey, ez)
    while alive:
        j = first_block(alive)
        alive &= ~rays_of_block(j)
        for k in range(3):
            start = load16(rows, OX + LANES * k + j * BLOCK_WORDS)
            sizes, starts = maximum(sizes, absolute(start)), maximum(starts, absolute(start - o[k]))
            ends = maximum(ends, absolute(_end(rows, j * BLOCK_WORDS, k) - e[k]))
    size, end = reduce_max(sizes), max(max(abs(ex), abs(ey)), abs(ez))
    if end < LARGE and reduce_max(ends) < reduce_max(starts):  # false too for rays without end
        return Focus(ex, ey, ez, max(size, end))
    return Focus(x, y, z, size)


@inlined
def _axis(rows, alive, k, origin, reach):
    """The `PacketAxis` k of a packet whose coordinates, with the tree's and `origin`, are at most `reach`."""
    lows, highs, nears, fars = splat16(_INF), splat16(-_INF), splat16(_INF), splat16(-_INF)
    while alive:
        j = first_block(alive)
        alive &= ~rays_of_block(j)
        b = j * BLOCK_WORDS + LANES * k
        inverse = load16(rows, INVERSE + b)
        offset = (splat16(origin) - load16(rows, OX + b)) * inverse
        lows, highs = minimum(lows, inverse), maximum(highs, inverse)
        nears, fars = minimum(nears, offset), maximum(fars, offset)
    low, high = reduce_min(lows), reduce_max(highs)
    if low < 0.0 and high > 0.0:  # the axis does not restrict t
        zero = np.float32(0.0)
        return PacketAxis(origin, zero, zero, -_INF, _INF, np.int64(2 * WIDTH * k))
    grow = _PAD * reach * (-low if low < 0 else high)
    word = np.int64(2 * WIDTH * k) + (np.int64(WIDTH) if low < 0 else np.int64(0))
    return PacketAxis(origin, low, high, reduce_min(nears) - grow, reduce_max(fars) + grow, word)


@inlined
def packet_of(tree, rows, alive):
    """(`Packet`, greatest limit) of the blocks that hold the rays in `alive` (bits), of several prepared blocks."""
    tmins, limits, left = splat16(_INF), splat16(-_INF), alive
    while left:
        j = first_block(left)
        left &= ~rays_of_block(j)
        b = j * BLOCK_WORDS
        tmins, limits = minimum(tmins, load16(rows, TMIN + b)), maximum(limits, load16(rows, LIMIT + b))
    f = _focus_of(rows, alive)
    reach = max(f.size, np.float32(tree.reach))
    x, y, z = _axis(rows, alive, 0, f.x, reach), _axis(rows, alive, 1, f.y, reach), _axis(rows, alive, 2, f.z, reach)
    mixed = x.high * x.low <= 0.0 or y.high * y.low <= 0.0 or z.high * z.low <= 0.0
    return Packet(x, y, z, reduce_min(tmins), mixed), reduce_max(limits)


@inlined
def _times(nodes, at, origin, a):
    """(least, greatest) t at which rays of the packet pass eight planes, the first one at word `at`."""
    planes = load8(nodes, at) - origin
    p, q = planes * a.low, planes * a.high
    return minimum(p, q) + a.near, maximum(p, q) + a.far


@inlined
def enter_any(nodes, at, packet, limit):
    """Test a node's eight boxes for the rays of a packet and t before `limit`.

    Return a mask of the boxes that any ray may enter, one of boxes that all rays enter as long as they last, and a
    vector of lower bounds of entry t.
    """
    x, y, z, tmin, _ = packet
    near_x, x_in = _times(nodes, at + x.word, x.origin, x)
    near_y, y_in = _times(nodes, at + y.word, y.origin, y)
    near_z, z_in = _times(nodes, at + z.word, z.origin, z)
    x_out, far_x = _times(nodes, at + (x.word ^ WIDTH), x.origin, x)
    y_out, far_y = _times(nodes, at + (y.word ^ WIDTH), y.origin, y)
    z_out, far_z = _times(nodes, at + (z.word ^ WIDTH), z.origin, z)
    near = maximum(maximum(near_x, near_y), maximum(near_z, splat8(tmin)))
    far = minimum(minimum(far_x, far_y), minimum(far_z, splat8(limit)))
    last_in = maximum(maximum(x_in, y_in), maximum(z_in, splat8(tmin)))
    first_out = minimum(minimum(x_out, y_out), minimum(z_out, splat8(limit)))
    return near <= far, last_in <= first_out, near


@inlined
def enter_each(nodes, box, rows):
    """Bits of the rays of a block that enter a box before their limits; box: the word of its first plane.

    All rays enter a missing child, which is a leaf without triangles.
    """
    near, far = load16(rows, TMIN), load16(rows, LIMIT)
    for k in range(3):
        inverse = load16(rows, INVERSE + LANES * k)
        a = broadcast16(nodes, box + 2 * WIDTH * k) * inverse
        b = broadcast16(nodes, box + 2 * WIDTH * k + WIDTH) * inverse
        near = maximum(near, minimum(a, b) + load16(rows, NEAR + LANES * k))
        far = minimum(far, maximum(a, b) + load16(rows, FAR + LANES * k))
    return bits(near <= far)


@inlined
def enter_alike(nodes, box, rows, packet):
    """`enter_each` for a packet whose rays agree, along each axis, which of two planes is the near one."""
    if packet.mixed:
        return enter_each(nodes, box, rows)
    r, (x, y, z) = rows, (box + packet.x.word, box + packet.y.word, box + packet.z.word)
    ix, iy, iz = load16(r, INVERSE), load16(r, INVERSE + LANES), load16(r, INVERSE + 2 * LANES)
    near_x = fma(broadcast16(nodes, x), ix, load16(r, NEAR))
    near_y = fma(broadcast16(nodes, y), iy, load16(r, NEAR + LANES))
    near_z = fma(broadcast16(nodes, z), iz, load16(r, NEAR + 2 * LANES))
    far_x = fma(broadcast16(nodes, x ^ WIDTH), ix, load16(r, FAR))
    far_y = fma(broadcast16(nodes, y ^ WIDTH), iy, load16(r, FAR + LANES))
    far_z = fma(broadcast16(nodes, z ^ WIDTH), iz, load16(r, FAR + 2 * LANES))
    near = maximum(maximum(near_x, near_y), maximum(near_z, load16(r, TMIN)))
    far = minimum(minimum(far_x, far_y), minimum(far_z, load16(r, LIMIT)))
    return bits(near <= far)
