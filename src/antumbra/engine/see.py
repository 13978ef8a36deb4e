"""Primary visibility in memory: the surfaces that a camera sees."""

from functools import partial

import numpy as np

from ..auto.ways import WAYS
from ..bvh import lbvh
from ..bvh.blocks import BlockTree
from ..query.gbuffer import GBuffer, from_hits
from ..query.light_samples import light_samples
from ..query.pixel_refinement import subpixel_gbuffer
from ..query.rasteriser import rasterise
from ..query.ray_passes import camera_pass, rays_through
from ..query.shadow_query import new_bits, shadow_queries
from ..scene.areas import solid_vertices
from ..scene.camera import CameraRays
from ..scene.triangles import Triangles
from ..techniques.chcrt.chc_rt import nearest_scheduled, primary_hits
from ..techniques.culling.pre_bvh_culling import solid_tree
from ..trace.alpha_test import CutoutTree, add_shadows, cutout_tree, show_cutouts
from ..trace.primary.primary_rays import trace_primary
from ..trace.rays.ray_hits import Nearest, nearest_surfaces
from .accelerate import Accelerated
from .ready import Job, fixed_job, small_scene_with_cutouts, small_view


def see(
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
        blocks = whole.prepared if whole.chosen is None else whole.chosen.forms.of(WAYS["multifrusta"])
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


def see_subpixels(
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
        gbuffer = see(triangles, camera, None, 2, tree)
        for query in shadow_queries(triangles, gbuffer, lights, [light_samples(light, 1) for light in lights], 0, 2):
            add_shadows(tree, query, new_bits(query), 2)

    return fixed_job("cut-outs", work)
