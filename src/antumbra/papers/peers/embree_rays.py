"""Traces ray sets by Embree: a ray or a packet of 4, 8 or 16 for each call, in compiled loops on all threads. ::

records = write(rays, packets(rays, "pixels"))  # not timed; a trace changes its records, so each needs new ones
trace(scene, records, coherent=True)  # timed
blocked = occluded_of(rays, records)
"""

import ctypes
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numba
import numpy as np

from ...bvh.nodes import aligned_empty
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from .denormals import FLUSH, control, set_control
from .embree import HIT_WORDS, RAY_WORDS, EmbreeScene, arguments, functions
from .ray_sets import RaySet, ray_set

_TFAR, _FACE, _GEOMETRY = 8, 17, 18  # words of a record
_RAYS_AT_A_TIME = 4096


class Records(NamedTuple):
    """Rays in Embree's layout, in the order of `ids`."""

    memory: np.ndarray  # float32: (n, words) for single rays; (n, 1 + words, lanes): the valid mask, then the packet
    ids: np.ndarray  # (n,) or (n, lanes) int32: ray ids, -1 in a lane that is not valid
    work: Callable  # the compiled loop


@cache
def _loop(ask: str, lanes: int, size: int):
    """A compiled worker that calls "intersect" or "occluded" on each record of `size` bytes.

    It holds addresses of this process, so it is not cached on disk.
    """
    call, valid = getattr(functions(), f"{ask}{lanes}"), 4 * lanes

    @numba.njit(nogil=True)
    def one(scene, record, args):
        call(scene, record, args)

    @numba.njit(nogil=True)
    def packet(scene, record, args):
        call(record, scene, record + valid, args)

    each = one if lanes == 1 else packet

    @numba.njit(nogil=True)
    def work(ticket, scene, records, args):
        before = control()
        set_control(before | FLUSH)
        for i in items(ticket):
            each(scene, records + size * i, args)
        set_control(before)

    work(new_ticket(0, 1), 0, 0, 0)
    return work


@inlined
def _write_ray(flat, whole, at, step, rays, i):
    """Write an RTCRay whose words are `step` apart. The caller writes the words after it."""
    for k in range(3):
        flat[at + k * step] = rays.origins[i // rays.each, k]
        flat[at + (4 + k) * step] = rays.directions[i, k]
    flat[at + 3 * step] = flat[at + 7 * step] = 0.0  # tnear, time
    flat[at + 8 * step] = rays.tmax
    whole[at + 9 * step], whole[at + 10 * step], whole[at + 11 * step] = -1, 0, 0  # mask, id, flags


@kernel
def _write(ticket, flat, whole, words, ids, rays):
    """Worker: write the records of ids, (n, lanes)."""
    lanes = ids.shape[1]
    size = len(flat) // len(ids)
    for i in items(ticket):
        for lane in range(lanes):
            at = i * size + lane
            if lanes > 1:
                whole[at] = -1 if ids[i, lane] >= 0 else 0
                at += lanes
            _write_ray(flat, whole, at, lanes, rays, max(ids[i, lane], 0))
            for k in range(RAY_WORDS, words):
                whole[at + k * lanes] = -1  # no hit


def write(rays: RaySet, ids: np.ndarray, hits: bool = False, threads=None) -> Records:
    """New records of the rays with these ids: (n,) for single rays, (n, lanes) from `packets` for packets.

    hits : whether to find the closest hit, not any hit
    """
    words, lanes = HIT_WORDS if hits else RAY_WORDS, 1 if ids.ndim == 1 else ids.shape[1]
    shape = (len(ids), words) if lanes == 1 else (len(ids), 1 + words, lanes)
    size = int(np.prod(shape[1:]))
    # If Embree has no kernel for a packet, rtcOccludedN reads an RTCRayHitN, beyond the end of the last record.
    flat = aligned_empty((len(ids) * size + HIT_WORDS * lanes,), "f4")[: len(ids) * size]
    columns = ids.reshape(-1, lanes)
    run(_write, thread_count(threads), new_ticket(len(ids), _RAYS_AT_A_TIME), flat, flat.view(np.int32), words, columns,
        rays)  # fmt: skip
    return Records(flat.reshape(shape), ids, _loop("intersect" if hits else "occluded", lanes, 4 * size))


def trace(scene: EmbreeScene, records: Records, coherent: bool = False, threads=None) -> None:
    """Trace the records in place. `coherent` sets RTC_RAY_QUERY_FLAG_COHERENT."""
    args, n = arguments(coherent), len(records.ids)
    chunk = _RAYS_AT_A_TIME if records.ids.ndim == 1 else _RAYS_AT_A_TIME // records.ids.shape[1]
    run(records.work, thread_count(threads), new_ticket(n, chunk), scene.handle, records.memory.ctypes.data,
        ctypes.addressof(args))  # fmt: skip


def _words(records: Records, which: int) -> tuple[np.ndarray, np.ndarray]:
    """(ids, one word of each ray's record)."""
    if records.ids.ndim == 1:
        return records.ids, records.memory[:, which]
    valid = records.ids >= 0
    return records.ids[valid], records.memory[:, 1 + which][valid]


def occluded_of(rays: RaySet, records: Records) -> np.ndarray:
    """(rays,) bool by ray id: the answers in traced records; False for a ray that was not asked."""
    out = np.zeros(len(rays.directions), bool)
    ids, tfar = _words(records, _TFAR)
    out[ids] = tfar < 0.0
    return out


def faces_of(rays: RaySet, records: Records) -> np.ndarray:
    """(rays,) int32 by ray id: the nearest face, -1 on a miss."""
    out = np.full(len(rays.directions), -1, np.int32)
    ids, face = _words(records, _FACE)
    geometry = _words(records, _GEOMETRY)[1].view(np.int32)
    out[ids] = np.where(geometry < 0, -1, face.view(np.int32))
    return out


def occluded(scene: EmbreeScene, origins, directions, tmax=np.inf, threads=None) -> np.ndarray:
    """(n,) bool: Embree's answers for rays, (n, 3) each, traced one by one."""
    rays = ray_set(origins, directions, tmax)
    records = write(rays, np.arange(len(rays.directions), dtype=np.int32), threads=threads)
    trace(scene, records, threads=threads)
    return occluded_of(rays, records)
