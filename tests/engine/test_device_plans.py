"""Plans on devices: their names, the option device, and what stays on the CPU."""

import pickle

import numpy as np
import pytest

import antumbra as at
import moving_square
from antumbra.base.errors import InputError
from antumbra.devices.device import OutOfDeviceMemory
from antumbra.devices.device_list import default_device, using_device
from antumbra.engine.device_plans import cpu_plan, plan_on
from antumbra.engine.engine import Engine, chosen_plan, default_plan_of
from antumbra.engine.plan import parse_plan
from antumbra.engine.sources.in_memory_source import InMemory
from antumbra.engine.sources.instanced_source import Instanced
from antumbra.trace.counters import NODES, RAYS, new_counters
from antumbra.trace.device import device_tracer as device_tracer_module
from antumbra.trace.device.device_tree import UploadedTree
from antumbra.trace.device.tree_build import BuiltTree
from asking import answer, query_of
from cutout_scenes import scene_with_cutouts
from devices import device_plans
from instance_scenes import whole_scenes
from truths import soup_scene

ON_HOST = "bsah+device:host:0"
LOOK = at.Camera((0, 2, 9), (0, -0.5, 0), width=16, height=12), at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))


@pytest.fixture(autouse=True)
def _no_variable(monkeypatch):
    monkeypatch.delenv("ANTUMBRA_DEVICE", raising=False)


@pytest.mark.parametrize("name", ["host", "host:0"])
def test_a_device_stands_in_a_plan_by_its_full_name(name):
    plan = parse_plan(f"bsah+reinsert+device:{name}")
    assert str(plan) == "bsah+reinsert+device:host:0" and plan.device == "host:0"
    assert parse_plan("bsah+single").device is None and str(cpu_plan(plan)) == "bsah+reinsert+single"


@pytest.mark.parametrize("name", ["bsah+{}+device:host", "device:host:0+bsah+{}", "{}+device:host+bsah"])
@pytest.mark.parametrize(
    "method, what, on_cpu", [("multifrusta", "shaft", "single"), ("chcrt", "cache of chunks", "chcrt")]
)
def test_a_method_on_a_device_is_one_tracer_named_by_two_parts(name, method, what, on_cpu):
    plan = parse_plan(name.format(method))
    assert str(plan) == f"bsah+{method}+device:host:0" and plan.device == "host:0" and parse_plan(str(plan)) == plan
    assert parse_plan(plan) == plan and what in plan.tracer.description
    assert str(cpu_plan(plan)) == f"bsah+{on_cpu}"
    for two in "bsah+cones+device:host", f"bsah+{method}+cones", "bsah+device:host+device:host:1":
        with pytest.raises(InputError, match="names two tracers"):
            parse_plan(two)


@pytest.mark.parametrize("build", ["bsah", "lbvh", "grid32+lbvh"])
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.device(name)) for name in ("host", "opencl")])
def test_shafts_give_pictures_and_rays_of_the_cpu_with_fewer_nodes(build, name):
    plan, (camera, light), scene = f"{build}+multifrusta+device:{name}", LOOK, soup_scene(3)
    frame, expected = (at.render(scene, camera, light, spp=5, plan=each) for each in (plan, "bsah+single"))
    np.testing.assert_array_equal(frame.bits[0], expected.bits[0])
    assert frame.bits[0].any() and frame.plan == f"{plan}:0"
    triangles, query = query_of(scene, camera, light, 5)
    counters = [new_counters(), new_counters()]
    for each, mine in zip((plan, "bsah+single"), counters):
        answer(each, triangles, query, 2, mine)
    assert counters[0][RAYS] > 0
    if "grid32" not in build:  # the lamp is huge beside the few triangles that are left, so single rays trace it
        assert 0 < counters[0][NODES] < counters[1][NODES]
    origins, targets = np.random.default_rng(1).uniform(-3, 3, (2, 50, 3))
    blocked = Engine(scene, plan).occluded(origins, targets=targets)
    np.testing.assert_array_equal(blocked, scene.occluded(origins, targets=targets))


@pytest.mark.parametrize("plan", [ON_HOST, "bsah+multifrusta+device:host:0", "grid32+ploc+device:host:0"])
@pytest.mark.parametrize("make", [lambda: soup_scene(3), scene_with_cutouts, lambda: whole_scenes(1)[0]])
def test_no_points_have_no_answers(plan, make):
    found = at.visibility(make(), np.zeros((0, 3)), LOOK[1], spp=5, plan=plan)
    assert found.bits.shape[0] == 0 and found.fraction.shape[0] == 0


