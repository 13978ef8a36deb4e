"""The protocol of a render source: it supplies triangles and trees, primary visibility and closest hits."""

from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Protocol

import numpy as np

from ..query.ray_list import HitArrays, RayArguments
from ..query.shadow_query import Surfaces
from ..scene.camera import CameraRays
from ..scene.data import SceneData
from ..scene.listed_rays import ListedRays
from ..scene.triangles import Triangles
from ..trace.rays.ray_hits import Nearest
from .accelerate import Accelerated
from .memory import FrameMemory

Progress = Callable[[int, int], Any]
"""Hears (rays done, rays), or whatever a tracer counts, about ten times a second."""


class RenderSource(Protocol):
    """A scene as seen by one `Engine`: `InMemory` or `Paged`.

    default_plan : str
        The plan of an `Engine` without an explicit plan.
    in_store : bool
        True if the triangles are read in chunks when rays reach them.
    looks : int
        How often `look` runs `progress` to its end.
    gbuffer : "raster", "rays" or "auto"
        The method of primary visibility in `look`.
    """

    default_plan: ClassVar[str]
    in_store: ClassVar[bool]
    looks: ClassVar[int]

    @property
    def scene(self) -> SceneData: ...

    @property
    def gbuffer(self) -> str: ...

    def warm_up(self) -> None:
        """Compile the kernels that only this kind of source calls."""

    def begin(self, memory: FrameMemory) -> None:
        """Begin a frame, or a query of points, that takes so much memory.

        Raises
        ------
        InputError
            If memory is too small for the frame.
        """

    def release(self) -> None:
        """Leave the memory of what was read to others."""

    def together(self, size: int) -> int:
        """How many passes, or pictures that they meet, are traced together; `size`: bytes of each."""
        ...

    def at_once(self, size: int) -> int:
        """How many things that take `size` bytes each may be in memory at once."""
        ...

    def moment(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The triangles at a time in seconds; and a tree of all of them, if an earlier frame kept one."""
        ...

    def for_points(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The triangles at a time in seconds, and a tree for a query of points; None: the tree depends on the query."""
        ...

    def keep(self, accelerated: Accelerated) -> None:
        """Offer the tree of a frame's shadow rays for reuse in later frames."""

    def bands(self, height: int) -> Iterator[slice]:
        """Yield the rows of a picture band by band. The caller traces the camera and shadow rays of each in turn."""
        ...

    def look(
        self, camera, triangles: Triangles, whole: Accelerated | None, progress=None, rows: slice | None = None
    ) -> Surfaces:
        """The surfaces that a camera sees.

        whole : a tree of all triangles; never None where `gbuffer` is "rays" or the camera is not perspective
        rows : a band of the picture; None: all
        """
        ...

    def nearest_in(self, whole: Accelerated) -> Nearest:
        """A closest-hit function: it finds the first surfaces that passes of diffuse rays meet."""
        ...

    def subpixels(
        self, triangles: Triangles, view: CameraRays | ListedRays, edge: np.ndarray, whole: Accelerated | None
    ) -> Surfaces:
        """The surfaces of the sub-pixels of selected pixels: see `query.pixel_refinement`; `whole`: as in `look`."""
        ...

    def trace_rays(self, rays: RayArguments, any_hit: bool, time: float, threads: int | None = None) -> HitArrays:
        """Trace a list of rays at a time within 0 .. `duration`.

        Raises
        ------
        InputError
            If a ray holds an invalid number.
        """
        ...

    def triangles_hit(self, rays: RayArguments, face: np.ndarray, time: float) -> tuple[Triangles, np.ndarray]:
        """The triangles that rays with these hits meet, and the index of each ray's triangle in them, or -1."""
        ...

    def box(self, triangles: Triangles) -> np.ndarray:
        """(2, 3) float32: bounds of the scene with these triangles, in the recentred frame."""
        ...

    def paging(self) -> dict[str, int] | None:
        """Counts of chunks read and evicted since `begin`; None if the scene is in memory."""
        ...
