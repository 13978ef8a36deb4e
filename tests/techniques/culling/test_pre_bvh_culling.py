"""Culling never drops a triangle that a segment meets, and drops many others."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import antumbra as at
import oracle
from antumbra.engine.method_registry import CULLERS
from antumbra.lab.papers.pre_bvh_culling.cell_marking import LINES
from antumbra.lab.papers.pre_bvh_culling.convex_region import CONVEX
from antumbra.query.light_samples import light_samples
from antumbra.query.query_bounds import reach
from antumbra.query.receivers import FREE, NOTHING
from antumbra.query.shadow_query import ShadowQuery, segments
from antumbra.scene.triangles import Triangles
from antumbra.techniques.culling import pre_bvh_culling
from antumbra.techniques.culling.pre_bvh_culling import HULLS, indices_of, marked_cells_of
from antumbra.techniques.culling.pre_bvh_culling import cull as culling
from asking import query_of
from strategies import point_arrays, soups
from strength import examples

each_culler = pytest.mark.parametrize("cull", [c.cull for c in CULLERS.values()], ids=list(CULLERS))


def _triangles(vertices):
    n = len(vertices)
    return Triangles(
        np.ascontiguousarray(vertices, np.float32), np.zeros(3), np.arange(n, dtype=np.int32), np.ones((n, 3))
    )


def _query(triangles, points, light, spp=4):
    """The query of points for a light. Points float freely, or have a normal up if the light needs normals."""
    origins = np.ascontiguousarray(points, np.float32).reshape(1, -1, 3)
    m, ambient = origins.shape[1], light.domain == "hemisphere"
    normals = np.tile([0.0, 1.0, 0.0], (1, m, 1)) if ambient else np.empty((0, 0, 3))
    sides = np.full((1, m), 1 if ambient else FREE, np.int8)
    patch = light.patch(triangles.origin, reach(triangles, origins))
    corners, no_faces = triangles.vertices.reshape(-1, 9), np.full((1, m), -1, np.int32)
    return ShadowQuery(origins, no_faces, sides, normals, corners, patch, light_samples(light, spp), 0, no_faces)


def _dropped(triangles, culled):
    kept = np.zeros(len(triangles.vertices), np.bool_)
    kept[culled.kept] = True
    return triangles.vertices[~kept]


def _check(cull, triangles, queries):
    """Check that no segment meets a dropped triangle; return (dropped, kept)."""
    culled = cull(triangles, queries, 2)
    np.testing.assert_array_equal(culled.vertices, triangles.vertices[culled.kept])
    assert (np.diff(culled.kept) > 0).all()
    dropped = _dropped(triangles, culled)
    for query in queries:
        ends, _ = segments(query)
        starts = np.broadcast_to(query.origins[:, :, None], ends.shape)
        asked = np.broadcast_to((query.sides != NOTHING)[..., None], ends.shape[:-1])
        assert not oracle.occluded(dropped, starts[asked], ends=ends[asked]).any()
    return len(dropped), len(culled.kept)


@st.composite
def lights(draw, scale=1.0):
    """A light of any shape, inside or outside of the triangles around the origin."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    at_, size = rng.normal(size=3) * draw(st.sampled_from([0.3, 2.0, 30.0])), draw(st.sampled_from([1e-3, 0.5, 4.0]))
    a, b = rng.normal(size=(2, 3)) * size
    if draw(st.booleans()):
        a, b = a * (1, 0, 0), b * (0, 1, 0)
    kind = draw(st.sampled_from(["point", "quad", "disk", "sphere", "sun", "ambient", "nearby", "list"]))
    return {
        "point": lambda: at.PointLight(at_ * scale),
        "quad": lambda: at.QuadLight(at_ * scale, a * scale, b * scale),
        "disk": lambda: at.DiskLight(at_ * scale, rng.normal(size=3), size * scale),
        "sphere": lambda: at.SphereLight(at_ * scale, size * scale),
        "sun": lambda: at.DirectionalLight(rng.normal(size=3), draw(st.sampled_from([0.0, 0.53, 40.0, 170.0]))),
        "ambient": lambda: at.AmbientOcclusion(),
        "nearby": lambda: at.AmbientOcclusion(size * scale),
        "list": lambda: at.PointLights((at_ + rng.normal(size=(20, 3)) * size) * scale),
    }[kind]()


