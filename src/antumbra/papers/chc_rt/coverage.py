"""The tiles, parts and triangles that query pairs cover [Mattausch et al. 2015, Fig. 4 to 6].

The matrix of Fig. 6 has a row for each ray and a column for each triangle. Rays come tile by tile, in the order of the
quadtree. Triangles come part by part, in the order of the tree. So each query pair covers a rectangle of the matrix,
and the pairs of both fronts cover all of it exactly once.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.blocks import BlockTree
from ...bvh.links import CHILDREN, block_leaf, is_leaf
from ...techniques.chcrt.occlusion_queries import Tiles
from ...techniques.chcrt.tree_parts import TreeParts
from ...techniques.chcrt.visibility_fronts import INNER, VISIBLE, Fronts
from ...trace.tree_list import ROOT, Hits


class Columns(NamedTuple):
    """The columns of the matrix: the triangles of a scene in memory."""

    spans: np.ndarray  # (r, 2) int64: first and end column of each row of `Parts`
    places: np.ndarray  # (n,) int64: the column of each slot of the tree


class Rectangles(NamedTuple):
    """The part of the matrix that each of k pairs covers."""

    rays: np.ndarray  # (k, 2) int64: first and end row
    triangles: np.ndarray  # (k, 2) int64: first and end column
    visible: np.ndarray  # (k,) bool


def columns_of(parts: TreeParts) -> Columns:
    """The columns of the matrix; the parts are subtrees of a `BlockTree`."""
    tree = parts.keeps
    assert isinstance(tree, BlockTree)
    spans = np.zeros((len(parts.lines), 2), np.int64)
    places, n = np.zeros(len(tree.prim_ids), np.int64), 0
    for part in np.argsort(parts.order):
        slots = _slots(tree, int(parts.trees[part, ROOT]))
        places[slots] = np.arange(n, n + len(slots))
        spans[parts.inner + part] = n, n + len(slots)
        n += len(slots)
    for row in range(parts.inner - 1, -1, -1):
        below = spans[[child for child in parts.children[row] if child >= 0]]
        spans[row] = below[:, 0].min(), below[:, 1].max()
    return Columns(spans, places)


def _slots(tree: BlockTree, root: int) -> np.ndarray:
    """The slots below a link, in the order of the blocks."""
    blocks, links = [], np.array([root])
    while len(links):
        blocks.append(block_leaf(links[is_leaf(links)]).block)
        links = tree.links[links[links >= 0], CHILDREN].ravel()
    slots = tree.slots[np.sort(np.concatenate(blocks))].ravel()
    return slots[slots >= 0]


def covered(tiles: Tiles) -> np.ndarray:
    """(t, smallest) bool: the smallest tiles inside each tile."""
    x0, x1, y0, y1 = (column[:, None] for column in tiles.spans.T)
    left, _, top, _ = tiles.spans[: tiles.smallest].T
    return (x0 <= left) & (left < x1) & (y0 <= top) & (top < y1)


def overdraw(fronts: Fronts) -> np.ndarray:
    """(smallest,) int64: the number of visible and invisible pairs over each smallest tile (Fig. 4, left)."""
    pairs = np.bincount(fronts.tile[fronts.state != INNER], minlength=len(fronts.tiles.spans))
    return pairs @ covered(fronts.tiles)


def listed(fronts: Fronts) -> np.ndarray:
    """(smallest,) int64: the number of parts that the rays of each smallest tile go through (Fig. 5, right)."""
    return np.bincount(fronts.tile[fronts.of(VISIBLE)], minlength=fronts.tiles.smallest)


def reachable(fronts: Fronts, columns: Columns) -> np.ndarray:
    """(smallest,) int64: the number of triangles in these parts (Fig. 4, middle and right)."""
    shown = fronts.of(VISIBLE)
    first, end = columns.spans[fronts.row[shown]].T
    return np.bincount(fronts.tile[shown], end - first, fronts.tiles.smallest).astype(np.int64)


def tile_of_pixels(tiles: Tiles, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) int64: the smallest tile that each pixel is in."""
    y, x = np.indices(shape) // tiles.pixels
    return y * tiles.across + x


def rows_of_rays(tiles: Tiles, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) int64: the row of each pixel's ray in the matrix."""
    own = tile_of_pixels(tiles, shape)
    order = np.argsort(_z_places(tiles)[own].ravel(), kind="stable")
    rows = np.empty(own.size, np.int64)
    rows[order] = np.arange(own.size)
    return rows.reshape(shape)


def _z_places(tiles: Tiles) -> np.ndarray:
    """(smallest,) int64: the place of each smallest tile in the order of the quadtree."""
    y, x = np.divmod(np.arange(tiles.smallest), tiles.across)
    code = sum((x >> k & 1) << 2 * k | (y >> k & 1) << 2 * k + 1 for k in range(16))
    return np.argsort(np.argsort(code))


def rectangles(fronts: Fronts, columns: Columns, shape: tuple[int, int]) -> Rectangles:
    """The rectangles of the visible and invisible pairs (Fig. 6)."""
    tiles, pairs = fronts.tiles, np.flatnonzero(fronts.state != INNER)
    places = _z_places(tiles)
    rays = np.bincount(places[tile_of_pixels(tiles, shape)].ravel(), minlength=tiles.smallest)
    starts = np.concatenate([[0], np.cumsum(rays)])
    inside = covered(tiles)[fronts.tile[pairs]]
    first = np.where(inside, places, tiles.smallest).min(1)
    last = np.where(inside, places, -1).max(1)
    spans = np.stack([starts[first], starts[last + 1]], 1)
    return Rectangles(spans, columns.spans[fronts.row[pairs]], fronts.state[pairs] == VISIBLE)


def crossings(hits: Hits, tiles: Tiles, columns: Columns) -> tuple[np.ndarray, np.ndarray]:
    """(row, column) of each actual hit in the matrix, (k,) int64 each."""
    hit = hits.face >= 0
    return rows_of_rays(tiles, hits.face.shape)[hit], columns.places[hits.slot[hit]]
