"""The top tree, over the chunks. It stays in memory."""

from typing import NamedTuple

import numpy as np

from ..bvh import binned_sah
from ..bvh.links import CHILDREN, bvh_leaf, bvh_link
from ..bvh.nodes import EMPTY
from ..bvh.reinsertion import reinsert


class Top(NamedTuple):
    """A tree whose leaves are chunks. Nodes are as in `Bvh`, but a link < 0 is ``~(8 * chunk)``, or EMPTY."""

    nodes: np.ndarray  # (m, 16) float32, 64-byte aligned
    links: np.ndarray  # (m, 16) int32, the same memory


def top_tree(boxes: np.ndarray, threads: int) -> Top:
    """Build the tree over boxes of chunks, (k, 6) float32: binned SAH, then insertion-based optimisation
    [Bittner et al. 2013].

    Builders take triangles. So each box becomes a triangle without area that has the same bounds.
    """
    lower, upper = boxes[:, :3], boxes[:, 3:]
    bvh = binned_sah.build(np.stack([lower, upper, lower], axis=1), threads, max_leaf=1)
    bvh = reinsert(bvh, threads)
    ends = bvh.links[:, CHILDREN]
    leaf = (ends < 0) & (ends != EMPTY)
    ends[leaf] = bvh_link(bvh.prim_ids[bvh_leaf(ends[leaf]).first], 1)
    return Top(bvh.nodes, bvh.links)
