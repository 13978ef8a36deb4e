"""Which child comes first: that in which a ray is the likelier blocked.

Rays that ask for any hit end at the first one, so a good order saves what comes after it. Here it is fixed when the
tree is made, and costs nothing when it is walked [Ize and Hansen 2011]. Of the lines that meet a convex body with the
surface S, triangles with the area A inside it are met 2 A / S times on average; if they lie at random, 1 - exp(-2 A /
S) of the lines meet one. A node's own probability follows from its children's, and those are entered in proportion to
their surfaces.
"""

import numpy as np

from ..jit import inlined, kernel
from ..simd import get, ptr, put
from .nodes import parents_first


@inlined
def _surface(nodes, at, other):
    """Half the surface of the box whose lower x is word `at`, or of its union with the one at `other`."""
    x = max(get(nodes, at + 2), get(nodes, other + 2)) - min(get(nodes, at), get(nodes, other))
    y = max(get(nodes, at + 6), get(nodes, other + 6)) - min(get(nodes, at + 4), get(nodes, other + 4))
    z = max(get(nodes, at + 10), get(nodes, other + 10)) - min(get(nodes, at + 8), get(nodes, other + 8))
    return np.float64(x) * y + np.float64(y) * z + np.float64(z) * x


@inlined
def _swap(words, node):
    """Exchange the two children of a node."""
    for k in range(0, 14, 2):
        left, right = get(words, node * 16 + k), get(words, node * 16 + k + 1)
        put(words, node * 16 + k, right)
        put(words, node * 16 + k + 1, left)


@inlined
def _blocked(link, surface, areas, inner):
    """The share of the rays through a child's box that something in it blocks."""
    if link >= 0:
        return inner[link]
    return 1.0 - np.exp(-areas[~link >> 5] / surface) if surface > 0.0 else 0.0


@kernel
def likelier_first(nodes, links, areas):
    """Put the child first in which a ray is the likelier blocked, in all nodes of a `blocks.BlockTree`.

    areas : (b,) of the triangles of each block
    """
    inner, boxes, words = np.zeros(len(nodes)), ptr(nodes), ptr(links)
    for node in parents_first(links)[::-1]:
        at = node * 16
        left, right, whole = _surface(boxes, at, at), _surface(boxes, at + 1, at + 1), _surface(boxes, at, at + 1)
        first = left * _blocked(links[node, 12], left, areas, inner)
        second = right * _blocked(links[node, 13], right, areas, inner)
        if whole > 0.0:
            inner[node] = 1.0 - (1.0 - min(first / whole, 1.0)) * (1.0 - min(second / whole, 1.0))
        if second > first:
            _swap(words, node)
