"""The cost metric and the heuristic of the SRDH paper, ray by ray. It imports nothing of the package.

Boxes are tested in float64. Rounding decides whether a ray that just touches a box enters it, and which of two equally
far boxes is closer. So costs are intervals: the least and the largest possible cost.
"""

from typing import NamedTuple

import numpy as np

LEFT, RIGHT, NEAR, FAR = "left first", "right first", "front to back", "back to front"


class Scene(NamedTuple):
    """Boxes of triangles, and segments with all their intersections."""

    lower: np.ndarray  # (n, 3) float64
    upper: np.ndarray  # (n, 3) float64
    origins: np.ndarray  # (m, 3) float64
    ends: np.ndarray  # (m, 3) float64
    hits: np.ndarray  # (m, n) bool: whether each segment meets each triangle


def scene_of(vertices, origins, ends, hits):
    v = vertices.astype(np.float64)
    return Scene(v.min(1), v.max(1), origins.astype(np.float64), ends.astype(np.float64), hits)


def box_of(scene, ids):
    return scene.lower[ids].min(0), scene.upper[ids].max(0)


def half_area(box):
    x, y, z = box[1] - box[0]
    return x * (y + z) + y * z


def pierces(box, origins, ends, slack=0.0):
    """(m,) bool: whether each segment enters the closed box, grown by `slack`."""
    lower, upper = box[0] - slack, box[1] + slack
    if (lower > upper).any():
        return np.zeros(len(origins), bool)
    d = ends - origins
    still, within = d == 0, (lower <= origins) & (origins <= upper)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        a, b = (lower - origins) / d, (upper - origins) / d
    near = np.where(still, np.where(within, -np.inf, np.inf), np.minimum(a, b)).max(1)
    far = np.where(still, np.where(within, np.inf, -np.inf), np.maximum(a, b)).min(1)
    return np.maximum(near, 0.0) <= np.minimum(far, 1.0)


def left_first(kernel, left, right, origins):
    """(kappa, doubtful), (m,) bool each, of one of the four kernels. `left` and `right` are boxes."""
    if kernel in (LEFT, RIGHT):
        return np.full(len(origins), kernel == LEFT), np.zeros(len(origins), bool)
    a, b = (np.linalg.norm((box[0] + box[1]) / 2 - origins, axis=1) for box in (left, right))
    return (a <= b) == (kernel == NEAR), abs(a - b) <= 1e-5 * np.maximum(a, b)


def candidates(vertices):
    """Yield the left sides, (n,) bool each, of all planes between bins. Each axis has 4 + n / 16 bins, at most 32.

    Bins are computed in float32, as in the package, because they decide the possible splits.
    """
    centre, f = vertices.min(1) + vertices.max(1), np.float32
    n_bins = min(32, 4 + len(vertices) // 16)
    for axis in range(3):
        c = centre[:, axis]
        extent = c.max() - c.min()
        if extent > 0:
            place = ((c - c.min()) * (f(n_bins) * f(1 - 2.0**-20) / extent)).astype(int).clip(0, n_bins - 1)
            for k in range(1, n_bins):
                if 0 < (place < k).sum() < len(vertices):
                    yield place < k


def _size(n, linear):
    return float(n) if linear else n**0.75


def srdh(scene, ids, others, rays, kernels, prior=0.0, linear=True, slack=1e-5):
    """Kernel -> (least, most) of SRDH(P1, P2, kappa, R) [Sec. 3.3], with `prior` additional rays spread as in the SAH.

    ids, others : indices of P1 and P2
    rays : indices of R
    slack : growth of boxes, relative to the largest coordinate
    """
    origins, ends = scene.origins[rays], scene.ends[rays]
    slack *= max(abs(a).max(initial=0) for a in (scene.lower, scene.upper, origins, ends))
    boxes, size = [box_of(scene, s) for s in (ids, others)], [_size(len(s), linear) for s in (ids, others)]
    h1, h2 = (scene.hits[np.ix_(rays, s)].any(1) for s in (ids, others))
    area = half_area(box_of(scene, np.concatenate([ids, others])))
    shares = [half_area(box) / area if area > 0 else 0.0 for box in boxes]
    even = prior * (shares[0] * size[0] + shares[1] * size[1])
    enters = [
        [pierces(boxes[0], origins, ends, s) | h1, pierces(boxes[1], origins, ends, s) | h2] for s in (-slack, slack)
    ]
    costs = {}
    for kernel in kernels:
        k, doubtful = left_first(kernel, *boxes, origins)
        both = []
        for kappa in (k, k ^ doubtful):
            both.append([((1 - ~kappa * h2) * i1 * size[0] + (1 - kappa * h1) * i2 * size[1]) for i1, i2 in enters])
        (low, high), (low2, high2) = both
        costs[kernel] = even + np.minimum(low, low2).sum(), even + np.maximum(high, high2).sum()
    return costs


def ray_sets(scene, ids, others, rays, kernel):
    """(rays of P1, rays of P2): the rays that reach each child and enter its box [Sec. 3.4]."""
    boxes = [box_of(scene, s) for s in (ids, others)]
    h1, h2 = (scene.hits[np.ix_(rays, s)].any(1) for s in (ids, others))
    i1, i2 = (pierces(box, scene.origins[rays], scene.ends[rays]) for box in boxes)
    kappa = left_first(kernel, *boxes, scene.origins[rays])[0] if kernel else np.zeros(len(rays), bool)
    free = not kernel  # without a kernel, no ray meets a triangle
    first, second = free | ~(~kappa & h2), free | ~(kappa & h1)
    return rays[first & (i1 | h1)], rays[second & (i2 | h2)]


class Costs(NamedTuple):
    """Costs of each ray at a node."""

    expected: np.ndarray  # (m,): C(N, r), with c_b = 1 and c_p = c_k = 0
    least: np.ndarray  # (m,): the cost if each node below visits the better child first
    most: np.ndarray  # (m,): the cost if each node below visits the worse child first
    hit: np.ndarray  # (m,) bool: H(N, r)


def visit(scene, tree, first):
    """(`Costs`, box) of a tree [Sec. 3.2].

    tree : a list of triangle indices for a leaf, or (left tree, right tree, order) for a branch
    first : function (order, left box, right box) -> kappa, (m,) float
    """
    m = len(scene.origins)
    if isinstance(tree, list):
        one = np.ones(m)
        return Costs(one, one, one, scene.hits[:, tree].any(1)), box_of(scene, tree)
    (a, left), (b, right) = visit(scene, tree[0], first), visit(scene, tree[1], first)
    kappa, box = first(tree[2], left, right), (np.minimum(left[0], right[0]), np.maximum(left[1], right[1]))
    enters = pierces(box, scene.origins, scene.ends)
    expected = (1 - (1 - kappa) * b.hit) * a.expected + (1 - kappa * a.hit) * b.expected
    least = np.minimum(a.least + ~a.hit * b.least, b.least + ~b.hit * a.least)
    most = np.maximum(a.most + ~a.hit * b.most, b.most + ~b.hit * a.most)
    costs = (1 + enters * cost for cost in (expected, least, most))
    return Costs(*costs, a.hit | b.hit), box
