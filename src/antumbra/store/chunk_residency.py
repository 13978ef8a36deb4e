"""Chunk residency: keep as many chunks of a store in memory as a budget allows.

[Mattausch et al. 2015, Sec. 5.4] trace the cached chunks first, and overwrite the cache round robin. This module evicts
the least recently used chunk (or round robin, for comparison). While the cached chunks are traced, threads read the
others.
"""

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import NamedTuple

import numpy as np

from ..bvh.block_tree import BlockTree, block_tree
from ..bvh.nodes import ROWS
from ..errors import InputError
from ..trace.tree_list import ADDRESSES, addresses
from .store_file import Store
from .store_format import NODE_BYTES, Chunk
from .system_resources import Pool

POLICIES = "lru", "round-robin"
_READERS = 2  # reading threads; while nothing can be traced they have all cores
_GROUP = 16  # chunks to wait for and trace together: rays that they block need no chunks behind them
_SOON = 2 * _GROUP  # chunks of which it is asked, before they are read, whether rays still want them
_IN_BLOCK = 6  # triangles in a block, a low estimate: every tree that was examined has more
_BLOCK_BYTES = 4 * 16 * (ROWS + 2) + NODE_BYTES  # memory for a block: rows, bounds, slots, and a node


class Paging(NamedTuple):
    """Counts of chunks that were requested and read."""

    wanted: int  # requests for chunks
    cached: int  # requests for chunks that were in memory
    loaded: int  # chunks read
    bytes: int  # bytes of the file read
    bvh_bytes: int  # bytes of nodes among them; the others are corners, numbers, colours, and zeros up to whole pages


class ResidentChunk(NamedTuple):
    """A chunk in memory."""

    tree: BlockTree
    palette: np.ndarray  # (p, 3) float32, as in `Chunk`
    index: np.ndarray  # (n,) uint8, uint16 or uint32
    memory: np.ndarray  # (n,) uint8: the memory of all arrays

    @property
    def bytes(self) -> int:
        return len(self.memory)


class Copies(NamedTuple):
    """Some triangles of a chunk."""

    slots: np.ndarray  # (n,) int64, ascending
    vertices: np.ndarray  # (n, 3, 3) float32
    colour: np.ndarray  # (n, 3) float32
    ids: np.ndarray  # (n,) int32, indices in the whole scene


Mark = Callable[[np.ndarray, np.ndarray], None]
"""``mark(first, marks)`` sets ``marks[first[k] + slot]`` for each hit in a slot of chunk k with first[k] >= 0."""


