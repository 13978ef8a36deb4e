"""Embree, for comparisons: the library in the ``embreex`` wheel, called through its C interface.

Ray sets are traced in compiled loops on all threads, with one ray or a packet of 4, 8 or 16 per call::

    records = write(rays, packets(rays, "pixels"))  # not timed; a trace overwrites its records
    trace(scene, records, coherent=True)  # timed
    blocked = occluded_of(rays, records)

The wheel's own Python classes cannot choose the build quality, time the build alone, or trace without Python in the
loop; the library's C functions can. A kernel calls `Functions` directly, with addresses as integers::

    occluded1 = functions().occluded1  # a module global, not an argument

    @numba.njit(nogil=True)
    def trace(scene, rays, n, arguments):
        for i in range(n):
            occluded1(scene, rays + 48 * i, arguments)  # sets tfar of a blocked ray to -inf

Embree requires denormals to be off in tracing threads; our kernels require them to be on, so they are restored.
"""

import ctypes
import platform
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple, Self

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import ArrayLike

from antumbra.base.errors import InputError
from antumbra.bvh.nodes import aligned_empty
from antumbra.kernels.jit import inlined, kernel
from antumbra.kernels.parallel import items, new_ticket, run, thread_count
from peers.ray_contest import PeerRays, ray_set

# --- Denormals --------------------------------------------------------------------------------------------------------


FLUSH = 0x8040  # MXCSR: flush to zero, denormals are zero
_X86 = platform.machine().lower() in ("x86_64", "amd64")


def _call(builder, name, slot):
    address = ir.IntType(8).as_pointer()
    function = builder.module.declare_intrinsic(name, (), ir.FunctionType(ir.VoidType(), [address]))
    builder.call(function, [builder.bitcast(slot, address)])


@intrinsic
def control(typingctx):
    """The MXCSR register of this thread; 0 on processors other than x86."""

    def codegen(context, builder, sig, values):
        slot = builder.alloca(ir.IntType(32))
        builder.store(ir.IntType(32)(0), slot)
        if _X86:
            _call(builder, "llvm.x86.sse.stmxcsr", slot)
        return builder.load(slot)

    return types.uint32(), codegen


@intrinsic
def set_control(typingctx, value):
    """Set the MXCSR register of this thread; no-op on processors other than x86."""

    def codegen(context, builder, sig, values):
        if _X86:
            slot = builder.alloca(ir.IntType(32))
            builder.store(context.cast(builder, values[0], value, types.uint32), slot)
            _call(builder, "llvm.x86.sse.ldmxcsr", slot)
        return context.get_dummy_value()

    return types.void(value), codegen


# --- Library, devices and scenes --------------------------------------------------------------------------------------


QUALITIES = {"low": 0, "medium": 1, "high": 2}
"""Name -> RTCBuildQuality: Morton codes, binned SAH, SAH with spatial splits."""

REFIT = 3
"""The RTCBuildQuality that refits the tree of a dynamic scene."""

DYNAMIC, COMPACT, ROBUST = 1, 2, 4  # RTCSceneFlags
RAY_WORDS, HIT_WORDS = 12, 24
"""Sizes of an RTCRay and of an RTCRayHit in 4-byte words. Embree 4.3 and newer write 21 of the latter, padded to a
multiple of 16 bytes."""

_COHERENT = 1 << 16  # RTCRayQueryFlags
_VERSION, _NATIVE = 0, {16: 34, 8: 33, 4: 32}  # RTCDeviceProperty: version; whether packets of 16, 8, 4 rays are native
_TRIANGLES, _INDICES, _VERTICES, _UINT3, _FLOAT3 = 0, 0, 1, 0x5003, 0x9003

_POINTER, _INT, _UINT, _SIZE = ctypes.c_void_p, ctypes.c_int, ctypes.c_uint, ctypes.c_size_t
_SIGNATURES = {
    "rtcNewDevice": (_POINTER, [ctypes.c_char_p]),
    "rtcReleaseDevice": (None, [_POINTER]),
    "rtcGetDeviceError": (_INT, [_POINTER]),
    "rtcGetDeviceProperty": (ctypes.c_ssize_t, [_POINTER, _INT]),
    "rtcNewGeometry": (_POINTER, [_POINTER, _INT]),
    "rtcSetNewGeometryBuffer": (_POINTER, [_POINTER, _INT, _UINT, _INT, _SIZE, _SIZE]),
    "rtcSetGeometryBuildQuality": (None, [_POINTER, _INT]),
    "rtcUpdateGeometryBuffer": (None, [_POINTER, _INT, _UINT]),
    "rtcCommitGeometry": (None, [_POINTER]),
    "rtcReleaseGeometry": (None, [_POINTER]),
    "rtcNewScene": (_POINTER, [_POINTER]),
    "rtcSetSceneFlags": (None, [_POINTER, _INT]),
    "rtcSetSceneBuildQuality": (None, [_POINTER, _INT]),
    "rtcAttachGeometry": (_UINT, [_POINTER, _POINTER]),
    "rtcCommitScene": (None, [_POINTER]),
    "rtcReleaseScene": (None, [_POINTER]),
    **{f"rtc{query}1": (None, [_POINTER] * 3) for query in ("Intersect", "Occluded")},
    **{f"rtc{query}{rays}": (None, [_POINTER] * 4) for query in ("Intersect", "Occluded") for rays in (4, 8, 16)},
}


