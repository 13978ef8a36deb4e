"""Scenes of instances: rays traverse the trees of meshes, and the triangles of copies are placed where rays meet them.

The plan ``wide`` traces instances, with any builder and optimiser. So do devices, ray by ray, if the CPU builds the
trees; the CPU finds all hits then, and what orthographic and panoramic cameras see. Other plans need all triangles at
once, so an engine with such a plan flattens the scene.
"""

import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import groupby
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from ...base.forks import is_stuck, renew_after_fork
from ...bvh.instance_trees import InstanceTrees
from ...devices.device import OutOfDeviceMemory
from ...query.closed_surfaces import closed_surfaces
from ...query.gbuffer import from_hits
from ...query.pixel_refinement import subpixel_rays
from ...query.ray_list import (
    HitArrays,
    RayArguments,
    RayArrays,
    TracedRays,
    changed_error,
    hit_arrays,
    rays_in_frame,
)
from ...query.ray_passes import RayPass, camera_pass, rays_through
from ...query.shadow_query import Surfaces
from ...scene.camera import CameraRays, ExplicitRays
from ...scene.instance_data import InstanceData
from ...scene.scene_bounds import flush_to_zero
from ...scene.scene_data import SceneData
from ...scene.triangles import AllHits, ClosestPoints, Triangles
from ...trace.rays.all_hits import INSIDE
from ...trace.rays.instance_batches import trace_list
from ...trace.rays.instance_rays import InstanceForest, count_all, find_all
from ...trace.rays.ray_hits import hit_surfaces
from ..accelerator import Accelerated, Accelerator, SceneTrees
from ..device_tracers import OnDevice, device_tracer, free_blocks, traces_single_rays
from ..plan import Plan
from ..precompilation import precompile
from ..primary_visibility import RAYS
from ..tree_choice import new_tree
from .in_memory_source import InMemory, RayLists, limit_device
from .source_protocols import Bodies, CameraView, SourceSettings

# --- Trees that engines share -----------------------------------------------------------------------------------------


INSTANCED_PLAN = "bsah+wide"
"""The plan of an engine without an explicit plan."""


def traces_instances(plan: Plan) -> bool:
    """Whether a plan traces instances without flattening them."""
    if plan.cull or plan.update or plan.wants_rays:
        return False
    return plan.trace == "wide" or (traces_single_rays(plan.trace) and plan.build not in plan.tracer.builders)


class SharedInstances:
    """The trees of a scene of instances, and those of its flattened triangles: `SharedTrees`. It is thread-safe."""

    default_plan: ClassVar[str] = INSTANCED_PLAN

    def __init__(self, data: SceneData):
        self._data, self._lock = cast(InstanceData, data), threading.RLock()
        self.clear()
        renew_after_fork(self)

    def clear(self) -> None:
        """Drop all trees. Other threads must not use them meanwhile."""
        self._trees: dict[object, InstanceTrees] = {}  # by `Plan.tree`
        self._flat: SceneTrees | None = None
        self._lists: RayLists | None = None

    def _after_fork(self) -> None:
        if is_stuck(self._lock):
            self._lock = threading.RLock()
            self.clear()

    def trees(self, accelerator: Accelerator) -> InstanceTrees:
        """The trees by a plan that traces instances."""
        with self._lock:
            key = accelerator.plan.tree
            if key not in self._trees:
                self._trees[key] = InstanceTrees(self._data, partial(new_tree, accelerator.choice), accelerator.threads)
            return self._trees[key]

    def source(self, accelerator: Accelerator, settings: SourceSettings) -> "Instanced | InMemory":
        """The source of an engine: flattened if the plan needs all triangles."""
        limit_device(self._data, accelerator, settings)
        if traces_instances(accelerator.plan):
            return Instanced(self._data, accelerator, self)
        return InMemory(self._data.flattened(), accelerator, self.flat(), settings.gbuffer)

    def flat(self) -> SceneTrees:
        """The trees of the flattened scene.

        Raises
        ------
        InputError
            If the copies take more memory than the machine has.
        """
        with self._lock:
            if self._flat is None:
                self._flat = SceneTrees(self._data.flattened())
            return self._flat

    def flat_lists(self, threads: int) -> RayLists:
        """The ray lists of the flattened scene. Errors as for `flat`."""
        trees = self.flat()
        with self._lock:
            if self._lists is None:
                self._lists = RayLists(self._data.flattened(), trees, threads)
            return self._lists


# --- The render source ------------------------------------------------------------------------------------------------