class Residency:
    """The chunks of a store in memory.

    store : Store
    budget : int
        Most bytes of chunks in memory. It can be changed between frames.
    policy : "lru" or "round-robin"
        Which chunk is evicted first.
    """

    def __init__(self, store: Store, budget: int, policy: str = "lru"):
        if policy not in POLICIES:
            raise InputError(f"eviction policy is {policy!r}; choose {' or '.join(POLICIES)}")
        self.store, self.budget, self.policy = store, budget, policy
        self.trees = np.zeros((len(store), ADDRESSES), np.int64)
        self.paging = Paging(0, 0, 0, 0, 0)
        self._chunks: OrderedDict[int, ResidentChunk] = OrderedDict()  # the next chunk to evict comes first
        self._used = self._coming = 0
        self._pinned: set[int] = set()
        self._copies: dict[int, Copies] = {}  # of chunks that left memory while rays still had hits in them
        self._pool = Pool()
        self._own = threading.local()  # each reading thread's memory
        self._reader = ThreadPoolExecutor(_READERS, "antumbra-paging")

    def __contains__(self, k: int) -> bool:
        return k in self._chunks

    @property
    def used(self) -> int:
        """Bytes of the chunks in memory."""
        return self._used

    @property
    def held(self) -> int:
        """Bytes that this object holds: of the chunks in memory, and free ones for chunks that come."""
        return self._used + self._pool.bytes

    def most_of(self, k: int) -> int:
        """Upper bound, in bytes, of what chunk `k` needs: its block tree, its corners and its colours."""
        blocks = int(self.store.chunks.triangles[k]) // _IN_BLOCK + 1
        return blocks * _BLOCK_BYTES + int(self.store.chunks.bytes[k]) - NODE_BYTES * int(self.store.chunks.nodes[k])

    def least_budget(self) -> int:
        """The smallest budget: two chunks, so that one is traced while another is read."""
        k = int(np.argmax(self.store.chunks.triangles))
        return 2 * self.most_of(k)

    def begin_question(self) -> None:
        """Forget the triangles that were copied for the question before."""
        self._copies.clear()

    def groups(
        self, parts: np.ndarray, still: Callable[[np.ndarray], np.ndarray], mark: Mark | None = None
    ) -> Generator[np.ndarray, None, None]:
        """Yield groups of the chunks `parts`. Chunks in memory come first.

        A group's trees stay in memory until the next group is taken. Before chunks are read, `still` returns a mask of
        the chunks that are still needed. The others are left out. Before a chunk leaves memory, the triangles that
        `mark` marks are copied for `triangles`; None: no triangles are wanted.
        """
        here = [k for k in parts.tolist() if k in self._chunks]
        missing = deque(k for k in parts.tolist() if k not in self._chunks)
        self._note(wanted=len(parts), cached=len(here))
        coming: deque[tuple[int, Future[ResidentChunk]]] = deque()
        self._pinned = set(here)
        try:
            self._request(missing, coming, mark)
            if here:
                yield np.array(here)
                self._used_now(here)
            while missing or coming:
                group = self._arrived(coming)
                self._pinned = set(group)
                missing = _still(missing, still)
                self._request(missing, coming, mark)
                if group:
                    yield np.array(group)
                    self._used_now(group)
        finally:
            self._pinned = set()
            self._abandon(coming)

    def triangles(self, k: int, slots: np.ndarray) -> Copies:
        """Triangles of chunk `k`, (n,) slots in ascending order. They are hits of the question that has just ended."""
        if k in self._chunks:
            return self._copied(k, slots)
        kept = self._copies[k]
        at = np.searchsorted(kept.slots, slots)
        return Copies(slots, kept.vertices[at], kept.colour[at], kept.ids[at])

    def trim(self) -> None:
        """Evict chunks until the budget is kept."""
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

    def _request(self, missing: deque, coming: deque, mark: Mark | None) -> None:
        """Start reading as many chunks as there is room for; at least one if none is in memory or being read."""
        self._make_room(missing, mark)
        while missing and (self._free() >= self.most_of(missing[0]) or not (coming or self._pinned)):
            k = missing.popleft()
            self._coming += self.most_of(k)
            coming.append((k, self._reader.submit(self._read, k)))

    def _free(self) -> int:
        return self.budget - self._used - self._coming

    def _make_room(self, missing: Iterable[int], mark: Mark | None) -> None:
        """Evict as many chunks as make room for the missing ones, or all that are not being traced."""
        short, leaving = -self._free(), []
        idle = iter([k for k in self._chunks if k not in self._pinned])
        for k in missing:
            short += self.most_of(k)
            while short > 0 and (old := next(idle, None)) is not None:
                leaving.append(old)
                short -= self._chunks[old].bytes
            if short > 0:
                break
        self._evict(leaving, mark)

    def _read(self, k: int) -> ResidentChunk:
        """Make the tree of a chunk; runs in a reading thread."""
        if not hasattr(self._own, "memory"):
            self._own.memory = self.store.memory()
        chunk = self.store.chunk(k, self._own.memory)
        return _resident(block_tree(chunk.bvh, 1), chunk, self._pool, self.most_of(k))

    def _arrived(self, coming: deque) -> list[int]:
        """Wait for the next `_GROUP` chunks; return them and all that follow and are read already."""
        group = []
        while coming and (len(group) < _GROUP or coming[0][1].done()):
            k, future = coming.popleft()
            self._receive(k, future)
            group.append(k)
        return group

    def _receive(self, k: int, future: Future) -> None:
        self._coming -= self.most_of(k)
        resident = future.result()
        self._chunks[k] = resident
        self._used += resident.bytes
        self.trees[k] = addresses(resident.tree)
        chunks = self.store.chunks
        self._note(loaded=1, bytes=int(chunks.bytes[k]), bvh_bytes=NODE_BYTES * int(chunks.nodes[k]))

    def _abandon(self, coming: deque) -> None:
        """After an error or an interruption, wait for chunks that are being read, and cancel the others."""
        for k, future in coming:
            future.cancel()
            self._coming -= self.most_of(k)
        wait([future for _, future in coming])

    def _used_now(self, group: list[int]) -> None:
        if self.policy == "lru":
            for k in group:
                self._chunks.move_to_end(k)

    def _evict(self, leaving: list[int], mark: Mark | None = None) -> None:
        if leaving and mark is not None:
            self._keep_hits(np.array(leaving), mark)
        for k in leaving:
            gone = self._chunks.pop(k)
            self._used -= gone.bytes
            self.trees[k] = 0
            self._pool.give(gone.memory)

    def _keep_hits(self, leaving: np.ndarray, mark: Mark) -> None:
        """Copy the triangles of chunks that the rays hit."""
        for k, slots in hit_slots(leaving, self.store.chunks.triangles, mark):
            self._copies[k] = self._copied(k, slots)

    def _copied(self, k: int, slots: np.ndarray) -> Copies:
        chunk = self._chunks[k]
        vertices = chunk.tree.corners[slots].reshape(-1, 3, 3)
        return Copies(slots, vertices, chunk.palette[chunk.index[slots]], chunk.tree.prim_ids[slots])

    def _note(self, **more: int) -> None:
        self.paging = self.paging._replace(**{name: getattr(self.paging, name) + n for name, n in more.items()})


