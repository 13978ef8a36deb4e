"""The scene hierarchy cut into a small top tree and *parts*: subtrees at which the traversal of query pairs ends.

`ChcRtOptions` limits the triangles and levels of a part [Mattausch et al. 2015, Sec. 5.2]. In core, parts are subtrees
of one `BlockTree`; out of core, they are the chunks of a store. For each smallest tile and ray set, a list has the
parts that its rays traverse, in order.
"""

from collections.abc import Callable, Generator
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...bvh.block_tree import BlockTree
from ...bvh.nodes import CHILDREN, EMPTY, LINK, MAX_DEPTH, block_leaf, boxes_of, bvh_leaf, parents_first
from ...kernels.jit import kernel
from ...kernels.simd import stack_array
from ...trace.tree_list import addresses, head
from ..tracer_options import ChcRtOptions
from .occlusion_queries import Pairs

# --- The top tree and the parts ---------------------------------------------------------------------------------------

_WAITING = MAX_DEPTH + 2

Owner: TypeAlias = object
"""A `BlockTree` or a store: the owner of the memory behind addresses, which must outlive them."""


Mark: TypeAlias = Callable[[NDArray[np.int64], NDArray[np.uint8]], None]
"""Marks hits: see `store.chunk_residency.Mark`."""


class PartMemory(Protocol):
    """Memory for the trees of some parts at a time."""

    def __contains__(self, k: int) -> bool:
        """Whether a part is in memory."""
        ...

    def begin_question(self) -> None:
        """Start a tracing call: discard what was kept for the previous one."""
        ...

    def groups(
        self, parts: NDArray[np.int32], still: Callable[[NDArray[np.int64]], NDArray[np.bool_]], mark: Mark | None
    ) -> Generator[NDArray[np.int64], None, None]:
        """Yield these parts in groups, parts in memory first. A group stays in memory until the next one is requested.

        still : called before parts are read; returns which of them are still needed, and the others are skipped
        mark : marks the hits so far: see `store.chunk_residency.Mark`; None: their triangles are not needed
        """
        ...


class TreeParts(NamedTuple):
    """The top tree as r rows: first its m inner nodes, the root first, then the k parts. Row m + i is part i."""

    lines: (
        np.ndarray
    )  # (r, 16) float32: nodes; of a part, its root node, so that queries test the boxes of its children
    children: np.ndarray  # (r, 2) int32: rows; -1: no child, or the row is a part
    links: np.ndarray  # (r,) int64: the link to each row's node in the tree; of parts of a store: their chunks
    share: np.ndarray  # (r,) float64: surface area relative to the root's
    inner: int  # m
    order: np.ndarray  # (k,) int32: the rank of each part in a depth-first, left-first traversal
    trees: np.ndarray  # (k, ADDRESSES) int64, see `trace.tree_list`; out of core, valid only for parts in memory
    heads: np.ndarray  # (k, 16) float32, see `trace.tree_list`
    extents: np.ndarray  # (3,) float32: extents of the scene
    memory: PartMemory | None  # None: everything is in memory
    keeps: Owner  # of the memory behind the addresses

    @property
    def boxes(self) -> NDArray[np.float32]:
        """(r, 2, 3) float32: lower and upper corner of each row."""
        return boxes_of(self.lines)


def shares(lines: NDArray[np.float32]) -> NDArray[np.float64]:
    """(r,) float64: the surface area of each row's box, relative to the first row's."""
    boxes = boxes_of(lines).astype(np.float64)
    x, y, z = np.maximum(boxes[:, 1] - boxes[:, 0], 0.0).T
    area: NDArray[np.float64] = x * y + y * z + z * x
    share: NDArray[np.float64] = area / max(area[0], 1e-300)
    return share


@kernel
def _measure(links, order, triangles, heights):
    """Count the triangles, and the levels of inner nodes, at and below each inner node of a `BlockTree`.

    order : the nodes, parents first
    """
    for i in range(len(order) - 1, -1, -1):
        node, n, height = order[i], 0, 0
        for side in range(2):
            link = np.int64(links[node, LINK + side])
            n += triangles[link] if link >= 0 else block_leaf(link).count
            if link >= 0 and heights[link] > height:
                height = heights[link]
        triangles[node], heights[node] = n, height + 1


@kernel
def _cut(links, triangles, heights, most, highest, top, roots):
    """Write the nodes of the top tree (parents first), and links to the roots of the parts. Return their numbers.

    most, highest : maximum number of triangles and levels of a part
    """
    waiting = stack_array(np.int64, _WAITING)
    waiting[0] = 0
    height, m, k = 1, 0, 0
    while height > 0:
        height -= 1
        link = waiting[height]
        if link < 0 or (triangles[link] <= most and heights[link] <= highest):
            if link >= 0 or block_leaf(link).count > 0:
                roots[k] = link
                k += 1
            continue
        top[m] = link
        m += 1
        for side in (1, 0):
            waiting[height] = links[link, LINK + side]
            height += 1
    return m, k


def _lines(tree: BlockTree, links: NDArray[np.int64], parents: dict[int, tuple[int, int]]) -> NDArray[np.float32]:
    """The lines of links. A block's line has its box as the box of both children."""
    lines = np.empty((len(links), 16), np.float32)
    inner = links >= 0
    lines[inner] = tree.nodes[links[inner]]
    for i in np.flatnonzero(~inner):
        node, side = parents[int(links[i])]
        lines[i] = tree.nodes[node]
        lines[i, 0:12:2] = lines[i, 1:12:2] = tree.nodes[node, side:12:2]
    return lines


