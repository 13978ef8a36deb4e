"""Trees on a device, and those that the CPU has built: uploaded once, and refitted there when triangles move."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import LINK, Bvh, Reach, aligned_empty, parents_first
from ...devices.device import Device, DeviceMemory
from .device_launches import DeviceLaunches
from .device_receivers import DeviceReceivers
from .device_traversal import PRIM, TRIANGLE, TreeBuffers


def device_triangles(bvh: Bvh) -> NDArray[np.float32]:
    """(n, TRIANGLE) float32: the triangles of a tree, by slot, as `TreeBuffers` describes them."""
    out = np.zeros((max(len(bvh.prim_ids), 1), TRIANGLE), np.float32)
    if len(bvh.prim_ids):
        corners = bvh.corners.reshape(-1, 3, 3)
        for k in range(3):
            out[:, 4 * k : 4 * k + 3] = corners[:, k]
        out.view(np.int32)[:, PRIM] = bvh.prim_ids
    return out


def bvh_of_device(nodes: NDArray[np.float32], triangles: NDArray[np.float32]) -> Bvh:
    """The tree with these nodes, (m, 16) and 64-byte aligned, and triangles as from `device_triangles`."""
    corners = np.ascontiguousarray(triangles.reshape(-1, 3, 4)[..., :3]).reshape(-1, 9)
    return Bvh(nodes, nodes.view(np.int32), triangles.view(np.int32)[:, PRIM].copy(), corners)


def reach_of_root(root: NDArray[np.float32]) -> Reach:
    """The `Reach` of a tree whose root is the node `root`, (16,) float32."""
    planes = np.abs(root[:12].reshape(3, 4))
    x, y, z = np.where(np.isfinite(planes), planes, np.float32(0.0)).max(1)
    return x, y, z


def tree_bytes(bvh: Bvh) -> int:
    """The memory that a tree takes on a device."""
    return bvh.nodes.nbytes + 4 * TRIANGLE * max(len(bvh.prim_ids), 1)


def levels_from_below(bvh: Bvh) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """(nodes, the deepest ones first, where each level begins, with the end): the order of a refit."""
    order = parents_first(bvh.links)
    depth = np.zeros(len(bvh.links), np.int64)
    children = bvh.links[:, LINK : LINK + 2]
    level, d = np.zeros(1, np.int32), 0
    while level.size:
        depth[level], d = d, d + 1
        below = children[level].ravel()
        level = below[below >= 0]
    by_depth = order[np.argsort(-depth[order], kind="stable")]
    counts = np.bincount(depth[order])[::-1]
    return by_depth, np.concatenate([[0], np.cumsum(counts)])


class DeviceTree:
    """A binary BVH on a device.

    launches : DeviceLaunches
    nodes, triangles : DeviceMemory
        As `TreeBuffers` describes them.
    n : number of triangles

    Attributes
    ----------
    receivers : tuple of DeviceReceivers
        Those of the queries for which triangles were culled, which are on the device already.
    """

    receivers: tuple[DeviceReceivers, ...] = ()

    def __init__(self, launches: DeviceLaunches, nodes: DeviceMemory, triangles: DeviceMemory, n: int) -> None:
        self.launches, self.nodes, self.triangles, self.n = launches, nodes, triangles, n
        self._bvh: Bvh | None = None
        self.reach: Reach = (np.float32(0.0),) * 3

    @property
    def device(self) -> Device:
        return self.launches.device

    @property
    def buffers(self) -> TreeBuffers:
        """The tree as kernels take it."""
        return TreeBuffers(self.nodes.address, self.triangles.address, self.reach)

    @property
    def faces(self) -> tuple[int, int]:
        """The index in the scene of each slot's triangle: the address of the first one, and the next one's distance."""
        return self.triangles.address + 4 * PRIM, TRIANGLE

    @property
    def bvh(self) -> Bvh:
        """The same tree on the host, with which the CPU decides what the device cannot."""
        if self._bvh is None:
            nodes = self.nodes.read(aligned_empty((self.nodes.size // 64, 16), "f4"))
            words = self.triangles.read(np.empty((self.n, TRIANGLE), np.float32))
            self._bvh = bvh_of_device(nodes, words)
        return self._bvh

    def some(self, slots: NDArray[np.int32]) -> Bvh:
        """The triangles in some slots, without nodes: for decisions about them on the CPU."""
        nodes = aligned_empty((1, 16), "f4")
        if self._bvh is not None:
            return Bvh(nodes, nodes.view(np.int32), self._bvh.prim_ids[slots], self._bvh.corners[slots])
        return bvh_of_device(nodes, self.launches.rows_at(self.triangles.address, slots, TRIANGLE // 3))


class UploadedTree(DeviceTree):
    """A tree that the CPU has built."""

    def __init__(self, bvh: Bvh, launches: DeviceLaunches) -> None:
        device = launches.device
        device.check_room(tree_bytes(bvh), "the tree of the scene")
        nodes = device.upload(bvh.nodes, "the nodes of the tree")
        triangles = device.upload(device_triangles(bvh), "the triangles of the tree")
        super().__init__(launches, nodes, triangles, len(bvh.prim_ids))
        self._bvh, self.reach = bvh, reach_of_root(bvh.nodes[0])
        self._levels: tuple[DeviceMemory, NDArray[np.int64]] | None = None

    def move(self, bvh: Bvh, vertices: NDArray[np.float32]) -> None:
        """Move the triangles of the tree and refit its boxes on the device.

        bvh : the same tree, refitted on the host
        vertices : (n, 3, 3) float32, all triangles of the scene, which `prim_ids` indexes
        """
        if self._levels is None:
            order, begins = levels_from_below(bvh)
            self._levels = self.device.upload(order, "the levels of the tree"), begins
        self._bvh, self.reach = bvh, reach_of_root(bvh.nodes[0])
        (order_memory, begins), launch = self._levels, self.launches.launch
        with self.device.upload(np.ascontiguousarray(vertices), "the moved triangles") as moved:
            launch("write_triangles", (self.buffers, *self.faces, moved.address, self.n), self.n)
            for first, end in pairwise(begins.tolist()):
                launch("refit_nodes", (self.buffers, order_memory.address, first, end - first), end - first)
            self.device.synchronise()
