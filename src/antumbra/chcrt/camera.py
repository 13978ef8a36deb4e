"""The camera's rays: their cells of 4 x 4 pixels and their bundles. Multi-frusta trace them (`trace.primary`).

All rays are measured in one *length*. This multiple of a ray's direction takes every ray out of the scene.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel, overload
from ..kernels.parallel import items, new_ticket, run
from ..kernels.predicate.filters import BEYOND
from ..kernels.simd import ptr, ptr_at, put
from ..query.gbuffer import pixel_direction
from ..query.raster_setup import direction_error
from ..scene.camera import CameraRays
from ..trace.tree_list import Hits
from .bundles import bundles_in, load_bundle
from .cells import (
    CELL,
    FAR,
    NONE,
    WORDS,
    Picture,
    first_receiver,
    new_cells,
    no_cell,
    put_cell,
    receiver_in,
    region_in,
    regions_in,
)

_F = np.float32
_REGION = 4 * CELL  # pixels of a region, both ways


class CameraBundles(NamedTuple):
    """The rays of a camera, and how far they look."""

    rays: CameraRays
    t: np.ndarray  # (h, w) float64: the nearest hits so far
    length: float  # see `length_of`


@overload(bundles_in)
def _bundles_in(source):
    if source.instance_class is CameraBundles:
        return lambda source: 1


@overload(load_bundle)
def _load_bundle(source, picture, y0, x0, s, k, blind, bundle):
    if source.instance_class is CameraBundles:
        return lambda source, picture, y0, x0, s, k, blind, bundle: _load(source, picture, y0, x0, bundle)


@kernel
def _load(source, picture, y0, x0, bundle):
    """`load_bundle` of a camera."""
    rays, live = source.rays, np.int64(0)
    for lane in range(16):
        y, x, inside = receiver_in(picture, y0, x0, lane)
        d = pixel_direction(rays, x, y)
        for k in range(3):
            put(bundle.rays, 16 * k + lane, rays.origin[k])
        put(bundle.rays, 48 + lane, d[0] * _F(source.length))
        put(bundle.rays, 64 + lane, d[1] * _F(source.length))
        put(bundle.rays, 80 + lane, d[2] * _F(source.length))
        far = source.t[y, x] / source.length * BEYOND if inside else -1.0
        put(bundle.limits, lane, _F(min(far, 1.0)))
        live |= np.int64(inside) << lane
    return live


def length_of(reach: float) -> float:
    """The least power of two that makes every direction at least 2 * `reach` long along the view axis.

    A direction's part along the view axis is 1.
    """
    return float(2.0 ** np.ceil(np.log2(2.0 * reach)))


@inlined
def _ends(rays, error, length, x, y, k):
    """Bounds of coordinate k of the whole rays of the cell at pixel (x, y)."""
    half = 1.5 * abs(rays.dx[k]) + 1.5 * abs(rays.dy[k]) + 2.0 * error[k]
    middle = rays.corner[k] + (x + 2.0) * rays.dx[k] + (y + 2.0) * rays.dy[k]
    return (middle - half) * length, (middle + half) * length


@kernel
def _bound(ticket, picture, rays, error, length, cells):
    """Worker: write the cells of regions."""
    eye = (rays.origin[0], rays.origin[1], rays.origin[2])
    for region in items(ticket):
        out = ptr_at(ptr(cells), region * WORDS)
        for g in range(16):
            y, x = first_receiver(picture, region, g)
            n = max(min(CELL, picture.h - y), 0) * max(min(CELL, picture.w - x), 0)
            if n == 0:
                no_cell(out, g)
                continue
            lx, hx = _ends(rays, error, length, x, y, 0)
            ly, hy = _ends(rays, error, length, x, y, 1)
            lz, hz = _ends(rays, error, length, x, y, 2)
            put_cell(out, g, eye, eye, (lx, ly, lz), (hx, hy, hz), _F(1.0), _F(n))


def bound_camera(picture: Picture, rays: CameraRays, rows: slice, length: float, threads: int) -> np.ndarray:
    """The cells of a camera's rays through some rows of pixels, (1, regions, ROWS, 16). Other cells have no rays."""
    cells, columns = new_cells(picture, 1), picture.layout.columns
    run(_bound, threads, new_ticket(cells.shape[1], 1), picture, rays, direction_error(rays), length, cells)
    first, end = rows.start // _REGION * columns, -(-rows.stop // _REGION) * columns
    cells[0, :first, FAR], cells[0, end:, FAR] = NONE, NONE
    return cells


@kernel
def _shorten(ticket, spans, tiles, columns, picture, t, length, cells):
    """Worker: update how far the cells of some tiles look, after some of their rays have been traced."""
    for i in items(ticket):
        span = spans[tiles[i]]
        for j in range(regions_in(span)):
            region = region_in(span, j, columns)
            out = ptr_at(ptr(cells), region * WORDS)
            for g in range(16):
                y0, x0 = first_receiver(picture, region, g)
                far = -1.0
                for y in range(y0, min(y0 + CELL, picture.h)):
                    for x in range(x0, min(x0 + CELL, picture.w)):
                        far = max(far, t[y, x])
                put(out, FAR * 16 + g, min(far / length * BEYOND, 1.0))


def shorten_camera(cells, spans, tiles, picture: Picture, hits: Hits, length: float, threads: int) -> None:
    """Update the cells of some tiles. No cell looks beyond the farthest of its rays' nearest hits."""
    ticket, columns = new_ticket(len(tiles), 1), picture.layout.columns
    run(_shorten, threads, ticket, spans, tiles, columns, picture, hits.t, length, cells)
