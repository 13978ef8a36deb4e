"""Representative shadow rays: the sample of a frame's rays that the builder `srdh` learns from.

The rays come from a sparse picture of the scene [Feltman et al. 2012, Sec. 3.4, 4.2], from the last frame of an
animation, or from the user. All their intersections are found in an existing BVH, or in a temporary one.

`SrdhRays` has the options of the sample. `Plan.sample` takes it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...bvh import lbvh
from ...bvh.nodes import Bvh
from ...bvh.triangle_bounds import MAX_COORDINATE
from ...checks import flag, points, whole_number
from ...errors import InputError
from ...query.gbuffer import GBuffer
from ...query.shadow_query import ShadowQuery, segments, shadow_queries
from ...trace.rays.ray_hits import bounced, intersections
from ..culling.pre_bvh_culling import solid_tree
from .ray_split import Intersections

# --- The choice of rays that ray-guided builders are shown. `Plan.sample` takes it ------------------------------------


@dataclass(frozen=True, eq=False)
class SrdhRays:
    """The choice of shadow rays that the builder `srdh` is shown.

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

    def __post_init__(self):
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


# --- Representative shadow rays: the sample of a frame's rays that the builder `srdh` learns from ---------------------
#
# The rays come from a sparse picture of the scene [Feltman et al. 2012, Sec. 3.4, 4.2], from the last frame of an
# animation, or from the user. All their intersections are found in an existing BVH, or in a temporary one.


_FEW_TRIANGLES = 1000  # among fewer, all rays are shown
_TRIED_RAYS, _TRIED_TRIANGLES = 16, 128  # pairs that estimate the share of boxes that rays enter
_LARGE_SHARE = 1 / 32
_LEAST_RAYS = 8  # that are shown in any case; as many times more as rays enter a smaller share of all boxes

Bounce = Callable[[Bvh], list[ShadowQuery]]
"""Function of a `Bvh` of all triangles: returns the queries at the surfaces that diffuse rays meet."""


class RepresentativeSegments(NamedTuple):
    """Shadow segments in the recentred frame."""

    origins: np.ndarray  # (m, 3) float32
    ends: np.ndarray  # (m, 3) float32
    skip: np.ndarray  # (m,) int32: triangle under the origin, which is not tested; -1: none
    cull_faces: int  # a value of CULL_FACES

    def in_bvh(self, bvh: Bvh, skip: np.ndarray, threads: int) -> Intersections:
        """All intersections with a BVH; `skip` holds indices into the BVH's triangles.

        Where rays enter the boxes of many triangles, it is those of some of the rays.
        """
        some = _affordable(self, bvh.corners)
        return intersections(bvh, self.origins[some], self.ends[some], skip[some], threads, self.cull_faces)


def _affordable(segments: RepresentativeSegments, corners: np.ndarray) -> np.ndarray:
    """Indices of the segments, evenly spread, that a builder can afford among triangles with these (n, 9) corners.

    A ray costs a builder some time for each box that it enters. In ordinary scenes these are few. But if rays enter a
    good share of all triangles' boxes, the cost grows with rays times triangles.
    """
    m, n = len(segments.origins), len(corners)
    if n < _FEW_TRIANGLES or m <= _LEAST_RAYS:
        return np.arange(m)
    tried, boxed = _spread(m, _TRIED_RAYS), corners[_spread(n, _TRIED_TRIANGLES)].reshape(-1, 3, 3)
    share = _share_entered(segments.origins[tried], segments.ends[tried], boxed.min(1), boxed.max(1))
    return _spread(m, max(_LEAST_RAYS, int(_LEAST_RAYS / share))) if share > _LARGE_SHARE else np.arange(m)


