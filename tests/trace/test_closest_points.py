"""Closest points of a scene's faces: against rational numbers, and the same whatever the tree and the batch."""

from fractions import Fraction
from math import isqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import antumbra as at
from antumbra.bvh.wide_bvh import widen
from antumbra.engine.method_registry import BUILDERS
from antumbra.kernels.marshalling import packed
from antumbra.trace.closest_points import ERROR, closest_points
from cutout_scenes import scene_with_cutouts
from strategies import soups


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def minus(a, b):
    return [x - y for x, y in zip(a, b)]


def square_from_edge(point, a, b):
    edge, r = minus(b, a), minus(point, a)
    share = min(max(dot(r, edge) / (dot(edge, edge) or 1), Fraction(0)), Fraction(1))
    rest = [x - share * y for x, y in zip(r, edge)]
    return dot(rest, rest)


def true_square(point, triangle):
    """The squared distance of a point from a triangle, a Fraction."""
    point, (a, b, c) = [Fraction(float(x)) for x in point], [[Fraction(float(x)) for x in p] for p in triangle]
    e, f, r = minus(b, a), minus(c, a), minus(point, a)
    n = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]]
    ee, ef, ff, re, rf, nn = dot(e, e), dot(e, f), dot(f, f), dot(r, e), dot(r, f), dot(n, n)
    u, v = ff * re - ef * rf, ee * rf - ef * re
    if nn and u >= 0 and v >= 0 and u + v <= nn:
        return dot(n, r) ** 2 / nn
    return min(square_from_edge(point, *edge) for edge in ((a, b), (b, c), (c, a)))


