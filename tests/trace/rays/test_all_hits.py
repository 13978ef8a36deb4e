"""All hits of rays, their numbers, and the insides of surfaces, in memory and in stores: against rational numbers."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from antumbra.bvh.wide_bvh import widen
from antumbra.engine.method_registry import BUILDERS
from antumbra.engine.sources.in_memory_source import RAY_PLANS
from antumbra.query.ray_list import rays_of
from antumbra.scene.triangles import HitFilter
from antumbra.trace.rays.all_hits import TRIANGLES, HitMemory, count_all, find_all, unsigned
from antumbra.trace.rays.ray_batches import RayTracer
from cutout_scenes import meets as stops
from cutout_scenes import scene_with_cutouts
from ray_cases import KINDS, N, displaced_meets, rays_of_kind
from strength import examples

STORE = 16  # triangles in a chunk


def _in_memory(scene, tmp_path):
    return scene


def _in_a_store(scene, tmp_path):
    at.build_store(scene, tmp_path / "a.antumbra", chunk=STORE)
    return at.load(tmp_path / "a.antumbra")


SOURCES = {"memory": _in_memory, "store": _in_a_store}


def truth_of(scene, world, directions, counts=lambda ray, face, side: True):
    """For each ray, all (t, face) that it meets, by rational arithmetic; directions may be Fractions."""
    triangles, origins = scene.triangles().vertices, (world - scene.origin).astype(np.float32)
    out = []
    for i, (o, d) in enumerate(zip(origins, directions)):
        tmax = 1 if isinstance(d[0], Fraction) else np.inf
        met = [(face, *oracle.meets_exactly(o, d, triangle, 0.0, tmax)) for face, triangle in enumerate(triangles)]
        hits = sorted((float(t), side, face) for face, side, t in met if side and counts(i, face, side))
        out.append([(t, face) for t, _, face in hits])
    assert sum(map(len, out)) > len(out) // 3
    return out


def assert_hits(hits, truth):
    """Assert that `AllHits` are true."""
    np.testing.assert_array_equal(hits.counts, [len(each) for each in truth])
    flat = [pair for each in truth for pair in each]
    np.testing.assert_array_equal(hits.t, [t for t, _ in flat])
    np.testing.assert_array_equal(hits.face, [face for _, face in flat])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("source", SOURCES)
def test_all_hits_are_those_of_real_arithmetic(source, kind, tmp_path):
    scene, world, directions = rays_of_kind(kind, True)
    engine, truth = SOURCES[source](scene, tmp_path), truth_of(scene, world, directions)
    hits = engine.all_hits(world, directions)
    assert_hits(hits, truth)
    np.testing.assert_array_equal(engine.count_hits(world, directions), hits.counts)
    assert_hits(engine.all_hits(world, directions, max_hits=2), [each[:2] for each in truth])
    first, there = engine.closest_hit(world, directions), hits.counts > 0
    nearest = hits.ray_offsets[:-1][there]
    for name in "t", "face", "u", "v":
        np.testing.assert_array_equal(getattr(hits, name)[nearest], getattr(first, name)[there])


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_skipped_faces_and_sides(source, kind, tmp_path):
    scene, world, directions = rays_of_kind(kind, True)
    whole = truth_of(scene, world, directions)
    middle = [each[len(each) // 2][0] if each else 1.0 for each in whole]
    skip = np.array([each[0][1] if each else -1 for each in whole])
    sides = {}
    truth_of(scene, world, directions, lambda i, face, side: sides.setdefault((i, face), side))
    engine = SOURCES[source](scene, tmp_path)
    for arguments, counts in (
        ({"tmin": middle}, lambda i, t, face: t > middle[i]),
        ({"tmax": middle}, lambda i, t, face: t < middle[i]),
        ({"skip_face": skip}, lambda i, t, face: face != skip[i]),
        ({"cull_faces": "front"}, lambda i, t, face: sides[i, face] > 0),
        ({"cull_faces": "back"}, lambda i, t, face: sides[i, face] < 0),
    ):
        truth = [[hit for hit in each if counts(i, *hit)] for i, each in enumerate(whole)]
        assert_hits(engine.all_hits(world, directions, **arguments), truth)
        np.testing.assert_array_equal(engine.count_hits(world, directions, **arguments), list(map(len, truth)))


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("kind", KINDS)
def test_segments(source, kind, tmp_path):
    scene, world, directions = rays_of_kind(kind, True)
    targets = world + 3.0 * directions
    ends = [(points - scene.origin).astype(np.float32) for points in (world, targets)]
    along = [oracle.minus(oracle.rational(b), oracle.rational(a)) for a, b in zip(*ends)]
    engine, truth = SOURCES[source](scene, tmp_path), truth_of(scene, world, along)
    assert_hits(engine.all_hits(world, targets=targets), truth)
    np.testing.assert_array_equal(engine.count_hits(world, targets=targets), list(map(len, truth)))
    np.testing.assert_array_equal(engine.occluded(world, targets=targets), [len(each) > 0 for each in truth])


def test_cutouts_have_holes():
    scene, rng = scene_with_cutouts(), np.random.default_rng(3)
    world = rng.uniform((-3, 0, -3), (3, 3, 3), (N, 3)).astype(np.float32) + scene.origin
    directions = rng.normal(size=(N, 3)).astype(np.float32)
    triangles, local = scene.triangles(), (world - scene.origin).astype(np.float32)
    exact = [oracle.rational(d) for d in directions]
    truth = truth_of(scene, world, directions, lambda i, face, side: stops(triangles, local[i], exact[i], face))
    assert sum(map(len, truth)) < 0.9 * sum(map(len, truth_of(scene, world, directions)))
    assert_hits(scene.all_hits(world, directions), truth)
    assert_hits(scene.all_hits(world, directions, max_hits=1), [each[:1] for each in truth])
    for merge in "none", "surface":
        np.testing.assert_array_equal(scene.count_hits(world, directions, merge=merge), list(map(len, truth)))


# --- Surfaces and their insides ---------------------------------------------------------------------------------------


def box(low, high):
    """(12, 3, 3): the faces of a box, from inside and outside alike."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    quads = (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)
    return np.concatenate([[corners[[a, b, c]], corners[[a, c, d]]] for a, b, c, d in quads]).astype(float)


