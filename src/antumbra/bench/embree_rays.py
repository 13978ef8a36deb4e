"""Ray arrays through Embree, one `rtcOccluded1` or `rtcIntersect1` a ray, in compiled loops on all threads."""

import ctypes
from functools import cache

import numba
import numpy as np

from ..bvh.nodes import aligned_empty
from ..parallel import CHUNK, N, new_ticket, run, take, thread_count
from .embree import EmbreeScene, arguments, functions

_RAY, _HIT = 12, 20  # float32 words of an RTCRay and an RTCRayHit
_NO_HIT = -1  # RTC_INVALID_GEOMETRY_ID


@cache
def _loop(name: str):
    """A worker that calls the function on each record; not cached on disk, for it holds addresses of this process."""
    call = getattr(functions(), name)
    size = 4 * (_HIT if name == "intersect1" else _RAY)

    @numba.njit(nogil=True)
    def work(ticket, scene, records, args):
        first = take(ticket)
        while first >= 0:
            for i in range(first, min(first + ticket[CHUNK], ticket[N])):
                call(scene, records + size * i, args)
            first = take(ticket)

    return work


def records_of(origins, directions, tmin=0.0, tmax=np.inf, hits: bool = False) -> np.ndarray:
    """(n, 12) float32 RTCRay records, or (n, 20) RTCRayHit records, of rays; every trace wants fresh ones."""
    records = aligned_empty((len(origins), _HIT if hits else _RAY), "f4")
    whole = records.view(np.int32)
    records[:, 0:3], records[:, 3], records[:, 4:7] = origins, tmin, directions
    records[:, 7], records[:, 8], whole[:, 9], whole[:, 10:12] = 0.0, tmax, -1, 0
    if hits:
        whole[:, 12:] = _NO_HIT
    return records


def trace(scene: EmbreeScene, records: np.ndarray, threads=None, coherent=False) -> None:
    """Trace the records in place."""
    name = "intersect1" if records.shape[1] == _HIT else "occluded1"
    args = arguments(coherent)
    run(_loop(name), thread_count(threads), new_ticket(len(records), 4096), scene.handle, records.ctypes.data,
        ctypes.addressof(args))  # fmt: skip


def occluded(scene: EmbreeScene, origins, directions, tmin=0.0, tmax=np.inf, threads=None) -> np.ndarray:
    """(n,) bool: what Embree says."""
    records = records_of(origins, directions, tmin, tmax)
    trace(scene, records, threads)
    return records[:, 8] < 0.0
