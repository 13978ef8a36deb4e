"""Optimise a finished BVH by reinsertion [Bittner et al. 2013] [Meister and Bittner 2018a].

Insertion-based optimisation is from [Bittner et al. 2013, "Fast insertion-based optimization of bounding volume
hierarchies"], its parallel form from [Meister and Bittner 2018a, "Parallel reinsertion for bounding volume hierarchy
optimization"]. For each large subtree, branch and bound finds the place in the tree that lowers the SAH cost most. All
threads search at once, while the tree stays unchanged. Then the moves are made, the most profitable first. This repeats
for a few rounds.

Departures from the papers:

- Only the subtrees with the largest boxes are candidates, a tenth of all at first. Most scenes gain nearly everything
  there. If the smaller half of the candidates contributes, twice as many follow in the next round.
- Conflicting moves are not excluded by locks. Instead, moves are made one after the other, and a move that no longer
  pays off is undone. So the result is bitwise identical for any number of threads.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import (
    bits,
    get,
    load8,
    load16,
    mask_from_bits16,
    minimum,
    ptr,
    put,
    select,
    shuffle,
    stack_array,
    stack_f32,
    stack_i32,
    store,
)
from .nodes import CHILDREN, LINK, MAX_DEPTH, Bvh, aligned_empty, bvh_leaf, is_leaf, line_at, link_at
from .tree_layout import cheapest_leaves, cut_tree, relayout
from .tree_quality import sah_cost
from .triangle_bounds import area_scale_of, half_area, write_boxes

_SEARCH_STACK = 2 * MAX_DEPTH + 2
_STACK_SIZE = MAX_DEPTH + 2
_COORDINATES = 0x77  # lanes of a box
_AREA = 3  # lane of a box with half its area
_CHUNK = 1024  # items that a thread takes at a time
_FIRST_SHARE = 0.1  # of the items: candidates of the first round
_SPREAD = 0.05  # share of the gain by the smaller half of the candidates above which more follow
_LEAST_CANDIDATES = 1024
_FEW = 0.002  # fraction of the candidates; fewer moves end the rounds
_MANY = 256  # places tried per candidate; a round that tries more is the last. Ordinary scenes take 20 to 65
_LEAST = np.float32(2.0**-16)  # minimum gain of a move, relative to the subtree's area


class LooseTree(NamedTuple):
    """A tree of m nodes and m + 1 leaves in a form that allows moves. Items are the nodes, then the leaves."""

    parents: NDArray[np.int32]  # (2 m + 1,) int32: item; -1 for the root, item 0
    children: NDArray[np.int32]  # (m, 2) int32: items
    heights: NDArray[np.int32]  # (2 m + 1,) int32: nodes on the longest path down; 0 for a leaf
    boxes: NDArray[np.float32]  # (2 m + 1, 8) float32: as in `triangle_bounds`, with half the area in the fourth lane
    links: NDArray[np.int32]  # (m + 1,) int32: links to the leaves
    scale: np.float32  # see `top_down.Settings`


class LoosePointers(NamedTuple):
    """Pointers to the arrays of a `LooseTree`, for hot kernels."""

    parents: I32Ptr  # int32 *
    children: I32Ptr  # int32 *, 2 per node
    heights: I32Ptr  # int32 *
    boxes: F32Ptr  # float32 *, 8 per item
    n_nodes: int
    scale: np.float32


@inlined
def _pointers_of(loose):
    """Pointers to the arrays of a `LooseTree`, which must outlive them."""
    return LoosePointers(
        ptr(loose.parents), ptr(loose.children), ptr(loose.heights), ptr(loose.boxes), len(loose.children), loose.scale
    )


@inlined
def _area(tree, item):
    return get(tree.boxes, item * 8 + _AREA)


@inlined
def _set_box(tree, item, box):
    store(tree.boxes, item * 8, box)
    put(tree.boxes, item * 8 + _AREA, half_area(box, tree.scale))


@inlined
def _sibling(tree, item):
    parent = get(tree.parents, item)
    left_child = get(tree.children, 2 * parent)
    return np.int64(get(tree.children, 2 * parent + 1) if left_child == item else left_child)


@inlined
def _update_node(tree, node):
    """Update a node's box and height from its children, and return (growth of its area, whether anything changed)."""
    left_child, right_child = get(tree.children, 2 * node), get(tree.children, 2 * node + 1)
    box = minimum(load8(tree.boxes, left_child * 8), load8(tree.boxes, right_child * 8))
    height = 1 + max(get(tree.heights, left_child), get(tree.heights, right_child))
    same = bits(box == load8(tree.boxes, node * 8)) & _COORDINATES == _COORDINATES
    before = _area(tree, node)
    changed = not same or height != get(tree.heights, node)
    _set_box(tree, node, box)
    put(tree.heights, node, height)
    return _area(tree, node) - before, changed


