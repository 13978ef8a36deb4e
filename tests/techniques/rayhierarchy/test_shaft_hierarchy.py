"""Lights as large as the scene: shafts give the same bits with far fewer tests."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, reject

import antumbra as at
from antumbra.engine.plan import parse_plan
from antumbra.lab.papers.ray_hierarchy.cone_hierarchy import Cones, combination
from antumbra.techniques.culling.pre_bvh_culling import soup_of
from antumbra.techniques.rayhierarchy import ray_hierarchy, shaft_hierarchy
from antumbra.techniques.rayhierarchy.ray_hierarchy import trace_shadow
from antumbra.techniques.tracer_options import FASTEST_RAY_HIERARCHY, RayHierarchyOptions
from antumbra.trace.counters import as_dict, new_counters
from asking import answer, query_of, true_occlusion, unpack
from beam_scenes import LIGHTS, RECEIVERS, lit, on_surfaces
from hierarchies import met_by
from strength import examples

WIDE = ["quad", "sphere", "sun", "ambient"]  # lights with an extent
TWO_PASSES = "cones:boxes:wide:blocks:early-accept:two-pass:shared:shafts"


def _bits(triangles, query, options=FASTEST_RAY_HIERARCHY, threads=2, counters=None):
    """(h, w, spp) bool: a variant's answer to a query."""
    spp = query.samples.shape[1]
    bits = np.zeros((*query.sides.shape, -(-spp // 64)), np.uint64)
    trace_shadow(soup_of(triangles), query, bits, threads, counters, None, options)
    return unpack(bits, spp)


@pytest.fixture(scope="module", autouse=True)
def _no_probe_is_left_out():
    """Probe scenes of few triangles too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ray_hierarchy, "LEAST", 0)
        patch.setattr(ray_hierarchy, "PROBE", 16)
        yield


@pytest.fixture(scope="module")
def always_shafts():
    """Use shafts at any cost. The list counts their traversals."""
    used, before = [], shaft_hierarchy.trace_clusters

    def spied(ticket, *arguments):
        used.append(ticket)
        before(ticket, *arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shaft_hierarchy, "trace_clusters", spied)
        patch.setattr(ray_hierarchy, "CHEAP", 0.0)
        patch.setattr(ray_hierarchy, "WORTH", 0.0)
        patch.setattr(ray_hierarchy, "CLUSTERED", -np.inf)
        yield used


@pytest.fixture
def shafts_always(always_shafts):
    always_shafts.clear()
    return always_shafts


@pytest.mark.parametrize("shape", [(21, 30), (1, 200)], ids=str)
@pytest.mark.parametrize("light", LIGHTS)
def test_shafts_say_what_brute_force_says(light, shape, shafts_always):
    triangles, query = on_surfaces(21, light, shape, n=60)
    truth, active = true_occlusion(triangles, query)
    assert truth[active].any() and not truth[active].all()
    for threads in (1, 3):
        np.testing.assert_array_equal(_bits(triangles, query, threads=threads), truth)
    np.testing.assert_array_equal(_bits(triangles, query, combination(TWO_PASSES)), truth)
    assert bool(shafts_always) >= (light in WIDE)


@pytest.mark.parametrize("cull_faces", [-1, 1])
@pytest.mark.parametrize("light", WIDE)
def test_culled_faces(light, cull_faces, shafts_always):
    triangles, query = on_surfaces(5, light, (18, 22), n=60, cull_faces=cull_faces)
    truth = answer(parse_plan("lbvh+single"), triangles, query)
    both = answer(parse_plan("lbvh+single"), triangles, query._replace(cull_faces=0))
    assert truth.any() and (truth <= both).all() and (truth != both).any()
    np.testing.assert_array_equal(_bits(triangles, query), truth)
    assert shafts_always


@pytest.mark.parametrize("spp", [1, 4, 17, 64, 65])
@pytest.mark.parametrize("light", WIDE)
def test_numbers_of_samples(light, spp, shafts_always):
    triangles, query = on_surfaces({"ambient": 2}.get(light, 3), light, (9, 11), n=60, spp=spp)
    truth, active = true_occlusion(triangles, query)
    assert truth[active].any() and not truth[active].all()
    np.testing.assert_array_equal(_bits(triangles, query), truth)
    assert shafts_always


@examples(150)
@given(
    seed=st.integers(0, 2**32 - 1),
    light=st.sampled_from(WIDE),
    receivers=st.sampled_from(list(RECEIVERS)),
    scale=st.sampled_from([1.0, 1e-6, 1e-3, 1e3, 1e6] * 3 + [1e-36, 1e-30, 1e-20, 1e20, 1e30, 3e33]),
)
def test_any_rays_and_triangles(always_shafts, seed, light, receivers, scale):
    """Triangles are aimed at the rays' ends, corners and edges."""
    try:
        triangles, query = lit(seed, light, receivers, scale)
    except at.InputError:  # this sun is too wide for so large a scene
        assert light == "sun" and scale >= 1e20
        reject()
    truth = met_by(query, triangles.vertices.reshape(-1, 9)).any(0)[None]
    got = _bits(triangles, query)
    if light == "ambient":  # samples below the horizon are dark too
        truth, _ = true_occlusion(triangles, query)
    np.testing.assert_array_equal(got, truth)


@pytest.mark.parametrize("segments_held", [1, 200, 1000])
@pytest.mark.parametrize("light", WIDE)
def test_queries_that_are_cut_into_parts(light, segments_held, monkeypatch, shafts_always):
    triangles, query = on_surfaces(8, light, (23, 18), n=40, spp=3)
    whole = _bits(triangles, query, RayHierarchyOptions(nodes=Cones, shared=True))
    monkeypatch.setattr(ray_hierarchy, "SEGMENTS", segments_held)
    np.testing.assert_array_equal(_bits(triangles, query), whole)
    assert whole.any() and not whole.all() and shafts_always


def _large_light(triangles, size):
    """(triangles, query) of a city with a quad light in its midst, `size` times as large as the city."""
    scene = at.procedural("city", triangles=triangles)
    corners = scene.triangles().vertices.reshape(-1, 3) + scene.triangles().origin
    low, extent = corners.min(0).astype(np.float64), np.ptp(corners, axis=0).astype(np.float64)
    corner = low + extent * [0.5 - size / 2, 0.6, 0.5 - size / 2]
    light = at.QuadLight(corner, (extent[0] * size, 0, 0), (0, 0, extent[2] * size))
    return query_of(scene, scene.cameras[0].resized(48, 48), light, 16)


def _counted(triangles, query, options):
    """(bits, counts) of a query."""
    tally = new_counters()
    return _bits(triangles, query, options, counters=tally), as_dict(tally)


def test_a_light_as_large_as_the_scene_takes_few_tests():
    triangles, query = _large_light(20_000, 1.0)
    got, counts = _counted(triangles, query, FASTEST_RAY_HIERARCHY)
    plain, before = _counted(triangles, query, FASTEST_RAY_HIERARCHY._replace(shafts=False))
    np.testing.assert_array_equal(got, plain)
    assert got.any() and not got.all()
    print({name: (counts[name], before[name]) for name in counts})
    for name in ("rays", "below_horizon"):
        assert counts[name] == before[name] > 0
    assert counts["triangle_tests"] + counts["box_tests"] < 16 * counts["rays"]
    assert before["triangle_tests"] > 10 * (counts["triangle_tests"] + counts["box_tests"])
