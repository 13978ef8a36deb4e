"""The background of pixels without a surface: skies, or a backdrop."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernels.elementary import atan2
from ..kernels.exact.filters import dot
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import get, ptr, put
from ..scene.camera import CameraRays, ExplicitRays
from ..scene.lights import Light
from ..scene.sky import Sky

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

BACKDROP = 0.75
"""Share of white in a backdrop where the daylight has a radiance of 1."""

BRIGHTEST = 0.9
"""The same of a daylight among the lights, at most. A dark model takes a long exposure, which would turn the ground
below it, and the shadows on it, white."""


@inlined
def _map_texel(values, w, row, column, c):
    return np.float64(get(values, 3 * (row * w + column) + c))


@inlined
def _add_radiance(sky_map, axes, d, out, at):
    """Add the radiance of a sky along d to the three elements of `out` from `at` on; bilinear, as `Sky.radiance`."""
    (h, w), values = sky_map.shape[:2], ptr(sky_map)
    right, upward, back = dot(axes[0], d), dot(axes[1], d), dot(axes[2], d)
    down = atan2(np.sqrt(right * right + back * back), upward) * (h / np.pi) - 0.5
    y, column, fx = np.int64(np.floor(down)), np.int64(0), 0.0
    if w > 1:
        across = (atan2(right, -back) * (0.5 / np.pi) + 0.5) * w - 0.5
        column, fx = np.int64(np.floor(across)), across - np.floor(across)
    fy, upper, lower = down - y, min(max(y, 0), h - 1), min(max(y + 1, 0), h - 1)
    column, beside = column % w, (column + 1) % w
    for c in range(3):
        a, b = _map_texel(values, w, upper, column, c), _map_texel(values, w, upper, beside, c)
        p, q = _map_texel(values, w, lower, column, c), _map_texel(values, w, lower, beside, c)
        radiance = (a + fx * (b - a)) * (1.0 - fy) + (p + fx * (q - p)) * fy
        put(out, at + c, get(out, at + c) + np.float32(radiance))


@kernel
def _sky_rows(ticket, rays, sky_map, axes, mask, image):
    """Worker: add a sky to the pixels of rows that are set in `mask`; `axes`: of the map, three tuples."""
    w, out, corner, dx, dy = mask.shape[1], ptr(image), rays.corner, rays.dx, rays.dy
    cx, cy, cz = corner[0], corner[1], corner[2]
    rx, ry, rz, ux, uy, uz = dx[0], dx[1], dx[2], dy[0], dy[1], dy[2]
    for y in items(ticket):
        v = y + 0.5
        for x in range(w):
            if mask[y, x]:
                u = x + 0.5
                d = cx + u * rx + v * ux, cy + u * ry + v * uy, cz + u * rz + v * uz
                _add_radiance(sky_map, axes, d, out, 3 * (y * w + x))


def add_skies(
    skies: list[Sky],
    rays: CameraRays | ExplicitRays,
    mask: NDArray[np.bool_],
    image: NDArray[np.float32],
    threads: int | None = None,
) -> None:
    """Add the radiance of skies to the pixels of an image, (H, W, 3) float32, that are set in a mask, (H, W) bool."""
    if isinstance(rays, ExplicitRays):
        image[mask] += sky_behind(skies, rays, *np.nonzero(mask))
        return
    for sky in skies:
        axes = tuple(tuple(axis) for axis in sky.axes.tolist())
        run(_sky_rows, thread_count(threads), new_ticket(len(mask), 8), rays, sky.radiance_map, axes, mask, image)


def backdrop(
    rays: CameraRays | ExplicitRays, coverage: np.ndarray, up: str, threads: int | None = None
) -> NDArray[np.float32]:
    """(H, W, 3) float32, linear shares of white: soft daylight behind a scene without a sky.

    It lights nothing and does not depend on exposure. It is 0 where surfaces cover the whole pixel.

    coverage : (H, W) float32, the share of each pixel that shows surfaces
    """
    out = np.zeros((*coverage.shape, 3), np.float32)
    add_skies([Sky(up=up, intensity=BACKDROP)], rays, coverage < 1.0, out, threads)
    return out


def seen_daylight(frame: Any) -> list[Sky]:
    """The skies behind the surfaces of a frame's image; none if one is an environment map or a uniform sky."""
    skies = skies_of(frame.lights) if frame.options is not None and frame.options.background else []
    return skies if all(sky.is_daylight for sky in skies) else []


def daylight_behind(frame: Any, exposure: float) -> tuple[NDArray[np.float32], float] | None:
    """The daylight behind the surfaces of a frame's image, if an exposure turns it white; else None.

    Returns its radiance with the shadows on the ground, (H, W, 3) float32, 0 where surfaces cover the whole pixel; and
    the factor that makes it linear shares of white.
    """
    skies = seen_daylight(frame)
    intensity = sum(sky.intensity for sky in skies)
    if exposure * intensity <= BRIGHTEST:
        return None
    out = np.zeros_like(frame.image)
    add_skies(skies, frame.camera.view(np.zeros(3)), frame.coverage < 1.0, out)
    return out if frame.ground is None else out * frame.ground.share, BRIGHTEST / intensity


def skies_of(lights: list[Light]) -> list[Sky]:
    """The skies among the lights."""
    return [light for light in lights if isinstance(light, Sky)]


def sky_behind(
    skies: list[Sky], rays: CameraRays | ExplicitRays, rows: np.ndarray, columns: np.ndarray
) -> NDArray[np.float32]:
    """(m, 3) float32: the radiance of skies, 0 without skies, at the centres of pixels (rows[i], columns[i])."""
    out = np.zeros((len(rows), 3), np.float32)
    if skies and len(rows):
        half = np.float32(0.5)
        directions = rays.directions(columns.astype(np.float32) + half, rows.astype(np.float32) + half)
        for sky in skies:
            out += sky.radiance(directions)
    return out