small = st.integers(-3, 3)
point = st.tuples(small, small, small)


@examples(60)
@given(
    st.lists(st.tuples(point, point, point), min_size=1, max_size=8),
    st.lists(st.tuples(point, point.filter(any)), min_size=1, max_size=8),
)
def test_surfaces_are_counted_as_by_displaced_rays(soup, rays):
    scene = at.Scene.from_arrays(np.array(soup, np.float32))
    world, directions = (np.array(each, np.float64) for each in zip(*rays))
    vertices, origins = scene.triangles().vertices, (world - scene.origin).astype(np.float32)
    truth = [
        sum(bool(oracle.meets_exactly(o, d, triangle)[0]) and displaced_meets(o, d, triangle) for triangle in vertices)
        for o, d in zip(origins, directions.astype(np.float32))
    ]
    np.testing.assert_array_equal(scene.count_hits(world, directions, merge="surface"), truth)


@pytest.mark.parametrize("source", SOURCES)
def test_a_box_contains_its_points_by_comparing_coordinates(source, tmp_path):
    """All points of a grid through the corners, edges and faces of boxes inside one another."""
    shells = [((-3, -3, -3), (3, 3, 3)), ((-2, -2, -2), (2, 2, 2)), ((-1, -1, -1), (1, 1, 1))]
    scene = at.Scene.from_arrays(np.concatenate([box(*each) for each in shells]), up="z")
    points = np.stack(np.meshgrid(*[np.arange(-4, 4.5, 0.5)] * 3, indexing="ij"), -1)
    size = np.abs(points).max(-1)
    truth = (size <= 1) | ((size >= 2) & (size <= 3))
    inside = SOURCES[source](scene, tmp_path).contains(points)
    assert inside.shape == points.shape[:-1] and 0.2 < truth.mean() < 0.8
    np.testing.assert_array_equal(inside, truth)


def test_points_in_turned_bodies():
    """Tetrahedra at random, whose insides four exact plane sides tell; points include corners and points on edges."""
    rng, n = np.random.default_rng(5), 60
    for up in "yz":
        corners = rng.integers(-4, 5, (n, 4, 3)).astype(np.float32)
        for body in corners:
            faces = body[[[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]]]
            if np.linalg.det((body[1:] - body[0]).astype(float)) == 0:
                continue
            points = np.concatenate(
                [body, (body[:, None] + body[None]).reshape(-1, 3) / 2, rng.integers(-4, 5, (40, 3))]
            )
            scene = at.Scene.from_arrays(faces, up=up)
            local = (points - scene.origin).astype(np.float32)
            sides = np.array([[oracle.plane_side(p, t) for t in scene.triangles().vertices] for p in local])
            turn = oracle.plane_side(local[3], scene.triangles().vertices[0])
            np.testing.assert_array_equal(scene.contains(points), (sides * turn >= 0).all(1))


