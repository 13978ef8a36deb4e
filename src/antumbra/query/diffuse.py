"""Diffuse rays: passes of one ray from each pixel's surface, into the hemisphere around its normal.

One pass is traced at a time [Mattausch et al. 2015, Sec. 5.3]. It takes one sample from each set, so the directions of
neighbouring pixels are similar. Directions are rounded once to float32, so all tracers get the same rays.
"""

from typing import NamedTuple

import numpy as np

from ..checks import whole_number
from ..errors import InputError
from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..scene.light_list import N_SETS
from ..scene.lights import MAX_SPP, is_bounced
from ..scene.listed_rays import ListedRays
from .receivers import NOTHING
from .samples import hemisphere, sample_point
from .sampling import domain_sets, light_samples

SEED = 1
"""Seed of the pairing of directions with light samples."""


class RayPass(NamedTuple):
    """One ray from each of m receivers, pixel by pixel and row by row."""

    origins: np.ndarray  # (m, 3) float32, recentred frame
    directions: np.ndarray  # (m, 3) float32, approximately unit length; zero: no ray, counts as a miss
    skip: np.ndarray  # (m,) int32, the triangle under the origin, which is not tested; -1: none


def listed_pass(origins: np.ndarray, directions: np.ndarray) -> RayPass:
    """The rays of a picture's pixels, (..., 3) float32 each, which start on no triangle."""
    rays = (np.ascontiguousarray(part).reshape(-1, 3) for part in (origins, directions))
    return RayPass(*rays, np.full(directions.size // 3, -1, np.int32))


def camera_pass(rays: ListedRays, rows: slice) -> RayPass:
    """The rays through the centres of some rows of a camera's pixels."""
    x, y = np.arange(rays.width) + 0.5, np.arange(rays.height)[rows, None] + 0.5
    return listed_pass(*rays.through(x, y))


class Passes(NamedTuple):
    """The samples of all passes: directions of the diffuse rays, and light samples for the surfaces they meet."""

    directions: np.ndarray  # (n, 4, 4, 3) float64, on the hemisphere; repeated over the picture
    lights: list[list[np.ndarray]]  # per light and pass: (16, k, 3) float64, as from `light_samples`


def diffuse_passes(lights, n: int, sampler: str) -> Passes:
    """The samples of n passes of diffuse rays, 1 to 1024, with cosine density; each ray end tests one sample per light.

    Light samples are paired with directions by a random permutation, a different one for each set. Without it, samples
    with equal numbers would lie in corresponding places of the light and of the hemisphere. For `PointLights` each pass
    tests all lights, or all lights of a set.

    Raises
    ------
    InputError
        If n is out of range or the sampler is unknown. If a light scales ambient light, or is itself bounced light.
    """
    n = whole_number(n, "bounce", 1, MAX_SPP)
    for light in lights:
        name = type(light).__name__
        if light.domain == "hemisphere":
            raise InputError(f"{name} dims the ambient light that bounce replaces; leave one of them out")
        if is_bounced(light):
            raise InputError(f"{name} with indirect=True and bounce are both light that has bounced; leave one out")
    # Eq. (1) of docs/design/sampling.md: pixel (x, y) uses the set of row y mod 4 and column x mod 4
    directions = domain_sets(n, sampler, "hemisphere").transpose(1, 0, 2).reshape(n, 4, 4, 3)
    return Passes(np.ascontiguousarray(directions), [_of_passes(light, n, sampler) for light in lights])


def _of_passes(light, n: int, sampler: str) -> list[np.ndarray]:
    """The samples of a light in each pass, (16, k, 3) float64."""
    samples = light_samples(light, n, sampler)
    if light.domain == "list":
        return [samples] * n
    rng = np.random.default_rng(SEED)
    order = rng.permuted(np.tile(np.arange(n), (N_SETS, 1)), axis=1)  # (16, n)
    mixed = samples[rng.permutation(N_SETS)[:, None], order]
    return list(np.ascontiguousarray(mixed.transpose(1, 0, 2)[:, :, None]))


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


def diffuse_rays(gbuffer, origins: np.ndarray, samples: np.ndarray, threads=None) -> RayPass:
    """One diffuse ray from each surface in a G-buffer.

    origins : (H, W, 3) float32, the receivers of its surfaces
    samples : (h, w, 3) float64, points of the unit hemisphere; pixel (x, y) uses entry [y mod h, x mod w]
    """
    directions = np.empty_like(origins)
    ticket = new_ticket(len(directions), 8)
    run(_direction_rows, thread_count(threads), ticket, gbuffer.normal, gbuffer.side, samples, directions)
    return RayPass(origins.reshape(-1, 3), directions.reshape(-1, 3), gbuffer.face.reshape(-1))
