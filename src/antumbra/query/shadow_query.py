"""The shadow query: the segments from receivers to light samples, the complete input of every tracer.

Also the queries of a picture, at the visible surfaces of its pixels, and the samples below a receiver's horizon, which
need no tracing.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.fetched_fields import FetchedFields
from ..kernels.exact.filters import UNSURE, max_magnitude, plane
from ..kernels.exact.predicate import exact_plane_side
from ..kernels.jit import F32Ptr, F64Ptr, I8Ptr, I32Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import get, popcount, ptr, put
from ..scene.lights import AMBIENT, Light, LightPatch
from ..scene.resident_triangles import ResidentTriangles
from ..scene.triangles import Triangles
from .gbuffer import GBuffer
from .light_samples import patch_at, sample_point
from .query_bounds import place, reach_of, triangle_box
from .receivers import FREE, NOTHING, surface_receivers
from .resident_gbuffer import ResidentGBuffer, ResidentSurfaces

# --- The shadow query -------------------------------------------------------------------------------------------------


_FEW_WORDS = 16  # up to this many words, NumPy is faster than a kernel

CULL_FACES = {None: 0, "front": -1, "back": 1}
"""Name -> sign of d . n of the triangles that do not block; d: the ray's direction, n: the triangle's normal."""


class ShadowQuery(NamedTuple):
    """Receivers, a light, and sample sets: one segment per receiver and sample.

    Receiver (y, x) uses sample set (x mod 4) + 4 (y mod 4); receivers that are not pixels form a single row.
    """

    origins: np.ndarray  # (h, w, 3) float32, receivers moved off their surface, recentred frame
    faces: np.ndarray  # (h, w) int32, the receiver's own triangle in `corners`, -1 if it has none
    sides: np.ndarray  # (h, w) int8: +-1: visible side of the surface; FREE: no surface; NOTHING: no receiver
    normals: np.ndarray  # (h, w, 3) float64 unit, to the visible side; (0, 0, 3) if all have faces and no light AMBIENT
    corners: np.ndarray  # (n, 9) float32, the triangles that `faces` indexes
    light: LightPatch
    samples: np.ndarray  # (16, spp, 3) float64, (a, b, c) in the light's domain
    cull_faces: int  # a value of CULL_FACES
    ids: np.ndarray  # (h, w) int32: own triangles' indices in trees; equal to `faces` if `corners` has all triangles

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        h, w = self.sides.shape
        return h, w

    @property
    def n(self) -> int:
        """The number of receivers, including missing ones."""
        return self.shape[0] * self.shape[1]

    @property
    def receivers(self) -> tuple[object, ...]:
        """Objects by whose identity receivers are recognised."""
        return self.origins, self.faces, self.sides, self.normals


_NO_NORMALS, _NO_CORNERS = np.empty((0, 0, 3)), np.empty((0, 9), np.float32)


class ResidentQuery(FetchedFields, ShadowQuery):
    """A `ShadowQuery` whose receivers are on a device, and all triangles of the scene.

    there : ResidentSurfaces
    """

    _plain, _own = ShadowQuery, ("light", "samples", "cull_faces")
    there: ResidentSurfaces

    @classmethod
    def of(
        cls, there: ResidentSurfaces, light: LightPatch, samples: NDArray[np.float64], cull_faces: int
    ) -> "ResidentQuery":
        """The query of a light at these surfaces."""
        new = cls._make([*[None] * 5, light, samples, cull_faces, None])
        new.there = there
        return new

    def _replace(self, **changes: Any) -> Any:
        if changes.keys() <= set(self._own):
            light, samples, cull_faces = (changes.get(name, getattr(self, name)) for name in self._own)
            return ResidentQuery.of(self.there, light, samples, cull_faces)
        return super()._replace(**changes)

    @property
    def shape(self) -> tuple[int, int]:
        return self.there.shape

    @property
    def receivers(self) -> tuple[object, ...]:
        return (self.there,)

    origins = property(lambda self: self.there.origins)
    faces = property(lambda self: self.there.face)
    sides = property(lambda self: self.there.side)
    ids = property(lambda self: self.there.face)
    corners = property(lambda self: self.there.triangles.vertices.reshape(-1, 9))

    @property
    def normals(self) -> NDArray[np.float64]:
        return self.there.normals if self.light.kind == AMBIENT else _NO_NORMALS

    def with_corners_of(self, receivers: NDArray[np.int64] | None) -> ShadowQuery:
        """The query on the host, with the triangles of some receivers only, or of none.

        receivers : (k,) int64, in any order, perhaps repeated; the faces of the others are -1. None: all faces stay.
        """
        faces, corners = self.faces, _NO_CORNERS
        if receivers is not None:
            own, places = np.unique(self.faces.reshape(-1)[receivers], return_inverse=True)
            none = int(np.searchsorted(own, 0))
            faces, corners = np.full_like(self.faces, -1), self.there.corners_of(own[none:])
            faces.reshape(-1)[receivers] = places.reshape(-1) - none
        return ShadowQuery(
            self.origins, faces, self.sides, self.normals, corners, self.light, self.samples, self.cull_faces, self.ids
        )


def without_corners(query: ShadowQuery) -> ShadowQuery:
    """The query for kernels that read no triangles, so that those on a device need not be copied."""
    return query.with_corners_of(None) if isinstance(query, ResidentQuery) else query


def with_receivers(query: ShadowQuery, pick: Callable[[np.ndarray], np.ndarray]) -> ShadowQuery:
    """The query of a selection of receivers: `pick` takes them from each (h, w, ...) array.

    Their sample sets follow from their new places.
    """
    names = "origins", "faces", "sides", "ids", *(["normals"] if query.normals.size else [])
    changes: dict[str, Any] = {name: np.ascontiguousarray(pick(getattr(query, name))) for name in names}
    return query._replace(**changes)


def new_bits(query: ShadowQuery) -> NDArray[np.uint64]:
    """(h, w, ceil(spp / 64)) uint64 zeros: no sample is occluded."""
    return np.zeros((*query.shape, -(-query.samples.shape[1] // 64)), np.uint64)


def ray_count(query: ShadowQuery) -> int:
    """The number of segments."""
    return int(np.count_nonzero(query.sides)) * int(query.samples.shape[1])  # NOTHING is 0


class Horizon(NamedTuple):
    """The plane of one receiver's surface, which decides which light samples lie above it. Float64 scalars."""

    side: int  # the receiver's side of the plane; FREE: there is no plane
    face: int  # the triangle in the plane; -1: only the normal is known
    px: float  # a point in the plane
    py: float
    pz: float
    nx: float  # its normal, any length
    ny: float
    nz: float
    error: float  # error of the product (l - p) . n, per unit of the largest component of l - p


