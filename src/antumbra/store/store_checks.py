"""The structure of a store: what a file says is checked against its size and its neighbours, before a kernel reads it.

Checksums find damage, but whoever writes a file can compute them, so nothing here trusts them. The directory is checked
when a store is opened, and a chunk when it is first read. What passes is a valid store of *some* scene: every link
leads to a node, every tree ends, every count fits its array, and every box is exact.
"""

import numpy as np
from numpy.typing import NDArray

from ..base.checks import quoted
from ..base.errors import InputError
from ..bvh.compact_tree import bvh_of, leaf_fault
from ..bvh.nodes import BACK_TO_FRONT, EMPTY, LINK, ORDER, UNORDERED, Bvh, boxes_of, bvh_leaf
from ..bvh.tree_quality import tree_fault
from ..scene.scene_bounds import NEAREST, flush_to_zero, frame_origin
from ..scene.triangle_setup import rows_with_area
from . import stored_cutouts, stored_looks
from .store_format import (
    COUNTS,
    NODE_BYTES,
    PAGE,
    TABLE,
    Chunk,
    Chunks,
    StoreMeta,
    TopTree,
    chunk_places,
    pages,
)
from .stored_heights import section_fault

MAX_TRIANGLES = 2**31 - 1  # so that int32 holds their indices
_MAX_META = 1 << 30  # bytes of metadata

# Each function returns the first fault in words, or "" if there is none.


# --- The directory ----------------------------------------------------------------------------------------------------


def counts_fault(counts: bytes, offset: int, size: int) -> str:
    """Check the counts of a directory of `size` bytes at `offset`, before memory is taken for it."""
    if len(counts) < COUNTS.size:
        return "it is cut short"
    k, m, length = COUNTS.unpack(counts)
    most = offset // PAGE - 1  # each chunk takes a page
    if not 1 <= k <= most:
        return f"it lists {k} chunks, where the file has room for 1 to {most}"
    if not 1 <= m <= max(k - 1, 1):
        return f"its tree has {m} nodes; a tree over {k} chunks has 1 to {max(k - 1, 1)}"
    if length > _MAX_META or size != pages(COUNTS.size + k * TABLE.itemsize + m * NODE_BYTES + length):
        return f"{k} chunks, {m} nodes and {length} bytes of metadata do not take {size} bytes"
    return ""


def directory_fault(meta: StoreMeta, chunks: Chunks, top: TopTree, offset: int) -> str:
    """Check the directory, which begins at `offset`."""
    if meta.heights is not None and (fault := section_fault(meta.heights, meta.raster, MAX_TRIANGLES)):
        return fault
    if meta.cutouts is not None and (fault := stored_cutouts.section_fault(meta.cutouts, meta.n_triangles)):
        return fault
    if meta.looks is not None and (fault := stored_looks.section_fault(meta.looks, meta.n_triangles)):
        return fault
    end = offset
    for name, section in (("looks", meta.looks), ("cut-outs", meta.cutouts), ("heights", meta.heights)):
        if section is not None and section.offset + section.bytes != end:
            return f"its {name} do not end where the next section begins"
        end = end if section is None else section.offset
    fault = _table_fault(chunks, end) or _top_fault(top, chunks.box)
    return fault or meta_fault(meta, chunks.box, int(chunks.triangles.sum()), MAX_TRIANGLES)


def _table_fault(chunks: Chunks, end: int) -> str:
    """Check the rows of the table, one by one and against their neighbours; `end`: of the last chunk."""
    n, m, p = chunks.triangles, chunks.nodes, chunks.colours
    possible = {
        "triangles": (n >= 1) & (n <= MAX_TRIANGLES),
        "nodes": (m >= 1) & (m <= np.maximum(n - 1, 1)),
        "colours": (p >= 1) & (p <= n),
        "offset": chunks.offset == np.append(PAGE, chunks.offset[:-1] + chunks.bytes[:-1]),
    }
    for name, good in possible.items():
        if not good.all():
            k = int(np.argmin(good))
            return f"chunk {k} has the {name} {int(getattr(chunks, name)[k])}"
    for k, counts in enumerate(zip(n.tolist(), m.tolist(), p.tolist())):
        if pages(chunk_places(*counts).end) != chunks.bytes[k]:
            return f"chunk {k} has {chunks.bytes[k]} bytes, which do not fit its counts"
    if chunks.offset[-1] + chunks.bytes[-1] != end:
        return "the last chunk does not end where the next section begins"
    boxes = boxes_of(chunks.root).reshape(-1, 6)
    exact = np.isfinite(chunks.box).all(1) & (boxes == chunks.box).all(1) & (boxes[:, :3] <= boxes[:, 3:]).all(1)
    return "" if exact.all() else f"the box of chunk {int(np.argmin(exact))} is not the one of its root"


def _top_fault(top: TopTree, boxes: NDArray[np.float32]) -> str:
    """Check that the top tree has each chunk in one leaf. Builders take triangles, and so does the check."""
    diagonals = np.stack([boxes[:, :3], boxes[:, 3:], boxes[:, :3]], axis=1).reshape(-1, 9)
    numbers = np.arange(len(boxes), dtype=np.int32)
    bvh = Bvh(top.nodes, top.links, numbers, diagonals)
    fault = tree_fault(bvh) or _order_fault(bvh)
    ends = top.links[:, LINK : LINK + 2]
    if not fault and (bvh_leaf(ends[(ends < 0) & (ends != EMPTY)]).count > 1).any():
        fault = "a leaf has several chunks"
    return f"tree over the chunks: {fault}" if fault else ""


