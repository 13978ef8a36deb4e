"""Bounced light at a sparse grid of pixels, and its interpolation at all others.

Bounced light varies slowly over a surface. `RenderOptions.bounce_step` therefore lets only every n-th pixel of every
n-th row trace diffuse rays: for the same cost, each traces n * n times as many. The other pixels take the weighted mean
of the four grid pixels around them that see the same surface.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..query.gbuffer import GBuffer
from ..query.shadow_query import Surfaces
from ..query.surface_links import PictureSurfaces

_FACING = 0.8
"""Smallest cosine between the normals of pixels that see the same surface."""
_OFF_PLANE = 0.02
"""Largest distance between a grid pixel's position and the plane of a pixel's surface, relative to its depth."""
_LEAST = 1e-3
"""Weight of a grid pixel in line with a pixel, so that each of the four counts where the others see other surfaces."""


def sparse_grid(values: np.ndarray, step: int) -> np.ndarray:
    """Every `step`-th value along the first two axes, contiguous."""
    return np.ascontiguousarray(values[::step, ::step])


def sparse_surfaces(surfaces: Surfaces, step: int) -> Surfaces:
    """The surfaces of the grid's pixels, as if they were a picture."""
    if step == 1:
        return surfaces
    names = "position", "normal", "face", "depth", "side"
    parts = {name: sparse_grid(getattr(surfaces.gbuffer, name), step) for name in names}
    gbuffer = surfaces.gbuffer._replace(**parts)
    return surfaces._replace(gbuffer=gbuffer, ids=sparse_grid(surfaces.ids, step), albedo=None, shading=None)


def sparse_picture(visible: PictureSurfaces, step: int) -> PictureSurfaces:
    """The visible surfaces of the grid's pixels, as input of filters."""
    if step == 1:
        return visible
    grid = lambda values: sparse_grid(values, step)
    surfaces = grid(visible.position), grid(visible.normal), grid(visible.face), grid(visible.depth), grid(visible.side)
    return PictureSurfaces(*surfaces, np.float32(step * visible.pixel))


def interpolated(gbuffer: GBuffer, irradiance: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """(H, W, 3) float32: irradiance of all pixels, given that of the grid's, (ceil(H / step), ceil(W / step), 3).

    Pixels around which no grid pixel sees their surface take the mean of those that see any. Background is 0.
    """
    if step == 1:
        return irradiance
    (height, width), (rows, columns) = gbuffer.face.shape, irradiance.shape[:2]
    y, x = np.arange(height), np.arange(width)
    down, right = ((each % step / step).astype(np.float32) for each in (y, x))
    near = np.float32(_OFF_PLANE) * np.where(gbuffer.face >= 0, gbuffer.depth, np.float32(0.0))
    sums = np.zeros((2, height, width, 3), np.float32)  # of the same surface, and of any
    weights = np.zeros((2, height, width, 1), np.float32)
    for below, beside in product((0, 1), (0, 1)):
        v, u = np.minimum(y // step + below, rows - 1), np.minimum(x // step + beside, columns - 1)
        at = (v * step)[:, None], (u * step)[None]
        seen = gbuffer.face[at] >= 0
        facing = (gbuffer.normal * gbuffer.normal[at]).sum(-1) > _FACING
        off = np.abs(((gbuffer.position - gbuffer.position[at]) * gbuffer.normal).sum(-1))
        weight = np.outer(down if below else 1.0 - down, right if beside else 1.0 - right) + np.float32(_LEAST)
        for k, counts in enumerate((seen & facing & (off <= near), seen)):
            share = np.where(counts, weight, np.float32(0.0))[..., None]
            sums[k] += share * irradiance[v[:, None], u[None]]
            weights[k] += share
    means = np.divide(sums, weights, out=np.zeros_like(sums), where=weights > 0.0)
    out: NDArray[np.float32] = np.where(weights[0] > 0.0, means[0], means[1])
    out[gbuffer.face < 0] = 0.0
    return out
