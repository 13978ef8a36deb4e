"""Light that has bounced before it reaches receivers: paths of diffuse rays, with shadow rays where they end.

Irradiance is the sum of a series: term k is the light that has met k surfaces on its way. With radiance L, albedo a and
direct irradiance E at the hits of a path of cosine-weighted rays, its estimate is the mean over the paths of

    pi (L_1 + a_1 (E_1 / pi + L_2) + a_1 a_2 (E_2 / pi + L_3) + ...)

All surfaces scatter diffusely, on both sides; the albedo is the base colour of the face.
Equal seeds give equal directions. Of a light list, such as a sky, each path tests a few entries, and all paths together
test all of them.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.engine import Engine
from ..query.gbuffer import GBuffer
from ..query.light_samples import light_samples
from ..query.ray_passes import SEED, diffuse_rays, path_passes
from ..query.receivers import NOTHING, Receivers, surface_receivers
from ..scene.light_lists import DirectionalLights, LightList
from ..scene.lights import Light
from ..trace.rays.ray_hits import hit_surfaces

Direct = Callable[[Receivers, Sequence[Light], Sequence[NDArray[np.float64]]], NDArray[np.float32]]
"""A function of receivers, lights and their samples, which returns the direct irradiance, (h, w, 3) float32."""


class _Step(NamedTuple):
    """One ray along a path: its direction, and the light at its end."""

    directions: NDArray[np.float64]  # (4, 4, 3), on the hemisphere; repeated over the receivers
    lights: list[Light]
    samples: list[NDArray[np.float64]]  # of each light, (16, k, 3)


class Bounces:
    """Measures bounced light in one scene.

    Parameters
    ----------
    engine : Engine
    bounces : int
        The largest number of surfaces that light meets on its way; at least 1.
    lights, spp, sampler
        As of the direct light; `spp` is the number of paths.
    emission : (n, 3) float32 or None
        Radiance of each face of the scene, on both sides. None: no face emits light.
    time, seed
        As in `antumbra.bake`.
    """

    def __init__(
        self,
        engine: Engine,
        bounces: int,
        lights: Sequence[Light],
        spp: int,
        sampler: str,
        emission: NDArray[np.float32] | None,
        time: float,
        seed: int = 0,
    ):
        self._engine, self._bounces, self._emission, self._time = engine, bounces, emission, time
        length = bounces + (emission is not None)  # emitted light that has met `bounces` surfaces
        self._paths = _paths(lights, spp, sampler, length, seed)
        shadow_rays = sum(s.shape[1] for path in self._paths for step in path[:bounces] for s in step.samples)
        self.rays_each = spp * length + shadow_rays

    def irradiance(self, receivers: Receivers, direct: Direct) -> NDArray[np.float32]:
        """(h, w, 3) float32: the irradiance of receivers from bounced and emitted light; 0 where there is none."""
        radiance = np.zeros((*receivers.sides.shape, 3))
        for path in self._paths:
            radiance += self._along(path, receivers, direct)
        return np.asarray(np.pi / len(self._paths) * radiance, np.float32)

    def _along(self, path: list[_Step], receivers: Receivers, direct: Direct) -> NDArray[np.float64]:
        """(h, w, 3) float64: the radiance that arrives along a path of each receiver."""
        shape = receivers.sides.shape
        radiance, share, skip = np.zeros((*shape, 3)), np.ones((*shape, 3)), np.full(shape, -1, np.int32)
        for bounce, step in enumerate(path):
            receivers, skip, albedo = self._next(receivers, step.directions, skip)
            if not receivers.sides.any():
                break
            if self._emission is not None:
                radiance += np.where((skip >= 0)[..., None], share * self._emission[skip], 0.0)
            share = share * albedo
            if bounce < self._bounces:
                radiance += share * (1.0 / np.pi) * direct(receivers, step.lights, step.samples)
        return radiance

    def _next(
        self, receivers: Receivers, directions: NDArray[np.float64], skip: NDArray[np.int32]
    ) -> tuple[Receivers, NDArray[np.int32], NDArray[np.float32]]:
        """The surfaces that one diffuse ray of each receiver meets.

        skip : (h, w) int32: the faces of the receivers, or -1

        Returns
        -------
        Receivers
            On the sides that the rays come from.
        (h, w) int32
            Their faces in the scene; -1: none.
        (h, w, 3) float32
            Their base colours; 0 where there is none.
        """
        engine, data, shape = self._engine, self._engine.data, receivers.sides.shape
        normals, zero = receivers.normals.astype(np.float32), np.zeros(shape, np.float32)
        rays = diffuse_rays(
            GBuffer(receivers.origins, normals, skip, zero, receivers.sides, data.origin),
            receivers.origins, directions, engine.threads,
        )  # fmt: skip
        alive = np.flatnonzero(receivers.sides != NOTHING)
        face, index, t = np.full(zero.size, -1, np.int32), np.full(zero.size, -1, np.int32), np.full(zero.size, np.inf)
        world = rays.origins[alive].astype(np.float64) + data.origin
        hit = engine.closest_hit(world, rays.directions[alive], skip_face=rays.skip[alive], time=self._time)
        triangles, index[alive] = hit.surfaces()
        face[alive], t[alive] = hit.face, hit.t
        surfaces = hit_surfaces(rays, index, t, shape, triangles, engine.threads)
        corners = triangles.vertices.reshape(-1, 9)
        flat = surfaces.position.reshape(-1, 3), surfaces.normal.reshape(-1, 3), index, surfaces.side.reshape(-1)
        origins = surface_receivers(*flat, corners, engine.threads).reshape(*shape, 3)
        there = (index >= 0).reshape(shape)
        met = Receivers(origins, there.astype(np.int8), surfaces.normal.astype(np.float64))
        colours = np.zeros((zero.size, 3), np.float32)
        colours[index >= 0] = triangles.colour[index[index >= 0]]
        return met, face.reshape(shape), colours.reshape(*shape, 3)


def _paths(lights: Sequence[Light], spp: int, sampler: str, length: int, seed: int) -> list[list[_Step]]:
    """The steps of `spp` paths."""
    of_steps = []
    for k, passes in enumerate(path_passes(lights, spp, sampler, length, seed)):
        chosen = [_entries(light, spp, (SEED, k, i, seed)) for i, light in enumerate(lights)]
        of_steps.append(
            [
                _Step(
                    passes.directions[p],
                    [of_light[p] for of_light in chosen],
                    [
                        light_samples(of_light[p], 1) if isinstance(light, LightList) else passes.lights[i][p]
                        for i, (light, of_light) in enumerate(zip(lights, chosen))
                    ],
                )
                for p in range(spp)
            ]
        )
    return [list(steps) for steps in zip(*of_steps)]


def _entries(light: Light, n: int, seed: tuple[int, ...]) -> list[Light]:
    """The light that each of n paths tests; of a list of distant lights, some of its entries, scaled for the others."""
    if not isinstance(light, LightList):
        return [light] * n
    order = np.random.default_rng(seed).permutation(len(light.points))
    rows = [order[p::n] if len(order) >= n else order[p % len(order), None] for p in range(n)]
    share = n / np.bincount(np.concatenate(rows), minlength=len(order))
    intensities, tint = light.intensity * share * light.intensities, np.asarray(light.colour)
    return [DirectionalLights(-light.points[row], intensities[row], light.colours[row] * tint) for row in rows]
