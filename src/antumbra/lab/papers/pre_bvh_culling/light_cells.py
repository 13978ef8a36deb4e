"""The destination cells of pre-BVH culling: the cells that overlap a light [Selgrad et al. 2015, Sec. 3.1].

They overlap the light itself, whatever samples a query takes of it. Each shape has an exact test against boxes, which
are grown by more than the rounding error of float32 samples.
"""

import numpy as np
from numpy.typing import NDArray

from ....query.shadow_query import ShadowQuery
from ....scene.lights import LIST, SPHERE, LightPatch
from ....techniques.culling.culling_grid import PAD, CellGrid, sample_points
from ....techniques.culling.pre_bvh_culling import Box

_ROUNDING = 2.0**-48  # more than the roundings of x, in a box far larger than the disk, as a share of its ends


def cell_bounds(grid: CellGrid) -> NDArray[np.float64]:
    """(3, n, 2) float64: the bounds of each cell along each axis, rounded outwards."""
    low, high = grid.bounds.astype(np.float64)[:, :3, None]
    scale = grid.scale.astype(np.float64)[:3, None]
    size = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
    walls = np.minimum(low + size * np.arange(grid.n + 1), high)
    walls[:, -1:] = high
    pad = PAD * np.abs(grid.bounds).max()
    return np.stack([walls[:, :-1] - pad, np.where(size > 0.0, walls[:, 1:], high) + pad], -1)


def _is_disk(query: ShadowQuery) -> bool:
    """Whether a flat light is a disk, with samples on all sides of its centre; those of a square are in [0, 1]^2."""
    return bool((query.samples < 0.0).any())


def light_box(query: ShadowQuery) -> Box:
    """The box of a light with a position."""
    light = query.light
    if light.kind == LIST:
        points = sample_points(query)
    elif light.kind == SPHERE:
        points = light.base + light.radius * np.array([[-1.0], [1.0]])
    elif _is_disk(query):
        points = light.base + np.hypot(light.u, light.v) * np.array([[-1.0], [1.0]])
    else:
        points = light.base + np.array([light.u * a + light.v * b for a in (0.0, 1.0) for b in (0.0, 1.0)])
    return points.min(0), points.max(0)


def light_cells(query: ShadowQuery, grid: CellGrid) -> NDArray[np.int64]:
    """(k, 3) int64: the cells of a grid that overlap a light with a position, which must lie in the grid."""
    light, bounds = query.light, cell_bounds(grid)
    if light.kind == LIST:
        near = [_cells_within(bounds, point, point) for point in np.unique(sample_points(query), axis=0)]
        return np.unique(np.concatenate(near), axis=0)
    cells = _cells_within(bounds, *light_box(query))
    low, high = (np.stack([bounds[axis, cells[:, axis], end] for axis in range(3)], -1) for end in range(2))
    if light.kind == SPHERE:
        meets = _meets_ball(low, high, light)
    else:
        meets = _meets_disk(low, high, light) if _is_disk(query) else _meets_quad(low, high, light)
    return cells[meets]


def _cells_within(
    bounds: NDArray[np.float64], lower: NDArray[np.float64], upper: NDArray[np.float64]
) -> NDArray[np.int64]:
    """(k, 3) int64: the cells that a box overlaps."""
    ranges = [np.flatnonzero((bounds[k, :, 1] >= lower[k]) & (bounds[k, :, 0] <= upper[k])) for k in range(3)]
    return np.stack([index.ravel() for index in np.meshgrid(*ranges, indexing="ij")], -1)


def _meets_ball(low: NDArray[np.float64], high: NDArray[np.float64], light: LightPatch) -> NDArray[np.bool_]:
    """(k,) bool: whether (k, 3) boxes overlap the ball of a sphere light."""
    nearest = np.clip(light.base, low, high) - light.base
    meets: NDArray[np.bool_] = (nearest**2).sum(-1) <= light.radius**2
    return meets


def _meets_quad(low: NDArray[np.float64], high: NDArray[np.float64], light: LightPatch) -> NDArray[np.bool_]:
    """(k,) bool: whether boxes overlap a parallelogram, by the separating axis theorem.

    Axes that vanish, as those of a point light, separate nothing.
    """
    middle, half = (low + high) / 2.0 - light.base, (high - low) / 2.0
    axes = [np.cross(light.u, light.v), *(np.cross(edge, axis) for edge in (light.u, light.v) for axis in np.eye(3))]
    meets = np.ones(len(low), np.bool_)
    for axis in axes:
        u, v, reach = light.u @ axis, light.v @ axis, half @ np.abs(axis)
        least, most = min(u, 0.0) + min(v, 0.0), max(u, 0.0) + max(v, 0.0)
        meets &= (middle @ axis + reach >= least) & (middle @ axis - reach <= most)
    return meets


def _meets_disk(low: NDArray[np.float64], high: NDArray[np.float64], light: LightPatch) -> NDArray[np.bool_]:
    """(k,) bool: whether boxes overlap a disk.

    The point of a box that is nearest to the centre c and in the plane of the disk is p(x) = clip(c + x n, low, high),
    with the x for which n . (p(x) - c) = 0. This height grows with x, and is linear between the x where c + x n passes
    the faces of the box.
    """
    normal = np.cross(light.u, light.v) / np.linalg.norm(np.cross(light.u, light.v))
    low, high = low - light.base, high - light.base

    def nearest(x: NDArray[np.float64]) -> NDArray[np.float64]:
        points: NDArray[np.float64] = np.clip(x[..., None] * normal, low, high)
        return points

    with np.errstate(divide="ignore", invalid="ignore"):
        faces = np.concatenate([low / normal, high / normal], axis=-1)
    knots = np.sort(np.where(np.isfinite(faces), faces, 0.0), axis=-1).T  # (6, k)
    heights = nearest(knots) @ normal
    right = np.clip((heights < 0.0).sum(0), 1, 5)
    a, b, left_height, right_height = (
        np.take_along_axis(values, index[None], 0)[0] for values in (knots, heights) for index in (right - 1, right)
    )
    rise = right_height - left_height
    share = np.divide(-left_height, rise, out=np.zeros_like(rise), where=rise > 0.0)
    p, reach = nearest(a + share * (b - a)), np.linalg.norm(light.u) + _ROUNDING * (np.abs(a) + np.abs(b))
    meets: NDArray[np.bool_] = (heights[0] <= 0.0) & (heights[-1] >= 0.0) & (np.linalg.norm(p, axis=-1) <= reach)
    return meets
