"""Kernels give the same bits for any x86 processor, and use a single instruction where the processor has one."""

import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import vector_operations as ops
from antumbra.kernels.processor import X86, level, usable

pytestmark = pytest.mark.skipif(level() not in X86, reason=f"compares x86 processors, and this is {platform.machine()}")
LOWEST, AVX2 = "x86-64-v2", "x86-64-v3"
HERE = usable(level())
needs_avx2 = pytest.mark.skipif(AVX2 not in HERE, reason="this processor cannot run code for x86-64-v3")


def results_compiled_for(processor, folder):
    """The results of another process, with kernels compiled for a level of processors."""
    path = folder / f"{processor}.npz"
    env = dict(os.environ, ANTUMBRA_LEVEL=processor)
    script = Path(ops.__file__)
    done = subprocess.run([sys.executable, str(script), str(path)], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with np.load(path) as results:
        return dict(results)


@pytest.fixture(scope="module")
def baseline(tmp_path_factory):
    return results_compiled_for(LOWEST, tmp_path_factory.mktemp("baseline"))


@pytest.fixture(scope="module")
def haswell(tmp_path_factory):
    return results_compiled_for(AVX2, tmp_path_factory.mktemp("haswell"))


def assert_same_bits(one, other):
    """Check that results are equal, except for `fma`, unspecified results, and the bits of NaN."""
    names = one.keys() - {"assembly"}
    assert names == other.keys() - {"assembly"}
    a, b, _ = ops.f32_inputs()
    unspecified = np.isnan(a) | np.isnan(b) | ((a == 0) & (b == 0))
    for name in names:
        lanes_of, _, operation = name.partition(".")
        if operation == "fma":
            continue
        x, y = one[name], other[name]
        if lanes_of.startswith("f32") and operation in ("minimum", "maximum"):
            x, y = x[~unspecified], y[~unspecified]
        if x.dtype == np.float32:
            nan = np.isnan(x)
            assert np.array_equal(nan, np.isnan(y)), name
            x, y = x[~nan].view(np.int32), y[~nan].view(np.int32)
        assert x.size > 0 and np.array_equal(x, y), name


def test_baseline_computes_the_same(baseline):
    assert_same_bits(baseline, ops.compute_all())


@needs_avx2
def test_avx2_computes_the_same(baseline, haswell):
    assert_same_bits(baseline, haswell)


@needs_avx2
def test_fma_rounds_once_only_where_there_is_the_instruction(baseline, haswell):
    for lanes in ops.LANES:
        name, twice = f"f32x{lanes}.fma", ops.expect_f32(lanes)[0]["fma"]
        assert np.array_equal(baseline[name], twice)
        assert not np.array_equal(haswell[name], twice)


@needs_avx2
def test_one_instruction_each(baseline, haswell):
    assembly = str(haswell["assembly"])
    for instruction in ("vaddps", "vminps", "vblendvps"):
        assert len(re.findall(rf"\b{instruction}\b.*ymm", assembly)) == 1, instruction
    assert "ymm" not in str(baseline["assembly"])  # so they were compiled for different processors
