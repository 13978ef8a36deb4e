"""Stores whose chunks are cached in a device, which traces shadow rays, give the pictures of scenes in memory."""

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.devices.device import Device, OutOfDeviceMemory
from antumbra.picture.renderer import Renderer
from antumbra.store import tiled_store
from antumbra.techniques.chcrt.device_parts import OnDeviceParts
from cutout_scenes import scene_with_cutouts
from truths import LIGHTS, soup_scene
from turned import BOTH, FIRST, camera_in, lights_in, scene_in

ON_DEVICE = pytest.mark.parametrize(
    "device", [pytest.param(d, marks=pytest.mark.device(d)) for d in ("host", "opencl")]
)
SIZE = 72, 60
LIGHT = at.QuadLight((-30, 60, -20), (30, 0, 0), (0, 0, 30))
SUN = at.DirectionalLight((0.4, -1, 0.3))


def plan_on(device):
    return f"bsah+chcrt+device:{device}:0"


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """(scene in memory, path of its store of 40 chunks or more)."""
    scene, path = at.procedural("city", triangles=20_000), tmp_path_factory.mktemp("paged") / "city.antumbra"
    assert at.build_store(scene, path, chunk=512).chunks >= 40
    return scene, path


def _walk(scene):
    """Cameras: a far one, two in a street, and the last one again."""
    street = [at.Camera((7, 1.7, 30 - 4 * k), (7, 3, -60), width=SIZE[0], height=SIZE[1]) for k in range(2)]
    return [scene.cameras[0].resized(*SIZE), *street, street[-1]]


def _renderer(path, device, chunks=None):
    """A renderer of a store whose device has room for some of the largest chunks; None: for all."""
    renderer = Renderer(at.load(path), plan_on(device), 2)
    if chunks is not None:
        there = renderer.source.on_device
        there.budget = chunks * 90 * int(renderer.source.store.chunks.triangles.max())
    return renderer


def _launched(renderer):
    """The names of the kernels that the tracer of chunks has launched."""
    return set(renderer.source.accelerated.prepared.on_device.tracer.launches._modules)


def _same(frame, other):
    assert len(frame.bits) == len(other.bits)
    for a, b in zip(frame.bits, other.bits):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(frame.gbuffer.face, other.gbuffer.face)
    np.testing.assert_array_equal(frame.image, other.image)


@ON_DEVICE
@pytest.mark.parametrize("chunks", [None, 1, 5])
def test_pictures_are_those_in_memory(city, device, chunks):
    scene, path = city
    lights = [LIGHT, SUN, at.AmbientOcclusion(3.0), LIGHTS["interleaved list"]]
    renderer, inside, frames = _renderer(path, device, chunks), Renderer(scene, "bsah+single", 2), []
    for camera in _walk(scene):
        frames.append(renderer.render(camera, lights, spp=4))
        _same(frames[-1], inside.render(camera, lights, spp=4))
        there = renderer.source.on_device
        assert there.used <= there.budget and frames[-1].plan == plan_on(device)
        paging = frames[-1].paging
        assert paging["device_wanted"] >= paging["device_kept"] + paging["device_uploaded"]
        assert (paging["device_bytes"] > paging["device_bvh_bytes"] > 0) == (paging["device_uploaded"] > 0)
    uploads, evictions = ([frame.paging[f"device_{name}"] for frame in frames] for name in ("uploaded", "evicted"))
    assert isinstance(renderer.source.accelerated.prepared.on_device, OnDeviceParts)
    assert {"find_listed", "trace_listed"} <= _launched(renderer)
    assert uploads[0] > 0 and frames[-1].paging["device_wanted"] > 0
    assert (uploads[-1] == 0) == (chunks is None) and (sum(evictions) > 0) == (chunks is not None)


