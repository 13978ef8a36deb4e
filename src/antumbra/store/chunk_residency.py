"""Chunk residency: keep as many chunks of a store in memory as a budget allows.

A chunk is read to the memory that it keeps, and only its blocks are added there.

Cached chunks are traced first while threads read the others. The least recently used chunk is evicted first.
[Mattausch et al. 2015, Sec. 5.4] overwrite their cache in round-robin order, which is available for comparison.
"""

from collections import OrderedDict, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import closing
from itertools import compress, islice
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.forks import renew_after_fork
from ..bvh.block_tree import BlockTree
from ..bvh.compact_tree import expand, expanded_bytes
from ..trace.tree_list import ADDRESSES, addresses
from .store_file import Store
from .store_format import NODE_BYTES, Chunk
from .system_resources import BufferPool

POLICIES = "lru", "round-robin"
_READERS = 2  # reading threads; while there is nothing to trace, they have all cores to themselves
_GROUP = 16  # chunks traced together: rays that hit something in them need none of the chunks behind
_AHEAD = 2 * _GROUP  # chunks read ahead of the rays at first
_NEARLY = 0.875  # share of the chunks read that rays still need, from which on twice as many are read ahead


class Paging(NamedTuple):
    """Counts of chunks requested and read."""

    wanted: int  # requests for chunks
    cached: int  # requests for chunks that were in memory
    loaded: int  # chunks read
    bytes: int  # bytes read from the file
    bvh_bytes: int  # bytes of nodes among them; the rest are corners, ids, colours, and padding to whole pages


class ResidentChunk(NamedTuple):
    """A chunk in memory."""

    tree: BlockTree
    palette: NDArray[np.float32]  # (p, 3), as in `Chunk`
    palette_rows: NDArray[Any]  # (n,) uint8, uint16 or uint32
    memory: NDArray[np.uint8]  # (n,): the memory of all arrays

    @property
    def bytes(self) -> int:
        return len(self.memory)


class TriangleCopies(NamedTuple):
    """Some triangles of a chunk."""

    slots: NDArray[np.int64]  # (n,), ascending
    vertices: NDArray[np.float32]  # (n, 3, 3)
    colour: NDArray[np.float32]  # (n, 3)
    ids: NDArray[np.int32]  # (n,), indices in the whole scene


Mark = Callable[[np.ndarray, np.ndarray], None]
"""``mark(first, marks)`` sets ``marks[first[k] + slot]`` for each hit in a slot of chunk k with first[k] >= 0."""


_Read: TypeAlias = tuple[int, Future[ResidentChunk]]
"""A chunk that is being read."""


