"""What the frame of a scene cannot hold is refused, in one line; what is next to its zero is there."""

from functools import cache

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.base.errors import InputError
from antumbra.engine.plan import Plan, covering_plans
from antumbra.engine.store_building import build_store
from antumbra.query.light_samples import light_samples
from antumbra.query.query_bounds import MOST_RATIO, place
from antumbra.scene import scene_bounds
from antumbra.scene.scene_bounds import MIN_EXTENT, NEAREST, flush_to_zero
from receivers import receivers_of

RNG = np.random.default_rng(8)
SOUP = RNG.integers(-9, 10, (40, 3, 3)).astype(float)


@pytest.mark.parametrize("scale", [2.0**-149, 1e-42, 2.0**-126, MIN_EXTENT / 32])
def test_scenes_that_float32_does_not_hold(scale):
    with pytest.raises(InputError, match=r"units wide; float32 does not hold .* multiply all coordinates"):
        at.Scene.from_arrays(SOUP * scale)


def test_a_store_of_such_a_scene(tmp_path):
    np.save(tmp_path / "frames.npy", (SOUP * 1e-40).reshape(1, -1, 3))
    np.save(tmp_path / "faces.npy", np.arange(120, dtype=np.int32).reshape(40, 3))
    with pytest.raises(InputError, match="multiply all coordinates"):
        at.load(tmp_path)


def test_a_store_of_an_earlier_version(tmp_path, monkeypatch):
    """Earlier versions wrote stores of narrower scenes. They are refused when they are opened."""
    with monkeypatch.context() as earlier:
        earlier.setattr(scene_bounds, "MIN_EXTENT", 0.0)
        build_store(at.Scene.from_arrays(SOUP * 2.0**-106), tmp_path / "a.antumbra")
        at.load(tmp_path / "a.antumbra")
    with pytest.raises(InputError, match=r"a\.antumbra: the scene is .* units wide; float32 does not hold"):
        at.load(tmp_path / "a.antumbra")


def test_the_narrowest_scenes():
    assert at.Scene.from_arrays(SOUP * MIN_EXTENT).n_triangles == 40
    assert at.Scene.from_arrays(np.full((2, 3, 3), 1e-44)).n_triangles == 2  # one point has no scale


def test_coordinates_next_to_zero():
    """They are zero, or as large as error bounds need; those of ordinary scenes do not change."""
    soup = SOUP * 2.0 ** RNG.integers(-149, 1, (40, 1, 1))
    soup = np.concatenate([soup, [[[k, k, k], [k, k, 0], [k, 0, 0]] for k in (-16.0, 16.0)]])
    scene = at.Scene.from_arrays(soup)
    vertices = scene.triangles().vertices
    assert not scene.origin.any()
    np.testing.assert_array_equal(vertices, np.where(abs(soup) < NEAREST, 0, soup).astype(np.float32))
    assert (vertices != soup.astype(np.float32)).any() and np.isnan(flush_to_zero(np.array([np.nan]))).all()
    np.testing.assert_array_equal(flush_to_zero(SOUP), SOUP)


