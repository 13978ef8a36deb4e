"""The camera's rays as a ray set of CHC+RT: cells of 4 x 4 pixels, traced by multi-frusta (`trace.primary`).

All rays count in one *length*: so many times its direction that every ray has left the scene.
"""

import numpy as np

from ..jit import kernel
from ..parallel import new_ticket, run, take
from ..query.raster_setup import direction_error
from ..scene.camera import CameraRays
from ..simd import ptr, ptr_at, put
from ..trace.forest import Hits
from .cells import FAR, WORDS, Picture, first_receiver, new_cells, no_cell, put_cell

_F = np.float32
BEYOND = np.float64(1.0 + 2.0**-20)  # covers the error of `hit_t` (2**-29) and the rounding to float32
CELL = 4  # pixels, both ways


def length_of(reach: float) -> float:
    """How often a direction, whose part along the view axis is 1, is as long as `reach` at least: a power of two."""
    return float(2.0 ** np.ceil(np.log2(2.0 * reach)))


@kernel
def _bound(ticket, picture, rays, error, length, cells):
    """Worker: the cells of regions."""
    o, corner, dx, dy = rays.origin, rays.corner, rays.dx, rays.dy
    eye = (o[0], o[1], o[2])
    region = take(ticket)
    while region >= 0:
        out = ptr_at(ptr(cells), region * WORDS)
        for g in range(16):
            y, x = first_receiver(picture, region, g)
            n = max(min(CELL, picture.h - y), 0) * max(min(CELL, picture.w - x), 0)
            if n == 0:
                no_cell(out, g)
                continue
            put_cell(out, g, eye, eye, eye, eye, _F(1.0), _F(n))
            for k in range(3):
                half = 1.5 * abs(dx[k]) + 1.5 * abs(dy[k]) + 2.0 * error[k]
                middle = corner[k] + (x + 2.0) * dx[k] + (y + 2.0) * dy[k]
                put(out, 96 + 16 * k + g, (middle - half) * length)
                put(out, 144 + 16 * k + g, (middle + half) * length)
        region = take(ticket)


def bound_camera(picture: Picture, rays: CameraRays, length: float, threads: int) -> np.ndarray:
    """The cells of a camera's rays, (1, regions, ROWS, 16)."""
    cells = new_cells(picture, 1)
    run(_bound, threads, new_ticket(cells.shape[1], 1), picture, rays, direction_error(rays), length, cells)
    return cells


@kernel
def _shorten(ticket, spans, tiles, columns, picture, t, length, cells):
    """Worker: how far the cells of some tiles look, now that some rays have met something."""
    i = take(ticket)
    while i >= 0:
        x0, x1, y0, y1 = spans[tiles[i]]
        for j in range((x1 - x0) * (y1 - y0)):
            region = (y0 + j // (x1 - x0)) * columns + x0 + j % (x1 - x0)
            out = ptr_at(ptr(cells), region * WORDS)
            for g in range(16):
                y0_, x0_ = first_receiver(picture, region, g)
                far = -1.0
                for y in range(y0_, min(y0_ + CELL, picture.h)):
                    for x in range(x0_, min(x0_ + CELL, picture.w)):
                        far = max(far, t[y, x])
                put(out, FAR * 16 + g, min(far / length * BEYOND, 1.0))
        i = take(ticket)


def shorten_camera(cells, spans, tiles, picture: Picture, hits: Hits, length: float, threads: int) -> None:
    """Bring the cells of some tiles up to date: none looks beyond what all its rays have met."""
    ticket, columns = new_ticket(len(tiles), 1), picture.layout.columns
    run(_shorten, threads, ticket, spans, tiles, columns, picture, hits.t, length, cells)