@pytest.mark.parametrize("plan", [None, "auto", ON_HOST, "bsah+device:host"])
def test_the_option_device_chooses_a_plan(plan):
    assert str(Engine(soup_scene(3), plan, device="host").plan) == ON_HOST


@pytest.mark.parametrize("device, plan", [("cpu", "auto"), ("host", ON_HOST), (None, ON_HOST)])
def test_the_chosen_plan_is_that_of_the_engine_whatever_the_variable(device, plan, monkeypatch):
    scene = soup_scene(3)
    monkeypatch.setenv("ANTUMBRA_DEVICE", "host")
    assert str(chosen_plan(scene.data, None, device)) == str(Engine(scene, device=device).plan) == plan


def test_the_variable_counts_only_without_a_plan_and_a_device(monkeypatch):
    scene = soup_scene(3)
    monkeypatch.setenv("ANTUMBRA_DEVICE", "host")
    assert str(Engine(scene).plan) == ON_HOST
    assert str(Engine(scene, "auto").plan) == str(Engine(scene, device="cpu").plan) == "auto"
    assert str(Engine(scene, "bsah+single").plan) == "bsah+single"


@pytest.mark.parametrize(
    "plan, device, message",
    [
        ("bsah+single", "host", r"'bsah\+single' does not trace on host:0.*device:host:0 in place of single"),
        (ON_HOST, "opencl", "does not trace on opencl:0"),
        (None, "gpu", "device is 'gpu'"),
        ("bsah+device:gpu", None, "the device of the plan is 'gpu'"),
        ("bsah+device", None, "unknown part 'device'"),
        ("device:host", None, "names no builder"),
    ],
)
def test_plans_and_devices_that_do_not_agree_are_refused(plan, device, message):
    with pytest.raises(InputError, match=message):
        Engine(soup_scene(3), plan, device=device)


def test_instances_are_traced_on_the_device_or_flattened_if_the_device_builds():
    scene, _ = whole_scenes()
    assert str(Engine(scene, device="host").plan) == plan_on("host", "auto", scene.data) == ON_HOST
    kinds = [type(Engine(scene, plan).source) for plan in (ON_HOST, "lbvh+device:host:0")]
    assert kinds == [Instanced, InMemory]


@pytest.mark.parametrize("plan", device_plans(text=True))
def test_an_engine_on_a_device_is_pickled_by_its_name(plan):
    engine = Engine(soup_scene(3), plan)
    light = at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))
    camera = at.Camera((0, 2, 9), (0, -0.5, 0), width=8, height=6)
    copy = pickle.loads(pickle.dumps(engine))
    assert str(copy.plan) == plan
    origins, targets = np.random.default_rng(1).uniform(-3, 3, (2, 50, 3))
    np.testing.assert_array_equal(copy.occluded(origins, targets=targets), engine.occluded(origins, targets=targets))
    frame = at.render(soup_scene(3), camera, light, spp=4, device=plan.split("device:")[1])
    assert frame.plan == plan.replace("lbvh", "bsah")  # the default for a scene that does not move
    np.testing.assert_array_equal(frame.bits[0], at.render(soup_scene(3), camera, light, spp=4).bits[0])


def test_frames_keep_the_tree_on_the_device(monkeypatch):
    trees = []

    def counted(bvh, launches):
        trees.append(UploadedTree(bvh, launches))
        return trees[-1]

    monkeypatch.setattr(device_tracer_module, "UploadedTree", counted)
    renderer = at.Renderer(soup_scene(3), device="host")
    camera = at.Camera((0, 2, 9), (0, -0.5, 0), width=8, height=6)
    light = at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))
    frames = [renderer.render(camera, light, spp=4).bits[0] for _ in range(3)]
    assert len(trees) == 1 and all(np.array_equal(frames[0], bits) for bits in frames)


def test_an_animation_is_rendered_in_trees_that_the_device_builds(tmp_path, monkeypatch):
    scene = at.load(moving_square.write(tmp_path / "square"))
    camera, light = at.Camera((0, 4, 5), (0, 0, 0), width=24, height=16), at.PointLight((0, 5, 0))
    renderer, on_cpu, frames = at.Renderer(scene, device="host"), at.Renderer(scene, plan="lbvh+multifrusta"), []
    for time in (0.0, 1.5, 3.0):
        frames.append(renderer.render(camera, light, time=time))
        assert frames[-1].plan == "lbvh+device:host:0"
        np.testing.assert_array_equal(frames[-1].bits[0], on_cpu.render(camera, light, time=time).bits[0])
    assert not np.array_equal(frames[0].bits[0], frames[1].bits[0])


