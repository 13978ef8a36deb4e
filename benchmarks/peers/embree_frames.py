"""A frame as rendered by a program written for Embree: primary rays, and shadow rays to one light.

The loops are compiled, and generate rays where they trace them. Threads share blocks of 4 x 4 pixels. Receivers are
offset from their surfaces by the formula of `query.receivers`, without its exact test. Samples below the horizon are
not traced. The light samples are those of our frames and the same for all receivers, so the light must be a point, quad
or disk.
"""

import ctypes
from functools import cache
from typing import NamedTuple

import numba
import numpy as np

from antumbra.kernels.jit import inlined
from antumbra.kernels.parallel import CHUNK, N, new_ticket, run, take
from antumbra.kernels.simd import (
    bits,
    f32_at,
    get,
    i32_at,
    load4,
    load8,
    load16,
    ptr,
    put,
    select,
    splat4,
    splat8,
    splat16,
    store,
)
from antumbra.query.gbuffer import FaceNormal, GBuffer, face_normal, fill_pixel, pixel_direction, surface_of
from antumbra.query.light_samples import light_samples
from antumbra.query.receivers import NOTHING
from antumbra.scene.camera import CameraRays
from antumbra.scene.lights import FIXED
from peers.embree import FLUSH, HIT_WORDS, EmbreeScene, arguments, control, functions, set_control

BLOCK = 4
ORDERS = "pixels", "samples"
"""The packets of shadow rays: one sample of several pixels, or several samples of one pixel."""

_WORDS = 16 * (1 + HIT_WORDS) + 16  # 4-byte words of a packet of 16 rays with its mask and alignment
_TFAR, _FACE, _GEOMETRY = 8, 17, 18
_SHIFT = np.float32(2.0**-21)


class Primary(NamedTuple):
    """The tracing mode of primary rays."""

    lanes: int  # rays per call: 1, 4, 8 or 16
    coherent: bool  # RTC_RAY_QUERY_FLAG_COHERENT

    def __str__(self) -> str:
        return f"rtcIntersect{self.lanes}{' coherent' if self.coherent else ''}"


class Shadow(NamedTuple):
    """The tracing mode of shadow rays."""

    lanes: int  # rays per call: 1, 4, 8 or 16
    order: str  # one of ORDERS
    coherent: bool  # RTC_RAY_QUERY_FLAG_COHERENT

    def __str__(self) -> str:
        return f"rtcOccluded{self.lanes} by {self.order}{' coherent' if self.coherent else ''}"


class Hits(NamedTuple):
    """The result of primary rays."""

    gbuffer: GBuffer
    origins: np.ndarray  # (H, W, 3) float32: receivers


@inlined
def _put_ray(floats, ints, lanes, lane, o, d, tmax):
    """Write ray `lane` of a packet. A single ray is a packet of one."""
    for k in range(3):
        put(floats, k * lanes + lane, o[k])
        put(floats, (4 + k) * lanes + lane, d[k])
    put(floats, 3 * lanes + lane, np.float32(0.0))
    put(floats, 7 * lanes + lane, np.float32(0.0))
    put(floats, _TFAR * lanes + lane, tmax)
    put(ints, 9 * lanes + lane, np.int32(-1))
    put(ints, 10 * lanes + lane, np.int32(0))
    put(ints, 11 * lanes + lane, np.int32(0))


@cache
def _caller(query: str, lanes: int):
    """A compiled call of rtcIntersectN or rtcOccludedN on the packet at an address, with the mask before the packet."""
    call = getattr(functions(), f"{query}{lanes}")

    @numba.njit(nogil=True)
    def one(scene, packet, args):
        call(scene, packet, args)

    @numba.njit(nogil=True)
    def many(scene, packet, args):
        call(packet - 4 * lanes, scene, packet, args)

    return one if lanes == 1 else many


