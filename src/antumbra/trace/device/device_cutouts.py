"""Cut-outs on a device: uploaded once, and traced after the solid triangles, with the bits of `trace.alpha_cutouts`.

The kernels are in `cutout_kernels`. A ray that float64 leaves undecided is traced through the cut-outs by the CPU,
which sends its answer.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import LEFT_FIRST, Bvh, tree_of
from ...devices.device import DeviceMemory
from ...kernels.exact.filters import comes_first, rounded_t
from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import get, ptr, put, stack_i32
from ...scene.alpha_masks import DARK
from ..alpha_cutouts import CutoutTree, DepthSum, sum_depths, texel_pointers
from ..rays.ray_traversal import CLOSEST, walk
from ..transmission import POWERS
from .cutout_kernels import KEPT, SUMS, CutoutBuffers, CutoutWork, ShareBuffers
from .device_kernels import HitBuffers
from .device_launches import DeviceLaunches
from .device_rays import BLOCKED, CLEAR, RayBuffers, SampleBuffers
from .device_traversal import Work
from .device_tree import DeviceTree, UploadedTree
from .settling import BEST, RAY, SKIP, Records, heads_of, ray_of

_CHUNK = 64

# --- What the CPU decides ---------------------------------------------------------------------------------------------


class _CutoutRecords(NamedTuple):
    """Rays that the CPU traces through the cut-outs."""

    records: Records
    heads: NDArray[np.int32]  # (m, 4), see `heads_of`
    cull_faces: int


@kernel
def _find_blocked(ticket, rest, bvh, texels, blocked):
    # In: rest; bvh and texels of the cut-outs. Out: blocked, by texels that closest hits meet
    tree, holes, order = tree_of(bvh), texel_pointers(texels), np.int64(LEFT_FIRST)
    for k in items(ticket):
        skip = np.int64(rest.heads[k, SKIP])
        blocked[k] = walk(tree, ray_of(rest.records, k), skip, rest.cull_faces, order, holes, None)[0] >= 0


@kernel
def _add_depths(ticket, rest, bvh, texels, sums):
    # In: rest; bvh and texels of the cut-outs. Out: sums (m, SUMS)
    tree, depth, out = tree_of(bvh), DepthSum(texel_pointers(texels), stack_i32(3)), ptr(sums)
    for k in items(ticket):
        ray, skip = ray_of(rest.records, k), np.int64(rest.heads[k, SKIP])
        sum_depths(tree, depth, ray, skip, rest.cull_faces)
        for c in range(3):
            put(out, SUMS * k + c, get(depth.sums, c))
        slot = walk(tree, ray, skip, rest.cull_faces, np.int64(LEFT_FIRST), None, None)[0]
        put(out, SUMS * k + 3, np.int64(slot >= 0))


@kernel
def _find_first(ticket, rest, bvh, texels, solid, found):
    # In: rest; bvh and texels of the cut-outs; solid: the Bvh of other triangles. Out: found: slots, or KEPT
    tree, triangles, holes = tree_of(bvh), tree_of(solid), texel_pointers(texels)
    for k in items(ticket):
        ray, best = ray_of(rest.records, k), np.int64(rest.heads[k, BEST])
        slot, t = walk(tree, ray, np.int64(rest.heads[k, SKIP]), rest.cull_faces, np.int64(CLOSEST), holes, None)
        if slot >= 0 and best >= 0:
            prim, other = np.int64(get(tree.prim_ids, slot)), np.int64(get(triangles.prim_ids, best))
            best_t = rounded_t(ray, triangles.corners, best)
            if not comes_first(ray, tree.corners, slot, prim, t, triangles.corners, best, other, best_t):
                slot = -1
        found[k] = slot if slot >= 0 else KEPT


def _records_of(records: Records, cull_faces: int) -> _CutoutRecords:
    return _CutoutRecords(records, heads_of(records), cull_faces)


def blocked_by_texels(records: Records, cutouts: CutoutTree, cull_faces: int, threads: int) -> NDArray[np.bool_]:
    """(m,) bool: whether texels block recorded rays that closest hits meet."""
    blocked, ticket = np.empty(len(records), np.bool_), new_ticket(len(records), _CHUNK)
    run(_find_blocked, threads, ticket, _records_of(records, cull_faces), cutouts.bvh, cutouts.texels, blocked)
    return blocked


def depths_along(records: Records, cutouts: CutoutTree, cull_faces: int, threads: int) -> NDArray[np.int32]:
    """(m, SUMS) int32: the depths along recorded rays, and 1 for each that meets a cut-out."""
    sums, ticket = np.empty((len(records), SUMS), np.int32), new_ticket(len(records), _CHUNK)
    run(_add_depths, threads, ticket, _records_of(records, cull_faces), cutouts.bvh, cutouts.texels, sums)
    return sums


def first_cutouts(
    records: Records, cutouts: CutoutTree, solid: Bvh, cull_faces: int, threads: int
) -> NDArray[np.int32]:
    """(m,) int32: slots of the cut-outs that recorded rays hit first; KEPT if a triangle of `solid`, or none, is."""
    found, ticket = np.empty(len(records), np.int32), new_ticket(len(records), _CHUNK)
    run(_find_first, threads, ticket, _records_of(records, cull_faces), cutouts.bvh, cutouts.texels, solid, found)
    return found


# --- On the device ----------------------------------------------------------------------------------------------------


class _Uploaded(NamedTuple):
    """Cut-outs on a device."""

    bvh: Bvh  # from which they were uploaded
    tree: UploadedTree
    arrays: list[tuple[NDArray[Any], DeviceMemory]]  # all of `AlphaTexels` but the depths, on the host and there


class SampleDepths(NamedTuple):
    """The depths along the segments of a part of a shadow query, on the device."""

    work: Work
    part: CutoutWork
    spp: int


class DeviceCutouts:
    """Traces rays against the cut-outs of a scene on a device. The latest ones stay there. Not thread-safe."""

    def __init__(self, launches: DeviceLaunches) -> None:
        self.launches = launches
        self.on_cpu = 0  # rays so far that the CPU has traced
        self._uploaded: _Uploaded | None = None

    def _buffers(self, cutouts: CutoutTree) -> CutoutBuffers:
        """The cut-outs on the device. Depths, which depend on the month, are sent each time.

        If faces have moved, their masks stay there.
        """
        kept, device, texels = self._uploaded, self.launches.device, cutouts.texels
        if kept is None or kept.bvh is not cutouts.bvh:
            there = [] if kept is None else kept.arrays
            same = [next((memory for array, memory in there if array is each), None) for each in texels[:-1]]
            self._uploaded = kept = None  # there may be no room for both
            del there
            arrays = [
                (each, device.upload(np.ascontiguousarray(each), "the alpha masks") if memory is None else memory)
                for each, memory in zip(texels[:-1], same)
            ]
            kept = self._uploaded = _Uploaded(cutouts.bvh, UploadedTree(cutouts.bvh, self.launches), arrays)
        depths = self.launches.sent("depths", np.ascontiguousarray(texels.depths), "the alpha masks")
        uv, mask, shapes, first, words, rows = (memory.address for _, memory in kept.arrays)
        return CutoutBuffers(kept.tree.buffers, uv, mask, shapes, first, words, rows, depths)

    def tree(self, cutouts: CutoutTree) -> UploadedTree:
        """The tree of the latest cut-outs."""
        assert self._uploaded is not None and self._uploaded.bvh is cutouts.bvh
        return self._uploaded.tree

    def block(self, cutouts: CutoutTree, rays: RayBuffers, work: Work, threads: int) -> None:
        """Change the states of rays in `work.out` to BLOCKED where texels block them that closest hits meet."""
        buffers = self._buffers(cutouts)
        for records in self.launches.left_over(
            "block_rays", lambda first, n: (buffers, rays, work, CutoutWork(first, n)), work
        ):
            self.on_cpu += len(records)
            rows = heads_of(records)[blocked_by_texels(records, cutouts, work.cull_faces, threads), RAY]
            self.launches.mark(work.out, rows, np.full(len(rows), BLOCKED))

    def nearest(
        self, cutouts: CutoutTree, solid: DeviceTree, rays: RayBuffers, work: Work, hits: HitBuffers, threads: int
    ) -> Work:
        """The work whose answers are the slots of the cut-outs that rays hit first; KEPT where that is none.

        work, hits : the slots and numbers of the solid triangles
        """
        buffers = self._buffers(cutouts)
        found = self.launches.block("cut-out hits", 4 * work.n, "the hits on cut-outs").address

        def arguments(first: int, n: int) -> tuple[Any, ...]:
            return solid.buffers, buffers, rays, work, hits, CutoutWork(first, n, found)

        for records in self.launches.left_over("nearest_cutouts", arguments, work):
            self.on_cpu += len(records)
            slots = first_cutouts(records, cutouts, solid.bvh, work.cull_faces, threads)
            self.launches.mark(found, heads_of(records)[:, RAY], slots)
        return work._replace(out=found)

    def sum_depths(
        self,
        cutouts: CutoutTree,
        samples: SampleBuffers,
        work: Work,
        bits: NDArray[np.uint64],
        keep: bool,
        threads: int,
    ) -> SampleDepths:
        """Add up the depths along the segments of receivers.

        bits : (n, ceil(spp / 64)) uint64, of these receivers: samples that are known to be dark
        keep : whether the sums are kept on the device, and states tell which lit samples meet a cut-out; otherwise,
            states tell which samples cut-outs darken
        """
        buffers, words = self._buffers(cutouts), 2 * bits.shape[1]
        occluded = self.launches.sent("known bits", np.ascontiguousarray(bits), "the bits of the samples")
        sums = self.launches.block("sums", 4 * SUMS * work.n, "the depths of cut-outs").address if keep else 0
        part = CutoutWork(0, work.n, 0, occluded, words, sums)

        def arguments(first: int, n: int) -> tuple[Any, ...]:
            return buffers, samples, work, part._replace(first=first, n=n)

        for records in self.launches.left_over("sum_depths_of_samples", arguments, work):
            self.on_cpu += len(records)
            rays, depths = heads_of(records)[:, RAY], depths_along(records, cutouts, work.cull_faces, threads)
            state = depths[:, 3] > 0 if keep else (depths[:, :3] > DARK).all(1)
            self.launches.mark(work.out, rays, np.where(state, BLOCKED, CLEAR))
            if keep:
                places = SUMS * rays.astype(np.int64)[:, None] + np.arange(SUMS)
                self.launches.mark(sums, places.reshape(-1), depths.reshape(-1))
        return SampleDepths(work, part, samples.spp)

    def shares(self, depths: SampleDepths, receivers: NDArray[np.int64], channels: int) -> NDArray[np.float32]:
        """(k, spp, channels) float32: the transmittances of the samples of some receivers, with sums that were kept."""
        send, values = self.launches.sent, np.empty((len(receivers), depths.spp, channels), np.float32)
        out = self.launches.block("shares", values.nbytes, "the transmittances of samples")
        buffers = ShareBuffers(
            send("which", receivers.astype(np.int32), "the receivers"),
            len(receivers),
            depths.spp,
            channels,
            depths.part.occluded,
            depths.part.words,
            depths.part.sums,
            send("powers", POWERS, "the transmittances of depths"),
            out.address,
        )
        self.launches.launch("write_shares", (buffers,), values.size)
        return out.read(values)