class Residency:
    """The chunks of a store in memory.

    store : Store
    budget : int
        Limit in bytes on the chunks in memory. It may change between frames.
    policy : "lru" or "round-robin"
        Which chunk is evicted first.

    Attributes
    ----------
    size : int
        Bytes that all chunks would occupy.
    pending : int
        Bytes reserved for chunks that are being read.
    traced : (chunks,) bool
        The chunks that were traced since `begin_band`.
    returned : int
        Bytes of chunks that were traced, evicted, read and traced again since then.
    """

    def __init__(self, store: Store, budget: int, policy: str = "lru"):
        if policy not in POLICIES:
            raise InputError(f"eviction policy is {policy!r}; choose {' or '.join(POLICIES)}")
        self.store, self.budget, self.policy = store, budget, policy
        self.trees = np.zeros((len(store), ADDRESSES), np.int64)
        self.traced, self.returned = np.zeros(len(store), np.bool_), 0
        self.paging = Paging(0, 0, 0, 0, 0)
        self._chunks: OrderedDict[int, ResidentChunk] = OrderedDict()  # the next chunk to evict comes first
        self._sizes = store.chunks.bytes + expanded_bytes(store.chunks.nodes)  # with their blocks
        self.size = int(self._sizes.sum())
        self._used = self.pending = 0
        self._pinned: set[int] = set()
        self._ahead = _AHEAD
        self._copies: dict[int, TriangleCopies] = {}  # from evicted chunks in which the current query has hits
        self._pool = BufferPool()
        self._start_readers()
        renew_after_fork(self)

    def _start_readers(self) -> None:
        self._reader = ThreadPoolExecutor(_READERS, "antumbra-paging")

    _after_fork = _start_readers  # threads do not survive a fork

    def __contains__(self, k: int) -> bool:
        return k in self._chunks

    @property
    def used(self) -> int:
        """Bytes occupied by the chunks in memory."""
        return self._used

    @property
    def held(self) -> int:
        """Bytes allocated: the chunks in memory, and free buffers for further chunks."""
        return self._used + self._pool.bytes

    def tree(self, k: int) -> BlockTree:
        """The tree of a chunk in memory."""
        return self._chunks[k].tree

    @property
    def loaded(self) -> int:
        """Bytes of all chunks read."""
        return self.paging.bytes

    def begin_band(self) -> None:
        """Start a band of rows of an image."""
        self.traced[:], self.returned = False, 0

    def max_bytes(self, k: int) -> int:
        """Upper bound, in bytes, on the memory of chunk `k`, which may be that of a larger one."""
        return int(self._sizes[k]) * 5 // 4

    def min_budget(self) -> int:
        """The smallest usable budget: two chunks, so that one is traced while another is read."""
        return 2 * self.max_bytes(int(np.argmax(self._sizes)))

    def begin_question(self) -> None:
        """Discard the triangles copied for the previous query."""
        self._copies.clear()

    def groups(
        self, parts: np.ndarray, still_needed: Callable[[np.ndarray], np.ndarray], mark: Mark | None = None
    ) -> Generator[np.ndarray, None, None]:
        """Yield the chunks `parts` in groups, starting with those in memory.

        The trees of a group stay in memory until the next group is requested. Before chunks are read, and once more
        before they are yielded, `still_needed` returns a mask of those that rays still need; the others are skipped.
        Before a chunk is evicted, the triangles that `mark` marks are copied for `triangles`; None: copy nothing.
        """
        here = [k for k in parts.tolist() if k in self._chunks]
        missing = deque(k for k in parts.tolist() if k not in self._chunks)
        self._count(wanted=len(parts), cached=len(here))
        self._ahead = _AHEAD
        coming: deque[_Read] = deque()
        self._pinned = set(here)
        try:
            self._request(missing, coming, mark)
            if here:
                yield np.array(here)
                self._mark_used(here)
            while missing or coming:
                group = self._needed(self._next_group(coming), missing, still_needed)
                self._pinned = set(group)
                self.returned += sum(int(self._sizes[k]) for k in group if self.traced[k])
                self._request(missing, coming, mark)
                if group:
                    yield np.array(group)
                    self._mark_used(group)
        finally:
            self._pinned = set()
            self._cancel(coming)

    def triangles(self, k: int, slots: np.ndarray) -> TriangleCopies:
        """The triangles in (n,) ascending slots of chunk `k`, hits of the latest query.

        A device may have hit others than those in memory and copied ones; the chunk is read for them.
        """
        if k in self._chunks:
            return _copies_of(self._chunks[k], slots)
        copies = self._copies.get(k)
        if copies is None or not np.isin(slots, copies.slots).all():
            return _copies_of(self._read_again(k), slots)
        at = np.searchsorted(copies.slots, slots)
        return TriangleCopies(slots, copies.vertices[at], copies.colour[at], copies.ids[at])

    def trim(self) -> None:
        """Evict chunks until the rest fit in the budget."""
        while self._chunks and self._used > self.budget:
            self._evict([next(iter(self._chunks))])
        if self.held > self.budget:
            self._pool.clear()

    def close(self) -> None:
        """Evict all chunks and stop the reading threads."""
        self._reader.shutdown()
        self._evict(list(self._chunks))
        self._pool.clear()
        self._copies.clear()

    def _request(self, missing: deque[int], coming: deque[_Read], mark: Mark | None) -> None:
        """Start reading the next chunks, if they fit in the budget; at least one if none is being traced or read."""
        soon = list(islice(missing, max(self._ahead - len(coming), 0)))
        self._make_room(soon, mark)
        for k in soon:
            if self._free() < self.max_bytes(k) and (coming or self._pinned):
                break
            missing.popleft()
            self.pending += self.max_bytes(k)
            coming.append((k, self._reader.submit(self._read, k)))

    def _needed(
        self, read: list[int], missing: deque[int], still_needed: Callable[[np.ndarray], np.ndarray]
    ) -> list[int]:
        """Those of the chunks `read` that rays still need. Of the missing ones, keep those needed among the next ones.

        If nearly all of the chunks are needed, as in views from afar, the next ones are read further ahead, and traced
        in larger groups.
        """
        needed = lambda chunks: list(compress(chunks, still_needed(np.array(chunks, np.int64)))) if chunks else []
        group, soon = needed(read), list[int]()
        self._ahead = min(2 * self._ahead, len(self.store)) if len(group) >= _NEARLY * len(read) else _AHEAD
        while missing and len(soon) < self._ahead:
            soon += needed([missing.popleft() for _ in range(min(self._ahead, len(missing)))])
        missing.extendleft(reversed(soon))
        return group

    def _free(self) -> int:
        return self.budget - self._used - self.pending

    def _make_room(self, missing: Iterable[int], mark: Mark | None) -> None:
        """Evict enough chunks for the missing ones to fit, or all that are not being traced."""
        short, leaving = -self._free(), []
        idle = iter([k for k in self._chunks if k not in self._pinned])
        for k in missing:
            short += self.max_bytes(k)
            while short > 0 and (old := next(idle, None)) is not None:
                leaving.append(old)
                short -= self._chunks[old].bytes
            if short > 0:
                break
        self._evict(leaving, mark)

    def _read(self, k: int) -> ResidentChunk:
        """Read a chunk and expand its tree; runs in a reading thread."""
        memory = self._pool.acquire(int(self._sizes[k]), self.max_bytes(k))
        chunk = self.store.chunk(k, memory)
        tree = expand(chunk.tree, memory[int(self.store.chunks.bytes[k]) :])
        return ResidentChunk(tree, chunk.palette, chunk.palette_rows, memory)

    def _next_group(self, coming: deque[_Read]) -> list[int]:
        """Wait for the next `_GROUP` chunks; return them and any following ones that are already read."""
        group: list[int] = []
        while coming and (len(group) < _GROUP or coming[0][1].done()):
            k, future = coming.popleft()
            self._receive(k, future)
            group.append(k)
        return group

    def _receive(self, k: int, future: Future[ResidentChunk]) -> None:
        self.pending -= self.max_bytes(k)
        resident = future.result()
        self._chunks[k] = resident
        self._used += resident.bytes
        self.trees[k] = addresses(resident.tree)
        chunks = self.store.chunks
        self._count(loaded=1, bytes=int(chunks.bytes[k]), bvh_bytes=NODE_BYTES * int(chunks.nodes[k]))

    def _cancel(self, coming: deque[_Read]) -> None:
        """After an error or an interruption, cancel the reads that have not begun and wait for the others."""
        for k, future in coming:
            future.cancel()
            self.pending -= self.max_bytes(k)
        wait([future for _, future in coming])

    def _mark_used(self, group: list[int]) -> None:
        self.traced[group] = True
        if self.policy == "lru":
            for k in group:
                self._chunks.move_to_end(k)

    def _evict(self, leaving: list[int], mark: Mark | None = None) -> None:
        if leaving and mark is not None:
            self._copy_hits(np.array(leaving), mark)
        for k in leaving:
            resident = self._chunks.pop(k)
            self._used -= resident.bytes
            self.trees[k] = 0
            self._pool.release(resident.memory)

    def _copy_hits(self, leaving: np.ndarray, mark: Mark) -> None:
        """Copy the triangles that rays hit in chunks about to be evicted."""
        for k, slots in hit_slots(leaving, self.store.chunks.triangles, mark):
            self._copies[k] = _copies_of(self._chunks[k], slots)

    def _read_again(self, k: int) -> Chunk:
        """Read a chunk that is not to stay."""
        chunks = self.store.chunks
        self._count(wanted=1, loaded=1, bytes=int(chunks.bytes[k]), bvh_bytes=NODE_BYTES * int(chunks.nodes[k]))
        return self.store.chunk(k)

    def _count(self, **increments: int) -> None:
        self.paging = self.paging._replace(**{name: getattr(self.paging, name) + n for name, n in increments.items()})