LIGHTS = {
    "point": lambda far: at.PointLight((0, far, 0)),
    "quad": lambda far: at.QuadLight((0, 1, 0), (far, 0, 0), (0, 0, 1)),
    "disk": lambda far: at.DiskLight((0, 9, 0), (0, 1, 0), far),
    "sphere": lambda far: at.SphereLight((0, far, 0), 1.0),
    "list": lambda far: at.PointLights([(0, 1, 0), (far, 0, 0)]),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_lights_that_are_too_far_for_a_scene(name):
    scene, far = at.Scene.from_arrays(SOUP * 2.0**-60), 2.0**65
    with pytest.raises(InputError, match=r"are .* units away from a scene that is .* units wide; bring them nearer"):
        at.visibility(scene, np.zeros((1, 3)), LIGHTS[name](far))
    with pytest.raises(InputError, match="bring them nearer"):
        at.render(scene, at.Camera((0, 0, 1e-17), (0, 0, 0), width=4, height=4), LIGHTS[name](far), spp=1)
    at.visibility(scene, np.zeros((1, 3)), LIGHTS[name](2.0**55))


def test_points_that_are_too_far_for_a_scene():
    scene = at.Scene.from_arrays(SOUP * 2.0**-60)
    with pytest.raises(InputError, match="bring them nearer"):
        at.visibility(scene, [[2.0**65, 0, 0]], at.PointLight((0, 1e-10, 0)))


def test_lights_next_to_zero_and_distant_ones():
    origin, box = np.zeros(3), np.array([[-1, -1, -1], [1, 1, 1]], np.float32)
    made = place(at.QuadLight((0, 1e-40, 1), (1, 0, 1e-35), (1e-36, 1, 0)), origin, box, 4.0)
    np.testing.assert_array_equal([made.base, made.u, made.v], [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    sun = at.DirectionalLight((0, -1, 0))
    assert place(sun, origin, box, 4.0).base.tobytes() == sun.patch(origin, 4.0).base.tobytes()
    assert place(sun, origin, None, 2 * MOST_RATIO) is not None


PLANS = [plan for plan in covering_plans() if plan == Plan(trace=plan.trace)]
"""A plan for each tracer."""

TINY = 2.0 ** RNG.integers(-149, -100, (96, 3)) * RNG.integers(-1, 2, (96, 3))
"""Coordinates next to the frame's zero: some are denormal, some are set to 0, some are kept."""

CENTRED = np.concatenate([SOUP, [[[k, k, k], [k, k, 0], [k, 0, 0]] for k in (-16.0, 16.0)]])
"""A scene whose frame has its zero at the world's."""


ENDS = CENTRED[RNG.integers(0, 40, 96)].mean(1) * RNG.choice([0.5, 1.0, 2.0], (96, 1))
ENDS = np.where(RNG.random((96, 3)) < 1 / 3, 0.0, ENDS).astype(np.float32).astype(float)
"""Points of the scene's triangles, and beside them."""

WAYS = RNG.integers(-4, 5, (96, 3)) + 0.5
PACES = 2.0 ** RNG.integers(-130, 100, (192, 1))


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The centred scene in memory, and in a store."""
    path, scene = tmp_path_factory.mktemp("centred") / "a.antumbra", at.Scene.from_arrays(CENTRED)
    build_store(scene, path)
    assert not scene.origin.any()
    return scene, at.load(path)


def test_ray_lists_next_to_zero(both):
    """Origins and targets are settled, as corners are; directions of any magnitude count as they are."""
    origins, ends = np.concatenate([TINY, TINY + ENDS]), np.concatenate([ENDS, TINY])
    mine, theirs = (flush_to_zero(a.astype(np.float32)) for a in (origins, ends))
    assert (mine != origins).any() and (theirs != ends).any()
    ways = ends + np.where(ends == 0.0, TINY[::-1].repeat(2, 0), 0.0)
    ways = (ways * PACES).astype(np.float32)
    ways[~ways.any(1)] = 1.0
    vertices = both[0].triangles().vertices
    segments = oracle.occluded(vertices, mine, ends=theirs)
    t, face = oracle.closest_hit(vertices, mine, ways)
    assert 0 < segments.sum() < 192 and 0 < (face >= 0).sum() < 192
    for scene in both:
        np.testing.assert_array_equal(scene.occluded(origins, targets=ends), segments)
        np.testing.assert_array_equal(scene.occluded(origins, ways), face >= 0)
        hit = scene.closest_hit(origins, ways)
        np.testing.assert_array_equal(hit.t, t)
        np.testing.assert_array_equal(hit.face, face)


def test_a_corner_next_to_zero_is_met_by_the_segment_that_ends_beyond_it(both):
    """Were only corners settled, the segment would pass it."""
    at_corner = np.array([2.0**-115, 0.5, 0.5])
    soup = np.concatenate([CENTRED, [[at_corner, [0, 1, 0.5], [-1, 1, 0.5]]]])[40:]
    scene = at.Scene.from_arrays(soup)
    assert not scene.origin.any()
    assert scene.occluded(at_corner - (0, 0, 1), targets=at_corner + (0, 0, 1))
    assert not scene.occluded([1e-3, 0.5, -0.5], targets=[1e-3, 0.5, 1.5])


def test_directions_with_components_of_all_magnitudes(tmp_path):
    """A component of 2^-60 beside one of 2^100 decides on which side of an edge a ray passes."""
    wall = np.array([[[1.0, 0, -1], [1, 0, 1], [1, 1, 0]], [[-1.0, 0, -1], [-1, 0, 1], [-1, -1, 0]]])
    scene, path = at.Scene.from_arrays(wall), tmp_path / "a.antumbra"
    build_store(scene, path)
    directions = np.array([[2.0**100, side * 2.0**-60, 0] for side in (1, 0, -1)])
    for each in scene, at.load(path):
        np.testing.assert_array_equal(each.occluded(np.zeros((3, 3)), directions), [True, True, False])
        np.testing.assert_array_equal(each.closest_hit(np.zeros((3, 3)), directions).face, [0, 0, -1])
        np.testing.assert_array_equal(each.closest_hit(np.zeros((3, 3)), 2.0**-89 * -directions).face, [1, 1, -1])


@pytest.mark.parametrize("far", [2.0**45, 2.0**90, 2.0**120])
def test_ray_lists_far_from_the_scene(both, far):
    """Rays need no limit of distances: float64 takes over where float32 does not hold them."""
    ends = ENDS
    origins = (ends - far * WAYS).astype(np.float32)
    back = (ends - origins).astype(np.float32)
    vertices = both[0].triangles().vertices
    t, face = oracle.closest_hit(vertices, origins, back)
    segments = oracle.occluded(vertices, origins, ends=ends)
    for scene in both:
        hit = scene.closest_hit(origins, back)
        np.testing.assert_array_equal(hit.t, t)
        np.testing.assert_array_equal(hit.face, face)
        np.testing.assert_array_equal(scene.occluded(origins, targets=ends), segments)


NEXT_TO_ZERO = {
    "list": at.PointLights(np.concatenate([TINY[:4], ENDS[:2]])),
    "quad": at.QuadLight((0, 0, 0), (1e-33, 0, 0), (0, 0, 2e-33)),
    "crossing zero": at.QuadLight((-0.5, 0, -1e-20), (1, 0, 0), (0, 0, 2e-20)),
    "disk": at.DiskLight((0, 0, 0), (0, 1, 0), 1e-33),
}


@cache
def _truth(name):
    """(points, (points, n) bool: whether each sample of a light is occluded)."""
    light, points = NEXT_TO_ZERO[name], np.concatenate([TINY, ENDS])
    scene = at.Scene.from_arrays(CENTRED)
    patch = place(light, np.zeros(3), None, 1.0)
    ends = light_samples(light, 4)[np.arange(192) % 4]
    ends = ((patch.base + ends[..., :1] * patch.u) + ends[..., 1:2] * patch.v) + ends[..., 2:] * patch.w
    origins = receivers_of(scene, points, None)[0].repeat(ends.shape[1], 0)
    found = oracle.occluded(scene.triangles().vertices, origins, ends=ends.reshape(-1, 3).astype(np.float32))
    assert 0 < found.sum() < found.size
    return points, found.reshape(192, -1)


@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_samples_next_to_zero(both, plan):
    """Samples of lights are float32 points of any magnitude: see docs/design/exactness.md."""
    for name, light in NEXT_TO_ZERO.items():
        points, occluded = _truth(name)
        seen = at.visibility(both[0], points, light, spp=4, plan=plan).seen_samples
        np.testing.assert_array_equal(~seen, occluded)


@pytest.mark.parametrize(
    "plan", ["bsah+single", "bsah+wide", "bsah+multifrusta", "bsah+packet16", "cones", "lbvh+single"]
)
@pytest.mark.parametrize("size", [2.0**-103, 2.0**-109, 2.0**-116])
def test_scenes_that_shrink(tmp_path, plan, size):
    """The limits of width hold at time 0. Later, coordinates are settled all the same."""
    np.save(tmp_path / "frames.npy", np.stack([CENTRED, CENTRED * size]).reshape(2, -1, 3))
    np.save(tmp_path / "faces.npy", np.arange(CENTRED.size // 3, dtype=np.int32).reshape(-1, 3))
    scene = at.load(tmp_path)
    later = scene.duration
    light = at.PointLight(np.array([1.0, 3, 2]) * size)
    points = ENDS * size
    vertices = scene.triangles(later).vertices
    origins = receivers_of(scene, points, None)[0]
    ends = flush_to_zero(np.array(light.position)).astype(np.float32)
    truth = oracle.occluded(vertices, origins, ends=np.broadcast_to(ends, (96, 3)))
    got = at.visibility(scene, points, light, spp=1, plan=plan, time=later)
    np.testing.assert_array_equal(~got.seen, truth)
    np.testing.assert_array_equal(scene.occluded(points, targets=light.position, time=later), truth)
    assert truth.any() == (size > 2.0**-115)
