"""Morton codes and the tree over them [Karras 2012], in plain Python. It imports nothing of the package."""

import numpy as np


def morton_codes(vertices, bits):
    """The code of each triangle, as Python integers: bits of x, y, z in turn, highest bits first. Cells are cubes."""
    centroid = vertices.min(1) + vertices.max(1)  # doubled
    lower = centroid.min(0)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        factor = np.float32(2**bits) / (centroid.max(0) - lower).max()
        cells = (centroid - lower) * (factor if np.isfinite(factor) else np.float32(0))
    cells = np.minimum(cells.astype(np.int64), 2**bits - 1)
    return [
        sum((int(cell[axis]) >> b & 1) << (3 * b + 2 - axis) for b in range(bits) for axis in range(3))
        for cell in cells
    ]


def karras_tree(codes, max_leaf=1):
    """(order, tree) of codes. A leaf is (first slot, count), a node [left, right]. Slots order equal codes."""
    order = sorted(range(len(codes)), key=lambda i: (codes[i], i))
    keys = [codes[i] << 32 | slot for slot, i in enumerate(order)]

    def tree(first, last):
        if last - first <= max_leaf and (last - first == 1 or last - first < len(keys)):
            return first, last - first
        bit = (keys[first] ^ keys[last - 1]).bit_length() - 1
        middle = next(i for i in range(first, last) if keys[i] >> bit & 1)
        return [tree(first, middle), tree(middle, last)]

    return order, tree(0, len(keys))


def depth_of(tree):
    """The number of inner nodes on the longest path."""
    return 1 + max(depth_of(child) for child in tree) if isinstance(tree, list) else 0
