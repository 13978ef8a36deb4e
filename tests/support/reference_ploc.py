"""Locally-ordered clustering [Meister and Bittner 2018b] of one range, in NumPy. It imports nothing of the package."""

import numpy as np


def _half_area(box):
    x, y, z = box[1] - box[0]
    return x * (y + z) + y * z


def _join(a, b):
    return np.stack([np.minimum(a[0], b[0]), np.maximum(a[1], b[1])])


def _nearest(boxes, i, radius):
    """The nearest neighbour of box i. Ties go to its partner in the pair (2 k, 2 k + 1), then to the first."""
    others = [j for j in range(max(i - radius, 0), min(i + radius + 1, len(boxes))) if j != i]
    return min(others, key=lambda j: (_half_area(_join(boxes[i], boxes[j])), j != i ^ 1, j))


def _as_leaves(tree, max_leaf):
    """(tree with its cheap subtrees as leaves, cost, ids): a leaf is a tuple of ids, a node [left, right]."""
    box, content = tree
    if not isinstance(content, list):
        return (content,), _half_area(box), (content,)
    (left, left_cost, left_ids), (right, right_cost, right_ids) = (_as_leaves(child, max_leaf) for child in content)
    ids, area = left_ids + right_ids, _half_area(box)
    cost, cost_of_leaf = area + left_cost + right_cost, area * np.float32(len(ids))
    if len(ids) <= max_leaf and cost_of_leaf <= cost:
        return ids, cost_of_leaf, ids
    return [left, right], cost, ids


def ploc_tree(vertices, order, radius, max_leaf):
    """The tree over triangles that are clustered in `order`. A leaf is a tuple of triangles, a node [left, right]."""
    clusters = [(np.stack([vertices[i].min(0), vertices[i].max(0)]), int(i)) for i in order]
    while len(clusters) > 1:
        boxes = [box for box, _ in clusters]
        nearest = [_nearest(boxes, i, radius) for i in range(len(boxes))]
        merged = []
        for i, (box, _) in enumerate(clusters):
            j = nearest[i]
            if nearest[j] != i:
                merged.append(clusters[i])
            elif i < j:
                merged.append((_join(box, boxes[j]), [clusters[i], clusters[j]]))
        clusters = merged
    return _as_leaves(clusters[0], min(max_leaf, len(order) - 1))[0]