def _share_entered(origins, ends, lower, upper) -> float:
    """The share of all pairs in which a segment enters a box, about; the arrays are (r, 3) and (k, 3)."""
    o, way = origins[:, None].astype(np.float64), ends[:, None].astype(np.float64) - origins[:, None]
    way = np.where(way == 0.0, 1e-300, way)
    a, b = (lower - o) / way, (upper - o) / way
    return float((np.minimum(a, b).max(2).clip(0.0) <= np.maximum(a, b).min(2).clip(None, 1.0)).mean())


def _spread(n: int, k: int | None) -> np.ndarray:
    """k of the indices 0 to n - 1, spread evenly; all of them if k is None."""
    return np.arange(n) if k is None or k >= n else ((np.arange(k) + 0.5) * n / k).astype(np.int64)


def _pixels(shape: tuple[int, int], size: int | None) -> tuple[np.ndarray, np.ndarray]:
    """(rows, columns) of size x size pixels of a picture, or of the same number of points in a single row."""
    h, w = shape
    if h == 1:
        return np.zeros(1, np.int64), _spread(w, None if size is None else size * size)
    return _spread(h, size), _spread(w, size)


def _sparse(array: np.ndarray, at: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The chosen rows and columns of an (H, W, ...) array."""
    return np.ascontiguousarray(array[at[0]][:, at[1]])


def fewer_samples(samples: np.ndarray, spp: int) -> np.ndarray:
    """At most `spp` samples of each set, (16, n, 3). Sets get different samples, so neighbours cover all of a light."""
    n = samples.shape[1]
    if spp >= n:
        return samples
    sets = np.arange(len(samples))[:, None]
    return np.ascontiguousarray(samples[sets, (_spread(n, spp) + sets) % n])


def _sparse_query(query: ShadowQuery, asked: SrdhRays) -> ShadowQuery:
    """The part of a query that `asked` selects."""
    at = _pixels(query.sides.shape, asked.size)
    normals = query.normals if query.normals.size == 0 else _sparse(query.normals, at)
    return query._replace(
        origins=_sparse(query.origins, at), faces=_sparse(query.faces, at), sides=_sparse(query.sides, at),
        normals=normals, samples=fewer_samples(query.samples, asked.spp), ids=_sparse(query.ids, at),
    )  # fmt: skip


def sparse_gbuffer(gbuffer: GBuffer, asked: SrdhRays) -> GBuffer:
    """The pixels of a picture that `asked` selects."""
    at = _pixels(gbuffer.face.shape, asked.size)
    return GBuffer(*(_sparse(array, at) for array in gbuffer[:5]), gbuffer.origin)


def segments_of(queries) -> RepresentativeSegments:
    """All segments of several queries that run above their receiver's horizon."""
    parts = []
    for query in queries:
        ends, above = segments(query)
        origins = np.broadcast_to(query.origins[:, :, None], ends.shape)
        faces = np.broadcast_to(query.faces[:, :, None], above.shape)
        parts.append((origins[above], ends[above], faces[above]))
    arrays = (np.ascontiguousarray(np.concatenate(arrays)) for arrays in zip(*parts))
    return RepresentativeSegments(*arrays, queries[0].cull_faces)


def _given(asked: SrdhRays, origin: np.ndarray, cull_faces: int) -> RepresentativeSegments:
    """The user's segments, in the recentred frame of a scene with this origin."""
    local = [(points - origin).astype(np.float32) for points in (asked.origins, asked.ends)]
    return RepresentativeSegments(*local, np.full(len(local[0]), -1, np.int32), cull_faces)


def _among(kept: np.ndarray | None, faces: np.ndarray) -> np.ndarray:
    """The index of each scene triangle among the kept ones (None: all are kept); -1: not kept."""
    if kept is None:
        return faces
    if len(kept) == 0:
        return np.full(len(faces), -1, np.int32)
    at = np.minimum(np.searchsorted(kept, faces), len(kept) - 1)
    return np.where(kept[at] == faces, at, -1).astype(np.int32)


def _counted_in(kept: np.ndarray | None, found: Intersections) -> Intersections:
    """Restrict intersections to the kept triangles, and renumber these."""
    prims, m = _among(kept, found.prims), len(found.origins)
    owner = np.repeat(np.arange(m), np.diff(found.first))[prims >= 0]
    first = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=m))])
    return found._replace(first=first, prims=prims[prims >= 0])


