"""The wide BVH: nodes of eight children, leaves of up to eight triangles. One ray tests eight of either at once.

`widen` makes it from a binary `Bvh` of any builder.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import F32Ptr, I32Ptr, inlined
from ..kernels.simd import ptr
from .nodes import Bvh, Tree, tree_of

WIDTH = 8
NODE_WORDS = 8 * WIDTH
LINKS = 6 * WIDTH  # word of a node's first link
GROUP_WORDS = 10 * WIDTH
NO_CHILD = np.int32(-1)  # link of a missing child: a leaf without triangles


class WideBvh(NamedTuple):
    """A wide BVH, with the `Bvh` from which it was made. Node 0 is the root and always exists.

    A node is four 64-byte lines: planes of eight boxes, one 8-wide register each, and the links of the children::

        0..7    lower x      8..15   upper x
        16..23  lower y      24..31  upper y
        32..39  lower z      40..47  upper z
        48..55  links (int32 bits)
        56..63  not used (zero)

    Children are in the lanes from 0 on. Any-hit queries visit them from the last to the first, the order of least
    expected cost to block a ray (`order.soonest_last`).

    A link >= 0 is an inner node. A link < 0 is a leaf with a count from 1 to 8: `links.wide_leaf`. A missing
    child has the link `NO_CHILD`, a leaf of no triangles, and a box that no ray enters.

    A group is five lines, ten 8-wide registers with a lane for each of eight triangles. The registers are the corner v0
    (x, y, z), the edges v1 - v0 and v2 - v0, and the largest magnitude of the edges' components. The edges are rounded
    to float32. Lanes from `count` on are zero.
    """

    nodes: np.ndarray  # (n_nodes, 64) float32, 64-byte aligned
    links: np.ndarray  # (n_nodes, 64) int32, the same memory
    groups: np.ndarray  # (n_groups, 80) float32, 64-byte aligned; at least one
    slots: np.ndarray  # (n_groups, 8) int32: lane -> slot of the binary BVH, -1 where there is no triangle
    reach: np.float32  # largest magnitude of a coordinate of the root's boxes; 0 without triangles
    bvh: Bvh  # the binary BVH


class WideTree(NamedTuple):
    """Pointers to the arrays of a `WideBvh`, for hot kernels."""

    nodes: F32Ptr  # float32 *, 64 a node
    links: I32Ptr  # int32 *, the same memory
    groups: F32Ptr  # float32 *, 80 a group
    slots: I32Ptr  # int32 *, 8 a group
    prim_ids: I32Ptr  # int32 *, slot -> triangle index
    corners: F32Ptr  # float32 *, 9 a slot
    reach: np.float32
    binary: Tree  # of the binary BVH


@inlined
def wide_tree_of(wide):
    """Pointers to the arrays of a `WideBvh`, which must outlive them."""
    return WideTree(
        ptr(wide.nodes), ptr(wide.links), ptr(wide.groups), ptr(wide.slots), ptr(wide.bvh.prim_ids),
        ptr(wide.bvh.corners), wide.reach, tree_of(wide.bvh),
    )  # fmt: skip
