"""The precise cone test accepts a subset of the cones that the sphere test accepts, so it never tests more nodes."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import antumbra as at
from antumbra.lab.papers.ray_hierarchy.cone_hierarchy import Cones, with_culling
from antumbra.lab.papers.ray_hierarchy.ray_hierarchy_views import open_view
from antumbra.picture.renderer import Renderer
from antumbra.techniques.culling.pre_bvh_culling import soup_of
from antumbra.techniques.rayhierarchy.light_beams import beams_of
from antumbra.techniques.rayhierarchy.ray_hierarchy import trace_shadow
from antumbra.techniques.tracer_options import RayHierarchyOptions
from antumbra.trace.counters import as_dict, new_counters
from beam_scenes import LIGHTS, RECEIVERS, beside_a_small_light, lit, on_surfaces
from hierarchies import hierarchy, points_query, said, triangles_of
from scenes import scene_path
from strength import examples

ROUND = list(LIGHTS)[:5]  # lights whose beams have an apex, and so cones


def traced(triangles, query, **options):
    """(bits, counters) of a traversal by cones."""
    h, w = query.sides.shape
    bits, tally = np.zeros((h, w, -(-query.samples.shape[1] // 64)), np.uint64), new_counters()
    trace_shadow(soup_of(triangles), query, bits, 1, tally, None, RayHierarchyOptions(nodes=Cones, **options))
    return bits, as_dict(tally)


def compared(triangles, query, **options):
    """(nodes tested by the precise test, by the sphere test); checks counts and bits."""
    (bits, precise), (others, spheres) = (traced(triangles, query, spheres=s, **options) for s in (False, True))
    np.testing.assert_array_equal(bits, others)
    assert precise["nodes"] <= spheres["nodes"] and precise["candidates"] <= spheres["candidates"]
    return precise["nodes"], spheres["nodes"]


@examples(25)
@given(
    seed=st.integers(0, 2**32 - 1),
    light=st.sampled_from(ROUND),
    receivers=st.sampled_from(list(RECEIVERS)),
    scale=st.sampled_from([1.0, 1e-6, 1e6, 1e-30, 1e30]),
    small=st.booleans(),
)
def test_each_cone_that_the_precise_test_accepts_meets_the_sphere(seed, light, receivers, scale, small):
    triangles, query = beside_a_small_light(seed) if small else lit(seed, light, receivers, scale)
    for beam in beams_of(query)[:4]:
        made = hierarchy(Cones, query, beam, 4)
        if made is not None:
            pairs = zip(said(made, soup_of(triangles)), said(made, soup_of(triangles), spheres=True))
            assert all((precise.may <= spheres.may).all() for (_, precise), (_, spheres) in pairs)


@examples(25)
@given(
    seed=st.integers(0, 2**32 - 1),
    light=st.sampled_from(ROUND),
    ordered=st.booleans(),
    shared=st.booleans(),
    wide=st.booleans(),
)
def test_the_precise_test_never_tests_more_nodes(seed, light, ordered, shared, wide):
    triangles, query = on_surfaces(seed, light, n=60)
    compared(triangles, query, sorted=ordered, shared=shared, wide=wide)


def test_triangles_beyond_all_receivers_pass_no_node():
    """Walls in line with the light, beyond the receivers: the cone intersects their planes in front of them."""
    rng = np.random.default_rng(2)
    receivers = np.stack([*rng.uniform(-0.1, 0.1, (2, 300)), rng.uniform(1.0, 1.1, 300)], -1)
    wall = np.array([[0.03, -0.5, 2.0], [0.03, 0.5, 2.0], [0.05, 0.0, 4.0]])
    triangles = triangles_of(wall + np.linspace(-0.02, 0.02, 40)[:, None, None] * [1.0, 0.0, 0.0])
    query = points_query(triangles, receivers, at.PointLight((0, 0, 0)), 1)
    bits, counts = traced(triangles, query)
    assert not bits.any() and counts["candidates"] == 0


def shadow_costs(view, variant):
    frame = Renderer(view.scene, with_culling(variant), 1).render(
        view.camera, view.lights, spp=1, counters=True, cull_faces="back"
    )
    return [b.tobytes() for b in frame.bits], frame.counters


@pytest.mark.parametrize("name", ["sponza_crytek", "synthetic_garden_foxes", "bart_robots", "bart_museum8_subdivided"])
def test_the_precise_test_never_tests_more_nodes_in_real_scenes(name, monkeypatch):
    monkeypatch.setenv("ANTUMBRA_SCENES", str(scene_path(f"{name}/scene.glb").parents[1]))
    view, found = open_view(name, (48, 48)), {}
    for variant in ("Spheres", "Precise", "SpheresSorted", "PreciseSorted"):
        found[variant] = shadow_costs(view, variant)
    assert len({tuple(bits) for bits, _ in found.values()}) == 1 and any(any(b) for b in found["Precise"][0])
    for suffix in ("", "Sorted"):
        precise, spheres = (found[f"{test}{suffix}"][1] for test in ("Precise", "Spheres"))
        assert 0 < precise["nodes"] < spheres["nodes"] and 0 < precise["candidates"] < spheres["candidates"]
