"""The stages of tracing on a device: float32 there, float64 there for undecided tests, the exact predicate on the CPU.

Rays are traced a chunk at a time. If the list of undecided tests fills up, the rays that found it full are traced
again, fewer at a time; if that hardly gets on, the CPU traces them.
"""

import threading
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.forks import renew_after_fork
from ...devices.device import Device
from ...query.shadow_query import ShadowQuery
from . import settling
from .device_kernels import RECORD
from .device_launches import DeviceLaunches
from .device_rays import AGAIN, BLOCKED, CLEAR, TRACED, RayBuffers, SampleBuffers, TileSegments
from .device_traversal import COUNTS, PAIRS, PARTS, REST, VISITS, WON, Work
from .device_tree import DeviceTree
from .shaft_parts import parts_bytes, tiles_of

CHUNK = 1 << 24
"""Largest number of rays traced together."""


class Capacities(NamedTuple):
    """The sizes of a device's lists."""

    pairs: int = 1 << 20  # undecided tests
    records: int = 1 << 17  # tests for the CPU
    least: int = 1 << 12  # if fewer rays get done at a time, the CPU traces the others


CAPACITIES = Capacities()


class RayKind(NamedTuple):
    """The kernels of a kind of query, by name."""

    trace: str
    settle: str
    record: str
    any_hit: bool
    by_shafts: bool = False  # `trace` serves only what is traced again


ANY = RayKind("trace_any", "settle_any", "record_rays", True)
SAMPLES = RayKind("trace_samples", "settle_samples", "record_samples", True)
SHAFTS = SAMPLES._replace(by_shafts=True)
NEAREST = RayKind("trace_nearest", "settle_nearest", "record_rays", False)
LISTED = RayKind("trace_listed", "settle_listed", "record_listed", True)
"""Of `tree_list_tracer`."""


class Chunk(NamedTuple):
    """A chunk of rays that is being traced."""

    kind: RayKind
    rays: RayBuffers | SampleBuffers | TileSegments
    work: Work
    query: ShadowQuery | None  # for samples


