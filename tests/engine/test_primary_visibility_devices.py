"""Frames of which a device finds the surfaces: the CPU's pictures, and nothing copied that the host does not read."""

from weakref import ref

import numpy as np
import pytest

import antumbra as at
import moving_square
from antumbra.devices.device import Device, OutOfDeviceMemory
from antumbra.engine.device_tracers import OnDevice, OnDeviceTracer, device_tracer, free_blocks
from antumbra.engine.engine import Engine
from antumbra.engine.primary_visibility import RASTER, RAYS
from antumbra.query.gbuffer import GBuffer
from antumbra.query.light_samples import light_samples
from antumbra.query.resident_gbuffer import ResidentGBuffer
from antumbra.query.shadow_query import surface_queries
from antumbra.techniques.culling import device_culling
from antumbra.trace.device import device_surfaces
from antumbra.trace.device.device_instances import ForestTracer
from antumbra.trace.device.device_tracer import DeviceTracer
from cutout_scenes import scene_with_cutouts
from devices import device_plans, on_device_of
from instance_scenes import random_scenes, whole_scenes
from truths import soup_scene

PLANS = [
    *device_plans(text=True),
    *(
        "grid32+lbvh+device:host:0",
        "ploc+device:host:0",
        "bsah+multifrusta+device:host:0",
        "bsah+reinsert+device:host:0",
    ),
]
LAMP = at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))
CAMERA = at.Camera((0, 2, 9), (0, -0.5, 0), width=24, height=16)
SCENES = {
    "soup": lambda: soup_scene(3),
    "cut-outs": scene_with_cutouts,
    "instances": lambda: random_scenes(1)[0],
    "whole instances": lambda: whole_scenes(1)[0],
}


def assert_same_frames(ours, theirs):
    for name, mine, other in zip(GBuffer._fields, ours.gbuffer, theirs.gbuffer):
        np.testing.assert_array_equal(mine, other, err_msg=name)
    assert type(ours.gbuffer) is GBuffer  # frames hold no memory of the device
    for mine, other in zip([*ours.bits, *ours.visibility], [*theirs.bits, *theirs.visibility]):
        np.testing.assert_array_equal(mine, other)
    np.testing.assert_array_equal(ours.image, theirs.image)
    assert ours.rays == theirs.rays and ours.mask.any()


@pytest.fixture
def looks(monkeypatch):
    """The numbers of pixels that devices have looked through."""
    found, see, draw, trace = [], OnDevice.see, OnDeviceTracer.draw, ForestTracer.trace_pixels

    def seen(self, triangles, rays, *rest):
        found.append(rays.width * rays.height)
        return see(self, triangles, rays, *rest)

    def drawn(self, triangles, rays, *rest):
        found.append(rays.width * rays.height)
        return draw(self, triangles, rays, *rest)

    def traced(self, forest, rays, rows, threads):
        found.append(rays.width * (rows.stop - rows.start))
        return trace(self, forest, rays, rows, threads)

    monkeypatch.setattr(OnDevice, "see", seen)
    monkeypatch.setattr(OnDeviceTracer, "draw", drawn)
    monkeypatch.setattr(ForestTracer, "trace_pixels", traced)
    return found


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("plan", PLANS)
def test_frames_of_a_device_are_those_of_the_cpu(plan, scene, looks):
    """The first one is rasterised; rays find the surfaces of the second one, unless triangles were culled."""
    scene = SCENES[scene]()
    camera = CAMERA if not scene.data.instanced else at.Camera((0, 9, 20), (0, 0, 0), width=24, height=16)
    theirs = at.Renderer(scene, "bsah+wide", gbuffer=RASTER).render(camera, LAMP, spp=5)
    renderer = at.Renderer(scene, plan)
    for _ in range(2):
        ours = renderer.render(camera, LAMP, spp=5)
        assert_same_frames(ours, theirs)
        assert ours.seen_on == renderer.plan.device and theirs.seen_on is None
    assert looks == [24 * 16] * 2


OPTIONS = {
    "refined": {"adaptive": 16},
    "filtered": {"filter": True},
    "bounced": {"bounce": 1},
    "with ground": {"ground": True},
    "in layers": {"layers": True},
    "counted": {"counters": True},
    "culling faces": {"cull_faces": "back"},
}


