"""Threads that meet: each runs until it gets to a shuffle, a vote or a barrier, and goes on once all have got there.

On a card, a kernel in which some thread misses a meeting hangs, or goes on with garbage. Here it is an error.
"""

from ctypes import c_int32, c_int64, c_void_p

import numpy as np
from numpy.typing import NDArray

from ..device import DeviceError
from .ptx_programs import THREAD_STATE, PtxProgram

WARP = 32
"""Lanes of a warp."""


class MeetingThreads:
    """Runs the blocks of a kernel whose threads meet.

    Threads that wait for nothing go on in an order that changes from one meeting to the next, so that a kernel that
    lacks a barrier is likely to get another result.
    """

    def __init__(self, program: PtxProgram) -> None:
        self._program = program
        self._start = program.function("start", *[c_void_p] * 3, *[c_int32] * 4)
        self._resume = program.function("resume", c_void_p, c_void_p, c_int64)
        self._destroy = program.function("destroy", c_void_p)

    def run_block(
        self, words: NDArray[np.int64], memory: NDArray[np.uint8], index: int, size: int, blocks: int
    ) -> None:
        """Run one block of `size` threads.

        words : the kernel's arguments
        memory : of the block
        index : of the block, among `blocks`

        Raises
        ------
        DeviceError
            If a thread misses a meeting.
        """
        states, order = np.zeros(size, THREAD_STATE), np.random.default_rng(index)
        try:
            for thread in order.permutation(size).tolist():
                self._start(words.ctypes.data, memory.ctypes.data, states.ctypes.data, thread, index, size, blocks)
            self._program.check_faults()
            while states["place"].any():
                ready = order.permutation(self._met(states))
                self._resume(states.ctypes.data, ready.ctypes.data, len(ready))
                self._program.check_faults()
        finally:
            for handle in states["handle"][states["place"] > 0].tolist():
                self._destroy(handle)

    def _met(self, states: NDArray[np.void]) -> NDArray[np.int64]:
        """The threads that have met, with their results stored."""
        places, threads = states["place"], np.arange(len(states))
        met = []
        for first in range(0, len(states), WARP):
            warp = slice(first, first + WARP)
            place = places[first]
            if place and (places[warp] == place).all() and not self._program.meetings[place - 1].of_block:
                self._exchange(self._program.meetings[place - 1].what, states[warp])
                met.append(threads[warp])
        if met:
            return np.concatenate(met)
        if (places == places[0]).all():  # a barrier
            return threads
        raise DeviceError(self._missed(places))

    @staticmethod
    def _exchange(what: str, warp: NDArray[np.void]) -> None:
        """Store the results of a shuffle or a vote of a warp's lanes."""
        words = warp["words"]
        if what == "shuffle":
            sources = words[:, 1] % WARP
            lanes = np.where(sources < len(warp), sources, np.arange(len(warp)))  # of a lane that is not there: its own
            warp["result"] = words[lanes, 0]
        else:
            bits = (words[:, 0] != 0).astype(np.uint32) << np.arange(len(warp), dtype=np.uint32)
            warp["result"] = np.bitwise_or.reduce(bits).astype(np.uint32).view(np.int32)

    def _missed(self, places: NDArray[np.int32]) -> str:
        """The message about threads of a block that wait for others which do not come."""
        parts = []
        for place in np.unique(places).tolist():
            threads = np.flatnonzero(places == place)
            where = f"wait at {self._program.meetings[place - 1].line}" if place else "have ended"
            parts.append(f"{len(threads)} threads, such as {threads[0]}, {where}")
        return f"{self._program.entry}: threads of a block do not meet: {'; '.join(parts)}"
