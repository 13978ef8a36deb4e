"""Tracers on devices, ``device:`` and the name of a device: a family of the registry of methods."""

from functools import cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..base.progress import ProgressCallback
from ..bvh.nodes import Bvh
from ..devices.device_list import CPU, current_budget, parse_device
from ..kernels.parallel import thread_count
from ..query.shadow_query import ShadowQuery, ray_count
from ..scene.resident_triangles import ResidentTriangles
from ..scene.triangles import Triangles
from ..techniques.culling.pre_bvh_culling import BoundedSegments
from ..trace.alpha_cutouts import CutoutTree
from ..trace.counters import RAYS
from ..trace.tracer import Bits, Counters, Tracer, TracerState
from ..trace.transmission import Shares
from .method_registry import register_family

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
    return _opened(name, max_memory)  # `cache` distinguishes a default from an equal argument


@cache
def _opened(name: str, max_memory: int | None) -> Any:
    from ..techniques.culling import device_culling  # noqa: F401, imported late, since most processes use no device
    from ..trace.device.device_kernels import KERNELS
    from ..trace.device.device_tracer import DeviceTracer
    from ..trace.device.self_test import open_tested
    from .precompilation import precompile_devices

    precompile_devices(list(KERNELS.values()))
    return DeviceTracer(open_tested(name, max_memory))


class OnDevice(TracerState):
    """A tree on a device, with the device's tracer. It is kept from frame to frame, so that it is uploaded once."""

    def __init__(self, tracer: Any, tree: Any) -> None:
        self.tracer = tracer  # `DeviceTracer`
        self.tree = tree  # `trace.device.device_tree.DeviceTree`

    @property
    def host_tree(self) -> Bvh:
        """The same tree on the host."""
        with self.tracer.lock:
            return cast(Bvh, self.tree.bvh)

    def begin(self) -> None:
        """Begin a frame; nothing changes on the device."""

    def add_shadows(self, cutouts: CutoutTree, query: ShadowQuery, bits: Bits, threads: int) -> None:
        """Set the bits of samples whose light cut-outs block, as `alpha_cutouts.add_shadows`."""
        self.tracer.add_shadows(cutouts, query, bits, threads)

    def shares(self, cutouts: CutoutTree, query: ShadowQuery, bits: Bits, threads: int) -> Shares:
        """The light that comes through cut-outs, as `transmission.shares_of`."""
        return cast(Shares, self.tracer.shares(cutouts, query, bits, threads))


class OnDeviceTracer(Tracer):
    """One ray per thread on a device, exact with the help of the CPU.

    device : full name
    """

    builders = ("lbvh",)

    def __init__(self, device: str) -> None:
        self.device, self.description = device, f"one ray per thread on the device {device}, exact with the CPU's help"

    def prepare(self, geometry: Any, threads: int | None = None) -> OnDevice:
        """The tree on the device."""
        tracer = device_tracer(str(self.device), current_budget())
        return OnDevice(tracer, tracer.tree(geometry))

    def build(
        self,
        builder: str,
        triangles: Triangles,
        faces: NDArray[np.int32] | None,
        segments: BoundedSegments | None = None,
    ) -> OnDevice:
        """A tree built on the device."""
        tracer = device_tracer(str(self.device), current_budget())
        vertices = _vertices(triangles, tracer)
        if segments is None:
            return OnDevice(tracer, tracer.build(vertices, faces))
        from ..techniques.culling.device_culling import build_relevant

        return OnDevice(tracer, build_relevant(tracer, vertices, faces, segments))

    def refit(self, prepared: OnDevice, triangles: Triangles, limit: float) -> OnDevice | None:
        """The tree, refitted on the device."""
        tree = prepared.tracer.refit(prepared.tree, _vertices(triangles, prepared.tracer), limit)
        return None if tree is None else OnDevice(prepared.tracer, tree)

    def trace(
        self,
        prepared: OnDevice,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        prepared.tracer.trace_shadow(prepared.tree, query, bits, thread_count(threads), progress)
        if counters is not None:
            counters[RAYS] += ray_count(query)


def _vertices(triangles: Triangles, tracer: Any) -> Any:
    """The vertices of triangles: in the memory of a tracer's device if they are there, otherwise on the host."""
    if isinstance(triangles, ResidentTriangles) and triangles.memory.device.name == tracer.device.name:
        return triangles.memory
    return triangles.vertices


@cache
def _tracer_of(name: str) -> OnDeviceTracer:
    """The tracer of plans on a device, by its full name."""
    return OnDeviceTracer(name)


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