class Functions(NamedTuple):
    """Functions for kernels to call; all arguments are addresses. ``embree4/rtcore_ray.h`` has the structures."""

    intersect1: object  # (scene, RTCRayHit, arguments)
    occluded1: object  # (scene, RTCRay, arguments)
    # Packets have a valid mask: an int32 per ray, -1 if the ray is valid.
    intersect4: object  # (valid mask, scene, RTCRayHit4, arguments), aligned to 16 bytes
    occluded4: object  # (valid mask, scene, RTCRay4, arguments)
    intersect8: object  # the same for 8 rays, aligned to 32 bytes
    occluded8: object  # the same for 8 rays, aligned to 32 bytes
    intersect16: object  # the same for 16 rays, aligned to 64 bytes
    occluded16: object  # the same for 16 rays, aligned to 64 bytes


class Arguments(ctypes.Structure):
    """RTCIntersectArguments or RTCOccludedArguments, which have the same layout; made by `arguments`."""

    _fields_ = (
        ("flags", ctypes.c_uint),
        ("feature_mask", ctypes.c_uint),
        ("context", ctypes.c_void_p),
        ("filter", ctypes.c_void_p),
        ("function", ctypes.c_void_p),
    )


def arguments(coherent: bool) -> Arguments:
    """Arguments for coherent or incoherent rays. Keep the object alive while its ``ctypes.addressof`` is in use."""
    return Arguments(_COHERENT if coherent else 0, 0xFFFFFFFF, None, None, None)


@cache
def library() -> ctypes.CDLL:
    """The Embree 4 library, with the types of its functions.

    Raises
    ------
    InputError
        If embreex is not installed.
    """
    try:
        import embreex
        import embreex.rtcore_scene  # loads the libraries that Embree needs
    except ImportError:
        raise InputError("Embree is not installed: pip install 'antumbra[peers]'") from None
    folder = Path(embreex.__file__).parent
    paths = sorted(p for d in (folder, folder.parent / "embreex.libs", folder / ".dylibs") for p in d.glob("*embree4*"))
    if not paths:
        raise InputError(f"embreex in {folder} contains no Embree 4: pip install 'antumbra[peers]'")
    lib = ctypes.CDLL(str(paths[0]))
    for name, (result, parameters) in _SIGNATURES.items():
        function = getattr(lib, name)
        function.restype, function.argtypes = result, parameters
    return lib


def functions() -> Functions:
    """The query functions, for calls in kernels."""
    lib = library()
    queries = "Intersect", "Occluded"
    return Functions(*(getattr(lib, f"rtc{query}{rays}") for rays in (1, 4, 8, 16) for query in queries))


