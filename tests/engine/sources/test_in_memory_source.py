"""Ray lists: the tree of a moment is optimised once its rays have lost the price, and answers stay."""

import threading

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.auto import cost_model
from antumbra.engine.plan import parse_plan
from antumbra.engine.sources.in_memory_source import RAY_PLANS
from forked import held_elsewhere

FIRST, BETTER = map(parse_plan, RAY_PLANS)


class _Lasting:
    """A source that lasts two seconds and does not move."""

    duration = 2.0

    def __init__(self, source):
        self._source = source

    def __getattr__(self, name):
        return getattr(self._source, name)


@pytest.fixture
def scene():
    return at.procedural("atrium", triangles=3000)


def _rays(n=500):
    rng = np.random.default_rng(2)
    return rng.uniform((-6, 0.1, -4), (6, 5, 4), (n, 3)), rng.normal(size=(n, 3))


def _price(monkeypatch, seconds):
    monkeypatch.setattr(cost_model, "build_seconds", lambda tree, n: seconds)


@pytest.mark.parametrize("seconds", [0.0, 1e6])
def test_rays_get_a_better_tree_once_it_pays(scene, monkeypatch, seconds):
    _price(monkeypatch, seconds)
    rays = _rays()
    tree_of = lambda plan: scene.engine.with_options(plan, None, None).accelerated().bvh
    blocked, first, hit = scene.occluded(*rays), tree_of(FIRST), scene.closest_hit(*rays)
    assert 0.1 < blocked.mean() < 1
    plan = scene.engine.source.ray_lists.plan
    assert plan == (BETTER if seconds == 0.0 else FIRST)
    assert (tree_of(FIRST) is first) == (plan == FIRST)  # a tree that was replaced is evicted
    tree = tree_of(plan)
    np.testing.assert_array_equal(scene.occluded(*rays), blocked)
    assert tree_of(plan) is tree
    assert (scene.closest_hit(*rays).face == hit.face).all() and (scene.closest_hit(*rays).t == hit.t).all()


def test_another_moment_begins_anew(scene, monkeypatch):
    _price(monkeypatch, 0.0)
    moving = at.Scene(_Lasting(scene.source))
    for time in (0.0, 1.0):
        moving.occluded(*_rays(), time=time)
        lists = moving.engine.source.ray_lists
        assert lists.plan == FIRST
        moving.occluded(*_rays(), time=time)
        assert lists.plan == BETTER


def test_illegal_rays_are_refused_after_the_tree_was_optimised(scene, monkeypatch):
    _price(monkeypatch, 0.0)
    origins, directions = _rays()
    scene.occluded(origins, directions)
    directions[7] = np.nan
    with pytest.raises(at.InputError, match="direction"):
        scene.occluded(origins, directions)


def test_only_one_call_waits_for_a_better_tree(scene):
    """The other threads go on with the present tree."""
    rays, found = _rays(), []
    expected, lists = scene.occluded(*rays), scene.engine.source.ray_lists
    assert lists.plan == FIRST
    lists.spent = 1e9
    with held_elsewhere(lists._lock):  # as by a thread that builds
        thread = threading.Thread(target=lambda: found.append(scene.occluded(*rays)), daemon=True)
        thread.start()
        thread.join(60)
        assert found and lists.plan == FIRST
    found.append(scene.occluded(*rays))
    assert lists.plan == BETTER and all(np.array_equal(each, expected) for each in found)


def _dome(shares, n=400):
    """A room with walls of glass, triangle by triangle: random faces, each with one of the shares of light."""
    rng = np.random.default_rng(5)
    faces = (rng.uniform(-3, 3, (n, 1, 3)) + rng.normal(0, 0.5, (n, 3, 3))).astype(np.float32)
    parts = [at.Scene.from_arrays(faces[k :: len(shares)], name=f"part{k}") for k in range(len(shares))]
    scene = parts[0]
    for part in parts[1:]:
        scene = at.changed_scene(scene, add=[(part, (0, 0, 0))])
    scene.set_transmittance({f"part{k}": share for k, share in enumerate(shares)})
    return scene


@pytest.mark.parametrize("shares", [(0.0, 0.2, 0.4), (0.0, 0.3, 0.9), (0.2, 0.2), (0.8, 0.1)])
def test_panes_that_rays_meet_everywhere_are_solid_for_them_and_answers_are_those_of_their_faces(shares):
    scene, (origins, directions) = _dome(shares), _rays()
    drawn = scene.triangles(0.0)
    met = np.flatnonzero(np.array(shares)[scene.object_of_face[np.arange(scene.n_triangles)]] <= 0.5)
    opaque = at.Scene.from_arrays(drawn.vertices[met] + drawn.origin)
    hit, want = scene.closest_hit(origins, directions), opaque.closest_hit(origins, directions)
    assert (hit.face == np.append(met, -1)[want.face]).all() and hit.mask.mean() > 0.1
    assert (scene.occluded(origins, directions) == opaque.occluded(origins, directions)).all()
    assert (scene.count_hits(origins, directions) == opaque.count_hits(origins, directions)).all()
    rays = scene.engine.source.ray_lists
    assert (rays._ready.accelerated.cutouts is None) == (max(shares) <= 0.5)
    moved = drawn.vertices + drawn.origin + np.float32(0.25)
    scene.update(moved.reshape(-1, 3))
    hit, want = (each.closest_hit(origins, directions) for each in (scene, at.Scene.from_arrays(moved[met])))
    assert (hit.face == np.append(met, -1)[want.face]).all() and hit.mask.mean() > 0.1