def part_order(children: NDArray[np.int32], m: int) -> NDArray[np.int32]:
    """See `TreeParts.order`."""
    order, waiting, n = np.empty(len(children) - m, np.int32), [0], 0
    while waiting:
        row = waiting.pop()
        if row >= m:
            order[row - m] = n
            n += 1
        elif row >= 0:
            waiting += [int(children[row, 1]), int(children[row, 0])]
    return order


def parts_of(tree: BlockTree, options: ChcRtOptions) -> TreeParts:
    """Cut a `BlockTree` into parts."""
    n = len(tree.nodes)
    triangles, heights = np.zeros(n, np.int64), np.zeros(n, np.int64)
    _measure(tree.links, parents_first(tree.links), triangles, heights)
    top, roots = np.empty(n, np.int64), np.empty(n + 1, np.int64)
    m, k = _cut(tree.links, triangles, heights, options.triangles, options.height, top, roots)
    top, roots = top[:m], roots[:k]
    rows = {int(link): row for row, link in enumerate([*top, *roots])}
    above = np.repeat(top, 2), np.tile([0, 1], m)
    below = tree.links[above[0], LINK + above[1]]
    parents = {int(link): (int(node), int(side)) for link, node, side in zip(below, *above)}
    parents.setdefault(~0, (0, 0))
    lines = _lines(tree, np.concatenate([top, roots]), parents)
    children = np.full((m + k, 2), -1, np.int32)
    children[:m] = np.array([rows.get(int(link), -1) for link in below], np.int32).reshape(m, 2)
    boxes = boxes_of(lines)
    trees = np.array([addresses(tree, int(root)) for root in roots], np.int64).reshape(k, -1)
    return TreeParts(
        lines, children, np.concatenate([top, roots]), shares(lines), m, part_order(children, m), trees,
        head(*boxes[m:].swapaxes(0, 1)), boxes[0, 1] - boxes[0, 0], None, tree,
    )  # fmt: skip


def parts_of_chunks(
    top: NDArray[np.float32], roots: NDArray[np.float32], trees: NDArray[np.int64], memory: PartMemory, keeps: Owner
) -> TreeParts:
    """`TreeParts` of the chunks of a store.

    top : (m, 16) float32: nodes over the chunks as in `Bvh`; a link < 0 is ``bvh_link(chunk, 1)``, or EMPTY
    roots : (k, 16) float32: the chunks' root nodes
    trees : (k, ADDRESSES) int64, which `memory` writes to
    """
    links, m = top.view(np.int32)[:, CHILDREN], len(top)
    children = np.where(links >= 0, links, np.where(links == EMPTY, -1, m + bvh_leaf(links).first)).astype(np.int32)
    lines = np.concatenate([top, roots])
    for side, other in ((0, 1), (1, 0)):  # replace the infinite box of a missing child by its sibling's
        gone = ~np.isfinite(lines[:, side])
        lines[gone, side:12:2] = lines[gone, other:12:2]
    children = np.concatenate([children, np.full((len(roots), 2), -1, np.int32)])
    if len(roots) == 1:  # with one chunk, the top tree is not needed
        lines, children, m = lines[m:], children[m:], 0
    boxes = boxes_of(lines)
    heads = head(*boxes[m:].swapaxes(0, 1))
    order = part_order(children, m)
    return TreeParts(
        lines, children, np.arange(-m, len(roots)), shares(lines), m, order, trees, heads, boxes[0, 1] - boxes[0, 0],
        memory, keeps,
    )  # fmt: skip


def matching_rows(old: TreeParts, new: TreeParts) -> NDArray[np.int32] | None:
    """(r,) int32: the row of `new` with the same node as each row of `old`; None unless both have the same nodes.

    A refitted tree has the same nodes in other boxes. Their children may be swapped.
    """
    by_old, by_new = np.argsort(old.links), np.argsort(new.links)
    if not np.array_equal(old.links[by_old], new.links[by_new]):
        return None
    rows = np.empty(len(by_old), np.int32)
    rows[by_old] = by_new
    children = np.append(rows, np.int32(-1))[old.children]
    return rows if np.array_equal(np.sort(children), np.sort(new.children[rows])) else None


# --- Lists of the parts that the rays of a smallest tile and ray set traverse -----------------------------------------


class Lists(NamedTuple):
    """The lists of all smallest tiles."""

    starts: np.ndarray  # (tiles * sets + 1,) int32: the first item of list tile * sets + set, and the end
    items: np.ndarray  # (n,) int32: parts
    tiles: np.ndarray  # (k,) int32: the tiles whose lists are not empty
    order: np.ndarray  # (n,) int64: the pair of each item


def in_lists(
    pairs: Pairs, keys: NDArray[np.float32] | NDArray[np.int32], sets: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(the list of each final pair, the pairs sorted by list, then by key)."""
    number = pairs.tile.astype(np.int64) * sets + pairs.set
    return number, np.lexsort((keys, number))


def lists_of(
    pairs: Pairs, keys: NDArray[np.float32], parts: TreeParts, smallest: int, sets: int, front_to_back: bool
) -> Lists:
    """The lists of final pairs: front to back by `keys`, or in tree order.

    Any-hit rays are fastest in tree order. A tile may start inside the boxes of many parts, which then all have the
    same key; with front to back, foliage (San Miguel) took 1.6 times as long.

    smallest : number of smallest tiles
    """
    number, order = in_lists(pairs, keys if front_to_back else parts.order[pairs.row - parts.inner], sets)
    counts = np.bincount(number, minlength=smallest * sets)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    items = (pairs.row[order] - parts.inner).astype(np.int32)
    return Lists(starts, items, np.unique(pairs.tile).astype(np.int32), order)
