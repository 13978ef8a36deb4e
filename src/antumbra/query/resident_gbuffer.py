"""The G-buffer of a picture on a device, whose arrays are copied to the host when something there reads them."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..base.fetched_fields import FetchedFields
from ..scene.triangles import Triangles
from .gbuffer import GBuffer


class ResidentSurfaces(Protocol):
    """The surfaces that the pixels of an (H, W) picture see, and their receivers, on a device.

    The arrays are copies on the host, made when they are first read, and kept: those of `GBuffer`, and

    origins : (H, W, 3) float32, the receivers, as `ShadowQuery.origins`
    normals : (H, W, 3) float64, `normal` in float64
    """

    triangles: Triangles
    shape: tuple[int, int]

    @property
    def device(self) -> Any: ...
    @property
    def position(self) -> NDArray[np.float32]: ...
    @property
    def normal(self) -> NDArray[np.float32]: ...
    @property
    def normals(self) -> NDArray[np.float64]: ...
    @property
    def face(self) -> NDArray[np.int32]: ...
    @property
    def depth(self) -> NDArray[np.float32]: ...
    @property
    def side(self) -> NDArray[np.int8]: ...
    @property
    def origins(self) -> NDArray[np.float32]: ...
    def corners_of(self, faces: NDArray[np.int32]) -> NDArray[np.float32]:
        """(k, 9) float32: the corners of k of the triangles."""


class ResidentGBuffer(FetchedFields, GBuffer):
    """A `GBuffer` on a device.

    there : ResidentSurfaces
    """

    _plain = GBuffer
    there: ResidentSurfaces

    @classmethod
    def of(cls, there: ResidentSurfaces) -> "ResidentGBuffer":
        """The G-buffer of these surfaces."""
        new = cls._make([*[None] * 5, there.triangles.origin])
        new.there = there
        return new

    position = property(lambda self: self.there.position)
    normal = property(lambda self: self.there.normal)
    face = property(lambda self: self.there.face)
    depth = property(lambda self: self.there.depth)
    side = property(lambda self: self.there.side)