_NOTHING = Triangles(np.zeros((1, 3, 3), np.float32), np.zeros(3), np.zeros(1, np.int32), np.zeros((1, 3), np.float32))


class Instanced:
    """A scene of instances: a `RenderSource` with a `FixedTree`, which traces its own `RayListSource`.

    Parameters
    ----------
    data : InstanceData
    accelerator : Accelerator
        Holds a plan that `traces_instances`.
    shared : SharedInstances
        Shared with other engines of the scene.
    """

    default_plan: ClassVar[str] = INSTANCED_PLAN
    looks: ClassVar[int] = 0
    gbuffer = RAYS
    geometry = memory = None

    def __init__(self, data: InstanceData, accelerator: Accelerator, shared: SharedInstances):
        self.scene, self.threads = data, accelerator.threads
        self._accelerator, self._shared = accelerator, shared
        self._bodies: Bodies | None = None
        self._forest: tuple[InstanceTrees, OnDevice] | None = None  # the trees, and the same on a device
        self._sees_on_cpu = False
        self._lock = threading.RLock()
        renew_after_fork(self)
        self._empty = _NOTHING._replace(
            origin=data.origin.copy()
        )  # never empty, since kernels may read the first entry

    def _after_fork(self) -> None:
        if is_stuck(self._lock):
            self._lock = threading.RLock()

    @property
    def fixed(self) -> "Instanced":
        return self

    @property
    def ray_lists(self) -> "Instanced":
        return self

    def warm_up(self) -> None:
        precompile("instances")

    @property
    def trees(self) -> InstanceTrees:
        """The trees of the engine's plan."""
        return self._shared.trees(self._accelerator)

    @property
    def accelerated(self) -> Accelerated:
        prepared = InstanceForest(self.trees.arrays) if self._accelerator.plan.device is None else self._on_device()
        return Accelerated(self._empty, None, prepared)

    def _on_device(self) -> OnDevice:
        """The trees on the device of the plan, uploaded once."""
        from ...trace.device.device_instances import ForestTracer  # imported late: most engines use no device

        with self._lock:
            if self._forest is None or self._forest[0] is not self.trees:
                plan, trees = self._accelerator.plan, self.trees
                tracer = ForestTracer(device_tracer(str(plan.device), self._accelerator.device_memory))
                self._forest = trees, OnDevice(tracer, tracer.forest(trees))
            return self._forest[1]

    @property
    def bounds(self) -> NDArray[np.float32]:
        return flush_to_zero((self.scene.bounds - self.scene.origin).astype(np.float32))

    def look(self, view: CameraView) -> Surfaces:
        """The surfaces visible to a camera."""
        camera, rows = view.camera, view.rows
        shape = rows.stop - rows.start, camera.width
        if camera.listed:
            return next(self.nearest([camera_pass(cast(ExplicitRays, camera.view(self.scene.origin)), rows)], shape))
        rays = camera.rays(self.scene.origin)
        hits, device = self._hits_of_pixels(rays, rows)
        visible, face = self._visible(hits.face.reshape(shape))
        gbuffer = from_hits(face, hits.t.reshape(shape), visible, rays, self.threads, rows.start)
        return Surfaces(gbuffer, visible, hits.face.reshape(shape), self.bounds, device=device)

    def see_on_cpu(self) -> bool:
        if self._accelerator.plan.device is None or self._sees_on_cpu:
            return False
        self._sees_on_cpu = True
        free_blocks(self._on_device().tracer)
        return True

    def _hits_of_pixels(self, rays: CameraRays, rows: slice) -> tuple[HitArrays, str | None]:
        """The nearest hits of the pixels of some rows, and the device that found them: the plan's, if it has room."""
        device = self._accelerator.plan.device
        if device is not None and not self._sees_on_cpu:
            there = self._on_device()
            try:
                return there.tracer.trace_pixels(there.tree, rays, rows, self.threads), device
            except OutOfDeviceMemory:
                free_blocks(there.tracer)
        mask = np.zeros((rays.height, rays.width), np.bool_)
        mask[rows] = True
        return self._hits(rays_through(rays, mask, self.threads)), None

    def _hits(self, rays: RayPass) -> HitArrays:
        """The nearest hits of a pass. Rays of length 0, which stand for pixels without a ray, miss."""
        moving = np.asarray(rays.directions.any(1))
        arguments = rays_in_frame(rays if moving.all() else RayPass(*(array[moving] for array in rays)))
        out = hit_arrays(arguments.n, False)
        valid = trace_list(self.trees, arguments, False, out, self.threads)
        assert valid, "rays of pictures are finite"
        if moving.all():
            return out
        face, t = np.full(len(moving), -1, np.int32), np.full(len(moving), np.inf)
        face[moving], t[moving] = out.face, out.t
        return out._replace(face=face, t=t)

    def _visible(self, faces: NDArray[np.int32]) -> tuple[Triangles, NDArray[np.int32]]:
        """The triangles of faces, (...) int32, each once; and the index of each face's triangle, or -1."""
        ids = np.unique(faces)
        ids = ids[ids >= 0]
        if not len(ids):
            return self._empty, np.full(faces.shape, -1, np.int32)
        index = np.where(faces >= 0, np.searchsorted(ids, faces), -1).astype(np.int32)
        return self.scene.some_triangles(ids), index

    def nearest(self, passes: Sequence[RayPass], shape: tuple[int, int]) -> Iterator[Surfaces]:
        """The first surfaces hit by each of several passes of rays; `shape`: (H, W) of the image."""
        for rays in passes:
            hits = self._hits(rays)
            visible, face = self._visible(hits.face)
            gbuffer = hit_surfaces(rays, face, hits.t, shape, visible, self.threads)
            yield Surfaces(gbuffer, visible, hits.face.reshape(shape), self.bounds)

    def subpixels(self, view: CameraView, edge: NDArray[np.bool_]) -> Surfaces:
        rays, shape = subpixel_rays(view.camera.view(self.scene.origin), edge, self.threads)
        return next(self.nearest([rays], shape))

    def trace_rays(self, rays: RayArguments, any_hit: bool, threads: int) -> TracedRays:
        self.warm_up()
        if self._accelerator.plan.device is not None:
            out = self._traced_there(rays, any_hit, threads)
            return TracedRays(out, None if any_hit else partial(self._visible, out.face.reshape(rays.shape).copy()))
        out = hit_arrays(rays.n, any_hit)
        if not trace_list(self.trees, rays, any_hit, out, threads):
            rays.arrays().check()
            raise changed_error()
        return TracedRays(out, None if any_hit else partial(self._visible, out.face.reshape(rays.shape).copy()))

    def _traced_there(self, rays: RayArguments, any_hit: bool, threads: int) -> HitArrays:
        """The hits of rays, from the device. InputError if a ray is invalid."""
        rays.arrays().check()
        there = self._on_device()
        return cast(HitArrays, there.tracer.trace_rays(there.tree, rays, any_hit, threads))

    def all_hits(self, rays: RayArguments, max_hits: int | None, rule: int, threads: int) -> AllHits:
        return find_all(self.trees, self._checked(rays), rays.cull_faces, rule, max_hits, threads)

    def count_hits(self, rays: RayArguments, rule: int, threads: int) -> NDArray[np.int64]:
        return count_all(self.trees, self._checked(rays), rays.cull_faces, rule, threads)

    def bodies(self, time: float) -> Bodies:
        """The surfaces of all copies. They are flattened if meshes, or copies in one place, have faces twice."""
        if self._bodies is None:
            self._bodies = self._find_bodies()
        return self._bodies._replace(time=time)

    def _find_bodies(self) -> Bodies:
        instances, open_edges = self.scene.instances, 0
        corners = [mesh.positions[mesh.faces] for mesh in instances.meshes]
        place = np.unique(instances.matrices.reshape(-1, 12), axis=0, return_inverse=True)[1].reshape(-1)
        order = np.lexsort((instances.mesh, place))
        together = groupby(order.tolist(), key=place.tolist().__getitem__)
        for meshes, copies in Counter(tuple(instances.mesh[list(group)].tolist()) for _, group in together).items():
            surfaces = closed_surfaces(np.concatenate([corners[k] for k in meshes]))
            if surfaces.once is not None:
                return RayLists(self.scene.flattened(), self._shared.flat(), self.threads).bodies(0.0)
            open_edges += copies * surfaces.open_edges
        return Bodies(self.bounds, open_edges, lambda rays, threads: self.count_hits(rays, INSIDE, threads), 0.0)

    def closest_points(self, points: NDArray[np.float32], time: float, threads: int) -> ClosestPoints:
        """Those of the flattened scene, since copies may be scaled and sheared."""
        return self._shared.flat_lists(self.threads).closest_points(points, time, threads)

    def _checked(self, rays: RayArguments) -> RayArrays:
        """The rays as arrays. Raises InputError for the first invalid one; compiles kernels."""
        self.warm_up()
        arrays = rays.arrays()
        arrays.check()
        return arrays