def test_overlapping_bodies_and_holes_follow_the_parity():
    scene = at.Scene.from_arrays(np.concatenate([box((0, 0, 0), (2, 2, 2)), box((1, 0, 0), (3, 2, 2))]), up="z")
    np.testing.assert_array_equal(scene.contains([(0.5, 1, 1), (1.5, 1, 1), (2.5, 1, 1)]), [True, False, True])
    open_below = box((0, 0, 0), (2, 2, 2))
    open_below = open_below[~(open_below[:, :, 2] == 0).all(1)]
    scene = at.Scene.from_arrays(open_below, up="z")
    np.testing.assert_array_equal(scene.contains([(1, 1, 1), (1, 1, -1), (1, 1, 3)]), [True, False, False])


def test_textures_do_not_open_bodies():
    scene = scene_with_cutouts()
    points = np.random.default_rng(1).uniform((-3, 0, -3), (3, 3, 3), (200, 3))
    inside = scene.contains(points)
    triangles = scene.triangles()
    visible = np.union1d(triangles.cutouts.faces, triangles.cutouts.solid)  # the others are clear everywhere
    assert len(visible) < scene.n_triangles
    solid = at.Scene.from_arrays(triangles.vertices[visible].astype(np.float64) + scene.origin)
    np.testing.assert_array_equal(inside, solid.contains(points))
    assert 0.1 < inside.mean() < 0.9


# --- Memory, threads and errors ---------------------------------------------------------------------------------------


def tracer_of(vertices, builder="bsah"):
    return RayTracer(widen(BUILDERS[builder].build(np.asarray(vertices, np.float32), 2), 2))


def crowded(n=3000, layers=400):
    """(vertices, rays): some rays through all of many layers, others past them."""
    rng = np.random.default_rng(2)
    z = rng.permutation(layers).astype(np.float32)
    sheet = np.array([[-1, -1, 0], [3, -1, 0], [-1, 3, 0]], np.float32)
    vertices = sheet + np.stack([0 * z, 0 * z, z], -1)[:, None]
    origins = rng.uniform(-2, 3, (n, 3)).astype(np.float32) * (1, 1, 0) - (0, 0, 1)
    rays = rays_of(origins, np.array([0.0, 0, 1]), HitFilter(), (0.0, 0.0, 0.0), layers)
    return vertices, rays


@pytest.mark.parametrize("kind", KINDS)
def test_counts_of_points_are_those_of_distinct_t_or_unclear(kind):
    """Hits that may be apart at one t, as those of several geometries, are unclear."""
    scene, world, directions = rays_of_kind(kind, False)
    hits = scene.all_hits(world, directions)
    distinct = np.array([len(np.unique(t)) for t in np.split(hits.t, hits.ray_offsets[1:-1])])
    rays = np.concatenate([world, directions], axis=1)
    for apart in False, True:
        counts = scene.engine._count_points(rays, apart)
        clear = counts >= 0
        np.testing.assert_array_equal(counts[clear], distinct[clear])
        assert (hits.counts == distinct)[clear].all() if apart else clear[distinct <= 32].all()


def test_rays_through_distinct_layers_are_clear_and_those_through_many_or_perhaps_equal_ones_are_not():
    layer, x = np.float32([[-9, -9, 0], [9, -9, 0], [0, 9, 0]]), np.arange(50) / 50
    rays = np.stack([x, 0 * x, 0 * x - 1, 0 * x + 0.01, 0 * x, 0 * x + 1], axis=1)

    def counts(heights, apart=True):
        scene = at.Scene.from_arrays(np.stack([layer + np.float32([0, 0, z]) for z in heights]))
        return set(scene.engine._count_points(rays, apart).tolist())

    for n in 5, 16, 17, 32:
        assert counts(range(n)) == counts(range(n), False) == {n}
    assert counts([0, 1, 1, 2]) == counts(range(33)) == counts(range(33), False) == {-1}
    assert counts([0, 1, 1, 2], False) == {3}
    late = [*range(20), 18]  # equal ones are stored beyond the first 16
    assert counts(late) == {-1} and counts(late, False) == {20}
    close = [5.0, 5.0 + 2.0**-20, 6.0]  # for float32
    assert counts(close) == {-1} and counts(close, False) == {3}


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("room", [1, 50, 1 << 14])
@pytest.mark.parametrize("together", [1, 7, 1 << 14])
def test_memory_does_not_change_the_hits(threads, room, together):
    vertices, rays = crowded()
    tracer = tracer_of(vertices)
    for max_hits in None, 3:
        hits = unsigned(find_all(tracer, rays, max_hits, threads=threads, memory=HitMemory(together, room)))
        counts = count_all(tracer, rays, TRIANGLES, threads)
        assert set(np.unique(counts)) == {0, len(vertices)}
        np.testing.assert_array_equal(hits.counts, counts if max_hits is None else np.minimum(counts, 3))
        expected = np.arange(1.0, 1 + (len(vertices) if max_hits is None else 3))
        for i in np.flatnonzero(counts)[:50]:
            np.testing.assert_array_equal(hits.t[hits.ray_offsets[i] : hits.ray_offsets[i + 1]], expected)


