"""Part residency on a device: its memory is a cache of the trees of parts [Mattausch et al. 2015, Sec. 5.4].

Parts that are on the device are traced first. The others follow in the order of the query pairs: they come to the
memory of the host, are queried once more, and are uploaded if a ray still needs them. The least recently used part is
evicted first.
"""

from collections import OrderedDict
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.memory import readable_size
from ...bvh.block_tree import BlockTree
from ...bvh.compact_tree import bvh_of, compacted
from ...bvh.nodes import Bvh
from ...devices.device import Device, OutOfDeviceMemory
from ...trace.device.device_tree import tree_bytes
from ...trace.device.part_trees import PartTree, part_tree
from ...trace.device.tree_list_kernels import TREE_WORDS
from .tree_parts import Mark, PartMemory

_PORTION = 16  # parts uploaded and traced together: segments that they block need none of the parts behind
_AHEAD = 4 * _PORTION  # parts that are read, at most, before rays have been traced through those in front of them


class DeviceTraffic(NamedTuple):
    """Counts of parts requested on a device and uploaded, as in Table 3 of the paper."""

    wanted: int  # requests for parts
    kept: int  # requests for parts that were there
    uploaded: int  # parts uploaded
    evicted: int  # parts evicted
    bytes: int  # bytes of parts uploaded
    bvh_bytes: int  # bytes of nodes among them; the rest are triangles


