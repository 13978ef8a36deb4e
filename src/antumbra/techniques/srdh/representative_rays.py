"""Representative shadow rays: the sample of a frame's rays to which the builder `srdh` adapts a BVH.

The rays are those of a sparse image of the scene [Feltman et al. 2012, Sec. 3.4, 4.2], of the last frame of an
animation, or the user's. All their intersections are computed in an existing BVH or in a temporary one.

`SrdhRays` has the options of the sample. `Plan.sample` takes it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...base.checks import flag, points, whole_number
from ...base.errors import InputError
from ...bvh import lbvh
from ...bvh.nodes import Bvh
from ...bvh.triangle_bounds import MAX_COORDINATE
from ...query.equal_samples import with_distinct_samples
from ...query.gbuffer import GBuffer
from ...query.shadow_query import ShadowQuery, segments, shadow_queries
from ...scene.lights import Light
from ...scene.triangles import Triangles
from ...trace.rays.ray_hits import Intersections, bounce_surfaces, intersections
from ..culling.pre_bvh_culling import solid_tree


@dataclass(frozen=True, eq=False)
class SrdhRays:
    """Which shadow rays the builder `srdh` samples.

    Parameters
    ----------
    size : int or None
        Size x size pixels, spread evenly over the picture, or size x size points of a query; 1 to 65536. None: all.
    spp : int
        Samples of each light from each pixel, 1 to 1024; at most the number that is traced.
    bounce : bool
        Add as many rays from the surfaces that one diffuse ray from each pixel meets [Feltman et al. 2012, Sec. 4].
        Use it for trees that answer more than the shadows of visible surfaces.
    last_frame : bool
        Show each frame of a `Renderer` after the first the rays of the previous frame, with their intersections.
    origins, ends : (m, 3) float or None
        World coordinates of explicit segments, which replace all other rays.

    Raises
    ------
    InputError
        If a value is out of range, a coordinate is not below the limit for triangles, or `origins` and `ends` differ in
        shape.
    """

    size: int | None = 16
    spp: int = 4
    bounce: bool = False
    last_frame: bool = False
    origins: np.ndarray | None = None
    ends: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.size is not None:
            whole_number(self.size, "size", 1, 1 << 16)
        whole_number(self.spp, "spp", 1, 1024)
        flag(self.bounce, "bounce")
        flag(self.last_frame, "last_frame")
        if (self.origins is None) != (self.ends is None):
            raise InputError("segments have origins and ends; give both, or neither")
        if self.origins is not None:
            origins, ends = points(self.origins, "origins"), points(self.ends, "ends")
            if origins.shape != ends.shape:
                raise InputError(f"origins {origins.shape} and ends {ends.shape} must have the same shape")
            for array, name in ((origins, "origins"), (ends, "ends")):
                if not (np.abs(array) < MAX_COORDINATE).all():
                    raise InputError(f"{name} have a coordinate that is not below {MAX_COORDINATE:.1e}")
            if self.bounce or self.last_frame:
                raise InputError("origins and ends are given, so bounce and last_frame say nothing; leave them out")
            object.__setattr__(self, "origins", origins)
            object.__setattr__(self, "ends", ends)


_FEW_TRIANGLES = 1000  # with fewer triangles, all rays are used
_PROBED_RAYS, _PROBED_TRIANGLES = 16, 128  # pairs that estimate the share of boxes that rays enter
_LARGE_SHARE = 1 / 32  # share of boxes above which the number of rays is limited
_LEAST_RAYS = 8  # minimum number of rays; the limit is this number divided by the share

Bounce = Callable[[Bvh], list[ShadowQuery]]
"""Function of a `Bvh` of all triangles; returns the queries at the surfaces that diffuse rays hit."""


_T = TypeVar("_T", bound=np.generic)


class RepresentativeSegments(NamedTuple):
    """Shadow segments in the recentred frame."""

    origins: np.ndarray  # (m, 3) float32
    ends: np.ndarray  # (m, 3) float32
    skip: np.ndarray  # (m,) int32: triangle under the origin, to be skipped; -1: none
    cull_faces: int  # a value of CULL_FACES

    def in_bvh(self, bvh: Bvh, skip: NDArray[np.int32], threads: int) -> Intersections:
        """All intersections with a BVH; `skip`: indices into the BVH's triangles.

        If rays enter the boxes of many triangles, only some of the rays are traced.
        """
        some = _affordable(self, bvh.corners)
        return intersections(bvh, self.origins[some], self.ends[some], skip[some], threads, self.cull_faces)


def _affordable(segments: RepresentativeSegments, corners: NDArray[np.float32]) -> NDArray[np.int64]:
    """Indices of as many segments, evenly spread, as are affordable for a builder of triangles with (n, 9) corners.

    The cost of a ray is proportional to the number of boxes that it enters. In ordinary scenes these are few, but if
    rays enter a large share of all triangles' boxes, the cost grows with rays times triangles.
    """
    m, n = len(segments.origins), len(corners)
    if n < _FEW_TRIANGLES or m <= _LEAST_RAYS:
        return np.arange(m)
    probed, boxed = _spread(m, _PROBED_RAYS), corners[_spread(n, _PROBED_TRIANGLES)].reshape(-1, 3, 3)
    share = _share_entered(segments.origins[probed], segments.ends[probed], boxed.min(1), boxed.max(1))
    return _spread(m, max(_LEAST_RAYS, int(_LEAST_RAYS / share))) if share > _LARGE_SHARE else np.arange(m)


def _share_entered(
    origins: NDArray[np.float32], ends: NDArray[np.float32], lower: NDArray[np.float32], upper: NDArray[np.float32]
) -> float:
    """Estimate of the share of (segment, box) pairs in which the segment enters the box; (r, 3) and (k, 3) arrays."""
    o, direction = origins[:, None].astype(np.float64), ends[:, None].astype(np.float64) - origins[:, None]
    direction = np.where(direction == 0.0, 1e-300, direction)
    a, b = (lower - o) / direction, (upper - o) / direction
    return float((np.minimum(a, b).max(2).clip(0.0) <= np.maximum(a, b).min(2).clip(None, 1.0)).mean())


def _spread(n: int, k: int | None) -> NDArray[np.int64]:
    """k evenly spread indices from 0 to n - 1; all of them if k is None."""
    return np.arange(n) if k is None or k >= n else ((np.arange(k) + 0.5) * n / k).astype(np.int64)


def _pixels(shape: tuple[int, int], size: int | None) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(rows, columns) of size x size pixels of an image, or of the same number of points in a single row."""
    h, w = shape
    if h == 1:
        return np.zeros(1, np.int64), _spread(w, None if size is None else size * size)
    return _spread(h, size), _spread(w, size)


