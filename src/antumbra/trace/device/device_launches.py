"""Launches of the kernels of devices: their code is made and loaded when first needed, and memory is reused."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ...devices.device import Device, DeviceMemory, Module, OutOfDeviceMemory
from ...kernels.marshalling import address_of, flatten, struct_of
from ...kernels.toolchain.device_code import Form
from ...scene.resident_triangles import ResidentTriangles
from ...scene.triangles import Triangles
from .device_kernels import KERNELS, RECORD
from .device_traversal import REST, Work


class DeviceLaunches:
    """Launches kernels on a device, and keeps blocks of its memory for the next launches. Not thread-safe.

    device : Device

    Attributes
    ----------
    evict : function of int
        Frees at least so many bytes of a cache on the device, or what it can spare; returns whether it has freed any.
    """

    def __init__(self, device: Device) -> None:
        self.device, self.evict = device, cast(Callable[[int], bool], _evict_nothing)
        self._modules: dict[str, Module] = {}
        self._blocks: dict[str, DeviceMemory] = {}
        self._triangles: tuple[object, object] | None = None  # whose memory on the host the latest ones are, and where

    def launch(self, name: str, arguments: Sequence[Any], threads: int) -> None:
        """Run a kernel of `KERNELS` in at least `threads` threads, in the order of the launches."""
        if threads <= 0:
            return
        module = self._modules.get(name)
        if module is None:
            module = self._modules[name] = self.device.load(KERNELS[name].code(cast(Form, self.device.form)))
        key, values = flatten(tuple(arguments))
        words = np.frombuffer(struct_of(key).pack(*values), np.int64)
        self.device.launch(module, words, threads)

    def block(self, name: str, size: int, what: str) -> DeviceMemory:
        """A block of at least `size` bytes, kept under a name for later calls; its contents are unspecified."""
        kept = self._blocks.get(name)
        if kept is None or kept.size < size:
            if kept is not None:
                self._blocks.pop(name).free()
            kept = self._blocks[name] = self.allocate(size, what)
        return kept

    def free_blocks(self) -> None:
        """Free all kept blocks."""
        self._triangles = None
        for kept in self._blocks.values():
            kept.free()
        self._blocks.clear()

    def allocate(self, size: int, what: str) -> DeviceMemory:
        """A block of memory, as from `Device.allocate`, for which a cache on the device may have to leave."""
        while True:
            try:
                return self.device.allocate(size, what)
            except OutOfDeviceMemory as full:
                if not self.evict(max(full.needed - full.left, 1)):  # 1: what is free may be in pieces
                    raise

    def upload(self, array: NDArray[Any], what: str) -> DeviceMemory:
        """A block of memory that holds the bytes of an array."""
        memory = self.allocate(array.nbytes, what)
        memory.write(array)
        return memory

    def sent_triangles(self, vertices: NDArray[np.float32]) -> int:
        """The address of a copy of triangles, (n, 3, 3) or (n, 9) float32; kept until the next call."""
        self._triangles = None
        address = self.sent("triangles of the scene", np.ascontiguousarray(vertices), "the triangles of the scene")
        self._triangles = _place_of(vertices)
        return address

    def kept_triangles(self, vertices: NDArray[np.float32]) -> int:
        """As `sent_triangles`; the latest ones are not copied again, since nobody may have written to them."""
        kept, ours = self._triangles, _place_of(vertices)
        if kept is None or ours is None or kept[0] is not ours[0] or kept[1] != ours[1]:
            return self.sent_triangles(vertices)
        return self.block("triangles of the scene", 0, "").address

    def address_of(self, triangles: Triangles) -> int:
        """The address of the vertices of triangles: those on this device, or a copy as from `kept_triangles`."""
        if isinstance(triangles, ResidentTriangles) and triangles.memory.device.name == self.device.name:
            return int(triangles.memory.address)
        return self.kept_triangles(triangles.vertices)

    def rows_at(self, address: int, items: NDArray[np.int32], each: int = 1) -> NDArray[np.float32]:
        """(k, 3 each) float32: k items of an array at an address on the device, each of some rows of three words."""
        rows = (each * items[:, None] + np.arange(each, dtype=np.int32)).astype(np.int32).reshape(-1)
        n = len(rows)
        out = self.block("rows", max(12 * n, 16), "rows of an array")
        self.launch("gather_points", (address, self.sent("places", rows, "rows of an array"), n, out.address), n)
        return out.read(np.empty((len(items), 3 * each), np.float32))

    def sent(self, name: str, array: NDArray[Any], what: str) -> int:
        """The address of a kept block that holds the bytes of an array."""
        block = self.block(name, max(array.nbytes, 16), what)
        block.write(array)
        return block.address

    def left_over(
        self, name: str, arguments: Callable[[int, int], tuple[Any, ...]], work: Work
    ) -> Iterator[NDArray[np.float64]]:
        """Launch a kernel for all rays of `work`, and yield the records of those that it leaves to the CPU.

        If the list of records is too short, the same rays are traced again, fewer at a time. So the kernel must not
        change what it reads.

        arguments : of the kernel for n rays from the first on, by (first, n)
        """
        counts, begin, at_once = self.block("counts", 0, ""), 0, work.n
        while begin < work.n:
            n = min(at_once, work.n - begin)
            counts.fill()
            self.launch(name, arguments(begin, n), n)
            left = int(counts.read(np.empty(4, np.int32))[REST])
            if left > work.rest_capacity:
                at_once = work.rest_capacity
                continue
            if left:
                yield self.block("rest", 0, "").read(np.empty((left, RECORD)))
            begin += n

    def mark(self, out: int, at: NDArray[Any], values: NDArray[Any]) -> None:
        """Write int32 values to elements of an array at an address, each element once."""
        if len(at):
            marks = self.sent("marks", np.stack([at, values], 1).astype(np.int32), "the CPU's answers")
            self.launch("mark_rays", (out, marks, len(at)), len(at))


def _evict_nothing(size: int) -> bool:
    return False


def _place_of(array: NDArray[Any]) -> tuple[object, object] | None:
    """(the owner of an array's memory, to be held so that it is not reused; the place in it); None: it has gaps."""
    owner = array if array.base is None else array.base
    return (owner, (address_of(array), array.nbytes)) if array.flags.c_contiguous else None
