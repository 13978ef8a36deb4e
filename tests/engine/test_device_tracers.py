"""Tracers on devices: a card takes its self-test before it traces."""

import pytest

import antumbra as at
from antumbra.devices.device import DeviceError
from antumbra.engine import device_tracers
from antumbra.trace.device import self_test
from antumbra.trace.device.self_test import SelfTest


@pytest.fixture
def first_use(tmp_path, monkeypatch):
    """A process and a user that have not used a card yet; lets the card give so many wrong answers."""
    monkeypatch.setattr(device_tracers, "device_tracer", device_tracers.device_tracer.__wrapped__)
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
