"""Kernels for faces that let light pass: one thread walks the tree of the cut-outs, and reads a texel at each hit.

They run after those of the solid triangles, see `trace.alpha_cutouts`. A test that float32 does not exclude is decided
in float64 at once, and so is the texel, by the CPU's expression. A ray for which float64 leaves a test, a texel or the
order of two hits undecided becomes a record (`device_kernels`), and the CPU traces it through the cut-outs.

- `block_rays`: any hit of a ray list, of texels that closest hits meet
- `nearest_cutouts`: hits of a ray list that precede those on solid triangles
- `sum_depths_of_samples`: the depths along shadow segments; which ones are dark, or meet a cut-out
- `write_shares`: the transmittances of samples
"""

from typing import NamedTuple

import numpy as np

from ...kernels.device import i64_at, thread_index, u8_at
from ...kernels.exact.filters import BEYOND, END_FLOOR, MISS, T_ACCURACY, UNKNOWN, UNSURE, smaller, volumes64
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel, overload
from ...kernels.simd import f32_at, f64_at, get, i32_at, put, stack_f32, stack_i32
from ...kernels.toolchain.device_code import DeviceKernel
from ...scene.alpha_masks import DARK
from ..alpha_cutouts import TexelPointers, texel_place
from ..transmission import power_of
from .device_kernels import (
    HITS,
    RAYS,
    SAMPLES,
    TREE,
    WORK,
    add_kernels,
    add_record,
    copy_corners,
    exact_t,
    hit_order,
    side_of_hit,
)
from .device_rays import BLOCKED, CLEAR, TRACED, ray_at
from .device_traversal import GO_ON, PRIM, TRIANGLE, UNDECIDED, TreeBuffers, visit, walk_candidates

KEPT = -3
"""Instead of the slot of a cut-out: the hit on a solid triangle, or the miss, stands."""

SUMS = 4  # int32 per ray: the depths of red, green and blue, and 1 if it meets a cut-out


class CutoutBuffers(NamedTuple):
    """The cut-outs of a scene on a device: their tree, and the addresses of the arrays of `AlphaTexels`."""

    tree: TreeBuffers
    uv: int
    mask: int
    shapes: int
    first: int
    texels: int
    rows: int
    depths: int


class CutoutWork(NamedTuple):
    """The rays of a launch, and what it reads and writes besides the buffers of `Work`: addresses on the device."""

    first: int  # the launch traces rays from this one on, counted from `Work.first`
    n: int  # number of rays
    found: int = 0  # int32 per ray: slot of the cut-out that it hits first, or KEPT
    occluded: int = 0  # int32, `words` per receiver: the samples that are known to be dark, a bit each
    words: int = 0
    sums: int = 0  # int32, SUMS per ray; 0: states tell which samples are dark, otherwise which ones meet a cut-out


# --- One test ---------------------------------------------------------------------------------------------------------


@inlined
def _texels(cutouts):
    return TexelPointers(
        f32_at(cutouts.uv), i32_at(cutouts.mask), i32_at(cutouts.shapes), i64_at(cutouts.first), u8_at(cutouts.texels),
        i64_at(cutouts.rows), i32_at(cutouts.depths),
    )  # fmt: skip


@inlined
def _place_of_hit(visitor, ray, slot):
    """(the sign of d . n, place of the texel's depths) of a hit on a cut-out; or MISS or UNSURE, and any place."""
    copy_corners(visitor.cutouts.tree, slot, visitor.corners)
    side = side_of_hit(ray, visitor.corners, visitor.cull_faces)
    if side == MISS or side == UNSURE:
        return side, np.int64(0)
    w = volumes64(ray, visitor.corners, 0)
    certain = T_ACCURACY * abs(w.d)  # as in `filters.weights`
    if not (w.e_error <= certain and w.d_error <= certain):
        return UNSURE, np.int64(0)
    return side, np.int64(texel_place(_texels(visitor.cutouts), slot, w.e1 / w.d, w.e2 / w.d))


@inlined
def _depth(visitor, at):
    return get(i32_at(visitor.cutouts.depths), at)


# --- Visitors ---------------------------------------------------------------------------------------------------------


class _BlockingTexel(NamedTuple):
    """Finds a texel that closest hits meet: BLOCKED."""

    cutouts: CutoutBuffers
    cull_faces: int
    limit: F32Ptr  # tmax
    corners: F32Ptr  # 9 float32


