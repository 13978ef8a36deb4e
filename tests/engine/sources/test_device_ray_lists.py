"""Ray lists of engines on devices: checks, times, moved triangles, cut-outs, and what the CPU answers."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.bvh import binned_sah, lbvh
from antumbra.engine.engine import Engine
from antumbra.engine.sources import device_ray_lists
from antumbra.engine.sources.device_ray_lists import REBUILD
from antumbra.trace.device import device_tracer as device_tracer_module
from antumbra.trace.device.device_tree import UploadedTree
from antumbra.trace.device.tree_build import BuiltTree
from cutout_scenes import scene_with_cutouts
from devices import device_plans
from truths import soup_scene

PLANS = device_plans(text=True)
UPLOADED, BUILT = (
    pytest.mark.parametrize("plan", [plan for plan in PLANS if plan.values[0].startswith(builder)])
    for builder in ("bsah", "lbvh")
)


def rays_in(scene, n, seed=1):
    low, high = np.asarray(scene.bounds)
    return low + np.random.default_rng(seed).random((2, n, 3)) * (high - low)


def check(engine, scene, n=200):
    """Compare any and nearest hits with those of the scene's own engine."""
    origins, targets = rays_in(scene, n)
    blocked = engine.occluded(origins, targets=targets)
    np.testing.assert_array_equal(blocked, scene.occluded(origins, targets=targets))
    ours, theirs = (each.closest_hit(origins, targets - origins) for each in (engine, scene))
    for name in ("face", "t", "u", "v"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert 0 < blocked.mean() < 1
    return ours


@pytest.mark.parametrize("plan", PLANS)
def test_shapes_points_and_objects_are_those_of_the_cpu(plan):
    scene = soup_scene(3)
    engine, (origins, targets) = Engine(scene, plan), rays_in(scene, 24)
    origins, directions = origins.reshape(4, 6, 3), (targets - origins).reshape(4, 6, 3)
    ours, theirs = (each.closest_hit(origins, directions, tmax=[2.0]) for each in (engine, scene))
    assert ours.t.shape == (4, 6) and (ours.face >= 0).any()
    np.testing.assert_array_equal(ours.position, theirs.position)
    assert engine.occluded(origins[0, 0], directions[0, 0]).shape == ()


@pytest.mark.parametrize(
    "change, message", [({"tmin": -1.0}, "tmin"), ({"directions": np.zeros(3)}, "zero"), ({"tmax": np.nan}, "NaN")]
)
def test_invalid_rays_are_refused_as_on_the_cpu(change, message):
    scene = soup_scene(3)
    for engine in Engine(scene, device="host"), scene:
        with pytest.raises(InputError, match=message):
            engine.occluded(**{"origins": np.zeros((3, 3)), "directions": np.ones(3)} | change)


@UPLOADED
def test_moved_triangles_are_refitted_on_the_device_until_a_new_tree_pays(plan, monkeypatch):
    scene, rng, moves, move = soup_scene(4), np.random.default_rng(2), [], UploadedTree.move
    monkeypatch.setattr(UploadedTree, "move", lambda *arguments: moves.append(1) or move(*arguments))
    engine, trees = Engine(scene, plan), []
    world = scene.triangles().vertices + scene.origin
    for amount in (0.0, 0.01, 0.01, 3.0, 0.01):
        if amount:
            world = world + rng.normal(0, amount, world.shape)
            scene.update(world)
        check(engine, scene)
        trees.append(engine._device_rays._ready.accelerated.prepared.tree)
    # the first tree is shared with point queries, so that the first update uploads another one
    assert trees[1] is not trees[0] and trees[2] is trees[1] and trees[3] is not trees[2] and trees[4] is trees[3]
    assert len(moves) == 2 and REBUILD > 1.0


@BUILT
def test_moved_triangles_are_refitted_where_the_tree_was_built_and_never_on_the_cpu(plan, monkeypatch):
    scene, rng, trees, builds = soup_scene(4), np.random.default_rng(2), [], []
    world = scene.triangles().vertices + scene.origin
    engine, tracer = Engine(scene, plan), device_tracer_module.DeviceTracer
    build = tracer.build
    monkeypatch.setattr(tracer, "build", lambda *arguments: builds.append(len(trees)) or build(*arguments))
    for amount in (0.001, 0.001, 0.001, 3.0, 0.001):  # the first gives all triangles an area
        world = world + rng.normal(0, amount, world.shape)
        scene.update(world)
        with monkeypatch.context() as without:
            for method in binned_sah, lbvh:
                without.setattr(method, "build", None)
            without.setattr(device_ray_lists, "refit_faces", None)
            ours = engine.occluded(*rays_in(scene, 200))
        np.testing.assert_array_equal(ours, scene.occluded(*rays_in(scene, 200)))
        trees.append(engine._device_rays._ready.accelerated)
        assert trees[-1].bvh is None and isinstance(trees[-1].prepared.tree, BuiltTree)
    check(engine, scene)
    assert builds == [0, 3]  # until a refit cost more than LIMIT


@pytest.mark.parametrize("plan", PLANS)
def test_a_query_keeps_the_triangles_from_before_an_update(plan):
    """Point queries share the first tree of ray lists, which an update must not change under them."""
    scene = soup_scene(4)
    engine = Engine(scene, plan)
    check(engine, scene)
    before = engine.accelerated()
    nodes = before.prepared.tree.nodes.read(np.empty_like(before.prepared.tree.bvh.nodes))
    scene.update(scene.triangles().vertices + scene.origin + 0.125)
    check(engine, scene)
    np.testing.assert_array_equal(before.prepared.tree.nodes.read(np.empty_like(nodes)), nodes)


@pytest.mark.parametrize("plan", PLANS)
def test_the_cpu_adds_cut_outs_and_finds_all_hits(plan):
    scene = scene_with_cutouts()
    engine, (origins, targets) = Engine(scene, plan), rays_in(scene, 200)
    hit = check(engine, scene)
    assert np.isin(hit.face, scene.data.cutouts.faces).any()
    ours, theirs = (each.all_hits(origins, targets=targets) for each in (engine, scene))
    np.testing.assert_array_equal(ours.face, theirs.face)
    points = rays_in(scene, 50)[0]
    np.testing.assert_array_equal(engine.contains(points), scene.contains(points))


@pytest.mark.parametrize("plan", PLANS)
def test_threads_share_an_engine_on_a_device(plan):
    scene = soup_scene(5)
    engine, lists = Engine(scene, plan), [rays_in(scene, 60, seed) for seed in range(6)]
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda rays: engine.occluded(rays[0], targets=rays[1]), lists))
    for blocked, (origins, targets) in zip(found, lists):
        np.testing.assert_array_equal(blocked, scene.occluded(origins, targets=targets))