@pytest.mark.parametrize("plan", ["bsah+device:host:0", "lbvh+device:host:0", "grid32+lbvh+device:host:0"])
@pytest.mark.parametrize("options", OPTIONS)
def test_all_options_have_the_same_pictures(plan, options, looks):
    scene = soup_scene(3)
    ours, theirs = (
        at.render(scene, CAMERA, LAMP, spp=4, plan=each, **OPTIONS[options]) for each in (plan, "bsah+single")
    )
    assert_same_frames(ours, theirs)
    assert looks


LIGHTS = {
    "ambient occlusion": at.AmbientOcclusion(),
    "a sun": at.DirectionalLight((0.3, -1.0, 0.2), 2.0),
    "a sky": at.Sky(count=32),
    "two lamps": [LAMP, at.SphereLight((1, 5, 0), 1.0)],
}


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("plan", ["bsah+device:host:0", "grid32+lbvh+device:host:0"])
def test_all_lights_have_the_same_pictures(plan, light):
    ours, theirs = (at.render(soup_scene(3), CAMERA, LIGHTS[light], spp=4, plan=each) for each in (plan, "bsah+single"))
    assert_same_frames(ours, theirs)


@pytest.mark.parametrize("plan", ["bsah+device:host:0", "lbvh+device:host:0", "grid32+lbvh+device:host:0"])
@pytest.mark.parametrize("projection", ["orthographic", "panoramic"])
def test_the_cpu_finds_what_other_cameras_see_also_after_frames_of_the_device(plan, projection, looks):
    scene, extent = soup_scene(3), 8.0 if projection == "orthographic" else None
    camera = at.Camera((0, 2, 9), (0, -0.5, 0), width=20, height=10, projection=projection, extent=extent)
    renderer = at.Renderer(scene, plan)
    for each in camera, CAMERA, camera:
        assert_same_frames(renderer.render(each, LAMP, spp=4), at.render(scene, each, LAMP, spp=4, plan="bsah+single"))
    assert looks == [24 * 16]


@pytest.mark.parametrize("gbuffer, count", [(RASTER, 0), (RAYS, 1), ("auto", 1)])
def test_the_option_gbuffer_can_keep_the_surfaces_on_the_cpu(gbuffer, count, looks):
    frame = at.render(soup_scene(3), CAMERA, LAMP, spp=4, plan="lbvh+device:host:0", gbuffer=gbuffer)
    assert_same_frames(frame, at.render(soup_scene(3), CAMERA, LAMP, spp=4, plan="bsah+single"))
    assert len(looks) == count and frame.seen_on == ("host:0" if count else None)


@pytest.mark.parametrize("gbuffer", ["auto", RAYS])
@pytest.mark.parametrize("scene", ["soup", "cut-outs", "instances"])
def test_surfaces_that_do_not_fit_are_found_by_the_cpu(scene, gbuffer, monkeypatch):
    refused = []

    def refuse(*args):
        refused.append(args)
        raise OutOfDeviceMemory("full", 1, 0)

    monkeypatch.setattr(device_surfaces.DeviceSurfaces, "__init__", refuse)
    monkeypatch.setattr(ForestTracer, "trace_pixels", refuse)
    scene = SCENES[scene]()
    ours = at.render(scene, CAMERA, LAMP, spp=4, plan="bsah+device:host:0", gbuffer=gbuffer)
    assert_same_frames(ours, at.render(scene, CAMERA, LAMP, spp=4, plan="bsah+wide"))
    assert ours.seen_on is None and refused


def test_a_whole_tree_that_does_not_fit_beside_a_culled_one_is_left_out(monkeypatch, looks):
    def refuse(*args):
        raise OutOfDeviceMemory("full", 1, 0)

    expected = at.render(soup_scene(3), CAMERA, LAMP, spp=4, plan="bsah+single")
    with monkeypatch.context() as full:
        full.setattr(DeviceTracer, "build", refuse)
        culled = at.render(soup_scene(3), CAMERA, LAMP, spp=4, plan="grid32+lbvh+device:host:0", gbuffer=RAYS)
        assert_same_frames(culled, expected)
        assert not looks
        with pytest.raises(OutOfDeviceMemory):
            at.render(soup_scene(3), CAMERA, LAMP, spp=4, plan="lbvh+device:host:0")


