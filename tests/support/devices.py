"""The devices that tests run over, and what is launched on them."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.devices.arrays import DeviceArray
from antumbra.devices.device import Device
from antumbra.devices.device_list import open_device
from antumbra.engine.device_tracers import device_tracer
from antumbra.engine.plan import parse_plan
from antumbra.kernels.marshalling import flatten, struct_of
from antumbra.kernels.toolchain.device_code import DeviceKernel

DEVICES = "host", "opencl", "cuda"


def opened(name: str, max_memory: int | None = None) -> Device:
    """A device, or a loud skip without it; a failure if ANTUMBRA_TEST_DEVICES names it: "opencl,cuda"."""
    try:
        return open_device(name, max_memory)
    except InputError as error:
        if name in os.environ.get("ANTUMBRA_TEST_DEVICES", "").split(","):
            pytest.fail(f"{name} is in ANTUMBRA_TEST_DEVICES: {error}")
        pytest.skip(f"{name} is NOT checked: {error}")


def device_plans(text: bool = False) -> list[Any]:
    """Parameters of tests: plans that trace on the host device and by OpenCL, which skips loudly without a driver.

    The CPU builds the tree of `bsah`, and the device that of `lbvh`.

    text : as strings instead of plans
    """
    plans = [(name, f"{build}+device:{name}:0") for build in ("bsah", "lbvh") for name in DEVICES[:2]]
    return [
        pytest.param(plan if text else parse_plan(plan), id=plan, marks=pytest.mark.device(name))
        for name, plan in plans
    ]


def on_device_of(engine: Any, array: np.ndarray) -> DeviceArray:
    """An array, copied to the device of an engine."""
    device = device_tracer(engine.plan.device, engine.accelerator.device_memory).device
    return DeviceArray(device.upload(np.ascontiguousarray(array)), array.shape, array.dtype, device.queue)


def words_of(*arguments: object) -> np.ndarray:
    """The argument words of a launch."""
    key, values = flatten(arguments)
    return np.frombuffer(struct_of(key).pack(*values), np.int64)


def launch(device: Device, kernel: DeviceKernel, arguments: Sequence[object], threads: int, **options: object) -> None:
    """Compile a kernel for a device, and run it there."""
    device.launch(device.load(kernel.code(device.form)), words_of(*arguments), threads, **options)
