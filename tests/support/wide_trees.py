"""A check of wide BVHs."""

import numpy as np

from antumbra.bvh.nodes import GROUP_WORDS, LINKS, NO_CHILD, WIDTH


def check_tree(wide, bvh, vertices):
    """Walk the tree from the root and check it; return the number of wide nodes."""
    assert wide.bvh is bvh
    assert wide.nodes.ctypes.data % 64 == 0 and wide.groups.ctypes.data % 64 == 0
    assert wide.groups.shape == (len(wide.slots), GROUP_WORDS)
    seen, waiting, nodes = np.zeros(len(vertices), int), [(0, None)], 0
    while waiting:
        node, outer = waiting.pop()
        nodes += 1
        planes, links = wide.nodes[node, :LINKS].reshape(3, 2, WIDTH), wide.links[node, LINKS : LINKS + WIDTH]
        for lane in range(WIDTH):
            box, link = planes[:, :, lane], int(links[lane])
            if link == NO_CHILD:
                assert (box[:, 0] > box[:, 1]).all()
                continue
            if outer is not None:
                assert (box[:, 0] >= outer[:, 0]).all() and (box[:, 1] <= outer[:, 1]).all()
            if link >= 0:
                waiting.append((link, box))
                continue
            group, count = ~link >> 4, ~link & 15
            assert 1 <= count <= WIDTH
            slots = wide.slots[group]
            assert (slots[:count] >= 0).all() and (slots[count:] == -1).all()
            faces = bvh.prim_ids[slots[:count]]
            seen[faces] += 1
            corners = vertices[faces]
            assert (corners >= box[:, 0]).all() and (corners <= box[:, 1]).all()
            edges = np.concatenate([corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], 1)
            rows = wide.groups[group].reshape(10, WIDTH)
            np.testing.assert_array_equal(rows[:9, :count].T, edges)
            np.testing.assert_array_equal(rows[9, :count], np.abs(edges[:, 3:]).max(1))
            assert (rows[:, count:] == 0).all()
    assert (seen == 1).all() and nodes == len(wide.nodes)
    assert wide.reach == tuple(np.abs(vertices).max(axis=(0, 1), initial=np.float32(0.0)))
    return nodes
