"""The interface of devices: memory within a budget, modules, launches, queues and events.

A device runs kernels that `kernels.toolchain.device_code` emits. Kernels take addresses and numbers as int64 words, and
an address is the same number on the host and in a kernel. Work that is put into one queue runs in order; work in
different queues may overlap.

A `Device` belongs to one owner, such as an engine, and has its own budget and its own default queue. Devices of one
card share the card's context and the modules loaded there. Every method may be called by several threads. A device does
not survive a fork: in the child, its methods raise an error that says so.
"""

import os
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from threading import RLock
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..base.checks import byte_count
from ..base.errors import InputError
from ..base.memory import readable_size

if TYPE_CHECKING:
    from ..kernels.toolchain.device_code import DeviceCode

BLOCK = 128
"""Threads per block, unless a launch says otherwise."""


class DeviceError(InputError):
    """A device is missing, unusable or failed; the message names the device, the driver's error, and the cure."""


class OutOfDeviceMemory(DeviceError):
    """An allocation exceeds a device's memory or its budget.

    needed : bytes that were asked for
    left : bytes that were left
    """

    def __init__(self, message: str, needed: int, left: int) -> None:
        super().__init__(message)
        self.needed, self.left = needed, left

    def __reduce__(self) -> tuple[type["OutOfDeviceMemory"], tuple[str, int, int]]:
        return OutOfDeviceMemory, (str(self), self.needed, self.left)


def check_process(opener: int, what: str) -> None:
    """Raise a DeviceError unless this is the process that opened a device or driver.

    opener : that process's id
    what : the device or driver, for the message
    """
    if os.getpid() != opener:
        raise DeviceError(
            f"{what}: a forked process cannot use a device that its parent has opened; start processes with "
            "multiprocessing.get_context('spawn'), or open devices only after the fork"
        )


# --- Events and queues ------------------------------------------------------------------------------------------------


_SPIN_SECONDS = 2e-4  # most launches end sooner than the system wakes a thread
_LONGEST_PAUSE = 1e-3


def wait_until(done: Callable[[], bool]) -> None:
    """Return once `done` returns True. Ctrl-C interrupts it; a driver's own waiting cannot be interrupted."""
    start, pause = perf_counter(), 2e-5
    while not done():
        if perf_counter() - start > _SPIN_SECONDS:
            sleep(pause)
            pause = min(2.0 * pause, _LONGEST_PAUSE)


class Event(ABC):
    """A point in a queue, passed once all work put into the queue before it is done."""

    @abstractmethod
    def is_done(self) -> bool:
        """Whether the queue has passed it."""

    @abstractmethod
    def seconds_since(self, earlier: Any) -> float:
        """Seconds on the device's clock between two events of one device, both of them done."""

    def synchronise(self) -> None:
        """Wait until the queue has passed it."""
        wait_until(self.is_done)


class Queue(ABC):
    """Work that a device does in order."""

    handle: int = 0
    """The driver's handle: a CUDA stream, as other libraries take it. 0 on other devices."""

    @abstractmethod
    def record(self) -> Event:
        """An event after all work put into the queue so far."""

    @abstractmethod
    def wait(self, event: Any) -> None:
        """Let later work in this queue wait for an event of another queue of this device; the host does not wait."""

    def synchronise(self) -> None:
        """Wait until all work in the queue is done.

        Raises
        ------
        DeviceError
            If some of it failed.
        """
        self.record().synchronise()


class Module:
    """A kernel loaded on a card."""

    def __init__(self, code: "DeviceCode") -> None:
        self.entry, self.words, self.digest = code.entry, code.words, code.digest


# --- Memory -----------------------------------------------------------------------------------------------------------


