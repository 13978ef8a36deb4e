"""Every variant of `cones` gives the bits of brute force."""

from functools import cache

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import antumbra as at
from antumbra.engine.plan import parse_plan
from antumbra.lab.papers.ray_hierarchy.cone_hierarchy import CONES, Cones, combination
from antumbra.query.shadow_query import segments
from antumbra.techniques.culling.pre_bvh_culling import Soup, soup_of
from antumbra.techniques.rayhierarchy import ray_hierarchy
from antumbra.techniques.rayhierarchy.ray_hierarchy import trace_shadow
from antumbra.techniques.tracer_options import FASTEST_RAY_HIERARCHY, RayHierarchyOptions
from antumbra.trace.counters import as_dict, new_counters
from asking import answer, query_of, true_occlusion, unpack
from beam_scenes import LIGHTS, RECEIVERS, lit, on_surfaces
from hierarchies import met_by, points_query, triangles_of
from strength import examples

pytestmark = pytest.mark.papers  # all variants, for all lights, with one and three threads

COMBINED = (
    "cones:wide:sorted:early-accept",
    "cones:precise:wide:blocks:early-accept:two-pass:shared",
    "cones:spheres:wide:blocks:shared:clustered",
    "cones:boxes:sorted:two-pass:backface",
    "cones:boxes:wide:blocks:early-accept:two-pass:shared:clustered",
    "cones:boxes:early-accept:shared",
    "cones:spheres:two-pass:backface:shared",
)
VARIANTS = (
    {"cones": FASTEST_RAY_HIERARCHY}
    | {name: options for name, (options, _) in CONES.items()}
    | {name: combination(name) for name in COMBINED}
)


