"""Cut-outs on devices: hits, dark samples and the light that passes, as on the CPU, whatever the lists can hold."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine import accelerator
from antumbra.engine.device_tracers import device_tracer
from antumbra.engine.engine import Engine
from antumbra.query.light_samples import light_samples
from antumbra.query.ray_list import HitFilter, rays_of
from antumbra.query.receivers import Receivers
from antumbra.query.shadow_query import new_bits
from antumbra.trace import alpha_cutouts
from antumbra.trace.alpha_cutouts import add_shadows, cutout_tree
from antumbra.trace.device import device_cutouts
from antumbra.trace.device.device_stages import CAPACITIES, Capacities
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.transmission import lit_fraction, shares_of
from asking import query_of
from cutout_scenes import MASKS, pane, scene_with_cutouts, seasonal, with_masks
from devices import DEVICES, device_plans, opened
from truths import LIGHTS

PLANS = device_plans(text=True)
FEW = Capacities(pairs=24, records=3, least=4)
"""Lists that a few hostile rays fill."""

CAMERA = at.Camera((0, 2, 9), (0, -0.5, 0), width=12, height=9)


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return opened(request.param)


@pytest.fixture(scope="module", params=[CAPACITIES, FEW], ids=["large lists", "tiny lists"])
def tracer(request, device):
    return DeviceTracer(device, request.param)


def through_cutouts(scene, n, seed=1):
    """(origins, targets): segments in a scene's box, most of them through corners, edges and planes of cut-outs."""
    rng = np.random.default_rng(seed)
    low, high = np.asarray(scene.bounds)
    origins, targets = (low + rng.random((n, 3)) * (high - low) for _ in range(2))
    chosen = scene.triangles().vertices[rng.choice(scene.data.cutouts.faces, n)] + scene.origin
    a, b, c = chosen.swapaxes(0, 1)
    kind, s = rng.integers(0, 7, n)[:, None], rng.random((n, 1))
    middles = [a, (a + b) / 2, a + (b - a) * s, (a + b + c) / 3, b + (b - a) * s]
    targets = np.select([kind == k for k in range(5)], [2 * middle - origins for middle in middles], targets)
    return np.where(kind == 4, a + (a - b) * s, origins), targets


def lit(engine, scene, points, month):
    """(h, w) float32: the light that arrives at points in a month."""
    light = LIGHTS["quad"]
    receivers = Receivers.in_space(points, scene.triangles().origin)
    return lit_fraction(engine.shadows(receivers, [light], [light_samples(light, 8)], month=month)[0])


def solid_tree(tracer, scene):
    """(the solid triangles on the device, the cut-outs)."""
    triangles, engine = scene.triangles(), Engine(scene, "bsah+single")
    return tracer.tree(engine.accelerated().bvh), cutout_tree(triangles, 2)