class Device:
    """An Embree device; close it after its scenes.

    threads : number of build threads; None: all cores
    isa : highest instruction set for Embree to use: "sse2", "sse4.2", "avx", "avx2" or "avx512"; None: the processor's
    """

    def __init__(self, threads: int | None = None, isa: str | None = None):
        options = f"threads={thread_count(threads)}" + (f",isa={isa}" if isa else "")
        self.handle = library().rtcNewDevice(options.encode())
        self.check()

    @property
    def version(self) -> str:
        """Embree's version, such as "4.4.0"."""
        number = self._property(_VERSION)
        return f"{number // 10000}.{number // 100 % 100}.{number % 100}"

    @property
    def width(self) -> int:
        """Rays of the largest packet with native kernels: 16 with AVX-512, 8 with AVX or AVX2, 4 with SSE."""
        return next((rays for rays, number in _NATIVE.items() if self._property(number)), 1)

    def _property(self, number: int) -> int:
        return int(library().rtcGetDeviceProperty(self.handle, number))

    def check(self) -> None:
        """Raise a RuntimeError if Embree has reported an error since the last check."""
        code = library().rtcGetDeviceError(self.handle)
        if code:
            raise RuntimeError(f"Embree reports error {code}")

    def close(self) -> None:
        library().rtcReleaseDevice(self.handle)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class EmbreeScene:
    """A triangle mesh built by Embree.

    Parameters
    ----------
    device : Device
    vertices : (n, 3, 3) float32, or (m, 3) float32 with `faces`
    faces : (n, 3) integers, optional
    quality : one of QUALITIES
    flags : int
        Sum of DYNAMIC, COMPACT, ROBUST.

    Attributes
    ----------
    handle : int
        Address of the RTCScene.
    build_seconds : float
        Wall time of ``rtcCommitScene`` alone, without copying vertices and indices into Embree's buffers.
    """

    def __init__(
        self,
        device: Device,
        vertices: ArrayLike,
        faces: ArrayLike | None = None,
        quality: str = "medium",
        flags: int = 0,
    ):
        if quality not in QUALITIES:
            raise InputError(f"quality is {quality!r}; it must be one of {', '.join(QUALITIES)}")
        vertices = np.ascontiguousarray(vertices, np.float32).reshape(-1, 3)
        faces = np.arange(len(vertices)).reshape(-1, 3) if faces is None else faces
        lib, level = library(), QUALITIES[quality]
        self._device, self._geometry = device, lib.rtcNewGeometry(device.handle, _TRIANGLES)
        geometry = self._geometry
        self._vertices, self._bytes = _copy(lib, geometry, _VERTICES, _FLOAT3, vertices), vertices.nbytes
        _copy(lib, geometry, _INDICES, _UINT3, np.ascontiguousarray(faces, np.uint32))
        lib.rtcSetGeometryBuildQuality(geometry, level)
        lib.rtcCommitGeometry(geometry)
        self.handle = lib.rtcNewScene(device.handle)
        lib.rtcSetSceneFlags(self.handle, flags)
        lib.rtcSetSceneBuildQuality(self.handle, level)
        lib.rtcAttachGeometry(self.handle, geometry)
        lib.rtcReleaseGeometry(geometry)
        start = time.perf_counter()
        lib.rtcCommitScene(self.handle)
        self.build_seconds = time.perf_counter() - start
        device.check()

    def fill(self, vertices: np.ndarray) -> None:
        """Replace the vertices in Embree's buffer by as many others. Call `build_again` afterwards."""
        vertices = np.ascontiguousarray(vertices, np.float32)
        if vertices.nbytes != self._bytes:
            raise ValueError(f"vertices have {vertices.nbytes} bytes; the buffer has {self._bytes}")
        ctypes.memmove(self._vertices, vertices.ctypes.data, vertices.nbytes)

    def build_again(self, refit: bool = False) -> None:
        """Rebuild from the current vertices, or refit (DYNAMIC scenes only). Sets `build_seconds`."""
        lib = library()
        start = time.perf_counter()
        if refit:
            lib.rtcSetGeometryBuildQuality(self._geometry, REFIT)
        lib.rtcUpdateGeometryBuffer(self._geometry, _VERTICES, 0)
        lib.rtcCommitGeometry(self._geometry)
        lib.rtcCommitScene(self.handle)
        self.build_seconds = time.perf_counter() - start
        self._device.check()

    def close(self) -> None:
        library().rtcReleaseScene(self.handle)  # also releases the geometry

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _copy(lib: ctypes.CDLL, geometry: int, kind: int, form: int, rows: np.ndarray) -> int:
    """Copy rows of three 4-byte numbers into a new buffer of the geometry; return its address."""
    buffer: int = lib.rtcSetNewGeometryBuffer(geometry, kind, 0, form, 12, len(rows))
    if buffer:
        ctypes.memmove(buffer, rows.ctypes.data, rows.nbytes)
    return buffer


# --- Ray sets ---------------------------------------------------------------------------------------------------------


_TFAR, _FACE, _GEOMETRY = 8, 17, 18  # words of a record
_RAYS_AT_A_TIME = 4096


class Records(NamedTuple):
    """Rays in Embree's layout, in the order of `ids`."""

    memory: (
        np.ndarray
    )  # float32: (n, words) of single rays; (n, 1 + words, lanes) of packets, with their valid mask first
    ids: np.ndarray  # (n,) or (n, lanes) int32: ray ids, -1 in invalid lanes
    work: Callable[..., None]  # the compiled loop


