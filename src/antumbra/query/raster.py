"""The rasteriser: primary visibility with the same bits as tracing each pixel's ray against every triangle."""

import numpy as np

from ..errors import InputError
from ..kernels.parallel import new_ticket, run, thread_count
from ..scene.camera import CameraRays
from .raster_bins import bin_triangles, tiles_across
from .raster_setup import make_view
from .raster_tiles import RASTER_COUNTERS, draw_tiles

__all__ = ["RASTER_COUNTERS", "new_raster_counters", "rasterise"]


def new_raster_counters() -> np.ndarray:
    """Zeros for the `counters` of `rasterise`, in the order of RASTER_COUNTERS."""
    return np.zeros(len(RASTER_COUNTERS), np.int64)


def rasterise(corners, rays: CameraRays, threads=None, cull_faces: int = 0, counters=None):
    """The nearest triangle at each pixel centre.

    Parameters
    ----------
    corners : (n, 9) float32, C-contiguous, finite
        Three corners a row, in the recentred frame: a view of `Triangles.vertices`.
    rays : CameraRays
    threads : int, optional
        None: all cores. The result does not depend on it.
    cull_faces : int
        0: none. 1, -1: ignore triangles whose normal points along the ray, or against it.
    counters : (5,) int64, optional
        From `new_raster_counters`; the counts are added to it.

    Returns
    -------
    face : (H, W) int32
        Row of `corners`, -1 in the background. Among triangles at the same t, the lowest row wins.
    t : (H, W) float64
        Depth, in lengths of the pixel's direction; inf in the background.

    Raises
    ------
    InputError
        If `corners` has another shape, dtype or layout, or `cull_faces` is not -1, 0 or 1.

    Notes
    -----
    Pixel (x, y) has the ray ``pixels.pixel_ray(rays, x, y)``, over (0, inf). ``filters.meets`` defines coverage, and
    ``hits.hit_t`` defines t. Triangles are culled and listed by screen tile (`raster_cull`, `raster_bins`). Then one
    thread draws each tile (`raster_tiles`).
    """
    corners = _checked(corners)
    if cull_faces not in (-1, 0, 1):
        raise InputError(f"cull_faces is {cull_faces!r}; it must be 0 (none), 1 (along the ray) or -1 (against it)")
    face, t = np.empty((rays.height, rays.width), np.int32), np.empty((rays.height, rays.width))
    threads, view = thread_count(threads), make_view(rays)
    counters = new_raster_counters() if counters is None else counters
    bins = bin_triangles(corners, view, threads)
    tiles, longest = tiles_across(rays.width) * tiles_across(rays.height), int(np.diff(bins.first).max())
    run(
        draw_tiles,
        threads,
        new_ticket(tiles, 1),
        bins,
        corners,
        rays,
        view,
        int(cull_faces),
        face,
        t,
        counters,
        own=lambda: (np.empty(longest, np.int32),),
    )
    return face, t


def _checked(corners) -> np.ndarray:
    if not (isinstance(corners, np.ndarray) and corners.ndim == 2 and corners.shape[1] == 9):
        raise InputError(f"corners must be an (n, 9) array, not {getattr(corners, 'shape', type(corners).__name__)}")
    if corners.dtype != np.float32 or not corners.flags.c_contiguous:
        raise InputError("corners must be C-contiguous float32: numpy.ascontiguousarray(corners, numpy.float32)")
    return corners
