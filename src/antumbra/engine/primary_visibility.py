"""Primary visibility in memory: the surfaces that a camera sees, by rasterisation or by rays through a tree.

If no method is named, the faster one is chosen once a tree is cached.

Rays are often faster, if the tree has the form that they walk. Its making would take longer than they save. So rays are
tried where an earlier frame has kept such a tree, and where their kernels are compiled. From then on the method is used
that took less time for a pixel.
"""

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import TypeVar

import numpy as np

from ..bvh import lbvh
from ..bvh.block_tree import BlockTree, block_tree
from ..query.gbuffer import GBuffer, from_hits
from ..query.light_samples import light_samples
from ..query.pixel_refinement import subpixel_gbuffer
from ..query.rasteriser import rasterise
from ..query.ray_passes import camera_pass, rays_through
from ..query.shadow_query import new_bits, shadow_queries
from ..scene.camera import CameraRays
from ..scene.triangle_setup import solid_vertices
from ..scene.triangles import Triangles
from ..techniques.chcrt.chc_rt import nearest_scheduled, primary_hits
from ..techniques.culling.pre_bvh_culling import solid_tree
from ..trace.alpha_test import CutoutTree, add_shadows, cutout_tree, show_cutouts
from ..trace.primary.primary_rays import trace_primary
from ..trace.rays.ray_hits import Nearest, nearest_surfaces
from .accelerator import Accelerated
from .auto.strategies import STRATEGIES
from .precompilation import Job, fixed_job, missing_of, small_scene, small_scene_with_cutouts, small_view

# --- Primary visibility in memory: the surfaces that a camera sees ----------------------------------------------------


def primary_visibility(
    triangles: Triangles,
    camera,
    whole: Accelerated | None = None,
    threads: int | None = None,
    cutouts: CutoutTree | None = None,
) -> GBuffer:
    """The G-buffer of a camera: by rays through `whole`, a BVH of all triangles; by rasterisation if it is None.

    For a camera that is not perspective, a BVH is built if there is none.

    cutouts : of `whole`, or of the triangles if there is no `whole`; None: they are found if there are any
    """
    if camera.listed:
        listed = camera_pass(camera.view(triangles.origin), slice(0, camera.height))
        whole = whole or _any_tree(triangles, threads)
        return next(nearest_in(whole, threads)([listed], (camera.height, camera.width))).gbuffer
    rays = camera.rays(triangles.origin)
    if whole is None:
        face, t = _rasterised(triangles, solid_vertices(triangles, threads), rays, threads)
    elif whole.scheduled is not None:
        face, t = primary_hits(whole.scheduled, rays, threads)
    else:
        blocks = whole.prepared if whole.chosen is None else whole.chosen.forms.of(STRATEGIES["multifrusta"])
        tree = blocks if isinstance(blocks, BlockTree) else whole.bvh
        face, t = trace_primary(tree, rays, threads)
    own = cutouts if whole is None else whole.cutouts
    if own is None:
        own = cutout_tree(triangles, threads)
    if own is not None:
        _show(own, rays, face, t, _in_front(own, rays, face, t, threads), threads)
    return from_hits(face, t, triangles, rays, threads)


def _any_tree(triangles: Triangles, threads: int | None) -> Accelerated:
    """A tree that is built soon."""
    bvh = solid_tree(lbvh.build, triangles, threads)
    return Accelerated(triangles, bvh, None, cutout_tree(triangles, threads))


def nearest_in(whole: Accelerated, threads: int | None = None) -> Nearest:
    """The closest-hit function of a tree of all triangles."""
    cutouts, triangles = whole.cutouts, whole.triangles
    show = partial(show_cutouts, cutouts, threads=threads) if cutouts is not None else None
    if whole.scheduled is not None:
        scheduled = partial(nearest_scheduled, scheduled=whole.scheduled, show=show)
        return partial(scheduled, triangles=triangles, threads=threads)
    assert whole.bvh is not None
    return partial(nearest_surfaces, bvh=whole.bvh, triangles=triangles, threads=threads, show=show)