@inlined
def _visit_any(visitor, r, slot):
    side, at = _place_of_hit(visitor, r.ray, slot)
    if side == MISS:
        return GO_ON
    if side == UNSURE:
        return UNDECIDED
    return GO_ON if _depth(visitor, at + 3) == 0 else BLOCKED


class _DepthSums(NamedTuple):
    """Adds up depths, until all light is blocked: BLOCKED."""

    cutouts: CutoutBuffers
    cull_faces: int
    limit: F32Ptr
    corners: F32Ptr
    sums: I32Ptr  # SUMS int32


@inlined
def _visit_sums(visitor, r, slot):
    """Whoever is certain to meet the triangle meets it within its edges, and thus crosses the surface."""
    side, at = _place_of_hit(visitor, r.ray, slot)
    if side == MISS:
        return GO_ON
    if side == UNSURE:
        return UNDECIDED
    put(visitor.sums, 3, 1)
    lit = False
    for c in range(3):
        total = min(np.int64(get(visitor.sums, c)) + np.int64(_depth(visitor, at + c)), np.int64(DARK + 1))
        put(visitor.sums, c, total)
        lit = lit or total <= DARK
    return GO_ON if lit else BLOCKED


_SLOT, _PRIM = range(2)  # of `_NearestTexel.best`


class _NearestTexel(NamedTuple):
    """Finds the cut-out that a ray hits first, before a solid triangle."""

    cutouts: CutoutBuffers
    cull_faces: int
    limit: F32Ptr  # at or behind the t of the best hit
    corners: F32Ptr
    best: I32Ptr  # of the best hit so far, its slot if it is a cut-out, or KEPT; index of its triangle, or -1
    best_corners: F32Ptr  # 9 float32


@inlined
def _visit_nearest(visitor, r, slot, prim):
    side, at = _place_of_hit(visitor, r.ray, slot)
    if side == MISS:
        return GO_ON
    if side == UNSURE:
        return UNDECIDED
    if _depth(visitor, at + 3) == 0:
        return GO_ON
    order, best, t = 1, np.int64(get(visitor.best, _PRIM)), exact_t(r.ray, visitor.corners)
    if best >= 0:
        order = hit_order(r.ray, visitor.corners, prim, side, visitor.best_corners, best)
    if order == 0 or t == UNKNOWN:
        return UNDECIDED
    if order > 0:
        put(visitor.best, _SLOT, slot)
        put(visitor.best, _PRIM, prim)
        put(visitor.limit, 0, np.float32(t * BEYOND) + END_FLOOR)
        for k in range(9):
            put(visitor.best_corners, k, get(visitor.corners, k))
    return GO_ON


@overload(visit)
def _visit(visitor, r, slot, prim):
    if visitor.instance_class is _BlockingTexel:
        return lambda visitor, r, slot, prim: _visit_any(visitor, r, slot)
    if visitor.instance_class is _DepthSums:
        return lambda visitor, r, slot, prim: _visit_sums(visitor, r, slot)
    if visitor.instance_class is _NearestTexel:
        return lambda visitor, r, slot, prim: _visit_nearest(visitor, r, slot, prim)
    return None


# --- Kernels ----------------------------------------------------------------------------------------------------------


@kernel
def block_rays(cutouts, rays, work, part):  # cutouts: CutoutBuffers, rays: RayBuffers, work: Work, part: CutoutWork
    """Change the state of CLEAR rays that a cut-out blocks to BLOCKED."""
    k, corners, limit = thread_index(), stack_f32(9), stack_f32(1)
    if k >= part.n:
        return
    j = part.first + k
    if get(i32_at(work.out), j) != CLEAR:
        return
    r = ray_at(rays, work.first + j)
    if r.state != TRACED:
        return
    put(limit, 0, np.float32(r.ray.tmax))
    answer = walk_candidates(cutouts.tree, r, _BlockingTexel(cutouts, work.cull_faces, limit, corners))
    if answer == BLOCKED:
        put(i32_at(work.out), j, BLOCKED)
    elif answer == UNDECIDED:
        add_record(work, j, r.skip, -1, r.ray)


@inlined
def _is_occluded(occluded, words, i, s):
    return get(i32_at(occluded), i * words + (s >> 5)) >> np.int32(s & 31) & 1 != 0


