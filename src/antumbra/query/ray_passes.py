"""Passes of one ray per pixel: diffuse rays, camera rays, and hits on a level ground plane.

Diffuse rays are traced pass by pass [Mattausch et al. 2015, Sec. 5.3]. Each pass takes one sample from each set, so
neighbouring pixels have similar directions. Directions are rounded to float32 once, so all tracers get the same rays.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.checks import whole_number
from ..base.errors import InputError
from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.small_matrices import length
from ..scene.camera import CameraRays, ExplicitRays
from ..scene.light_lists import N_SETS
from ..scene.lights import MAX_SPP, Light, is_indirect
from .gbuffer import GBuffer, pixel_direction
from .light_samples import domain_sets, hemisphere, light_samples, sample_point
from .receivers import NOTHING, SHIFT

# --- Passes of diffuse rays -------------------------------------------------------------------------------------------


SEED = 1
"""First part of the seeds of permutations that pair light samples with directions."""

MAX_BOUNCES = 64
"""Largest number of surfaces that light meets on a path."""


class RayPass(NamedTuple):
    """One ray from each of m receivers, pixel by pixel and row by row."""

    origins: np.ndarray  # (m, 3) float32, recentred frame
    directions: np.ndarray  # (m, 3) float32, approximately unit length; zero: no ray, counts as a miss
    skip: np.ndarray  # (m,) int32, the triangle under the origin, which is not tested; -1: none


def listed_pass(origins: np.ndarray, directions: np.ndarray) -> RayPass:
    """The rays of a picture's pixels, (..., 3) float32 each, which do not start on triangles."""
    o, d = (np.ascontiguousarray(part).reshape(-1, 3) for part in (origins, directions))
    return RayPass(o, d, np.full(directions.size // 3, -1, np.int32))


def camera_pass(rays: ExplicitRays, rows: slice) -> RayPass:
    """The rays through the pixel centres in some rows of a camera's picture."""
    x, y = np.arange(rays.width) + np.float64(0.5), np.arange(rays.height)[rows, None] + np.float64(0.5)
    return listed_pass(*rays.through(x, y))


class Passes(NamedTuple):
    """The samples of all passes: directions of diffuse rays, and light samples for the surfaces they meet."""

    directions: np.ndarray  # (n, 4, 4, 3) float64, on the hemisphere; repeated over the picture
    lights: list[list[np.ndarray]]  # per light and pass: (16, k, 3) float64, as from `light_samples`


def diffuse_passes(lights: Sequence[Light], n: int, sampler: str, seed: int = 0) -> Passes:
    """The samples of n passes of diffuse rays, 1 to 1024, with cosine density; each ray end tests one sample per light.

    A random permutation, different for each set and seed, pairs light samples with directions. Without it, samples with
    equal indices would lie in corresponding places of the light and of the hemisphere. For `PointLights` each pass
    tests all lights, or all lights of a set.

    Raises
    ------
    InputError
        If n is out of range, the sampler is unknown, or a light scales ambient light or is itself bounced light.
    """
    n = whole_number(n, "bounce", 1, MAX_SPP)
    for light in lights:
        name = type(light).__name__
        if light.domain == "hemisphere":
            raise InputError(f"{name} dims the ambient light that bounce replaces; leave one of them out")
        if is_indirect(light):
            raise InputError(f"{name} with indirect=True and bounce both add bounced light; leave one of them out")
    directions = domain_sets(n, sampler, "hemisphere", seed)
    return _passes(directions, [_pass_samples(light, n, sampler, (SEED,), seed) for light in lights])


def path_passes(
    lights: Sequence[Light], n: int, sampler: str, length: int, seed: int = 0, first: int = 0
) -> list[Passes]:
    """The samples of n paths of `length` diffuse rays: the passes of each ray along the paths, from the `first` on.

    Each ray and light has shifts and a permutation of its own for each seed, so that the mean over seeds covers all
    combinations of samples along a path.
    """
    of_rays = []
    for k in range(first, length):
        directions = domain_sets(n, sampler, "hemisphere", seed, k)
        directions = directions if k == 0 else _shuffled(directions, (SEED, k), seed)
        samples = [_pass_samples(light, n, sampler, (SEED, k, i), seed) for i, light in enumerate(lights)]
        of_rays.append(_passes(directions, samples))
    return of_rays


def _passes(directions: NDArray[np.float64], lights: list[list[np.ndarray]]) -> Passes:
    """`Passes` with directions (16, n, 3)."""
    # Eq. (1) of docs/design/sampling.md: pixel (x, y) uses the set of row y mod 4 and column x mod 4
    of_pass = directions.transpose(1, 0, 2).reshape(-1, 4, 4, 3)
    return Passes(np.ascontiguousarray(of_pass), lights)


def _pass_samples(light: Light, n: int, sampler: str, place: tuple[int, ...], seed: int) -> list[NDArray[np.float64]]:
    """The samples of a light per pass, (16, k, 3) float64."""
    samples = light_samples(light, n, sampler, seed)
    if light.domain == "list":
        return [samples] * n
    return list(np.ascontiguousarray(_shuffled(samples, place, seed).transpose(1, 0, 2)[:, :, None]))


def _shuffled(samples: NDArray[np.float64], place: tuple[int, ...], seed: int) -> NDArray[np.float64]:
    """Sample sets, (16, n, 3), in another order, and each with its samples in another order.

    A net has its samples in the same cells for all seeds, so the order must differ between them.
    """
    rng = np.random.default_rng((*place, seed))
    order = rng.permuted(np.tile(np.arange(samples.shape[1]), (N_SETS, 1)), axis=1)  # (16, n)
    return np.asarray(samples[rng.permutation(N_SETS)[:, None], order])


@kernel
def _direction_rows(ticket, normals, sides, samples, out):
    zero, one = np.float64(0.0), np.float64(1.0)
    h, w = samples.shape[:2]
    for y in items(ticket):
        for x in range(sides.shape[1]):
            d = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            if sides[y, x] != NOTHING:
                nx, ny, nz = normals[y, x, 0], normals[y, x, 1], normals[y, x, 2]
                around = hemisphere(zero, zero, zero, np.float64(nx), np.float64(ny), np.float64(nz), one)
                a, b, c = samples[y % h, x % w, 0], samples[y % h, x % w, 1], samples[y % h, x % w, 2]
                d = sample_point(around, a, b, c)
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = d


def diffuse_rays(
    gbuffer: GBuffer, origins: NDArray[np.float32], samples: NDArray[np.float64], threads: int | None = None
) -> RayPass:
    """One diffuse ray from each surface in a G-buffer.

    origins : (H, W, 3) float32, receivers on the surfaces
    samples : (h, w, 3) float64, points of the unit hemisphere; pixel (x, y) uses entry [y mod h, x mod w]
    """
    directions = np.empty_like(origins)
    ticket = new_ticket(len(directions), 8)
    run(_direction_rows, thread_count(threads), ticket, gbuffer.normal, gbuffer.side, samples, directions)
    return RayPass(origins.reshape(-1, 3), directions.reshape(-1, 3), gbuffer.face.reshape(-1))


# --- Camera rays of selected pixels -----------------------------------------------------------------------------------


@kernel
def _directions(ticket, pixels, rays, directions):
    for i in items(ticket):
        d = pixel_direction(rays, pixels[i, 1], pixels[i, 0])
        directions[i, 0], directions[i, 1], directions[i, 2] = d


def rays_through(rays: CameraRays | ExplicitRays, mask: NDArray[np.bool_], threads: int | None = None) -> RayPass:
    """The rays through the centres of the pixels that are True in `mask`, (H, W) bool, row by row."""
    if isinstance(rays, ExplicitRays):
        return RayPass(*(part[mask.reshape(-1)] for part in camera_pass(rays, slice(0, rays.height))))
    pixels = np.ascontiguousarray(np.argwhere(mask))
    m = len(pixels)
    directions = np.empty((m, 3), np.float32)
    run(_directions, thread_count(threads), new_ticket(m, 4096), pixels, rays, directions)
    origins = np.broadcast_to(rays.origin.astype(np.float32), (m, 3)).copy()
    return RayPass(origins, directions, np.full(m, -1, np.int32))


# --- The ground plane -------------------------------------------------------------------------------------------------


_FAR = 40.0  # extent of the ground, in radii of the scene
_FADE_START = 0.5  # fraction of this distance at which shadows start to fade, so that the ground has no visible border


class GroundPlane(NamedTuple):
    """A level plane in the recentred frame of a scene, visible from above and up to a distance."""

    axis: int  # the axis that points up: 1 or 2
    height: float
    x: float  # the centre of the scene, on the two level axes
    y: float
    radius: float


class GroundHits(NamedTuple):
    """Points where rays meet the ground."""

    gbuffer: GBuffer  # without faces; its side is 1 where the ground is visible
    origins: np.ndarray  # (H, W, 3) float32: receivers, as from `point_receivers`
    kept: np.ndarray  # (H, W) float32: shadow strength: 1 near the scene, 0 where the ground ends


def plane_below(box: np.ndarray, up: str, height: float) -> GroundPlane:
    """The ground plane of a scene.

    box : (2, 3), bounds of the scene in its recentred frame
    height : of the plane, in the same frame
    """
    lower, upper = box.astype(np.float64)
    radius = max(float(length(upper - lower)) / 2.0, float(np.finfo(np.float32).tiny))
    axis = "xyz".index(up)
    x, y = np.delete((lower + upper) / 2.0, axis).tolist()
    return GroundPlane(axis, float(np.float32(height)), x, y, _FAR * radius)


class _PlaneHits(NamedTuple):
    """The hits of rays on a plane, one row per pixel."""

    position: np.ndarray  # (n, 3) float32
    normal: np.ndarray  # (n, 3) float32
    depth: np.ndarray  # (n,) float32
    side: np.ndarray  # (n,) int8
    origins: np.ndarray  # (n, 3) float32
    strength: np.ndarray  # (n,) float32


@kernel
def _hit_plane(ticket, plane, rays, pixels, hits):
    """Worker: write the hits of rays on the plane to their pixels."""
    # In: plane, `GroundPlane`; rays, `RayPass`; pixels, (m,) int64, of the rays. Out: hits, `_PlaneHits`
    up = plane.axis
    a, b = (0, 3 - up) if up != 0 else (1, 2)
    for i in items(ticket):
        above, falls = np.float64(rays.origins[i, up]) - plane.height, -np.float64(rays.directions[i, up])
        if not (above > 0.0 and falls > 0.0):
            continue
        t, k = above / falls, pixels[i]
        p = np.float32(np.float64(rays.origins[i, a]) + t * np.float64(rays.directions[i, a]))
        q = np.float32(np.float64(rays.origins[i, b]) + t * np.float64(rays.directions[i, b]))
        dx, dy = np.float64(p) - plane.x, np.float64(q) - plane.y
        away = np.sqrt(dx * dx + dy * dy) / plane.radius
        if not away < 1.0:
            continue
        height = np.float32(plane.height)
        hits.position[k, a], hits.position[k, b], hits.position[k, up] = p, q, height
        # Eq. (2) of docs/design/receivers.md
        shift = SHIFT * np.float64(max(abs(p), abs(q), abs(height)))
        hits.origins[k, a], hits.origins[k, b], hits.origins[k, up] = p, q, np.float32(np.float64(height) + shift)
        hits.normal[k, up], hits.depth[k], hits.side[k] = np.float32(1.0), np.float32(t), np.int8(1)
        x = max((away - _FADE_START) / (1.0 - _FADE_START), 0.0)
        hits.strength[k] = np.float32(1.0 - x * x * (3.0 - 2.0 * x))


def ground_hits(
    plane: GroundPlane,
    rays: RayPass,
    mask: NDArray[np.bool_],
    origin: NDArray[np.float64],
    threads: int | None = None,
) -> GroundHits:
    """The points where rays meet the ground.

    rays : rays of the pixels that are True in `mask`, (H, W) bool, which meet no surface
    origin : (3,) float64, world position of the frame's origin
    """
    shape = mask.shape
    position, normal, origins = (np.zeros((*shape, 3), np.float32) for _ in range(3))
    depth, side = np.full(shape, np.inf, np.float32), np.full(shape, NOTHING, np.int8)
    strength = np.zeros(shape, np.float32)
    ticket, pixels = new_ticket(len(rays.origins), 4096), np.flatnonzero(mask)
    hits = _PlaneHits(
        position.reshape(-1, 3), normal.reshape(-1, 3), depth.reshape(-1), side.reshape(-1), origins.reshape(-1, 3),
        strength.reshape(-1),
    )  # fmt: skip
    run(_hit_plane, thread_count(threads), ticket, plane, rays, pixels, hits)
    return GroundHits(GBuffer(position, normal, np.full(shape, -1, np.int32), depth, side, origin), origins, strength)
