"""One frame of CHC+RT: the three phases of Algorithm 1 [Mattausch et al. 2015, Sec. 5.1]."""

from collections.abc import Callable
from contextlib import closing
from time import perf_counter
from typing import Protocol

import numpy as np

from .fronts import INVISIBLE, VISIBLE, Fronts
from .lists import in_lists
from .queries import Answers, Pairs

_FIRST_BATCH = 4  # newly visible parts of a tile in the first batch; batches double up to `Options.batch`


class RaySet(Protocol):
    """The rays of a picture, as the schedule sees them: one ray set, or several."""

    def ask(self, pairs: Pairs, threshold: int, again: bool) -> Answers:
        """Answer occlusion queries for pairs; `again`: the pairs have just been traced.

        A part that blocks a ray must stay visible for the next frame. So queries of traced pairs count blocked rays,
        too.
        """
        ...

    def trace(self, pairs: Pairs, keys: np.ndarray) -> None:
        """Trace the rays of final pairs, and update what the queries know of them; `keys`: see `Answers`."""
        ...

    def marker(self) -> Callable | None:
        """The function that marks the hits so far: see `store.residency.Mark`. None: their triangles are not wanted."""
        ...


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


def trace_frame(fronts: Fronts, rays: RaySet, progress: Progress | None = None) -> Statistics:
    """Trace the rays of a frame, and store the visible pairs in `fronts` for the next frame."""
    fronts.begin_frame()
    statistics = Statistics(progress)
    shown, hidden = fronts.of(VISIBLE), fronts.of(INVISIBLE)
    _trace(fronts, rays, shown, statistics)
    statistics.lap("phase 1")
    due = shown[fronts.due[shown] <= fronts.frame]
    seen, still = _ask(fronts, rays, hidden, statistics), _ask(fronts, rays, due, statistics, True)
    fronts.due[due] += fronts.options.every
    fronts.state[due[~still]] = INVISIBLE
    statistics.lap("phase 2")
    _traverse(fronts, rays, hidden[seen], statistics)
    fronts.end_frame()
    statistics.lap("phase 3")
    return statistics


def _ask(fronts: Fronts, rays: RaySet, pairs: np.ndarray, statistics: Statistics, again: bool = False) -> np.ndarray:
    """Query pairs. Return (k,) bool: which pairs have more rays than the threshold."""
    answers = rays.ask(fronts.pairs(pairs), fronts.options.threshold, again)
    fronts.key[pairs] = answers.keys
    statistics.queries += len(pairs)
    statistics.multi_queries += answers.groups
    return answers.counts > fronts.options.threshold


def _trace(fronts: Fronts, rays: RaySet, pairs: np.ndarray, statistics: Statistics) -> np.ndarray:
    """Trace the rays of final pairs, parts in memory first (Sec. 5.4). Return the pairs that were traced.

    The other parts follow nearest first, each once for all its pairs. A pair is left out if all its rays find a hit
    before its part is read.
    """
    memory = fronts.parts.memory
    if memory is None or not len(pairs):
        statistics.traced += len(pairs)
        rays.trace(fronts.pairs(pairs), fronts.key[pairs])
        return pairs
    parts = fronts.row[pairs] - fronts.parts.inner

    def still(asked: np.ndarray) -> np.ndarray:
        """Which parts do unblocked rays still meet? Called before the parts are read."""
        those = pairs[np.isin(parts, asked)]
        threshold = fronts.options.threshold
        met = those[rays.ask(fronts.pairs(those), threshold, False).counts > threshold]
        return np.isin(asked, fronts.row[met] - fronts.parts.inner)

    wanted, done, traced = _nearest_first(parts, fronts.key[pairs]), 0, [pairs[:0]]
    with closing(memory.groups(wanted, still, rays.marker())) as groups:
        for group in groups:
            traced.append(pairs[np.isin(parts, group)])
            statistics.traced += len(traced[-1])
            rays.trace(fronts.pairs(traced[-1]), fronts.key[traced[-1]])
            done += len(group)
            if statistics.progress is not None:
                statistics.progress(done, len(wanted))
    return np.concatenate(traced)


def _nearest_first(parts: np.ndarray, keys: np.ndarray) -> np.ndarray:
    """The parts without repetition, in the order of their least keys."""
    order = np.argsort(keys, kind="stable")
    _, first = np.unique(parts[order], return_index=True)
    return parts[order][np.sort(first)]


def _traverse(fronts: Fronts, rays: RaySet, seen: np.ndarray, statistics: Statistics) -> None:
    """Phase 3: split newly visible pairs down to final pairs, and trace the final pairs.

    In core this goes batch by batch. A batch has the nearest parts of each tile. The parts behind them are queried
    again before they are traced. Out of core, the part memory does both.
    """
    waiting = [seen[:0]]
    while len(seen):
        final = fronts.is_final(seen)
        waiting.append(seen[final])
        children = fronts.split(seen[~final])
        seen = children[_ask(fronts, rays, children, statistics)]
    pairs, batch = np.concatenate(waiting), min(_FIRST_BATCH, fronts.options.batch)
    if fronts.parts.memory is not None:
        fronts.show(_trace(fronts, rays, pairs, statistics))
        return
    while len(pairs):
        nearest = _rank(fronts, pairs) < batch
        now, pairs = pairs[nearest], pairs[~nearest]
        fronts.show(now)
        _trace(fronts, rays, now, statistics)
        pairs, batch = pairs[_ask(fronts, rays, pairs, statistics)], min(2 * batch, fronts.options.batch)


def _rank(fronts: Fronts, pairs: np.ndarray) -> np.ndarray:
    """(k,) int: the number of nearer pairs of the same tile and set."""
    number, order = in_lists(fronts.pairs(pairs), fronts.key[pairs], fronts.sets)
    ordered = number[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])) if len(order) else order
    rank = np.empty(len(pairs), np.int64)
    rank[order] = np.arange(len(pairs)) - np.repeat(starts, np.diff(np.append(starts, len(pairs))))
    return rank