@cache
def _primary_loop(lanes: int):
    """Worker: trace primary rays of rows of blocks. It contains process addresses, so it is not cached on disk."""
    call, wide = _caller("intersect", lanes), min(lanes, BLOCK)
    infinite, high = np.float32(np.inf), max(lanes // BLOCK, 1)

    @numba.njit(nogil=True, error_model="numpy")
    def work(ticket, scene, rays, corners, gbuffer, origins, args):
        before = control()
        set_control(before | FLUSH)
        memory = np.empty(_WORDS, np.float32)
        packet = (memory.ctypes.data + 4 * lanes + 63) // 64 * 64
        floats, ints, mask = f32_at(packet), i32_at(packet), i32_at(packet - 4 * lanes)
        surface, triangles, out = surface_of(gbuffer), ptr(corners), ptr(origins)
        h, w = gbuffer.face.shape
        origin = rays.origin[0], rays.origin[1], rays.origin[2]
        first, last, normal = take(ticket), np.int64(-1), FaceNormal(0.0, 0.0, 0.0, 0.0)
        while first >= 0:
            for row in range(first, min(first + ticket[CHUNK], ticket[N])):
                y0 = row * high
                for x0 in range(0, w, wide):
                    for lane in range(lanes):
                        y, x = y0 + lane // wide, x0 + lane % wide
                        if lanes > 1:
                            put(mask, lane, np.int32(-1) if y < h and x < w else np.int32(0))
                        _put_ray(floats, ints, lanes, lane, origin, pixel_direction(rays, x, y), infinite)
                        put(ints, _GEOMETRY * lanes + lane, np.int32(-1))
                        put(ints, 19 * lanes + lane, np.int32(-1))
                    call(scene, packet, args)
                    for lane in range(lanes):
                        y, x = y0 + lane // wide, x0 + lane % wide
                        if y >= h or x >= w:
                            continue
                        at = y * w + x
                        if get(ints, _GEOMETRY * lanes + lane) < 0:
                            gbuffer.face[y, x], gbuffer.depth[y, x], gbuffer.side[y, x] = -1, infinite, NOTHING
                            for k in range(3):
                                gbuffer.position[y, x, k] = gbuffer.normal[y, x, k] = np.float32(0.0)
                            continue
                        face, t = get(ints, _FACE * lanes + lane), get(floats, _TFAR * lanes + lane)
                        gbuffer.face[y, x], gbuffer.depth[y, x] = face, t
                        if face != last:  # as in our own filling
                            last, normal = np.int64(face), face_normal(triangles, np.int64(face))
                        fill_pixel(y, x, normal, np.float64(t), rays, surface, at)
                        p, n = surface.position, surface.normal
                        a, b, c = abs(get(p, 3 * at)), abs(get(p, 3 * at + 1)), abs(get(p, 3 * at + 2))
                        shift = _SHIFT * max(a, b, c)
                        for k in range(3):
                            put(out, 3 * at + k, get(p, 3 * at + k) + shift * get(n, 3 * at + k))
            first = take(ticket)
        set_control(before)

    return work


class _Packet(NamedTuple):
    """Pointers into a thread's memory for a packet of rays, or a single ray. Words of a lane are `lanes` apart."""

    floats: object  # float32 *, the RTCRayN
    mask: object  # int32 *, before the RTCRayN
    normals: object  # float32 *, (3, lanes): normals of the receivers
    unseen: object  # int64 *, (lanes,): bits of each lane's pixel


@inlined
def _put_receiver(packet, lanes, lane, gbuffer, origins, at):
    """Make pixel number `at` the receiver of a lane; -1: none."""
    for k in range(3):
        put(packet.floats, k * lanes + lane, get(origins, 3 * at + k) if at >= 0 else np.float32(0.0))
        put(packet.normals, k * lanes + lane, get(gbuffer.normal, 3 * at + k) if at >= 0 else np.float32(0.0))
    put(packet.unseen, lane, 0)


@inlined
def _pixel(gbuffer, y0, x0, p, h, w):
    """The number of pixel p of a block; -1 without a visible surface or outside the picture."""
    y, x = y0 + p // BLOCK, x0 + p % BLOCK
    if y >= h or x >= w or get(gbuffer.side, y * w + x) == NOTHING:
        return -1
    return y * w + x


@cache
def _tracer(lanes: int):
    """A function that traces a packet's rays to light points and returns the bits of lanes that do not see theirs.

    The points' x are at `first`; y and z follow, `step` apart. Points below the horizon and NaN are not traced.
    """
    call = _caller("occluded", lanes)

    @numba.njit(nogil=True, error_model="numpy")
    def trace_one(scene, address, packet, points, first, step, args):
        height = np.float32(0.0)
        for k in range(3):
            d = get(points, first + k * step) - get(packet.floats, k)
            put(packet.floats, 4 + k, d)
            height += d * get(packet.normals, k)
        if not height > np.float32(0.0):
            return 1
        put(packet.floats, _TFAR, np.float32(1.0))
        call(scene, address, args)
        return 1 if get(packet.floats, _TFAR) < np.float32(0.0) else 0

    if lanes == 1:
        return trace_one
    load, splat, everyone = *{4: (load4, splat4), 8: (load8, splat8), 16: (load16, splat16)}[lanes], (1 << lanes) - 1

    @numba.njit(nogil=True, error_model="numpy")
    def trace(scene, address, packet, points, first, step, args):
        floats, normals = packet.floats, packet.normals
        x = load(points, first) - load(floats, 0)
        y = load(points, first + step) - load(floats, lanes)
        z = load(points, first + 2 * step) - load(floats, 2 * lanes)
        height = x * load(normals, 0) + y * load(normals, lanes) + z * load(normals, 2 * lanes)
        mask = height > np.float32(0.0)
        if bits(mask) == 0:
            return everyone
        store(floats, 4 * lanes, x)
        store(floats, 5 * lanes, y)
        store(floats, 6 * lanes, z)
        store(floats, _TFAR * lanes, splat(np.float32(1.0)))
        store(packet.mask, 0, select(mask, splat(np.int32(-1)), splat(np.int32(0))))
        call(scene, address, args)
        return bits(~mask | (load(floats, _TFAR * lanes) < np.float32(0.0)))

    return trace


@cache
def _shadow_loop(lanes: int, order: str):
    """Worker: trace shadow rays of rows of 4 x 4 blocks. Bit s of a pixel is set if sample s is not visible."""
    trace, by_pixels, pixels = _tracer(lanes), order == "pixels", lanes if order == "pixels" else 1

    @numba.njit(nogil=True, error_model="numpy")
    def work(ticket, scene, gbuffer, origins, lights, spp, out, args):
        before = control()
        set_control(before | FLUSH)
        memory, normals, unseen_bits = np.zeros(_WORDS, np.float32), np.empty(48, np.float32), np.empty(16, np.int64)
        address = (memory.ctypes.data + 4 * lanes + 63) // 64 * 64
        packet = _Packet(f32_at(address), i32_at(address - 4 * lanes), ptr(normals), ptr(unseen_bits))
        for lane in range(lanes):  # ray masks: the same for all rays, and Embree does not change them
            put(i32_at(address), 9 * lanes + lane, np.int32(-1))
        h, w = gbuffer.face.shape
        surface, receivers, points, results = surface_of(gbuffer), ptr(origins), ptr(lights), ptr(out)
        width = lights.shape[2]
        first = take(ticket)
        while first >= 0:
            for row in range(first, min(first + ticket[CHUNK], ticket[N])):
                for x0 in range(0, w, BLOCK):
                    for p in range(0, BLOCK * BLOCK, pixels):
                        for lane in range(lanes):
                            at = _pixel(surface, row * BLOCK, x0, p + (lane if by_pixels else 0), h, w)
                            _put_receiver(packet, lanes, lane, surface, receivers, at)
                        if by_pixels:
                            for s in range(spp):
                                unseen = trace(scene, address, packet, points, 3 * width * s + p, width, args)
                                for lane in range(lanes):
                                    put(packet.unseen, lane, get(packet.unseen, lane) | (unseen >> lane & 1) << s)
                        elif _pixel(surface, row * BLOCK, x0, p, h, w) >= 0:
                            for s in range(0, spp, lanes):
                                unseen = trace(scene, address, packet, points, 3 * width * p + s, width, args)
                                put(packet.unseen, 0, get(packet.unseen, 0) | unseen << s)
                        for lane in range(pixels):
                            at = _pixel(surface, row * BLOCK, x0, p + lane, h, w)
                            if at >= 0:
                                put(results, at, unseen_bits[lane])
            first = take(ticket)
        memory[0], normals[0] = np.float32(0.0), np.float32(0.0)  # keeps both arrays alive until here
        set_control(before)

    return work


def primary(scene: EmbreeScene, triangles, rays: CameraRays, how: Primary, threads: int) -> Hits:
    """The G-buffer of a camera and its receivers."""
    shape = rays.height, rays.width
    vectors = [np.empty((*shape, 3), np.float32) for _ in range(3)]
    face, depth, side = (np.empty(shape, dtype) for dtype in (np.int32, np.float32, np.int8))
    gbuffer = GBuffer(*vectors[:2], face, depth, side, triangles.origin)
    args, ticket = arguments(how.coherent), new_ticket(-(-shape[0] // max(how.lanes // BLOCK, 1)), 4)
    corners = triangles.vertices.reshape(-1, 9)
    run(
        _primary_loop(how.lanes),
        threads,
        ticket,
        scene.handle,
        rays,
        corners,
        gbuffer,
        vectors[2],
        ctypes.addressof(args),
    )
    return Hits(gbuffer, vectors[2])


def light_points(light, origin: np.ndarray, spp: int) -> np.ndarray:
    """(16, spp, 3) float32: the samples of a light in the frame at `origin`, the same for all receivers."""
    patch = light.patch(origin, 1.0)
    if patch.kind != FIXED or spp > 64:
        raise NotImplementedError("a point, quad or disk, and at most 64 samples")
    a = light_samples(light, spp)
    return (((patch.base + a[..., :1] * patch.u) + a[..., 1:2] * patch.v) + a[..., 2:] * patch.w).astype(np.float32)


def shadows(scene: EmbreeScene, hits: Hits, points: np.ndarray, how: Shadow, threads: int) -> np.ndarray:
    """(H, W, 1) uint64: bit s is set if sample s of `light_points` is not visible."""
    shape, spp = hits.gbuffer.face.shape, points.shape[1]
    filled = -(-spp // how.lanes) * how.lanes
    if how.order == "pixels":
        table = np.ascontiguousarray(points.transpose(1, 2, 0))
    else:
        table = np.full((len(points), 3, filled), np.nan, np.float32)
        table[..., :spp] = points.transpose(0, 2, 1)
    unseen, args = np.zeros((*shape, 1), np.uint64), arguments(how.coherent)
    run(
        _shadow_loop(how.lanes, how.order),
        threads,
        new_ticket(-(-shape[0] // BLOCK), 1),
        scene.handle,
        hits.gbuffer,
        hits.origins,
        table,
        spp,
        unseen,
        ctypes.addressof(args),
    )
    return unseen if spp == filled else unseen & np.uint64((1 << spp) - 1)