@pytest.fixture
def builds(monkeypatch):
    """The numbers of triangles of the trees that devices have built."""
    found, build = [], device_tracer_module.DeviceTracer.build

    def counted(tracer, vertices, faces, builder):
        found.append(len(vertices if faces is None else faces))
        return build(tracer, vertices, faces, builder)

    monkeypatch.setattr(device_tracer_module.DeviceTracer, "build", counted)
    return found


BUILT = pytest.mark.parametrize("plan", [*device_plans(text=True)[2:], "ploc+device:host:0"])


@BUILT
def test_frames_of_an_animation_refit_the_tree_on_the_device(plan, builds, tmp_path):
    scene, camera = (
        at.load(moving_square.write(tmp_path / "square")),
        at.Camera((0, 4, 5), (0, 0, 0), width=24, height=16),
    )
    on_device, on_cpu = (at.Renderer(scene, plan=each) for each in (plan, "lbvh+single"))
    for time in 0.0, 0.1, 3.0:
        frames = [each.render(camera, at.PointLight((0, 5, 0)), time=time) for each in (on_device, on_cpu)]
        np.testing.assert_array_equal(frames[0].bits[0], frames[1].bits[0])
        assert len(builds) == 1 and frames[0].plan == plan


@BUILT
@pytest.mark.parametrize("fits", [True, False])
def test_an_update_refits_the_tree_of_frames_and_points_if_there_is_room(plan, fits, builds, monkeypatch):
    def refuse(tree, vertices):
        raise OutOfDeviceMemory("full", 1, 0)

    if not fits:
        monkeypatch.setattr(BuiltTree, "refitted", refuse)
    rng = np.random.default_rng(4)
    vertices = soup_scene(3).triangles().vertices + rng.normal(0, 1e-3, (3, 3))
    scene = at.Scene.from_arrays(vertices)
    receivers = at.Receivers.in_space(rng.random((40, 3)), scene.origin)
    on_device, on_cpu = at.Renderer(scene, plan=plan), at.Renderer(scene, plan="lbvh+single")
    for moment in range(3):
        frames = [each.render(*LOOK, spp=4).bits[0] for each in (on_device, on_cpu)]
        np.testing.assert_array_equal(*frames)
        bits = [each.engine.visibility(receivers, LOOK[1], spp=4).bits for each in (on_device, on_cpu)]
        np.testing.assert_array_equal(*bits)
        scene.update(vertices + 1e-3 * moment)
    assert len(builds) == (1 if fits else 3)


@pytest.mark.parametrize("order", [("lbvh+device:host:0", "lbvh+single"), ("lbvh+single", "lbvh+device:host:0")])
def test_plans_of_one_builder_answer_alike_wherever_it_ran_first(order):
    engine = Engine(soup_scene(3), order[0])
    receivers = at.Receivers.in_space(np.random.default_rng(4).random((40, 3)), engine.data.origin)
    engines = engine, engine.with_options(order[1], None, None)
    bits = [each.visibility(receivers, LOOK[1], spp=4).bits for each in engines]
    np.testing.assert_array_equal(*bits)


@pytest.mark.parametrize(
    "plan",
    [
        "grid32+lbvh+device:host:0",
        "grid32+ploc+device:host:0",
        "lbvh+reinsert+device:host:0",
        "lbvh+refit+device:host:0",
    ],
)
def test_a_device_builds_what_culling_leaves_and_takes_trees_that_the_cpu_improves(plan):
    frame, expected = (at.render(soup_scene(3), *LOOK, spp=4, plan=each) for each in (plan, "bsah+single"))
    assert frame.plan == plan
    np.testing.assert_array_equal(frame.bits[0], expected.bits[0])


def test_camera_rays_have_a_tree_of_their_own_beside_one_of_the_device():
    frames = [
        at.Renderer(soup_scene(3), plan=plan, gbuffer="rays").render(*LOOK, spp=4)
        for plan in ("lbvh+device:host:0", "bsah+single")
    ]
    np.testing.assert_array_equal(frames[0].bits[0], frames[1].bits[0])


def test_stores_keep_their_plan_for_the_cpu(monkeypatch, tmp_path):
    assert default_plan_of(soup_scene(3).data) == "auto"
    monkeypatch.setenv("ANTUMBRA_DEVICE", "host")
    assert default_plan_of(soup_scene(3).data) == ON_HOST
    at.build_store(soup_scene(3), tmp_path / "soup.antumbra")
    assert str(Engine(at.load(tmp_path / "soup.antumbra")).plan) == "bsah+chcrt"


def test_a_device_of_a_command_counts_only_within_it():
    with using_device("host"), using_device(None):
        assert default_device() == "host"
    assert default_device() is None
    with pytest.raises(InputError, match="device is 'gpu'"), using_device("gpu"):
        pass
