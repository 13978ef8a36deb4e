"""Rays to one point, projected on a face of the cube around it, and their tests by a triangle's shadow planes.

A receiver is (u, v, q) on its face (`box_nodes`): its ray is the point (u, v), and q = 1 / depth gives its end. The
planes that decide whether a triangle may block the rays of a node, or blocks them all, decide the same for one ray: on
the positive side of all inner planes it is blocked, on the negative side of an outer plane it is not. This takes 18
products for 16 rays, where edge functions take 50. Rays within the planes' margins for rounding are decided exactly. A
receiver on the triangle itself is on the negative side of its own inner plane, and is left out of the exact tests.
"""

import numpy as np

from ...kernels.exact.predicate import segment
from ...kernels.jit import inlined, kernel
from ...kernels.simd import atomic_or, bits, fma, get, load16, lowest_bit, ptr_at
from ...kernels.vec3 import rows
from ...query.shadow_query import ShadowQuery
from ...trace.counters import TRIANGLE_TESTS, count
from ...trace.rays.ray_traversal import settle
from .box_nodes import height
from .ray_leaves import BLOCK_BOX, PAD, Blocks, Empty, block_of, receiver_at
from .shadow_planes import COVERS, INNER, OUTER, TRIANGLE, integer, number16

_F = np.float32


def new_projected_blocks(n: int, query: ShadowQuery, empty: Empty) -> Blocks:
    """Allocate n blocks of 4 x 4 pixels for projected rays."""
    (h, w), points, own = query.sides.shape, empty(48 * n + PAD, np.float32), empty(16 * n, np.int32)
    points[-PAD:] = 0
    boxes = empty(BLOCK_BOX * n, np.float32)
    return Blocks(n, 16, query.origins.reshape(-1), np.zeros(PAD, np.int32), own, points, w, h, boxes)


@inlined
def _edge(row, at, u, v):
    """f32x16: `height` for a plane through the apex."""
    return fma(v, number16(row, at + 1), fma(u, number16(row, at), number16(row, at + 2)))


@inlined
def meet_projected(points, row):
    """(bits of the rays that the triangle of a row surely blocks, bits of those that are undecided)."""
    (u, v, q), zero = rows(points, 0, 16), _F(0.0)
    outside = (_edge(row, OUTER, u, v) < zero) | (_edge(row, OUTER + 4, u, v) < zero)
    outside = outside | (_edge(row, OUTER + 8, u, v) < zero) | (height(row, OUTER + 12, u, v, q) < zero)
    if integer(row, COVERS) == 0:
        return np.int64(0), bits(outside) ^ 0xFFFF
    inside = (_edge(row, INNER, u, v) > zero) & (_edge(row, INNER + 4, u, v) > zero)
    inside = inside & (_edge(row, INNER + 8, u, v) > zero) & (height(row, INNER + 12, u, v, q) > zero)
    return bits(inside), bits(outside | inside) ^ 0xFFFF


@kernel
def _decide(leaves, block, soup, slot, facing, undecided, counters):
    """Bits of the `undecided` rays of a block that the triangle in a slot of the soup blocks, exactly."""
    # In: leaves (`LeafRays`), facing, as in `block_projected`
    blocked = 0
    undecided &= ~bits(load16(leaves.own, 16 * block) == get(soup.ids, slot))
    while undecided != 0:
        lane = lowest_bit(undecided)
        undecided &= undecided - 1
        at = 3 * receiver_at(leaves, block, lane)
        x, y, z = get(leaves.origins, at), get(leaves.origins, at + 1), get(leaves.origins, at + 2)
        ray = segment(x, y, z, get(leaves.ends, 0), get(leaves.ends, 16), get(leaves.ends, 32))
        side = settle(ray, soup.corners, slot, counters)
        if side != 0 and side != facing:
            blocked |= 1 << lane
    return blocked


@kernel
def block_projected(leaves, leaf, row, soup, facing, counters):
    """Mark the rays of a leaf that a triangle blocks as dead; True if all of them are dead now.

    leaves, soup : rays and triangles, as pointers
    row : pointer to the triangle's first number, as `box_nodes.write_point_rows` writes it
    facing : triangles with this sign of d . n do not block
    """
    live, block = ~np.int64(get(leaves.dead, leaf)) & 0xFFFF, block_of(leaves, leaf)
    if live == 0:
        return True
    count(counters, TRIANGLE_TESTS, 1)
    blocked, undecided = meet_projected(ptr_at(leaves.points, 48 * block), row)
    blocked &= live
    undecided &= live
    if undecided != 0:
        blocked |= _decide(leaves, block, soup, np.int64(integer(row, TRIANGLE)), facing, undecided, counters)
    if blocked != 0:
        atomic_or(leaves.dead, leaf, blocked)
    return live == blocked