@ON_DEVICE
@pytest.mark.parametrize("chunks", [None, 3])
def test_bounced_light_and_refined_edges(city, device, chunks):
    """Diffuse rays, several passes of which are traced together, and rays of sub-pixels."""
    scene, path = city
    asked = {"spp": 4, "bounce": 3, "filter": True, "adaptive": 16, "layers": True}
    renderer, inside = _renderer(path, device, chunks), Renderer(scene, "bsah+single", 2)
    for camera in _walk(scene)[1:3]:
        frame, truth = (each.render(camera, [LIGHT], **asked) for each in (renderer, inside))
        _same(frame, truth)
        np.testing.assert_array_equal(frame.indirect, truth.indirect)
        np.testing.assert_array_equal(frame.gbuffer.position, truth.gbuffer.position)
        assert frame.indirect.any() and frame.refined.any()
    calls = [n for n, fronts in renderer.source.accelerated.prepared.states() if fronts.parts.memory is not None]
    assert len(calls) > 2 and "find_listed" in _launched(renderer)


@ON_DEVICE
def test_nearest_hits_of_ray_lists(city, device):
    scene, path = city
    rng = np.random.default_rng(4)
    origins, directions = rng.uniform((-40, 0.2, -40), (40, 25, 40), (3000, 3)), rng.normal(size=(3000, 3))
    asked = {"tmin": rng.uniform(0, 2, 3000), "tmax": rng.uniform(2, 60, 3000), "cull_faces": "back"}
    stored = at.Engine(at.load(path), plan_on(device), threads=2)
    for more in {}, asked:
        found, truth = (each.closest_hit(origins, directions, **more) for each in (stored, scene))
        for name in "face", "t", "u", "v":
            np.testing.assert_array_equal(getattr(found, name), getattr(truth, name))
        assert 0.1 < (truth.face >= 0).mean() < 1.0
    assert "find_listed" in set(stored.source.accelerated.prepared.on_device.tracer.launches._modules)


def _fronts_of(renderer, camera):
    """The fronts and the statistics of a frame that begins without fronts and with all chunks in all memories."""
    source = renderer.source
    source.residency.budget = 1 << 40
    for memory in filter(None, (source.residency, source.on_device)):
        for _ in memory.groups(np.arange(len(source.store), dtype=np.int32), lambda k: np.ones(len(k), bool), None):
            pass
    state = source.accelerated.prepared
    state._fronts.clear()
    frame = renderer.render(camera, [LIGHT, SUN], spp=4, bounce=1)
    counts = [{k: n for k, n in each.items() if not k.startswith("phase")} for each in frame.scheduled]
    return counts, [fronts for _, fronts in state.states()]


def test_queries_and_fronts_are_those_of_the_cpu(city):
    """Once all chunks are in memory, the order of the pairs does not depend on where they are traced."""
    camera = _walk(city[0])[1]
    (counts, there), (others, here) = (
        _fronts_of(Renderer(at.load(city[1]), plan, 2), camera) for plan in (plan_on("host"), "bsah+chcrt")
    )
    assert counts == others and len(there) == len(here) > 3
    for fronts, other in zip(there, here):
        for name in "tile", "set", "row", "state", "key":
            np.testing.assert_array_equal(getattr(fronts, name), getattr(other, name))
    assert sum(each["traced pairs"] for each in counts) > 100


def test_triangles_hit_on_the_device_may_have_left_the_host(city, monkeypatch):
    """The second frame finds all chunks on the device, and none in the memory of the host."""
    scene, path = city
    camera, renderer, inside = _walk(scene)[1], _renderer(path, "host"), Renderer(scene, "bsah+single", 2)
    for _ in range(2):
        _same(renderer.render(camera, [LIGHT], spp=4), inside.render(camera, [LIGHT], spp=4))
        renderer.source.release()
        assert not renderer.source.residency.used
    frame = renderer.render(camera, [LIGHT], spp=4)
    assert frame.paging["device_uploaded"] == 0


