"""Tracers on devices, ``device:`` and the name of a device: a family of the registry of methods."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.progress import ProgressCallback
from ..bvh.nodes import Bvh
from ..devices.device_list import CPU, current_budget, parse_device
from ..kernels.parallel import thread_count
from ..query.shadow_query import ShadowQuery, ray_count
from ..trace.counters import RAYS
from .method_registry import Tracer, register_family

DEVICE = "device"
"""The name of the family."""


def device_tracer(name: str, max_memory: int | None = None) -> Any:
    """The `trace.device.device_tracer.DeviceTracer` of a device, by its full name. Engines with one budget share it.

    max_memory : bytes that may be allocated on the device; None: all that is free

    Raises
    ------
    DeviceError
        If the device cannot be used, or fails its self-test, which it takes on first use.
    """
    return _opened(name, max_memory)  # `cache` tells a default from the same argument


@cache
def _opened(name: str, max_memory: int | None) -> Any:
    from ..trace.device.device_kernels import DEVICE_KERNELS  # imported late: most processes use no device
    from ..trace.device.device_tracer import DeviceTracer
    from ..trace.device.self_test import open_tested
    from .precompilation import precompile_devices

    precompile_devices(DEVICE_KERNELS)
    return DeviceTracer(open_tested(name, max_memory))


class OnDevice(NamedTuple):
    """A tree on a device, and the device's tracer."""

    tracer: Any  # `DeviceTracer`
    tree: Any  # `trace.device.device_tree.DeviceTree`


@cache
def _tracer_of(name: str) -> Tracer:
    """The tracer of plans on a device, by its full name."""

    def prepare(bvh: Bvh, threads: int | None = None) -> OnDevice:
        tracer = device_tracer(name, current_budget())
        return OnDevice(tracer, tracer.tree(bvh))

    def trace(
        prepared: OnDevice,
        query: ShadowQuery,
        bits: NDArray[np.uint64],
        threads: int | None,
        counters: NDArray[np.int64] | None,
        progress: ProgressCallback | None,
    ) -> None:
        prepared.tracer.trace_shadow(prepared.tree, query, bits, thread_count(threads), progress)
        if counters is not None:
            counters[RAYS] += ray_count(query)

    return Tracer(
        prepare, trace, f"one ray per thread on the device {name}, exact with the help of the CPU", "", keeps=True
    )


def find_device_tracer(name: str) -> tuple[str, Tracer] | None:
    """The tracer ``device:NAME``, with the device's full name."""
    device = name.partition(":")[2]
    if not device or device == CPU:
        return None
    full = ":".join(map(str, parse_device(device, "the device of the plan")))
    return f"{DEVICE}:{full}", _tracer_of(full)


register_family(DEVICE, find_device_tracer)


def device_of(tracer: str) -> str | None:
    """The full name of the device of a tracer, by its canonical name; None: it traces on the CPU."""
    family, _, device = tracer.partition(":")
    return device if family == DEVICE else None