def _sparse(array: NDArray[_T], at: tuple[NDArray[np.int64], NDArray[np.int64]]) -> NDArray[_T]:
    """The chosen rows and columns of an (H, W, ...) array."""
    return np.ascontiguousarray(array[at[0]][:, at[1]])


def fewer_samples(samples: NDArray[np.float64], spp: int) -> NDArray[np.float64]:
    """At most `spp` samples of each set, (16, n, 3). Sets get different ones, so that neighbours cover the light."""
    n = samples.shape[1]
    if spp >= n:
        return samples
    sets = np.arange(len(samples))[:, None]
    return np.ascontiguousarray(samples[sets, (_spread(n, spp) + sets) % n])


def _sparse_query(query: ShadowQuery, settings: SrdhRays) -> ShadowQuery:
    """The receivers and samples of a query that the settings select."""
    at = _pixels(query.sides.shape, settings.size)
    normals = query.normals if query.normals.size == 0 else _sparse(query.normals, at)
    return query._replace(
        origins=_sparse(query.origins, at), faces=_sparse(query.faces, at), sides=_sparse(query.sides, at),
        normals=normals, samples=fewer_samples(query.samples, settings.spp), ids=_sparse(query.ids, at),
    )  # fmt: skip


def sparse_gbuffer(gbuffer: GBuffer, settings: SrdhRays) -> GBuffer:
    """The pixels of an image that the settings select."""
    at = _pixels(gbuffer.face.shape, settings.size)
    position, normal, face, depth, side = (_sparse(array, at) for array in gbuffer[:5])
    return GBuffer(position, normal, face, depth, side, gbuffer.origin)


def segments_of(queries: Sequence[ShadowQuery]) -> RepresentativeSegments:
    """All segments of several queries that lie above their receiver's horizon."""
    parts = []
    for query in queries:
        ends, above = segments(query)
        origins = np.broadcast_to(query.origins[:, :, None], ends.shape)
        faces = np.broadcast_to(query.faces[:, :, None], above.shape)
        parts.append((origins[above], ends[above], faces[above]))
    origins, ends, faces = (np.ascontiguousarray(np.concatenate(arrays)) for arrays in zip(*parts))
    return RepresentativeSegments(origins, ends, faces, queries[0].cull_faces)


def _explicit_segments(settings: SrdhRays, origin: NDArray[np.float64], cull_faces: int) -> RepresentativeSegments:
    """The user's segments, in the recentred frame of a scene with this origin."""
    assert settings.origins is not None and settings.ends is not None
    origins, ends = ((points - origin).astype(np.float32) for points in (settings.origins, settings.ends))
    return RepresentativeSegments(origins, ends, np.full(len(origins), -1, np.int32), cull_faces)