@pytest.mark.parametrize("what", ["the nearest hits of rays", "the lists of tiles"])
def test_the_cpu_sees_if_the_device_has_no_room_for_rays(city, what, monkeypatch):
    scene, path = city
    camera, inside, allocate, refused = _walk(scene)[1], Renderer(scene, "bsah+single", 2), Device.allocate, []

    def tight(self, size, name="an array"):
        if name == what and len(refused) < 2:
            refused.append(size)
            raise OutOfDeviceMemory("full", size, 0)
        return allocate(self, size, name)

    renderer = _renderer(path, "host")
    monkeypatch.setattr(Device, "allocate", tight)
    frame, truth = (each.render(camera, [LIGHT], spp=4, bounce=1) for each in (renderer, inside))
    _same(frame, truth)
    assert refused and "trace_listed" in _launched(renderer)


def _refuse_rays(monkeypatch):
    """Let devices have no room for nearest-hit rays; the sizes refused."""
    allocate, refused = Device.allocate, []

    def full(self, size, name="an array"):
        if name == "the nearest hits of rays":
            refused.append(size)
            raise OutOfDeviceMemory("full", size, 0)
        return allocate(self, size, name)

    monkeypatch.setattr(Device, "allocate", full)
    return refused


def test_rays_without_room_are_traced_by_the_cpu_from_then_on(city, monkeypatch):
    """Whether they are a list, a camera's or passes of bounced light; other rays stay on the device."""
    scene, path = city
    refused, stored = _refuse_rays(monkeypatch), at.Engine(at.load(path), plan_on("host"), threads=2)
    rng = np.random.default_rng(4)
    origins, directions = rng.uniform((-40, 0.2, -40), (40, 25, 40), (300, 3)), rng.normal(size=(300, 3))
    for _ in range(2):
        np.testing.assert_array_equal(
            stored.closest_hit(origins, directions).face, scene.closest_hit(origins, directions).face
        )
        assert len(refused) == 1
    assert not stored.source.see_on_cpu()  # it does already
    renderer, inside, camera = _renderer(path, "host"), Renderer(scene, "bsah+single", 2), _walk(scene)[1]
    for _ in range(2):
        _same(*(each.render(camera, [LIGHT], spp=4, bounce=2) for each in (renderer, inside)))
        assert len(refused) == 2
    assert "trace_listed" in _launched(renderer)


