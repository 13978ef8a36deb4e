"""The decorators of compiled functions."""

import pytest

from antumbra.kernels.jit import inlined, kernel


@inlined
def _half(x):
    """Half of it."""
    return 0.5 * x


@kernel
def _quarter(x):
    return _half(_half(x))


def test_kernels_call_what_is_inlined_and_python_does_not():
    assert _quarter(8.0) == 2.0
    with pytest.raises(TypeError, match=r"^_half is inlined; only kernels can call it$"):
        _half(8.0)
    assert _half.py_func(8.0) == 4.0 and _half.__doc__ == "Half of it."