def subpixel_visibility(
    triangles: Triangles, rays: CameraRays, wanted: np.ndarray, threads: int | None, cutouts: CutoutTree | None
) -> GBuffer:
    """The G-buffer of the sub-pixels of selected pixels: see `query.pixel_refinement`."""
    solid = solid_vertices(triangles, threads)

    def hits(shifted: CameraRays):
        face, t = _rasterised(triangles, solid, shifted, threads)
        if cutouts is not None:
            _show(cutouts, shifted, face, t, wanted, threads)
        return face, t

    return subpixel_gbuffer(triangles, rays, wanted, threads, hits)


def _rasterised(triangles: Triangles, solid: np.ndarray, rays: CameraRays, threads) -> tuple[np.ndarray, np.ndarray]:
    """The nearest solid triangle at each pixel centre: (face, t); `solid`: their `solid_vertices`."""
    face, t = rasterise(solid.reshape(-1, 9), rays, threads)
    if triangles.solid is not None:
        face = np.append(triangles.solid, np.int32(-1))[face]  # the last entry is that of face -1
    return face, t


def _in_front(cutouts: CutoutTree, rays: CameraRays, face, t, threads) -> np.ndarray:
    """(H, W) bool: where the triangle of a cut-out, holes and all, is nearer than what is seen."""
    nearest, depth = trace_primary(cutouts.blocks, rays, threads)
    return (nearest >= 0) & ((depth < t) | ((depth == t) & (nearest < face)))


def _show(cutouts: CutoutTree, rays: CameraRays, face, t, wanted: np.ndarray, threads) -> None:
    """Replace the hits of selected pixels by those on cut-outs that are nearer."""
    faces, ts = face[wanted], t[wanted]
    show_cutouts(cutouts, rays_through(rays, wanted, threads), faces, ts, threads)
    face[wanted], t[wanted] = faces, ts


def cutouts_job() -> Job:
    """The additional job of scenes with cut-outs."""

    def work():
        scene, (camera, lights) = small_scene_with_cutouts(), small_view()
        triangles = scene.triangles(0.0, 2)
        tree = cutout_tree(triangles, 2)
        assert tree is not None
        gbuffer = primary_visibility(triangles, camera, None, 2, tree)
        for query in shadow_queries(triangles, gbuffer, lights, [light_samples(light, 1) for light in lights], 0, 2):
            add_shadows(tree, query, new_bits(query), 2)

    return fixed_job("cut-outs", work)


# --- How a camera's surfaces are found where no method was named: by rasterisation, or by rays through a tree ---------
#
# Rays are often faster, if the tree has the form that they walk. Its making would take longer than they save. So rays
# are tried where an earlier frame has kept such a tree, and where their kernels are compiled. From then on the method
# is used that took less time for a pixel.


RASTER, RAYS, AUTO = METHODS = "raster", "rays", "auto"
_AGAIN = 64  # frames after which the slower method is tried again
_T = TypeVar("_T")


def compiled_for(method: str) -> str:
    """The method whose kernels are compiled before the first frame."""
    return RASTER if method == AUTO else method


class PrimaryMethodChooser:
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
        return not whole.chosen.forms.missing(STRATEGIES["multifrusta"])
    return isinstance(whole.prepared, BlockTree)


def _rays_are_compiled() -> bool:
    wanted = camera_rays_job().kernels()
    return wanted is not None and not missing_of(wanted)


def camera_rays_job() -> Job:
    """The job of camera rays through a tree of blocks."""

    def work():
        triangles, (camera, _) = small_scene().triangles(0.0, 2), small_view()
        bvh = lbvh.build(triangles.vertices, 2)
        primary_visibility(triangles, camera, Accelerated(triangles, bvh, block_tree(bvh, 2)), 2)

    return fixed_job("camera rays", work)
