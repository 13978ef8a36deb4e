"""OpenCL devices, through pyopencl: Intel's graphics cards, AMD's where the driver takes SPIR-V, and processors.

Kernels take addresses as numbers, so memory is shared virtual memory: an allocation has one address on the host and on
the device. A device that cannot read all of the host's memory must be given the list of allocations before a launch,
since the driver does not see addresses among the words.
"""

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from ..base.forks import hold_during_fork
from ..base.memory import available_memory, readable_size
from .device import Device, DeviceError, Event, Module, OutOfDeviceMemory, Queue
from .opencl_drivers import NO_DRIVER, OpenClDevice, error_name, opencl_devices, pyopencl

if TYPE_CHECKING:
    from ..kernels.toolchain.device_code import DeviceCode

_ALIGNMENT = 128  # the largest that the standard allows
_SVM_POINTERS = 0x11B7  # CL_KERNEL_EXEC_INFO_SVM_PTRS
_NO_MEMORY = "MEM_OBJECT_ALLOCATION_FAILURE", "OUT_OF_RESOURCES", "OUT_OF_HOST_MEMORY"

_lock = Lock()
hold_during_fork(_lock)
_cards: dict[int, "_Card"] = {}


@contextmanager
def _named_errors(device: object) -> Iterator[None]:
    """Turn errors of pyopencl into a DeviceError of one line."""
    try:
        yield
    except pyopencl().Error as error:
        raise DeviceError(f"{device}: {error_name(error)}; if it happens again, please report it") from None


def _part(address: int, size: int) -> Any:
    """Memory at an address, on the host or in an allocation, as pyopencl takes it."""
    return pyopencl().SVM((ctypes.c_char * size).from_address(address))


# --- Events and queues ------------------------------------------------------------------------------------------------


class OpenClEvent(Event):
    """A marker in a queue."""

    def __init__(self, marker: Any, device: "OpenCl") -> None:
        self.marker, self._device = marker, device

    def is_done(self) -> bool:
        self._device.check_alive()
        with _named_errors(self._device):
            status = self.marker.command_execution_status
        if status < 0:
            raise DeviceError(f"{self._device}: a kernel failed: {_status_name(status)}; please report it")
        return bool(status == pyopencl().command_execution_status.COMPLETE)

    def seconds_since(self, earlier: "OpenClEvent") -> float:
        with _named_errors(self._device):
            return float(1e-9 * (self.marker.profile.end - earlier.marker.profile.end))


class OpenClQueue(Queue):
    """A command queue, in order."""

    def __init__(self, device: "OpenCl") -> None:
        cl, self._device = pyopencl(), device
        with _named_errors(device):
            context = device.card.context
            self.commands = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        device.card.queues.add(self)

    def record(self) -> OpenClEvent:
        self._device.check_alive()
        with _named_errors(self._device):
            marker = pyopencl().enqueue_marker(self.commands)
            self.commands.flush()  # another queue may wait for it
        return OpenClEvent(marker, self._device)

    def wait(self, event: OpenClEvent) -> None:
        self._device.check_alive()
        with _named_errors(self._device):
            pyopencl().enqueue_barrier(self.commands, wait_for=[event.marker])


# --- Modules ----------------------------------------------------------------------------------------------------------


class _Card:
    """What all `OpenCl` devices of one card share: its context, its allocations and its modules."""

    def __init__(self, found: OpenClDevice) -> None:
        cl = pyopencl()
        self.handle = found.handle
        self.context = cl.Context([found.handle])
        self.allocations: dict[int, Any] = {}  # address -> SVMAllocation
        self.changes = 0  # of the allocations
        self.queues: WeakSet[OpenClQueue] = WeakSet()
        self.modules: dict[str, OpenClModule] = {}
        self.lock = Lock()
        hold_during_fork(self.lock)
        capabilities, fp = cl.device_svm_capabilities, cl.device_fp_config
        self.reads_host = bool(found.handle.svm_capabilities & capabilities.FINE_GRAIN_SYSTEM)
        rounded = found.handle.single_fp_config & fp.CORRECTLY_ROUNDED_DIVIDE_SQRT
        self.options = "-cl-fp32-correctly-rounded-divide-sqrt" if rounded else ""


class OpenClModule(Module):
    """A kernel, with the lock of its arguments: OpenCL keeps them in the kernel between the calls of a launch."""

    def __init__(self, code: "DeviceCode", card: _Card) -> None:
        super().__init__(code)
        cl, self._card, self._changes, self.lock = pyopencl(), card, -1, Lock()
        program = cl.Program(card.context, code.code)
        _build(program, card)
        self.kernel = cl.Kernel(program, code.entry)

    def declare_allocations(self) -> None:
        """Tell the driver which allocations the kernel may reach by their addresses."""
        if self._changes == self._card.changes:
            return
        self._changes = self._card.changes
        addresses = list(self._card.allocations)
        if addresses:
            pointers = (ctypes.c_void_p * len(addresses))(*addresses)
            handle, size = ctypes.c_void_p(self.kernel.int_ptr), ctypes.c_size_t(ctypes.sizeof(pointers))
            status = _loader().clSetKernelExecInfo(handle, ctypes.c_uint(_SVM_POINTERS), size, pointers)
            if status:
                raise DeviceError(f"{self.entry}: clSetKernelExecInfo: {_status_name(status)}; please report it")