@kernel
def _loosen(bvh, loose):
    """Convert a BVH with nodes in depth-first order to a loose tree."""
    nodes, tree, n, pair, leaves = ptr(bvh.nodes), _pointers_of(loose), len(bvh.nodes), stack_f32(16), 0
    for node in range(n):
        line = shuffle(load16(nodes, line_at(node)), 0, 4, 8, 0, 2, 6, 10, 2, 1, 5, 9, 1, 3, 7, 11, 3)
        store(pair, 0, select(mask_from_bits16(0xF0F0), -line, line))
        for side in range(2):
            item = np.int64(bvh.links[node, LINK + side])
            if item < 0:
                loose.links[leaves] = item
                item = n + leaves
                put(tree.heights, item, 0)
                leaves += 1
            _set_box(tree, item, load8(pair, 8 * side))
            put(tree.parents, item, node)
            put(tree.children, 2 * node + side, item)
    put(tree.parents, 0, -1)
    for node in range(n - 1, -1, -1):
        _update_node(tree, node)


class InsertionPlace(NamedTuple):
    """The best place found for an item."""

    gain: np.float32  # decrease of the tree's SAH cost, times half the area of its root
    place: np.int64  # its new sibling; -1 if it stays
    visits: np.int64  # number of places tried


@kernel
def _search(tree, item, root, gain, best, stack, gains):
    """The better of `best` and the best place below `root`."""
    # In: tree, item, root; gain, float32, cost saved by removing the item; best, the best `InsertionPlace` so far
    # Scratch: stack, int32 *, and gains, float32 *, _SEARCH_STACK each
    box, area = load8(tree.boxes, item * 8), _area(tree, item)
    put(stack, 0, root)
    put(gains, 0, gain)
    height, visits = 1, best.visits
    while height > 0:
        height -= 1
        visits += 1
        place, gain = get(stack, height), get(gains, height)
        merged = half_area(minimum(load8(tree.boxes, place * 8), box), tree.scale)
        if gain - merged > best.gain:
            best = InsertionPlace(gain - merged, place, visits)
        below = gain + _area(tree, place) - merged  # `place` grows
        if place < tree.n_nodes and below - area > best.gain:  # the new node is at least as large as the item
            for side in range(2):
                put(stack, height, get(tree.children, 2 * place + side))
                put(gains, height, below)
                height += 1
    return InsertionPlace(best.gain, best.place, visits)


@kernel
def _best_place(tree, item, stack, gains):
    """The best place of an item below the siblings of its ancestors [Meister and Bittner 2018a, Alg. 1]."""
    path = get(tree.parents, item)
    sibling, gain = _sibling(tree, item), _area(tree, path)
    shrunk = load8(tree.boxes, sibling * 8)
    best = _search(tree, item, sibling, gain, InsertionPlace(_LEAST * _area(tree, item), -1, 0), stack, gains)
    while path > 0:
        other = _sibling(tree, path)
        best = _search(tree, item, other, gain, best, stack, gains)
        path = get(tree.parents, path)
        shrunk = minimum(shrunk, load8(tree.boxes, other * 8))
        gain += _area(tree, path) - half_area(shrunk, tree.scale)
        if path > 0 and gain - _area(tree, path) > best.gain:
            best = InsertionPlace(gain - _area(tree, path), path, best.visits)
    return best


