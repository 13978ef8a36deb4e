"""Many calls: a server that answers for weeks must not grow."""

import gc
import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from stores import built

RNG = np.random.default_rng(0)
POINTS, DIRECTIONS = RNG.uniform((-6, 0.1, -4), (6, 5, 4), (64, 3)), RNG.normal(size=(64, 3))
LAMP = at.PointLight((0, 3, 0))
QUERIES = {
    "occluded": lambda scene, k: scene.occluded(POINTS[k % 64], DIRECTIONS[k % 64]),
    "two threads": lambda scene, k: scene.occluded(POINTS, DIRECTIONS, threads=1 + k % 2),
    "closest_hit": lambda scene, k: scene.closest_hit(POINTS[k % 64], DIRECTIONS[k % 64]).position,
    "visibility": lambda scene, k: at.visibility(scene, POINTS[k % 64], LAMP),
    "refused": lambda scene, k: _refused(scene),
}

_ROUNDS = 4


def _refused(scene):
    with pytest.raises(at.InputError):
        scene.occluded(POINTS[0], [0.0, 0.0, 0.0])


def growths(scene, query, calls: int) -> list[int]:
    """Bytes of Python and NumPy that remain after some calls, and after as many more, and so on."""
    sizes = []
    tracemalloc.start()
    try:
        for _ in range(_ROUNDS + 1):
            for k in range(calls):
                query(scene, k)
            gc.collect()
            sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    return np.diff(sizes).tolist()


@pytest.mark.parametrize("query", QUERIES)
def test_calls_leave_nothing(query):
    """Caches may fill in some rounds, but a leak grows in each."""
    scene = at.procedural("atrium", triangles=1000)
    assert min(growths(scene, QUERIES[query], 300)) < 300 * 8  # less than a reference per call


def test_calls_of_a_store_leave_nothing(tmp_path):
    scene = at.load(built(tmp_path, at.procedural("atrium", triangles=1000)).path)
    assert min(growths(scene, QUERIES["occluded"], 100)) < 100 * 96  # NumPy refills its caches; an array has 112 bytes


def test_a_leak_would_be_seen():
    kept = []
    assert min(growths(None, lambda scene, k: kept.append(bytes(64)), 300)) > 300 * 64


MANY = """
import gc, os, sys
from pathlib import Path
import antumbra as at
from test_engine_memory import QUERIES

def resident():
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

scene, query = at.procedural("atrium", triangles=1000), QUERIES[sys.argv[1]]
for k in range(40_000):  # until the tree is optimised for what it is asked
    query(scene, k)
before = resident()
for k in range(100_000):
    query(scene, k)
print(resident() - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="resident memory is read from /proc")
@pytest.mark.parametrize("query", QUERIES)
def test_a_hundred_thousand_calls_leave_nothing(query):
    """In the process as a whole: memory of LLVM and of threads counts too."""
    folders = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "support"), *sys.path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, folders))}
    done = subprocess.run([sys.executable, "-c", MANY, query], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 4 << 20  # 42 bytes per call
