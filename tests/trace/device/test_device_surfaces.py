"""What a camera sees on devices: the G-buffer of the rasteriser and its receivers, bit for bit, on hazards too."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import lbvh
from antumbra.engine import primary_visibility
from antumbra.query.gbuffer import GBuffer, from_hits
from antumbra.query.light_samples import light_samples
from antumbra.query.resident_gbuffer import ResidentGBuffer
from antumbra.query.shadow_query import ResidentQuery, new_bits, shadow_queries, without_corners
from antumbra.techniques.culling.device_culling import build_relevant
from antumbra.techniques.culling.pre_bvh_culling import CullRequest, solid_tree
from antumbra.trace.alpha_cutouts import cutout_tree
from antumbra.trace.device import device_surfaces
from antumbra.trace.device.device_rasteriser import draw_surfaces
from antumbra.trace.device.device_stages import CAPACITIES, Capacities
from antumbra.trace.device.device_surfaces import see_surfaces
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.device.device_tree import DeviceTree
from antumbra.trace.rays.single_rays import as_built, trace_shadow
from cutout_scenes import scene_with_cutouts
from devices import DEVICES, opened
from truths import LIGHTS, soup_scene

TINY = Capacities(pairs=24, records=8, least=4)
LAMP = at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return opened(request.param)


@pytest.fixture(scope="module", params=[CAPACITIES, TINY], ids=["large lists", "tiny lists"])
def tracer(request, device):
    return DeviceTracer(device, request.param)


# --- Scenes -----------------------------------------------------------------------------------------------------------


def lattice():
    """Squares in two planes, cut into triangles whose corners and edges pixel centres meet; twice, in another order."""
    steps = np.arange(-8, 9) * 0.5 + 0.25
    x, y = np.meshgrid(steps, steps)
    p = np.stack([x, y, np.where((x > 0) & (y > 1), 0.5, 0.0)], -1)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    whole = np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2).reshape(-1, 3, 3)
    again = np.concatenate([whole[::-1][:200], whole[100:150, ::-1]])
    return np.concatenate([whole, again])


def slivers():
    """Thin triangles in the middle row of pixels, some too thin for float64, among others.

    They are in float32, so that the scene's frame has the origin 0, where float32 has the thinnest of them.
    """
    rng = np.random.default_rng(5)
    heights = 10.0 ** rng.uniform(-30, -1, 40)
    ends = np.sort(rng.uniform(-3, 3, (40, 2)), 1)
    depths = np.round(rng.uniform(-2, 1, 40), 1)
    thin = np.zeros((40, 3, 3))
    thin[:, 0, 0], thin[:, 1, 0], thin[:, 2, 0] = ends[:, 0], ends[:, 1], ends.mean(1)
    thin[:, :, 1], thin[:, :, 2] = heights[:, None] * [-1, -1, 1], depths[:, None]
    loose = rng.uniform(-2, 2, (60, 1, 3)) + rng.normal(0, 1, (60, 3, 3))
    loose[:, 2] = loose[:, 0] + 0.5 * (loose[:, 1] - loose[:, 0]) + rng.normal(0, 1e-4, (60, 3))
    return np.concatenate([thin, loose]).astype(np.float32)


AT_LATTICE = at.Camera((0, 0, 4), (0, 0, 0), vfov=90.0, width=16, height=16)
AT_SLIVERS = at.Camera((0, 0, 4), (0, 0, 0), width=37, height=25)
SEEN = {
    "soup": (lambda: soup_scene(3), at.Camera((0, 2, 9), (0, -0.5, 0), width=40, height=30)),
    "lattice": (lambda: at.Scene.from_arrays(lattice()), AT_LATTICE),
    "slivers": (lambda: at.Scene.from_arrays(slivers()), AT_SLIVERS),
    "cut-outs": (scene_with_cutouts, at.Camera((0, 3, 7), (0, 0, 0), width=40, height=30)),
    "one triangle": (lambda: at.Scene.from_arrays(lattice()[:1]), AT_LATTICE),
    "atrium": (lambda: at.procedural("atrium", triangles=3000), None),
}
for _scale in 1e-6, 1e6, 1e12:
    SEEN[f"soup of size {_scale:g}"] = (
        lambda scale=_scale: at.Scene.from_arrays(soup_scene(3).triangles().vertices.astype(float) * scale),
        at.Camera((0, 2 * _scale, 9 * _scale), (0, -0.5 * _scale, 0), width=24, height=20),
    )


def expected_of(name, light=LAMP, spp=4):
    """(scene, triangles, camera, G-buffer of the CPU, its query)."""
    make, camera = SEEN[name]
    scene = make()
    camera, triangles = camera or scene.cameras[0].resized(31, 23), scene.triangles()
    gbuffer = primary_visibility.primary_visibility(triangles, camera, None, 2)
    (query,) = shadow_queries(triangles, gbuffer, [light], [light_samples(light, spp)], 0, 2)
    return triangles, camera, gbuffer, query


def seen(tracer, triangles, camera):
    tree, cutouts = tracer.tree(solid_tree(lbvh.build, triangles, 2)), cutout_tree(triangles, 2)
    return see_surfaces(tracer, tree, triangles, camera.rays(triangles.origin), cutouts, 2)


def drawn(tracer, triangles, camera):
    return draw_surfaces(tracer, triangles, camera.rays(triangles.origin), cutout_tree(triangles, 2), 2)


METHODS = pytest.mark.parametrize("find", [seen, drawn], ids=["rays", "raster"])


# --- Surfaces ---------------------------------------------------------------------------------------------------------


@METHODS
@pytest.mark.parametrize("name", SEEN)
def test_a_device_sees_the_surfaces_of_the_rasteriser(tracer, name, find):
    triangles, camera, gbuffer, query = expected_of(name)
    found = find(tracer, triangles, camera)
    for ours, theirs, field in zip(ResidentGBuffer.of(found), gbuffer, GBuffer._fields):
        np.testing.assert_array_equal(ours, theirs, err_msg=field)
        assert ours.dtype == theirs.dtype and ours.shape == theirs.shape
    np.testing.assert_array_equal(found.origins, query.origins)
    assert (gbuffer.face >= 0).any()


@METHODS
@pytest.mark.parametrize("name", ["soup", "lattice", "slivers", "cut-outs"])
def test_t_in_float64_is_that_of_pictures_of_the_cpu(tracer, name, find, monkeypatch):
    # Positions and depths in float32 would hide other digits of t in nearly all pixels
    triangles, camera, _, _ = expected_of(name)
    on_cpu = []
    monkeypatch.setattr(
        primary_visibility, "from_hits", lambda face, t, *rest: on_cpu.append(t) or from_hits(face, t, *rest)
    )
    primary_visibility.primary_visibility(triangles, camera, None, 2)
    find(tracer, triangles, camera)
    t = tracer.launches.block("t", 0, "").read(np.empty((camera.height, camera.width)))
    np.testing.assert_array_equal(t, on_cpu[0])
    assert np.isfinite(t).any()


@METHODS
@pytest.mark.parametrize("n", [0, 1])
def test_pictures_of_hardly_any_triangles(tracer, n, find):
    whole, camera = at.Scene.from_arrays(lattice()[:1]).triangles(), AT_LATTICE
    triangles = whole._replace(vertices=whole.vertices[:n], face_id=whole.face_id[:n], colour=whole.colour[:n])
    expected = primary_visibility.primary_visibility(triangles, camera, None, 2)
    found = find(tracer, triangles, camera)
    for ours, theirs, field in zip(ResidentGBuffer.of(found), expected, GBuffer._fields):
        np.testing.assert_array_equal(ours, theirs, err_msg=field)
    assert (found.face >= 0).any() == (n > 0)


def test_rays_through_corners_and_along_edges_see_the_first_face(device):
    triangles, camera, gbuffer, _ = expected_of("lattice")
    found = seen(DeviceTracer(device), triangles, camera)
    corners = triangles.vertices[gbuffer.face]
    on_corner = (corners == gbuffer.position[..., None, :]).all(-1).any(-1)
    assert on_corner.mean() > 0.5
    np.testing.assert_array_equal(found.face, gbuffer.face)


@METHODS
def test_the_cpu_moves_receivers_that_float64_leaves_undecided(tracer, find, monkeypatch):
    triangles, camera, _, query = expected_of("slivers")
    moved, move = [], device_surfaces._move_on_cpu

    def noted(tracer, out, vertices, pairs, threads):
        moved.append(len(pairs))
        move(tracer, out, vertices, pairs, threads)

    monkeypatch.setattr(device_surfaces, "_move_on_cpu", noted)
    np.testing.assert_array_equal(find(tracer, triangles, camera).origins, query.origins)
    assert sum(moved) > 0


@METHODS
def test_pictures_are_seen_some_pixels_at_a_time(device, find, monkeypatch):
    monkeypatch.setattr(device_surfaces, "AT_ONCE", 100)
    triangles, camera, gbuffer, query = expected_of("soup")
    found = find(DeviceTracer(device, TINY), triangles, camera)
    np.testing.assert_array_equal(found.position, gbuffer.position)
    np.testing.assert_array_equal(found.origins, query.origins)


# --- Queries ----------------------------------------------------------------------------------------------------------


def resident(there, query):
    return ResidentQuery.of(there, query.light, query.samples, query.cull_faces)


@pytest.mark.parametrize("light", LIGHTS)
def test_shadow_rays_start_from_receivers_that_stay_there(tracer, light, monkeypatch):
    triangles, camera, _, query = expected_of("soup", LIGHTS[light])
    bvh = solid_tree(lbvh.build, triangles, 2)
    query, bits = resident(seen(tracer, triangles, camera), query), new_bits(query)
    expected = new_bits(query)
    uploads, upload = [], tracer.device.upload_bytes

    def counted(address, source, queue, wait):
        uploads.append(source.nbytes)
        upload(address, source, queue, wait)

    tree = tracer.tree(bvh)
    monkeypatch.setattr(tracer.device, "upload_bytes", counted)
    tracer.trace_shadow(tree, query, bits, 2)
    assert "_packed" not in vars(query.there) or tracer.on_cpu
    trace_shadow(as_built(bvh), query, expected, 2)
    np.testing.assert_array_equal(bits, expected)
    if not tracer.on_cpu:
        assert sum(uploads) == query.samples.nbytes


def test_a_horizon_in_the_plane_of_the_light_is_decided_on_the_cpu_by_few_triangles(device):
    triangles, camera, _, query = expected_of("lattice", at.QuadLight((-1, -1, 0), (2, 0, 0), (0, 2, 0)))
    tracer, bvh = DeviceTracer(device), solid_tree(lbvh.build, triangles, 2)
    query = resident(seen(tracer, triangles, camera), query)
    bits, expected = new_bits(query), new_bits(query)
    tracer.trace_shadow(tracer.tree(bvh), query, bits, 2)
    assert tracer.on_cpu > 0
    trace_shadow(as_built(bvh), query, expected, 2)
    np.testing.assert_array_equal(bits, expected)
    assert bits.any() and not bits.all()


def test_culling_takes_receivers_that_are_there(device, monkeypatch):
    triangles, camera, _, query = expected_of("atrium", at.QuadLight((-1.0, 4.0, -1.0), (1, 0, 0), (0, 0, 1)))
    tracer = DeviceTracer(device)
    query, bits, expected = resident(seen(tracer, triangles, camera), query), new_bits(query), new_bits(query)
    trace_shadow(as_built(lbvh.build(triangles.vertices, 2)), query, expected, 2)
    monkeypatch.setattr(tracer._uploads, "write", lambda *args: pytest.fail("receivers were uploaded"))
    box = np.stack([triangles.vertices.min((0, 1)), triangles.vertices.max((0, 1))])
    tree = build_relevant(tracer, triangles.vertices, None, CullRequest([query], 32, 2, lambda step: None), box)
    tracer.trace_shadow(tree, query, bits, 2)
    np.testing.assert_array_equal(bits, expected)
    assert 0 < tree.n < len(triangles.vertices) and bits.any()


def test_other_samples_keep_receivers_there_and_other_receivers_do_not(device):
    triangles, camera, _, query = expected_of("soup")
    mine = resident(seen(DeviceTracer(device), triangles, camera), query)
    few = mine._replace(samples=query.samples[:, :1])
    assert isinstance(few, ResidentQuery) and few.there is mine.there and few.receivers == mine.receivers
    assert few.shape == mine.shape == query.shape and mine.n == query.n
    assert type(mine._replace(sides=query.sides)) is type(query) is type(without_corners(mine))
    assert without_corners(query) is query and not len(without_corners(mine).corners)
    for ours, theirs, name in zip(mine, query, query._fields):
        if name == "light":
            assert ours is theirs
        else:
            np.testing.assert_array_equal(ours, theirs, err_msg=name)


@pytest.mark.parametrize("held", [False, True])
def test_some_triangles_of_a_tree_are_those_in_its_slots(device, held):
    tracer = DeviceTracer(device)
    whole = soup_scene(3).triangles().vertices
    tree = tracer.build(whole)
    assert isinstance(tree, DeviceTree)
    expected = lbvh.build(whole, 2)
    if held:
        _ = tree.bvh
    few = tree.some(np.array([7, 0, 3], np.int32))
    np.testing.assert_array_equal(few.prim_ids, expected.prim_ids[[7, 0, 3]])
    np.testing.assert_array_equal(few.corners, expected.corners[[7, 0, 3]])
