"""Shadow queries by shafts on devices: the bits of the CPU in all hazards, with fewer visits of nodes."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import binned_sah
from antumbra.query.light_samples import light_samples
from antumbra.query.receivers import NOTHING
from antumbra.query.shadow_query import new_bits, ray_count, with_receivers
from antumbra.trace.counters import NODES, new_counters
from antumbra.trace.device import device_tracer as device_tracer_module
from antumbra.trace.device.device_stages import CAPACITIES, Capacities
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.rays.single_rays import as_built, trace_shadow
from asking import query_of
from beam_scenes import RECEIVERS, lit, on_surfaces
from devices import DEVICES, opened
from truths import soup_scene

TINY = Capacities(pairs=24, records=8, least=4)
QUAD = at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return opened(request.param)


def check(device, triangles, query, capacities=CAPACITIES):
    """Compare with the CPU's bits. Return (share of blocked segments, visits of shafts, visits of single rays)."""
    bvh, tracer, counters = binned_sah.build(triangles.vertices, 2), DeviceTracer(device, capacities), new_counters()
    truth, bits = new_bits(query), new_bits(query)
    trace_shadow(as_built(bvh), query, truth, 2, counters)
    tracer.trace_shadow(tracer.tree(bvh), query, bits, 2, shafts=True)
    np.testing.assert_array_equal(bits, truth)
    return np.bitwise_count(truth).sum() / max(ray_count(query), 1), tracer.visits, counters[NODES]


@pytest.mark.parametrize("cull_faces", [0, -1, 1])
@pytest.mark.parametrize("light", ["point", "quad", "sphere", "list"])
def test_receivers_on_the_triangles_of_a_soup(device, light, cull_faces):
    shares = [check(device, *on_surfaces(seed, light, cull_faces=cull_faces))[0] for seed in range(4)]
    assert 0.02 < np.mean(shares) < 0.98


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_hostile_triangles_and_floating_receivers(device, scale):
    shares = [check(device, *lit(seed, "quad", receivers, scale))[0] for seed, receivers in enumerate(RECEIVERS)]
    assert np.mean(shares) > 0.02 and min(shares) < 0.98


@pytest.mark.parametrize("offset", [1e3, 1e6])
def test_scenes_far_from_their_origin(device, offset):
    assert check(device, *on_surfaces(5, "quad", offset=offset))[0] > 0


@pytest.mark.parametrize("capacities", [TINY, TINY._replace(least=1000)], ids=["again", "on the CPU"])
def test_lists_that_are_too_short(device, capacities):
    share, visits, _ = check(device, *on_surfaces(6, "quad", offset=100.0), capacities)
    assert 0 < share < 1 and visits > 0


@pytest.mark.parametrize("rows, columns", [(1, 40), (40, 1), (5, 3), (33, 35)])
def test_terrain_of_odd_sizes(device, rows, columns):
    """Receivers on a height field, lit by a low sun; some tiles are empty, and some in part."""
    rng, n = np.random.default_rng(8), 12
    x, z = np.meshgrid(np.arange(float(n)), np.arange(float(n)), indexing="ij")
    p = np.stack([x, rng.uniform(0, 1.5, x.shape), z], -1)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    scene = at.Scene.from_arrays(np.stack([np.stack([a, c, b], 2), np.stack([a, d, c], 2)], 2).reshape(-1, 3, 3))
    camera = at.Camera((6, 14, -9), (6, 0, 6), width=40, height=40)
    triangles, query = query_of(scene, camera, at.DirectionalLight((1, -0.4, 0.3), angular_diameter=2), 6)
    query.sides[16:24, :12] = NOTHING
    first = 20 - rows // 2, 20 - columns // 2
    place = slice(first[0], first[0] + rows), slice(first[1], first[1] + columns)
    share, visits, _ = check(device, triangles, with_receivers(query, lambda each: each[place]))
    assert visits > 0 and share > 0


def test_no_receivers(device):
    triangles, query = on_surfaces(1, "quad")
    assert check(device, triangles, query._replace(sides=np.full_like(query.sides, NOTHING))) == (0, 0, 0)


@pytest.mark.parametrize("rays", [100, 5 * 18 * 7, 5 * 40])
def test_chunks_that_begin_within_rows_and_tiles(device, rays, monkeypatch):
    monkeypatch.setattr(device_tracer_module, "CHUNK", rays)
    triangles, query = on_surfaces(7, "quad")
    assert 0 < check(device, triangles, query)[0] < 1
    row = with_receivers(query, lambda each: each.reshape(1, -1, *each.shape[2:]))
    assert 0 < check(device, triangles, row)[0] < 1


@pytest.mark.parametrize("light, spp", [(QUAD, 16), (at.PointLight((0, 6, 0)), 1)], ids=["soft", "hard"])
def test_shafts_visit_fewer_nodes_than_rays(device, light, spp):
    scene = at.procedural("atrium", triangles=3000)
    triangles, query = query_of(scene, scene.cameras[0].resized(32, 32), light, spp)
    assert query.samples.shape == light_samples(light, spp).shape
    _, visits, single = check(device, triangles, query)
    assert 0 < visits < single / (8 if spp == 16 else 2)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_scenes_of_hardly_any_triangles(device, n):
    triangles, query = on_surfaces(2, "quad")
    bvh, tracer = binned_sah.build(triangles.vertices[:n], 1), DeviceTracer(device)
    truth, bits = new_bits(query), new_bits(query)
    trace_shadow(as_built(bvh), query, truth, 1)
    tracer.trace_shadow(tracer.tree(bvh), query, bits, 1, shafts=True)
    np.testing.assert_array_equal(bits, truth)
    assert truth.any()


def test_a_soup_from_a_camera(device):
    triangles, query = query_of(soup_scene(4), at.Camera((0, 2, 9), (0, -0.5, 0), width=23, height=18), QUAD, 20)
    assert 0.05 < check(device, triangles, query)[0] < 0.95
