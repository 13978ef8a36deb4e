"""Plans on devices: their names, the option device, and what stays on the CPU."""

import pickle

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.devices.device_list import default_device, using_device
from antumbra.engine.device_plans import cpu_plan, plan_on
from antumbra.engine.engine import Engine, chosen_plan, default_plan_of
from antumbra.engine.plan import parse_plan
from antumbra.trace.device import device_tracer as device_tracer_module
from antumbra.trace.device.device_tree import DeviceTree
from devices import device_plans
from instance_scenes import whole_scenes
from truths import soup_scene

ON_HOST = "bsah+device:host:0"


@pytest.fixture(autouse=True)
def _no_variable(monkeypatch):
    monkeypatch.delenv("ANTUMBRA_DEVICE", raising=False)


@pytest.mark.parametrize("name", ["host", "host:0"])
def test_a_device_stands_in_a_plan_by_its_full_name(name):
    plan = parse_plan(f"bsah+reinsert+device:{name}")
    assert str(plan) == "bsah+reinsert+device:host:0" and plan.device == "host:0"
    assert parse_plan("bsah+single").device is None and str(cpu_plan(plan)) == "bsah+reinsert+single"


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


def test_instances_keep_their_plan_for_the_cpu():
    scene, _ = whole_scenes()
    assert str(Engine(scene, device="host").plan) == str(Engine(scene).plan)
    assert plan_on("host", None, scene.data) is None and plan_on("host", "auto", scene.data) == "auto"


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
    assert frame.plan == plan
    np.testing.assert_array_equal(frame.bits[0], at.render(soup_scene(3), camera, light, spp=4).bits[0])


def test_frames_keep_the_tree_on_the_device(monkeypatch):
    trees = []

    def counted(bvh, launches):
        trees.append(DeviceTree(bvh, launches))
        return trees[-1]

    monkeypatch.setattr(device_tracer_module, "DeviceTree", counted)
    renderer = at.Renderer(soup_scene(3), device="host")
    camera = at.Camera((0, 2, 9), (0, -0.5, 0), width=8, height=6)
    light = at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))
    frames = [renderer.render(camera, light, spp=4).bits[0] for _ in range(3)]
    assert len(trees) == 1 and all(np.array_equal(frames[0], bits) for bits in frames)


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