def test_the_tree_of_the_camera_leaves_if_a_culled_one_does_not_fit_beside_it(monkeypatch):
    trees, held, see, build = [], [], OnDevice.see, device_culling.build_relevant

    def seen(self, *args):
        trees.append(ref(self.tree))
        return see(self, *args)

    def tight(*args):
        held.append(trees[-1]() is not None)
        if held[-1]:
            raise OutOfDeviceMemory("full", 1, 0)
        return build(*args)

    monkeypatch.setattr(OnDevice, "see", seen)
    monkeypatch.setattr(device_culling, "build_relevant", tight)
    expected = at.render(soup_scene(3), CAMERA, LAMP, spp=4, adaptive=16, plan="bsah+single")
    renderer = at.Renderer(soup_scene(3), "grid32+lbvh+device:host:0", gbuffer=RAYS)
    for _ in range(2):
        assert_same_frames(renderer.render(CAMERA, LAMP, spp=4, adaptive=16), expected)
    assert held[:2] == [True, False] and held.count(True) == 2


SAMPLES = "the samples of a light"


@pytest.mark.parametrize(
    "scene, plan",
    [
        ("soup", "grid32+lbvh+device:host:0"),
        ("cut-outs", "bsah+device:host:0"),
        ("instances", "bsah+device:host:0"),
    ],
)
def test_a_frame_that_fits_only_without_surfaces_on_the_device_is_seen_by_the_cpu(scene, plan, monkeypatch):
    """Memory ends at the first allocation for shadow rays or at the last one, once; later frames do not try again."""
    scene, full = SCENES[scene](), []
    camera = CAMERA if not scene.data.instanced else at.Camera((0, 9, 20), (0, 0, 0), width=24, height=16)
    theirs = at.Renderer(scene, "bsah+wide", gbuffer=RASTER).render(camera, LAMP, spp=5, counters=True)
    allocate, made = Device.allocate, []

    def tight(self, size, what="an array"):
        made.append(what)
        if full and what == full[0] and SAMPLES in made:
            full.clear()
            raise OutOfDeviceMemory("full", size, 0)
        return allocate(self, size, what)

    def new():
        made.clear()
        renderer = at.Renderer(scene, plan)
        free_blocks(device_tracer("host:0"))
        return renderer

    monkeypatch.setattr(Device, "allocate", tight)
    assert new().render(camera, LAMP, spp=5, counters=True).seen_on == "host:0"
    for name in SAMPLES, made[-1]:
        renderer, full[:] = new(), [name]
        for _ in range(2):
            ours = renderer.render(camera, LAMP, spp=5, counters=True)
            assert_same_frames(ours, theirs)
            assert not full and ours.seen_on is None and ours.counters["rays"] == theirs.counters["rays"]


def test_surfaces_of_an_engine_are_ordinary_arrays():
    ours, theirs = (Engine(soup_scene(3), plan).surfaces(CAMERA) for plan in ("lbvh+device:host:0", "bsah+single"))
    assert type(ours) is GBuffer
    for mine, other in zip(ours, theirs):
        np.testing.assert_array_equal(mine, other)


def test_frames_of_an_animation_are_seen_by_the_device(tmp_path, looks):
    scene = at.load(moving_square.write(tmp_path / "square"))
    camera, light = at.Camera((0, 4, 5), (0, 0, 0), width=24, height=16), at.PointLight((0, 5, 0))
    ours, theirs = at.Renderer(scene, device="host"), at.Renderer(scene, plan="lbvh+multifrusta")
    for time in (0.0, 1.5, 3.0):
        assert_same_frames(ours.render(camera, light, time=time), theirs.render(camera, light, time=time))
    assert len(looks) == 3


@pytest.mark.parametrize(
    "plan, gbuffer, count",
    [
        ("lbvh+device:host:0", "auto", 1),
        ("lbvh+device:host:0", RAYS, 1),
        ("grid32+lbvh+device:host:0", "auto", 0),
        ("grid32+lbvh+device:host:0", RAYS, 1),
    ],
)
def test_a_scene_at_rest_has_at_most_one_tree_of_all_triangles(plan, gbuffer, count, monkeypatch):
    builds, build = [], DeviceTracer.build

    def counted(tracer, *args):
        builds.append(args)
        return build(tracer, *args)

    monkeypatch.setattr(DeviceTracer, "build", counted)
    renderer = at.Renderer(soup_scene(3), plan, gbuffer=gbuffer)
    for _ in range(3):
        renderer.render(CAMERA, LAMP, spp=4)
    assert len(builds) == count