class QueryPointers(NamedTuple):
    """Pointers to a `ShadowQuery` for hot kernels, free of reference counts; receivers are numbered row by row."""

    origins: F32Ptr  # float32
    faces: I32Ptr  # int32
    ids: I32Ptr  # int32
    sides: I8Ptr  # int8
    normals: F64Ptr  # float64
    corners: F32Ptr  # float32
    samples: F64Ptr  # float64
    light: LightPatch  # with tuples of three numbers
    facing: int  # a value of CULL_FACES
    h: int
    w: int  # receivers per row
    spp: int
    words: int  # uint64 words per receiver


@inlined
def query_pointers(query):
    """The `QueryPointers` of a `ShadowQuery`, which must outlive them."""
    (h, w), spp, p = query.sides.shape, query.samples.shape[1], query.light
    light = LightPatch(p.kind, _three(p.base), _three(p.u), _three(p.v), _three(p.w), p.radius)
    return QueryPointers(
        ptr(query.origins), ptr(query.faces), ptr(query.ids), ptr(query.sides), ptr(query.normals), ptr(query.corners),
        ptr(query.samples), light, query.cull_faces, h, w, spp, (spp + 63) >> 6,
    )  # fmt: skip


@inlined
def _three(a):
    return a[0], a[1], a[2]


@inlined
def three_at(p, i):
    """Vector i of an array of 3-vectors, in float64."""
    return np.float64(get(p, 3 * i)), np.float64(get(p, 3 * i + 1)), np.float64(get(p, 3 * i + 2))


