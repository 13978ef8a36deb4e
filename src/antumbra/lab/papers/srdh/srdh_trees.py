"""What SRDH changes about a tree [Feltman et al. 2012, Fig. 3, Sec. 5]: its shape, its kernels, and its memory.

The *frequent occluders* of a set of rays are the triangles that it meets most often: as few as make up half of all
intersections. In Figure 3 they are the middle blinds. A subtree *of frequent occluders* is a maximal subtree in which
at least half of the triangles are frequent; the paper compares the depths of the roots of such subtrees.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....bvh.nodes import CHILDREN, LEFT_FIRST, ORDER, UNORDERED, Bvh, bvh_leaf
from ....trace.rays.ray_hits import Intersections
from ..bench_runner import plot_sheet

# --- The shape of a tree ----------------------------------------------------------------------------------------------


class SubtreeTable(NamedTuple):
    """All subtrees of a `Bvh` with one triangle per leaf: its m inner nodes, then its n triangles, in slots."""

    children: NDArray[np.int64]  # (m, 2): indices of both subtrees
    parent: NDArray[np.int64]  # (m + n,): -1 for the root
    depth: NDArray[np.int64]  # (m + n,): 0 for the root
    order: NDArray[np.int32]  # (m,): child order of each node


def subtrees(bvh: Bvh) -> SubtreeTable:
    """The subtrees of a tree with one triangle per leaf, and at least two triangles."""
    m, n = len(bvh.nodes), len(bvh.prim_ids)
    links = bvh.links[:, CHILDREN].astype(np.int64)
    leaves = links < 0
    assert (bvh_leaf(links[leaves]).count == 1).all() and leaves.sum() == n
    children = np.where(leaves, m + bvh_leaf(links).first, links)
    parent, depth = np.full(m + n, -1), np.zeros(m + n, np.int64)
    parent[children] = np.arange(m)[:, None]
    level = np.zeros(1, np.int64)
    while len(level):
        below = children[level].ravel()
        depth[below] = np.repeat(depth[level], 2) + 1
        level = below[below < m]
    return SubtreeTable(children, parent, depth, bvh.links[:, ORDER])


def sums_below(trees: SubtreeTable, of_slots: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m + n,) the sum of a value of the triangles in each subtree; of_slots: (n,) the value of each slot."""
    m = len(trees.children)
    sums = np.concatenate([np.zeros(m, np.int64), of_slots])
    for level in range(int(trees.depth.max()), 0, -1):
        at = np.flatnonzero(trees.depth == level)
        np.add.at(sums, trees.parent[at], sums[at])
    return sums


