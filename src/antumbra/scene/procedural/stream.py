"""The blocks of a city, made by several processes. They take groups of blocks in turn, and send each through a pipe.

Processes start by module name. Unlike fork or spawn, this does not disturb this process's threads or main module.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from itertools import cycle
from pathlib import Path

import numpy as np

from .city import GROUP, city_groups
from .shapes import PaletteMesh

_PACKAGE = Path(__file__).parents[3]


def streamed_blocks(triangles: int, seed: int, processes: int) -> Iterator[PaletteMesh]:
    """The blocks of `city_blocks`, made by `processes` processes. The arguments have been checked."""
    workers = [_started(triangles, seed, k, processes) for k in range(processes)]
    try:
        for worker in cycle(workers):
            blocks = 0
            while blocks < GROUP and (block := _received(worker.stdout)) is not None:
                yield block
                blocks += 1
            if blocks < GROUP:  # the last group
                break
        if worker.wait() != 0:
            raise RuntimeError("a process that makes blocks of the city has failed")
    finally:
        for worker in workers:
            worker.kill()
            worker.stdout.close()
            worker.wait()


def _started(triangles: int, seed: int, first: int, step: int) -> subprocess.Popen:
    """A process that makes every `step`-th group. Ctrl-C goes to its parent, which ends it."""
    paths = [str(_PACKAGE), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in paths if p), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", __name__, *map(str, (triangles, seed, first, step))]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=env, start_new_session=True)


def _received(pipe) -> PaletteMesh | None:
    """The next block, sent after its numbers of vertices and faces; None at the end."""
    sizes = np.zeros(2, np.int64)
    if pipe.readinto(sizes.view(np.uint8).data) == 0:
        return None
    v, f = sizes
    block = PaletteMesh(np.empty((v, 3), np.float32), np.empty((f, 3), np.int32), np.empty(f, np.uint8))
    for array in block:
        if pipe.readinto(array.reshape(-1).view(np.uint8).data) != array.nbytes:
            raise RuntimeError("a process that makes blocks of the city has ended too early")
    return block


def _send(pipe, triangles: int, seed: int, first: int, step: int) -> None:
    """In a process: write the blocks of its groups. A group is finished before it is sent."""
    for group in city_groups(triangles, seed, first, step):
        for block in list(group):
            sizes = np.array([len(block.vertices), len(block.faces)], np.int64)
            for array in (sizes, *block):
                pipe.write(np.ascontiguousarray(array).data)
    pipe.flush()


if __name__ == "__main__":
    with suppress(BrokenPipeError):  # the parent has gone
        _send(sys.stdout.buffer, *map(int, sys.argv[1:]))