def test_the_cpu_sees_in_all_ranges_once_it_does_in_one(city, tmp_path, monkeypatch):
    scene, _ = city
    at.build_store(scene, tmp_path / "all.tiles", chunk=512, tile=scene.n_triangles // 4)
    monkeypatch.setattr(tiled_store, "MAX_TRIANGLES", 2 * scene.n_triangles // 3)
    source = _renderer(tmp_path / "all.tiles", "host").source
    assert source.on_device is not None and len(source._ranges) == 2
    source._ranges[0][1].see_here()
    assert source.see_on_cpu() and not source.see_on_cpu()


@ON_DEVICE
def test_counters_count_the_rays(city, device):
    scene, path = city
    camera = _walk(scene)[1]
    frames = [
        Renderer(at.load(path), plan, 2).render(camera, [LIGHT], spp=4, counters=True)
        for plan in (plan_on(device), "bsah+chcrt")
    ]
    assert frames[0].counters["rays"] == frames[1].counters["rays"] > 0


@ON_DEVICE
@pytest.mark.parametrize("light", LIGHTS)
def test_hostile_points_see_lights_as_they_do_in_memory(device, light, tmp_path):
    scene, path = soup_scene(3), tmp_path / "soup.antumbra"
    at.build_store(scene, path, chunk=256)
    rng = np.random.default_rng(2)
    corners = scene.triangles().vertices[rng.integers(0, scene.n_triangles, 300), 0] + scene.origin
    points = np.concatenate([corners, rng.uniform(-4, 4, (300, 3))])
    normals = rng.normal(size=(600, 3)) if LIGHTS[light].domain == "hemisphere" else None
    found, truth = (
        at.visibility(each, points, LIGHTS[light], normals, spp=20, plan=plan)
        for each, plan in ((at.load(path), plan_on(device)), (scene, "bsah+single"))
    )
    np.testing.assert_array_equal(found.bits, truth.bits)
    assert truth.bits.any()


@ON_DEVICE
def test_faces_that_let_light_pass(device, tmp_path):
    scene, path = scene_with_cutouts(), tmp_path / "holes.antumbra"
    at.build_store(scene, path, chunk=16)
    camera = at.Camera((0, 2, 9), (0, 0.5, 0), width=36, height=28)
    lights = [at.QuadLight((-2, 5, -2), (4, 1, 0), (0, 0, 4)), at.AmbientOcclusion(3.0)]
    renderer = _renderer(path, device)
    _same(renderer.render(camera, lights, spp=4), at.render(scene, camera, lights, spp=4, plan="bsah+single"))
    assert renderer.source.on_device.traffic.uploaded > 0


@ON_DEVICE
@pytest.mark.parametrize("ranges", [1, 2])
def test_tiles_in_several_ranges(city, device, ranges, tmp_path, monkeypatch):
    scene, _ = city
    at.build_store(scene, tmp_path / "all.tiles", chunk=512, tile=scene.n_triangles // 4)
    if ranges > 1:
        monkeypatch.setattr(tiled_store, "MAX_TRIANGLES", 2 * scene.n_triangles // 3)
    renderer = _renderer(tmp_path / "all.tiles", device, 3)
    assert len(renderer.source.store.ranges) == ranges
    inside = Renderer(scene, "bsah+single", 2)
    for camera in _walk(scene)[::2]:
        _same(renderer.render(camera, [LIGHT, SUN], spp=4), inside.render(camera, [LIGHT, SUN], spp=4))
    assert renderer.source.on_device.traffic.evicted > 0


@ON_DEVICE
@pytest.mark.parametrize("turn", [FIRST, BOTH], ids=["first", "turned"])
@pytest.mark.parametrize("unit", [1.0, 0.3048], ids=["metres", "feet"])
def test_a_scene_that_is_turned_and_measured_in_feet(device, turn, unit, tmp_path):
    whole, path = scene_in(turn), tmp_path / "blocks.antumbra"
    vertices = (whole.triangles().vertices + whole.origin) / unit
    scene = at.Scene.from_arrays(vertices, up=turn.up, unit="m" if unit == 1.0 else "ft")
    at.build_store(scene, path, chunk=16)
    camera, lights = camera_in(turn), lights_in(turn)
    frame, truth = (
        at.render(each, camera, lights, spp=4, plan=plan)
        for each, plan in ((at.load(path), plan_on(device)), (scene, "bsah+single"))
    )
    for found, right in zip(frame.bits, truth.bits):
        np.testing.assert_array_equal(found, right)
    assert frame.paging["device_uploaded"] > 0 and any(bits.any() for bits in truth.bits)


def test_questions_between_frames_keep_their_own_fronts(city):
    """Points, pictures and ray lists take turns, on the device and on the CPU, with calls of equal numbers."""
    scene, path = city
    stored = at.Engine(at.load(path), plan_on("host"), threads=2)
    points = np.random.default_rng(3).uniform((-40, 0.2, -40), (40, 12, 40), (400, 3))
    targets = points[::-1]
    for _ in range(2):
        found = stored.visibility(at.Receivers.in_space(points, scene.origin), LIGHT, spp=20)
        np.testing.assert_array_equal(found.bits[:, 0], at.visibility(scene, points, LIGHT, spp=20).bits)
        np.testing.assert_array_equal(stored.occluded(points, targets=targets), scene.occluded(points, targets=targets))
        hits = [each.closest_hit(points, targets - points) for each in (stored, scene)]
        np.testing.assert_array_equal(hits[0].face, hits[1].face)


def test_a_chunk_without_area_blocks_nothing(tmp_path):
    scene, path = at.Scene.from_arrays([[[-1, 0, 0], [0, 0, 0], [1, 0, 0]]]), tmp_path / "line.antumbra"
    at.build_store(scene, path)
    stored = at.Engine(at.load(path), plan_on("host"))
    points = at.Receivers.in_space([[0, -1, 0], [0.25, -2, 0.5]], scene.origin)
    assert not stored.visibility(points, at.PointLight((0, 1, 0))).bits.any()
    assert stored.source.on_device.traffic.uploaded == 1


def test_nothing_to_trace_needs_no_chunks(city):
    path = city[1]
    found = at.visibility(at.load(path), np.zeros((0, 3)), LIGHT, spp=4, plan=plan_on("host"))
    assert found.bits.shape[0] == 0
    away = at.Camera((0, 900, 0), (0, 1000, 1), width=20, height=20)
    frame = _renderer(path, "host").render(away, [LIGHT], spp=4)
    assert not frame.mask.any() and frame.paging["device_uploaded"] == 0


def test_chunks_above_the_limit_are_refused(city):
    renderer = _renderer(city[1], "host")
    renderer.source.on_device.budget = 1000
    with pytest.raises(OutOfDeviceMemory, match=r"a part of the scene needs .* parts may take 1\.0 kB there"):
        renderer.render(_walk(city[0])[0], [LIGHT], spp=4)


@pytest.mark.parametrize("spare", [100_000, 400_000])
def test_chunks_leave_for_the_receivers_of_a_larger_picture(city, spare):
    """The device has room for the chunks that a small picture needs, and `spare` bytes."""
    scene, path = city
    lights, cameras = [LIGHT, SUN, at.AmbientOcclusion(3.0)], [_walk(scene)[0], _walk(scene)[0].resized(120, 100)]
    renderer, inside = _renderer(path, "host"), Renderer(scene, "bsah+single", 2)
    _same(renderer.render(cameras[0], lights, spp=4), inside.render(cameras[0], lights, spp=4))
    there = renderer.source.on_device
    device, used, before = there.device, there.device.used, there.traffic.evicted
    try:
        device.max_memory = used + spare
        _same(renderer.render(cameras[1], lights, spp=4), inside.render(cameras[1], lights, spp=4))
        assert there.traffic.evicted > before and device.used <= used + spare
        there.close()
        device.max_memory = device.used + 1000
        with pytest.raises(OutOfDeviceMemory, match="max_memory"):
            renderer.render(cameras[1].resized(400, 400), lights, spp=4)
    finally:
        device.max_memory = None


@pytest.mark.parametrize("plan", [plan_on("host"), "chcrt+device:host+bsah", "device:host+bsah+chcrt"])
def test_the_plan_is_for_stores_alone(city, plan):
    scene, path = city
    assert str(at.Engine(at.load(path), plan).plan) == plan_on("host")
    with pytest.raises(InputError, match=r"chcrt\+device:host:0 is for scenes in a store.* use device:host:0"):
        at.render(scene, _walk(scene)[0], [LIGHT], spp=4, plan=plan)


def test_the_command_line_says_what_was_uploaded(city, cli):
    words = "render", str(city[1]), "--size", "24", "--spp", "4", "--explain-plan", "-o", "a.png"
    out = cli(*words, "--plan", plan_on("host")).out
    assert "on the device" in out and "were uploaded" in out
    found = "The device host:0 found what the camera sees and traced the shadow rays; the CPU decided"
    for more in (), ("--adaptive", "--bounce", 1), ("--camera", "panorama"):
        assert found in cli(*words, "--plan", plan_on("host"), *more).out
    plain = cli(*words, "--device", "host").out
    assert "by the plan bsah+chcrt+device:host:0, the device traces camera and shadow rays" in plain