@kernel
def sum_depths_of_samples(cutouts, rays, work, part):  # cutouts: CutoutBuffers, work: Work, part: CutoutWork
    """Add up depths along `rays` that are not known to be occluded; write their states, and sums if wanted."""
    k, corners, limit, sums = thread_index(), stack_f32(9), stack_f32(1), stack_i32(SUMS)
    if k >= part.n:
        return
    j, answer = part.first + k, np.int64(GO_ON)
    for c in range(SUMS):
        put(sums, c, 0)
    if not _is_occluded(part.occluded, part.words, j // rays.spp, j % rays.spp):
        r = ray_at(rays, work.first + j)
        if r.state == TRACED:
            put(limit, 0, np.float32(r.ray.tmax))
            answer = walk_candidates(cutouts.tree, r, _DepthSums(cutouts, work.cull_faces, limit, corners, sums))
            if answer == UNDECIDED:
                add_record(work, j, r.skip, -1, r.ray)
    if part.sums == 0:
        put(i32_at(work.out), j, BLOCKED if answer == BLOCKED else CLEAR)
        return
    for c in range(SUMS):
        put(i32_at(part.sums), SUMS * j + c, get(sums, c))
    put(i32_at(work.out), j, BLOCKED if get(sums, 3) != 0 else CLEAR)


@kernel
def nearest_cutouts(solid, cutouts, rays, work, hits, part):  # solid: TreeBuffers, cutouts: CutoutBuffers, work: Work
    """Find the cut-outs that a part of the rays hit before `Work.out`, solid triangles whose hits have numbers."""
    k, corners, limit = thread_index(), stack_f32(9), stack_f32(1)
    best, best_corners, f = stack_i32(2), stack_f32(9), np.float32
    if k >= part.n:
        return
    j = part.first + k
    slot, r = np.int64(get(i32_at(work.out), j)), ray_at(rays, work.first + j)
    put(best, _SLOT, KEPT)
    put(best, _PRIM, -1)
    put(limit, 0, f(r.ray.tmax))
    if slot >= 0:
        copy_corners(solid, slot, best_corners)
        put(best, _PRIM, get(i32_at(solid.triangles), TRIANGLE * slot + PRIM))
        put(limit, 0, smaller(f(r.ray.tmax), f(get(f64_at(hits.t), j) * BEYOND) + END_FLOOR))
    answer = np.int64(GO_ON)
    if r.state == TRACED:
        visitor = _NearestTexel(cutouts, work.cull_faces, limit, corners, best, best_corners)
        answer = walk_candidates(cutouts.tree, r, visitor)
    if answer == UNDECIDED:
        add_record(work, j, r.skip, slot, r.ray)
    put(i32_at(part.found), j, get(best, _SLOT))


class ShareBuffers(NamedTuple):
    """What `write_shares` reads and writes: addresses on the device, and numbers."""

    receivers: int  # int32: whose samples are wanted
    n: int  # their number
    spp: int
    channels: int
    occluded: int  # int32, as in `CutoutWork`
    words: int
    sums: int  # int32, SUMS per sample of all receivers
    powers: int  # float64, `transmission.POWERS`
    values: int  # float32, (n, spp, channels)


@kernel
def write_shares(shares):  # shares: ShareBuffers
    """Write the transmittances of the samples of some receivers, a channel per thread."""
    k = thread_index()
    at, c = k // shares.channels, k % shares.channels
    if at >= shares.n * shares.spp:
        return
    i, s = np.int64(get(i32_at(shares.receivers), at // shares.spp)), at % shares.spp
    depth = np.int64(get(i32_at(shares.sums), SUMS * (i * shares.spp + s) + c))
    dark = depth > DARK or _is_occluded(shares.occluded, shares.words, i, s)
    put(f32_at(shares.values), k, np.float32(0.0) if dark else power_of(f64_at(shares.powers), depth))


_CUTOUTS = CutoutBuffers(TREE, 0, 0, 0, 0, 0, 0, 0)
_PART = CutoutWork(0, 0)

CUTOUT_KERNELS = {
    "block_rays": DeviceKernel(block_rays, (_CUTOUTS, RAYS, WORK, _PART)),
    "sum_depths_of_samples": DeviceKernel(sum_depths_of_samples, (_CUTOUTS, SAMPLES, WORK, _PART)),
    "nearest_cutouts": DeviceKernel(nearest_cutouts, (TREE, _CUTOUTS, RAYS, WORK, HITS, _PART)),
    "write_shares": DeviceKernel(write_shares, (ShareBuffers(0, 0, 0, 0, 0, 0, 0, 0, 0),)),
}
add_kernels(CUTOUT_KERNELS)
