"""One frame of CHC+RT: the three phases of Algorithm 1 [Mattausch et al. 2015, Sec. 5.1]."""

from collections.abc import Callable
from contextlib import closing
from time import perf_counter
from typing import NamedTuple, Protocol

import numpy as np

from .fronts import INVISIBLE, VISIBLE, Fronts
from .queries import Answers

_FIRST_BATCH = 4  # newly visible parts of a tile in the first batch; batches double up to `Options.batch`


class RaySet(Protocol):
    """The rays of a picture, as the schedule sees them."""

    front_to_back: bool  # True: rays go through lists front to back; False: in the tree's order of parts

    def ask(self, fronts: Fronts, pairs: np.ndarray, again: bool) -> Answers:
        """Answer occlusion queries for pairs; `again`: the pairs have just been traced.

        A part that blocks a ray must stay visible for the next frame. So queries of traced pairs count blocked rays,
        too.
        """
        ...

    def trace(self, lists: "Lists") -> None:
        """Trace the rays of each tile and set through lists of parts, and update the cells of these tiles."""
        ...


class Lists(NamedTuple):
    """For each smallest tile and each set, the parts that its rays go through, in order."""

    starts: np.ndarray  # (tiles * sets + 1,) int32: list number tile * sets + set
    items: np.ndarray  # (n,) int32: parts
    tiles: np.ndarray  # (k,) int32: the tiles whose lists are not empty


Progress = Callable[[int, int], None]


class Statistics:
    """The times and counts of a frame, by the phases of Fig. 8.

    progress : function of (done, total) or None
        It receives the number of parts traced, and the number of parts requested from the part memory.
    """

    def __init__(self, progress: Progress | None = None):
        self.progress = progress
        self.seconds = dict.fromkeys(("phase 1", "phase 2", "phase 3"), 0.0)
        self.queries = self.multi_queries = self.traced = 0
        self._last = perf_counter()

    def lap(self, phase: str) -> None:
        now = perf_counter()
        self.seconds[phase] += now - self._last
        self._last = now

    def as_dict(self, fronts: Fronts) -> dict:
        """The statistics as a dict, for people and benchmarks."""
        visible = int(np.count_nonzero(fronts.state == VISIBLE))
        hidden = int(np.count_nonzero(fronts.state == INVISIBLE))
        return {
            **self.seconds, "queries": self.queries, "multi_queries": self.multi_queries, "traced pairs": self.traced,
            "visible": visible, "invisible": hidden, "pairs": len(fronts),
        }  # fmt: skip


