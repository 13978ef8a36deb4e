"""Alpha testing: rays that no solid triangle blocks are tested against faces that let light pass, the *cut-outs*.

The solid triangles of a scene are in the plan's own tree, whose tracer reads no textures. Cut-outs are in a separate
tree, the same for every plan, which is traced after the solid triangles. `add_shadows` adds the segments that cut-outs
darken to a tracer's bits, and `add_nearest` replaces hits on solid triangles by nearer hits on cut-outs. A shadow ray
reads texels only if shafts have determined that it may meet a cut-out, and nothing solid blocks it.

A segment is dark if the product of the transmittances of the cut-outs that it meets is below 1/256
(`scene.alpha_masks.DARK`). A ray that crosses the common edge or vertex of several cut-outs counts each surface once
(`kernels.exact.surface_crossing`). `trace.transmission` has the products.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh import binned_sah
from ..bvh.block_tree import BlockTree, block_tree
from ..bvh.nodes import LEFT_FIRST, Bvh, tree_of
from ..kernels.exact.filters import BEYOND, comes_first, single_weights, weights
from ..kernels.exact.predicate import ray_along, segment
from ..kernels.exact.surface_crossing import crosses_surface
from ..kernels.jit import F32Ptr, I32Ptr, I64Ptr, U8Ptr, inlined, kernel, overload
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import get, lowest_bit, ptr, put, stack_i32
from ..kernels.vec3 import get3
from ..query.ray_list import HitArrays, RayArrays
from ..query.ray_passes import RayPass
from ..query.shadow_query import ShadowQuery, new_bits, patch_of, query_pointers, sample_of, set_bit
from ..scene.alpha_masks import DARK, Cutouts, channels_of
from ..scene.materials import CLAMP, MIRROR
from ..scene.triangle_setup import rows_with_area
from ..scene.triangles import AllHits, Triangles
from .frusta.multi_frusta import trace_shadow
from .rays.local_rays import LocalRays, local_pass, local_ray, local_rays
from .rays.ray_traversal import CLOSEST, ignores_hit, triangle_hit, walk

# --- Texels of cut-outs -----------------------------------------------------------------------------------------------


class AlphaTexels(NamedTuple):
    """The data by which slots of a cut-out tree find their texels: see `scene.alpha_masks.Cutouts`."""

    uv: np.ndarray  # (m, 6) float32, slot -> texture coordinates of the three corners
    mask: np.ndarray  # (m,) int32, slot -> mask
    shapes: np.ndarray  # (p, 4) int32
    first: np.ndarray  # (p,) int64
    texels: np.ndarray  # (b,) uint8
    rows: np.ndarray  # (p,) int64
    depths: np.ndarray  # (r, 4) int32


class TexelPointers(NamedTuple):
    """Pointers to the arrays of `AlphaTexels`, which must outlive them."""

    uv: F32Ptr  # float32 *
    mask: I32Ptr  # int32 *
    shapes: I32Ptr  # int32 *
    first: I64Ptr  # int64 *
    texels: U8Ptr  # uint8 *
    rows: I64Ptr  # int64 *
    depths: I32Ptr  # int32 *


@inlined
def texel_pointers(texels):
    """`TexelPointers` of `AlphaTexels`."""
    return TexelPointers(
        ptr(texels.uv), ptr(texels.mask), ptr(texels.shapes), ptr(texels.first), ptr(texels.texels),
        ptr(texels.rows), ptr(texels.depths),
    )  # fmt: skip


@inlined
def _wrapped(x, size, wrap):
    """The texel, 0 to size - 1, at coordinate x of the repeated texture."""
    if wrap == CLAMP:
        return min(max(x, 0), size - 1)
    if wrap == MIRROR:
        x = x % (2 * size)
        return x if x < size else 2 * size - 1 - x
    return x % size


@inlined
def _inside(weight):
    """The weight, clamped to 0 .. 1, which rounding may have exceeded."""
    return min(max(weight, np.float64(0.0)), np.float64(1.0))


@inlined
def _texture_coordinate(uv, slot, axis, b, c):
    f, at = np.float64, 6 * slot + axis
    return (1.0 - b - c) * f(get(uv, at)) + b * f(get(uv, at + 2)) + c * f(get(uv, at + 4))


@inlined
def texel_place(texels, slot, b, c):
    """The place in `depths` of the texel at weights b and c of the cut-out in `slot`. This expression defines it."""
    b, c = _inside(b), _inside(c)
    k = get(texels.mask, slot)
    w, h = get(texels.shapes, 4 * k), get(texels.shapes, 4 * k + 1)
    u = np.int64(np.floor(_texture_coordinate(texels.uv, slot, 0, b, c) * w))
    v = np.int64(np.floor(_texture_coordinate(texels.uv, slot, 1, b, c) * h))
    x, y = _wrapped(u, w, get(texels.shapes, 4 * k + 2)), _wrapped(v, h, get(texels.shapes, 4 * k + 3))
    return 4 * (get(texels.rows, k) + np.int64(get(texels.texels, get(texels.first, k) + y * w + x)))


@kernel
def _depths_at(texels, ray, corners, slot):
    """Where the ray meets the cut-out in `slot`: the place of its texel's depths."""
    b, c = weights(ray, corners, slot)
    return texel_place(texels, slot, b, c)


