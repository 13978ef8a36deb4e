"""The query-pair hierarchy: pairs of a screen tile and a node, and which pairs were visible.

Its leaves are the *visible front*, pairs that are traced, and the *invisible front*, pairs that are skipped. Inner
pairs record the splits, so that invisible pairs can be pulled up [Mattausch et al. 2015, Sec. 4.3, 4.5, 5.1].

Each ray set has its own hierarchy. All rays to a light form one set. Each direction of ambient occlusion or of diffuse
rays forms a set (Sec. 5.3). All hierarchies share the same arrays, because their queries are asked together.
"""

import numpy as np

from .options import Options
from .parts import Parts
from .queries import Pairs
from .tiles import Tiles

INNER, INVISIBLE, VISIBLE = range(3)


class Fronts:
    """The pairs of all sets, n of them, as arrays.

    tile, set, row : (n,) int32
        A tile of `Tiles`, a ray set, a row of `Parts`.
    parent : (n,) int32
        The pair that was split; -1 for the first of each set.
    state : (n,) int8
        INNER, INVISIBLE or VISIBLE.
    due : (n,) int64
        The frame in which a visible pair is queried again.
    key : (n,) float32
        The parameter at which rays last entered its box.
    """

    def __init__(self, tiles: Tiles, parts: Parts, sets: int, options: Options):
        self.tiles, self.parts, self.sets, self.options = tiles, parts, sets, options
        self.frame = 0
        self._random = np.random.default_rng(0)
        self._restart()

    def _restart(self) -> None:
        """Forget all pairs but the first of each set: the whole screen and the whole scene."""
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

    def begin_frame(self) -> None:
        """Keep the pairs of the frame before, if the options say so (Sec. 4.5)."""
        if not self.options.keep:
            self._restart()

    def pairs(self, chosen: np.ndarray) -> Pairs:
        """Some of the pairs, by their indices."""
        return Pairs(self.tile[chosen], self.set[chosen], self.row[chosen])

    def of(self, state: int) -> np.ndarray:
        """(k,) int64: the pairs in a state."""
        return np.flatnonzero(self.state == state)

    def is_final(self, pairs: np.ndarray) -> np.ndarray:
        """(k,) bool: which pairs are final. A final pair is never split: a smallest tile and a part."""
        return (self.tile[pairs] < self.tiles.smallest) & (self.row[pairs] >= self.parts.inner)

    def split(self, pairs: np.ndarray) -> np.ndarray:
        """Split pairs that are not final. Return their children, which are queried next.

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
        there = (tile2 >= 0) & (row2 >= 0)
        self.state[pairs] = INNER
        return self._add(tile2[there], row2[there], np.repeat(pairs, there.sum(1)))

    def _add(self, tile, row, parent) -> np.ndarray:
        first, n = len(self), len(tile)
        self.tile, self.row = np.append(self.tile, tile), np.append(self.row, row)
        self.set = np.append(self.set, self.set[parent])
        self.parent = np.append(self.parent, parent.astype(np.int32))
        self.state = np.append(self.state, np.full(n, INVISIBLE, np.int8))
        self.due = np.append(self.due, np.zeros(n, np.int64))
        self.key = np.append(self.key, np.ones(n, np.float32))
        return np.arange(first, first + n)

    def show(self, pairs: np.ndarray) -> None:
        """Make pairs visible. Their first queries are spread at random over the next frames (Sec. 5.1)."""
        self.state[pairs] = VISIBLE
        self.due[pairs] = self.frame + self._random.integers(1, self.options.every + 1, len(pairs))

    def end_frame(self) -> None:
        """Pull invisibility up by at most one level (Sec. 5.1). Forget the children of pairs that became invisible."""
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
        kept = ~(has_parent & pulled[self.parent])
        new = np.cumsum(kept, dtype=np.int32) - 1
        self.parent = np.where(has_parent, new[self.parent], -1)[kept].astype(np.int32)
        self.tile, self.set, self.row = self.tile[kept], self.set[kept], self.row[kept]
        self.state, self.due, self.key = self.state[kept], self.due[kept], self.key[kept]
