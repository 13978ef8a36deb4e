"""OpenCL devices: what differs from other devices. Errors of the driver have their names in the OpenCL standard."""

import struct
import warnings

import numpy as np
import pytest

from antumbra.devices.device import DeviceError, OutOfDeviceMemory
from device_kernels import SAMPLES
from devices import launch, opened

ODDS = SAMPLES[-1]


@pytest.fixture
def device():
    return opened("opencl")


def odds(device, numbers):
    """The number of odd numbers, by the device."""
    source, total = device.upload(numbers), device.allocate(8)
    total.fill(0)
    launch(device, ODDS, [source.address, total.address], len(numbers))
    return total.read(np.zeros(1, np.int64))[0]


def test_allocations_are_declared_where_the_device_cannot_read_the_hosts_memory(device, monkeypatch):
    numbers = np.arange(1024, dtype=np.int32)
    monkeypatch.setattr(device.card, "reads_host", False)
    module = device.load(ODDS.code("spirv"))
    for _ in range(3):
        assert odds(device, numbers) == 512
        assert module._changes <= device.card.changes
    declared = module._changes
    launch(device, ODDS, [0, 0], 0)
    assert module._changes == declared > 0


def test_memory_is_freed_only_when_no_kernel_uses_it(device):
    source = device.upload(np.ones(1 << 16, np.int32))
    total = device.allocate(8)
    total.fill(0)
    for _ in range(20):
        launch(device, ODDS, [source.address, total.address], 1 << 16)
    source.free()
    assert total.read(np.zeros(1, np.int64))[0] == 20 << 16


def test_an_array_larger_than_the_driver_allows_is_named(device):
    largest = device.card.handle.max_mem_alloc_size
    with pytest.raises(OutOfDeviceMemory, match="in one piece; split the scene, or compute on the CPU") as error:
        device.allocate(largest + 1)
    assert (error.value.needed, error.value.left) == (largest + 1, largest)


def test_code_that_the_driver_does_not_take_comes_with_its_log(device):
    code = ODDS.code("spirv")
    strange = struct.pack("<8I", 0x07230203, 0x10000, 0, 16, 0, 0x0003000E, 2, 1)  # a memory model of graphics
    with pytest.raises(DeviceError) as error:
        device.load(code._replace(code=strange, digest="strange"))
    message = str(error.value)
    assert message.startswith(
        f"{device}: the driver does not take {code.entry}: clBuildProgram: CL_BUILD_PROGRAM_FAILURE:"
    )
    assert "\n" not in message


def test_code_without_the_entry_is_refused_by_name(device):
    code = ODDS.code("spirv")
    with pytest.raises(DeviceError, match="does not take other: clCreateKernel: CL_INVALID_KERNEL_NAME"):
        device.load(code._replace(entry="other", digest="other"))


def test_a_launch_that_fails_names_the_error(device):
    module = device.load(ODDS.code("spirv"))
    with pytest.raises(DeviceError, match="clEnqueueNDRangeKernel: CL_INVALID_WORK_GROUP_SIZE"):
        device.launch(module, [0, 0], 1, block=1 << 20)


def test_options_of_the_user_do_not_reach_the_compiler(device, monkeypatch):
    monkeypatch.setenv("PYOPENCL_BUILD_OPTIONS", "-cl-no-such-option")
    code = ODDS.code("spirv")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        device.load(code._replace(digest="compiled again"))