class DeviceMemory:
    """A block of a device's memory, freed with `free`, at the end of a ``with`` block, or when it is deleted.

    address : of its first byte, as kernels take it; aligned to 128 bytes
    size : in bytes
    """

    def __init__(self, device: "Device", address: int, size: int) -> None:
        self.device, self.address, self.size = device, address, size
        self._finalizer = weakref.finalize(self, _give_back, device, address, size)
        self._finalizer.atexit = False  # the driver frees everything

    def write(self, source: NDArray[Any], offset: int = 0, queue: Queue | None = None, wait: bool = True) -> None:
        """Copy an array's bytes into the block, in the order of the queue.

        source : any dtype; it is copied first if it is not C-contiguous
        offset : byte of the block where it goes
        wait : whether to return only when `source` may be changed; if False, it must stay unchanged until then
        """
        source = np.ascontiguousarray(source)
        self._check(offset, source.nbytes)
        if source.nbytes:
            self.device.upload_bytes(self.address + offset, source, queue, wait)

    def read(self, into: NDArray[Any], offset: int = 0, queue: Queue | None = None, wait: bool = True) -> NDArray[Any]:
        """Copy bytes of the block into a C-contiguous array, in the order of the queue; return the array.

        wait : whether to return only when they are there; if False, they are there once the queue is synchronised
        """
        if not (into.flags.c_contiguous and into.flags.writeable):
            raise ValueError("a device can only be read into a writeable C-contiguous array")
        self._check(offset, into.nbytes)
        if into.nbytes:
            if wait:
                (queue or self.device.queue).synchronise()  # by polling: a driver's copy cannot be interrupted
            self.device.download_bytes(self.address + offset, into, queue, wait)
        return into

    def fill(self, byte: int = 0, offset: int = 0, size: int | None = None, queue: Queue | None = None) -> None:
        """Set bytes of the block, in the order of the queue; by default all bytes from `offset` on."""
        size = self.size - offset if size is None else size
        self._check(offset, size)
        if size:
            self.device.fill_bytes(self.address + offset, byte, size, queue)

    def free(self) -> None:
        """Free the block; kernels that use it must have ended."""
        self._finalizer()

    def _check(self, offset: int, size: int) -> None:
        self.device.check_alive()
        if not self._finalizer.alive:
            raise ValueError("this device memory is freed")
        if offset < 0 or size < 0 or offset + size > self.size:
            raise ValueError(f"bytes {offset} to {offset + size} are not within a block of {self.size} bytes")

    def __enter__(self) -> "DeviceMemory":
        return self

    def __exit__(self, *_: object) -> None:
        self.free()


def _give_back(device: "Device", address: int, size: int) -> None:
    if device.is_alive():
        device.release(address, size)


# --- Devices ----------------------------------------------------------------------------------------------------------


