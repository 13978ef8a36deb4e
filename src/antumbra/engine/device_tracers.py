"""Tracers on devices: families of the registry, each with the name of a device, such as ``multifrusta+device:cuda:0``.

``device`` traces single rays, ``multifrusta+device`` shafts, and ``chcrt+device`` the chunks of a store.
"""

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.progress import ProgressCallback
from ..bvh.nodes import Bvh
from ..devices.device import OutOfDeviceMemory
from ..devices.device_list import CPU, current_budget, parse_device
from ..kernels.parallel import thread_count
from ..query.gbuffer import GBuffer
from ..query.query_bounds import triangle_box
from ..query.resident_gbuffer import ResidentGBuffer
from ..query.shadow_query import ShadowQuery, ray_count
from ..scene.camera import CameraRays
from ..scene.resident_triangles import ResidentTriangles
from ..scene.triangles import Triangles
from ..techniques.chcrt.chcrt_tracer import ChcRtTracer
from ..techniques.culling.pre_bvh_culling import CullRequest
from ..techniques.tracer_options import ChcRtOptions
from ..trace.alpha_cutouts import CutoutTree
from ..trace.counters import NODES, RAYS
from ..trace.frusta.multi_frusta import BENTHIN
from ..trace.tracer import Bits, Counters, Tracer, TracerState
from ..trace.transmission import Shares
from .method_registry import register_family

if TYPE_CHECKING:
    from ..techniques.chcrt.chc_rt import ChcRtState

DEVICE, SHAFTS, CHUNKS = "device", "multifrusta+device", "chcrt+device"
"""The names of the families: single rays, shafts, and single rays through chunks of a store."""


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


def free_blocks(tracer: Any) -> None:
    """Free what a device keeps for further calls of its tracer besides trees, such as the rays of a camera."""
    with tracer.lock:
        tracer.launches.free_blocks()


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

    def see(self, triangles: Triangles, rays: CameraRays, cutouts: CutoutTree | None, threads: int) -> GBuffer:
        """What a perspective camera sees of a scene of which this is the tree. OutOfDeviceMemory if it does not fit."""
        from ..trace.device.device_surfaces import see_surfaces

        there = see_surfaces(self.tracer, self.tree, triangles, rays, cutouts, threads)
        return ResidentGBuffer.of(there)

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

    builders = ("lbvh", "ploc")

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
        request: CullRequest | None = None,
    ) -> OnDevice:
        """A tree built on the device, of the triangles that queries can meet if there is a request."""
        tracer = device_tracer(str(self.device), current_budget())
        vertices = _vertices(triangles, tracer)
        if request is None or not vertices.size:
            return OnDevice(tracer, tracer.build(vertices, faces, builder))
        from ..techniques.culling.device_culling import build_relevant

        box = triangle_box(triangles, request.threads)
        return OnDevice(tracer, build_relevant(tracer, vertices, faces, request, box, builder))

    def draw(self, triangles: Triangles, rays: CameraRays, cutouts: CutoutTree | None, threads: int) -> GBuffer | None:
        """What a perspective camera sees, drawn without a tree; None: the device cannot draw it."""
        from ..trace.device.device_rasteriser import draw_surfaces

        tracer = device_tracer(str(self.device), current_budget())
        try:
            there = draw_surfaces(tracer, triangles, rays, cutouts, threads)
        except OutOfDeviceMemory:
            free_blocks(tracer)
            return None
        return None if there is None else ResidentGBuffer.of(there)

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
        visits = self._launch(prepared, query, bits, thread_count(threads), progress)
        if counters is not None:
            counters[RAYS] += ray_count(query)
            counters[NODES] += visits

    def _launch(
        self, prepared: OnDevice, query: ShadowQuery, bits: Bits, threads: int, progress: ProgressCallback | None
    ) -> int:
        """Trace a query, and return the number of nodes visited, as far as it is counted."""
        prepared.tracer.trace_shadow(prepared.tree, query, bits, threads, progress)
        return 0


class ShaftsOnDeviceTracer(OnDeviceTracer):
    """One shaft of up to 16 shadow rays per thread on a device; rays of lists, and unsuitable queries, one by one."""

    paper = BENTHIN

    def __init__(self, device: str) -> None:
        super().__init__(device)
        self.description = f"one shaft of shadow rays per thread on the device {device}, exact with the CPU's help"

    def _launch(
        self, prepared: OnDevice, query: ShadowQuery, bits: Bits, threads: int, progress: ProgressCallback | None
    ) -> int:
        tracer, before = prepared.tracer, prepared.tracer.visits
        tracer.trace_shadow(prepared.tree, query, bits, threads, progress, True)
        return int(tracer.visits - before)


class ChunksOnDeviceTracer(ChcRtTracer):
    """CHC+RT whose rays are traced on a device, with its memory as a cache of a store's chunks.

    device : full name
    """

    def __init__(self, device: str) -> None:
        super().__init__(
            ChcRtOptions(), f"chcrt for stores, with the memory of the device {device} as a cache of chunks"
        )
        self.device = device

    def _state_of(self, bvh: Bvh, threads: int | None = None) -> "ChcRtState":
        raise InputError(
            f"{CHUNKS}:{self.device} is for scenes in a store, and this one is in memory; use {DEVICE}:{self.device}"
        )


def _vertices(triangles: Triangles, tracer: Any) -> Any:
    """The vertices of triangles: in the memory of a tracer's device if they are there, otherwise on the host."""
    if isinstance(triangles, ResidentTriangles) and triangles.memory.device.name == tracer.device.name:
        return triangles.memory
    return triangles.vertices


_TRACERS: dict[str, Callable[[str], Tracer]] = {
    DEVICE: OnDeviceTracer,
    SHAFTS: ShaftsOnDeviceTracer,
    CHUNKS: ChunksOnDeviceTracer,
}
"""Family -> its tracer on a device, by the device's full name."""


@cache
def _tracer_of(family: str, name: str) -> Tracer:
    """The tracer of plans on a device, by the device's full name."""
    return _TRACERS[family](name)


def find_device_tracer(name: str) -> tuple[str, Tracer] | None:
    """The tracer of a family and a device, as in ``device:NAME``, with the device's full name."""
    family, _, device = name.partition(":")
    if not device or device == CPU:
        return None
    full = ":".join(map(str, parse_device(device, "the device of the plan")))
    return f"{family}:{full}", _tracer_of(family, full)


for _family in _TRACERS:
    register_family(_family, find_device_tracer)


def joined_tracer(a: str, b: str) -> str | None:
    """The tracer that two parts of a plan name together, ``multifrusta`` and ``device:NAME``; None: they name two."""
    first, second = (b, a) if a.startswith(f"{DEVICE}:") else (a, b)
    is_joined = f"{first}+{DEVICE}" in _TRACERS and second.startswith(f"{DEVICE}:")
    return f"{first}+{second}" if is_joined else None


def device_of(tracer: str) -> str | None:
    """The full name of the device of a tracer, by its canonical name; None: it traces on the CPU."""
    family, _, device = tracer.partition(":")
    return device if family in _TRACERS else None


def method_on_cpu(tracer: str) -> str:
    """The tracer whose kernels run on the CPU beside those of a device, by that one's canonical name."""
    return "chcrt" if tracer.partition(":")[0] == CHUNKS else "single"


def traces_single_rays(tracer: str) -> bool:
    """Whether a tracer, by its canonical name, traces all rays on a device one by one, as it does through copies."""
    return tracer.partition(":")[0] == DEVICE
