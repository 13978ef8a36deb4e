"""NVIDIA's cards, through their driver: `cuda_driver` has its library and its errors.

Each card has one context for the whole process, the primary one, so addresses and streams of PyTorch, CuPy and JAX are
valid in it. Streams do not wait for the default stream of those libraries; `Queue.wait` orders them.
"""

import ctypes
import weakref
from ctypes import c_float, c_int, c_uint64, c_void_p
from math import prod
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..base.forks import hold_during_fork
from .cuda_driver import NOT_READY, OUT_OF_MEMORY, CudaContext, cuda_cards
from .device import Device, DeviceError, Event, Module, Queue

if TYPE_CHECKING:
    from ..kernels.toolchain.device_code import DeviceCode

_PORTABLE = 1  # CU_MEMHOSTALLOC_PORTABLE: page-locked for all contexts
_NON_BLOCKING = 1  # CU_STREAM_NON_BLOCKING
_ERROR_LOG, _ERROR_LOG_SIZE = 5, 6  # CU_JIT_ERROR_LOG_BUFFER, and its size in bytes
_LOG_BYTES = 4096
_REGISTERS, _LOCAL = 4, 3  # CU_FUNC_ATTRIBUTE_NUM_REGS, CU_FUNC_ATTRIBUTE_LOCAL_SIZE_BYTES

_lock = Lock()
hold_during_fork(_lock)
_cards: dict[int, "_Card"] = {}


class _Card:
    """What all `Cuda` devices of one card share."""

    def __init__(self, ordinal: int, where: str) -> None:
        self.context = CudaContext(ordinal, where)
        self.modules: dict[str, CudaModule] = {}
        self.lock = Lock()
        hold_during_fork(self.lock)


# --- Events, queues and modules ---------------------------------------------------------------------------------------


class CudaEvent(Event):
    """An event in a stream."""

    def __init__(self, device: "Cuda", stream: int) -> None:
        self._device, self._context, self.event = device, device.context, c_void_p()
        self._context.check("cuEventCreate", self.event, 0)
        weakref.finalize(self, self._context.discard, "cuEventDestroy_v2", self.event).atexit = False
        self._context.check("cuEventRecord", self.event, stream)

    def is_done(self) -> bool:
        self._device.check_alive()
        status = self._context.status("cuEventQuery", self.event)
        if status in (0, NOT_READY):
            return status == 0
        raise self._context.driver.error(self._device, "a kernel failed", status)

    def seconds_since(self, earlier: "CudaEvent") -> float:
        milliseconds = c_float()
        self._context.check("cuEventElapsedTime", milliseconds, earlier.event, self.event)
        return 1e-3 * milliseconds.value


class CudaQueue(Queue):
    """A stream: a new one, or one that another library has made.

    handle : that library's stream; None creates one
    """

    def __init__(self, device: "Cuda", handle: int | None = None) -> None:
        self._device = device
        if handle is not None:
            self.handle = handle
            return
        stream = c_void_p()
        device.context.check("cuStreamCreate", stream, _NON_BLOCKING)
        self.handle = stream.value or 0
        weakref.finalize(self, device.context.discard, "cuStreamDestroy_v2", self.handle).atexit = False

    def record(self) -> CudaEvent:
        self._device.check_alive()
        return CudaEvent(self._device, self.handle)

    def wait(self, event: CudaEvent) -> None:
        self._device.check_alive()
        self._device.context.check("cuStreamWaitEvent", self.handle, event.event, 0)


class CudaModule(Module):
    """A kernel that the driver has compiled for the card.

    registers, local_bytes : of a thread
    """

    def __init__(self, code: "DeviceCode", device: "Cuda") -> None:
        super().__init__(code)
        context, module, self.function = device.context, c_void_p(), c_void_p()
        log, text = ctypes.create_string_buffer(_LOG_BYTES), code.code + b"\0"  # the driver looks for the end
        options = (c_int * 2)(_ERROR_LOG, _ERROR_LOG_SIZE)
        values = (c_void_p * 2)(ctypes.addressof(log), _LOG_BYTES)
        status = context.status("cuModuleLoadDataEx", module, text, len(options), options, values)
        if status:
            about = log.value.decode(errors="replace").strip()
            raise context.driver.error(device, f"the driver does not take {code.entry}", status, about or None)
        context.check("cuModuleGetFunction", self.function, module, code.entry.encode())
        self.registers = self._attribute(context, _REGISTERS)
        self.local_bytes = self._attribute(context, _LOCAL)

    def _attribute(self, context: CudaContext, which: int) -> int:
        value = c_int()
        context.check("cuFuncGetAttribute", value, which, self.function)
        return value.value


