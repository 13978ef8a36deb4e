"""The stages of tracing on devices: where lists are too short, rays are traced again, and at last by the CPU."""

import numpy as np
import pytest

from antumbra.bvh import binned_sah
from antumbra.query.ray_list import HitFilter, rays_of
from antumbra.trace.device.device_stages import CAPACITIES, Capacities
from antumbra.trace.device.device_tracer import DeviceTracer
from devices import DEVICES, opened
from truths import soup_scene

TINY = Capacities(pairs=24, records=8, least=4)
"""Lists that a few hostile rays fill."""

WAYS = {CAPACITIES: (False, False), TINY: (True, False), TINY._replace(least=10_000): (False, True)}
"""Capacities -> whether rays are traced again there, and whether the CPU traces them."""


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return opened(request.param)


def rays_through_corners(scene, n):
    """(origins, directions): half of them through corners of triangles."""
    rng, (low, high) = np.random.default_rng(1), np.asarray(scene.bounds)
    origins, targets = (low + rng.random((n, 3)) * (high - low) for _ in range(2))
    targets[::2] = scene.triangles().vertices[rng.integers(0, scene.n_triangles, n)[::2], 0] + scene.origin
    return origins, targets - origins


@pytest.mark.parametrize("any_hit", [True, False])
@pytest.mark.parametrize("capacities", WAYS, ids=["large lists", "tiny lists", "no rounds"])
def test_rays_that_find_the_list_full_are_traced_again_and_at_last_by_the_cpu(device, capacities, any_hit, monkeypatch):
    scene, tracer, calls = soup_scene(3), DeviceTracer(device, capacities), []
    for name in "_round", "_trace_on_cpu":
        stage = getattr(tracer, name)
        monkeypatch.setattr(tracer, name, lambda *args, stage=stage, name=name: (calls.append(name), stage(*args))[1])
    origins, directions = rays_through_corners(scene, 600)
    rays = rays_of(origins, directions, HitFilter(), tuple(scene.origin.tolist()), scene.n_triangles, None)
    hits = tracer.trace_rays(tracer.tree(binned_sah.build(scene.triangles().vertices, 2)), rays, any_hit, 2)
    found = hits.blocked if any_hit else hits.face >= 0
    np.testing.assert_array_equal(found, scene.occluded(origins, directions))
    assert found.any() and not found.all()
    assert (calls.count("_round") > 1, "_trace_on_cpu" in calls) == WAYS[capacities]
