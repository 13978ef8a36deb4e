"""How a camera's surfaces are found where no method was named: by rasterisation, or by rays through a tree.

Rays are often faster, if the tree has the form that they walk. Its making would take longer than they save. So rays are
tried where an earlier frame has kept such a tree, and where their kernels are compiled. From then on the method is used
that took less time for a pixel.
"""

from collections.abc import Callable
from time import perf_counter
from typing import TypeVar

from ..auto.ways import WAYS
from ..bvh import lbvh
from ..bvh.blocks import BlockTree, block_tree
from .accelerate import Accelerated
from .ready import Job, fixed_job, missing_of, small_scene, small_view
from .see import see

RASTER, RAYS, AUTO = METHODS = "raster", "rays", "auto"
_AGAIN = 64  # frames after which the slower method is tried again
_T = TypeVar("_T")


def compiled_for(method: str) -> str:
    """The method whose kernels are compiled before the first frame."""
    return RASTER if method == AUTO else method


class Looking:
    """What the methods have taken in the frames so far."""

    def __init__(self) -> None:
        self._calls = {RASTER: 0, RAYS: 0}
        self._seconds: dict[str, float] = {}  # method -> seconds for a pixel in its last frame
        self._frames = 0

    def choose(self, whole: Accelerated | None) -> str:
        """The method of the next frame; `whole`: a tree of all triangles that an earlier frame has kept."""
        if whole is None or not _has_blocks(whole):
            return RASTER
        if self._calls[RAYS] == 0 and not _rays_are_compiled():
            return RASTER
        for method in RASTER, RAYS:
            if method not in self._seconds:
                return method
        self._frames += 1
        slower, faster = sorted(self._seconds, key=self._seconds.__getitem__, reverse=True)
        return slower if self._frames % _AGAIN == 0 else faster

    def timed(self, method: str, pixels: int, look: Callable[[], _T]) -> _T:
        """The result of `look`, whose time is noted. The first call of a method is not, since it loads kernels."""
        start = perf_counter()
        seen = look()
        self._calls[method] += 1
        if self._calls[method] > 1:
            self._seconds[method] = (perf_counter() - start) / pixels
        return seen


def _has_blocks(whole: Accelerated) -> bool:
    """Has the tree the form that camera rays walk?"""
    if whole.chosen is not None:
        return not whole.chosen.forms.missing(WAYS["multifrusta"])
    return isinstance(whole.prepared, BlockTree)


def _rays_are_compiled() -> bool:
    wanted = camera_rays_job().kernels()
    return wanted is not None and not missing_of(wanted)


def camera_rays_job() -> Job:
    """The job of camera rays through a tree of blocks."""

    def work():
        triangles, (camera, _) = small_scene().triangles(0.0, 2), small_view()
        bvh = lbvh.build(triangles.vertices, 2)
        see(triangles, camera, Accelerated(triangles, bvh, block_tree(bvh, 2)), 2)

    return fixed_job("camera rays", work)