class BestPlaces(NamedTuple):
    """The best places of n items, and the number of places tried."""

    gains: np.ndarray  # (n,) float32
    places: np.ndarray  # (n,) int64: the new siblings, -1 where the item stays
    visits: np.ndarray  # (n,) int64


@kernel
def find_places(ticket, loose, candidates, best):
    """Worker: find the best place of each of the items `candidates`. The root's children stay."""
    tree = _pointers_of(loose)
    stack, scratch = stack_i32(_SEARCH_STACK), stack_f32(_SEARCH_STACK)
    for k in items(ticket):
        place, item = InsertionPlace(np.float32(0.0), -1, 0), np.int64(candidates[k])
        if item > 0 and get(tree.parents, item) > 0:
            place = _best_place(tree, item, stack, scratch)
        best.gains[k], best.places[k], best.visits[k] = place


@kernel
def _update_ancestors(tree, node):
    """Update the changed nodes from `node` upwards, and return the total growth of their areas."""
    growth = np.float32(0.0)
    while node >= 0:
        node_growth, changed = _update_node(tree, node)
        growth += node_growth
        node = get(tree.parents, node) if changed else -1
    return growth


@inlined
def _replace_child(tree, new, old):
    """Replace the child `old` by `new`, and return their parent."""
    parent = get(tree.parents, old)
    put(tree.children, 2 * parent + (0 if get(tree.children, 2 * parent) == old else 1), new)
    put(tree.parents, new, parent)
    return parent


@kernel
def _move(tree, item, place):
    """Make `item` the sibling of `place` under its reused parent node, and return the total growth of areas."""
    node, sibling = get(tree.parents, item), _sibling(tree, item)
    growth = -_area(tree, node)
    growth += _update_ancestors(tree, _replace_child(tree, sibling, node))
    parent = _replace_child(tree, node, place)
    put(tree.children, 2 * node, place)
    put(tree.children, 2 * node + 1, item)
    put(tree.parents, place, node)
    put(tree.parents, item, node)
    _update_node(tree, node)
    return growth + _area(tree, node) + _update_ancestors(tree, parent)


@kernel
def _can_move(tree, item, place):
    """Whether the move changes the tree, `place` is not below the item, and the depth stays within MAX_DEPTH."""
    if get(tree.parents, item) <= 0 or place <= 0 or place == get(tree.parents, item) or place == _sibling(tree, item):
        return False
    node, depth = np.int64(place), 0
    while node > 0:
        if node == item:
            return False
        node = get(tree.parents, node)
        depth += 1
    return depth + 1 + max(get(tree.heights, item), get(tree.heights, place)) <= MAX_DEPTH


@kernel
def _make_moves(loose, items, places):
    """Make the moves that still pay off, in this order, and return their number."""
    tree, n_moves = _pointers_of(loose), 0
    for k in range(len(items)):
        item, place = np.int64(items[k]), np.int64(places[k])
        if _can_move(tree, item, place):
            sibling = _sibling(tree, item)
            if _move(tree, item, place) < np.float32(0.0):
                n_moves += 1
            else:
                _move(tree, item, sibling)
    return n_moves


@kernel
def _write_nodes(loose, bvh):
    """Write the nodes of a loose tree, depth first."""
    tree, nodes, links = _pointers_of(loose), ptr(bvh.nodes), ptr(bvh.links)
    stack, n = stack_array(np.int64, _STACK_SIZE, 2), 0
    stack[0, 0], stack[0, 1], height = 0, -1, 1
    while height > 0:
        height -= 1
        item, word = stack[height]
        if word >= 0:
            put(links, word, n if item < tree.n_nodes else loose.links[item - tree.n_nodes])
        if item >= tree.n_nodes:
            continue
        left_child, right_child = get(tree.children, 2 * item), get(tree.children, 2 * item + 1)
        write_boxes(nodes, n, load8(tree.boxes, left_child * 8), load8(tree.boxes, right_child * 8))
        stack[height, 0], stack[height, 1] = right_child, link_at(n, 1)
        stack[height + 1, 0], stack[height + 1, 1] = left_child, link_at(n, 0)
        height, n = height + 2, n + 1


