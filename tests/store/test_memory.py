"""A build stays within its memory, and released chunks leave the memory."""

import subprocess
import sys
from pathlib import Path

import pytest

from bvh_scenes import terrain
from stores import built, soup_scene

pytest.importorskip("resource", reason="this system does not say how much memory a process has had: NOT checked")

SCRIPT = """
import sys
from antumbra.store.resident import peak_resident
from antumbra.scene.generated import StreamedCity
from antumbra.rendering.building import build_store
from antumbra.store.build import LEAST_MEMORY

triangles, path = int(sys.argv[1]), sys.argv[2]
build_store([StreamedCity(20_000)], path, chunk=1024)  # all is imported and compiled
before = peak_resident()
made = build_store([StreamedCity(triangles)], path, max_memory=LEAST_MEMORY)
print(made.triangles, made.bytes, peak_resident() - before, peak_resident(), LEAST_MEMORY)
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


def mapped_resident() -> int:
    """Bytes of mapped files that this process has in memory."""
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(lines["RssFile"].split()[0]) * 1024


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux tells files from other memory")
def test_chunks_that_are_released_leave_memory(tmp_path):
    store = built(tmp_path, soup_scene(terrain(150_000)), chunk=16_384)
    size = int(store.chunks.bytes.sum())
    assert size > 10 << 20
    before = mapped_resident()
    for k in range(len(store)):
        store.check(k)
    held = mapped_resident()
    for k in range(len(store)):
        store.release(k)
    assert held - before > 0.9 * size and mapped_resident() - before < 0.1 * size
