"""Tracers on devices: a card takes its self-test before it traces, and its memory is limited."""

import pickle

import pytest

import antumbra as at
from antumbra.devices.device import DeviceError, OutOfDeviceMemory
from antumbra.engine import device_tracers
from antumbra.trace.device import self_test
from antumbra.trace.device.self_test import SelfTest


@pytest.fixture
def first_use(tmp_path, monkeypatch):
    """A process and a user that have not used a card yet; lets the card give so many wrong answers."""
    monkeypatch.setattr(device_tracers, "_opened", device_tracers._opened.__wrapped__)
    monkeypatch.setattr(self_test, "cache_root", lambda: tmp_path)
    monkeypatch.setattr(self_test, "_passed", set())
    return lambda wrong: monkeypatch.setattr(self_test, "run_self_test", lambda device: SelfTest(1000, wrong))


@pytest.mark.device("opencl")
def test_a_card_that_fails_its_self_test_traces_nothing(first_use):
    scene = at.Scene.from_arrays([[[-1, 0, -1], [1, 0, -1], [0, 0, 1]]])
    ray = [0.0, 1, 0], [0.0, -1, 0]
    first_use(wrong=3)
    with pytest.raises(DeviceError, match="3 of 1000 answers in its self-test are wrong, so it is not used"):
        at.Engine(scene, device="opencl").occluded(*ray)
    first_use(wrong=0)
    assert at.Engine(scene, device="opencl").occluded(*ray)


@pytest.mark.parametrize("device", [pytest.param(name, marks=pytest.mark.device(name)) for name in ("host", "opencl")])
def test_memory_on_a_device_is_limited(device):
    scene = at.procedural("atrium", triangles=20_000)
    ray = [0.0, 3, 0], [0.0, -1, 0]
    with pytest.raises(
        OutOfDeviceMemory, match=r"the tree of the scene needs .* but max_memory \(1\.0 MB\) leaves"
    ) as error:
        at.Engine(scene, device=device, max_memory=1 << 20).occluded(*ray)
    assert error.value.needed > 1 << 20
    engine = pickle.loads(pickle.dumps(at.Engine(scene, device=device, max_memory=100 << 20)))
    assert engine.max_memory == 100 << 20 and engine.occluded(*ray) == scene.occluded(*ray)


def test_memory_in_the_processor_is_not_limited():
    scene = at.procedural("atrium", triangles=1000)
    with pytest.raises(at.InputError, match="max_memory is for scenes in a store"):
        at.Engine(scene, device="cpu", max_memory=1 << 20)


def test_the_command_line_limits_memory_on_a_device(cli):
    words = "render", "procedural:atrium?triangles=20k", "--size", "8", "--device", "host", "-o", "a.png"
    cli(*words, "--max-memory", "1M").refused("the tree of the scene needs", "max_memory (1.0 MB)", "--max-memory")
    assert cli(*words, "--max-memory", "200M").code == 0


def test_engines_with_one_budget_share_a_tracer():
    tracer = device_tracers.device_tracer("host:0")
    assert tracer is device_tracers.device_tracer("host:0", None)
    assert tracer is not device_tracers.device_tracer("host:0", 1 << 30)
