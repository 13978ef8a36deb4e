"""The host device: memory of this process, and PTX run on the processor. It is for tests, and never chosen by plans."""

import ctypes
import platform
from ctypes import c_int32, c_void_p
from threading import Lock
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...base.forks import hold_during_fork
from ...base.memory import available_memory
from ..device import Device, Event, Module, Queue
from .ptx_programs import PtxProgram
from .thread_meetings import MeetingThreads

if TYPE_CHECKING:
    from ...kernels.toolchain.device_code import DeviceCode

_ALIGNMENT = 128  # bytes
_FRESH = 0xCD
"""Every byte of new memory, so that kernels which read it before they write it are noticed."""
_BLOCKS_AT_A_TIME = 64  # between two chances for Ctrl-C

_lock = Lock()
hold_during_fork(_lock)
_programs: dict[bytes, PtxProgram] = {}  # by the text of PTX


class HostEvent(Event):
    """A moment: all work is done when it is given."""

    def __init__(self) -> None:
        self._time = perf_counter()

    def is_done(self) -> bool:
        return True

    def seconds_since(self, earlier: "HostEvent") -> float:
        return self._time - earlier._time


class HostQueue(Queue):
    """A queue in which nothing waits."""

    def record(self) -> HostEvent:
        return HostEvent()

    def wait(self, event: HostEvent) -> None:
        pass


class HostModule(Module):
    """A kernel in this processor's machine code."""

    def __init__(self, code: "DeviceCode", program: PtxProgram) -> None:
        super().__init__(code)
        self.program = program


class HostDevice(Device):
    """The processor in the place of a card; launches return when they are done.

    ordinal : 0
    max_memory : as in `Device`
    """

    kind, form = "host", "ptx"
    in_host_memory = True

    def __init__(self, ordinal: int = 0, max_memory: int | None = None) -> None:
        super().__init__(ordinal, platform.machine(), "PTX by LLVM", max_memory)
        self._arrays: dict[int, NDArray[np.uint8]] = {}  # by their addresses

    def free_memory(self) -> int:
        return available_memory() or 1 << 40

    def _allocate(self, size: int) -> int | None:
        try:
            array = np.full(size + _ALIGNMENT, _FRESH, np.uint8)
        except MemoryError:
            return None
        address = -(-array.ctypes.data // _ALIGNMENT) * _ALIGNMENT
        self._arrays[address] = array
        return address

    def _release(self, address: int) -> None:
        del self._arrays[address]

    def upload_bytes(self, address: int, source: NDArray[Any], queue: Queue | None, wait: bool) -> None:
        ctypes.memmove(address, source.ctypes.data, source.nbytes)

    def download_bytes(self, address: int, into: NDArray[Any], queue: Queue | None, wait: bool) -> None:
        ctypes.memmove(into.ctypes.data, address, into.nbytes)

    def fill_bytes(self, address: int, byte: int, size: int, queue: Queue | None) -> None:
        ctypes.memset(address, byte, size)

    def new_queue(self) -> HostQueue:
        return HostQueue()

    def _load(self, code: "DeviceCode") -> HostModule:
        with _lock:
            if code.code not in _programs:
                _programs[code.code] = PtxProgram(code.code)
            return HostModule(code, _programs[code.code])

    def _launch(self, module: HostModule, words: NDArray[np.int64], blocks: int, block: int, queue: Any) -> None:
        program = module.program
        memory = np.full(program.block_memory + _ALIGNMENT, _FRESH, np.uint8)
        memory = memory[-memory.ctypes.data % _ALIGNMENT :]
        if program.meetings:
            threads = MeetingThreads(program)
            for index in range(blocks):
                memory.fill(_FRESH)
                threads.run_block(words, memory, index, block, blocks)
            return
        run = program.function("run", c_void_p, c_void_p, *[c_int32] * 4)
        for first in range(0, blocks, _BLOCKS_AT_A_TIME):
            end = min(first + _BLOCKS_AT_A_TIME, blocks)
            run(words.ctypes.data, memory.ctypes.data, first, end, block, blocks)
            program.check_faults()
