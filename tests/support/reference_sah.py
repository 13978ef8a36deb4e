"""Plain references for the SAH: binning, full sweeps, the least cost of any tree. It imports nothing of the package."""

from functools import cache

import numpy as np


def half_area(lower, upper):
    x, y, z = upper - lower
    return x * (y + z) + y * z


def binned_sah(vertices, bins=16, max_leaf=4):
    """(SAH cost, depth) of the tree by greedy binning on three axes. A node costs 1, and so does a triangle."""
    v = np.asarray(vertices, np.float64)
    lower, upper = v.min(1), v.max(1)
    centre = lower + upper

    def build(ids, may_be_leaf=True):
        area, n = half_area(lower[ids].min(0), upper[ids].max(0)), len(ids)
        if n == 1:
            return area, 0
        best, sides = np.inf, (ids[: n // 2], ids[n // 2 :])
        for axis in range(3):
            c = centre[ids, axis]
            place = ((c - c.min()) * (bins * 0.999999 / max(np.ptp(c), 1e-300))).astype(int)
            for k in range(1, bins):
                left, right = ids[place < k], ids[place >= k]
                if len(left) and len(right):
                    split = sum(half_area(lower[s].min(0), upper[s].max(0)) * len(s) for s in (left, right))
                    if split < best:
                        best, sides = split, (left, right)
        if may_be_leaf and n <= max_leaf and area + best >= area * n:
            return area * n, 0
        (left, left_depth), (right, right_depth) = build(sides[0]), build(sides[1])
        return area + left + right, 1 + max(left_depth, right_depth)

    cost, depth = build(np.arange(len(v)), may_be_leaf=False)
    return cost / half_area(lower.min(0), upper.max(0)), depth


def swept_sah(vertices, max_leaf=4):
    """SAH cost of the tree by trying all splits of each range. A node costs 1, and so does a triangle."""
    v = np.asarray(vertices, np.float64)
    lower, upper = v.min(1), v.max(1)
    centre = lower + upper

    def areas(ids):
        """Half the areas of the boxes of the first 1, 2, ... triangles."""
        x, y, z = (np.maximum.accumulate(upper[ids]) - np.minimum.accumulate(lower[ids])).T
        return x * (y + z) + y * z

    def build(ids, may_be_leaf=True):
        area, n = areas(ids)[-1], len(ids)
        if n == 1:
            return area
        best = np.inf
        for axis in range(3):
            order = ids[np.lexsort([ids, centre[ids, axis]])]
            counts = np.arange(1, n)
            costs = areas(order)[:-1] * counts + areas(order[::-1])[-2::-1] * counts[::-1]
            if costs.min() < best:
                best, sides = costs.min(), np.split(order, [costs.argmin() + 1])
        if may_be_leaf and n <= max_leaf and area + best >= area * n:
            return area * n
        return area + build(sides[0]) + build(sides[1])

    return build(np.arange(len(v)), may_be_leaf=False) / half_area(lower.min(0), upper.max(0))


def least_sah_cost(vertices, max_leaf):
    """The least SAH cost of any tree over a few triangles whose root is not a leaf."""
    v = np.asarray(vertices, np.float64)
    lower, upper = v.min(1), v.max(1)

    @cache
    def least(ids, may_be_leaf):
        area = half_area(lower[list(ids)].min(0), upper[list(ids)].max(0))
        if len(ids) == 1:
            return area
        options = [area * len(ids)] if may_be_leaf and len(ids) <= max_leaf else []
        for code in range(1, 1 << (len(ids) - 1)):  # the last triangle always goes right
            left = tuple(i for k, i in enumerate(ids) if code >> k & 1)
            right = tuple(i for i in ids if i not in left)
            options.append(area + least(left, True) + least(right, True))
        return min(options)

    ids = tuple(range(len(v)))
    return least(ids, may_be_leaf=False) / half_area(lower.min(0), upper.max(0))
