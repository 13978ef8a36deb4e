"""Scenes of instances on a device: the trees of meshes and of copies there, and the tracer that walks them.

The kernels are in `instance_kernels`. Copies are never flattened: a mesh takes about 190 bytes per triangle, and a copy
about 300 bytes. The bits are those of flattened copies. The CPU traces the rays that float64 leaves undecided.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...bvh.instance_trees import (
    REACH,
    InstanceTrees,
    MeshTree,
    instance_pointers,
)
from ...devices.device import DeviceMemory
from ...kernels.exact.filters import rounded_t, single_weights
from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import get, stack_f32, stack_f64, stack_i64
from ...query.ray_list import HitArrays, RayArguments, hit_arrays
from ...query.shadow_query import ShadowQuery
from ...scene.camera import CameraRays
from ..rays.instance_traversal import BEST, HIT_FLOATS, HIT_IDS, TESTED, InstanceHit, InstanceQuery, walk_instances
from . import settling
from .device_kernels import HitBuffers
from .device_launches import DeviceLaunches
from .device_rays import BLOCKED, CLEAR, TRACED
from .device_stages import CHUNK, Chunk
from .device_surfaces import parts_of, rays_of_pixels
from .device_tracer import DeviceTracer, words_of
from .device_traversal import TreeBuffers
from .device_tree import device_triangles, reach_of_root
from .instance_kernels import ForestBuffers, Part

_CHUNK = 64

# --- What the CPU decides ---------------------------------------------------------------------------------------------


class _Rest(NamedTuple):
    """Rays that the CPU traces."""

    records: settling.Records
    heads: NDArray[np.int32]  # (m, 4), see `heads_of`
    cull_faces: int
    any_hit: bool


@kernel
def _trace_rest(ticket, rest, arrays, hits):
    # In: rest, arrays (InstanceArrays). Out: hits (HitArrays; face, and for nearest hits t, u and v)
    scene = instance_pointers(arrays)
    hit = InstanceHit(stack_f32(HIT_FLOATS), TESTED, BEST, stack_f64(1), stack_i64(HIT_IDS))
    for k in items(ticket):
        ray = settling.ray_of(rest.records, k)
        query = InstanceQuery(np.int64(rest.heads[k, settling.SKIP]), np.int64(rest.cull_faces), rest.any_hit)
        walk_instances(scene, ray, query, hit, None)
        hits.face[k] = get(hit.ids, 0)
        if not rest.any_hit and hits.face[k] >= 0:
            hits.t[k] = rounded_t(ray, hit.corners, BEST)
            hits.u[k], hits.v[k] = single_weights(ray, hit.corners, BEST)


def traced_rays(
    records: settling.Records, trees: InstanceTrees, cull_faces: int, any_hit: bool, threads: int
) -> HitArrays:
    """The hits of recorded rays. face is -1 on a miss, also for any hit; t, u and v are those of nearest hits."""
    hits, ticket = hit_arrays(len(records), False), new_ticket(len(records), _CHUNK)
    hits.t.fill(np.inf)
    hits.u.fill(0.0)
    hits.v.fill(0.0)
    rest = _Rest(records, settling.heads_of(records), cull_faces, any_hit)
    run(_trace_rest, threads, ticket, rest, trees.arrays, hits)
    return hits


# --- Uploads ----------------------------------------------------------------------------------------------------


def _arrays_of(tree: MeshTree) -> list[NDArray[Any]]:
    """The arrays of a mesh on a device, in the order of its words: by slots of its binary tree instead of lanes."""
    bvh, slots = tree.wide.bvh, tree.wide.slots.reshape(-1)
    lanes = np.zeros(len(bvh.prim_ids), np.int64)
    lanes[slots[slots >= 0]] = np.flatnonzero(slots >= 0)
    corners, ids = tree.corners[lanes], tree.ids[lanes]
    relative = (corners.reshape(-1, 3) - tree.centre).astype(np.float32).reshape(-1, 9)
    triangles = device_triangles(bvh._replace(prim_ids=ids, corners=relative))
    return [bvh.nodes, triangles, corners, ids, tree.part[lanes], np.array([max(tree.wide.reach)], np.float32)]


class DeviceForest:
    """The trees of a scene of instances on a device.

    Raises
    ------
    OutOfDeviceMemory
        If they do not fit.
    """

    def __init__(self, trees: InstanceTrees, launches: DeviceLaunches) -> None:
        self.trees, self._launches, self._memory = trees, launches, list[DeviceMemory]()
        arrays, top, words = trees.arrays, trees.top, np.zeros_like(trees.arrays.meshes)
        for k, tree in trees.meshes.items():
            words[k, : REACH + 1] = [self._sent(each) for each in _arrays_of(tree)]
        nodes, copies = self._sent(top.nodes), self._sent(top.prim_ids)
        self.buffers = ForestBuffers(
            TreeBuffers(nodes, 0, reach_of_root(top.nodes[0])),
            copies,
            self._sent(words),
            self._sent(arrays.mesh),
            self._sent(arrays.matrices),
            self._sent(arrays.maps),
            self._sent(arrays.rows),
            self._sent(arrays.starts),
            self._sent(arrays.origin),
        )

    def _sent(self, array: NDArray[Any]) -> int:
        self._memory.append(self._launches.device.upload(np.ascontiguousarray(array), "the trees of the instances"))
        return self._memory[-1].address


# --- Queries ----------------------------------------------------------------------------------------------------------


class ForestTracer:
    """Traces rays and shadow queries through a `DeviceForest`, as `DeviceTracer` does through a tree.

    tracer : DeviceTracer
        Of the device. Its lock is held by every call.

    Attributes
    ----------
    on_cpu : int
        Number of rays so far that the CPU has traced.
    """

    def __init__(self, tracer: DeviceTracer) -> None:
        self._tracer, self.launches, self.lock, self.on_cpu = tracer, tracer.launches, tracer.lock, 0

    def forest(self, trees: InstanceTrees) -> DeviceForest:
        """The trees of a scene, uploaded. OutOfDeviceMemory if they do not fit."""
        with self.lock:
            return DeviceForest(trees, self.launches)

    def trace_rays(self, forest: DeviceForest, rays: RayArguments, any_hit: bool, threads: int) -> HitArrays:
        """The hits of valid rays."""
        arrays, out = rays.arrays(), hit_arrays(rays.n, any_hit)
        with self.lock:
            for first in range(0, rays.n, CHUNK):
                part = slice(first, min(first + CHUNK, rays.n))
                n = part.stop - first
                chunk = self._tracer.chunk_of(arrays.part(part), rays, any_hit)
                if any_hit:
                    self._block(forest, chunk, "block_by_copies", threads)
                    out.blocked[part] = np.unpackbits(self._tracer.bits(chunk, n), count=n, bitorder="little")
                else:
                    self._find_nearest(forest, chunk, HitArrays(*(a[part] if len(a) else a for a in out)), threads)
        return out

    def trace_pixels(self, forest: DeviceForest, rays: CameraRays, rows: slice, threads: int) -> HitArrays:
        """The nearest hits of the pixels of some rows of a perspective camera."""
        start, out = rows.start * rays.width, hit_arrays((rows.stop - rows.start) * rays.width, False)
        with self.lock:
            for pixels in parts_of(rays, rows):
                first, n = pixels.first - start, pixels.n
                chunk = self._tracer.chunk_in(rays_of_pixels(pixels, self.launches), n, 0, False)
                here = HitArrays(*(a[first : first + n] if len(a) else a for a in out))
                self._find_nearest(forest, chunk, here, threads)
        return out

    def trace_shadow(
        self,
        forest: DeviceForest,
        query: ShadowQuery,
        bits: NDArray[np.uint64],
        threads: int,
        progress: ProgressCallback | None = None,
    ) -> None:
        """Set bit s of ``bits[y, x]`` where sample s of a `ShadowQuery` is occluded."""
        spp, words = query.samples.shape[1], bits.reshape(-1, bits.shape[-1])
        with self.lock:
            for chunk, rows in self._tracer.parts(query, max(CHUNK // spp, 1), threads):
                self._block(forest, chunk, "block_samples_by_copies", threads)
                words[rows] |= words_of(self._tracer.bits(chunk, chunk.work.n), len(words[rows]), spp)
                if progress is not None:
                    progress(rows.stop, len(words))

    def _block(self, forest: DeviceForest, chunk: Chunk, name: str, threads: int) -> None:
        """Write the states of a chunk of rays."""
        work = chunk.work

        def arguments(first: int, n: int) -> tuple[Any, ...]:
            return forest.buffers, chunk.rays, work, Part(first, n)

        for records in self.launches.left_over(name, arguments, work):
            heads = settling.heads_of(records)
            self.on_cpu += len(records)
            blocked = traced_rays(records, forest.trees, work.cull_faces, True, threads).face >= 0
            blocked &= heads[:, settling.STATE] == TRACED
            if chunk.query is not None:
                numbers = work.first + heads[:, settling.RAY].astype(np.int64)
                blocked |= settling.below_horizon(numbers, chunk.query, threads)
            self.launches.mark(work.out, heads[:, settling.RAY], np.where(blocked, BLOCKED, CLEAR))

    def _find_nearest(self, forest: DeviceForest, chunk: Chunk, out: HitArrays, threads: int) -> None:
        """Write the nearest hits of a chunk of rays to arrays on the host."""
        arrays, rest = dict(zip(HitBuffers._fields, out[1:])), list[tuple[NDArray[np.int32], HitArrays]]()
        blocks = {name: self.launches.block(name, each.nbytes, "the hits") for name, each in arrays.items()}
        hits = HitBuffers(*(each.address for each in blocks.values()))

        def arguments(first: int, n: int) -> tuple[Any, ...]:
            return forest.buffers, chunk.rays, chunk.work, hits, Part(first, n)

        for records in self.launches.left_over("nearest_in_copies", arguments, chunk.work):
            self.on_cpu += len(records)
            found = traced_rays(records, forest.trees, chunk.work.cull_faces, False, threads)
            rest.append((settling.heads_of(records)[:, settling.RAY], found))
        for name, block in blocks.items():
            block.read(arrays[name])
        for rays, found in rest:
            for array, numbers in zip(out[1:], found[1:]):
                array[rays] = numbers