def _make_loose(bvh: Bvh) -> LooseTree:
    m = len(bvh.nodes)
    numbers = np.empty((2, 2 * m + 1), np.int32)
    boxes = aligned_empty((2 * m + 1, 8), "f4")
    scale = area_scale_of(bvh)
    loose = LooseTree(numbers[0], np.empty((m, 2), np.int32), numbers[1], boxes, np.empty(m + 1, np.int32), scale)
    _loosen(bvh, loose)
    return loose


def _largest_leaf(links: NDArray[np.int32]) -> int:
    ends = links[:, CHILDREN]
    return int(bvh_leaf(ends[is_leaf(ends)]).count.max())


def _least_area(loose: LooseTree, share: float) -> np.float32:
    """The least area among a share of the items, those with the largest areas."""
    areas = loose.boxes[:, _AREA]
    count = max(round(share * len(areas)), _LEAST_CANDIDATES)
    return np.float32(0.0) if count >= len(areas) else np.partition(areas, -count)[-count]


def _is_spread(areas: NDArray[np.float32], best: BestPlaces) -> bool:
    """Whether the smaller half of the candidates contributes to the gain; `areas`: those of the candidates."""
    gains = np.where(best.places >= 0, best.gains.astype(np.float64), 0.0)
    return bool(gains[areas < np.median(areas)].sum() > _SPREAD * gains.sum())


def reinsert(bvh: Bvh, threads: int | None = None, rounds: int = 5) -> Bvh:
    """A tree of the same triangles with a lower SAH cost, or `bvh` itself; identical for any number of threads.

    Parameters
    ----------
    bvh : Bvh
        Its nodes must be in depth-first order, as from every builder. It is not modified.
    rounds : int
        Maximum number of rounds. They end earlier once they move few subtrees, or when the bounds exclude few places,
        as among triangles with a common centroid.

    Notes
    -----
    Leaves are moved unchanged. Finally, subtrees become leaves where this is cheaper. These leaves have at most as many
    triangles as the largest leaf of `bvh`.
    """
    threads, m = thread_count(threads), len(bvh.nodes)
    if m < 3:
        return bvh
    loose, share = _make_loose(bvh), _FIRST_SHARE
    least = _least_area(loose, share)
    for _ in range(rounds):
        candidates = np.flatnonzero(loose.boxes[:, _AREA] >= least)
        n, areas = len(candidates), loose.boxes[candidates, _AREA]
        best = BestPlaces(np.empty(n, np.float32), np.empty(n, np.int64), np.empty(n, np.int64))
        run(find_places, threads, new_ticket(n, _CHUNK), loose, candidates, best)
        movable = np.flatnonzero(best.places >= 0)
        order = movable[np.argsort(-best.gains[movable], kind="stable")]
        n_moves = _make_moves(loose, candidates[order], best.places[order])
        if n_moves < _FEW * n or best.visits.sum() > _MANY * n:
            break
        if share < 1.0 and _is_spread(areas, best):
            share *= 2.0
            least = _least_area(loose, share)
    nodes = aligned_empty((m, 16), "f4")
    changed = bvh._replace(nodes=nodes, links=nodes.view(np.int32))
    _write_nodes(loose, changed)
    pieces = cut_tree(changed)
    better = relayout(changed, pieces, cheapest_leaves(changed, pieces, _largest_leaf(bvh.links), threads), threads)
    return better if sah_cost(better, threads=threads) < sah_cost(bvh, threads=threads) else bvh
