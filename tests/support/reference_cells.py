"""The cells of pre-BVH culling as published, in rational arithmetic; imports nothing from the package."""

from fractions import Fraction
from itertools import product

import numpy as np


def rational(values):
    """An array of floats as nested lists of fractions."""
    return [rational(each) for each in values] if np.ndim(values) else Fraction(float(values))


def cells_of_points(lower, scale, n, points):
    """The set of cells of float32 points, in a grid from `lower` with `scale` cells per unit of length."""
    places = (np.asarray(points, np.float32) - np.asarray(lower, np.float32)) * np.asarray(scale, np.float32)
    return set(map(tuple, np.clip(places, 0, n - 1).astype(int).tolist()))


def line_cells(a, b):
    """The cells on the line between the centres of cells a and b, from wall to wall.

    Where it crosses two walls at once, x comes before y, and y before z.
    """
    crossings = []
    for axis in range(3):
        d = b[axis] - a[axis]
        step = 1 if d > 0 else -1
        crossings += [(Fraction(2 * i + 1, 2 * abs(d)), axis, i, step) for i in range(abs(d))]
    cell, cells = list(a), [tuple(a)]
    for _, axis, _, step in sorted(crossings):
        cell[axis] += step
        cells.append(tuple(cell))
    return cells


def open_line_cells(a, b, n):
    """The cells whose interior the line between the centres of cells a and b meets."""
    return {cell for cell in product(range(n), repeat=3) if _stay(a, b, cell) > 0}


def closed_line_cells(a, b, n):
    """The cells that the line between the centres of cells a and b at least touches."""
    return {cell for cell in product(range(n), repeat=3) if _stay(a, b, cell) >= 0}


def _stay(a, b, cell):
    """The share of the line inside a cell; negative if it does not even touch it."""
    enter, leave = Fraction(0), Fraction(1)
    for start, end, k in zip(a, b, cell):
        d, x = end - start, Fraction(2 * start + 1, 2)
        if d == 0:
            if k != start:
                return Fraction(-1)
            continue
        first, last = sorted(Fraction(wall - x) / d for wall in (k, k + 1))
        enter, leave = max(enter, first), min(leave, last)
    return leave - enter


def ring(cells, n):
    """The cells and their neighbours, also diagonal ones, inside the grid."""
    near = {tuple(k + d for k, d in zip(cell, by)) for cell in cells for by in product((-1, 0, 1), repeat=3)}
    return {cell for cell in near if all(0 <= k < n for k in cell)}


def cell_boxes(lower, upper, scale, n, pad):
    """Cell -> its corners (low, high), in fractions, grown by `pad`."""
    walls = []
    for low, high, per_unit in zip(*map(rational, (lower, upper, scale))):
        walls.append([min(low + k / per_unit, high) if k < n else high for k in range(n + 1)])
    pad = Fraction(float(pad))
    return {
        cell: tuple([walls[axis][k + end] + (2 * end - 1) * pad for axis, k in enumerate(cell)] for end in range(2))
        for cell in product(range(n), repeat=3)
    }


def polygon_meets(box, polygon):
    """Whether a convex polygon, even without area, meets a closed box; it is clipped face by face [Sutherland 1974]."""
    for axis in range(3):
        for wall, sign in (box[0][axis], 1), (box[1][axis], -1):
            polygon = _clip(polygon, [sign * (point[axis] - wall) for point in polygon])
    return bool(polygon)


def _clip(polygon, heights):
    """The part of a polygon whose heights are not negative."""
    kept = []
    for i, (point, height) in enumerate(zip(polygon, heights)):
        before, under = polygon[i - 1], heights[i - 1]
        if (height < 0) != (under < 0):
            share = under / (under - height)
            kept.append([p + share * (q - p) for p, q in zip(before, point)])
        if height >= 0:
            kept.append(point)
    return kept


def ball_meets(box, centre, radius):
    """Whether a ball meets a closed box."""
    nearest = (min(max(x, low), high) - x for x, low, high in zip(centre, *box))
    return sum(d * d for d in nearest) <= radius * radius