@each_culler
@examples(25)
@given(vertices=soups(60) | point_arrays((20, 3)), light=lights(), data=st.data())
def test_no_segment_meets_a_triangle_that_was_dropped(cull, vertices, light, data):
    triangles = _triangles(vertices)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    corners = triangles.vertices.reshape(-1, 3)
    near = corners[rng.integers(len(corners), size=(30, 3))]  # on planes of triangles, in triangles, or between them
    points = (near * rng.dirichlet([1, 1, 1], 30)[:, :, None]).sum(1)
    if data.draw(st.booleans()):
        points = points[:3] * data.draw(st.sampled_from([1.0, 0.01, 5.0]))
    _check(cull, triangles, [_query(triangles, points, light)])


METHODS = {"hulls": HULLS, "lines": LINES, "convex": CONVEX}


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
@examples(30)
@given(n=st.sampled_from([3, 8, 16, 32]), seed=st.integers(0, 10**6), axis=st.integers(0, 2))
@example(n=16, seed=0, axis=0)
def test_triangles_that_only_touch_the_face_of_a_cell(method, n, seed, axis):
    """Integer coordinates in a grid of cells of size 1: up to rounding, everything is on walls between cells."""
    cull = partial(culling, method=method, n=n)
    rng = np.random.default_rng(seed)
    flat = rng.integers(0, n + 1, (300, 1, 3)) + rng.integers(0, 2, (300, 3, 3))
    flat[:, :, axis] = flat[:, :1, axis]
    triangles = _triangles(np.concatenate([flat, [[[0, 0, 0], [n, n, n], [0, n, n]]]]))
    points = np.concatenate([rng.integers(0, n + 1, (20, 3)), [[0, 0, 0], [n, n, n]]])  # the grid is from 0 to n
    light = at.PointLight(rng.integers(0, n + 1, 3))
    straight = at.DirectionalLight(np.eye(3)[rng.integers(3)], 0.0)
    _check(cull, triangles, [_query(triangles, points, light, 1), _query(triangles, points, straight, 1)])


@each_culler
def test_a_huge_triangle_counts_where_it_is(cull):
    rng = np.random.default_rng(5)
    small = rng.uniform(0, 10, (2000, 1, 3)) + rng.normal(size=(2000, 3, 3)) * 0.05
    huge = np.array([[[-1e4, 5, -1e4], [1e4, 5, -1e4], [0, 5, 2e4]], [[-1e4, -9, -1e4], [1e4, -9, -1e4], [0, -9, 2e4]]])
    triangles = _triangles(np.concatenate([small, huge]))
    query = _query(triangles, rng.uniform(0, 1, (50, 3)), at.PointLight((1, 9, 1)))
    dropped, kept = _check(cull, triangles, [query])
    assert 2000 in cull(triangles, [query], 1).kept
    assert dropped > 0 and kept > 0


@each_culler
def test_much_is_dropped_and_more_lights_drop_less(cull):
    rng = np.random.default_rng(6)
    triangles = _triangles(rng.uniform(0, 10, (5000, 1, 3)) + rng.normal(size=(5000, 3, 3)) * 0.05)
    points = rng.uniform(0, 2, (400, 3))
    near, far = (_query(triangles, points, at.SphereLight(c, 0.2)) for c in ((1, 3, 1), (9, 9, 9)))
    one, both = _check(cull, triangles, [near]), _check(cull, triangles, [near, far])
    assert one[0] > 0.8 * 5000 and one[1] > 20
    assert one[1] < both[1] < 0.6 * 5000
    again = cull(triangles, [near, far], 3)
    np.testing.assert_array_equal(again.kept, cull(triangles, [near, far], 1).kept)


@pytest.mark.parametrize("light", [at.DirectionalLight((0.2, -1, 0.1)), at.DirectionalLight((0, -1, 0), 60.0)])
def test_a_distant_light_drops_what_is_not_towards_it(light):
    rng = np.random.default_rng(7)
    triangles = _triangles(rng.uniform(0, 10, (5000, 1, 3)) + rng.normal(size=(5000, 3, 3)) * 0.05)
    points = rng.uniform((4, 7, 4), (6, 9, 6), (400, 3))
    dropped, kept = _check(CULLERS["grid32"].cull, triangles, [_query(triangles, points, light)])
    assert dropped > 0.6 * 5000 and kept > 50


