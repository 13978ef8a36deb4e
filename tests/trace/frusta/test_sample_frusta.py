"""Frusta of 16 receivers and one light sample give the bits of single rays, and visit fewer nodes than packets."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import binned_sah
from antumbra.bvh.nodes import boxes_of
from antumbra.engine.method_registry import TRACERS
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


def test_interleaved_lists_of_lights_suit_frusta_of_light_samples(pillars):
    triangles, gbuffer, bvh = pillars
    box = boxes_of(bvh.nodes[:1])[0]
    suited = {
        name
        for name, light in LIGHTS.items()
        for query in shadow_queries(triangles, gbuffer, [light], [light_samples(light, 16)])
        if TRACERS["multifrusta:by-sample"].suits(query, box)
    }
    assert suited == {"interleaved lights", "sky"}


@pytest.mark.parametrize("name", LIGHTS)
def test_known_blocked_segments_remain_and_the_others_are_traced(pillars, name):
    triangles, gbuffer, bvh = pillars
    query = shadow_queries(triangles, gbuffer, [LIGHTS[name]], [light_samples(LIGHTS[name], 16)])[0]
    tracer, half, both = TRACERS["multifrusta:by-sample"], new_bits(query), new_bits(query)
    tracer.trace(tracer.prepare(bvh), query, both, 1)
    half[...] = both
    half[::2] = 0
    own_surfaces = new_bits(query)
    empty = binned_sah.build(np.full((1, 3, 3), 1e6, np.float32))
    tracer.trace(tracer.prepare(empty), query, own_surfaces, 1)
    known = half | own_surfaces
    assert (known != both).any() and (known != own_surfaces).any()
    tracer.trace(tracer.prepare(bvh), query, known, 1, fresh=False)
    np.testing.assert_array_equal(known, both)


def answers(pillars, light, facing):
    """Bits and counts of tracers by name."""
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
