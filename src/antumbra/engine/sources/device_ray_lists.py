"""Ray lists of plans that trace on a device. When users move the geometry, the tree is refitted on the device."""

import threading
from typing import Any, NamedTuple

from ...base.errors import InputError
from ...base.forks import is_stuck, renew_after_fork
from ...bvh.refit import refit_faces
from ...bvh.tree_quality import sah_cost
from ...devices.arrays import DeviceArray
from ...kernels.array_pool import ArrayPool
from ...query.ray_list import RayArguments, TracedRays, cull_value
from ...scene.resident_triangles import DeviceVertices
from ...scene.triangles import HitFilter, Triangles
from ...trace.device.resident_rays import ResidentRays, is_resident
from ..accelerator import Accelerated, Accelerator, SceneTrees
from ..device_tracers import OnDevice, device_tracer
from ..precompilation import precompile
from ..tree_choice import are_equal_faces

REBUILD = 1.5
"""The tree is rebuilt once moved triangles have raised its SAH cost by this factor: refits take little time."""


class _RayTree(NamedTuple):
    """The tree of ray lists at a time sample."""

    time: float
    accelerated: Accelerated
    own: bool  # whether nobody else uses the tree on the device, so that it can be refitted there
    cost: float  # SAH cost when it was built


class DeviceRayLists:
    """Traces any and nearest hits of ray lists on a device, a `HitSource`. It is thread-safe; calls take turns.

    accelerator : Accelerator
        Of the plan.
    """

    def __init__(self, trees: SceneTrees, accelerator: Accelerator) -> None:
        self._trees, self._accelerator = trees, accelerator
        self._ready: _RayTree | None = None
        self._pool = ArrayPool()
        self._lock = threading.RLock()
        renew_after_fork(self)

    def _after_fork(self) -> None:
        if is_stuck(self._lock):
            self._lock, self._ready = threading.RLock(), None

    def takes(self, origins: Any) -> bool:
        """Whether rays are in an array on a device, for `trace_resident`."""
        return is_resident(origins)

    def vertices(self, value: Any) -> DeviceVertices:
        """New vertices in an array on the device, for `MemoryData.update`. InputError if it is elsewhere."""
        from ...trace.device.resident_vertices import ResidentVertices

        return ResidentVertices(
            device_tracer(str(self._accelerator.plan.device), self._accelerator.device_memory), value
        )

    def trace_rays(self, rays: RayArguments, any_hit: bool, threads: int) -> TracedRays:
        """The hits of rays. InputError if a ray is invalid."""
        rays.arrays().check()
        with self._lock:
            ready = self._ready_at(rays.time)
            prepared: OnDevice = ready.accelerated.prepared
            out = prepared.tracer.trace_rays(prepared.tree, rays, any_hit, threads, ready.accelerated.cutouts)
        if any_hit:
            return TracedRays(out, None)
        found = ready.accelerated.triangles, out.face.reshape(rays.shape)
        return TracedRays(out, lambda: found)

    def trace_resident(
        self,
        origins: Any,
        directions: Any,
        targets: Any,
        hits: HitFilter,
        frame: tuple[float, float, float],
        any_hit: bool,
        time: float,
        threads: int,
    ) -> tuple[DeviceArray, ...]:
        """The hits of rays in arrays on the device, there; see `DeviceTracer.trace_resident`.

        Raises
        ------
        InputError
            If an argument is not of the kind that devices take, or a ray is invalid.
        """
        if hits.skip_face is not None or (directions is None) == (targets is None):
            raise InputError("on a device, give origins and either directions or targets, without skip_face")
        with self._lock:
            ready = self._ready_at(time)
            prepared: OnDevice = ready.accelerated.prepared
            segments, facing = targets is not None, cull_value(hits.cull_faces)
            ends, interval = targets if segments else directions, (hits.tmin, hits.tmax)
            device = prepared.tracer.device
            rays = ResidentRays.checked(device, origins, ends, segments, interval, facing, frame)
            trace, cutouts = prepared.tracer.trace_resident, ready.accelerated.cutouts
            found: tuple[DeviceArray, ...] = trace(prepared.tree, rays, any_hit, threads, cutouts)
            return found

    def _ready_at(self, time: float) -> _RayTree:
        precompile("devices")
        ready, threads = self._ready, self._accelerator.threads
        triangles = self._trees.triangles(time, threads)
        if ready is not None and ready.accelerated.triangles is triangles:
            return ready
        if ready is not None and ready.time == time:
            self._ready = self._refitted(ready, triangles)
        else:
            self._ready = _RayTree(time, self._trees.of(self._accelerator, time), False, 0.0)
        return self._ready

    def _refitted(self, ready: _RayTree, triangles: Triangles) -> _RayTree:
        """The tree with moved triangles, or a new one. The accelerator refits those that the device builds."""
        bvh, threads = ready.accelerated.bvh, self._accelerator.threads
        if (
            bvh is None
            or len(bvh.prim_ids) < 2
            or not are_equal_faces(ready.accelerated.triangles.solid, triangles.solid)
        ):
            return _RayTree(ready.time, self._accelerator.build(triangles), True, 0.0)
        moved = refit_faces(bvh, triangles.vertices, threads, self._pool)
        cost = ready.cost or sah_cost(bvh, threads=threads)
        if sah_cost(moved, threads=threads) > REBUILD * cost:
            return _RayTree(ready.time, self._accelerator.build(triangles), True, 0.0)
        prepared: OnDevice = ready.accelerated.prepared
        if ready.own:
            prepared.tracer.move(prepared.tree, moved, triangles.vertices)
        else:
            prepared = OnDevice(prepared.tracer, prepared.tracer.tree(moved))
        cutouts = self._accelerator.cutouts_of(triangles)
        return _RayTree(ready.time, Accelerated(triangles, moved, prepared, cutouts), True, cost)
