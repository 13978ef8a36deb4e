"""The names, the example in the docstring, and the disk cache."""

import inspect
import os
import subprocess
import sys
import textwrap

from antumbra.kernels import simd
from antumbra.kernels.jit import Intrinsic

WIDE = "load broadcast splat iota mask_from_bits"
ONCE = """store minimum maximum fma absolute flip_sign select bits any_lane all_lanes reduce_min reduce_max reduce_and
    extract store_compressed swap_halves shuffle permute join square_root to_f32 to_f64 to_i32 f32_bits
    ptr ptr_at load8x3_pair load16x3
    as_i32 as_f32 splat1 gather f32_at f64_at i32_at get put stack_array stack_f32 stack_f64 stack_i32 stack_i64
    prefetch popcount lowest_bit highest_bit product_error widen_loops atomic_add atomic_and atomic_or"""


def test_public_names():
    expected = {f"{name}{lanes}" for name in WIDE.split() for lanes in (4, 8, 16)} | set(ONCE.split())
    assert set(simd.__all__) == expected and len(simd.__all__) == len(expected)
    assert {n for n, v in vars(simd).items() if isinstance(v, Intrinsic)} == expected


def test_docstring_explains_every_name():
    names = {*ONCE.split(), *(f"{name}4" for name in WIDE.split())}
    assert not [name for name in names if f"`{name}`" not in simd.__doc__]


def _example():
    """The block of code in the docstring."""
    lines = inspect.getdoc(simd).split("::", 1)[1].splitlines()
    block = []
    for line in lines:
        if line and not line.startswith(" "):
            break
        block.append(line)
    return textwrap.dedent("\n".join(block))


CHECK = """
assert inside == ((points.astype(np.float64) ** 2).sum(0) <= 1).sum() and 100 < inside < 800
from antumbra.kernels.toolchain.kernel_loading import events
print(*(event.source for event in events))
"""

VECTOR_ARGUMENTS = """
import numpy as np
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import load8, select, stack_f32, store

@kernel
def limit(v, mask):
    scratch = stack_f32(8)
    store(scratch, 0, select(mask, v, 2))
    return load8(scratch, 0)

@kernel
def compute(a):
    store(a, 0, limit(load8(a, 0), load8(a, 0) < 2))

a = np.arange(8, dtype=np.float32)
compute(a)
assert a.tolist() == [0, 1, 2, 2, 2, 2, 2, 2]
from antumbra.kernels.toolchain.kernel_loading import events
print(*(event.source for event in events))
"""


def _run_twice(source, folder):
    """The output of a program in a first and in a second process that share a disk cache."""
    path = folder / "program.py"
    path.write_text(source)
    env = dict(os.environ, ANTUMBRA_CACHE=str(folder / "cache"))
    runs = [subprocess.run([sys.executable, path], env=env, capture_output=True, text=True) for _ in range(2)]
    assert not any(run.returncode for run in runs), [run.stderr for run in runs]
    return [run.stdout.strip() for run in runs]


def test_docstring_example_runs_and_is_cached(tmp_path):
    assert _run_twice(_example() + CHECK, tmp_path) == ["compiled", "cache"]


def test_kernels_that_pass_vectors_are_cached(tmp_path):
    assert _run_twice(VECTOR_ARGUMENTS, tmp_path) == ["compiled", "cache"]
