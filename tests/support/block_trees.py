"""Checks of block trees."""

import numpy as np

from antumbra.bvh.block_tree import BLOCK


def slots_in_blocks(vertices, tree):
    """Walk the tree and check the boxes of blocks and nodes; return the slots found."""
    corners = vertices.reshape(-1, 9)
    found, waiting = [], [(0, np.full(3, -np.inf), np.full(3, np.inf))]
    while waiting:
        node, lower, upper = waiting.pop()
        for child in (0, 1):
            low = np.maximum(lower, tree.nodes[node, [child, 4 + child, 8 + child]])
            high = np.minimum(upper, tree.nodes[node, [2 + child, 6 + child, 10 + child]])
            link = int(tree.links[node, 12 + child])
            if link >= 0:
                waiting.append((link, low, high))
                continue
            block, count = ~link >> 5, ~link & 31
            assert count <= BLOCK
            slots = tree.slots[block]
            assert (slots[:count] >= 0).all() and (slots[count:] == -1).all()
            found.extend(slots[:count])
            points = corners[tree.prim_ids[slots[:count]]].reshape(-1, 3)
            assert (points >= low).all() and (points <= high).all()
            middle, half = tree.bounds[block, :3].astype(float), tree.bounds[block, 4:7].astype(float)
            assert (np.abs(points.astype(float) - middle) <= half).all()
            for lane in range(count):
                v0, v1, v2 = corners[tree.prim_ids[slots[lane]]].reshape(3, 3)
                np.testing.assert_array_equal(tree.blocks[block, :, lane], np.concatenate([v0, v1 - v0, v2 - v0]))
    return found