class RepresentativeRays:
    """The rays that a builder is shown: segments, with their intersections once known."""

    def __init__(self, segments: RepresentativeSegments, bvh: Bvh | None = None):
        self.segments = segments
        self.bvh = bvh  # of all triangles of the scene, if there is one
        self.met: Intersections | None = None

    def among(self, vertices: np.ndarray, kept: np.ndarray | None, threads: int, bvh: Bvh | None = None):
        """The `Intersections` with the builder's triangles, in the builder's numbering.

        vertices : (n, 3, 3) float32, the builder's triangles
        kept : (n,) int, their indices in the scene; None: all triangles of the scene
        bvh : a BVH of these triangles, if there is one

        Without any BVH, a temporary `lbvh` is built: few rays are traced, so build time matters most.
        """
        if self.met is None and self.bvh is not None:
            self.met = self.segments.in_bvh(self.bvh, self.segments.skip, threads)
        if self.met is not None:
            return _counted_in(kept, self.met)
        bvh = lbvh.build(vertices, threads) if bvh is None else bvh
        return self.segments.in_bvh(bvh, _among(kept, self.segments.skip), threads)


class RepresentativeRaySelector:
    """Chooses the rays that the builder of a `Renderer` is shown, frame after frame."""

    def __init__(self, asked: SrdhRays, threads: int):
        self.asked, self.threads = asked, threads
        self.last: RepresentativeRays | None = None  # of the previous frame, if `last_frame` is set
        self.n_triangles = 0  # of that frame

    def show(self, queries, triangles, bvh: Bvh | None = None, bounce: Bounce | None = None) -> RepresentativeRays:
        """The rays to show for these queries: a selection of their rays, the user's rays, or those of the last frame.

        bvh : a BVH of all triangles, if there is one
        bounce : adds the queries at bounce surfaces; None: the queries do not come from a picture
        """
        if self.asked.origins is not None:
            return RepresentativeRays(_given(self.asked, triangles.origin, queries[0].cull_faces), bvh)
        queries = [_sparse_query(query, self.asked) for query in queries]
        if self.asked.bounce:
            if bounce is None:
                raise InputError("srdh_rays asks for a bounce; only the rays of pictures can have one")
            queries += bounce(solid_tree(lbvh.build, triangles, self.threads) if bvh is None else bvh)
        shown = RepresentativeRays(segments_of(queries), bvh)
        if not self.asked.last_frame:
            return shown
        last, n, self.last, self.n_triangles = self.last, self.n_triangles, shown, len(triangles.vertices)
        same = last is not None and last.met is not None and n == self.n_triangles  # triangle indices still hold
        return last if same else shown

    def built(self, bvh: Bvh) -> None:
        """Store the intersections of this frame's rays with the first BVH of the frame, for the next frame."""
        if self.last is not None and self.last.met is None:  # a later BVH of the frame, for culled edges, has less
            self.last.met = self.last.segments.in_bvh(bvh, self.last.segments.skip, self.threads)


def bounced_queries(
    showing: RepresentativeRaySelector | None, triangles, gbuffer: GBuffer, lights, samples, facing=0
) -> Bounce | None:
    """A function that makes the queries where diffuse rays end, one ray per shown pixel; None if not requested."""
    if showing is None or not showing.asked.bounce:
        return None
    asked, threads = showing.asked, showing.threads

    def bounce(bvh: Bvh) -> list[ShadowQuery]:
        surfaces = bounced(sparse_gbuffer(gbuffer, asked), triangles, bvh, threads=threads)
        fewer = [fewer_samples(sets, asked.spp) for sets in samples]
        return shadow_queries(triangles, surfaces, lights, fewer, facing, threads)

    return bounce