@inlined
def set_of(query, i):
    """The sample set of receiver i."""
    # Eq. (1) of docs/design/sampling.md
    return (i % query.w & 3) + 4 * (i // query.w & 3)


@inlined
def patch_of(query, i):
    """The `Patch` of the light for receiver i."""
    z = np.float64(0.0)
    n = three_at(query.normals, i) if query.light.kind == AMBIENT else (z, z, z)
    x, y, z = get(query.origins, 3 * i), get(query.origins, 3 * i + 1), get(query.origins, 3 * i + 2)
    return patch_at(query.light, x, y, z, n[0], n[1], n[2])


@inlined
def sample_of(query, patch, i, s):
    """Sample s of receiver i, float32."""
    at = (set_of(query, i) * query.spp + s) * 3
    return sample_point(patch, get(query.samples, at), get(query.samples, at + 1), get(query.samples, at + 2))


@inlined
def face_horizon(side, face, corners):
    """The `Horizon` of a receiver on a triangle."""
    z = np.float64(0.0)
    p, n, error = plane(corners, face, z, z, z)
    return Horizon(side, face, p[0], p[1], p[2], n[0], n[1], n[2], error)


@inlined
def horizon_of(query, i):
    """The `Horizon` of receiver i."""
    side, face, z = get(query.sides, i), get(query.faces, i), np.float64(0.0)
    if face >= 0:
        return face_horizon(side, face, query.corners)
    p = three_at(query.origins, i)
    n = three_at(query.normals, i) if side == 1 or side == -1 else (z, z, z)  # NOTHING may have no row
    return Horizon(side, face, p[0], p[1], p[2], n[0], n[1], n[2], z)


@inlined
def set_bit(query, bits, i, s):
    """Set the bit of the blocked sample s of receiver i; `bits`: pointer to the answer."""
    at = i * query.words + (s >> 6)
    put(bits, at, get(bits, at) | np.uint64(1) << np.uint64(s & 63))


@inlined
def has_bit(query, bits, i, s):
    """Whether the bit of sample s of receiver i is set; `bits`: pointer to the answer."""
    return get(bits, i * query.words + (s >> 6)) >> np.uint64(s & 63) & np.uint64(1) != 0


@inlined
def above_horizon(horizon, lx, ly, lz):
    """Whether the float32 light sample lies strictly on the receiver's side of its surface: 1, 0 or UNSURE."""
    if horizon.side == FREE:
        return 1
    a = (np.float64(lx) - horizon.px, np.float64(ly) - horizon.py, np.float64(lz) - horizon.pz)
    height = a[0] * horizon.nx + a[1] * horizon.ny + a[2] * horizon.nz
    if abs(height) <= horizon.error * max_magnitude(a):
        return 0 if horizon.face < 0 else UNSURE
    return 1 if (height > 0.0) == (horizon.side > 0) else 0


@inlined
def is_above(horizon, lx, ly, lz, corners):
    """True if the float32 light sample lies strictly on the receiver's side of its surface; exact if `face` >= 0."""
    above = above_horizon(horizon, lx, ly, lz)
    if above == UNSURE:
        return exact_plane_side(np.float64(lx), np.float64(ly), np.float64(lz), corners, horizon.face) == horizon.side
    return above == 1


@kernel
def _segments_kernel(query, ends, above):
    pointers = query_pointers(query)
    for y in range(pointers.h):
        for x in range(pointers.w):
            i = y * pointers.w + x
            patch, horizon = patch_of(pointers, i), horizon_of(pointers, i)
            for s in range(pointers.spp):
                lx, ly, lz = sample_of(pointers, patch, i, s)
                ends[y, x, s, 0], ends[y, x, s, 1], ends[y, x, s, 2] = lx, ly, lz
                above[y, x, s] = get(pointers.sides, i) != NOTHING and is_above(horizon, lx, ly, lz, pointers.corners)


def segments(query: ShadowQuery) -> tuple[np.ndarray, np.ndarray]:
    """All segments of a query, one per receiver and sample: (ends, above).

    ends : (h, w, spp, 3) float32, ends of the segments that begin at ``query.origins``
    above : (h, w, spp) bool; False if the surface itself occludes the sample or there is no receiver
    """
    h, w = query.sides.shape
    spp = query.samples.shape[1]
    ends, above = np.empty((h, w, spp, 3), np.float32), np.empty((h, w, spp), np.bool_)
    _segments_kernel(query, ends, above)
    return ends, above


@inlined
def _set_bits(words, n, i):
    """The number of set bits in row i of n words."""
    count = 0
    for k in range(n):
        count += popcount(get(words, i * n + k))
    return count


@kernel
def _fraction_kernel(ticket, bits, spp, out):
    """Worker: for each row of words, the fraction of the spp samples whose bit is not set."""
    words, n = ptr(bits), bits.shape[1]
    for i in items(ticket):
        out[i] = np.float32(1.0 - np.float64(_set_bits(words, n, i)) / spp)


@kernel
def _count_kernel(ticket, bits, out):
    """Worker: for each row of words, the number of set bits."""
    words, n = ptr(bits), bits.shape[1]
    for i in items(ticket):
        out[i] = _set_bits(words, n, i)


def count_occluded(bits: NDArray[np.uint64], threads: int | None = None) -> NDArray[np.int32]:
    """(...) int32: the number of occluded samples, from bits (..., ceil(spp / 64)) uint64."""
    out = np.empty(bits.shape[:-1], np.int32)
    ticket = new_ticket(out.size, 1 << 16)
    run(_count_kernel, thread_count(threads), ticket, bits.reshape(-1, bits.shape[-1]), out.reshape(-1))
    return out


def fraction_lit(bits: NDArray[np.uint64], spp: int, threads: int | None = None) -> NDArray[np.float32]:
    """(...) float32: the fraction of samples that are not occluded, from bits (..., ceil(spp / 64)) uint64."""
    if bits.size <= _FEW_WORDS:
        occluded = np.bitwise_count(bits)
        occluded = occluded[..., 0] if bits.shape[-1] == 1 else occluded.sum(-1)
        fraction: NDArray[np.float32] = (1.0 - occluded / float(spp)).astype(np.float32)
        return fraction
    out = np.empty(bits.shape[:-1], np.float32)
    ticket = new_ticket(out.size, 1 << 16)
    run(_fraction_kernel, thread_count(threads), ticket, bits.reshape(-1, bits.shape[-1]), spp, out.reshape(-1))
    return out


# --- Samples below the horizon ----------------------------------------------------------------------------------------


@kernel
def _below_kernel(ticket, query, bits):
    pointers, out = query_pointers(query), ptr(bits)
    for i in items(ticket):
        patch, horizon = patch_of(pointers, i), horizon_of(pointers, i)
        for s in range(pointers.spp):
            x, y, z = sample_of(pointers, patch, i, s)
            if not is_above(horizon, x, y, z, pointers.corners):
                set_bit(pointers, out, i, s)


def below_horizon(query: ShadowQuery, threads: int | None = None) -> NDArray[np.uint64]:
    """(h, w, ceil(spp / 64)) uint64: bit s is set if the receiver's own surface occludes sample s."""
    bits = new_bits(query)
    run(_below_kernel, thread_count(threads), new_ticket(query.sides.size, 256), query, bits)
    return bits


# --- Shadow queries of a picture --------------------------------------------------------------------------------------


class ShadingNormals(NamedTuple):
    """Normals for shading only; shadows use the geometric surface."""

    normal: np.ndarray  # (H, W, 3) float32, unit length, towards the camera
    bend: np.ndarray  # (H, W) float32: sine of the height above their horizon where light ends


class PixelMaterials(NamedTuple):
    """The metallic-roughness parameters of pixels, for shading only."""

    lobe: np.ndarray  # (H, W) bool: pixels that have a GGX lobe
    metallic: np.ndarray  # (H, W) float32
    roughness: np.ndarray  # (H, W) float32
    occlusion: np.ndarray | None  # (H, W) float32: share of ambient light that arrives; None: 1
    emission: np.ndarray | None  # (H, W, 3) float32: emitted radiance; None: 0


class Surfaces(NamedTuple):
    """The surfaces that a picture's rays meet, and their triangles."""

    gbuffer: GBuffer  # its faces index `triangles`
    triangles: Triangles  # all triangles of the scene, or only the visible ones
    ids: np.ndarray  # (H, W) int32: index of the face in the scene; -1: background
    box: np.ndarray | None = None  # (2, 3) float32: bounds of the whole scene; None: use the bounds of `triangles`
    albedo: np.ndarray | None = None  # (H, W, 3) float32: linear base colours; None: those of the faces
    shading: ShadingNormals | None = None  # None: shade with the geometric normals
    materials: PixelMaterials | None = None  # None: all surfaces are diffuse
    device: str | None = None  # the device that found the surfaces; None: the CPU


class SurfacesThere(FetchedFields, Surfaces):
    """`Surfaces` of a `ResidentGBuffer`, whose faces index all triangles of the scene."""

    _plain = Surfaces
    ids = property(lambda self: self.gbuffer.face)

    def _replace(self, **changes: Any) -> Any:
        if "ids" in changes:
            return super()._replace(**changes)
        kept = {name: getattr(self, name) for name in self._fields if name != "ids"}
        return SurfacesThere._make((kept | changes).get(name) for name in self._fields)


def surfaces_of(gbuffer: GBuffer, triangles: Triangles) -> Surfaces:
    """`Surfaces` of a G-buffer whose faces index all triangles of the scene."""
    if isinstance(gbuffer, ResidentGBuffer):
        return SurfacesThere(gbuffer, triangles, None, device=gbuffer.there.device.name)  # type: ignore[arg-type]
    return Surfaces(gbuffer, triangles, gbuffer.face)


def join_bands(bands: Sequence[Surfaces]) -> Surfaces:
    """The surfaces of a picture's consecutive bands, from top to bottom. Each triangle is stored once."""
    meshes = [band.triangles for band in bands if (band.ids >= 0).any()] or [bands[0].triangles]
    ids, first = np.unique(np.concatenate([triangles.face_id for triangles in meshes]), return_index=True)
    vertices, colour = (np.concatenate([getattr(t, name) for t in meshes])[first] for name in ("vertices", "colour"))
    faces = [np.where(b.ids >= 0, np.searchsorted(ids, b.ids), -1).astype(np.int32) for b in bands]
    names = "position", "normal", "depth", "side"
    of_all = {name: np.concatenate([getattr(b.gbuffer, name) for b in bands]) for name in names}
    gbuffer = bands[0].gbuffer._replace(**of_all, face=np.concatenate(faces))
    triangles = Triangles(vertices, meshes[0].origin, ids, colour)
    return Surfaces(gbuffer, triangles, np.concatenate([band.ids for band in bands]), bands[0].box)


def shadow_queries(
    triangles: Triangles,
    gbuffer: GBuffer,
    lights: Sequence[Light],
    samples: Sequence[NDArray[np.float64]],
    cull_faces: int = 0,
    threads: int | None = None,
) -> list[ShadowQuery]:
    """One query per light at the surfaces in a G-buffer; ``samples``: one array per light, from `light_samples`."""
    return surface_queries(surfaces_of(gbuffer, triangles), lights, samples, cull_faces, threads)


def surface_queries(
    surfaces: Surfaces,
    lights: Sequence[Light],
    samples: Sequence[NDArray[np.float64]],
    cull_faces: int = 0,
    threads: int | None = None,
) -> list[ShadowQuery]:
    """`shadow_queries` for `Surfaces`."""
    gbuffer, triangles, box = surfaces.gbuffer, surfaces.triangles, surfaces.box
    patches = _placed(lights, triangles, box, threads)
    if isinstance(gbuffer, ResidentGBuffer):
        there = gbuffer.there
        return [ResidentQuery.of(there, patch, sets, cull_faces) for patch, sets in zip(patches, samples)]
    shape, ids = gbuffer.face.shape, surfaces.ids
    corners = triangles.vertices.reshape(-1, 9)
    flat = (
        gbuffer.position.reshape(-1, 3),
        gbuffer.normal.reshape(-1, 3),
        gbuffer.face.reshape(-1),
        gbuffer.side.reshape(-1),
    )
    origins = surface_receivers(*flat, corners, threads).reshape(*shape, 3)
    ambient = any(p.kind == AMBIENT for p in patches)
    normals = gbuffer.normal.astype(np.float64) if ambient else _NO_NORMALS
    return [
        ShadowQuery(origins, gbuffer.face, gbuffer.side, normals, corners, patch, sets, cull_faces, ids)
        for patch, sets in zip(patches, samples)
    ]


def _placed(
    lights: Sequence[Light], triangles: Triangles, box: NDArray[np.float32] | None, threads: int | None
) -> list[LightPatch]:
    """The patches of lights; `box`: as in `Surfaces`."""
    some = isinstance(triangles, ResidentTriangles) or triangles.vertices.size > 0
    if box is None and some:
        box = triangle_box(triangles, threads)
    far = reach_of(box) if box is not None and some else 1.0
    return [place(light, triangles.origin, box, far) for light in lights]