def test_only_new_triangles_are_rasterised(monkeypatch):
    drawn, draw = [], OnDeviceTracer.draw

    def noted(self, triangles, *rest):
        drawn.append(triangles)
        return draw(self, triangles, *rest)

    monkeypatch.setattr(OnDeviceTracer, "draw", noted)
    scene = at.Scene.from_arrays(waves(0.0))
    renderer = at.Renderer(scene, "lbvh+device:host:0")
    for time in 0.1, 0.2:
        scene.update(waves(time))
        expected = at.render(at.Scene.from_arrays(waves(time)), OVER, LOW, spp=4, plan="bsah+single")
        for _ in range(2):
            np.testing.assert_array_equal(renderer.render(OVER, LOW, spp=4).bits[0], expected.bits[0])
    assert len(drawn) == 2


# --- Bytes ------------------------------------------------------------------------------------------------------------


class Copies:
    """The bytes that are copied to a device and from it."""

    def __init__(self, device, monkeypatch):
        self.up = self.down = 0
        upload, download = device.upload_bytes, device.download_bytes

        def sent(address, source, queue, wait):
            self.up += source.nbytes
            upload(address, source, queue, wait)

        def fetched(address, into, queue, wait):
            self.down += into.nbytes
            download(address, into, queue, wait)

        monkeypatch.setattr(device, "upload_bytes", sent)
        monkeypatch.setattr(device, "download_bytes", fetched)


def waves(time, n=40):
    x, z = np.meshgrid(*2 * [np.linspace(-5, 5, n + 1)])
    p = np.stack([x, np.sin(2 * x + time) * np.cos(1.7 * z - time), z], -1).astype(np.float32)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2).reshape(-1, 3, 3)


PIXELS, SPP = 48 * 32, 16
OVER = at.Camera((0, 4, 9), (0, -0.5, 0), width=48, height=32)
LOW = at.QuadLight((-7.0, 3.0, -2.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0))


@pytest.mark.parametrize("gbuffer", ["auto", RAYS])
@pytest.mark.parametrize("plan", [*PLANS[2:4], "grid32+lbvh+device:host:0"])
def test_only_bits_come_down_from_new_vertices_on_the_device(plan, gbuffer, monkeypatch):
    scene, other = (at.Scene.from_arrays(waves(0.0)) for _ in range(2))
    engine, samples = Engine(scene, plan, gbuffer=gbuffer), [light_samples(LOW, SPP)]
    arrays = [on_device_of(engine, waves(time)) for time in (0.1, 0.2, 0.3)]
    for k, array in enumerate(arrays):
        with monkeypatch.context() as counting:
            copies = Copies(array.device, counting)
            engine.update(array)
            frame = engine.frame_tracer()
            frame.begin(None, PIXELS * SPP, 0, 0.0)
            assert frame.build_for_camera(OVER) == (gbuffer == RAYS)
            surfaces = frame.surfaces(OVER, slice(0, OVER.height))
            queries = surface_queries(surfaces, [LOW], samples, 0, 2)
            frame.prepare(queries, lambda step: None)
            (bits,) = frame.accelerator.answer_all(frame.tree, queries)
        assert (
            isinstance(surfaces.gbuffer, ResidentGBuffer)
            and not {"_packed", "position"} & vars(surfaces.gbuffer.there).keys()
        )
        assert "_fetched" not in vars(scene.triangles())
        assert copies.up < samples[0].nbytes + 4096
        assert copies.down < PIXELS * SPP // 8 + 4096
        other.update(waves((0.1, 0.2, 0.3)[k]))
        expected = at.render(other, OVER, LOW, spp=SPP, plan="bsah+single")
        np.testing.assert_array_equal(bits, expected.bits[0])
        np.testing.assert_array_equal(surfaces.gbuffer.face, expected.gbuffer.face)
    assert 0.01 < np.bitwise_count(bits).sum() / (PIXELS * SPP) < 0.99


@pytest.mark.parametrize("plan", ["lbvh+device:host:0", "grid32+lbvh+device:host:0"])
def test_a_picture_brings_down_its_surfaces_and_bits_but_no_triangles(plan, monkeypatch):
    scene, other = (at.Scene.from_arrays(waves(0.0)) for _ in range(2))
    renderer = at.Renderer(scene, plan)
    array = on_device_of(renderer.engine, waves(0.3))
    renderer.engine.update(array)
    with monkeypatch.context() as counting:
        copies = Copies(array.device, counting)
        frame = renderer.render(OVER, LOW, spp=SPP)
    assert "_fetched" not in vars(scene.triangles())
    assert copies.down < PIXELS * (44 + SPP // 8) + 4096
    other.update(waves(0.3))
    assert_same_frames(frame, at.render(other, OVER, LOW, spp=SPP, plan="bsah+single"))
