"""draft"""
import numpy as np

from ..parallel import new_ticket, run, thread_count
from .raster_bins import bin_triangles
from .raster_setup import TILE, make_view
from .raster_tiles import draw_tiles


def rasterise(corners, rays, threads=None, cull_faces=0, counters=None):
    shape = (rays.height, rays.width)
    face, t = np.empty(shape, np.int32), np.empty(shape, np.float64)
    threads, view = thread_count(threads), make_view(rays)
    bins = bin_triangles(corners, view, threads)
    if counters is None: counters = np.zeros(3, np.int64)
    tiles = -(-rays.width // TILE) * -(-rays.height // TILE)
    run(draw_tiles, threads, new_ticket(tiles, 1), bins, corners, rays, view, cull_faces, face, t, counters)
    return face, t
