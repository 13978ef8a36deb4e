"""Primary visibility in memory: the surfaces visible to a camera, by rasterisation or by rays through a tree.

A device that holds the tree, or rasterises, finds them there; they stay there until the host reads them.

If no method is given, `PrimaryMethodChooser` chooses one. Rays are often faster if there is a tree of blocks, but
building one would take longer than they save. So rays are tried only if an earlier frame has cached such a tree and
their kernels are compiled. From then on, the method with the lower time per pixel is used.
"""

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from ..bvh import lbvh
from ..bvh.block_tree import BlockTree
from ..devices.device import OutOfDeviceMemory
from ..kernels.exact.filters import BEYOND
from ..kernels.parallel import thread_count
from ..kernels.toolchain.kernel_manifest import kernels_of_warm_up
from ..query.gbuffer import GBuffer, from_hits
from ..query.pixel_refinement import subpixel_gbuffer
from ..query.rasteriser import rasterise
from ..query.ray_passes import camera_pass, rays_through
from ..scene.camera import Camera, CameraRays, ExplicitRays
from ..scene.triangle_setup import solid_vertices
from ..scene.triangles import Triangles
from ..techniques.chcrt.chc_rt import nearest_scheduled, primary_hits
from ..techniques.culling.pre_bvh_culling import solid_tree
from ..trace.alpha_cutouts import CutoutTree, cutout_tree, replace_by_cutouts
from ..trace.primary.primary_rays import trace_primary
from ..trace.rays.ray_hits import Nearest, nearest_surfaces
from ..trace.tracer import BLOCKS
from .accelerator import Accelerated
from .auto.strategies import AutoState
from .device_tracers import OnDevice, free_blocks
from .precompilation import are_on_disk

# --- Primary visibility -----------------------------------------------------------------------------------------------


def primary_visibility(
    triangles: Triangles,
    camera: Camera,
    tree: Accelerated | None = None,
    threads: int | None = None,
    cutouts: CutoutTree | None = None,
    draw: Callable[[Triangles, CameraRays], GBuffer | None] | None = None,
) -> GBuffer:
    """The G-buffer of a camera by rays through `tree`, a BVH of all triangles, or by rasterisation if it is None.

    For a camera that is not perspective, a BVH is built if there is none.

    cutouts : the tree of alpha-masked faces, used if `tree` is None; None: build it if there are such faces
    draw : rasterises on a device, if `tree` is None; None: there is none. It may return None, too
    """
    if camera.listed:
        listed = camera_pass(cast(ExplicitRays, camera.view(triangles.origin)), slice(0, camera.height))
        tree = tree or _any_tree(triangles, threads)
        return next(nearest_in(tree, threads)([listed], (camera.height, camera.width))).gbuffer
    rays = camera.rays(triangles.origin)
    if tree is not None and isinstance(tree.prepared, OnDevice):
        try:
            return tree.prepared.see(triangles, rays, tree.cutouts, thread_count(threads))
        except OutOfDeviceMemory:
            free_blocks(tree.prepared.tracer)
            cutouts, tree = tree.cutouts, None
    drawn = draw(triangles, rays) if tree is None and draw is not None else None
    if drawn is not None:
        return drawn
    if tree is None:
        face, t = _rasterised(triangles, solid_vertices(triangles, threads), rays, threads)
    elif tree.scheduled is not None:
        face, t = primary_hits(tree.scheduled, rays, threads)
    else:
        blocks = tree.chosen.forms.of(BLOCKS) if isinstance(tree.chosen, AutoState) else tree.prepared
        blocks_or_bvh = blocks if isinstance(blocks, BlockTree) else tree.bvh
        assert blocks_or_bvh is not None
        face, t = trace_primary(blocks_or_bvh, rays, threads)
    alpha_tree = cutouts if tree is None else tree.cutouts
    if alpha_tree is None:
        alpha_tree = cutout_tree(triangles, threads)
    if alpha_tree is not None:
        _show_cutouts(alpha_tree, rays, face, t, _cutouts_in_front(alpha_tree, rays, t, threads), threads)
    return from_hits(face, t, triangles, rays, threads)


def _any_tree(triangles: Triangles, threads: int | None) -> Accelerated:
    """A tree that is quick to build."""
    bvh = solid_tree(lbvh.build, triangles, threads)
    return Accelerated(triangles, bvh, None, cutout_tree(triangles, threads))


