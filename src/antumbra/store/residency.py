"""Which chunks of a store are in memory: as many as a budget allows, those of the last frames first.

[Mattausch et al. 2015, Sec. 5.4] trace what is cached first, and overwrite the cache round robin. Here the chunk goes
that has not been used for longest (or round robin, to compare), and while the cached ones are traced a thread reads the
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
_READERS = 2  # threads: while nothing can be traced they have all cores
_GROUP = 16  # chunks that are traced together, if so many are coming: what is behind them need not be read
_IN_BLOCK = 6  # triangles, fewer than there are in all trees that were looked at
_BLOCK_BYTES = 4 * 16 * (ROWS + 2) + 64  # of memory for a block: rows, bounds, slots, and a node


class Paging(NamedTuple):
    """What has come and gone."""

    wanted: int  # chunks, each once for each time that it was wanted
    cached: int  # how many of them were in memory
    loaded: int  # chunks read
    bytes: int  # of the file read


class Resident(NamedTuple):
    """A chunk in memory."""

    tree: BlockTree
    bytes: int  # of memory, at most


class Residency:
    """The chunks of a store in memory.

    store : Store
    budget : int
        Bytes of chunks that may be in memory; can be changed between frames.
    policy : "lru" or "round-robin"
    """

    def __init__(self, store: Store, budget: int, policy: str = "lru"):
        if policy not in POLICIES:
            raise InputError(f"eviction policy is {policy!r}; choose {' or '.join(POLICIES)}")
        self.store, self.budget, self.policy = store, budget, policy
        self.trees = np.zeros((len(store), ADDRESSES), np.int64)
        self.paging = Paging(0, 0, 0, 0)
        self._chunks: OrderedDict[int, Resident] = OrderedDict()  # the next one to go first
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
        """Bytes of memory that chunk `k` will take, or rather less: what is made of it, and its pages."""
        blocks = int(self.store.chunks.triangles[k]) // _IN_BLOCK + 1
        return blocks * _BLOCK_BYTES + self._pages(k)

    def _pages(self, k: int) -> int:
        """Bytes of chunk `k`'s pages but for its nodes, which are copied."""
        return int(self.store.chunks.bytes[k]) - 64 * int(self.store.chunks.nodes[k])

    def least_budget(self) -> int:
        """The smallest budget: two chunks, one to be traced and one to be read."""
        k = int(np.argmax(self.store.chunks.triangles))
        return 2 * self.most_of(k)

    def groups(self, parts: np.ndarray, still: Callable[[np.ndarray], np.ndarray]) -> Generator[np.ndarray, None, None]:
        """Groups of these chunks, those that are in memory first.

        A group's trees stay until the next one is asked for. `still` says of some chunks, before they are read, which
        are still wanted; the others are left out.
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
        """Let chunks go until the budget is kept."""
        while self._chunks and self._used > self.budget:
            self._evict(next(iter(self._chunks)))

    def close(self) -> None:
        """Let all chunks go, and the thread that reads."""
        self._reader.shutdown()
        for k in list(self._chunks):
            self._evict(k)

    def _request(self, missing: deque, coming: deque) -> None:
        """Have as many chunks read as there is room for; at least one if none is coming."""
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
        """Make the tree of a chunk; runs in the reader's thread."""
        if not self._checked[k]:
            self.store.check(k)
            self._checked[k] = True
        chunk = self.store.chunk(k)
        tree, size = _apart(block_tree(chunk.bvh, 1))
        self.store.release(k)  # of what is left only a little is looked at
        return Resident(tree, size + self._pages(k))

    def _arrived(self, coming: deque) -> list[int]:
        """Wait for the next chunks; they, and all others that are there already."""
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
        """After an error or an interruption: what is being read is waited for, and the rest not read."""
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
    """Those of some chunks that are still wanted."""
    chunks = np.array(missing, np.int64)
    return deque(chunks[still(chunks)].tolist() if len(chunks) else [])


def _apart(tree: BlockTree) -> tuple[BlockTree, int]:
    """(the tree in memory of its own, that goes back to the system when nobody holds it; bytes of that).

    Memory that is freed in small pieces would stay with the process, for which the next chunk is of another size.
    """
    made = {name: getattr(tree, name) for name in ("nodes", "blocks", "bounds", "slots")}
    places = np.concatenate([[0], np.cumsum([-(-a.nbytes // 64) * 64 for a in made.values()])])
    memory = np.frombuffer(mmap.mmap(-1, max(int(places[-1]), 1)), np.uint8)
    kept = {}
    for (name, array), at in zip(made.items(), places):
        kept[name] = memory[at : at + array.nbytes].view(array.dtype).reshape(array.shape)
        kept[name][...] = array
    return tree._replace(**kept, links=kept["nodes"].view(np.int32)), len(memory)