class Device(ABC):
    """A device and a budget of its memory.

    kind : "cuda", "opencl" or "host"
    ordinal : number among the devices of this kind
    model : the vendor's name
    driver : name and version of the driver
    form : what it loads, "ptx" or "spirv"
    max_memory : bytes that may be allocated at one time; None: all that is free
    """

    kind: ClassVar[str]
    form: ClassVar[str]
    dlpack_kind: ClassVar[int | None] = None
    """DLPack's number for this kind of memory; None if other libraries cannot use it."""
    in_host_memory: bool = False
    """Whether its memory is that of the process."""

    def __init__(self, ordinal: int, model: str, driver: str, max_memory: int | None = None) -> None:
        self.ordinal, self.model, self.driver = ordinal, model, driver
        self.max_memory = None if max_memory is None else byte_count(max_memory, "max_memory", 1)
        self.used = 0
        self._lock = RLock()  # reentrant, since the garbage collector may free memory while it is held
        self._process = os.getpid()
        self._queue: Queue | None = None

    @property
    def name(self) -> str:
        """The name that options take, such as "cuda:1"."""
        return f"{self.kind}:{self.ordinal}"

    def __str__(self) -> str:
        return f"{self.name} ({self.model})"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.ordinal, self.max_memory)

    # Life

    def is_alive(self) -> bool:
        """Whether this process may use the device: it is not a fork of the one that opened it."""
        return os.getpid() == self._process

    def check_alive(self) -> None:
        """Raise a DeviceError in a forked child."""
        check_process(self._process, str(self))

    # Memory

    @abstractmethod
    def free_memory(self) -> int:
        """Bytes that the driver could allocate now."""

    def room(self) -> int:
        """Bytes that may be allocated now: what is free, and what the budget leaves."""
        free = self.free_memory()
        return free if self.max_memory is None else max(min(free, self.max_memory - self.used), 0)

    def check_room(self, size: int, what: str) -> None:
        """Raise `OutOfDeviceMemory` if `size` bytes do not fit.

        what : what needs them, as the subject of the message
        """
        if size > (left := self.room()):
            raise self._too_large(size, left, what)

    def _too_large(self, size: int, left: int, what: str) -> OutOfDeviceMemory:
        needed = f"{what} needs {readable_size(size)} of memory on {self}"
        if self.max_memory is not None and self.used + size > self.max_memory:
            cure = f"raise max_memory, for example --max-memory {-(-(self.used + size) >> 20)}M"
            limit = f"max_memory ({readable_size(self.max_memory)}) leaves {readable_size(max(left, 0))}"
        else:
            cure = "close other programs that use it, or compute on the CPU"
            limit = f"{readable_size(left)} are free"
        return OutOfDeviceMemory(f"{needed}, but {limit}; {cure}", size, left)

    def allocate(self, size: int, what: str = "an array") -> DeviceMemory:
        """A block of uninitialised memory.

        what : what it is for, as the subject of the message if it does not fit

        Raises
        ------
        OutOfDeviceMemory
            If the budget or the device does not have `size` bytes left.
        """
        self.check_alive()
        with self._lock:  # two threads must not share what is left
            if self.max_memory is not None and self.used + size > self.max_memory:
                raise self._too_large(size, self.room(), what)
            address = self._allocate(max(size, 1))
            if address is None:
                raise self._too_large(size, self.room(), what)
            self.used += size
        return DeviceMemory(self, address, size)

    def upload(self, array: NDArray[Any], what: str = "an array", queue: Queue | None = None) -> DeviceMemory:
        """A new block that holds the bytes of an array."""
        memory = self.allocate(array.nbytes, what)
        memory.write(array, queue=queue)
        return memory

    def release(self, address: int, size: int) -> None:
        """Free a block; `DeviceMemory` calls it."""
        with self._lock:
            self.used -= size
            self._release(address)

    @abstractmethod
    def _allocate(self, size: int) -> int | None:
        """The address of a new block; None if the driver has too little memory."""

    @abstractmethod
    def _release(self, address: int) -> None: ...

    @abstractmethod
    def upload_bytes(self, address: int, source: NDArray[Any], queue: Queue | None, wait: bool) -> None:
        """Copy a C-contiguous array to an address of the device; see `DeviceMemory.write`."""

    @abstractmethod
    def download_bytes(self, address: int, into: NDArray[Any], queue: Queue | None, wait: bool) -> None:
        """Copy from an address of the device to a C-contiguous array; see `DeviceMemory.read`."""

    @abstractmethod
    def fill_bytes(self, address: int, byte: int, size: int, queue: Queue | None) -> None:
        """Set bytes from an address of the device on."""

    def host_array(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """An uninitialised array on the host that the device copies fastest from and to, for arrays used repeatedly.

        Only copies of such arrays overlap with the host's work (``wait=False``).
        """
        return np.empty(shape, dtype)

    # Kernels

    @property
    def queue(self) -> Queue:
        """The default queue."""
        self.check_alive()
        with self._lock:
            if self._queue is None:
                self._queue = self.new_queue()
            return self._queue

    @abstractmethod
    def new_queue(self) -> Queue:
        """Another queue, whose work may overlap with that of the default one."""

    def foreign_queue(self, handle: int) -> Queue:
        """The queue of another library's stream in this process, by its handle; only CUDA has them."""
        raise DeviceError(f"{self} has no streams of other libraries")

    def load(self, code: "DeviceCode") -> Module:
        """A kernel, compiled for the device by its driver; the second time it is found by its digest.

        Raises
        ------
        DeviceError
            If the driver does not take the code; its log is part of the message.
        """
        self.check_alive()
        if code.form != self.form:
            raise ValueError(f"{self} loads {self.form}, and {code.entry} is {code.form}")
        return self._load(code)

    @abstractmethod
    def _load(self, code: "DeviceCode") -> Module: ...

    def launch(
        self, module: Any, words: NDArray[np.int64], threads: int, block: int = BLOCK, queue: Queue | None = None
    ) -> None:
        """Run a kernel in a queue; return at once.

        module : from `load` of a device of the same card
        words : (module.words,) int64; addresses and numbers, as `kernels.marshalling` packs them
        threads : rounded up to whole blocks, so kernels compare their index with a count; 0: nothing runs
        """
        self.check_alive()
        words = np.ascontiguousarray(words, np.int64)
        if words.shape != (module.words,):
            raise ValueError(f"{module.entry} takes {module.words} words, not {words.shape}")
        if threads > 0:
            self._launch(module, words, -(-threads // block), block, queue or self.queue)

    @abstractmethod
    def _launch(self, module: Any, words: NDArray[np.int64], blocks: int, block: int, queue: Any) -> None: ...

    def synchronise(self) -> None:
        """Wait until all work in the default queue is done; Ctrl-C interrupts the waiting."""
        self.queue.synchronise()
