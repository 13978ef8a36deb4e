"""Trees that a device builds, and the LBVH of the CPU, node by node, from vertices on the device (`build_kernels`)."""

from abc import ABC, abstractmethod
from copy import copy
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...bvh.tree_quality import AREA_ROW, AREA_ROWS, cost_of_sums
from ...bvh.triangle_bounds import MAX_COORDINATE
from ...devices.device import DeviceMemory
from .build_kernels import BITS, DIGIT, FAULT, PART, ROW, SLOTS, Keys, Pyramid, Source, Spines
from .device_launches import DeviceLaunches
from .device_traversal import TRIANGLE
from .device_tree import DeviceTree, reach_of_root

MAX_LEAF = 4  # as in `lbvh.build`
_STRIPS, _JOINED = 1 << 14, 1 << 7  # boxes of the first and the second step of a reduction
_BOX, _NODE, _RANGE = 32, 64, 12  # bytes
_ONE_ROW = 1 << 10  # numbers that one thread adds


class BuiltTree(DeviceTree, ABC):
    """A tree that the device has built.

    Attributes
    ----------
    n_nodes : int
    built_cost : float or None
        The `cost` of the tree from which this one was refitted; None: it was built.
    """

    n_nodes: int
    built_cost: float | None = None

    def _allocate(self, launches: DeviceLaunches, n: int, n_nodes: int) -> None:
        self.n_nodes = n_nodes
        nodes = launches.device.allocate(_NODE * n_nodes, "the nodes of the tree")
        super().__init__(launches, nodes, launches.device.allocate(4 * TRIANGLE * n, "the triangles of the tree"), n)

    def refitted(self, vertices: NDArray[np.float32] | DeviceMemory) -> Self:
        """The same tree of moved triangles, with boxes from the device. This one stays as it is, for those who use it.

        vertices : as for `source_of`, valid coordinates

        Raises
        ------
        OutOfDeviceMemory
            If there is no room beside this tree.
        """
        tree = copy(self)
        tree.built_cost = self.cost() if self.built_cost is None else self.built_cost
        tree._allocate(self.launches, self.n, self.n_nodes)
        tree._refit(self, _address_of(vertices, self.launches))
        return tree

    @abstractmethod
    def _refit(self, source: "BuiltTree", vertices: int) -> None:
        """Write the triangles and nodes of another tree, with vertices at an address."""

    def _filled(self) -> None:
        """Read the root, once all boxes are written."""
        self._root = self.nodes.read(np.empty(16, np.float32))
        self.reach = reach_of_root(self._root)

    def cost(self) -> float:
        """The SAH cost, added on the device: the bits of `bvh.tree_quality.sah_cost`."""
        launch, rows = self.launches.launch, -(-self.n_nodes // AREA_ROW)
        chunks = -(-rows // AREA_ROWS)
        block = self.launches.block("areas", 16 * (rows + chunks), "the areas of nodes")
        launch("sum_areas", (self.buffers, self.n_nodes, block.address), rows)
        launch("join_areas", (block.address, rows, block.address + 16 * rows, chunks), chunks)
        sums = block.read(np.empty((chunks, 2)), offset=16 * rows)
        return cost_of_sums(sums, self._root, self.n_nodes, self.n)


class LbvhTree(BuiltTree):
    """The tree of `bvh.lbvh` with 30-bit codes, of two triangles or more, built on the device.

    Parameters
    ----------
    source : Source
        From `source_of`.
    launches : DeviceLaunches
    max_leaf : int
        As for `lbvh.build`.

    Raises
    ------
    InputError
        If a coordinate is not finite, or too large for a tree.
    OutOfDeviceMemory
        If it does not fit.
    """

    def __init__(self, source: Source, launches: DeviceLaunches, max_leaf: int = MAX_LEAF) -> None:
        n = source.n
        codes, sorted_faces, spines = sort_by_codes(launches, source, min(max_leaf, n - 1))
        n_nodes = _number_nodes(launches, codes, spines)
        self._ranges = launches.device.allocate(_RANGE * n_nodes, "the ranges of the nodes")
        self._allocate(launches, n, n_nodes)
        launches.launch("write_nodes", (spines, self.nodes.address, self._ranges.address), n)
        self._fill((sorted_faces, 1), source.vertices, self.nodes.address)

    def _refit(self, source: BuiltTree, vertices: int) -> None:
        self._fill(source.faces, vertices, source.nodes.address)

    def _fill(self, faces: tuple[int, int], vertices: int, nodes: int) -> None:
        """Write the triangles, and the boxes of all nodes; the links are those at `nodes`, the address of a tree's."""
        launch, tree, lowest = self.launches.launch, self.buffers, -(-self.n // SLOTS)
        launch("write_triangles", (tree, *faces, vertices, self.n), self.n)
        boxes = self.launches.block("pyramid", 2 * _BOX * lowest, "the boxes of triangles")
        pyramid = Pyramid(boxes.address, lowest)
        launch("bound_slots", (tree, self.n, pyramid), lowest)
        for level in range((lowest - 1).bit_length() - 1, -1, -1):
            first, end = 1 << level, min(2 << level, lowest)
            launch("join_pairs", (pyramid, first, end), end - first)
        launch("bound_nodes", (tree, nodes, self._ranges.address, pyramid, self.n_nodes), self.n_nodes)
        self._filled()


def source_of(
    vertices: NDArray[np.float32] | DeviceMemory, faces: NDArray[np.int32] | None, launches: DeviceLaunches
) -> Source:
    """The triangles of a tree, on the device.

    Parameters
    ----------
    vertices : (n, 3, 3) float32, or DeviceMemory
        All triangles of the scene: on the host, or their 36 n bytes on the device.
    faces : (k,) int32, ascending, or None
        Those in the tree; None: all.
    launches : DeviceLaunches

    Raises
    ------
    OutOfDeviceMemory
        If the tree does not fit.
    """
    in_scene = vertices.size // 36 if isinstance(vertices, DeviceMemory) else len(vertices)
    n = in_scene if faces is None else len(faces)
    launches.device.check_room(4 * TRIANGLE * n + _NODE * (n // (2 * MAX_LEAF)), "the tree of the scene")
    ids = 0 if faces is None else launches.sent("source", faces, "the faces of the tree")
    return Source(_address_of(vertices, launches), ids, n)


def _address_of(vertices: NDArray[np.float32] | DeviceMemory, launches: DeviceLaunches) -> int:
    if isinstance(vertices, DeviceMemory):
        return vertices.address
    return launches.sent_triangles(vertices)


# --- Steps of a build -------------------------------------------------------------------------------------------------


def write_grid(launches: DeviceLaunches, source: Source) -> int:
    """The address of the grid of the codes."""
    summary = launches.block("summary", 16, "counts")
    strips, boxes = strips_of(source.n, launches)
    summary.fill()
    launches.launch("bound_strips", (source, boxes, strips, summary.address), strips)
    seconds, joined = _joined(boxes, strips, launches)
    grid = seconds + _BOX * joined
    launches.launch("make_grid", (seconds, joined, grid), 1)
    return grid


def strips_of(n: int, launches: DeviceLaunches) -> tuple[int, int]:
    """(the number of strips of n triangles or points, the address for their boxes, which `join_all` joins)."""
    strips = min(n, _STRIPS)
    return strips, launches.block("strips", _BOX * (strips + min(strips, _JOINED) + 1), "the bounds").address


def _joined(boxes: int, strips: int, launches: DeviceLaunches) -> tuple[int, int]:
    """(address, number) of fewer boxes; there is room for one behind them."""
    seconds, joined = boxes + _BOX * strips, min(strips, _JOINED)
    launches.launch("join_strips", (boxes, strips, seconds, joined), joined)
    return seconds, joined


def join_all(boxes: int, strips: int, launches: DeviceLaunches) -> NDArray[np.float32]:
    """(8,) float32: the box of the boxes of all strips, from `strips_of`: lower corner, and minus the upper one."""
    seconds, joined = _joined(boxes, strips, launches)
    last = seconds + _BOX * joined
    launches.launch("join_strips", (seconds, joined, last, 1), 1)
    return launches.block("strips", 0, "").read(np.empty(8, np.float32), offset=last - boxes)


def sort_by_codes(launches: DeviceLaunches, source: Source, max_leaf: int) -> tuple[int, int, Spines]:
    """(codes, faces, spines): sorted on the device, and where the radix tree over them goes."""
    n, launch = source.n, launches.launch
    parts, names = -(-n // PART), ("codes", "faces", "other codes", "other faces")
    codes, faces, *other = (launches.block(name, 4 * n, "the codes of triangles").address for name in names)
    counts = launches.block("counts of digits", 4 * max(parts << DIGIT, n + 1), "counts").address
    launch("write_codes", (source, write_grid(launches, source), codes, faces), n)
    keys, to = (codes, faces), (other[0], other[1])
    for shift in range(0, 3 * BITS, DIGIT):
        moved = Keys(*keys, n, parts)
        launch("count_digits", (moved, shift, counts), parts)
        add_up(launches, counts, parts << DIGIT)
        launch("scatter_keys", (moved, shift, counts, *to), parts)
        keys, to = to, keys
    return *keys, Spines(*to, counts, n, max_leaf)


def add_up(launches: DeviceLaunches, numbers: int, n: int, level: int = 0) -> None:
    """Replace n int32 on the device by the sums of those before them."""
    if n <= _ONE_ROW:
        launches.launch("scan_rows", (numbers, n, n, 0, 1), 1)
        return
    m = -(-n // ROW)
    sums = launches.block(f"sums {level}", 4 * m, "sums").address
    launches.launch("sum_rows", (numbers, n, sums, m), m)
    add_up(launches, sums, m, level + 1)
    launches.launch("scan_rows", (numbers, n, ROW, sums, m), m)


def keep_tagged(source: Source, tags: DeviceMemory, launches: DeviceLaunches) -> Source:
    """The triangles of a source that are tagged, until the next call.

    tags : int32, 1 or 0 for each triangle, and 0 after the last one; replaced by prefix sums
    """
    n = source.n
    add_up(launches, tags.address, n + 1)
    kept = int(tags.read(np.empty(1, np.int32), offset=4 * n)[0])
    faces = launches.block("kept", 4 * max(kept, 1), "the faces of the tree")
    launches.launch("keep_tagged", (source, tags.address, faces.address), n)
    return Source(source.vertices, faces.address, kept)


def _number_nodes(launches: DeviceLaunches, codes: int, spines: Spines) -> int:
    """Number the nodes of all spines, and return how many there are. InputError if a coordinate is invalid."""
    n = spines.n
    launches.launch("split_nodes", (codes, spines), n)
    launches.launch("count_spines", (spines,), n + 1)
    add_up(launches, spines.counts, n + 1)
    total = launches.block("counts of digits", 0, "").read(np.empty(1, np.int32), offset=4 * n)
    refuse_faults(launches)
    return int(total[0])


def refuse_faults(launches: DeviceLaunches) -> None:
    """Raise an InputError if a coordinate of the triangles sorted last is invalid."""
    faulty, face = launches.block("summary", 0, "").read(np.empty(2, np.int32), offset=4 * FAULT)
    if faulty:
        raise InputError(f"triangle {face} has a coordinate that is not finite, or not below {MAX_COORDINATE:.1e}")