@inlined
def is_hole(texels, ray, corners, slot):
    """True if closest hits ignore the cut-out in `slot` where the ray meets it."""
    return get(texels.depths, _depths_at(texels, ray, corners, slot) + 3) == 0


class DepthSum(NamedTuple):
    """A hit filter that adds up the depths of cut-outs, and ignores hits until all light is blocked."""

    texels: TexelPointers
    sums: I32Ptr  # int32 *: red, green and blue; `DARK` + 1 is the most


@inlined
def _is_opaque(texels, at):
    """Whether the texel with depths at `at` blocks all light."""
    depths = texels.depths
    return get(depths, at) > DARK and get(depths, at + 1) > DARK and get(depths, at + 2) > DARK


@kernel
def _stays_lit(depth, ray, corners, slot):
    """Add the depths of a cut-out that the ray meets. Returns whether some light still passes."""
    at, lit = _depths_at(depth.texels, ray, corners, slot), False
    if not _is_opaque(depth.texels, at) and not crosses_surface(ray, corners, slot):
        return True
    for c in range(3):
        total = min(get(depth.sums, c) + get(depth.texels.depths, at + c), np.int32(DARK + 1))
        put(depth.sums, c, total)
        lit = lit or total <= DARK
    return lit


@overload(ignores_hit)
def _ignores_hit(hit_filter, ray, corners, slot, prim):
    if getattr(hit_filter, "instance_class", None) is TexelPointers:
        return lambda hit_filter, ray, corners, slot, prim: is_hole(hit_filter, ray, corners, slot)
    if getattr(hit_filter, "instance_class", None) is DepthSum:
        return lambda hit_filter, ray, corners, slot, prim: _stays_lit(hit_filter, ray, corners, slot)
    return None


# --- Tracing cut-outs after the solid triangles -----------------------------------------------------------------------


class CutoutTree(NamedTuple):
    """The cut-outs of a scene at one time; triangle indices are those of the whole scene."""

    bvh: Bvh
    blocks: BlockTree
    texels: AlphaTexels
    channels: int  # number of values that tell how much light passes: 0, 1 or 3, see `channels_of`
    months: np.ndarray  # (12 or 0, r, 4) int32, see `Cutouts.months`
    corners: np.ndarray  # (n, 9) float32: all triangles of the scene; (1, 9): they are in a store

    def in_month(self, month: int | None) -> "CutoutTree":
        """The tree with the depths of a month, 0 to 11; None: those without a date."""
        if month is None or not len(self.months):
            return self
        depths = self.months[month]
        return self._replace(texels=self.texels._replace(depths=depths), channels=channels_of(depths))

    def as_holes(self) -> "CutoutTree":
        """The tree with texels that let all light pass or none, as for closest hits."""
        if not self.channels:
            return self
        depths = self.texels.depths.copy()
        depths[:, :3] = depths[:, 3:] * (DARK + 1)
        return self._replace(texels=self.texels._replace(depths=depths), channels=0)


def cutout_tree(triangles: Triangles, threads: int | None = None) -> CutoutTree | None:
    """The `CutoutTree` of a scene's triangles; None if it has no cut-outs."""
    cutouts = triangles.cutouts
    if cutouts is None or not len(cutouts.faces):
        return None
    return tree_of_cutouts(cutouts, triangles.vertices[cutouts.faces], triangles.vertices.reshape(-1, 9), threads)


