"""Queries by rays and points: the public methods that scenes and engines share, with their documentation.

This module imports no kernels: files can be inspected without them.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..scene.triangles import AllHits, ClosestPoints, Hit, HitFilter


class RayQueries:
    """Queries by rays and points, answered by an engine, which gets the arguments as users give them."""

    engine: Any  # an `Engine`, whose module imports this one

    def occluded(
        self,
        origins: "ArrayLike",
        directions: "ArrayLike | None" = None,
        tmin: "ArrayLike" = 0.0,
        tmax: "ArrayLike" = np.inf,
        skip_face: "ArrayLike | None" = None,
        time: float = 0.0,
        *,
        targets: "ArrayLike | None" = None,
        cull_faces: str | None = None,
        threads: int | None = None,
    ) -> NDArray[np.bool_]:
        """Any-hit query: whether a triangle blocks each ray strictly between tmin and tmax, or before its target.

        The result is exact (docs/design/exactness.md). A scene in a store stays within its `PagedScene.max_memory`.

        Parameters
        ----------
        origins, directions : (..., 3) float, world
            They broadcast against each other. `origins` alone may have shape (..., 6). Arrays with DLPack in host
            memory are accepted. Float64 origins are recentred before they are rounded to float32. Directions are
            rounded to float32; they need not be unit vectors.
        tmin, tmax : float or (...) float
            In lengths of the direction, with 0 <= tmin. They bound `Hit.t` in float64: a triangle blocks if
            ``tmin < t < tmax`` for the t that `closest_hit` reports for it. So a hit at exactly tmin or tmax does not
            count.
        skip_face : int or (...) int, optional
            A face to ignore, for rays that start on a known face; -1: none. A point computed on a face, such as its
            centre, is rounded to one side of it, so without `skip_face` about half of such rays hit their own face.
        time : float
            Seconds. The BVH of the latest query's time is cached.
        targets : (..., 3) float, world, optional
            The other ends of segments, in place of `directions`, `tmin` and `tmax`. A triangle blocks a segment if it
            intersects it strictly between its ends. Targets are recentred and rounded like origins. The result is that
            of real arithmetic for the two rounded points; no direction between them is rounded.
        cull_faces : None, "front" or "back"
            Faces whose front or back side, respectively, faces the ray's origin do not block it.
        threads : int, optional
            None: all cores.

        Returns
        -------
        (...) bool

        Raises
        ------
        InputError
            If shapes do not broadcast; origins, directions or targets are NaN, infinite or beyond float32; a direction
            is zero; tmin is negative or infinite; tmax is NaN; or targets are combined with directions, tmin or tmax.

        Examples
        --------
        >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]])
        >>> roof.occluded([[1, 1, 0], [3, 3, 0]], (0, 0, 1))
        array([ True, False])
        """
        blocked: NDArray[np.bool_] = self.engine._any_hit(
            origins, directions, HitFilter(tmin, tmax, skip_face, cull_faces), targets, time, threads
        )
        return blocked

    def closest_hit(
        self,
        origins: "ArrayLike",
        directions: "ArrayLike | None" = None,
        tmin: "ArrayLike" = 0.0,
        tmax: "ArrayLike" = np.inf,
        skip_face: "ArrayLike | None" = None,
        time: float = 0.0,
        *,
        cull_faces: str | None = None,
        threads: int | None = None,
    ) -> Hit:
        """The nearest hit of each ray strictly between tmin and tmax; arguments and errors as for `occluded`.

        A ray that is NaN, infinite or beyond float32, or whose direction is zero, fails alone, unless all rays do: its
        t is NaN, and the rest as on a miss. In arrays on a device, it is an error.

        Returns
        -------
        Hit
            t (...) float64: in lengths of the direction, the exact value rounded to the nearest float64; inf on a miss.
            face (...) int32: -1 on a miss. u, v (...) float32: weights of the face's second and third corner, from 0
            to 1. Among faces with the same t, one whose front faces the origin wins, then the lowest index.

        Notes
        -----
        ``closest_hit(o, d, tmin=hit.t)`` finds the next hit. Repeated until there is no hit, it visits each distinct t
        once in ascending order, and reports the first face at each. The front of a face is the side from which its
        corners run counterclockwise.

        Examples
        --------
        >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]])
        >>> hit = roof.closest_hit([[1, 1, 0], [3, 3, 0]], (0, 0, 1))
        >>> hit.t, hit.face
        (array([ 1., inf]), array([ 0, -1], dtype=int32))
        """
        hit: Hit = self.engine._closest_hit(
            origins, directions, HitFilter(tmin, tmax, skip_face, cull_faces), time, threads
        )
        return hit

    def all_hits(
        self,
        origins: "ArrayLike",
        directions: "ArrayLike | None" = None,
        tmin: "ArrayLike" = 0.0,
        tmax: "ArrayLike" = np.inf,
        skip_face: "ArrayLike | None" = None,
        time: float = 0.0,
        *,
        targets: "ArrayLike | None" = None,
        max_hits: int | None = None,
        merge: str = "none",
        cull_faces: str | None = None,
        threads: int | None = None,
    ) -> AllHits:
        """All hits of each ray strictly between tmin and tmax, sorted by t; arguments and errors as for `occluded`.

        Parameters
        ----------
        max_hits : int, optional
            Only the first `max_hits` hits of each ray; None: all.
        merge : "none" or "surface"
            Which hits count, as for `count_hits`.

        Returns
        -------
        AllHits
            The hits of ray i, in C order of the rays' shape, are elements ``ray_offsets[i]`` to
            ``ray_offsets[i + 1] - 1`` of `t`, `face`, `u` and `v`, which are as for `closest_hit`. Among faces
            with the same t, those whose front faces the origin come first; then they are sorted by index. A ray through
            an edge or a vertex hits every face there. Each ray has as many hits as `count_hits` returns; with the merge
            "none", it has one if and only if `occluded` is True, and the first one is that of `closest_hit`.

        Notes
        -----
        Besides the result, memory is needed for the hits of a million rays at a time.
        """
        hits = HitFilter(tmin, tmax, skip_face, cull_faces)
        every_hit: AllHits = self.engine._all_hits(origins, directions, hits, targets, max_hits, merge, time, threads)
        return every_hit

    def count_hits(
        self,
        origins: "ArrayLike",
        directions: "ArrayLike | None" = None,
        tmin: "ArrayLike" = 0.0,
        tmax: "ArrayLike" = np.inf,
        skip_face: "ArrayLike | None" = None,
        time: float = 0.0,
        *,
        targets: "ArrayLike | None" = None,
        merge: str = "none",
        cull_faces: str | None = None,
        threads: int | None = None,
    ) -> NDArray[np.int64]:
        """The number of hits of each ray strictly between tmin and tmax; arguments and errors as for `occluded`.

        Parameters
        ----------
        merge : "none" or "surface"
            "none": every face counts, so a ray through a common edge counts both. "surface": a ray that crosses a
            surface on an edge or at a vertex counts it once, and one that only touches a rim from outside counts it
            twice or not at all. This is decided by an infinitesimal displacement of the ray, in exact arithmetic, not
            by a distance. So for a closed surface, the number from a point is odd inside and even outside. A ray that
            touches an edge can be occluded and yet cross nothing.

        Returns
        -------
        (...) int64
        """
        hits = HitFilter(tmin, tmax, skip_face, cull_faces)
        counts: NDArray[np.int64] = self.engine._count_hits(origins, directions, hits, targets, merge, time, threads)
        return counts

    def contains(self, points: "ArrayLike", time: float = 0.0, *, threads: int | None = None) -> NDArray[np.bool_]:
        """Whether points are inside the scene's closed surfaces, or on one.

        A point is inside if a ray from it crosses surfaces an odd number of times (``count_hits(merge="surface")``), or
        if it is on a face. For closed surfaces, the result is exact for the rounded points, and never depends on edges
        or vertices that the ray meets. Where closed surfaces overlap, every second layer is outside.

        A surface drawn twice, such as once per side, counts once; a wall between two bodies, of which each has its own
        copy, counts twice. Edges that an odd number of faces share are open. A scene with open edges gets a note with
        their number in `Scene.notes`. Points outside its bounds are outside, and most of 14 rays along the axes and the
        space diagonals decide about others. A store is taken as it is drawn, without a note.

        Parameters
        ----------
        points : (..., 3) float, world
            Float64 points are recentred before they are rounded to float32.
        time : float
            Seconds.
        threads : int, optional
            None: all cores.

        Returns
        -------
        (...) bool
            Faces with alpha masks count as a whole, unless they are clear everywhere.

        Raises
        ------
        InputError
            If the shape is not (..., 3), or a point is NaN, infinite or beyond float32.

        Examples
        --------
        >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
        >>> solid = at.Scene.from_arrays(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        >>> solid.contains([[0.1, 0.1, 0.1], [1, 1, 1]])
        array([ True, False])
        """
        inside: NDArray[np.bool_] = self.engine._inside(points, time, threads)
        return inside

    def closest_points(self, points: "ArrayLike", time: float = 0.0, *, threads: int | None = None) -> ClosestPoints:
        """The closest point of the scene's faces to each point, and its distance.

        Points are rounded as for `contains`. The distance from the rounded point is computed in float64: its error is
        below ``2**-48`` of the distance plus the longest edge of the face. Of faces with the same computed distance,
        the one with the lowest index is returned; both faces of an edge have the same distance from a point that is
        closest to the edge. A point that is NaN, infinite or beyond float32 fails alone, unless all points do: its
        distance and position are NaN, and its face -1.

        Parameters
        ----------
        points : (..., 3) float, world
        time : float
            Seconds.
        threads : int, optional
            None: all cores.

        Returns
        -------
        ClosestPoints
            distance (...) float64: never negative, 0 on a face. face (...) int32. u, v (...) float32: weights of the
            face's second and third corner. position (..., 3) float64, world. Faces without area do not count, and
            faces with alpha masks count as a whole, unless they are clear everywhere. Without any, the distance is inf,
            the face -1 and the position NaN.

        Raises
        ------
        InputError
            If the shape is not (..., 3), all points fail, the scene is in a store, or its instances take more memory
            than the machine has, since they are flattened.

        Examples
        --------
        >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]])
        >>> roof.closest_points([[1, 1, 3]]).distance
        array([2.])
        """
        closest: ClosestPoints = self.engine._closest_points(points, time, threads)
        return closest

    def signed_distance(
        self, points: "ArrayLike", time: float = 0.0, *, threads: int | None = None
    ) -> NDArray[np.float64]:
        """The distance of points from the scene's faces: that of `closest_points`, negative where `contains` is True.

        So the sign is exact. In `trimesh.proximity.signed_distance` it is the opposite: positive inside.

        Parameters
        ----------
        points : (..., 3) float, world
        time : float
            Seconds.
        threads : int, optional
            None: all cores.

        Returns
        -------
        (...) float64
            NaN where `closest_points` has it.

        Raises
        ------
        InputError
            As for `closest_points`.
        """
        distance: NDArray[np.float64] = self.engine._signed_distance(points, time, threads)
        return distance
