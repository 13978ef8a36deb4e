"""Trees of parts of a scene on a device: one block of memory each, and a row of the table that kernels read.

The host keeps no copy. Where the CPU must decide about a whole part, its tree comes back.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import Bvh, aligned_empty
from ...devices.device import Device, DeviceMemory
from .device_traversal import TRIANGLE
from .device_tree import bvh_of_device, device_triangles, reach_of_root, tree_bytes
from .tree_list_kernels import TREE_WORDS

_NODES, _TRIANGLES, _N_NODES, _N_TRIANGLES = 0, 1, 4, 5  # columns of a row
_REACH = slice(4, 7)  # of its float32


class PartTree(NamedTuple):
    """A tree on a device."""

    memory: DeviceMemory
    row: NDArray[np.int64]  # (TREE_WORDS,): its row of the table
    bvh_bytes: int  # of its nodes; the rest are triangles

    @property
    def bytes(self) -> int:
        return self.memory.size


def part_tree(bvh: Bvh, device: Device) -> PartTree:
    """The tree of a part, uploaded. OutOfDeviceMemory if it does not fit."""
    memory, triangles = device.allocate(tree_bytes(bvh), "a part of the scene"), device_triangles(bvh)
    memory.write(bvh.nodes)
    memory.write(triangles, bvh.nodes.nbytes)
    row = np.zeros(TREE_WORDS, np.int64)
    row[[_NODES, _TRIANGLES]] = memory.address, memory.address + bvh.nodes.nbytes
    row.view(np.float32)[_REACH] = reach_of_root(bvh.nodes[0])
    row[[_N_NODES, _N_TRIANGLES]] = len(bvh.nodes), len(bvh.prim_ids)
    return PartTree(memory, row, bvh.nodes.nbytes)


def part_bvh(row: NDArray[np.int64], device: Device) -> Bvh:
    """The tree of a part, by its row of the table, fetched from the device."""
    nodes = aligned_empty((int(row[_N_NODES]), 16), "f4")
    words = np.empty((max(int(row[_N_TRIANGLES]), 1), TRIANGLE), np.float32)
    device.synchronise()
    device.download_bytes(int(row[_NODES]), nodes, None, True)
    device.download_bytes(int(row[_TRIANGLES]), words, None, True)
    return bvh_of_device(nodes, words[: int(row[_N_TRIANGLES])])
