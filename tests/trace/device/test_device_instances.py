"""Instances on devices: the bits and numbers of flattened copies, which are never made."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.engine import Engine
from antumbra.engine.plan import parse_plan
from antumbra.engine.sources.instanced_source import traces_instances
from antumbra.query.light_samples import light_samples
from antumbra.query.ray_list import HitFilter, rays_of
from antumbra.query.shadow_query import new_bits
from antumbra.trace.device.device_instances import ForestTracer
from antumbra.trace.device.device_stages import CAPACITIES, Capacities
from antumbra.trace.device.device_tracer import DeviceTracer
from devices import DEVICES, device_plans, opened
from instance_scenes import block, both, random_scenes, random_transforms, rays_to_corners, whole_scenes

PLANS = device_plans(text=True)[:2]
"""Devices build no trees of instances."""

SCENES = {
    "random": random_scenes,
    "far": lambda: random_scenes(3, 5e6),
    "whole": whole_scenes,
    "one copy": lambda: both([block()], [np.eye(4)[None]]),
    "flat mesh": lambda: both([(block()[0] * (1.0, 0.0, 1.0), block()[1])], [random_transforms(7, 5)]),
}
FEW = Capacities(pairs=24, records=3, least=4)


@pytest.fixture(scope="module", params=SCENES)
def scenes(request):
    """(instances, flattened)."""
    return SCENES[request.param]()


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return opened(request.param)


@pytest.fixture(scope="module", params=[CAPACITIES, FEW], ids=["large lists", "tiny lists"])
def tracer(request, device):
    return ForestTracer(DeviceTracer(device, request.param))


def forest_of(tracer, scene):
    return tracer.forest(Engine(scene).source.trees)


@pytest.mark.parametrize("cull_faces", [None, "back"])
def test_rays_have_the_hits_of_the_flattened_scene(tracer, scenes, cull_faces):
    inside, flat = scenes
    origins, directions = rays_to_corners(inside, flat, 500, 1)
    rng, n = np.random.default_rng(2), len(origins)
    hits = {"tmin": rng.choice([0.0, 0.0, 0.2], n), "tmax": rng.choice([0.9, 1.0, 2.0, np.inf], n)}
    hits |= {"skip_face": rng.integers(-1, flat.n_triangles, n), "cull_faces": cull_faces}
    rays = rays_of(origins, directions, HitFilter(**hits), tuple(inside.origin.tolist()), inside.n_triangles)
    forest = forest_of(tracer, inside)
    ours, theirs = tracer.trace_rays(forest, rays, False, 2), flat.closest_hit(origins, directions, **hits)
    for name in ("face", "t", "u", "v"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
    blocked = tracer.trace_rays(forest, rays, True, 2).blocked
    np.testing.assert_array_equal(blocked, theirs.face >= 0)
    assert 0.02 < blocked.mean() < 0.98


LIGHT = at.QuadLight((-4, 14, -4), (8, 0, 0), (0, 0, 8))


@pytest.mark.parametrize("spp", [1, 16, 33])
def test_samples_are_occluded_where_flattened_copies_occlude_them(tracer, spp):
    inside, flat = whole_scenes(4)
    rng = np.random.default_rng(3)
    points = rng.integers(-9, 9, (60, 3)) + rng.choice([0.0, 0.5, 0.25], (60, 3))
    normals = rng.normal(size=(60, 3))
    receivers = at.Receivers.of(points, normals, inside.origin, inside.middle)
    query = inside.engine.queries(receivers, [LIGHT], [light_samples(LIGHT, spp)])[0]
    expected = flat.engine.shadows(receivers, [LIGHT], [light_samples(LIGHT, spp)])[0].bits
    bits = new_bits(query)
    tracer.trace_shadow(forest_of(tracer, inside), query, bits, 2)
    np.testing.assert_array_equal(bits, expected)
    assert 0 < np.bitwise_count(bits).sum() < 60 * spp


def test_the_cpu_traces_only_rays_that_float64_leaves_open(device):
    inside, _ = random_scenes()
    tracer, rng = ForestTracer(DeviceTracer(device)), np.random.default_rng(4)
    low, high = np.asarray(inside.bounds)
    origins, targets = low + rng.random((2, 400, 3)) * (high - low)
    rays = rays_of(origins, targets - origins, HitFilter(), tuple(inside.origin.tolist()), inside.n_triangles)
    forest = forest_of(tracer, inside)
    hits = tracer.trace_rays(forest, rays, False, 2)
    assert (hits.face >= 0).any() and tracer.on_cpu < 40
    tracer.trace_rays(forest, rays, True, 2)
    assert tracer.on_cpu < 40


@pytest.mark.parametrize("plan", PLANS)
def test_engines_trace_instances_on_devices_without_flattening_them(plan, scenes):
    inside, flat = scenes
    engine = Engine(inside, plan)
    origins, directions = rays_to_corners(inside, flat, 300, 5)
    blocked = engine.occluded(origins, directions)
    np.testing.assert_array_equal(blocked, flat.occluded(origins, directions))
    ours, theirs = (each.closest_hit(origins, directions) for each in (engine, flat))
    for name in ("face", "t", "u", "v", "corners"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
    found, expected = (each.all_hits(origins, directions).face for each in (engine, flat))
    np.testing.assert_array_equal(found, expected)
    points = origins[:100]
    bits = [at.visibility(scene, points, LIGHT, spp=8, plan=each).bits for scene, each in
            ((inside, plan), (flat, "bsah+single"))]  # fmt: skip
    np.testing.assert_array_equal(*bits)
    assert "_flat" not in vars(inside.data) and str(engine.plan) == plan


@pytest.mark.parametrize("plan", PLANS)
def test_pictures_of_instances_have_their_shadows_from_the_device(plan):
    inside, flat = whole_scenes(1)
    camera = at.Camera((0, 12, 24), (0, 0, 0), width=24, height=18)
    plans = (inside, plan), (flat, "bsah+single")
    frames = [at.render(scene, camera, LIGHT, spp=4, plan=each) for scene, each in plans]
    np.testing.assert_array_equal(frames[0].bits[0], frames[1].bits[0])
    assert frames[0].plan == plan and "_flat" not in vars(inside.data) and frames[1].bits[0].any()


def test_shafts_on_devices_need_flattened_copies():
    plan, points = "bsah+multifrusta+device:host:0", np.random.default_rng(6).uniform(-9, 9, (40, 3))
    inside, flat = whole_scenes(2)
    bits = [at.visibility(scene, points, LIGHT, spp=16, plan=each).bits for scene, each in
            ((inside, plan), (flat, "bsah+single"))]  # fmt: skip
    np.testing.assert_array_equal(*bits)
    assert bits[0].any() and "_flat" in vars(inside.data) and not traces_instances(parse_plan(plan))


class OnCard:
    """As tensors of PyTorch on a card."""

    __cuda_array_interface__ = None

    def __array__(self, *arguments, **options):
        raise TypeError


def test_arrays_on_cards_are_refused_with_the_cure():
    message = "^origins: the array is on a card, from which this plan or scene takes none; copy it to the host$"
    with pytest.raises(at.InputError, match=message):
        Engine(whole_scenes(2)[0], "bsah+device:host").occluded(OnCard(), np.ones((3, 3)))