def _indices_among(ids: NDArray[np.int32] | None, faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """The index of each scene triangle in ascending ids (None: all triangles); -1: not among them."""
    if ids is None:
        return faces
    if len(ids) == 0:
        return np.full(len(faces), -1, np.int32)
    at = np.minimum(np.searchsorted(ids, faces), len(ids) - 1)
    return np.where(ids[at] == faces, at, -1).astype(np.int32)


def _restricted(ids: NDArray[np.int32] | None, hits: Intersections) -> Intersections:
    """Restrict intersections to the triangles in `ids`, with indices into `ids`."""
    prims, m = _indices_among(ids, hits.prims), len(hits.origins)
    owner = np.repeat(np.arange(m), np.diff(hits.first))[prims >= 0]
    first = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=m))])
    return hits._replace(first=first, prims=prims[prims >= 0])


class RepresentativeRays:
    """The rays for a builder: segments, with their intersections once computed."""

    def __init__(self, segments: RepresentativeSegments, bvh: Bvh | None = None):
        self.segments = segments
        self.bvh = bvh  # of all triangles of the scene, if there is one
        self.met: Intersections | None = None

    def among(
        self, vertices: NDArray[np.float32], ids: NDArray[np.int32] | None, threads: int, bvh: Bvh | None = None
    ) -> Intersections:
        """The `Intersections` with the builder's triangles, in the builder's numbering.

        vertices : (n, 3, 3) float32, the builder's triangles
        ids : (n,) int, their indices in the scene; None: all triangles of the scene
        bvh : a BVH of these triangles, if there is one

        Without a BVH, a temporary `lbvh` is built: with few rays to trace, build time matters most.
        """
        if self.met is None and self.bvh is not None:
            self.met = self.segments.in_bvh(self.bvh, self.segments.skip, threads)
        if self.met is not None:
            return _restricted(ids, self.met)
        bvh = lbvh.build(vertices, threads) if bvh is None else bvh
        return self.segments.in_bvh(bvh, _indices_among(ids, self.segments.skip), threads)


class RepresentativeRaySelector:
    """Selects the rays for the builder of a `Renderer`, frame by frame."""

    def __init__(self, settings: SrdhRays, threads: int):
        self.asked, self.threads = settings, threads
        self.last: RepresentativeRays | None = None  # of the previous frame, if `last_frame` is set
        self.n_triangles = 0  # of that frame

    def show(
        self,
        queries: Sequence[ShadowQuery],
        triangles: Triangles,
        bvh: Bvh | None = None,
        bounce: Bounce | None = None,
    ) -> RepresentativeRays:
        """Select rays for these queries: a sample of their rays, the user's rays, or those of the last frame.

        bvh : a BVH of all triangles, if there is one
        bounce : returns the queries at bounce surfaces; None: the queries are not those of an image
        """
        if self.asked.origins is not None:
            return RepresentativeRays(_explicit_segments(self.asked, triangles.origin, queries[0].cull_faces), bvh)
        queries = [_sparse_query(with_distinct_samples(query), self.asked) for query in queries]
        if self.asked.bounce:
            if bounce is None:
                raise InputError("srdh_rays requests bounced rays, which only images have")
            queries += bounce(solid_tree(lbvh.build, triangles, self.threads) if bvh is None else bvh)
        rays = RepresentativeRays(segments_of(queries), bvh)
        if not self.asked.last_frame:
            return rays
        last, n, self.last, self.n_triangles = self.last, self.n_triangles, rays, len(triangles.vertices)
        if last is not None and last.met is not None and n == self.n_triangles:  # triangle indices are still valid
            return last
        return rays

    def built(self, bvh: Bvh) -> None:
        """Store the intersections of this frame's rays with the first BVH of the frame, for the next frame."""
        if self.last is not None and self.last.met is None:  # later BVHs of the frame may lack culled triangles
            self.last.met = self.last.segments.in_bvh(bvh, self.last.segments.skip, self.threads)


def bounced_queries(
    selector: RepresentativeRaySelector | None,
    triangles: Triangles,
    gbuffer: GBuffer,
    lights: Sequence[Light],
    samples: Sequence[NDArray[np.float64]],
    facing: int = 0,
) -> Bounce | None:
    """A function that makes the queries where diffuse rays end, one ray per selected pixel; None if not requested."""
    if selector is None or not selector.asked.bounce:
        return None
    settings, threads = selector.asked, selector.threads

    def bounce(bvh: Bvh) -> list[ShadowQuery]:
        surfaces = bounce_surfaces(sparse_gbuffer(gbuffer, settings), triangles, bvh, threads=threads)
        fewer = [fewer_samples(sets, settings.spp) for sets in samples]
        return shadow_queries(triangles, surfaces, lights, fewer, facing, threads)

    return bounce
