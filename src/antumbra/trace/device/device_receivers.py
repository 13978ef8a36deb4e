"""Receivers of shadow queries on a device: uploaded once, for culling and for all lights."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...devices.device import DeviceMemory
from ...kernels.parallel import new_ticket, run
from ...query.shadow_query import ShadowQuery
from ...scene.lights import AMBIENT
from .device_launches import DeviceLaunches
from .device_rays import pack_receivers

_PER_SHARE = 1 << 14  # receivers


class NeededArrays(NamedTuple):
    """Whether kernels read arrays of a query besides its packed receivers."""

    ids: bool  # otherwise, the indices in trees are the faces
    corners: bool  # some receivers lie on triangles
    normals: bool  # for the horizons of receivers without triangles, and for lights of ambient occlusion


def needed_arrays(query: ShadowQuery) -> NeededArrays:
    """What a device needs of a query whose receivers are on the host."""
    own = query.ids is not query.faces and not np.array_equal(query.ids, query.faces)
    ambient = query.light.kind == AMBIENT
    normals = query.normals.size > 0 and (ambient or bool((query.faces < 0).any()))
    return NeededArrays(own, bool((query.faces >= 0).any()), normals)


class DeviceReceivers:
    """The receivers of a query on a device, for that query and others with the same arrays.

    Nobody may write to the arrays meanwhile: they are recognised by identity (`ShadowQuery.receivers`).

    query : ShadowQuery
    memory : DeviceMemory
        16 bytes per receiver, as `SampleBuffers.receivers`.
    normals : DeviceMemory or None
        24 bytes per receiver, as `SampleBuffers.normals`, if some receivers have no triangles.
    """

    def __init__(self, query: ShadowQuery, memory: DeviceMemory, normals: DeviceMemory | None = None) -> None:
        self._of, self.memory, self.n, self.normals = query.receivers, memory, query.n, normals

    def are_of(self, query: ShadowQuery) -> bool:
        """Whether these are the receivers of a query."""
        others = query.receivers
        return len(self._of) == len(others) and all(ours is theirs for ours, theirs in zip(self._of, others))


class ReceiverUploads:
    """Uploads receivers by way of an array on the host from which copies to a device are fast. Not thread-safe.

    launches : DeviceLaunches
    """

    def __init__(self, launches: DeviceLaunches) -> None:
        self._launches = launches
        self._staging: NDArray[np.float32] | None = None

    def write(self, query: ShadowQuery, memory: DeviceMemory, threads: int) -> None:
        """Write the receivers of a query to a block of at least 16 bytes for each."""
        n = query.sides.size
        if self._staging is None or len(self._staging) < n:
            self._staging = self._launches.device.host_array((n, 4), np.float32)
        packed = self._staging[:n]
        run(pack_receivers, threads, new_ticket(n, _PER_SHARE), *_arrays_of(query), packed)
        memory.write(packed)

    def new(self, query: ShadowQuery, threads: int) -> DeviceReceivers:
        """The receivers of a query, in memory of their own."""
        memory, normals = self._launches.allocate(16 * query.n, "the receivers"), None
        self.write(query, memory, threads)
        if query.normals.size and (query.faces < 0).any():
            normals = self._launches.upload(np.ascontiguousarray(query.normals), "the receivers' normals")
        return DeviceReceivers(query, memory, normals)


def _arrays_of(query: ShadowQuery) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int8]]:
    return query.origins, query.faces, query.sides
