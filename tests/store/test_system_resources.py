"""The memory of this process, as the system reports it."""

import subprocess
import sys

import numpy as np

from antumbra.store.system_resources import peak_resident_memory

_PEAK = "from antumbra.store.system_resources import peak_resident_memory as peak; print(peak())"


def test_the_peak_of_a_process_is_not_that_of_its_parent():
    big = np.ones(1 << 27, np.uint8)  # more than a process that has only imported the module
    child = subprocess.run([sys.executable, "-c", _PEAK], capture_output=True, check=True, text=True)
    own = peak_resident_memory()
    assert own is None or int(child.stdout) < own - len(big) // 2
