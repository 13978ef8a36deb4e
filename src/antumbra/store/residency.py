"""Keeps chunks of a store in memory, as many as a budget allows.

[Mattausch et al. 2015, Sec. 5.4] trace the cached chunks first, and overwrite the cache round robin. This module evicts
the least recently used chunk (or round robin, for comparison). While the cached chunks are traced, threads read the
others.
"""

import mmap
from collections import OrderedDict, deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import NamedTuple

import numpy as np

from ..bvh.blocks import ROWS, BlockTree, block_tree
from ..errors import InputError
from ..trace.forest import ADDRESSES, addresses
from .read import Store

POLICIES = "lru", "round-robin"
_READERS = 2  # reading threads; while nothing can be traced they have all cores
_GROUP = 16  # chunks to wait for and trace together: rays that they block need no chunks behind them
_IN_BLOCK = 6  # triangles in a block, a low estimate: every tree that was examined has more
_BLOCK_BYTES = 4 * 16 * (ROWS + 2) + 64  # memory for a block: rows, bounds, slots, and a node


class Paging(NamedTuple):
    """Counts of chunks that were requested and read."""

    wanted: int  # requests for chunks
    cached: int  # requests for chunks that were in memory
    loaded: int  # chunks read
    bytes: int  # bytes of the file read


class Resident(NamedTuple):
    """A chunk in memory."""

    tree: BlockTree
    bytes: int  # upper bound of the memory that the chunk takes


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
        self.paging = Paging(0, 0, 0, 0)
        self._chunks: OrderedDict[int, Resident] = OrderedDict()  # the next chunk to evict comes first
        self._used = self._coming = 0
        self._pinned: set[int] = set()
        self._checked = np.zeros(len(store), np.bool_)
        self._reader = ThreadPoolExecutor(_READERS, "antumbra-paging")

    def __contains__(self, k: int) -> bool:
        return k in self._chunks

    @property
    def used(self) -> int:
        """Bytes of the chunks in memory."""
        return self._used

    def most_of(self, k: int) -> int:
        """Upper bound, in bytes, of the memory for chunk `k`: its block tree and its pages."""
        blocks = int(self.store.chunks.triangles[k]) // _IN_BLOCK + 1
        return blocks * _BLOCK_BYTES + self._pages(k)

    def _pages(self, k: int) -> int:
        """Bytes of chunk `k`'s pages without its nodes, which are copied."""
        return int(self.store.chunks.bytes[k]) - 64 * int(self.store.chunks.nodes[k])

    def least_budget(self) -> int:
        """The smallest budget: two chunks, so that one is traced while another is read."""
        k = int(np.argmax(self.store.chunks.triangles))
        return 2 * self.most_of(k)

    def groups(self, parts: np.ndarray, still: Callable[[np.ndarray], np.ndarray]) -> Generator[np.ndarray, None, None]:
        """Yield groups of the chunks `parts`. Chunks in memory come first.

        A group's trees stay in memory until the next group is taken. Before chunks are read, `still` returns a mask of
        the chunks that are still needed. The others are left out.
        """
        here = [k for k in parts.tolist() if k in self._chunks]
        missing = deque(k for k in parts.tolist() if k not in self._chunks)
        self._note(wanted=len(parts), cached=len(here))
        coming: deque[tuple[int, Future[Resident]]] = deque()
        self._pinned = set(here)
        try:
            self._request(missing, coming)
            if here:
                yield np.array(here)
                self._used_now(here)
            while missing or coming:
                group = self._arrived(coming)
                self._pinned = set(group)
                missing = _still(missing, still)
                self._request(missing, coming)
                if group:
                    yield np.array(group)
                    self._used_now(group)
        finally:
            self._pinned = set()
            self._abandon(coming)

    def trim(self) -> None:
        """Evict chunks until the budget is kept."""
        while self._chunks and self._used > self.budget:
            self._evict(next(iter(self._chunks)))

    def close(self) -> None:
        """Evict all chunks and stop the reading threads."""
        self._reader.shutdown()
        for k in list(self._chunks):
            self._evict(k)

    def _request(self, missing: deque, coming: deque) -> None:
        """Start reading as many chunks as there is room for; at least one if none is in memory or being read."""
        while missing and (self._make_room(self.most_of(missing[0])) or not (coming or self._pinned)):
            k = missing.popleft()
            self._coming += self.most_of(k)
            coming.append((k, self._reader.submit(self._read, k)))

    def _make_room(self, size: int) -> bool:
        free = self.budget - self._used - self._coming
        for k in [k for k in self._chunks if k not in self._pinned] if free < size else []:
            self._evict(k)
            free = self.budget - self._used - self._coming
            if free >= size:
                break
        return free >= size

    def _read(self, k: int) -> Resident:
        """Make the tree of a chunk; runs in a reading thread."""
        if not self._checked[k]:
            self.store.check(k)
            self._checked[k] = True
        chunk = self.store.chunk(k)
        tree, size = _apart(block_tree(chunk.bvh, 1))
        self.store.release(k)  # tracing touches few of the remaining pages
        return Resident(tree, size + self._pages(k))

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
        self._note(loaded=1, bytes=int(self.store.chunks.bytes[k]))

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

    def _evict(self, k: int) -> None:
        self._used -= self._chunks.pop(k).bytes
        self.trees[k] = 0
        self.store.release(k)

    def _note(self, **more: int) -> None:
        self.paging = self.paging._replace(**{name: getattr(self.paging, name) + n for name, n in more.items()})


def _still(missing: deque, still: Callable[[np.ndarray], np.ndarray]) -> deque:
    """The chunks of `missing` that are still needed."""
    chunks = np.array(missing, np.int64)
    return deque(chunks[still(chunks)].tolist() if len(chunks) else [])


def _apart(tree: BlockTree) -> tuple[BlockTree, int]:
    """Copy a tree to memory of its own; return the copy and the bytes of that memory.

    The system gets this memory back when nothing refers to it. The process would keep memory that is freed in small
    pieces, because the next chunk has another size.
    """
    made = {name: getattr(tree, name) for name in ("nodes", "blocks", "bounds", "slots")}
    places = np.concatenate([[0], np.cumsum([-(-a.nbytes // 64) * 64 for a in made.values()])])
    memory = np.frombuffer(mmap.mmap(-1, max(int(places[-1]), 1)), np.uint8)
    kept = {}
    for (name, array), at in zip(made.items(), places):
        kept[name] = memory[at : at + array.nbytes].view(array.dtype).reshape(array.shape)
        kept[name][...] = array
    return tree._replace(**kept, links=kept["nodes"].view(np.int32)), len(memory)
