"""Faces that let light pass, and copies of meshes, on a device: parts `cutouts` and `copies` of benchmarks/device.py.

Scenes, with about --triangles triangles:

- `cutouts`: leaves with holes, and coloured panes, above a floor
- `copies`: turned and scaled copies of a mesh of 2,000 triangles

Cases: `random` and `closest` as in device.py; `light`: what arrives from a light's samples at points, with its
transmittance, from points on the host to shares on the host. Rays are on the host, and so are the answers.
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

import antumbra
from antumbra.engine.engine import Engine
from antumbra.scene.alpha_masks import AlphaMask, cutouts_of
from antumbra.scene.materials import CLAMP, REPEAT

MESH = 2000
"""Triangles of the mesh that is copied."""


class Measures(NamedTuple):
    """How device.py measures: its functions, and options."""

    timed: Callable[[Callable[[], Any], int], Any]
    row: Callable[..., dict[str, Any]]
    rounds: int
    threads: int


def leaves(n: int) -> antumbra.Scene:
    """A scene of n triangles: three quarters have holes in half of their texels, a sixteenth are panes."""
    rng = np.random.default_rng(5)
    size = (n / 64) ** (1 / 3)
    cards = rng.uniform(0, size, (n, 1, 3)) + rng.normal(0, 0.2, (n, 3, 3))
    scene = antumbra.Scene.from_arrays(cards, name="leaves")
    holes = AlphaMask(np.uint8(rng.random((64, 64)) < 0.5), np.array([[1.0] * 3, [0.0] * 3]), (REPEAT, REPEAT))
    pane = AlphaMask(np.zeros((1, 1), np.uint8), np.array([[0.8, 0.7, 0.5]]), (CLAMP, CLAMP))
    mask = np.where(np.arange(n) % 16 < 12, 0, np.where(np.arange(n) % 16 == 12, 1, -1)).astype(np.int32)
    scene.data.cutouts = cutouts_of(rng.uniform(0, 4, (n, 3, 2)).astype(np.float32), mask, [holes, pane])
    return scene


def copies(n: int) -> antumbra.Scene:
    """A scene of n triangles in copies of one mesh."""
    rng, k = np.random.default_rng(6), max(n // MESH, 1)
    mesh = rng.normal(size=(MESH, 1, 3)) + rng.normal(0, 0.1, (MESH, 3, 3))
    transforms = np.zeros((k, 3, 4))
    angle, scale = rng.uniform(0, 2 * np.pi, k), rng.uniform(0.5, 2, k)
    transforms[:, 0, 0] = transforms[:, 2, 2] = scale * np.cos(angle)
    transforms[:, 0, 2] = scale * np.sin(angle)
    transforms[:, 2, 0] = -transforms[:, 0, 2]
    transforms[:, 1, 1] = scale
    transforms[:, :, 3] = rng.uniform(0, 4, (k, 3)) * (np.sqrt(k), 1, np.sqrt(k))
    return antumbra.Scene.from_instances([mesh], [transforms], name="copies", instances=True)


SCENES = {"cutouts": leaves, "copies": copies}


def rows(part: str, n: int, options: argparse.Namespace, how: Measures) -> Iterator[dict[str, Any]]:
    """Rows of a part for a number of triangles."""
    scene = SCENES[part](n)
    there, rng = Engine(scene, device=options.device, threads=options.threads), np.random.default_rng(7)
    origins, targets = rng.uniform(*scene.bounds, (2, options.rays, 3)).astype(np.float32)
    points, light = origins[: max(options.rays // options.spp, 1)], _light(scene)

    def blocked(engine: Any) -> Any:
        return engine.occluded(origins, targets=targets, threads=how.threads)

    def nearest(engine: Any) -> Any:
        hit = engine.closest_hit(origins, targets - origins, threads=how.threads)
        return hit.face, hit.t, hit.u, hit.v

    def arriving(engine: Any) -> Any:
        plan = str(there.plan) if engine is there else None
        return antumbra.visibility(scene, points, light, spp=options.spp, plan=plan, threads=how.threads).fraction

    about = {"scene": part, "triangles": scene.n_triangles}
    cases = {"random": (blocked, len(origins)), "closest": (nearest, len(origins))}
    cases["light"] = arriving, len(points) * options.spp
    for name, (ask, rays) in cases.items():
        engines = {"device, host arrays": there, "cpu": scene}
        timings = {method: how.timed(partial(ask, engine), how.rounds) for method, engine in engines.items()}
        for method, timing in timings.items():
            yield how.row({**about, "case": name}, method, timing, rays, timings["cpu"].answers)


def _light(scene: antumbra.Scene) -> antumbra.QuadLight:
    """A light above a scene, half as wide."""
    low, high = np.asarray(scene.bounds)
    x, y, z = high - low
    return antumbra.QuadLight((low[0] + x / 4, high[1] + y, low[2] + z / 4), (x / 2, 0, 0), (0, 0, z / 2))