def frequent_occluders(hits: Intersections, n: int) -> NDArray[np.bool_]:
    """(n,) whether each triangle is one of the frequent occluders of the rays."""
    times = np.bincount(hits.prims, minlength=n)
    ranked = np.argsort(-times, kind="stable")
    enough = int(np.searchsorted(np.cumsum(times[ranked]), (times.sum() + 1) // 2)) + 1
    frequent = np.zeros(n, bool)
    frequent[ranked[:enough]] = times[ranked[:enough]] > 0
    return frequent


class TreeShape(NamedTuple):
    """A tree's kernels, and where its frequent occluders lie: the depths of the roots of their subtrees (Fig. 3)."""

    scene: str
    method: str
    frequent: int  # frequent occluders
    roots: int  # subtrees of frequent occluders
    first: int  # depth of the root at or above which a tenth of them lie
    half: int  # the same for half of them
    most: int  # the same for nine tenths
    ordered: int  # nodes with a traversal-order kernel other than 1/2
    distance: int  # of these, nodes that compare distances: front to back, or back to front


def tree_shape(scene: str, method: str, bvh: Bvh, frequent: NDArray[np.bool_]) -> TreeShape:
    """The shape of a tree with one triangle per leaf; frequent: as `frequent_occluders` returns."""
    trees = subtrees(bvh)
    inside = sums_below(trees, frequent[bvh.prim_ids].astype(np.int64))
    size = sums_below(trees, np.ones(len(bvh.prim_ids), np.int64))
    dense = 2 * inside >= size
    outer = dense & ~_has_ancestor(trees, dense)
    roots = np.flatnonzero(outer & (inside > 0))
    by_depth = roots[np.argsort(trees.depth[roots], kind="stable")]
    reached = np.cumsum(inside[by_depth]) / max(1, inside[by_depth].sum())
    tenth, half, most = (int(trees.depth[by_depth[np.searchsorted(reached, share)]]) for share in (0.1, 0.5, 0.9))
    orders = int((trees.order != UNORDERED).sum()), int((trees.order > LEFT_FIRST).sum())
    return TreeShape(scene, method, int(frequent.sum()), len(roots), tenth, half, most, *orders)


def _has_ancestor(trees: SubtreeTable, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(m + n,) whether an ancestor of each subtree is among the chosen ones."""
    below = np.zeros(len(trees.parent), bool)
    for level in range(1, int(trees.depth.max()) + 1):
        at = np.flatnonzero(trees.depth == level)
        below[at] = (below | chosen)[trees.parent[at]]
    return below


# --- The memory of both trees (Sec. 5) --------------------------------------------------------------------------------


class TreeMemory(NamedTuple):
    """Bytes of the SAH tree and the tree for shadow rays, both with one triangle per leaf."""

    scene: str
    triangles: int
    sah: int
    srdh: int
    corners: int  # of each tree: its copy of the triangles, in leaf order
    rays: int  # rays of 16 x 16 pixels and their intersections, which only building needs

    @property
    def growth(self) -> float:
        """Size of both trees relative to the SAH tree."""
        return (self.sah + self.srdh) / self.sah

    @property
    def growth_shared(self) -> float:
        """The same if both trees shared the triangles, as the paper suggests."""
        return (self.sah + self.srdh - self.corners) / self.sah


def tree_memory(scene: str, sah: Bvh, srdh: Bvh, rays: Intersections) -> TreeMemory:
    """The memory of two trees of the same triangles, and of the rays that one was built for."""
    arrays = (array for array in rays if isinstance(array, np.ndarray))
    return TreeMemory(
        scene, len(sah.prim_ids), bytes_of(sah), bytes_of(srdh), sah.corners.nbytes, sum(a.nbytes for a in arrays)
    )


def bytes_of(bvh: Bvh) -> int:
    """The bytes of a tree: nodes, triangle indices and corners."""
    return bvh.nodes.nbytes + bvh.prim_ids.nbytes + bvh.corners.nbytes


# --- Figure 3 ---------------------------------------------------------------------------------------------------------


DRAWN = 5
"""Depth at which the drawings end."""

_ORDER_COLOURS = {LEFT_FIRST: "tab:red", UNORDERED: "0.6"}  # others: distance kernels
_DISTANCE_COLOUR = "tab:blue"


class DrawnTree(NamedTuple):
    """A tree of Figure 3."""

    title: str
    bvh: Bvh


def write_trees(drawn: list[DrawnTree], frequent: NDArray[np.bool_], path: Path) -> None:
    """Draw the upper levels of trees of the same triangles, one above the other, to a .png file.

    A subtree is redder, the larger the share of the frequent occluders that lies in it. Its number is the number of its
    triangles. Red lines lead to children that come first by constant kernels, blue ones from nodes with other kernels.
    """
    with plot_sheet(path, 3.6 * len(drawn)) as sheet:
        panels = sheet.subplots(len(drawn), 1, squeeze=False)
        for panel, tree in zip(panels[:, 0], drawn):
            panel.set_title(tree.title)
            panel.set_axis_off()
            _draw_tree(panel, tree.bvh, frequent)


def _draw_tree(panel: Any, bvh: Bvh, frequent: NDArray[np.bool_]) -> None:
    trees = subtrees(bvh)
    inside = sums_below(trees, frequent[bvh.prim_ids].astype(np.int64)) / max(1, int(frequent.sum()))
    size = sums_below(trees, np.ones(len(bvh.prim_ids), np.int64))
    level = [(0, 0.5)]  # subtrees of one depth, and where they stand from 0 to 1
    for depth in range(DRAWN + 1):
        for at, x in level:
            panel.plot(
                x, -depth, "o", color=(1.0, 1.0 - inside[at], 1.0 - inside[at]), markersize=9, mec="0.4", zorder=2
            )
            turned = {"rotation": 90, "va": "top"} if depth == DRAWN else {"va": "bottom"}
            above = -0.18 if depth == DRAWN else 0.16
            panel.text(x, above - depth, f"{size[at]:,}", fontsize=8, ha="center", **turned)
        if depth < DRAWN:
            level = [below for at, x in level for below in _draw_children(panel, trees, at, x, depth)]
    panel.set(xlim=(0, 1), ylim=(-DRAWN - 0.9, 0.5))


def _draw_children(panel: Any, trees: SubtreeTable, at: int, x: float, depth: int) -> list[tuple[int, float]]:
    """Draw the lines from a node to its children; return these with their places. Leaves have none."""
    if at >= len(trees.children):
        return []
    order, below = int(trees.order[at]), []
    for side, child in enumerate(trees.children[at].tolist()):
        place = x + (side - 0.5) / 2 ** (depth + 1)
        constant = order in _ORDER_COLOURS
        colour = _ORDER_COLOURS[UNORDERED if side else order] if constant else _DISTANCE_COLOUR
        panel.plot((x, place), (-depth, -depth - 1), color=colour, linewidth=1.0 + (colour == "tab:red"), zorder=1)
        below.append((child, place))
    return below
