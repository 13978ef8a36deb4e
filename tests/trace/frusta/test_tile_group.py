"""Tile groups: many tiles are traced together towards a large light, with the bits of single rays for any light."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.accelerator import Accelerator
from antumbra.engine.method_registry import TRACERS
from antumbra.engine.plan import parse_plan
from antumbra.query.shadow_query import new_bits
from antumbra.trace.counters import as_dict, new_counters
from asking import answer, query_of, true_occlusion

LIGHTS = {
    "quad": at.QuadLight((-6, 7, -6), (12, 0, 0), (0, 0, 12)),
    "disk": at.DiskLight((0, 7, 0), (0, -1, 0), 7.0),
    "sphere": at.SphereLight((0, 12, 0), 6.0),
    "sun": at.DirectionalLight((0.3, -1, 0.2), angular_diameter=40.0),
}


def _scene(n, size):
    """A floor, and n triangles of a given size above it."""
    rng = np.random.default_rng(n)
    floor = 40 * np.array([[[-1, 0, -1], [1, 0, 1], [1, 0, -1]], [[-1, 0, -1], [-1, 0, 1], [1, 0, 1]]], float)
    over = rng.uniform((-4, 0.2, -4), (4, 5, 4), (n, 1, 3)) + size * rng.normal(size=(n, 3, 3))
    return at.Scene.from_arrays(np.concatenate([floor, over]).reshape(-1, 3), np.arange(3 * n + 6).reshape(-1, 3))


def _query(scene, light, spp, size=(48, 32), vfov=5.0):
    """The query of a camera with a long lens, so that receivers are close together."""
    return query_of(scene, at.Camera((0, 6, 8), (0, 0, 0), vfov=vfov, width=size[0], height=size[1]), light, spp)


def _traced(triangles, query):
    tally = new_counters()
    return answer(parse_plan("bsah+multifrusta"), triangles, query, counters=tally), as_dict(tally)


@pytest.mark.parametrize("n, size", [(40, 0.8), (3000, 0.05)], ids=["few large", "many small"])
@pytest.mark.parametrize("name", LIGHTS)
def test_the_bits_of_single_rays(name, n, size):
    triangles, query = _query(_scene(n, size), LIGHTS[name], 16)
    bits, counts = _traced(triangles, query)
    assert counts["group_tiles"] >= 12 and bits.any() and not bits.all()
    assert (counts["fan_strata"] > 0) == (name == "quad" or name == "disk"), "only lights that stay have fans"
    np.testing.assert_array_equal(bits, answer(parse_plan("bsah+single"), triangles, query))


@pytest.mark.parametrize("n, size", [(60, 0.6), (3000, 0.05)], ids=["few large", "many small"])
@pytest.mark.parametrize("cull_faces", [-1, 1])
def test_culled_faces(cull_faces, n, size):
    triangles, query = _query(_scene(n, size), LIGHTS["quad"], 16)
    query = query._replace(cull_faces=cull_faces)
    bits, counts = _traced(triangles, query)
    assert counts["group_tiles"] >= 12 and counts["fan_strata"] > 0 and bits.any()
    np.testing.assert_array_equal(bits, answer(parse_plan("bsah+single"), triangles, query))


@pytest.mark.parametrize("spp", [9, 24])
def test_the_oracle(spp):
    triangles, query = _query(_scene(60, 0.6), LIGHTS["quad"], spp)
    bits, counts = _traced(triangles, query)
    truth, active = true_occlusion(triangles, query)
    assert counts["group_tiles"] >= 12 and truth.any() and not truth[active].all()
    np.testing.assert_array_equal(bits, truth)


def test_more_undecided_rays_than_there_is_memory_for():
    """The light and the receivers of the whole picture lie in the planes of a triangle's copies: nothing is certain."""
    edge = np.array([[-3.0, 0, 0], [3, 0, 0], [0, 1e-6, 0]])
    vertices = np.concatenate([edge + (0, 0.5, z) for z in np.linspace(-2, 2, 200)])
    floor = 40 * np.array([[-1, 0, -1], [1, 0, 1], [1, 0, -1], [-1, 0, -1], [-1, 0, 1], [1, 0, 1]], float)
    scene = at.Scene.from_arrays(np.concatenate([floor, vertices]), np.arange(606).reshape(-1, 3))
    triangles, query = _query(scene, LIGHTS["quad"], 16)
    bits, counts = _traced(triangles, query)
    assert counts["group_tiles"] >= 12
    np.testing.assert_array_equal(bits, answer(parse_plan("bsah+single"), triangles, query))


def test_a_huge_light_goes_to_packets():
    triangles, query = _query(_scene(40, 0.8), at.QuadLight((-40, 7, -40), (80, 0, 0), (0, 0, 80)), 16)
    bits, counts = _traced(triangles, query)
    assert counts["group_tiles"] == counts["covered"] == 0 and bits.any() and not bits.all()
    np.testing.assert_array_equal(bits, answer(parse_plan("bsah+single"), triangles, query))


def test_auto_traces_shafts_to_a_huge_light_where_it_has_chosen_them():
    """It compares times, which a rule must not replace: the same bits, but by shafts."""
    triangles, query = _query(_scene(40, 0.8), at.QuadLight((-40, 7, -40), (80, 0, 0), (0, 0, 80)), 16)
    accelerated = Accelerator(parse_plan("bsah+multifrusta"), 1).build(triangles)
    bits, by_packets, tally = new_bits(query), new_bits(query), new_counters()
    TRACERS["multifrusta"].trace_suited(accelerated.prepared, query, bits, 1, tally)
    TRACERS["multifrusta"].trace(accelerated.prepared, query, by_packets, 1)
    assert as_dict(tally)["covered"] > 0 and bits.any()
    np.testing.assert_array_equal(bits, by_packets)


@pytest.mark.parametrize("n, size", [(60, 0.6), (3000, 0.05)], ids=["few large", "many small"])
@pytest.mark.parametrize("vfov", [5.0, 40.0])
def test_areas_of_many_tiles(n, size, vfov):
    """A picture so large that a thread takes four regions at once, and tries which groups pay."""
    triangles, query = _query(_scene(n, size), LIGHTS["quad"], 16, (264, 264), vfov)
    tally = new_counters()
    bits = answer(parse_plan("bsah+multifrusta"), triangles, query, threads=1, counters=tally)
    counts = as_dict(tally)
    assert counts["group_tiles"] >= 200 and counts["fan_strata"] > 0 and bits.any() and not bits.all()
    np.testing.assert_array_equal(bits, answer(parse_plan("bsah+packet16"), triangles, query))


@pytest.mark.parametrize("size", [(4100, 4), (4100, 16), (17000, 1), (8, 2100), (530, 130)])
@pytest.mark.parametrize("spp", [1, 16])
def test_areas_cover_pictures_of_any_shape(size, spp):
    """One thread takes four regions at once, in a row of regions too."""
    triangles, query = _query(_scene(60, 0.6), LIGHTS["quad"], spp, size, 10.0)
    bits = answer(parse_plan("bsah+multifrusta"), triangles, query, threads=1)
    assert bits.any() and not bits.all()
    np.testing.assert_array_equal(bits, answer(parse_plan("bsah+packet16"), triangles, query))