@pytest.mark.parametrize("cull_faces", [None, "front", "back"])
def test_hits_on_texels_are_those_of_the_cpu(tracer, cull_faces):
    scene, n, rng = scene_with_cutouts(), 400, np.random.default_rng(2)
    origins, targets = through_cutouts(scene, n)
    tree, cutouts = solid_tree(tracer, scene)
    hits = {"tmin": 0.125, "tmax": rng.choice([0.5, 1.0, np.inf], n), "cull_faces": cull_faces}
    hits["skip_face"] = np.where(rng.random(n) < 0.3, rng.choice(scene.data.cutouts.faces, n), -1)
    frame, directions = tuple(scene.origin.tolist()), targets - origins
    rays = rays_of(origins, directions, HitFilter(**hits), frame, scene.n_triangles, None)
    before = tracer.cutouts.on_cpu
    ours, theirs = tracer.trace_rays(tree, rays, False, 2, cutouts), scene.closest_hit(origins, directions, **hits)
    for name in ("face", "t", "u", "v"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
    blocked = tracer.trace_rays(tree, rays, True, 2, cutouts).blocked
    np.testing.assert_array_equal(blocked, theirs.face >= 0)
    assert np.isin(theirs.face, scene.data.cutouts.faces).mean() > 0.05 and 0.1 < blocked.mean() < 0.9
    assert tracer.cutouts.on_cpu - before > 3  # along edges, only exact arithmetic decides


SHARES = [pane([0.9, 0.5, 0.25]), pane([0.5] * 3), pane([0.02] * 3), pane([0.6] * 3, closed=True)]


@pytest.mark.parametrize("spp", [1, 5, 16, 33, 64, 100])
def test_dark_samples_and_shares_of_light_whatever_their_number(tracer, spp):
    scene = with_masks(60, [*MASKS, *SHARES])
    _, query = query_of(scene, CAMERA, LIGHTS["quad"], spp)
    tree, cutouts = solid_tree(tracer, scene)
    bits = new_bits(query)
    tracer.trace_shadow(tree, query, bits, 2)
    ours = bits.copy()
    tracer.add_shadows(cutouts, query, ours, 2)
    add_shadows(cutouts, query, bits, 2)
    np.testing.assert_array_equal(ours, bits)
    (receivers, values), expected = tracer.shares(cutouts, query, bits, 2), shares_of(cutouts, query, bits, 2)
    np.testing.assert_array_equal(receivers, expected[0])
    np.testing.assert_array_equal(values, expected[1])
    assert values.shape[1:] == (spp, 3) and ((values > 0) & (values < 1)).any()
    assert spp == 1 or (values == 0).any()


@pytest.mark.parametrize("name", LIGHTS)
def test_shares_of_every_light_are_those_of_the_cpu(tracer, name):
    scene = with_masks(60, SHARES[1:])
    _, query = query_of(scene, CAMERA, LIGHTS[name], 4)
    tree, cutouts = solid_tree(tracer, scene)
    bits = new_bits(query)
    tracer.trace_shadow(tree, query, bits, 2)
    ours = bits.copy()
    tracer.add_shadows(cutouts, query, ours, 2)
    add_shadows(cutouts, query, bits, 2)
    np.testing.assert_array_equal(ours, bits)
    for found, expected in zip(tracer.shares(cutouts, query, bits, 2), shares_of(cutouts, query, bits, 2)):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("plan", PLANS)
def test_engines_trace_no_cut_out_on_the_cpu(plan, monkeypatch):
    scene, light = with_masks(60, [*MASKS, *SHARES]), LIGHTS["quad"]
    points = np.random.default_rng(3).uniform((-3, -0.9, -3), (3, 2, 3), (50, 3))
    expected = at.visibility(scene, points, light, spp=8, plan="bsah+single")
    device_tracer(plan.split("device:")[1])  # takes its self-test, in which the CPU takes part
    for module, name in (accelerator, "add_shadows"), (accelerator, "shares_of"), (alpha_cutouts, "add_nearest"):
        monkeypatch.setattr(module, name, None)
    found = at.visibility(scene, points, light, spp=8, plan=plan)
    np.testing.assert_array_equal(found.bits, expected.bits)
    np.testing.assert_array_equal(found.fraction, expected.fraction)
    assert len(np.unique(expected.fraction)) > 9  # multiples of 1/8 are shares of samples


@pytest.mark.parametrize("plan", PLANS)
def test_each_month_has_the_light_of_the_cpu(plan):
    rng = np.random.default_rng(4)
    scene = with_masks(50, [seasonal(rng), seasonal(rng), *MASKS])
    points = rng.uniform((-3, -0.9, -3), (3, 0, 3), (40, 3))
    ours, theirs = Engine(scene, plan), Engine(scene, "bsah+single")
    shares = []
    for month in (None, 0, 6, 0):
        found, expected = (lit(engine, scene, points, month) for engine in (ours, theirs))
        np.testing.assert_array_equal(found, expected)
        shares.append(expected)
    assert (shares[1] != shares[2]).any() and (shares[0] != shares[1]).any()


def test_cut_outs_are_uploaded_once(device, monkeypatch):
    scene, uploads = scene_with_cutouts(), []
    tracer = DeviceTracer(device)
    tree, cutouts = solid_tree(tracer, scene)
    uploaded = device_cutouts.UploadedTree
    monkeypatch.setattr(device_cutouts, "UploadedTree", lambda *arguments: uploads.append(1) or uploaded(*arguments))
    rays = rays_of(*through_cutouts(scene, 20), HitFilter(), tuple(scene.origin.tolist()), scene.n_triangles)
    for _ in range(2):
        tracer.trace_rays(tree, rays, True, 1, cutouts)
        tracer.trace_rays(tree, rays, False, 1, cutouts.as_holes())
    assert len(uploads) == 1
    masks = tracer.cutouts._uploaded.arrays[4][1]
    scene.update(scene.triangles().vertices + scene.origin + 0.25)
    tracer.trace_rays(tree, rays, True, 1, cutout_tree(scene.triangles(), 2))
    assert len(uploads) == 2 and tracer.cutouts._uploaded.arrays[4][1] is masks