def test_finer_grids_keep_less():
    rng = np.random.default_rng(8)
    triangles = _triangles(rng.uniform(0, 10, (9000, 1, 3)) + rng.normal(size=(9000, 3, 3)) * 0.02)
    query = _query(triangles, rng.uniform(0, 3, (300, 3)) * (1, 0, 1), at.QuadLight((2, 8, 2), (1, 1, 0), (0, 1, 1)))
    kept = [_check(CULLERS[f"grid{n}"].cull, triangles, [query])[1] for n in (16, 32, 64, 128, 256)]
    assert all(finer < 1.05 * coarser for coarser, finer in pairwise(kept)) and kept[-1] < 0.85 * kept[0]
    paper = _check(CULLERS["grid32:paper"].cull, triangles, [query])[1]
    assert kept[1] < paper < 9000


@each_culler
def test_nothing_to_cull_and_nobody_who_asks(cull):
    empty, one = _triangles(np.zeros((0, 3, 3))), _triangles(np.eye(3)[None])
    query = _query(one, np.zeros((5, 3)), at.PointLight((1, 1, 1)))
    assert len(cull(empty, [query], 2).kept) == 0
    silent = query._replace(sides=np.zeros_like(query.sides))
    assert len(cull(one, [silent], 2).kept) == 0 and cull(one, [silent], 2).grid is None
    assert len(cull(one, [query, silent], 2).kept) == 1
    away = _query(one, np.full((5, 3), 50.0), at.PointLight((60, 60, 60)))
    assert len(cull(one, [away], 2).kept) <= 1


@examples(40)
@given(n=st.integers(1, 9), seed=st.integers(0, 10**6))
def test_sums_of_cells(n, seed):
    cells = (np.random.default_rng(seed).random((n, n, n)) < 0.3).astype(np.uint8)
    sums = marked_cells_of(cells, 2).sums
    np.testing.assert_array_equal(sums[1:, 1:, 1:], cells.cumsum(0, np.int64).cumsum(1).cumsum(2))
    assert not sums[0].any() and not sums[:, 0].any() and not sums[:, :, 0].any()


@each_culler
@examples(8)
@given(vertices=soups(60), light=lights(), seed=st.integers(0, 2**32 - 1))
def test_what_cameras_see(cull, vertices, light, seed):
    """Receivers of pixels: moved off their surfaces, in tiles, with gaps between them."""
    rng = np.random.default_rng(seed)
    middle, size = vertices.reshape(-1, 3).mean(0), np.ptp(vertices.reshape(-1, 3), axis=0).max()
    size = max(size, 1e-6 * np.abs(middle).max(), 1e-9)  # the triangles may all be one point
    scene = at.Scene.from_arrays(vertices.astype(np.float64))
    camera = at.Camera(middle + size * rng.normal(size=3), middle, vfov=70, width=19, height=21)
    triangles, query = query_of(scene, camera, light, 3)
    if np.count_nonzero(query.sides):
        _check(cull, triangles, [query])


def test_a_convex_region_has_more_than_the_grid():
    """Two groups of receivers below a light, far apart: what lies between them is dropped by the grid only."""
    rng = np.random.default_rng(5)
    triangles = _triangles(rng.uniform((-10, 0, -10), (10, 4, 10), (4000, 1, 3)) + rng.uniform(-0.1, 0.1, (4000, 3, 3)))
    points = np.concatenate([rng.uniform((x, 0, -1), (x + 1, 0.1, 1), (30, 3)) for x in (-9, 8)])
    queries = [_query(triangles, points, at.SphereLight((0, 9, 0), 0.5))]
    dropped, kept = _check(partial(culling, method=CONVEX), triangles, queries)
    of_grid = _check(culling, triangles, queries)[1]
    assert dropped > 100 and 1.5 * of_grid < kept


def test_few_indices_are_kept_but_many_die_with_their_scene(monkeypatch):
    monkeypatch.setattr(pre_bvh_culling, "_KEPT", 100)
    for n in (0, 1, 100, 101):
        first = indices_of(n)
        assert first.dtype == np.int32 and first.tolist() == list(range(n))
        assert (indices_of(n) is first) == (n <= 100)