@cache
def _loop(query: str, lanes: int, size: int) -> Callable[..., None]:
    """A compiled worker that calls "intersect" or "occluded" on each record of `size` bytes.

    It contains addresses of this process, so it is not cached on disk.
    """
    call, valid = getattr(functions(), f"{query}{lanes}"), 4 * lanes

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
def _write_ray(floats, ints, at, step, rays, i):
    """Write an RTCRay with words `step` apart; the caller writes the words after it."""
    for k in range(3):
        floats[at + k * step] = rays.origins[i // rays.each, k]
        floats[at + (4 + k) * step] = rays.directions[i, k]
    floats[at + 3 * step] = floats[at + 7 * step] = 0.0  # tnear, time
    floats[at + 8 * step] = rays.tmax
    ints[at + 9 * step], ints[at + 10 * step], ints[at + 11 * step] = -1, 0, 0  # mask, id, flags


@kernel
def _write(ticket, floats, ints, words, ids, rays):
    """Worker: write the records of ids, (n, lanes)."""
    lanes = ids.shape[1]
    size = len(floats) // len(ids)
    for i in items(ticket):
        for lane in range(lanes):
            at = i * size + lane
            if lanes > 1:
                ints[at] = -1 if ids[i, lane] >= 0 else 0
                at += lanes
            _write_ray(floats, ints, at, lanes, rays, max(ids[i, lane], 0))
            for k in range(RAY_WORDS, words):
                ints[at + k * lanes] = -1  # no hit


def write(rays: PeerRays, ids: np.ndarray, hits: bool = False, threads: int | None = None) -> Records:
    """New records of the rays with these ids: (n,) for single rays, (n, lanes) from `packets` for packets.

    hits : whether to find the closest hit, not any hit
    """
    words, lanes = HIT_WORDS if hits else RAY_WORDS, 1 if ids.ndim == 1 else ids.shape[1]
    shape = (len(ids), words) if lanes == 1 else (len(ids), 1 + words, lanes)
    size = int(np.prod(shape[1:]))
    # If Embree has no kernel for a packet size, rtcOccludedN reads an RTCRayHitN, past the end of the last record.
    floats = aligned_empty((len(ids) * size + HIT_WORDS * lanes,), "f4")[: len(ids) * size]
    columns = ids.reshape(-1, lanes)
    ticket = new_ticket(len(ids), _RAYS_AT_A_TIME)
    run(_write, thread_count(threads), ticket, floats, floats.view(np.int32), words, columns, rays)
    return Records(floats.reshape(shape), ids, _loop("intersect" if hits else "occluded", lanes, 4 * size))


def trace(scene: EmbreeScene, records: Records, coherent: bool = False, threads: int | None = None) -> None:
    """Trace the records in place. `coherent` sets RTC_RAY_QUERY_FLAG_COHERENT."""
    args, n = arguments(coherent), len(records.ids)
    chunk = _RAYS_AT_A_TIME if records.ids.ndim == 1 else _RAYS_AT_A_TIME // records.ids.shape[1]
    memory, address = records.memory.ctypes.data, ctypes.addressof(args)
    run(records.work, thread_count(threads), new_ticket(n, chunk), scene.handle, memory, address)


def _words(records: Records, which: int) -> tuple[np.ndarray, np.ndarray]:
    """(ids, one word of each record)."""
    if records.ids.ndim == 1:
        return records.ids, records.memory[:, which]
    valid = records.ids >= 0
    return records.ids[valid], records.memory[:, 1 + which][valid]


def occluded_of(rays: PeerRays, records: Records) -> np.ndarray:
    """(rays,) bool by ray id: the answers in traced records; False for rays without a record."""
    out = np.zeros(len(rays.directions), bool)
    ids, tfar = _words(records, _TFAR)
    out[ids] = tfar < 0.0
    return out


def faces_of(rays: PeerRays, records: Records) -> np.ndarray:
    """(rays,) int32 by ray id: the nearest face, -1 on a miss."""
    out = np.full(len(rays.directions), -1, np.int32)
    ids, face = _words(records, _FACE)
    geometry = _words(records, _GEOMETRY)[1].view(np.int32)
    out[ids] = np.where(geometry < 0, -1, face.view(np.int32))
    return out


def occluded(
    scene: EmbreeScene,
    origins: ArrayLike,
    directions: ArrayLike,
    tmax: float = np.inf,
    threads: int | None = None,
) -> np.ndarray:
    """(n,) bool: whether Embree finds each ray occluded; origins and directions (n, 3), traced one by one."""
    rays = ray_set(origins, directions, tmax)
    records = write(rays, np.arange(len(rays.directions), dtype=np.int32), threads=threads)
    trace(scene, records, threads=threads)
    return occluded_of(rays, records)
