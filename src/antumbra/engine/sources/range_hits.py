"""Hits of a store whose faces int32 cannot number: its ranges are traced one after the other, and the nearer hit kept.

Ranges ascend, so of two hits that differ in nothing else, the earlier one has the lower face.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...query.ray_list import RayArguments
from ...store.store_file import FaceRange
from ...trace.tree_list import Hits


def in_store(parts: NDArray[np.int32], of: FaceRange) -> NDArray[np.int32]:
    """The chunks of the store that chunks of a range are; -1 stays."""
    start = of.chunks.start
    return parts if start == 0 else np.where(parts >= 0, parts + np.int32(start), np.int32(-1))


def numbered(rays: RayArguments, of: FaceRange) -> RayArguments:
    """The rays with the faces that they skip numbered in a range."""
    return rays if isinstance(rays.skip, float) else rays._replace(skip=of.numbers(np.asarray(rays.skip)))


def skipped_faces(rays: RayArguments) -> NDArray[np.int64]:
    """(n,) int64: the face of the scene that each ray skips; -1: none."""
    return np.broadcast_to(np.asarray(rays.skip), rays.shape).reshape(-1).astype(np.int64)


def _precedes(signed_t: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether hits precede those of earlier ranges, as `kernels.exact.filters.precedes`; inf: no hit."""
    out: NDArray[np.bool_] = (np.abs(signed_t) < np.abs(other)) | ((signed_t == -other) & (signed_t > other))
    return out


def _signed_t(face: NDArray[Any], signed_t: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(face >= 0, signed_t, np.inf)


class NearestSoFar:
    """The nearest hits of n rays in the ranges so far; with a single range, all are nearest."""

    def __init__(self, n: int, ranges: int):
        self._signed_t = np.full(n, np.inf) if ranges > 1 else None

    def replaces(self, places: NDArray[np.int64], hits: Hits) -> slice | NDArray[np.bool_]:
        """Which hits, (1, m), of the rays at m places are nearer than those of earlier ranges."""
        if self._signed_t is None:
            return slice(None)
        signed_t = _signed_t(hits.face[0], hits.signed_t[0])
        nearer = _precedes(signed_t, self._signed_t[places])
        self._signed_t[places[nearer]] = signed_t[nearer]
        return nearer


class FirstHits(NamedTuple):
    """The first hits of an image's rays, (h, w) each."""

    face: NDArray[Any]  # of the scene, -1 on a miss
    t: NDArray[np.float64]
    triangle: NDArray[np.int32]  # index in the triangles that were copied, -1 on a miss
    signed_t: NDArray[np.float64]  # of hits; of cameras, only if there are several ranges


def first_hits(hits: Hits, index: NDArray[np.int32], n: int, of: FaceRange) -> FirstHits:
    """The hits of a range, whose triangles, copied as `index`, follow n others."""
    moved = index if n == 0 else np.where(index >= 0, index + np.int32(n), np.int32(-1))
    return FirstHits(of.faces(hits.face), hits.t, moved, hits.signed_t)


def nearer(first: FirstHits, second: FirstHits) -> FirstHits:
    """The nearer hits of those of two ranges in ascending order."""
    signed_t, other = (_signed_t(each.face, each.signed_t) for each in (second, first))
    chosen = _precedes(signed_t, other)
    pairs = zip(first._replace(signed_t=other), second._replace(signed_t=signed_t))
    return FirstHits(*(np.where(chosen, b, a) for a, b in cast(Iterable[tuple[np.ndarray, np.ndarray]], pairs)))