# --- Devices ----------------------------------------------------------------------------------------------------------


class Cuda(Device):
    """A card of NVIDIA's.

    ordinal : the driver's number, in the order of ``CUDA_VISIBLE_DEVICES``
    max_memory : as in `Device`

    Raises
    ------
    DeviceError
        If there is no such card or no driver, or if another program has the card for itself.
    """

    kind, form, dlpack_kind = "cuda", "ptx", 2

    def __init__(self, ordinal: int = 0, max_memory: int | None = None) -> None:
        cards = cuda_cards()
        if ordinal >= len(cards):
            last = f"the last card is cuda:{len(cards) - 1}" if cards else "the driver lists no card"
            raise DeviceError(f"there is no cuda:{ordinal}; {last}")
        found = cards[ordinal]
        super().__init__(ordinal, found.model, found.driver, max_memory)
        if found.problem is not None:
            raise DeviceError(f"{self}: {found.problem}")
        with _lock:
            if ordinal not in _cards:
                _cards[ordinal] = _Card(ordinal, str(self))
            self.card = _cards[ordinal]
        self.context = self.card.context

    # Memory

    def free_memory(self) -> int:
        free, total = ctypes.c_size_t(), ctypes.c_size_t()
        self.context.check("cuMemGetInfo_v2", free, total)
        return free.value

    def _allocate(self, size: int) -> int | None:
        address = c_uint64()
        status = self.context.status("cuMemAlloc_v2", address, size)
        if status not in (0, OUT_OF_MEMORY):
            raise self.context.driver.error(self, "cuMemAlloc", status)
        return address.value if status == 0 else None

    def _release(self, address: int) -> None:
        self.context.discard("cuMemFree_v2", address)  # waits until no kernel uses it

    def upload_bytes(self, address: int, source: NDArray[Any], queue: Queue | None, wait: bool) -> None:
        queue = queue or self.queue
        self.context.check("cuMemcpyHtoDAsync_v2", address, source.ctypes.data, source.nbytes, queue.handle)
        if wait:
            queue.synchronise()

    def download_bytes(self, address: int, into: NDArray[Any], queue: Queue | None, wait: bool) -> None:
        queue = queue or self.queue
        self.context.check("cuMemcpyDtoHAsync_v2", into.ctypes.data, address, into.nbytes, queue.handle)
        if wait:
            queue.synchronise()

    def fill_bytes(self, address: int, byte: int, size: int, queue: Queue | None) -> None:
        self.context.check("cuMemsetD8Async", address, byte, size, (queue or self.queue).handle)

    def host_array(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        self.check_alive()
        kind, shape = np.dtype(dtype), (shape,) if isinstance(shape, int) else shape
        block = _PageLocked(self.context, prod(shape) * kind.itemsize)
        return np.asarray(block).view(kind).reshape(shape)

    # Kernels

    def new_queue(self) -> CudaQueue:
        self.check_alive()
        return CudaQueue(self)

    def foreign_queue(self, handle: int) -> CudaQueue:
        self.check_alive()
        return CudaQueue(self, handle)

    def _load(self, code: "DeviceCode") -> CudaModule:
        with self.card.lock:
            if code.digest not in self.card.modules:
                self.card.modules[code.digest] = CudaModule(code, self)
            return self.card.modules[code.digest]

    def _launch(self, module: CudaModule, words: NDArray[np.int64], blocks: int, block: int, queue: Any) -> None:
        first, count = words.ctypes.data, len(words)
        parameters = (c_void_p * count)(*range(first, first + 8 * count, 8))  # addresses of the words
        self.context.check(
            "cuLaunchKernel", module.function, blocks, 1, 1, block, 1, 1, 0, queue.handle, parameters, None
        )


class _PageLocked:
    """The base of an array in page-locked memory of the host, and of all its views."""

    def __init__(self, context: CudaContext, size: int) -> None:
        start = c_void_p()
        context.check("cuMemHostAlloc", start, max(size, 1), _PORTABLE)
        weakref.finalize(self, context.discard, "cuMemFreeHost", start).atexit = False
        self.__array_interface__ = {"shape": (size,), "typestr": "|u1", "data": (start.value, False), "version": 3}
