"""Triangles in the memory of a device, which are copied to the host only when something there reads their vertices."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..base.fetched_fields import FetchedFields
from .triangles import Triangles


class FramedVertices(NamedTuple):
    """The triangles of a scene on a device, in the scene's frame."""

    memory: Any  # the device's block of 36 n bytes, (n, 3, 3) float32
    fetch: Callable[[], NDArray[np.float32]]  # copies them to the host
    with_area: NDArray[np.int32] | None  # as `triangle_setup.rows_with_area`
    bounds: NDArray[np.float32]  # (2, 3) float32: lower and upper corner
    exact: bool  # whether rounding in the frame lost nothing of the world coordinates


@runtime_checkable
class DeviceVertices(Protocol):
    """New vertices of a scene in an array on a device."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def in_frame(self, corners: NDArray[np.int32] | None, origin: NDArray[np.float64], name: str) -> FramedVertices:
        """The triangles, in the frame at `origin`.

        corners : (3 n,) int32, the vertex of each corner; None: the vertices are the corners
        name : of the scene, for errors

        Raises
        ------
        InputError
            If a vertex is NaN, infinite, or too far from the frame.
        """


class ResidentTriangles(FetchedFields, Triangles):
    """Triangles on a device. `vertices` is fetched when it is first read, and kept.

    memory, bounds : as in `FramedVertices`
    """

    _plain = Triangles
    memory: Any
    bounds: NDArray[np.float32]
    _fetch: Callable[[], NDArray[np.float32]]

    @classmethod
    def of(cls, framed: FramedVertices, triangles: Triangles) -> "ResidentTriangles":
        """Triangles with the vertices of `framed`, and everything else of `triangles`."""
        new = cls._make(triangles)
        new.memory, new.bounds, new._fetch = framed.memory, framed.bounds, framed.fetch
        return new

    @property
    def vertices(self) -> NDArray[np.float32]:
        if "_fetched" not in vars(self):
            self._fetched = self._fetch()
        return self._fetched
