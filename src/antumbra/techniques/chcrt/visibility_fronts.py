"""The query-pair hierarchy with its visible and invisible fronts, and one frame of CHC+RT (Algorithm 1).

Fronts [Mattausch et al. 2015, Sec. 4.3, 4.5, 5.1]. A query pair is a screen tile and a node. The leaves of the
hierarchy are the *visible front*, pairs that are traced, and the *invisible front*, pairs that are skipped. Inner pairs
record the splits, so that invisibility can be pulled up.

Each ray set has its own hierarchy: all rays to a light form one set, and so do the rays of each direction of ambient
occlusion or diffuse rays (Sec. 5.3). All hierarchies share the same arrays, because their queries are answered
together.
"""

from contextlib import closing
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback, clock_seconds
from ..tracer_options import ChcRtOptions
from .occlusion_queries import Answers, Pairs, Tiles
from .tree_parts import Mark, TreeParts, in_lists

# --- The query-pair hierarchy -----------------------------------------------------------------------------------------


INNER, INVISIBLE, VISIBLE = range(3)


class Fronts:
    """The n pairs of all sets, as arrays.

    tile, set, row : (n,) int32
        A tile of `Tiles`, a ray set, a row of `TreeParts`.
    parent : (n,) int32
        The pair that was split; -1: the root pair of a set.
    state : (n,) int8
        INNER, INVISIBLE or VISIBLE.
    due : (n,) int64
        The frame in which a visible pair of nearest-hit rays is queried again.
    key : (n,) float32
        The parameter at which rays enter its box, by the last query.
    """

    def __init__(self, tiles: Tiles, parts: TreeParts, sets: int, options: ChcRtOptions):
        self.tiles, self.parts, self.sets, self.options = tiles, parts, sets, options
        self.frame = 0
        self._random = np.random.default_rng(0)
        self._restart()

    def _restart(self) -> None:
        """Keep only the root pair of each set: the whole screen and the whole scene."""
        sets = self.sets
        self.tile = np.full(sets, len(self.tiles.spans) - 1, np.int32)
        self.set = np.arange(sets, dtype=np.int32)
        self.row = np.zeros(sets, np.int32)
        self.parent = np.full(sets, -1, np.int32)
        self.state = np.full(sets, INVISIBLE, np.int8)
        self.due = np.zeros(sets, np.int64)
        self.key = np.zeros(sets, np.float32)

    def __len__(self) -> int:
        return len(self.tile)

    def move_to(self, parts: TreeParts, rows: NDArray[np.int32]) -> None:
        """Continue over the parts of a refitted tree; `rows`: see `tree_parts.matching_rows`."""
        self.parts, self.row = parts, rows[self.row]

    def begin_frame(self) -> None:
        """Discard the pairs of the previous frame unless `ChcRtOptions.keep` is set (Sec. 4.5)."""
        if not self.options.keep:
            self._restart()

    def pairs(self, chosen: NDArray[np.int64]) -> Pairs:
        """The pairs with these indices."""
        return Pairs(self.tile[chosen], self.set[chosen], self.row[chosen])

    def of(self, state: int) -> NDArray[np.int64]:
        """(k,) int64: the pairs in a state."""
        return np.flatnonzero(self.state == state)

    def is_final(self, pairs: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(k,) bool: whether pairs are final, a smallest tile and a part. Final pairs are never split."""
        final: NDArray[np.bool_] = (self.tile[pairs] < self.tiles.smallest) & (self.row[pairs] >= self.parts.inner)
        return final

    def split(self, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
        """Split pairs that are not final. Return their children.

        A pair is split in object space if the node's share of the scene is larger than t_q times the tile's share of
        the screen. Otherwise it is split in screen space (Sec. 4.4).
        """
        tile, row = self.tile[pairs], self.row[pairs]
        smallest, part = tile < self.tiles.smallest, row >= self.parts.inner
        larger = self.parts.share[row] > self.options.weight * self.tiles.share[tile]
        in_object = ~part & (larger | smallest)
        nodes = np.pad(self.parts.children[row], ((0, 0), (0, 2)), constant_values=-1)
        tile2 = np.where(in_object[:, None], tile[:, None], self.tiles.children[tile])
        row2 = np.where(in_object[:, None], nodes, row[:, None])
        exists = (tile2 >= 0) & (row2 >= 0)
        self.state[pairs] = INNER
        return self._add(tile2[exists], row2[exists], np.repeat(pairs, exists.sum(1)))

    def _add(self, tile: NDArray[np.int32], row: NDArray[np.int32], parent: NDArray[np.int64]) -> NDArray[np.int64]:
        first, n = len(self), len(tile)
        self.tile, self.row = np.append(self.tile, tile), np.append(self.row, row)
        self.set = np.append(self.set, self.set[parent])
        self.parent = np.append(self.parent, parent.astype(np.int32))
        self.state = np.append(self.state, np.full(n, INVISIBLE, np.int8))
        self.due = np.append(self.due, np.zeros(n, np.int64))
        self.key = np.append(self.key, np.ones(n, np.float32))
        return np.arange(first, first + n)

    def show(self, pairs: NDArray[np.int64]) -> None:
        """Make pairs visible, and distribute their first queries at random over the next frames (Sec. 5.1)."""
        self.state[pairs] = VISIBLE
        self.due[pairs] = self.frame + self._random.integers(1, self.options.every + 1, len(pairs))

    def end_frame(self) -> None:
        """Pull invisibility up by at most one level (Sec. 5.1), and remove the children of pulled-up pairs."""
        self.frame += 1
        if self.options.pull_up:
            self._pull_up()

    def _pull_up(self) -> None:
        n = len(self)
        has_parent = self.parent >= 0
        children = np.bincount(self.parent[has_parent], minlength=n)
        hidden = np.bincount(self.parent[has_parent & (self.state == INVISIBLE)], minlength=n)
        pulled = (children > 0) & (children == hidden)
        if not pulled.any():
            return
        self.state[pulled] = INVISIBLE
        remaining = ~(has_parent & pulled[self.parent])
        new = np.cumsum(remaining, dtype=np.int32) - 1
        self.parent = np.where(has_parent, new[self.parent], -1)[remaining].astype(np.int32)
        self.tile, self.set, self.row = self.tile[remaining], self.set[remaining], self.row[remaining]
        self.state, self.due, self.key = self.state[remaining], self.due[remaining], self.key[remaining]


# --- One frame of CHC+RT: the three phases of Algorithm 1 [Mattausch et al. 2015, Sec. 5.1] ---------------------------

_FIRST_BATCH = 4  # newly visible parts of a tile in the first batch; batches double up to `ChcRtOptions.batch`


class FrameRaySet(Protocol):
    """One or several ray sets of an image, as input of `trace_frame`.

    any_hit : bool
        True: rays seek any blocker, and queries no longer count a blocked ray. False: rays seek their nearest hits, and
        queries count each ray up to its hit so far.
    """

    any_hit: bool

    def answer(self, pairs: Pairs, threshold: int) -> Answers:
        """Answer occlusion queries for pairs."""
        ...

    def trace(self, pairs: Pairs, keys: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Trace the rays of final pairs, and update the limits that queries use; `keys`: see `Answers`.

        Return (k,) bool: the pairs that blocked an any-hit ray.
        """
        ...

    def marker(self) -> Mark | None:
        """The function that marks hits, a `store.chunk_residency.Mark`; None: their triangles are not needed."""
        ...


class Statistics:
    """Times and counts of a tracing call, by the phases of Fig. 8.

    progress : function of (done, total) or None
        Called with the number of parts traced, and the number of parts requested from the part memory.
    """

    def __init__(self, progress: ProgressCallback | None = None):
        self.progress = progress
        self.seconds = dict.fromkeys(("phase 1", "phase 2", "phase 3"), 0.0)
        self.queries = self.multi_queries = self.traced = 0
        self._last = clock_seconds()

    def lap(self, phase: str) -> None:
        now = clock_seconds()
        self.seconds[phase] += now - self._last
        self._last = now

    def as_dict(self, fronts: Fronts) -> dict[str, float]:
        """The statistics as a dict, for reports and benchmarks."""
        visible = int(np.count_nonzero(fronts.state == VISIBLE))
        hidden = int(np.count_nonzero(fronts.state == INVISIBLE))
        return {
            **self.seconds, "queries": self.queries, "multi_queries": self.multi_queries, "traced pairs": self.traced,
            "visible": visible, "invisible": hidden, "pairs": len(fronts),
        }  # fmt: skip


def trace_frame(fronts: Fronts, rays: FrameRaySet, progress: ProgressCallback | None = None) -> Statistics:
    """Trace the rays of a call, and update `fronts` for the next frame.

    Visible pairs of nearest-hit rays are queried every few frames (Sec. 5.1). Pairs of any-hit rays stay visible while
    they block a ray; the others are queried in every frame.
    """
    fronts.begin_frame()
    statistics = Statistics(progress)
    visible, hidden = fronts.of(VISIBLE), fronts.of(INVISIBLE)
    blocking = _trace(fronts, rays, visible, statistics).blocking
    statistics.lap("phase 1")
    due = visible[~blocking if rays.any_hit else fronts.due[visible] <= fronts.frame]
    is_visible, is_still_visible = _query(fronts, rays, hidden, statistics), _query(fronts, rays, due, statistics)
    fronts.due[due] = fronts.frame + fronts.options.every
    fronts.state[due[~is_still_visible]] = INVISIBLE
    statistics.lap("phase 2")
    _traverse(fronts, rays, hidden[is_visible], statistics)
    fronts.end_frame()
    statistics.lap("phase 3")
    return statistics


def _query(fronts: Fronts, rays: FrameRaySet, pairs: NDArray[np.int64], statistics: Statistics) -> NDArray[np.bool_]:
    """Query pairs. Return (k,) bool: whether each has more rays than the threshold."""
    answers = rays.answer(fronts.pairs(pairs), fronts.options.threshold)
    fronts.key[pairs] = answers.keys
    statistics.queries += len(pairs)
    statistics.multi_queries += answers.groups
    return answers.counts > fronts.options.threshold


class TracedPairs(NamedTuple):
    """What tracing k pairs has found."""

    traced: NDArray[np.bool_]  # (k,): False where no ray needed the pair any more
    blocking: NDArray[np.bool_]  # (k,): see `FrameRaySet.trace`


def _trace(fronts: Fronts, rays: FrameRaySet, pairs: NDArray[np.int64], statistics: Statistics) -> TracedPairs:
    """Trace the rays of final pairs, parts in memory first (Sec. 5.4).

    The other parts follow front to back, each once for all its pairs. A pair is skipped if all its rays have hits
    before its part is read.
    """
    memory = fronts.parts.memory
    if memory is None or not len(pairs):
        statistics.traced += len(pairs)
        return TracedPairs(np.ones(len(pairs), np.bool_), rays.trace(fronts.pairs(pairs), fronts.key[pairs]))
    parts = fronts.row[pairs] - fronts.parts.inner

    def still(candidates: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether active rays still enter each of these parts. Called before the parts are read."""
        queried = pairs[np.isin(parts, candidates)]
        threshold = fronts.options.threshold
        entered = queried[rays.answer(fronts.pairs(queried), threshold).counts > threshold]
        return np.isin(candidates, fronts.row[entered] - fronts.parts.inner)

    ordered, done = _nearest_first(parts, fronts.key[pairs]), 0
    traced, blocking = np.zeros(len(pairs), np.bool_), np.zeros(len(pairs), np.bool_)
    with closing(memory.groups(ordered, still, rays.marker())) as groups:
        for group in groups:
            now = np.flatnonzero(np.isin(parts, group))
            statistics.traced += len(now)
            traced[now] = True
            blocking[now] = rays.trace(fronts.pairs(pairs[now]), fronts.key[pairs[now]])
            done += len(group)
            if statistics.progress is not None:
                statistics.progress(done, len(ordered))
    if statistics.progress is not None and done < len(ordered):  # no ray needed the other parts
        statistics.progress(len(ordered), len(ordered))
    return TracedPairs(traced, blocking)


def _nearest_first(parts: NDArray[np.int32], keys: NDArray[np.float32]) -> NDArray[np.int32]:
    """The distinct parts, sorted by their smallest keys."""
    order = np.argsort(keys, kind="stable")
    _, first = np.unique(parts[order], return_index=True)
    return parts[order][np.sort(first)]


def _traverse(fronts: Fronts, rays: FrameRaySet, visible: NDArray[np.int64], statistics: Statistics) -> None:
    """Phase 3: split newly visible pairs down to final pairs, and trace the final pairs.

    In core, each batch has the nearest parts of each tile, and the parts behind them are queried again before they are
    traced. Out of core, the part memory does both.
    """
    waiting = [visible[:0]]
    while len(visible):
        final = fronts.is_final(visible)
        waiting.append(visible[final])
        children = fronts.split(visible[~final])
        visible = children[_query(fronts, rays, children, statistics)]
    pairs, batch = np.concatenate(waiting), min(_FIRST_BATCH, fronts.options.batch)
    if fronts.parts.memory is not None:
        fronts.show(pairs[_trace(fronts, rays, pairs, statistics).traced])
        return
    while len(pairs):
        nearest = _rank(fronts, pairs) < batch
        now, pairs = pairs[nearest], pairs[~nearest]
        fronts.show(now)
        _trace(fronts, rays, now, statistics)
        pairs, batch = pairs[_query(fronts, rays, pairs, statistics)], min(2 * batch, fronts.options.batch)


def _rank(fronts: Fronts, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k,) int64: the number of nearer pairs of the same tile and set."""
    number, order = in_lists(fronts.pairs(pairs), fronts.key[pairs], fronts.sets)
    ordered = number[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])) if len(order) else order
    rank = np.empty(len(pairs), np.int64)
    rank[order] = np.arange(len(pairs)) - np.repeat(starts, np.diff(np.append(starts, len(pairs))))
    return rank