@pytest.mark.parametrize("builder", BUILDERS)
def test_every_builder_gives_the_same_hits(builder):
    if BUILDERS[builder].wants_rays:
        pytest.skip("guided by rays")
    scene, world, directions = rays_of_kind("stack", False)
    vertices = scene.triangles().vertices
    rays = rays_of(world, directions, HitFilter(), tuple(scene.origin), len(vertices))
    for mine, other in zip(unsigned(find_all(tracer_of(vertices, builder), rays)), scene.all_hits(world, directions)):
        np.testing.assert_array_equal(mine, other)


@pytest.mark.parametrize("source", SOURCES)
def test_shapes_and_no_rays(source, tmp_path):
    scene = SOURCES[source](at.Scene.from_arrays(np.tile(box((0, 0, 0), (1, 1, 1)), (3, 1, 1))), tmp_path)
    hits = scene.all_hits(np.full((2, 1, 3), (0.4, 0.3, 0.45)), np.array([[1.0, 0, 0.1], [0, 1, 0], [0, 0, -1]]))
    assert hits.counts.tolist() == [3, 3, 3, 3, 3, 3] and hits.ray.tolist() == np.repeat(range(6), 3).tolist()
    assert scene.count_hits(np.full((2, 1, 3), 0.4), np.ones((3, 3))).shape == (2, 3)
    assert scene.count_hits([0.4, 0.3, 0.4], [1, 0, 0.1]).shape == () == scene.contains([0.4, 0.3, 0.4]).shape
    none = scene.all_hits(np.empty((0, 3)), np.empty((0, 3)))
    assert len(none.t) == 0 and none.ray_offsets.tolist() == [0]
    assert scene.count_hits(np.empty((0, 3)), np.empty((0, 3))).shape == scene.contains(np.empty((0, 3))).shape == (0,)
    far = scene.all_hits([[9, 9, 9.0]], [[1, 1, 1.0]])
    assert far.counts.tolist() == [0] and [array.dtype.str[1:] for array in far] == ["i8", "f8", "i4", "f4", "f4"]


@pytest.mark.parametrize("source", SOURCES)
def test_bad_arguments(source, tmp_path):
    scene = SOURCES[source](at.Scene.from_arrays(box((0, 0, 0), (1, 1, 1))), tmp_path)
    rays = np.zeros((3, 3)), np.ones((3, 3))
    for call, message in (
        (lambda: scene.all_hits(*rays, max_hits=0), "max_hits"),
        (lambda: scene.all_hits(rays[0], [[1, 1, 1], [np.nan, 0, 0], [1, 1, 1]]), r"directions hold NaN .*ray 1"),
        (lambda: scene.count_hits(rays[0], np.zeros((3, 3))), "direction of ray 0 is zero"),
        (lambda: scene.count_hits(*rays, merge="edges"), "merge.*none.*surface"),
        (lambda: scene.count_hits(rays[0], targets=rays[1], tmax=2.0), "targets"),
        (lambda: scene.contains(np.zeros((3, 2))), r"points must have shape \(\.\.\., 3\)"),
        (lambda: scene.contains([[0, 0, 0], [0, np.inf, 0]]), "points are NaN, infinite .*point 1"),
    ):
        with pytest.raises(at.InputError, match=message):
            call()


def test_the_plan_of_ray_lists_is_used():
    scene = at.Scene.from_arrays(box((0, 0, 0), (1, 1, 1)))
    scene.count_hits([0.5, 0.4, 0.5], [1, 0, 0])
    assert str(scene.engine.source.ray_lists.plan) in RAY_PLANS
