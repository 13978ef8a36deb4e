"""Queries with the oracle's answers, computed once for all tests of a process."""

from functools import cache

import numpy as np

import antumbra as at
from asking import query_of, true_occlusion

TRIANGLES = 3000
SIZE = (96, 68)  # pixels; with 16 samples these are more than 100 000 rays


def soup_scene(seed=3):
    rng = np.random.default_rng(seed)
    n = TRIANGLES
    soup = rng.normal(size=(n, 1, 3)) * (2, 1, 2) + rng.normal(size=(n, 3, 3)) * 0.15
    soup[: n // 4] = np.round(soup[: n // 4] * 4) / 4
    floor = np.array([[[-9, -3, -9], [-9, -3, 9], [9, -3, 9]], [[-9, -3, -9], [9, -3, 9], [9, -3, -9]]])
    return at.Scene.from_arrays(np.concatenate([soup, floor]), name="soup")


def _case(name, size):
    if name == "soup":
        scene = soup_scene()
        return scene, at.Camera((0, 2, 9), (0, -0.5, 0), width=size[0], height=size[1]), None
    scene = at.procedural(name, triangles=TRIANGLES)
    return scene, scene.cameras[0].resized(*size), scene.lights[0]


def case_of(name, size):
    scene, camera, light = _case(name, size)
    triangles, query = query_of(scene, camera, light or at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2)), 16)
    truth, active = true_occlusion(triangles, query)
    print(f"{name}: {active.sum()} rays, {truth[active].mean():.1%} occluded")
    assert active.sum() > 7 * size[0] * size[1]
    assert 0.02 < truth[active].mean() < 0.98
    return triangles, query, truth


LIGHTS = {
    "point": at.PointLight((0.5, 5, 0.25)),
    "quad": at.QuadLight((-2, 5, -2), (4, 1, 0), (0, 0, 4)),
    "disk": at.DiskLight((0, 5, 1), (0.2, -1, 0), 1.5),
    "sphere": at.SphereLight((1, 5, 0), 1.0),
    "sphere around everything": at.SphereLight((0, 0, 0), 20.0),
    "sun": at.DirectionalLight((0.3, -1, 0.2)),
    "wide sun": at.DirectionalLight((0.3, -1, 0.2), angular_diameter=60),
    "parallel sun": at.DirectionalLight((0, -1, 0), angular_diameter=0),
    "light inside the geometry": at.QuadLight((-1, -0.5, -1), (2, 0, 0), (0, 0, 2)),
    "ambient": at.AmbientOcclusion(),
    "ambient nearby": at.AmbientOcclusion(0.5, spp=7),
    "list": at.PointLights(np.random.default_rng(1).uniform((-3, 1, -3), (3, 5, 3), (9, 3))),
    "interleaved list": at.PointLights(np.random.default_rng(1).uniform(-3, 5, (37, 3)), interleave=True),
    "suns": at.DirectionalLights(np.random.default_rng(2).normal((0.2, -1, 0), 0.3, (21, 3))),
    "whole sky": at.DirectionalLights(np.random.default_rng(3).normal(size=(40, 3)), interleave=True),
    "light in the floor's plane": at.QuadLight((-1, -3, -1), (2, 0, 0), (0, 0, 2)),
}


@cache
def asked_of(seed, size, light, spp, scale=1.0):
    """(triangles, query, truth, active) of a soup. The oracle answers once, for all plans."""
    scene = soup_scene(seed)
    if scale != 1.0:
        scene = at.Scene.from_arrays(scene.triangles().vertices.astype(np.float64) * scale)
        light = at.QuadLight((-scale, 6 * scale, -scale), (2 * scale, 0, 0), (0, 0, 2 * scale))
    camera = at.Camera((0, 2 * scale, 9 * scale), (0, -0.5 * scale, 0), width=size[0], height=size[1])
    triangles, query = query_of(scene, camera, light, spp)
    return triangles, query, *true_occlusion(triangles, query)