def root(square):
    """The root of a Fraction, as a Fraction with an error below 2^-200."""
    return Fraction(isqrt(square.numerator * 4**200 // square.denominator), 2**200)


def has_area(triangle):
    a, b, c = (list(map(Fraction, map(float, p))) for p in triangle)
    e, f = minus(b, a), minus(c, a)
    return dot(e, e) * dot(f, f) != dot(e, f) ** 2


def check(scene, points, sample=None):
    """Assert that the closest points are within the stated error, and on their faces. Return them."""
    found, triangles = scene.closest_points(points), scene.triangles().vertices
    local = (np.asarray(points, np.float64) - scene.origin).astype(np.float32)
    with_area = [triangle for triangle in triangles if has_area(triangle)]
    for i, point in enumerate(local):
        truth = root(min(true_square(point, triangle) for triangle in with_area))
        own = triangles[found.face[i]].astype(np.float64)
        longest = max(np.linalg.norm(own - np.roll(own, 1, 0), axis=1))
        bound = Fraction(ERROR) * (truth + Fraction(float(longest)))
        assert abs(Fraction(float(found.distance[i])) - truth) <= bound
        assert root(true_square(point, own)) <= truth + bound
    own = triangles[found.face].astype(np.float64)
    size = np.abs(own).max((1, 2)) + np.abs(local).max(1)
    position = found.position - scene.origin
    u, v = found.u[:, None].astype(np.float64), found.v[:, None].astype(np.float64)
    places = own[:, 0] * (1 - u - v) + own[:, 1] * u + own[:, 2] * v
    scale = size + np.abs(scene.origin).max()
    assert (np.abs(places - position).max(1) <= 2.0**-20 * scale).all()  # weights are float32
    assert (np.abs(np.linalg.norm(position - local, axis=1) - found.distance) <= 2.0**-45 * scale).all()
    assert ((found.u >= 0) & (found.v >= 0) & (found.u.astype(np.float64) + found.v <= 1 + 2.0**-23)).all()
    return found


@given(soups(), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_distances_are_within_the_stated_error(soup, seed):
    rng, scene = np.random.default_rng(seed), at.Scene.from_arrays(soup)
    if not any(has_area(triangle) for triangle in scene.triangles().vertices):
        return
    corners = soup.reshape(-1, 3)
    size = np.abs(corners).max()
    places = (rng.dirichlet((1, 1, 1), 6)[:, :, None] * soup[rng.integers(0, len(soup), 6)]).sum(1)
    middles = (corners[rng.integers(0, len(corners), 4)] + corners[rng.integers(0, len(corners), 4)]) / 2
    check(scene, np.concatenate([rng.normal(size=(8, 3)) * size, corners[:4], middles, places]))


@pytest.mark.parametrize("height", [2.0**-8, 2.0**-16, 2.0**-22])
def test_slivers_are_measured_as_exactly_as_other_faces(height):
    """The weights of a sliver's corners cannot be found by the products of its edges alone."""
    rng = np.random.default_rng(1)
    ends = rng.normal(size=(20, 2, 3))
    soup = np.stack([ends[:, 0], ends[:, 1], ends.mean(1) + rng.normal(size=(20, 3)) * height], 1).astype(np.float32)
    points = rng.normal(size=(40, 3)) * np.repeat([1.0, 1e-3], 20)[:, None] + np.tile(ends.mean(1), (2, 1))
    check(at.Scene.from_arrays(soup), points)


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1.0, 1e12, 1e17])
def test_the_scale_of_a_scene_does_not_matter(scale):
    """Beyond some powers of two, float32 rules nothing out."""
    rng = np.random.default_rng(2)
    soup, points = rng.normal(size=(60, 3, 3)) * scale, rng.normal(size=(12, 3)) * 2 * scale
    found = check(at.Scene.from_arrays(soup), points)
    assert len(np.unique(found.face)) > 3


def test_the_result_depends_neither_on_the_tree_nor_on_other_points():
    rng = np.random.default_rng(3)
    scene = at.procedural("atrium", triangles=3000)
    triangles, (lower, upper) = scene.triangles().vertices, scene.bounds - scene.origin
    points = rng.uniform(lower, upper, (300, 3)).astype(np.float32)
    points[:100] = triangles[rng.integers(0, len(triangles), 100), 0]  # on corners, which many faces share
    found = scene.closest_points(points + scene.origin, threads=1)
    for builder in BUILDERS.values():
        tree = packed(widen(builder.build(triangles, 1), 1))
        other = closest_points(tree, points, 1)
        for name in ("distance", "face", "u", "v"):
            np.testing.assert_array_equal(getattr(other, name), getattr(found, name))
    order = rng.permutation(300)
    again = scene.closest_points(points[order] + scene.origin, threads=2)
    for one, other in zip(again, found):
        np.testing.assert_array_equal(one, other[order])
    alone = [scene.closest_points(point + scene.origin) for point in points[:40]]
    assert [(each.face, each.distance) for each in alone] == list(zip(found.face[:40], found.distance[:40]))


def test_the_lowest_of_equally_close_faces_is_found():
    """Each face, measured alone, has the distance that it has among others."""
    rng = np.random.default_rng(4)
    grid = rng.integers(-2, 3, (40, 3, 3)).astype(np.float32)
    soup = np.concatenate([grid, grid[::-1, ::-1], np.full((1, 3, 3), 2.0) * [[1, 1, 1], [1, 1, -1], [-1, -1, -1]]])
    scene = at.Scene.from_arrays(soup)
    points = rng.integers(-4, 5, (80, 3)) / 2.0
    each = np.stack([closest_alone(triangle, points - scene.origin) for triangle in scene.triangles().vertices])
    found = scene.closest_points(points)
    np.testing.assert_array_equal(found.distance, each.min(0))
    np.testing.assert_array_equal(found.face, each.argmin(0))
    assert ((each == each.min(0)).sum(0) > 1).mean() > 0.9


def closest_alone(triangle, points):
    """The distances of points from one triangle; inf if it has no area."""
    if not has_area(triangle):
        return np.full(len(points), np.inf)
    tree = packed(widen(BUILDERS["bsah"].build(triangle[None], 1), 1))
    return closest_points(tree, np.ascontiguousarray(points, np.float32), 1).distance


def test_both_faces_of_an_edge_are_equally_far():
    """Whichever way round each face names its corners."""
    rng, shared = np.random.default_rng(5), 0
    for _ in range(50):
        a, b, c, d = rng.normal(size=(4, 3)).astype(np.float32)
        points = ((a + b) / 2 + (a + b - c - d) * 3 + rng.normal(size=(20, 3)) * 0.1).astype(np.float32)
        one, other = (closest_alone(np.stack(each), points) for each in ((a, b, c), (b, a, d)))
        edge = [i for i, p in enumerate(points) if true_square(p, (a, b, c)) == true_square(p, (a, b, d))]
        shared += len(edge)
        assert (one[edge] == other[edge]).all()
    assert shared > 100


# --- Scenes of every kind ---------------------------------------------------------------------------------------------


def test_shapes_and_values():
    scene = at.Scene.from_arrays([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    found = scene.closest_points([[[1.0, 2, 3], [-3, -4, 0]]])
    assert [array.shape for array in found] == [(1, 2)] * 4 + [(1, 2, 3)]
    assert [array.dtype for array in found] == [np.float64, np.int32, np.float32, np.float32, np.float64]
    assert found.distance.tolist() == [[3.0, 5.0]] and found.face.tolist() == [[0, 0]]
    assert found.u.tolist() == [[0.25, 0.0]] and found.v.tolist() == [[0.5, 0.0]]
    assert found.position.tolist() == [[[1.0, 2.0, 0.0], [0.0, 0.0, 0.0]]]
    one = scene.closest_points([1.0, 1.0, -2.0])
    assert one.distance.shape == () and one.distance == 2.0 and one.position.tolist() == [1.0, 1.0, 0.0]
    assert scene.closest_points(np.zeros((0, 3))).position.shape == (0, 3)


def test_a_scene_far_from_the_origin_is_measured_in_its_own_frame():
    soup = np.array([[[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]])
    far = at.Scene.from_arrays(soup + 5_000_000.0)
    found = far.closest_points(np.array([1.0, 2.0, 0.125]) + 5_000_000.0)
    assert found.distance == 0.125 and found.position.tolist() == [5_000_001.0, 5_000_002.0, 5_000_000.0]


def test_faces_without_area_do_not_count():
    soup = np.array([[[0.0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 0, 9], [1, 0, 9], [2, 0, 9]]])
    found = at.Scene.from_arrays(soup).closest_points([[1.0, 1.0, 8.0]])
    assert found.face.tolist() == [0] and found.distance.tolist() == [8.0]
    nothing = at.Scene.from_arrays(soup[1:]).closest_points([[1.0, 1.0, 8.0]])
    assert nothing.face.tolist() == [-1] and np.isinf(nothing.distance).all() and np.isnan(nothing.position).all()


def test_faces_with_holes_count_as_a_whole():
    scene, points = scene_with_cutouts(), np.random.default_rng(6).uniform(-1, 1, (60, 3))
    found = check(scene, points + scene.origin)
    solid = scene.triangles().solid
    masked = ~np.isin(found.face, solid)
    assert masked.any() and not masked.all()


def test_instances_are_measured_like_their_flattened_copies():
    rng = np.random.default_rng(7)
    mesh = rng.normal(size=(30, 3, 3))
    transforms = [np.c_[rng.normal(size=(3, 3)), rng.normal(size=3) * 4] for _ in range(5)]
    scenes = [at.Scene.from_instances([mesh], [transforms], instances=kept) for kept in (True, False)]
    points = rng.normal(size=(50, 3)) * 4
    for one, other in zip(*(scene.closest_points(points) for scene in scenes)):
        np.testing.assert_array_equal(one, other)


def test_moved_geometry_is_measured_where_it_is():
    scene = at.Scene.from_arrays([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    assert scene.closest_points([1.0, 1.0, 8.0]).distance == 8.0
    scene.update([[0.0, 0, 2], [4, 0, 2], [0, 4, 2]])
    assert scene.closest_points([1.0, 1.0, 8.0]).distance == 6.0


def test_scenes_in_a_store_are_refused(tmp_path):
    at.build_store(at.procedural("atrium", triangles=1000), tmp_path / "a.antumbra")
    with pytest.raises(at.InputError, match="closest points need a scene in memory; this one is in a store"):
        at.load(tmp_path / "a.antumbra").closest_points([0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    "points, words",
    [
        ([[0.0, np.nan, 0.0]], r"points are NaN, infinite or beyond float32 \(point 0\)"),
        (np.zeros((4, 2)), r"points must have shape \(\.\.\., 3\), not \(4, 2\)"),
        ("here", "points must be numbers"),
    ],
)
def test_wrong_points_are_refused(points, words):
    scene = at.Scene.from_arrays([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    for query in (scene.closest_points, scene.signed_distance):
        with pytest.raises(at.InputError, match=words):
            query(points)


# --- Signed distances -------------------------------------------------------------------------------------------------


def box(quarter: int) -> at.Scene:
    """A box of 2 x 4 x 6 around the origin, turned about the vertical by quarters."""
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-2.0, 2.0) for z in (-3.0, 3.0)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [(a, b, c) for a, b, c, _ in sides] + [(a, c, d) for a, _, c, d in sides]
    return at.Scene.from_arrays(turned(corners, quarter), faces)


def turned(points, quarter):
    return points if quarter == 0 else np.stack([points[:, 2], points[:, 1], -points[:, 0]], 1)


@pytest.mark.parametrize("quarter", [0, 1])
def test_signed_distances_are_those_of_a_box(quarter):
    points = np.random.default_rng(8).uniform(-4, 4, (400, 3)).astype(np.float32).astype(np.float64)
    beyond = np.abs(points) - (1, 2, 3)
    truth = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(1), 0.0)
    found = box(quarter).signed_distance(turned(points, quarter))
    assert 40 < (found < 0.0).sum() < 360
    np.testing.assert_allclose(found, truth, rtol=1e-14, atol=1e-14)


def test_signed_distances_are_positive_zero_on_faces():
    found = box(0).signed_distance([[1.0, 0.5, 0.25], [1.0, 2.0, 3.0], [0.0, -2.0, 0.0]])
    assert found.tolist() == [0.0] * 3 and not np.signbit(found).any()


def test_signed_distances_are_those_of_trimesh_with_the_other_sign():
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("rtree", reason="no rtree: trimesh's distances are NOT compared", exc_type=ImportError)
    mesh = trimesh.creation.torus(1.0, 0.3, 24, 12)
    points = np.random.default_rng(9).uniform(-1.5, 1.5, (200, 3))
    found = at.load(mesh).signed_distance(points)
    np.testing.assert_allclose(found, -trimesh.proximity.signed_distance(mesh, points), atol=1e-6)
    assert 5 < (found < 0.0).sum() < 150