def _build(program: Any, card: _Card) -> None:
    """Let the driver compile a program, with our options alone: pyopencl adds the user's, which may change rounding."""
    device = ctypes.c_void_p(card.handle.int_ptr)
    status = _loader().clBuildProgram(
        ctypes.c_void_p(program.int_ptr), 1, ctypes.byref(device), card.options.encode(), None, None
    )
    if status:
        log = program.get_build_info(card.handle, pyopencl().program_build_info.LOG)
        raise DeviceError(f"clBuildProgram: {_status_name(status)}: {log}")


def _status_name(status: int) -> str:
    return f"CL_{pyopencl().status_code.to_string(status)}"


def _loader() -> ctypes.CDLL:
    """The library that pyopencl calls; a function is also found in what a library links to, except on Windows."""
    return ctypes.CDLL("OpenCL.dll" if sys.platform == "win32" else pyopencl()._cl.__file__)


# --- Devices ----------------------------------------------------------------------------------------------------------


class OpenCl(Device):
    """A device of an OpenCL driver.

    ordinal : in the order of `opencl_drivers.opencl_devices`
    max_memory : as in `Device`

    Raises
    ------
    MissingPackage
        If pyopencl is not installed.
    DeviceError
        If there is no such device, or it cannot run our kernels.
    """

    kind, form = "opencl", "spirv"

    def __init__(self, ordinal: int = 0, max_memory: int | None = None) -> None:
        devices = opencl_devices()
        if not devices:
            raise DeviceError(NO_DRIVER)
        if ordinal >= len(devices):
            raise DeviceError(f"there is no opencl:{ordinal}; the last OpenCL device is opencl:{len(devices) - 1}")
        found = devices[ordinal]
        super().__init__(ordinal, found.model, found.driver, max_memory)
        if found.problem is not None:
            raise DeviceError(f"{self}: {found.problem}")
        with _lock, _named_errors(self):
            if ordinal not in _cards:
                _cards[ordinal] = _Card(found)
            self.card = _cards[ordinal]
        self.in_host_memory = bool(self.card.handle.host_unified_memory)

    def free_memory(self) -> int:
        handle = self.card.handle
        taken = sum(each.size for each in list(self.card.allocations.values()))
        free: int = max(handle.global_mem_size - taken, 0)
        return min(free, available_memory() or free) if self.in_host_memory else free

    def _allocate(self, size: int) -> int | None:
        cl, largest = pyopencl(), self.card.handle.max_mem_alloc_size
        if size > largest:
            raise OutOfDeviceMemory(
                f"{self}: an array takes {readable_size(size)}, and this driver allocates at most "
                f"{readable_size(largest)} in one piece; split the scene, or compute on the CPU",
                size,
                largest,
            )
        with _named_errors(self):
            try:
                memory = cl.SVMAllocation(self.card.context, size, _ALIGNMENT, cl.svm_mem_flags.READ_WRITE)
            except cl.Error as error:
                if cl.status_code.to_string(error.code) in _NO_MEMORY:
                    return None
                raise
        address: int = memory.svm_ptr
        self.card.allocations[address] = memory
        self.card.changes += 1
        return address

    def _release(self, address: int) -> None:
        memory = self.card.allocations.pop(address)
        self.card.changes += 1
        for queue in list(self.card.queues):  # the driver frees at once, even what a kernel still uses
            queue.commands.finish()
        memory.release()

    def upload_bytes(self, address: int, source: NDArray[Any], queue: Any, wait: bool) -> None:
        self._copy(address, source.ctypes.data, source, queue, wait)

    def download_bytes(self, address: int, into: NDArray[Any], queue: Any, wait: bool) -> None:
        self._copy(into.ctypes.data, address, into, queue, wait)

    def _copy(self, to: int, start: int, array: NDArray[Any], queue: Any, wait: bool) -> None:
        commands = self._commands(queue)
        with _named_errors(self):
            to_part, from_part = _part(to, array.nbytes), _part(start, array.nbytes)
            pyopencl().enqueue_copy(commands, to_part, from_part, is_blocking=wait)
            commands.flush()

    def fill_bytes(self, address: int, byte: int, size: int, queue: Any) -> None:
        with _named_errors(self):
            pyopencl().enqueue_svm_memfill(self._commands(queue), _part(address, size), np.uint8(byte))

    def _commands(self, queue: OpenClQueue | None) -> Any:
        chosen: Any = queue or self.queue
        return chosen.commands

    def new_queue(self) -> OpenClQueue:
        self.check_alive()
        return OpenClQueue(self)

    def _load(self, code: "DeviceCode") -> OpenClModule:
        with self.card.lock:
            if code.digest not in self.card.modules:
                try:
                    self.card.modules[code.digest] = OpenClModule(code, self.card)
                except (DeviceError, pyopencl().Error) as error:
                    reason = error if isinstance(error, DeviceError) else error_name(error)
                    raise DeviceError(f"{self}: the driver does not take {code.entry}: {reason}") from None
            return self.card.modules[code.digest]

    def _launch(self, module: OpenClModule, words: NDArray[np.int64], blocks: int, block: int, queue: Any) -> None:
        with module.lock, _named_errors(self):
            module.kernel.set_args(*words)
            if not self.card.reads_host:
                module.declare_allocations()
            pyopencl().enqueue_nd_range_kernel(queue.commands, module.kernel, (blocks * block,), (block,))
            queue.commands.flush()