class RayStages:
    """Traces chunks of rays on a device, one call at a time. It may be shared by Python threads.

    device : Device
    capacities : Capacities
        Small ones are for tests.

    Attributes
    ----------
    lock : RLock
        Held by every call.
    undecided, on_cpu : int
        The numbers of tests so far that float32 left to float64, and that float64 left to the CPU.
    visits : int
        The number of nodes so far that subgroups of shafts have visited.
    """

    def __init__(self, device: Device, capacities: Capacities = CAPACITIES) -> None:
        self.device, self._capacities, self.launches = device, capacities, DeviceLaunches(device)
        self.undecided = self.on_cpu = self.visits = 0
        self.lock = threading.RLock()
        renew_after_fork(self)

    def _after_fork(self) -> None:
        self.lock = threading.RLock()  # so that the error of a device in a child is raised

    def _work(self, first: int, n: int, cull_faces: int) -> Work:
        sizes, block = self._capacities, self.launches.block
        out = block("out", 4 * n, "the answers")
        counts = block("counts", 4 * COUNTS, "counts")
        pairs = block("pairs", 8 * sizes.pairs, "the list of undecided tests")
        rest = block("rest", 8 * RECORD * sizes.records, "the list of tests for the CPU")
        lists = pairs.address, sizes.pairs, rest.address, sizes.records
        return Work(first, n, 0, out.address, counts.address, *lists, cull_faces)

    def _read(self, name: str, shape: tuple[int, ...], dtype: type) -> NDArray[Any]:
        return self.launches.block(name, 0, "").read(np.empty(shape, dtype))

    def _counts(self) -> NDArray[np.int32]:
        return self._read("counts", (COUNTS,), np.int32)

    def _trace(self, tree: DeviceTree, chunk: Chunk, threads: int) -> None:
        """Trace a chunk of rays and decide all their tests. Their states or slots stay on the device."""
        waiting = self._round(tree, chunk, None, threads)
        at_once = 2 * (chunk.work.n - len(waiting))
        while len(waiting):
            if at_once < self._capacities.least:
                self._trace_on_cpu(tree, chunk, waiting, threads)
                return
            now, later = waiting[:at_once], waiting[at_once:]
            full = self._round(tree, chunk, now, threads)
            at_once, waiting = 2 * (len(now) - len(full)), np.concatenate([full, later])

    def _round(
        self, tree: DeviceTree, chunk: Chunk, which: NDArray[np.int32] | None, threads: int
    ) -> NDArray[np.int32]:
        """Trace some rays of a chunk, or all, and decide their tests. Return those that found the list full."""
        work, counts, n = chunk.work, self.launches.block("counts", 0, ""), chunk.work.n
        if which is not None:
            n = len(which)
            work = work._replace(which=self.launches.sent("which", which, "the rays"), n=n)
        counts.fill()
        if which is None and chunk.query is not None and chunk.kind.by_shafts:
            self._launch_shafts(tree, chunk, chunk.query)
        else:
            self.launches.launch(chunk.kind.trace, (tree.buffers, chunk.rays, work), n)
        pairs = int(self._counts()[PAIRS])
        self.undecided += min(pairs, work.capacity)
        self.settle(tree, chunk, min(pairs, work.capacity), threads)
        if pairs <= work.capacity:
            return np.empty(0, np.int32)
        states = self._read("out", (chunk.work.n,), np.int32)
        return np.flatnonzero(states == AGAIN).astype(np.int32) if which is None else which[states[which] == AGAIN]

    def _launch_shafts(self, tree: DeviceTree, chunk: Chunk, query: ShadowQuery) -> None:
        """Trace a chunk by shafts, once the parts of its tiles are listed."""
        work, spp = chunk.work, query.samples.shape[1]
        tiles = tiles_of(query, work.first // spp, work.n // spp)
        parts = self.launches.block("parts", parts_bytes(tiles), "the parts of tiles")
        tiles = tiles._replace(parts=parts.address)
        self.launches.launch("find_parts", (chunk.rays, work, tiles), tiles.n)
        tiles = tiles._replace(n=tiles.n + int(self._counts()[PARTS]))
        self.launches.block("out", 0, "").fill(size=4 * work.n)  # CLEAR, also where there is no receiver
        self.launches.launch("trace_shafts", (tree.buffers, chunk.rays, work, tiles), tiles.n * spp)
        self.visits += int(self._counts()[VISITS])

    def settle(self, tree: DeviceTree, chunk: Chunk, pairs: int, threads: int) -> None:
        """Decide the listed tests: in float64 on the device, and what is left on the CPU."""
        work, counts, begin, at_once = chunk.work, self.launches.block("counts", 0, ""), 0, pairs
        while begin < pairs:
            n = min(at_once, pairs - begin)
            counts.fill()
            self.launches.launch(chunk.kind.settle, (tree.buffers, chunk.rays, work, begin, n), n)
            counted = self._counts()
            left = int(counted[REST])
            if left > work.rest_capacity:
                at_once = work.rest_capacity
                continue
            if counted[WON]:
                continue
            self.on_cpu += left
            if left:
                self._decide(tree, chunk, self._read("rest", (left, RECORD), np.float64), threads)
            begin += n

    def _decide(self, tree: DeviceTree, chunk: Chunk, records: settling.Records, threads: int) -> None:
        """Decide tests on the CPU, and send the answers."""
        work, slots = chunk.work, settling.renumber(records)
        few = tree.some(slots)
        if chunk.kind.any_hit:
            rays = settling.blocked_rays(records, few, work.cull_faces, chunk.query, work.first, threads)
            self._mark(rays, np.full(len(rays), BLOCKED, np.int32))
        else:
            rays, found = settling.nearest_slots(records, few, work.cull_faces)
            self._mark(rays, np.append(slots, np.int32(-1))[found])

    def _mark(self, rays: NDArray[np.int32], values: NDArray[np.int32]) -> None:
        """Write the states of some rays, or the slots of their hits."""
        self.launches.mark(self.launches.block("out", 0, "").address, rays, values)

    def _trace_on_cpu(self, tree: DeviceTree, chunk: Chunk, rays: NDArray[np.int32], threads: int) -> None:
        """Trace rays whose undecided tests do not fit the list."""
        work = chunk.work._replace(which=self.launches.sent("which", rays, "the rays"))
        for begin in range(0, len(rays), work.rest_capacity):
            n = min(work.rest_capacity, len(rays) - begin)
            self.launches.launch(chunk.kind.record, (chunk.rays, work, begin, n), n)
            records = self._read("rest", (n, RECORD), np.float64)
            self._mark(rays[begin : begin + n], self._answers(tree, chunk, records, threads))

    def _answers(self, tree: DeviceTree, chunk: Chunk, records: settling.Records, threads: int) -> NDArray[np.int32]:
        """The states of recorded rays, or the slots of their nearest hits, by the CPU's walk."""
        work, any_hit = chunk.work, chunk.kind.any_hit
        slots = settling.traced_rays(records, tree.bvh, work.cull_faces, any_hit, threads)
        if not any_hit:
            return slots
        states = settling.heads_of(records)[:, settling.STATE]
        blocked = (states == BLOCKED) | ((states == TRACED) & (slots >= 0))
        if chunk.query is not None:
            numbers = work.first + settling.heads_of(records)[:, settling.RAY].astype(np.int64)
            blocked |= settling.below_horizon(numbers, chunk.query, threads)
        return np.where(blocked, BLOCKED, CLEAR).astype(np.int32)

    def bits(self, chunk: Chunk, n: int) -> NDArray[np.uint8]:
        """Bits of n segments of a chunk, whether each is blocked; in bytes, the first bit of a byte first."""
        words = -(-n // 32)
        out = self.launches.block("words", 4 * words, "the bits of the answers").address
        self.launches.launch("pack_states", (chunk.work.out, n, out, words), words)
        return self._read("words", (words,), np.int32).view(np.uint8)
