"""The host device has memory with a budget, and loads PTX and nothing else. `test_operations` runs kernels on it."""

import numpy as np
import pytest

import device_kernels as sample
from antumbra.devices.device import DeviceError, OutOfDeviceMemory
from antumbra.devices.host import host_device
from antumbra.devices.host.host_device import HostDevice

FLOATS = sample.FLOATS.code("ptx")


@pytest.fixture
def device():
    return HostDevice()


def test_new_memory_is_not_zero(device):
    with device.allocate(1000) as memory:
        assert memory.read(np.zeros(1000, np.uint8)).all() and memory.address % 128 == 0


def test_memory_has_a_budget(device):
    small = HostDevice(max_memory=1 << 20)
    with pytest.raises(OutOfDeviceMemory, match="raise max_memory"):
        small.allocate(2 << 20)
    block = small.allocate(1 << 20)
    block.free()
    assert small.used == 0 and small._arrays == {}


def test_a_kernel_is_translated_once(monkeypatch, device):
    device.load(FLOATS)
    monkeypatch.setattr(host_device, "PtxProgram", lambda code: pytest.fail("it is translated again"))
    assert HostDevice().load(FLOATS).entry == FLOATS.entry


def test_spirv_is_refused(device):
    with pytest.raises(ValueError, match="loads ptx"):
        device.load(sample.FLOATS.code("spirv"))


def test_damaged_code_is_an_error(device):
    with pytest.raises(DeviceError):
        device.load(FLOATS._replace(code=FLOATS.code[:900]))
