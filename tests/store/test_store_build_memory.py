"""A build stays within its memory."""

import subprocess
import sys

import pytest

pytest.importorskip("resource", reason="this system does not say how much memory a process has had: NOT checked")

SCRIPT = """
import sys
from antumbra.store.system_resources import peak_resident_memory
from antumbra.generate.generated_scene import StreamedCity
from antumbra.engine.store_building import build_store
from antumbra.store.store_build import MIN_MEMORY

triangles, path = int(sys.argv[1]), sys.argv[2]
build_store([StreamedCity(20_000)], path, chunk=1024)  # all is imported and compiled
before = peak_resident_memory()
made = build_store([StreamedCity(triangles)], path, max_memory=MIN_MEMORY)
print(made.triangles, made.bytes, peak_resident_memory() - before, peak_resident_memory(), MIN_MEMORY)
"""


def check_memory(tmp_path, triangles):
    command = [sys.executable, "-c", SCRIPT, str(triangles), str(tmp_path / "a.antumbra")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    n, size, grown, peak, allowed = map(int, done.stdout.split())
    assert 0.9 * triangles < n < 1.1 * triangles
    return size, grown, peak, allowed


def test_a_small_city(tmp_path):
    _, grown, _, allowed = check_memory(tmp_path, 1_000_000)
    assert grown <= allowed - (100 << 20)  # the rest is for Python, Numba and its kernels


@pytest.mark.slow
def test_a_city_larger_than_its_memory(tmp_path):
    size, grown, _, allowed = check_memory(tmp_path, 7_000_000)
    assert grown <= allowed - (100 << 20) < 300 << 20 < size
