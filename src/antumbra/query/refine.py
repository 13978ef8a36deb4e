"""Selection of pixels for refinement: penumbrae and silhouettes [Benthin and Wald 2009, Sec. 5.4 and 6.1]."""

from typing import NamedTuple

import numpy as np

from ..checks import whole_number
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..scene.light_list import N_SETS
from ..scene.lights import MAX_SPP
from .receivers import NOTHING
from .sampling import light_samples
from .surface import PictureSurfaces, points_of, same_surface

VISIBLE = np.float32(1.0 / 16.0)
"""Largest difference in red, green or blue of linear base colours that makes no edge."""

NO_BOUNDARY, INNER, OUTLINE = np.int8(0), np.int8(1), np.int8(2)
"""What lies between two neighbouring pixels; see `boundaries`."""


class FinerSamples(NamedTuple):
    """The samples of refined pixels, of each light."""

    penumbra: list[np.ndarray]  # (16, n, 3) float64: a set for each pixel
    edges: list[
        np.ndarray
    ]  # (16, ceil(n / 16), 3) float64: one for each of a pixel's sub-pixels, which share n samples


def finer_samples(lights, n: int, sampler: str) -> FinerSamples:
    """The samples for n shadow rays, 1 to 1024, in each refined pixel; lights with their own numbers keep them.

    Raises
    ------
    InputError
        If n is out of range, or the sampler is unknown.
    """
    n = whole_number(n, "adaptive", 1, MAX_SPP)
    shared = -(-n // N_SETS)
    return FinerSamples(
        [light_samples(s, n, sampler) for s in lights], [light_samples(s, shared, sampler) for s in lights]
    )


@kernel
def _penumbra_rows(ticket, seen, counts, spp, out):
    points = points_of(seen)
    h, w = counts.shape
    for y in items(ticket):
        for x in range(w):
            own = counts[y, x]
            found = 0 < own < spp
            for v in range(max(y - 1, 0), min(y + 2, h)):
                for u in range(max(x - 1, 0), min(x + 2, w)):
                    found = found or (counts[v, u] != own and same_surface(points, y, x, v, u))
            out[y, x] = found and seen.side[y, x] != NOTHING


def penumbra(seen: PictureSurfaces, counts: np.ndarray, spp: int, threads=None) -> np.ndarray:
    """(H, W) bool: pixels partly in shadow, or with another count than a neighbour on the same surface.

    counts : (H, W) int, the number of a pixel's `spp` samples of one light that are occluded
    """
    counts, out = np.ascontiguousarray(counts, np.int32), np.empty(counts.shape, np.bool_)
    run(_penumbra_rows, thread_count(threads), new_ticket(len(out), 8), seen, counts, int(spp), out)
    return out


@inlined
def _other_colour(colour, i, k):
    """True if two faces (indices, or -1 for the background) have visibly different colours."""
    if i < 0 or k < 0:
        return i != k
    for c in range(3):
        if abs(colour[i, c] - colour[k, c]) > VISIBLE:
            return True
    return False


@kernel
def _boundary_rows(ticket, seen, colour, below, right):
    points = points_of(seen)
    h, w = below.shape
    for y in items(ticket):
        for x in range(w):
            face = seen.face[y, x]
            for v, u, out in ((y + 1, x, below), (y, x + 1, right)):
                out[y, x] = NO_BOUNDARY
                if v < h and u < w and seen.face[v, u] != face:
                    other = seen.face[v, u]
                    if min(face, other) < 0:
                        out[y, x] = OUTLINE
                    elif _other_colour(colour, face, other) or not same_surface(points, y, x, v, u):
                        out[y, x] = INNER


def boundaries(seen: PictureSurfaces, colour: np.ndarray, threads=None) -> tuple[np.ndarray, np.ndarray]:
    """Two (H, W) int8: what lies between each pixel and that below, and that to the right of it.

    It is INNER between two surfaces or colours, OUTLINE between a surface and the background, or else NO_BOUNDARY.

    colour : (n, 3) float32, linear base colour of each face
    """
    below, right = (np.empty(seen.face.shape, np.int8) for _ in range(2))
    run(_boundary_rows, thread_count(threads), new_ticket(len(below), 8), seen, colour, below, right)
    return below, right


def edges(seen: PictureSurfaces, colour: np.ndarray, threads=None) -> np.ndarray:
    """(H, W) bool: pixels with a direct neighbour on another surface, of another colour, or in the background.

    colour : (n, 3) float32, linear base colour of each face

    The paper finds silhouettes during traversal, as edges whose two triangles face the viewer differently. Visible
    silhouettes are discontinuities of the G-buffer; so are creases and intersections, which the paper's test misses.
    The G-buffer test needs no adjacency of triangles, and does not mark hidden silhouettes. It misses objects narrower
    than a pixel that pass between all pixel centres.
    """
    below, right = boundaries(seen, colour, threads)
    out = (below | right) > 0
    out[1:] |= below[:-1] > 0
    out[:, 1:] |= right[:, :-1] > 0
    return out