def tree_of_cutouts(
    cutouts: Cutouts, vertices: NDArray[np.float32], corners: NDArray[np.float32], threads: int | None = None
) -> CutoutTree:
    """The `CutoutTree` of at least one cut-out.

    vertices : (m, 3, 3), of the cut-outs
    corners : as in `CutoutTree`
    """
    areas = rows_with_area(vertices, thread_count(threads))
    bvh = binned_sah.build(vertices if areas is None else vertices[areas], threads)
    at = bvh.prim_ids if areas is None else areas[bvh.prim_ids]
    bvh = bvh._replace(prim_ids=cutouts.faces[at])
    uv, mask = cutouts.uv[at].reshape(-1, 6), cutouts.mask[at]
    texels = AlphaTexels(uv, mask, cutouts.shapes, cutouts.first, cutouts.texels, cutouts.rows, cutouts.depths)
    channels = channels_of(cutouts.depths)
    return CutoutTree(bvh, block_tree(bvh, threads), texels, channels, cutouts.months, corners)


@inlined
def ray_to_sample(query, patch, i, s):
    """The segment from receiver i to its sample s."""
    o, (lx, ly, lz) = get3(query.origins, 3 * i, 1), sample_of(query, patch, i, s)
    return segment(o.x, o.y, o.z, lx, ly, lz)


@inlined
def _blocks_alone(tree, texels, ray, skip, cull_faces, slot):
    """Whether the cut-out in `slot` blocks the ray by an opaque texel; slot -1: no cut-out."""
    if slot < 0 or get(tree.prim_ids, slot) == skip:
        return False
    o = (np.float32(ray.ox), np.float32(ray.oy), np.float32(ray.oz))
    d = (np.float32(ray.dx), np.float32(ray.dy), np.float32(ray.dz))
    if not triangle_hit(tree.corners, slot, ray, o, d, cull_faces, None):
        return False
    return _is_opaque(texels, _depths_at(texels, ray, tree.corners, slot))


@inlined
def sum_depths(tree, depth, ray, skip, cull_faces):
    """Add up the depths along a ray. Returns the slot of the cut-out after which all light is blocked, or -1."""
    for c in range(3):
        put(depth.sums, c, 0)
    return walk(tree, ray, skip, cull_faces, np.int64(LEFT_FIRST), depth, None)[0]


@kernel
def _shadows(ticket, bvh, texels, query, met, bits):
    """Worker: set the bits of segments in `met` that cut-outs darken, unless they are already set."""
    tree, depth, pointers = tree_of(bvh), DepthSum(texel_pointers(texels), stack_i32(3)), query_pointers(query)
    candidates, out, last = ptr(met), ptr(bits), -1  # `last` blocked the previous ray and is tested first
    for i in items(ticket):
        skip = get(pointers.ids, i)
        for k in range(pointers.words):
            words = get(candidates, i * pointers.words + k) & ~get(out, i * pointers.words + k)
            if words == 0:
                continue
            patch = patch_of(pointers, i)
            while words != 0:
                s = 64 * k + lowest_bit(words)
                words &= words - np.uint64(1)
                ray = ray_to_sample(pointers, patch, i, s)
                slot = last
                if not _blocks_alone(tree, depth.texels, ray, skip, pointers.facing, last):
                    slot = sum_depths(tree, depth, ray, skip, pointers.facing)
                if slot >= 0:
                    last = slot
                    set_bit(pointers, out, i, s)


def add_shadows(tree: CutoutTree, query: ShadowQuery, bits: NDArray[np.uint64], threads: int | None = None) -> None:
    """Set bit s of ``bits[y, x]`` where cut-outs block the light of sample s.

    bits : (h, w, ceil(spp / 64)) uint64, the answer of a tracer over the solid triangles
    """
    met = new_bits(query)
    trace_shadow(tree.blocks, query, met, threads)
    ticket = new_ticket(query.sides.size, 256)
    run(_shadows, thread_count(threads), ticket, tree.bvh, tree.texels, query, met, bits)


@kernel
def _nearest(ticket, bvh, texels, rays, scene, rows, out):
    tree, holes, corners = tree_of(bvh), texel_pointers(texels), ptr(scene)
    for i in items(ticket):
        o, d, skip = rays.origins[i], rays.directions[i], np.int64(rays.skip[i])
        if rays.segments:
            ray = segment(o[0], o[1], o[2], d[0], d[1], d[2])
        else:
            tmax = min(rays.tmax[i], out.t[i] * BEYOND)
            ray = ray_along(o[0], o[1], o[2], d[0], d[1], d[2], rays.tmin[i], tmax)
        if ray.dx == 0.0 and ray.dy == 0.0 and ray.dz == 0.0:
            continue
        slot, t = walk(tree, ray, skip, rays.cull_faces, np.int64(CLOSEST), holes, None)
        if slot < 0:
            continue
        prim, best = get(tree.prim_ids, slot), np.int64(out.face[i])
        if best < 0 or comes_first(ray, tree.corners, slot, prim, t, corners, np.int64(rows[i]), best, out.t[i]):
            u, v = single_weights(ray, tree.corners, slot)
            out.face[i], out.t[i], out.u[i], out.v[i] = prim, t, u, v