def _copies_of(chunk: "ResidentChunk | Chunk", slots: np.ndarray) -> TriangleCopies:
    vertices = chunk.tree.corners[slots].reshape(-1, 3, 3)
    return TriangleCopies(slots, vertices, chunk.palette[chunk.palette_rows[slots]], chunk.tree.prim_ids[slots])


class RangeMemory:
    """The chunks of a range of faces, numbered from 0 on, in the memory of all chunks.

    residency : Residency, or another `PartMemory`
    chunks : slice
    """

    def __init__(self, residency: Any, chunks: slice):
        self._residency, self._chunks = residency, chunks

    def __contains__(self, k: int) -> bool:
        return k + self._chunks.start in self._residency

    def begin_question(self) -> None:
        """As `Residency.begin_question`."""
        self._residency.begin_question()

    def groups(
        self, parts: np.ndarray, still_needed: Callable[[np.ndarray], np.ndarray], mark: Mark | None = None
    ) -> Generator[np.ndarray, None, None]:
        """As `Residency.groups`."""
        start = self._chunks.start
        of_all = None if mark is None else lambda first, marks: mark(first[self._chunks], marks)
        with closing(self._residency.groups(parts + start, lambda k: still_needed(k - start), of_all)) as groups:
            for group in groups:
                yield group - start


def slot_starts(chunks: np.ndarray, triangles: np.ndarray) -> NDArray[np.int64]:
    """(k,) int64: the first slot of each chunk if the slots of `chunks` are concatenated; -1 for all other chunks.

    triangles : (k,) int64, triangles of all chunks
    """
    first = np.full(len(triangles), -1, np.int64)
    first[chunks] = np.cumsum(triangles[chunks], dtype=np.int64) - triangles[chunks]
    return first


def hit_slots(chunks: np.ndarray, triangles: np.ndarray, mark: Mark) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yield the number of each chunk in which rays have hits, and the slots of the hits in ascending order."""
    first, marks = slot_starts(chunks, triangles), np.zeros(int(triangles[chunks].sum()), np.uint8)
    mark(first, marks)
    for k in chunks.tolist():
        slots = np.flatnonzero(marks[first[k] : first[k] + triangles[k]])
        if len(slots):
            yield k, slots
