"""The memory of this process, as the system reports it."""

import subprocess
import sys

import numpy as np

from antumbra.kernels import array_pool
from antumbra.kernels.array_pool import ArrayPool, recycled_empty
from antumbra.store.system_resources import peak_resident_memory, release_freed

_PEAK = "from antumbra.store.system_resources import peak_resident_memory as peak; print(peak())"


def test_the_peak_of_a_process_is_not_that_of_its_parent():
    big = np.ones(1 << 27, np.uint8)  # more than a process that has only imported the module
    child = subprocess.run([sys.executable, "-c", _PEAK], capture_output=True, check=True, text=True)
    own = peak_resident_memory()
    assert own is None or int(child.stdout) < own - len(big) // 2


def test_memory_of_earlier_trees_does_not_count_against_a_store(monkeypatch):
    pool = ArrayPool(4, 1 << 20)
    monkeypatch.setattr(array_pool, "_recent", pool)
    kept = recycled_empty((1 << 18,), np.uint8)
    kept[...] = 7
    recycled_empty((1 << 18,), np.uint8)
    assert any(pool._free.values())
    release_freed()
    assert not any(pool._free.values()) and (kept == 7).all()
    del kept
    assert len(pool._free[1 << 18]) == 1