class SolidHits(NamedTuple):
    """The triangles that rays hit, of a scene whose triangles are not all in memory."""

    corners: NDArray[np.float32]  # (k, 9), k >= 1
    rows: NDArray[np.int32]  # (m,): for each ray, the row of its triangle, or -1


def add_nearest(
    tree: CutoutTree, rays: LocalRays, out: HitArrays, threads: int | None = None, solid: SolidHits | None = None
) -> None:
    """Replace hits by nearer hits on cut-outs.

    out : face, t, u and v of the nearest solid triangles; face -1 and t inf on a miss
    solid : None: all triangles are in `tree.corners`
    """
    ticket, of = new_ticket(len(rays.origins), 1024), solid or SolidHits(tree.corners, out.face)
    run(_nearest, thread_count(threads), ticket, tree.bvh, tree.texels, rays, of.corners, of.rows, out)


def replace_by_cutouts(
    tree: CutoutTree | None,
    rays: RayPass,
    face: NDArray[np.int32],
    t: NDArray[np.float64],
    threads: int | None = None,
) -> None:
    """Replace the hits of a pass, face (m,) int32 and t (m,) float64, by nearer hits on cut-outs."""
    if tree is not None:
        add_nearest(tree, local_pass(rays), _hits(face, t), threads)


def _hits(face: np.ndarray, t: np.ndarray) -> HitArrays:
    return HitArrays(np.empty(0, np.bool_), face, t, np.empty(len(face), np.float32), np.empty(len(face), np.float32))


def add_hits(
    tree: CutoutTree,
    rays: RayArrays,
    cull_faces: int,
    any_hit: bool,
    out: HitArrays,
    threads: int | None = None,
    may_meet: NDArray[np.bool_] | None = None,
) -> None:
    """Add hits on cut-outs to the hits of a checked ray list on solid triangles.

    may_meet : (n,) bool, false for rays that meet no cut-out, whether or not in a hole; None: all may meet one
    """
    asks = ~out.blocked if any_hit else np.ones(len(out.face), np.bool_)
    some = np.flatnonzero(asks if may_meet is None else asks & may_meet)
    if any_hit:
        hits = _hits(np.full(len(some), -1, np.int32), np.full(len(some), np.inf))
    else:
        hits = HitArrays(out.blocked, *(each[some] for each in out[1:]))
    add_nearest(tree, local_rays(rays.part(some), cull_faces), hits, threads)
    if any_hit:
        out.blocked[some] = hits.face >= 0
    else:
        for each, found in zip(out[1:], hits[1:]):
            each[some] = found


@kernel
def _find_holes(ticket, bvh, texels, rays, hit_rays, slots, passes):
    """Worker: whether rays pass through the cut-outs that they meet."""
    tree, holes = tree_of(bvh), texel_pointers(texels)
    for k in items(ticket):
        passes[k] = is_hole(holes, local_ray(rays, hit_rays[k]), tree.corners, np.int64(slots[k]))


def without_holes(tree: CutoutTree, rays: LocalRays, hits: AllHits, threads: int | None = None) -> AllHits:
    """All hits of rays on cut-outs, without those on texels that closest hits ignore."""
    order, n, hit_rays = np.argsort(tree.bvh.prim_ids), len(hits.face), hits.ray
    slots, passes = order[np.searchsorted(tree.bvh.prim_ids[order], hits.face)], np.empty(n, np.bool_)
    ticket = new_ticket(n, 1024)
    run(_find_holes, thread_count(threads), ticket, tree.bvh, tree.texels, rays, hit_rays, slots, passes)
    counts = np.bincount(hit_rays[~passes], minlength=len(rays.origins))
    offsets, some = np.concatenate([[0], np.cumsum(counts)]), ~passes
    return AllHits(offsets, hits.t[some], hits.face[some], hits.u[some], hits.v[some])