def _still(missing: deque, still: Callable[[np.ndarray], np.ndarray]) -> deque:
    """The chunks of `missing`, without those among the next ones that are not needed any more."""
    chunks = np.array(missing, np.int64)
    soon, later = chunks[:_SOON], chunks[_SOON:]
    return deque([*soon[still(soon)].tolist(), *later.tolist()] if len(soon) else [])


def slot_starts(chunks: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(k,) int64: where the slots of each chunk begin if those of some `chunks` follow one another; -1 for the others.

    triangles : (k,) int64, triangles of all chunks
    """
    first = np.full(len(triangles), -1, np.int64)
    first[chunks] = np.cumsum(triangles[chunks], dtype=np.int64) - triangles[chunks]
    return first


def hit_slots(chunks: np.ndarray, triangles: np.ndarray, mark: Mark) -> Iterable[tuple[int, np.ndarray]]:
    """For each of some chunks in which rays have hits: its number, and the slots of the hits, ascending."""
    first, marks = slot_starts(chunks, triangles), np.zeros(int(triangles[chunks].sum()), np.uint8)
    mark(first, marks)
    for k in chunks.tolist():
        slots = np.flatnonzero(marks[first[k] : first[k] + triangles[k]])
        if len(slots):
            yield k, slots


def _resident(tree: BlockTree, chunk: Chunk, pool: Pool, most: int) -> ResidentChunk:
    """Copy a chunk's tree and colours to memory of the pool."""
    made = {name: getattr(tree, name) for name in tree._fields if name != "links"}
    made |= {"palette": chunk.palette, "index": chunk.index}
    slot_starts = np.concatenate([[0], np.cumsum([-(-a.nbytes // 64) * 64 for a in made.values()])])
    memory = pool.take(int(slot_starts[-1]), most)
    kept = {}
    for (name, array), at in zip(made.items(), slot_starts):
        kept[name] = memory[at : at + array.nbytes].view(array.dtype).reshape(array.shape)
        kept[name][...] = array
    palette, index = kept.pop("palette"), kept.pop("index")
    return ResidentChunk(BlockTree(links=kept["nodes"].view(np.int32), **kept), palette, index, memory)
