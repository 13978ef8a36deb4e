"""The decorators of compiled functions."""

import numpy as np
import pytest

from antumbra.kernels.jit import formula, inlined, kernel, recorded_calls
from antumbra.kernels.toolchain import compiling


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


def test_calls_are_recorded_even_of_kernels_called_before():
    _quarter(8.0)
    with recorded_calls() as first:
        assert _quarter(4.0) == 1.0 and _quarter(np.float32(4.0)) == 1.0
    _quarter(2)
    assert {name for name, _ in first} == {_quarter.name} and len(first) == 2
    with recorded_calls() as second:
        pass
    assert second == set()


# --- formulas and errors -------------------------------------------------------------------------------------------


@formula
def twice(x):
    return 2 * x


@inlined
def _positive(x):
    if x < 0:
        raise ValueError("negative")
    return x


@kernel
def _checked(x):
    return _positive(x) + 1


@kernel
def _checked_twice(x):
    return twice(_checked(x))


@kernel
def _only_twice(x):
    return twice(twice(x))


def test_python_and_kernels_call_formulas():
    assert twice(3) == 6 and _only_twice(3) == 12
    assert twice(np.arange(3)).tolist() == [0, 2, 4]


def test_an_error_reaches_python_through_callers():
    assert _checked_twice(3) == 8
    with pytest.raises(RuntimeError):
        _checked_twice(-3)
    assert _checked_twice(3) == 8


def test_calls_of_functions_that_never_raise_test_for_no_error():
    """Nothing but a call can fail here, so the code has a branch only where a callee may raise."""
    blocks = {}
    for function in (_only_twice, _checked_twice):
        module = compiling.lower_kernel(function, "i", "code")[0]
        name = function.__name__
        blocks[name] = [len(list(f.blocks)) for f in module.functions if name in f.name and not f.is_declaration]
    assert blocks["_only_twice"] == [1] and blocks["_checked_twice"][0] > 1