def _order_fault(bvh: Bvh) -> str:
    orders = bvh.links[:, ORDER]
    good = (orders >= UNORDERED) & (orders <= BACK_TO_FRONT)
    return "" if good.all() else f"node {int(np.argmin(good))}: its child order is {orders[np.argmin(good)]}"


def meta_fault(meta: StoreMeta, boxes: NDArray[np.float32], n_triangles: int, most: int) -> str:
    """Check the metadata, whose JSON may hold anything.

    boxes : (k, 6) of the chunks, or of tiles
    n_triangles : of them all
    most : the largest number of triangles
    """
    for name, value, kinds in (
        ("name", meta.name, str), ("n_triangles", meta.n_triangles, int), ("built", meta.built, dict),
        ("crs", meta.crs, (str, type(None))),
    ):  # fmt: skip
        if not isinstance(value, kinds):
            return f"its {name} is {quoted(value)}"
    if meta.up not in ("y", "z") or not all(isinstance(note, str) for note in meta.notes):
        return f"its up axis is {quoted(meta.up)}, or a note is no text"
    if not n_triangles <= meta.n_triangles <= most:
        return f"its chunks have {n_triangles} triangles, and the scene {meta.n_triangles}"
    if meta.objects is not None and (fault := meta.objects.fault(meta.n_triangles)):
        return fault
    return _frame_fault(meta, boxes) or _raster_fault(meta, (most + 1) // 2)


def _frame_fault(meta: StoreMeta, boxes: NDArray[np.float32]) -> str:
    """Check the bounds, and that the frame and the box in it follow from them."""
    bounds, origin, box = meta.bounds, meta.origin, meta.box
    if bounds.shape != (2, 3) or origin.shape != (3,) or box.shape != (2, 3):
        return "its bounds have other than three axes"
    if not (np.isfinite(bounds).all() and (bounds[0] <= bounds[1]).all()):
        return f"its bounds are {bounds.tolist()}"
    if not any(np.array_equal(origin, frame_origin(bounds[0], bounds[1], single)) for single in (False, True)):
        return "its origin does not follow from its bounds"
    limits = flush_to_zero((bounds - origin).astype(np.float32))  # wider than the box if a mesh has unused vertices
    if not (np.isfinite(box).all() and (limits[0] <= box[0]).all() and (box[1] <= limits[1]).all()):
        return "its box is not inside its bounds"
    if (points := meta.framed) is not None:
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            return "its framed points have other than three axes"
        if not ((bounds[0] <= points) & (points <= bounds[1])).all():
            return "its framed points are not inside its bounds"
    if (detail := meta.detail) is not None:
        if detail.box.shape != (2, 3) or detail.dense.shape != (3,):
            return "its detail has other than three axes"
        wide = bounds + (bounds[1] - bounds[0]) * [[-1.0], [1.0]]  # corners in the frame are rounded
        if not all(((wide[0] <= point) & (point <= wide[1])).all() for point in (*detail.box, detail.dense)):
            return "its detail is not near its bounds"
    inside = (box[0] <= boxes[:, :3]).all(1) & (boxes[:, 3:] <= box[1]).all(1)
    return "" if inside.all() else f"chunk {int(np.argmin(inside))} lies outside of the scene's box"


def _raster_fault(meta: StoreMeta, most_cells: int) -> str:
    raster = meta.raster
    if raster is None:
        return ""
    place = np.array([raster.west, raster.north, raster.spacing], np.float64)
    cells = raster.columns, raster.rows
    good = np.isfinite(place).all() and raster.spacing > 0.0 and all(isinstance(each, int) for each in cells)
    if good and min(cells) >= 1 and cells[0] * cells[1] <= most_cells and isinstance(raster.crs, (str, type(None))):
        return ""
    return f"its raster is {quoted(raster)}"


def check_one_range(name: str, n_triangles: int) -> None:
    """Raise an InputError if int32 cannot number the faces of a scene with cut-outs."""
    if n_triangles > MAX_TRIANGLES:
        raise InputError(
            f"{name}: {n_triangles} triangles, some of which let light pass; at most {MAX_TRIANGLES} may: build two "
            "scenes, or make all faces solid (?cutouts=off, no transmittance)"
        )


# --- Chunks -----------------------------------------------------------------------------------------------------------


def chunk_fault(chunk: Chunk, root: NDArray[np.float32], n_triangles: int) -> str:
    """Check a chunk whose arrays have the sizes of its row, against `root`, the row's copy of its root node."""
    tree = chunk.tree
    ids = np.sort(tree.prim_ids)
    if ids[0] < 0 or ids[-1] >= n_triangles or (ids[1:] == ids[:-1]).any():
        return f"its triangles are not distinct ones of 0 to {n_triangles - 1}"
    if tree.nodes[0].tobytes() != root.tobytes():
        return "its root is not the one in the directory"
    if fault := leaf_fault(tree) or tree_fault(bvh := bvh_of(tree)) or _order_fault(bvh):
        return fault
    size = np.abs(tree.corners)
    if ((size > 0.0) & (size < NEAREST)).any():
        return "a corner is closer to a plane of the frame than float32 resolves"
    areas = rows_with_area(tree.corners.reshape(-1, 3, 3), 1)
    if (
        areas is not None and (np.delete(tree.prim_ids, areas) != 0).any()
    ):  # the scene's first triangle stays in any case
        return "it has a triangle without area"
    rows, colours = chunk.palette_rows, len(chunk.palette)
    if int(rows.max()) >= colours or not np.bincount(rows, minlength=colours).all():
        return "its colours are not those of its palette"
    if not (chunk.palette >= 0.0).all() or not np.isfinite(chunk.palette).all():
        return "a colour is negative, NaN or infinite"
    return ""
