"""Frusta of 16 receivers and one light sample give the bits of single rays, and visit fewer nodes than packets."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import binned_sah
from antumbra.engine.method_registry import TRACERS, add_plugins
from antumbra.engine.scene import procedural
from antumbra.picture.renderer import Renderer
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import new_bits, shadow_queries
from antumbra.trace.counters import as_dict, new_counters

RNG = np.random.default_rng(1)
LIGHTS = {
    "interleaved lights": at.PointLights(
        np.random.default_rng(1).uniform((-4, 2, -4), (4, 3, 4), (256, 3)), interleave=True
    ),
    "lights for all": at.PointLights(np.random.default_rng(2).uniform((-4, 2, -4), (4, 3, 4), (20, 3))),
    "sky": at.DirectionalLights(-np.abs(RNG.normal(size=(256, 3))), interleave=True),
    "ambient occlusion": at.AmbientOcclusion(),
    "point": at.PointLight((0.5, 2.5, 0.25)),
}
COHERENT = "interleaved lights", "lights for all", "point"


@pytest.fixture(scope="module")
def pillars():
    scene = procedural("atrium", triangles=5000)
    triangles, camera = scene.triangles(), scene.cameras[0].resized(90, 70)
    return triangles, Renderer(scene).see(triangles, camera, None), binned_sah.build(triangles.vertices)


def answers(pillars, light, facing):
    """Bits and counts of tracers by name."""
    add_plugins()
    triangles, gbuffer, bvh = pillars
    query = shadow_queries(triangles, gbuffer, [light], [light_samples(light, 16)], facing)[0]
    found = {}
    for name in "single", "packet16", "multifrusta:by-sample":
        bits, counters = new_bits(query), new_counters()
        TRACERS[name].trace(TRACERS[name].prepare(bvh), query, bits, 1, counters, None)
        found[name] = bits, as_dict(counters)
    return found


@pytest.mark.parametrize("facing", [-1, 0, 1])
@pytest.mark.parametrize("name", LIGHTS)
def test_bits_are_those_of_single_rays(pillars, name, facing):
    found = answers(pillars, LIGHTS[name], facing)
    truth, counts = found["single"]
    assert truth.any() and counts["triangle_tests"] > 0
    for bits, _ in found.values():
        np.testing.assert_array_equal(bits, truth)
    if name in COHERENT:
        assert found["multifrusta:by-sample"][1]["nodes"] < found["packet16"][1]["nodes"]
