"""Bounds of a query: bounding boxes of triangles and points, and light placement in the scene's frame.

Distant lights are placed beyond the bounds. `place` rejects points and lights that are too far away for the tracers'
arithmetic, compared with the width of the scene. `morton_codes` orders points so that neighbours in a list are close in
space.
"""

import weakref
from math import sqrt
from operator import sub

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..kernels.jit import kernel
from ..kernels.parallel import CHUNK, new_ticket, run_short, shares, thread_count
from ..kernels.simd import load16, maximum, minimum, ptr, splat16, store
from ..scene.light_lists import LightList
from ..scene.lights import DIRECTIONAL, Light, LightPatch
from ..scene.resident_triangles import ResidentTriangles
from ..scene.scene_bounds import flush_to_zero
from ..scene.triangles import Triangles

# --- Morton order -----------------------------------------------------------------------------------------------------


def morton_codes(points: NDArray[np.floating]) -> NDArray[np.int32]:
    """(n,) int32: Morton codes of (n, 3) points within their bounding box, 10 bits per axis.

    Points too far apart for their dtype get arbitrary codes.
    """
    axes = np.ascontiguousarray(points.T)  # minima along rows are several times faster
    with np.errstate(over="ignore", invalid="ignore"):
        low = axes.min(1, initial=np.inf, keepdims=True)
        size = max(float((axes.max(1, initial=-np.inf, keepdims=True) - low).max()), 1e-30)
        cells = np.clip((axes - low) * axes.dtype.type(1023.0 / size), 0, 1023).astype(np.int32)
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cells = (cells | cells << shift) & np.int32(mask)
    codes: NDArray[np.int32] = cells[0] << 2 | cells[1] << 1 | cells[2]
    return codes


# --- Bounds of triangles and points -----------------------------------------------------------------------------------


_ROWS = 16  # points per block: three vectors of 16 lanes; each lane holds the same axis in every block
_BLOCK = 3 * _ROWS
_CHUNK = 2048  # blocks
_TINY = float(np.finfo(np.float32).tiny)


@kernel
def _bounds(ticket, values, parts):
    """Worker: minimum and maximum at each of the 48 positions in a block, for each chunk of blocks."""
    p, out = ptr(values), ptr(parts)
    for first, last in shares(ticket):
        a, b, c = (splat16(np.float32(np.inf)), splat16(np.float32(np.inf)), splat16(np.float32(np.inf)))
        d, e, f = (splat16(np.float32(-np.inf)), splat16(np.float32(-np.inf)), splat16(np.float32(-np.inf)))
        for i in range(first, last):
            x, y, z = load16(p, _BLOCK * i), load16(p, _BLOCK * i + 16), load16(p, _BLOCK * i + 32)
            a, b, c = minimum(a, x), minimum(b, y), minimum(c, z)
            d, e, f = maximum(d, x), maximum(e, y), maximum(f, z)
        row = first // ticket[CHUNK] * 2 * _BLOCK
        store(out, row, a)
        store(out, row + 16, b)
        store(out, row + 32, c)
        store(out, row + 48, d)
        store(out, row + 64, e)
        store(out, row + 80, f)


def bounds(points: NDArray[np.float32], threads: int | None = None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lower and upper corner, (3,) float32 each, of the bounding box of (..., 3) float32 points.

    The points must be C-contiguous and finite, and there must be at least one.
    """
    flat = points.reshape(-1)
    n = flat.size // _BLOCK
    if n == 0:
        remaining = flat.reshape(-1, 3)
        if len(remaining) == 1:
            return remaining[0], remaining[0]
        return remaining.min(0), remaining.max(0)
    parts = np.empty((-(-n // _CHUNK), 2, _ROWS, 3), np.float32)
    run_short(_bounds, thread_count(threads), new_ticket(n, _CHUNK), flat, parts)
    remaining = flat[n * _BLOCK :].reshape(-1, 3)
    lower, upper = parts[:, 0].reshape(-1, 3), parts[:, 1].reshape(-1, 3)
    return np.concatenate([lower, remaining]).min(0), np.concatenate([upper, remaining]).max(0)


_latest: list[tuple[weakref.ref[NDArray[np.float32]], NDArray[np.float32]]] = []  # at most one: vertices, their box


def triangle_box(triangles: Triangles, threads: int | None = None) -> NDArray[np.float32]:
    """(2, 3) float32: the `bounds` of at least one triangle. Those of the latest triangles are cached: do not write."""
    if isinstance(triangles, ResidentTriangles):
        return triangles.bounds
    for vertices, box in _latest:
        if vertices() is triangles.vertices:
            return box
    box = np.stack(bounds(triangles.vertices, threads))
    _latest[:] = [(weakref.ref(triangles.vertices), box)]
    return box


def reach(triangles: Triangles, points: NDArray[np.float32], threads: int | None = None) -> float:
    """A length greater than the distance from any of the (..., 3) points to any triangle's corner."""
    return reach_of(triangle_box(triangles, threads), points, threads)


def reach_of(box: NDArray[np.float32], points: NDArray[np.float32] | None = None, threads: int | None = None) -> float:
    """As `reach`, from the exact bounds of the triangles.

    box : (2, 3) float32
    points : (..., 3) float32 or None; None: they lie on the triangles
    """
    lower, upper = box
    if points is not None:
        low, high = bounds(points, threads)
        lower, upper = np.minimum(lower, low), np.maximum(upper, high)
    x, y, z = (upper.astype(np.float64) - lower).tolist()
    return 2.0 * sqrt(x * x + y * y + z * z) + _TINY  # a dot product of NumPy has other last bits on other processors


# --- Placing lights ---------------------------------------------------------------------------------------------------


MOST_RATIO = 2.0**120
"""Largest distance of points and lights, in widths of the scene: lengths in units of a segment stay within float32."""


def place(light: Light, origin: np.ndarray, box: np.ndarray | None, reach: float) -> LightPatch:
    """The patch of a light in the frame with its origin at the world position `origin`.

    box : (2, 3) float32, bounds of the scene's triangles; None: there are none
    reach : as for `Light.patch`

    Raises
    ------
    InputError
        If points or the light are more than MOST_RATIO widths of the scene away.
    """
    patch = light.patch(origin, reach)
    if isinstance(light, LightList) or patch.kind == DIRECTIONAL:
        _check_ratio(box, max(reach, _farthest(light, patch)), light)
        return patch
    vectors = np.array((patch.base, patch.u, patch.v))
    _check_ratio(box, max(reach, max(map(abs, vectors.reshape(-1).tolist())) + patch.radius), light)
    base, u, v = flush_to_zero(vectors)
    return LightPatch(patch.kind, base, u, v, patch.w, patch.radius)


def _farthest(light: Light, patch: LightPatch) -> float:
    """Roughly the largest coordinate magnitude of a list of lights; 0 for distant lights, which `reach` places."""
    if patch.kind == DIRECTIONAL or not isinstance(light, LightList) or not len(light.points):
        return 0.0
    return float(np.abs(light.points).max()) + float(np.abs(patch.base).max())


def _check_ratio(box: np.ndarray | None, far: float, light: Light) -> None:
    if box is None:
        return
    width = max(map(sub, *box[::-1].tolist()))
    if width > 0.0 and far > MOST_RATIO * width:
        raise InputError(
            f"points, or the {type(light).__name__}, are {far:.3g} units away from a scene that is {width:.3g} units "
            f"wide; bring them nearer than {MOST_RATIO:.2g} times its width"
        )
