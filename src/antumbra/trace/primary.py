"""Primary rays: the G-buffer by ray tracing, the same bits as the rasteriser's."""

import numpy as np

from ..bvh.nodes import tree_of
from ..jit import kernel
from ..parallel import new_ticket, run, take, thread_count
from ..predicate.exact import ray_along
from ..query.pixels import pixel_direction
from .traverse import walk

_TILE = 16


@kernel
def _primary_tiles(ticket, bvh, rays, face, t):
    columns = (rays.width + _TILE - 1) // _TILE
    o = rays.origin
    tree = tree_of(bvh)
    tile = take(ticket)
    while tile >= 0:
        y0, x0 = tile // columns * _TILE, tile % columns * _TILE
        for y in range(y0, min(y0 + _TILE, rays.height)):
            for x in range(x0, min(x0 + _TILE, rays.width)):
                dx, dy, dz = pixel_direction(rays, x, y)
                ray = ray_along(o[0], o[1], o[2], dx, dy, dz, 0.0, np.inf)
                slot, t[y, x] = walk(tree, ray, np.int64(-1), 0, False, None)
                face[y, x] = -1 if slot < 0 else bvh.prim_ids[slot]
        tile = take(ticket)


def trace_primary(bvh, rays, threads=None) -> tuple[np.ndarray, np.ndarray]:
    """(face, t) of the pixel-centre rays: (H, W) int32, -1 on a miss; (H, W) float64, inf on a miss."""
    face, t = np.empty((rays.height, rays.width), np.int32), np.empty((rays.height, rays.width))
    tiles = -(-rays.width // _TILE) * -(-rays.height // _TILE)
    run(_primary_tiles, thread_count(threads), new_ticket(tiles, 1), bvh, rays, face, t)
    return face, t