def nearest_in(tree: Accelerated, threads: int | None = None) -> Nearest:
    """The closest-hit function of a tree of all triangles."""
    cutouts, triangles = tree.cutouts, tree.triangles
    show = partial(replace_by_cutouts, cutouts, threads=threads) if cutouts is not None else None
    if tree.scheduled is not None:
        scheduled = partial(nearest_scheduled, scheduled=tree.scheduled, show=show)
        return partial(scheduled, triangles=triangles, threads=threads)
    bvh = tree.host_bvh
    assert bvh is not None
    return partial(nearest_surfaces, bvh=bvh, triangles=triangles, threads=threads, show=show)


def subpixel_visibility(
    triangles: Triangles, rays: CameraRays, selected: np.ndarray, threads: int | None, cutouts: CutoutTree | None
) -> GBuffer:
    """The G-buffer of the sub-pixels of selected pixels, see `query.pixel_refinement`."""
    solid = solid_vertices(triangles, threads)

    def hits(shifted: CameraRays) -> tuple[np.ndarray, np.ndarray]:
        face, t = _rasterised(triangles, solid, shifted, threads)
        if cutouts is not None:
            _show_cutouts(cutouts, shifted, face, t, selected, threads)
        return face, t

    return subpixel_gbuffer(triangles, rays, selected, threads, hits)


def _rasterised(
    triangles: Triangles, solid: np.ndarray, rays: CameraRays, threads: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """The nearest solid triangle at each pixel centre: (face, t); `solid`: the `solid_vertices` of the triangles."""
    face, t = rasterise(solid.reshape(-1, 9), rays, threads)
    if triangles.solid is not None:
        face = np.append(triangles.solid, np.int32(-1))[face]  # the last entry is that of face -1
    return face, t


def _cutouts_in_front(cutouts: CutoutTree, rays: CameraRays, t: np.ndarray, threads: int | None) -> NDArray[np.bool_]:
    """(H, W) bool: where an alpha-masked triangle, including its holes, may be in front of the visible surface."""
    nearest, depth = trace_primary(cutouts.blocks, rays, threads)
    in_front: NDArray[np.bool_] = (nearest >= 0) & (depth <= t * BEYOND)
    return in_front


def _show_cutouts(
    cutouts: CutoutTree, rays: CameraRays, face: np.ndarray, t: np.ndarray, selected: np.ndarray, threads: int | None
) -> None:
    """Replace the hits of selected pixels by nearer hits on alpha-masked faces."""
    faces, ts = face[selected], t[selected]
    replace_by_cutouts(cutouts, rays_through(rays, selected, threads), faces, ts, threads)
    face[selected], t[selected] = faces, ts


# --- Choose between rasterisation and primary rays --------------------------------------------------------------------


RASTER, RAYS, AUTO = METHODS = "raster", "rays", "auto"
RETRY_PERIOD = 64
"""Frames after which the slower method is tried again."""

_T = TypeVar("_T")


def precompiled_method(method: str) -> str:
    """The method whose kernels are compiled before the first frame, given the `gbuffer` option."""
    return RASTER if method == AUTO else method


class PrimaryMethodChooser:
    """Chooses a method by the time per pixel of earlier frames."""

    def __init__(self) -> None:
        self._calls = {RASTER: 0, RAYS: 0}
        self._seconds: dict[str, float] = {}  # method -> seconds per pixel in its last frame
        self._frames = 0

    def choose(self, tree: Accelerated | None) -> str:
        """The method of the next frame; `tree`: a tree of all triangles, cached by an earlier frame."""
        if tree is None or not has_blocks(tree):
            return RASTER
        if self._calls[RAYS] == 0 and not rays_are_compiled():
            return RASTER
        for method in RASTER, RAYS:
            if method not in self._seconds:
                return method
        self._frames += 1
        slower, faster = sorted(self._seconds, key=self._seconds.__getitem__, reverse=True)
        return slower if self._frames % RETRY_PERIOD == 0 else faster

    def timed(self, method: str, pixels: int, look: Callable[[], _T]) -> _T:
        """Call `look` and record its time, except in the first call of a method, which loads kernels."""
        start = perf_counter()
        result = look()
        self._calls[method] += 1
        if self._calls[method] > 1:
            self._seconds[method] = (perf_counter() - start) / pixels
        return result


def has_blocks(tree: Accelerated) -> bool:
    """Whether the tree exists in the form that camera rays traverse."""
    if isinstance(tree.chosen, AutoState):
        return not tree.chosen.forms.missing(BLOCKS)
    return isinstance(tree.prepared, BlockTree)


def rays_are_compiled() -> bool:
    """Whether the kernels of camera rays are compiled."""
    return are_on_disk(kernels_of_warm_up("camera rays"))
