"""Random lights of a frame: suns and spheres that light what its camera sees.

A light depends only on the scene, the seed, its number and the frame's camera. `RULE` states how it is drawn.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.small_matrices import length
from ..query.receivers import point_receivers
from ..scene.camera import Camera
from ..scene.lights import DirectionalLight, Light, SphereLight
from .random_views import LIGHT_SIZES, SamplingRegion, random_sun

MIN_LIT = 0.1
"""Least share of the surfaces that a camera sees whose light from a random light is not blocked."""

TRIES = 64
"""Maximum number of lights tried of each kind; then the one that lights the most is taken."""

RULE = (
    "Light k of frame f is drawn from the seed, k and f. If k is even: a sun 10 to 80 degrees high. If k is odd, or if "
    f"none of {TRIES} suns lights {MIN_LIT:.0%} of the surfaces that the camera sees: a sphere in free space, at a "
    f"random share of the way from the camera to one of these surfaces, which lights {MIN_LIT:.0%} of them. If {TRIES} "
    "spheres light less, the light that lights the most. A sphere gives pi lux at the median distance of the surfaces."
)
"""How `frame_light` draws lights, for manifests."""

_LIGHT = 3  # stream of random numbers
_PROBE = 16  # rays across and down a view
_NEAREST, _FARTHEST = 0.1, 0.9  # shares of the way to a surface at which spheres are placed


class SeenSurfaces(NamedTuple):
    """Points on the surfaces that a camera sees, at the centres of a grid of its pixels."""

    eye: NDArray[np.float64]  # (3,) world
    points: NDArray[np.float64]  # (n, 3) world, moved off their faces
    normals: NDArray[np.float64]  # (n, 3), towards the camera
    faces: NDArray[np.int32]  # (n,)


def seen_surfaces(region: SamplingRegion, camera: Camera) -> SeenSurfaces:
    """The `SeenSurfaces` of a camera."""
    gbuffer = region.scene.engine.surfaces(camera.resized(_PROBE, _PROBE), region.time)
    seen = gbuffer.face >= 0
    position, normal = (part[seen].astype(np.float64) for part in (gbuffer.position, gbuffer.normal))
    points = point_receivers(position, normal, position, single=False).astype(np.float64) + gbuffer.origin
    return SeenSurfaces(np.asarray(camera.position, np.float64), points, normal, gbuffer.face[seen])


def frame_light(region: SamplingRegion, seen: SeenSurfaces, seed: int, k: int, frame: int) -> Light:
    """Random light k of a frame whose camera sees these surfaces; see `RULE`."""
    rng = np.random.default_rng([seed, _LIGHT, k, frame])
    best, most = None, -1.0
    for kind in ("sun", "sphere")[k % 2 :]:
        for _ in range(TRIES):
            light = random_sun(region, rng) if kind == "sun" else _sphere_in_view(region, seen, rng)
            share = lit_share(region, seen, light) if light is not None else -1.0
            if share >= MIN_LIT:
                assert light is not None
                return light
            if light is not None and share > most:
                best, most = light, share
    return random_sun(region, rng) if best is None else best


def lit_share(region: SamplingRegion, seen: SeenSurfaces, light: Light) -> float:
    """The share of seen surfaces that face the centre of a light, and from which nothing blocks it."""
    if not len(seen.points):
        return 0.0
    if isinstance(light, DirectionalLight):
        towards, tmax = np.broadcast_to(-light.direction, seen.points.shape), np.inf
    else:
        assert isinstance(light, SphereLight)
        towards, tmax = light.center - seen.points, 1.0
    facing = np.flatnonzero((seen.normals * towards).sum(1) > 0.0)
    blocked = region.scene.occluded(
        seen.points[facing], towards[facing], 0.0, tmax, seen.faces[facing], region.time, threads=region.threads
    )
    return float(np.count_nonzero(~blocked)) / len(seen.points)


def _sphere_in_view(region: SamplingRegion, seen: SeenSurfaces, rng: np.random.Generator) -> SphereLight | None:
    """A sphere on the way from the camera to a surface that it sees; None if there is no room for it."""
    if not len(seen.points):
        return None
    target, share = seen.points[rng.integers(len(seen.points))], rng.uniform(_NEAREST, _FARTHEST)
    centre, size = seen.eye + share * (target - seen.eye), region.radius * rng.uniform(*LIGHT_SIZES)
    size = min(size, 0.5 * float(length(target - centre)))
    if region.walled(centre, size):
        return None
    distance = float(np.median(length(seen.points - centre)))
    return SphereLight(centre, size, intensity=float(np.pi * distance**2))
