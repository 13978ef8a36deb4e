"""Numba's internals that the toolchain patches while it compiles: each must still be there, and take what it took."""

import inspect

import pytest

from antumbra.kernels.toolchain.numba_frontend import PATCHES, numba_patches


@pytest.mark.parametrize("owner, name, value", PATCHES, ids=[name for _, name, _ in PATCHES])
def test_a_patch_still_applies(owner, name, value):
    before = getattr(owner, name)  # an AttributeError means that this version of Numba needs another patch
    if inspect.isfunction(before) and inspect.isfunction(value):
        assert len(inspect.signature(before).parameters) == len(inspect.signature(value).parameters)
    with numba_patches():
        assert getattr(owner, name) is value
    assert getattr(owner, name) is before