class DeviceResidency:
    """The parts of a scene on a device: a `PartMemory` on top of another one, from which it uploads.

    device : Device
    host : PartMemory
        Brings parts to the memory of the host.
    tree_of : function of a part
        Its tree, while it is in the memory of the host.
    parts : int
        Number of parts.
    budget : int
        Limit in bytes on the parts on the device. It may change between frames.

    Attributes
    ----------
    trees : (parts, TREE_WORDS) int64
        Rows of the table of trees; valid only for parts on the device.
    traced : (parts,) bool
        The parts that were traced since `begin_band`.
    returned : int
        Bytes of parts that were traced, evicted and uploaded again since then.
    """

    def __init__(
        self, device: Device, host: PartMemory, tree_of: Callable[[int], BlockTree], parts: int, budget: int
    ) -> None:
        self.device, self.budget, self._host, self._tree_of = device, budget, host, tree_of
        self.trees = np.zeros((parts, TREE_WORDS), np.int64)
        self.traffic = DeviceTraffic(0, 0, 0, 0, 0, 0)
        self.used = 0
        self.traced, self.returned = np.zeros(parts, np.bool_), 0
        self._parts: OrderedDict[int, PartTree] = OrderedDict()  # the next part to evict comes first
        self._pinned: set[int] = set()  # those that are being traced

    def __contains__(self, k: int) -> bool:
        return k in self._parts

    @property
    def loaded(self) -> int:
        """Bytes of all parts uploaded."""
        return self.traffic.bytes

    def begin_band(self) -> None:
        """Start a band of rows of an image."""
        self.traced[:], self.returned = False, 0

    def begin_question(self) -> None:
        """Start a tracing call."""
        self._host.begin_question()

    def groups(
        self, parts: NDArray[np.int32], still: Callable[[NDArray[np.int64]], NDArray[np.bool_]], mark: Mark | None
    ) -> Generator[NDArray[np.int64], None, None]:
        """Yield these parts in groups, those on the device first; see `PartMemory.groups`.

        Raises
        ------
        OutOfDeviceMemory
            If a part exceeds the budget, or the device has no room for it.
        """
        here = np.array([k for k in parts.tolist() if k in self._parts], np.int64)
        self._count(wanted=len(parts), kept=len(here))
        try:
            if len(here):
                self._pinned, self.traced[here] = set(here.tolist()), True
                yield here
                for k in here.tolist():
                    self._parts.move_to_end(k)
            for some in self._next_missing(parts):
                needed = some[still(some)].astype(np.int32)
                if not len(needed):
                    continue
                with closing(self._host.groups(needed, still, mark)) as groups:
                    for group in groups:
                        for first in range(0, len(group), _PORTION):
                            portion = np.asarray(group[first : first + _PORTION], np.int64)
                            yield from self._uploaded(portion[still(portion)])
        finally:
            self._pinned = set()

    def _next_missing(self, parts: NDArray[np.int32]) -> Iterator[NDArray[np.int64]]:
        """Yield the parts that are not on the device, a few at a time: first those in the memory of the host.

        The host reads as far ahead as its memory allows, so with all parts at a time, it would read most of them
        before rays have been traced through the first ones: in a street, four times as many as are uploaded.
        """
        missing = [k for k in parts.tolist() if k not in self._parts]
        ordered = np.array(sorted(missing, key=lambda k: k not in self._host), np.int64)
        first, end = 0, sum(k in self._host for k in missing) + _AHEAD
        while first < len(ordered):
            yield ordered[first:end]
            first, end = end, end + _AHEAD

    def trim(self) -> None:
        """Evict parts until the rest fit in the budget."""
        self.evict(self.used - self.budget)

    def evict(self, size: int) -> bool:
        """Evict the least recently used parts, except those that are being traced, until `size` bytes are free.

        Returns whether any part was evicted.
        """
        left = size
        for k in [each for each in self._parts if each not in self._pinned]:
            if left <= 0:
                break
            left -= self._parts[k].bytes
            self._evict(k)
        return left < size

    def close(self) -> None:
        """Evict all parts."""
        for k in list(self._parts):
            self._evict(k)

    def _uploaded(self, portion: NDArray[np.int64]) -> Generator[NDArray[np.int64], None, None]:
        """Upload parts, and yield them in groups that fit beside what else is on the device."""
        group: list[int] = []
        for k in portion.tolist():
            bvh, self._pinned = bvh_of(compacted(self._tree_of(k))), set(group)
            tree = self._upload(bvh)
            if tree is None:
                yield np.array(group)
                group, self._pinned = [], set()
                tree = self._upload(bvh)
            assert tree is not None  # parts that are not being traced leave, or an error is raised
            self._add(k, tree)
            group.append(k)
        self._pinned = set(group)
        if group:
            yield np.array(group)

    def _upload(self, bvh: Bvh) -> PartTree | None:
        """Upload a tree, for which the least recently used parts leave. None: those that are being traced must leave.

        Others may have taken memory of the device, so that it has less than the budget.
        """
        size = tree_bytes(bvh)
        if size > self.budget:
            message = (
                f"a part of the scene needs {readable_size(size)} of memory on {self.device}, and parts may take "
                f"{readable_size(self.budget)} there; build the store with smaller chunks, or compute on the CPU"
            )
            raise OutOfDeviceMemory(message, size, self.budget)
        self.evict(self.used + size - self.budget)
        while self.used + size <= self.budget:
            try:
                return part_tree(bvh, self.device)
            except OutOfDeviceMemory as full:
                if self.evict(max(full.needed - full.left, 1)):  # 1: what is free may be in pieces
                    continue
                if not self._pinned:
                    raise
                break
        return None

    def _add(self, k: int, tree: PartTree) -> None:
        self._parts[k], self.trees[k] = tree, tree.row
        self.returned += tree.bytes if self.traced[k] else 0
        self.traced[k] = True
        self.used += tree.bytes
        self._count(uploaded=1, bytes=tree.bytes, bvh_bytes=tree.bvh_bytes)

    def _evict(self, k: int) -> None:
        tree = self._parts.pop(k)
        self.used -= tree.bytes
        self.trees[k] = 0
        tree.memory.free()
        self._count(evicted=1)

    def _count(self, **increments: int) -> None:
        traffic = {name: getattr(self.traffic, name) + n for name, n in increments.items()}
        self.traffic = self.traffic._replace(**traffic)
