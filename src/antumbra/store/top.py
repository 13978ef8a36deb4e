"""The tree over the chunks, which stays in memory."""

from typing import NamedTuple

import numpy as np

from ..bvh import binned_sah
from ..bvh.nodes import EMPTY
from ..bvh.reinsertion import reinsert


class Top(NamedTuple):
    """A tree whose leaves are chunks: nodes as in `Bvh`, but a link < 0 is ``~(8 * chunk)``, or EMPTY."""

    nodes: np.ndarray  # (m, 16) float32, 64-byte aligned
    links: np.ndarray  # (m, 16) int32, the same memory


def top_tree(boxes: np.ndarray, threads: int) -> Top:
    """The tree over boxes of chunks, (k, 6) float32: by the SAH, then by insertion-based optimisation
    [Bittner et al. 2013].

    Builders take triangles, so a box becomes the triangle without area that has just these bounds.
    """
    lower, upper = boxes[:, :3], boxes[:, 3:]
    bvh = binned_sah.build(np.stack([lower, upper, lower], axis=1), threads, max_leaf=1)
    bvh = reinsert(bvh, threads)
    ends = bvh.links[:, 12:14]
    leaf = (ends < 0) & (ends != EMPTY)
    ends[leaf] = ~(8 * bvh.prim_ids[~ends[leaf] >> 3])
    return Top(bvh.nodes, bvh.links)
