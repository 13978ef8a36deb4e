"""Packets through the wide BVH: the bits of `single`, whatever the light and however the rays of a tile differ."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.method_registry import TRACERS
from antumbra.engine.plan import Plan, parse_plan
from antumbra.trace.counters import as_dict, new_counters
from asking import answer, query_of

NAMES = "wide", "wide:samples"
AROUND = np.random.default_rng(3).normal((0, 3, 0), 4, (20, 3))
LIGHTS = {
    "wide overhead": at.QuadLight((-4, 8, -4), (8, 0, 0), (0, 0, 8)),
    "small": at.QuadLight((-1, 7, -1), (0.2, 0, 0), (0, 0, 0.2)),
    "sun": at.DirectionalLight((0.3, -1, 0.2), 10.0),
    "sky": at.AmbientOcclusion(3.0),
    "scattered": at.PointLights(AROUND, interleave=True),
}


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=3000)


@pytest.mark.parametrize("facing", [0, 1])
@pytest.mark.parametrize("spp", [1, 3, 5, 16, 37])
@pytest.mark.parametrize("light", LIGHTS)
def test_bits_are_those_of_single_rays(scene, light, spp, facing):
    triangles, query = query_of(scene, scene.cameras[0].resized(43, 30), LIGHTS[light], spp)
    query = query._replace(cull_faces=facing)
    truth = answer(Plan(), triangles, query)
    assert truth.any() and not truth.all()
    for name in NAMES:
        np.testing.assert_array_equal(answer(Plan(trace=name), triangles, query), truth)


@pytest.mark.parametrize("spp", [2, 16])
def test_receivers_in_a_row_have_the_bits_of_single_rays(scene, spp):
    points = np.random.default_rng(4).uniform((-6, 0.1, -4), (6, 5, 4), (501, 3))
    truth = at.visibility(scene, points, LIGHTS["wide overhead"], spp=spp, plan="bsah+single").bits
    for name in NAMES:
        found = at.visibility(scene, points, LIGHTS["wide overhead"], spp=spp, plan=f"bsah+{name}").bits
        np.testing.assert_array_equal(found, truth)
    assert 0 < np.count_nonzero(truth) < len(points)


def test_the_rays_of_a_tile_share_nodes():
    """In a forest, neighbouring pixels are far apart, but the rays of one pixel are not."""
    scene, nodes = at.procedural("forest", triangles=10_000), {}
    triangles, query = query_of(scene, scene.cameras[0].resized(64, 48), scene.lights[0], 16)
    for name in (*NAMES, "packet16"):
        counters = new_counters()
        answer(parse_plan(f"bsah+{name}"), triangles, query, counters=counters)
        nodes[name] = as_dict(counters)["nodes"]
    assert nodes["wide:samples"] < nodes["wide"] < nodes["packet16"] / 2


def test_single_samples_of_neighbouring_tiles_share_nodes():
    scene, nodes = at.procedural("atrium", triangles=10_000), {}
    triangles, query = query_of(scene, scene.cameras[0].resized(64, 48), at.PointLight((0, 7, 0)), 1)
    for name in ("wide", "packet16"):
        counters = new_counters()
        answer(parse_plan(f"bsah+{name}"), triangles, query, counters=counters)
        nodes[name] = as_dict(counters)["nodes"]
    assert 0 < nodes["wide"] < nodes["packet16"] / 8


def test_both_are_strategies_of_one_form():
    assert [TRACERS[name].form for name in NAMES] == [TRACERS["wide"].form] * 2
    assert all(TRACERS[name].cost is not None for name in NAMES)