def _in_lists(fronts: Fronts, pairs: np.ndarray, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(the list of each pair, the order of the pairs by list, and by key within a list)."""
    number = fronts.tile[pairs].astype(np.int64) * fronts.sets + fronts.set[pairs]
    return number, np.lexsort((keys, number))


def lists_of(fronts: Fronts, pairs: np.ndarray, front_to_back: bool) -> Lists:
    """The lists of final pairs: front to back, or in the tree's order of parts.

    Any-hit rays are fastest in the tree's order. A tile may begin inside the boxes of many parts, which are then all
    equally near. There, front to back took 1.6 times as long in foliage (San Miguel).
    """
    parts = fronts.parts
    keys = fronts.key[pairs] if front_to_back else parts.order[fronts.row[pairs] - parts.inner]
    number, order = _in_lists(fronts, pairs, keys)
    counts = np.bincount(number, minlength=fronts.tiles.smallest * fronts.sets)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    items = (fronts.row[pairs][order] - fronts.parts.inner).astype(np.int32)
    return Lists(starts, items, np.unique(fronts.tile[pairs]).astype(np.int32))


def trace_frame(fronts: Fronts, rays: RaySet, progress: Progress | None = None) -> Statistics:
    """Trace the rays of a frame, and store the visible pairs in `fronts` for the next frame."""
    told = Statistics(progress)
    shown, hidden = fronts.of(VISIBLE), fronts.of(INVISIBLE)
    _trace(fronts, rays, shown, told)
    told.lap("phase 1")
    due = shown[fronts.due[shown] <= fronts.frame]
    seen, still = _ask(fronts, rays, hidden, told), _ask(fronts, rays, due, told, True)
    fronts.due[due] += fronts.options.every
    fronts.state[due[~still]] = INVISIBLE
    told.lap("phase 2")
    _traverse(fronts, rays, hidden[seen], told)
    fronts.end_frame()
    told.lap("phase 3")
    return told


def _ask(fronts: Fronts, rays: RaySet, pairs: np.ndarray, told: Statistics, again: bool = False) -> np.ndarray:
    """Query pairs. Return (k,) bool: which pairs have more rays than the threshold."""
    answers = rays.ask(fronts, pairs, again)
    fronts.key[pairs] = answers.keys
    told.queries += len(pairs)
    told.multi_queries += answers.groups
    return answers.counts > fronts.options.threshold


def _trace(fronts: Fronts, rays: RaySet, pairs: np.ndarray, told: Statistics) -> np.ndarray:
    """Trace the rays of final pairs, parts in memory first (Sec. 5.4). Return the pairs that were traced.

    The other parts follow nearest first, each once for all its pairs. A pair is left out if all its rays find a hit
    before its part is read.
    """
    memory = fronts.parts.memory
    if memory is None or not len(pairs):
        told.traced += len(pairs)
        rays.trace(lists_of(fronts, pairs, rays.front_to_back))
        return pairs
    parts = fronts.row[pairs] - fronts.parts.inner

    def still(asked: np.ndarray) -> np.ndarray:
        """Which parts do unblocked rays still meet? Called before the parts are read."""
        those = pairs[np.isin(parts, asked)]
        met = those[rays.ask(fronts, those, False).counts > fronts.options.threshold]
        return np.isin(asked, fronts.row[met] - fronts.parts.inner)

    wanted, done, traced = _nearest_first(parts, fronts.key[pairs]), 0, [pairs[:0]]
    with closing(memory.groups(wanted, still)) as groups:
        for group in groups:
            traced.append(pairs[np.isin(parts, group)])
            told.traced += len(traced[-1])
            rays.trace(lists_of(fronts, traced[-1], rays.front_to_back))
            done += len(group)
            if told.progress is not None:
                told.progress(done, len(wanted))
    return np.concatenate(traced)


def _nearest_first(parts: np.ndarray, keys: np.ndarray) -> np.ndarray:
    """The parts without repetition, in the order of their least keys."""
    order = np.argsort(keys, kind="stable")
    _, first = np.unique(parts[order], return_index=True)
    return parts[order][np.sort(first)]


def _traverse(fronts: Fronts, rays: RaySet, seen: np.ndarray, told: Statistics) -> None:
    """Phase 3: split newly visible pairs down to final pairs, and trace the final pairs.

    In core this goes batch by batch. A batch has the nearest parts of each tile. The parts behind them are queried
    again before they are traced. Out of core, the part memory does both.
    """
    waiting = [seen[:0]]
    while len(seen):
        final = fronts.is_final(seen)
        waiting.append(seen[final])
        children = fronts.split(seen[~final])
        seen = children[_ask(fronts, rays, children, told)]
    pairs, batch = np.concatenate(waiting), min(_FIRST_BATCH, fronts.options.batch)
    if fronts.parts.memory is not None:
        fronts.show(_trace(fronts, rays, pairs, told))
        return
    while len(pairs):
        nearest = _rank(fronts, pairs) < batch
        now, pairs = pairs[nearest], pairs[~nearest]
        fronts.show(now)
        _trace(fronts, rays, now, told)
        pairs, batch = pairs[_ask(fronts, rays, pairs, told)], min(2 * batch, fronts.options.batch)


def _rank(fronts: Fronts, pairs: np.ndarray) -> np.ndarray:
    """(k,) int: the number of nearer pairs of the same tile and set."""
    number, order = _in_lists(fronts, pairs, fronts.key[pairs])
    ordered = number[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])) if len(order) else order
    rank = np.empty(len(pairs), np.int64)
    rank[order] = np.arange(len(pairs)) - np.repeat(starts, np.diff(np.append(starts, len(pairs))))
    return rank
