"""Few points: the segments from a few points to a light's samples, traced as a list of rays.

A shadow query takes longer to set up than its first hundred segments take to trace. A ray list holds the same segments,
and the intersection tests are exact, so the bits are those of a shadow query.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...query.equal_samples import copy_bits, have_equal_samples
from ...query.light_samples import sample_ends
from ...query.query_bounds import place, reach_of
from ...query.ray_list import segments_between
from ...query.receivers import NOTHING, Receivers
from ...query.shadow_query import fraction_lit
from ...scene.lights import AMBIENT, FIXED, LIST, SPHERE, Light, LightPatch
from ..visibility import Visibility
from .source_protocols import Geometry, HitSource

MOST_SEGMENTS = 128  # more are traced as fast by a shadow query
_SETS = 4  # sample sets of points in a row


class _Placed(NamedTuple):
    """A light in the frame of a scene."""

    raw: tuple[int, float, float, bytes]  # what `place` makes of: kind, radius, reach; base, u and v
    sets: NDArray[np.float64]  # (16, m, 3)
    patch: LightPatch
    distinct: NDArray[np.float64]  # (16, k, 3): `sets` without equal samples
    ends: NDArray[np.float32] | None  # (_SETS, k, 3): the samples, if they do not depend on the receiver


class FewPoints:
    """Answers point queries of few segments in a scene in memory. It is thread-safe.

    geometry : Geometry
    rays : HitSource
        Traces the segments.
    """

    def __init__(self, geometry: Geometry, rays: HitSource):
        self._geometry, self._rays = geometry, rays
        self._reach: tuple[NDArray[np.float32], list[list[float]], float] | None = None  # of the latest bounds
        self._placed: _Placed | None = None  # the latest light

    def visibility(
        self, receivers: Receivers, light: Light, sets: NDArray[np.float64], facing: int, time: float, threads: int
    ) -> Visibility | None:
        """The `Visibility`, (n, 1), of a light; None: the query needs more segments, or a tree of its own.

        sets : (16, m, 3) float64, from `light_samples`
        facing : a value of CULL_FACES
        time : within 0 .. `duration`
        """
        n, m = receivers.n, sets.shape[1]
        if n > MOST_SEGMENTS or len(receivers.sides) > 1:
            return None
        triangles = self._geometry.triangles_for_few(time)
        if triangles is None:
            return None
        begin, sides = receivers.origins[0], receivers.sides[0]
        placed = self._place(light, sets, triangles.origin, self._geometry.box(triangles), begin)
        count = placed.distinct.shape[1]
        if n * count > MOST_SEGMENTS or placed.patch.kind in (SPHERE, AMBIENT):  # their axes depend on the receiver
            return None
        if placed.ends is None:
            end = sample_ends(placed.patch, begin, placed.distinct)
        else:
            end = placed.ends[:n] if n <= _SETS else placed.ends[np.arange(n) % _SETS]
        origins = begin if count == 1 else np.repeat(begin, count, 0)
        segments = segments_between(origins, end.reshape(-1, 3), -1.0, time, facing)
        blocked = self._rays.trace_rays(segments, True, threads).hits.blocked.reshape(n, count)
        if receivers.normals.size:
            blocked = (blocked | ~_above(receivers.normals[0], begin, end)) & (sides != NOTHING)[:, None]
        if count == 1:
            bits, fraction = copy_bits(blocked.astype(np.uint64), m), (~blocked).astype(np.float32)
        else:
            bits = _packed(blocked)
            fraction = fraction_lit(bits, m)[:, None]
        return Visibility(bits[:, None], fraction, np.array([m]))

    def _place(
        self,
        light: Light,
        sets: NDArray[np.float64],
        origin: NDArray[np.float64],
        box: NDArray[np.float32],
        points: NDArray[np.float32],
    ) -> _Placed:
        """The light in the scene's frame, at once if it is the latest one."""
        reach, latest = self._reach_of(box, points), self._placed
        kind, base, u, v, _, radius = light.patch(origin, reach)
        raw = kind, radius, reach, bytes(base) + bytes(u) + bytes(v)
        if latest is not None and latest.sets is sets and latest.raw == raw:
            return latest
        patch = place(light, origin, box, reach)
        distinct = sets[:, :1] if sets.shape[1] > 1 and have_equal_samples(patch, sets) else sets
        fixed = patch.kind in (FIXED, LIST)
        ends = sample_ends(patch, np.zeros((_SETS, 3), np.float32), distinct) if fixed else None
        self._placed = _Placed(raw, sets, patch, distinct, ends)
        return self._placed

    def _reach_of(self, box: NDArray[np.float32], points: NDArray[np.float32]) -> float:
        """`reach_of`, at once for points within the latest bounds."""
        latest = self._reach
        if latest is None or latest[0] is not box:
            latest = self._reach = box, box.tolist(), reach_of(box)
        (a, b, c), (d, e, f) = latest[1]
        for x, y, z in points.tolist():
            if not (a <= x <= d and b <= y <= e and c <= z <= f):
                return reach_of(box, points, 1)
        return latest[2]


def _above(normals: NDArray[np.float64], origins: NDArray[np.float32], ends: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(n, m) bool: whether the ends, (n, m, 3), lie above the horizons of receivers, as `shadow_query.is_above`."""
    x, y, z = np.moveaxis((ends.astype(np.float64) - origins[:, None]) * normals[:, None], -1, 0)
    above: NDArray[np.bool_] = (x + y) + z > 0.0
    return above


def _packed(blocked: NDArray[np.bool_]) -> NDArray[np.uint64]:
    """(n, ceil(m / 64)) uint64: the bits of (n, m) bool."""
    octets = np.packbits(blocked, axis=1, bitorder="little")
    words = np.zeros((len(blocked), -(-octets.shape[1] // 8) * 8), np.uint8)
    words[:, : octets.shape[1]] = octets
    return words.view("<u8").astype(np.uint64, copy=False)