def _bits(triangles, query, options, threads=2, counters=None, soup=None):
    """(h, w, spp) bool: a variant's answer to a query."""
    spp = query.samples.shape[1]
    bits = np.zeros((*query.sides.shape, -(-spp // 64)), np.uint64)
    trace_shadow(soup or soup_of(triangles), query, bits, threads, counters, None, options)
    return unpack(bits, spp)


def _all_say(truth, triangles, query, variants=VARIANTS, threads=(1, 3)):
    for name, options in variants.items():
        for n in threads:
            got = _bits(triangles, query, options, n)
            np.testing.assert_array_equal(got, truth, err_msg=f"{name}, {n} threads")


@pytest.mark.parametrize("shape", [(21, 30), (1, 200)], ids=str)
@pytest.mark.parametrize("light", LIGHTS)
def test_receivers_on_surfaces(light, shape):
    triangles, query = on_surfaces(21, light, shape, n=60)
    truth, active = true_occlusion(triangles, query)
    assert truth[active].any() and not truth[active].all()
    _all_say(truth, triangles, query)


@pytest.mark.parametrize("receivers", RECEIVERS)
@pytest.mark.parametrize("light", LIGHTS)
def test_receivers_in_the_air(light, receivers):
    triangles, query = lit(11, light, receivers, 1.0, 40)
    triangles = triangles_of(triangles.vertices[::2])
    truth, _ = true_occlusion(triangles, query)
    _all_say(truth, triangles, query, threads=(2,))


@examples(60)
@given(
    seed=st.integers(0, 2**32 - 1),
    light=st.sampled_from(list(LIGHTS)),
    name=st.sampled_from(list(VARIANTS)),
    shape=st.sampled_from([(9, 14), (1, 60)]),
    offset=st.sampled_from([0.0, 100.0, 5000.0]),
    cull_faces=st.sampled_from([-1, 0, 1]),
)
def test_any_surfaces_lights_and_options(seed, light, name, shape, offset, cull_faces):
    triangles, query = on_surfaces(seed, light, shape, 30, offset, 2, cull_faces)
    single = answer(parse_plan("lbvh+single"), triangles, query)
    np.testing.assert_array_equal(_bits(triangles, query, VARIANTS[name]), single)


@pytest.mark.parametrize("cull_faces", [-1, 1])
@pytest.mark.parametrize("light", ["point", "quad", "sun", "ambient"])
def test_culled_faces(light, cull_faces):
    triangles, query = on_surfaces(5, light, (18, 22), n=60, cull_faces=cull_faces)
    truth = answer(parse_plan("lbvh+single"), triangles, query)
    both = answer(parse_plan("lbvh+single"), triangles, query._replace(cull_faces=0))
    assert truth.any() and (truth <= both).all() and (truth != both).any()
    _all_say(truth, triangles, query)


@pytest.mark.parametrize("spp", [1, 4, 17, 64, 65])
@pytest.mark.parametrize("light", ["quad", "sphere", "sun", "ambient"])
def test_numbers_of_samples(light, spp):
    triangles, query = on_surfaces({"ambient": 2}.get(light, 3), light, (9, 11), n=60, spp=spp)
    truth, active = true_occlusion(triangles, query)
    assert truth[active].any() and not truth[active].all()
    some = {name: VARIANTS[name] for name in ("cones", "cones:SpheresSorted", "cones:PreciseSEATP", *COMBINED)}
    _all_say(truth, triangles, query, some, threads=(2,))


@pytest.mark.parametrize("segments_held", [1, 40, 200, 1000])
@pytest.mark.parametrize("shape", [(23, 18), (1, 150)], ids=str)
@pytest.mark.parametrize("light", ["quad", "sun", "ambient", "interleaved list"])
def test_queries_that_are_cut_into_parts(light, shape, segments_held, monkeypatch):
    triangles, query = on_surfaces(8, light, shape, n=40, spp=3)
    whole = _bits(triangles, query, FASTEST_RAY_HIERARCHY)
    monkeypatch.setattr(ray_hierarchy, "SEGMENTS", segments_held)
    for name in ("cones", "cones:precise:sorted", "cones:SpheresSorted"):
        np.testing.assert_array_equal(_bits(triangles, query, combination(name) or VARIANTS[name]), whole)
    assert whole.any() and not whole.all()
    assert len(ray_hierarchy.query_parts(query, np.zeros((*shape, 1), np.uint64))) > (1 if segments_held < 1000 else 0)


# Hazards, by name.


def _zero_area(n=30):
    rng = np.random.default_rng(1)
    v = rng.normal(size=(n, 3, 3))
    v[::3] = v[::3, :1]  # points
    v[1::3, 2] = (v[1::3, 0] + v[1::3, 1]) / 2  # on a line, or nearly
    v[2::3, 2] = v[2::3, 1]
    return v


def _shared_edges():
    """A grid of squares below the light, each split into two triangles."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-3.0, 3), np.arange(-3.0, 3)))
    low = np.stack([x, y, 0 * x + 1], 1)
    return low[:, None] + np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]])


_GRID = np.stack(np.meshgrid(*[np.arange(-2.0, 3)] * 3), -1).reshape(-1, 3)
_SOUP = np.random.default_rng(2).normal(size=(40, 3, 3))

SOUPS = {
    "empty": np.zeros((0, 3, 3)),
    "one triangle": _SOUP[:1],
    "zero area": _zero_area(),
    "squares that share edges": _shared_edges(),
    "all in the light's plane": _SOUP * [1, 1, 0],
    "corners at the light": np.concatenate([0 * _SOUP[:, :1], _SOUP[:, 1:]], 1),
    "around the light": np.concatenate([_SOUP, -_SOUP]) * 0.3,
    "copies of one": np.tile(_SOUP[:1] * 3, (40, 1, 1)),
    "huge": _SOUP * 1e20,
    "tiny": _SOUP * 1e-20,
    "whole numbers": np.round(_SOUP * 2),
}
POINTS = {
    "a grid, one of them at the light": _GRID,
    "random": np.random.default_rng(3).normal(size=(150, 3)) * 3,
    "behind shared edges": np.concatenate([_GRID[:, [0, 1]] * 2, 0 * _GRID[:, :1] + 2], 1),
    "in one plane with the light": _GRID * [1, 1, 0],
    "one": np.array([[1.0, 2, 3]]),
    "one, at zero": np.zeros((1, 3)),
    "none": np.zeros((0, 3)),
}


@pytest.mark.parametrize("points", POINTS)
@pytest.mark.parametrize("soup", SOUPS)
def test_hazards(soup, points):
    """A light at the origin (where receivers or corners are too), a small light there, a list, and the sun."""
    triangles = triangles_of(SOUPS[soup])
    lights = (
        at.PointLight((0, 0, 0)),
        at.QuadLight((-1, -1, 0), (2, 0, 0), (0, 2, 0)),
        at.SphereLight((0, 0, 0), 0.25),
        at.PointLights([[0, 0, 0], [0, 0, 5], [1, 1, 1]]),
        at.DirectionalLight((0, 0, -1), 0.0),
        at.DirectionalLight((0, 0, -1), 40.0),
    )
    some = {name: VARIANTS[name] for name in ("cones", "cones:SpheresSorted", "cones:PreciseSEATP", *COMBINED[:4])}
    for light in lights:
        query, truth = _points_query(triangles, POINTS[points], light)
        _all_say(truth, triangles, query, some, threads=(2,))


def _points_query(triangles, points, light):
    """(query, truth): as `hierarchies.points_query`, but with the correct bits, and for no points or triangles too."""
    known = triangles if len(triangles.vertices) else triangles_of(np.eye(3)[None])
    query = points_query(known, points if len(points) else np.ones((1, 3)), light, 2)
    truth = met_by(query, triangles.vertices.reshape(-1, 9)).any(0)[None]
    m = len(points)
    fewer = query._replace(origins=query.origins[:, :m], faces=query.faces[:, :m], sides=query.sides[:, :m])
    return fewer, truth[:, :m]


@pytest.mark.parametrize("plan", ["cones", "cones:precise:sorted", "grid32+cones", "cones:PreciseSEATP"])
@pytest.mark.parametrize("with_normals", [False, True])
def test_points_that_ask(plan, with_normals):
    """Points through the public interface: none, one and many, on surfaces and free-floating."""
    rng = np.random.default_rng(6)
    scene = at.Scene.from_arrays(rng.normal(size=(80, 3, 3)))
    lights = (
        at.PointLight((0.5, 2, 1)),
        at.SphereLight((0, 3, 0), 0.5),
        at.DirectionalLight((0.2, -1, 0.1)),
        at.PointLights(rng.normal(size=(20, 3)) * 2),
        at.PointLights(rng.normal(size=(20, 3)) * 2, interleave=True),
    ) + ((at.AmbientOcclusion(), at.AmbientOcclusion(0.4)) if with_normals else ())
    for light in lights:
        for shape in ((), (1,), (3, 50), (0,)):
            points = rng.normal(size=(*shape, 3))
            normals = rng.normal(size=(*shape, 3)) if with_normals else None
            seen, plain = (at.visibility(scene, points, light, normals, spp=4, plan=p) for p in (plan, "lbvh+single"))
            np.testing.assert_array_equal(seen.bits, plain.bits)
            assert not shape or shape == (0,) or shape == (1,) or seen.bits.any()


def test_a_point_on_its_surface_at_the_light():
    """The receiver is moved onto the light. So the light is not above its horizon."""
    triangles = triangles_of(_SOUP)
    query = points_query(triangles, [[0, 0, 0], [1, 0, 0]], at.PointLight((0, 0, 0)), 1, [[0, 0, 1.0], [-1.0, 0, 0]])
    truth, _ = true_occlusion(triangles, query)
    assert truth[0, 0, 0] and segments(query)[1].tolist() == [[[False], [True]]]
    _all_say(truth, triangles, query)


@pytest.mark.parametrize("light", ["point", "quad", "sun", "ambient"])
def test_nothing_asks(light):
    """An empty picture, and one whose receivers all face away from the light."""
    triangles, query = on_surfaces(3, light, (9, 11))
    nothing = query._replace(sides=np.zeros_like(query.sides))
    _all_say(np.zeros((9, 11, 5), bool), triangles, nothing, threads=(2,))
    if light == "point":
        below = ~segments(query)[1]
        away = query._replace(sides=np.where(below.all(2), query.sides, 0).astype(np.int8))
        truth = np.broadcast_to((away.sides != 0)[..., None], below.shape)
        assert truth.any()
        _all_say(truth, triangles, away, threads=(2,))


def test_triangles_that_culling_left_are_known_by_their_numbers_in_the_scene():
    """Receivers skip their own triangle, at any index in the soup."""
    triangles, query = on_surfaces(4, "quad", (12, 15), n=50)
    kept = np.sort(np.random.default_rng(1).choice(50, 30, replace=False)).astype(np.int32)
    soup = Soup(np.ascontiguousarray(triangles.vertices[kept]).reshape(-1, 9), kept)
    truth, _ = true_occlusion(triangles_of(triangles.vertices[kept]), query)
    for name, options in VARIANTS.items():
        np.testing.assert_array_equal(_bits(triangles, query, options, soup=soup), truth, err_msg=name)


@cache
def _picture():
    scene = at.procedural("cellar", triangles=1500)
    return query_of(scene, scene.cameras[0].resized(48, 36), scene.lights[0], 4)


@pytest.mark.parametrize("name", VARIANTS)
def test_a_picture_and_what_is_counted(name):
    """All variants trace the same rays, and give the answers of single rays."""
    triangles, query = _picture()
    tally, plain = new_counters(), new_counters()
    got = _bits(triangles, query, VARIANTS[name], counters=tally)
    np.testing.assert_array_equal(got, answer(parse_plan("lbvh+single"), triangles, query, counters=plain))
    counts, expected = as_dict(tally), as_dict(plain)
    for key in ("rays", "below_horizon"):
        assert counts[key] == expected[key] > 0
    assert counts["nodes"] > 0 and counts["triangle_tests"] + counts["covered"] > 0
    assert (counts["covered"] > 0) <= VARIANTS[name].early_accept
    assert got.any() and not got.all()


def test_better_tests_and_orders_visit_fewer_nodes():
    triangles, query = _picture()
    nodes = {}
    for name in ("Spheres", "Precise", "PreciseSorted", "PreciseSEA"):
        tally = new_counters()
        _bits(triangles, query, CONES[f"cones:{name}"][0]._replace(shared=True), counters=tally)
        nodes[name] = as_dict(tally)["nodes"]
    assert nodes["Precise"] < nodes["Spheres"] and nodes["PreciseSorted"] < nodes["Precise"]
    assert nodes["PreciseSEA"] < nodes["PreciseSorted"]


def test_progress_is_told():
    triangles, query = on_surfaces(1, "point", (20, 20), n=600)
    calls, bits = [], np.zeros((20, 20, 1), np.uint64)
    trace_shadow(
        soup_of(triangles),
        query,
        bits,
        1,
        None,
        lambda done, n: calls.append((done, n)),
        RayHierarchyOptions(nodes=Cones),
    )
    assert calls[-1] == (600, 600) and bits.any()
