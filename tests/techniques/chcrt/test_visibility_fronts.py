"""The query-pair hierarchy always covers each pair of a ray and a triangle exactly once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.bvh.block_tree import block_tree
from antumbra.bvh.nodes import boxes_of
from antumbra.engine.method_registry import BUILDERS
from antumbra.techniques.chcrt.occlusion_queries import Answers, tiles_of
from antumbra.techniques.chcrt.tree_parts import lists_of, part_order, parts_of
from antumbra.techniques.chcrt.visibility_fronts import INNER, INVISIBLE, VISIBLE, Fronts, trace_frame
from antumbra.techniques.tracer_options import ChcRtOptions
from antumbra.trace.tile import TileShape
from strength import examples


def _parts(n=3000, triangles=200, seed=0):
    rng = np.random.default_rng(seed)
    soup = (rng.normal(size=(n, 1, 3)) * 5 + rng.normal(size=(n, 3, 3)) * 0.2).astype(np.float32)
    return parts_of(block_tree(BUILDERS["bsah"].build(soup, 1)), ChcRtOptions(triangles=triangles)), soup


def _tiles(w=200, h=120, pixels=32):
    return tiles_of(TileShape(4, 4, -(-w // 4), -(-h // 4)), pixels)


class _Guessing:
    """Rays that answer at random."""

    def __init__(self, seed, any_hit=False):
        self.rng, self.any_hit, self.traced = np.random.default_rng(seed), any_hit, []

    def answer(self, pairs, threshold):
        counts = (self.rng.random(len(pairs.tile)) < 0.8).astype(np.int32)
        return Answers(counts, self.rng.random(len(pairs.tile)).astype(np.float32), 1)

    def trace(self, pairs, keys):
        self.traced.append((pairs, keys))
        return self.rng.random(len(keys)) < 0.5


def _lists(fronts, pairs, keys, front_to_back=True):
    return lists_of(pairs, keys, fronts.parts, fronts.tiles.smallest, fronts.sets, front_to_back)


def _covered(fronts):
    """For each set: how often the leaves of the hierarchy cover each pair of a smallest tile and a part."""
    tiles, parts = fronts.tiles, fronts.parts
    below = {}

    def under(row):
        if row not in below:
            kids = [k for k in parts.children[row] if k >= 0]
            below[row] = [part for k in kids for part in under(k)] if row < parts.inner else [row - parts.inner]
        return below[row]

    rows, columns = tiles.spans[-1, 3], tiles.spans[-1, 1]
    count = np.zeros((fronts.sets, rows, columns, len(parts.trees)), np.int64)
    for i in np.flatnonzero(fronts.state != INNER):
        x0, x1, y0, y1 = tiles.spans[fronts.tile[i]]
        for part in under(int(fronts.row[i])):
            count[fronts.set[i], y0:y1, x0:x1, part] += 1
    return count


@examples(15)
@given(seed=st.integers(0, 1000), sets=st.sampled_from([1, 3]), frames=st.integers(1, 5), any_hit=st.booleans())
def test_leaves_cover_everything_once(seed, sets, frames, any_hit):
    fronts = Fronts(_tiles(), _parts()[0], sets, ChcRtOptions(every=2))
    assert fronts.parts.inner > 5 and fronts.tiles.smallest > 5
    rays = _Guessing(seed, any_hit)
    for _ in range(frames):
        trace_frame(fronts, rays)
        assert (_covered(fronts) == 1).all()
        assert fronts.is_final(fronts.of(VISIBLE)).all()
    assert rays.traced


def test_what_was_visible_is_traced_first_and_once_a_frame():
    fronts = Fronts(_tiles(), _parts()[0], 1, ChcRtOptions(every=3))
    trace_frame(fronts, _Guessing(3))
    shown = fronts.of(VISIBLE)
    assert len(shown) > 3
    expected = fronts.pairs(shown)
    rays = _Guessing(4)
    trace_frame(fronts, rays)
    for got, wanted in zip(rays.traced[0][0], expected):
        np.testing.assert_array_equal(got, wanted)
    every = np.concatenate([pairs.tile.astype(np.int64) * 100_000 + pairs.row for pairs, _ in rays.traced])
    assert len(np.unique(every)) == len(every)


@pytest.mark.parametrize("front_to_back", [True, False])
def test_lists_have_each_visible_part_once_in_their_order(front_to_back):
    fronts = Fronts(_tiles(), _parts()[0], 2, ChcRtOptions())
    trace_frame(fronts, _Guessing(3))
    shown, parts = fronts.of(VISIBLE), fronts.parts
    lists = _lists(fronts, fronts.pairs(shown), fronts.key[shown], front_to_back)
    keys = {(t, s, r - parts.inner): k for t, s, r, k in zip(fronts.tile, fronts.set, fronts.row, fronts.key)}
    assert len(lists.items) == len(shown) and np.diff(lists.starts).max() > 2
    for number, (begin, end) in enumerate(zip(lists.starts[:-1], lists.starts[1:])):
        items = lists.items[begin:end]
        by = parts.order[items] if not front_to_back else [keys[*divmod(number, 2), k] for k in items]
        assert (np.diff(by) >= 0).all() and len(set(items)) == len(items)


def test_parts_come_in_the_order_of_the_tree():
    parts = _parts()[0]
    np.testing.assert_array_equal(parts.order, np.arange(len(parts.trees)))  # in the order of `parts_of`
    np.testing.assert_array_equal(part_order(np.array([[1, 4], [3, 2], [-1, -1], [-1, -1], [-1, -1]]), 2), [1, 0, 2])


class _Counting(_Guessing):
    """Rays that meet everything, and record how many pairs each query has."""

    def answer(self, pairs, threshold):
        self.asked = [*getattr(self, "asked", []), len(pairs.tile)]
        return Answers(np.ones(len(pairs.tile), np.int32), np.zeros(len(pairs.tile), np.float32), 1)


def test_visible_pairs_of_nearest_hits_are_queried_every_few_frames():
    fronts = Fronts(_tiles(), _parts()[0], 1, ChcRtOptions(every=3))
    trace_frame(fronts, _Counting(0))
    n, asked = len(fronts.of(VISIBLE)), 0
    assert n > 100 and not len(fronts.of(INVISIBLE))
    for _ in range(3):
        rays = _Counting(0)
        trace_frame(fronts, rays)
        assert 0 < sum(rays.asked) < n
        asked += sum(rays.asked)
    assert asked == n


def test_visible_pairs_of_any_hit_rays_are_queried_unless_they_block():
    class Blocking(_Counting):
        def trace(self, pairs, keys):
            self.idle = ~super().trace(pairs, keys)
            return ~self.idle

    fronts = Fronts(_tiles(), _parts()[0], 1, ChcRtOptions(every=3))
    trace_frame(fronts, _Counting(0, any_hit=True))
    for seed in range(3):
        rays = Blocking(seed, any_hit=True)
        trace_frame(fronts, rays)
        assert 0 < sum(rays.asked) == rays.idle.sum() < len(fronts.of(VISIBLE))


def test_invisibility_is_pulled_up_one_level_a_frame():
    class Blind(_Guessing):
        def answer(self, pairs, threshold):
            return Answers(np.zeros(len(pairs.tile), np.int32), np.zeros(len(pairs.tile), np.float32), 1)

    class Seeing(_Guessing):
        def answer(self, pairs, threshold):
            return Answers(np.ones(len(pairs.tile), np.int32), np.zeros(len(pairs.tile), np.float32), 1)

    fronts = Fronts(_tiles(), _parts()[0], 1, ChcRtOptions(every=1))
    trace_frame(fronts, Seeing(0))
    sizes = [len(fronts)]
    while len(fronts) > 1:
        trace_frame(fronts, Blind(0))
        sizes.append(len(fronts))
        assert sizes[-1] < sizes[-2] and len(sizes) < 40
    assert len(sizes) > 5 and fronts.state.tolist() == [INVISIBLE]


def test_domains_are_split_by_their_shares():
    """A node larger than t_q times the tile is split; otherwise the tile is split [Mattausch et al. 2015, Sec. 4.4]."""
    parts, _ = _parts()
    for weight, in_object in ((1e-6, True), (1e6, False)):
        fronts = Fronts(_tiles(64, 64, 32), parts, 1, ChcRtOptions(weight=weight))
        children = fronts.split(np.array([0]))
        same_tile = fronts.tile[children] == fronts.tile[0]
        assert same_tile.all() == in_object and len(children) == (2 if in_object else 4)


def test_parts_hold_all_triangles_once_within_the_limits():
    parts, soup = _parts(triangles=150)
    tree = parts.keeps
    seen = []

    def below(link, depth):
        assert depth <= ChcRtOptions().height
        if link >= 0:
            return below(tree.links[link, 12], depth + 1) + below(tree.links[link, 13], depth + 1)
        block, n = ~link >> 5, ~link & 31
        return tree.prim_ids[tree.slots[block, :n]].tolist()

    for k, root in enumerate(parts.trees[:, -1]):
        mine = below(int(root), 0)
        assert 0 < len(mine) <= 150
        box = boxes_of(parts.lines)[parts.inner + k]
        corners = soup[mine].reshape(-1, 3)
        np.testing.assert_array_equal(box, [corners.min(0), corners.max(0)])
        seen += mine
    assert sorted(seen) == list(range(len(soup)))
    assert parts.share[0] == 1.0 and (parts.share <= 1.0).all()


@pytest.mark.parametrize("n", [0, 1, 2, 17])
def test_small_scenes_are_one_part(n):
    parts, _ = _parts(n)
    assert parts.inner == 0 and len(parts.trees) == len(parts.lines) == 1 and np.isfinite(parts.lines[:, :12]).all()


@pytest.mark.parametrize("w, h, pixels", [(200, 120, 32), (16, 16, 64), (1000, 1, 64), (33, 700, 16)])
def test_tiles_are_a_quadtree(w, h, pixels):
    shape = TileShape(4, 4, -(-w // 4), -(-h // 4)) if h > 1 else TileShape(16, 1, -(-w // 16), 1)
    tiles = tiles_of(shape, pixels)
    whole = tiles.spans[-1]
    assert whole[0] == whole[2] == 0 and tiles.share[-1] == 1.0
    covered = np.zeros((whole[3], whole[1]), np.int64)
    for x0, x1, y0, y1 in tiles.spans[: tiles.smallest]:
        covered[y0:y1, x0:x1] += 1
    assert (covered == 1).all()
    for k in range(tiles.smallest, len(tiles.spans)):
        kids = tiles.children[k][tiles.children[k] >= 0]
        assert len(kids) and np.isclose(tiles.share[kids].sum(), tiles.share[k])
