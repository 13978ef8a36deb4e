"""Rays of CHC+RT on a device: the same ray sets, queries and fronts, but their pairs are traced there.

The CPU answers the queries and keeps the fronts. Rays, what is known of them and the trees of parts are on the device.
A segment ends at the first triangle that blocks it, and its later pairs are skipped, because each call lists only tiles
and parts that open segments still need. Of nearest-hit rays, each call returns the new hits.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...query.receivers import NOTHING
from ...scene.camera import CameraRays
from ...trace.counters import RAYS
from ...trace.device.nearest_list_tracer import RayGrid, RayVectors, TiledRays
from ...trace.device.tree_list_tracer import TiledTracer, TileLayout, TreeLists, set_bits
from ..tracer_options import ChcRtOptions
from .picture_ray_sets import CameraRaySet, HitRays, PassRaySet, SegmentRaySets, SegmentStep
from .ray_bundles import PassRays, shorten_pass
from .tree_parts import Lists, TreeParts


class OnDeviceParts(NamedTuple):
    """Parts in the memory of a device, and the tracer there."""

    tracer: TiledTracer
    parts: TreeParts  # their `memory` is a `DeviceResidency`, and `trees` are rows of its table

    def segments(
        self, options: ChcRtOptions, step: SegmentStep, bits: NDArray[np.uint64], *arguments: Any
    ) -> "DeviceSegmentSets":
        """The ray sets of a step; arguments: those of `SegmentRaySets` after the bits."""
        return DeviceSegmentSets(self, options, step, bits, *arguments)

    def passes(self, options: ChcRtOptions, rays: PassRays, threads: int) -> "DevicePassSet":
        """The ray set of nearest-hit rays. OutOfDeviceMemory if they do not fit."""
        return DevicePassSet(self, options, rays, threads)

    def camera(
        self, options: ChcRtOptions, camera: CameraRays, rows: slice, reach: float, threads: int
    ) -> "DeviceCameraSet":
        """The ray set of a camera. OutOfDeviceMemory if it does not fit."""
        return DeviceCameraSet(self, options, camera, rows, reach, threads)

    def free_blocks(self) -> None:
        """Free what the device keeps for further calls besides parts."""
        with self.tracer.lock:
            self.tracer.launches.free_blocks()

    def tree_lists(self, lists: Lists, sets: int) -> tuple[TreeLists, NDArray[np.int32]]:
        """Lists of parts as lists of trees on the device, and the part that each row of their table is."""
        rows, items = np.unique(lists.items, return_inverse=True)
        return TreeLists(self.parts.trees[rows], lists.starts, items.astype(np.int32), sets), rows


class DeviceSegmentSets(SegmentRaySets):
    """`SegmentRaySets` on a device."""

    def __init__(
        self, there: OnDeviceParts, options: ChcRtOptions, step: SegmentStep, bits: NDArray[np.uint64], *arguments: Any
    ):
        super().__init__(there.parts, options, step, bits, *arguments)
        self._there, self._tracer = there, there.tracer
        self._layout = TileLayout(self.tiles.pixels, self.tiles.across, self.segments.first, self.segments.n_samples)
        # Uploaded at once: parts leave for it while none is being traced.
        self._tiled = self._tracer.query(self.query, self._layout, self.threads)

    def block(self, lists: Lists, tiles: NDArray[np.int32]) -> NDArray[np.int32]:
        if self._tiled.fresh and self.counters is not None:
            self.counters[RAYS] += np.count_nonzero(self.query.sides != NOTHING) * self._layout.count
        words, blockers = self._tracer.trace_tiles(
            self._tiled, tiles, self._there.tree_lists(lists, self.sets)[0], self.threads
        )
        set_bits(self.bits, self._layout, tiles, words)
        return blockers


class DevicePassSet(PassRaySet):
    """`PassRaySet` of nearest-hit rays on a device."""

    def __init__(self, there: OnDeviceParts, options: ChcRtOptions, rays: PassRays, threads: int):
        super().__init__(there.parts, options, rays, threads)
        assert not rays.any_hit
        vectors = RayVectors(rays.origins, rays.directions, rays.skip, rays.spans, rays.cull_faces)
        self._there, self._rays = there, _on_tiles(there, self, slice(0, rays.skip.shape[0]), vectors)

    def find(self, lists: Lists) -> None:
        self._rays.trace_nearest(lists.tiles, *self._there.tree_lists(lists, 1), self.threads)
        rays = self.rays
        shorten_pass(rays.cells[0], self.tiles.spans, lists.tiles, rays.picture, self.pass_, self.threads)


class DeviceCameraSet(CameraRaySet):
    """`CameraRaySet` on a device. The signed t of hits is always known."""

    marker = HitRays.marker  # type: ignore[assignment]
    sign = HitRays.sign

    def __init__(
        self, there: OnDeviceParts, options: ChcRtOptions, camera: CameraRays, rows: slice, reach: float, threads: int
    ):
        super().__init__(there.parts, options, camera, rows, reach, threads)
        self._there, self._rays = there, _on_tiles(there, self, rows, camera)

    def find(self, lists: Lists) -> None:
        self._rays.trace_nearest(lists.tiles, *self._there.tree_lists(lists, 1), self.threads)


def _on_tiles(there: OnDeviceParts, rays: HitRays, rows: slice, vectors: RayVectors | CameraRays) -> TiledRays:
    """The rays of a set on the device."""
    grid = RayGrid(rays.tiles.pixels, rays.tiles.across, rays.hits.face.shape, rows)
    return TiledRays(there.tracer, grid, vectors, rays.hits)
