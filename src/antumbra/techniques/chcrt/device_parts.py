"""Shadow segments of CHC+RT on a device: the same ray sets, queries and fronts, but their pairs are traced there.

The CPU answers the queries and keeps the fronts. Rays, their blocked bits and the trees of parts are on the device. A
segment ends at the first triangle that blocks it, and its later pairs are skipped, because each call lists only tiles
and parts that open segments still need.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...query.receivers import NOTHING
from ...trace.counters import RAYS
from ...trace.device.tree_list_tracer import TiledTracer, TileLayout, TreeLists, set_bits
from ..tracer_options import ChcRtOptions
from .picture_ray_sets import SegmentRaySets, SegmentStep
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


class DeviceSegmentSets(SegmentRaySets):
    """`SegmentRaySets` on a device."""

    def __init__(
        self, there: OnDeviceParts, options: ChcRtOptions, step: SegmentStep, bits: NDArray[np.uint64], *arguments: Any
    ):
        super().__init__(there.parts, options, step, bits, *arguments)
        self._tracer = there.tracer
        self._layout = TileLayout(self.tiles.pixels, self.tiles.across, self.segments.first, self.segments.n_samples)
        # Uploaded at once: parts leave for it while none is being traced.
        self._tiled = self._tracer.query(self.query, self._layout, self.threads)

    def block(self, lists: Lists, tiles: NDArray[np.int32]) -> NDArray[np.int32]:
        if self._tiled.fresh and self.counters is not None:
            self.counters[RAYS] += np.count_nonzero(self.query.sides != NOTHING) * self._layout.count
        rows, items = np.unique(lists.items, return_inverse=True)
        there = TreeLists(self.parts.trees[rows], lists.starts, items.astype(np.int32), self.sets)
        words, blockers = self._tracer.trace_tiles(self._tiled, tiles, there, self.threads)
        set_bits(self.bits, self._layout, tiles, words)
        return blockers
