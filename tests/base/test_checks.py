import decimal
from fractions import Fraction

import numpy as np
import pytest

from antumbra import InputError
from antumbra.base import checks


@pytest.mark.parametrize("value", [3, 3.0, np.int8(3), np.float32(3), Fraction(3), decimal.Decimal(3), np.array(3)])
def test_numbers_of_any_type(value):
    assert checks.whole_number(value, "n", 1, 3) == 3 and type(checks.whole_number(value, "n", 1, 3)) is int
    assert checks.number(value, "x", 2.0, 4.0) == 3.0 and type(checks.number(value, "x", 2.0, 4.0)) is float


@pytest.mark.parametrize(
    "ends, taken, says",
    [
        ("()", [False, True, False], "it must lie between 0 and 1"),
        ("[)", [True, True, False], "it must be at least 0 and below 1"),
        ("[]", [True, True, True], "it must be a number from 0 to 1"),
    ],
)
def test_ends_of_intervals(ends, taken, says):
    for x, fits in zip((0.0, 0.5, 1.0), taken):
        if fits:
            assert checks.number(x, "x", 0.0, 1.0, ends) == x
        else:
            with pytest.raises(InputError, match=says):
                checks.number(x, "x", 0.0, 1.0, ends)


def test_bytes_are_told_as_they_are_written():
    assert checks.byte_count(4 << 30, "max_memory", 1 << 20) == 4 << 30
    with pytest.raises(InputError, match=r"^max_memory is 100M; it must be a number of bytes from 384M to 1,048,576T$"):
        checks.byte_count(100 << 20, "max_memory", 384 << 20)


def test_long_values_are_cut():
    for value in ("x" * 10_000, 10**6000, np.zeros(10_000), list(range(10_000))):
        assert len(checks.quoted(value)) <= 60 and checks.quoted(value).isprintable()


def test_unit_vectors_have_the_bits_of_a_plain_division():
    v = np.random.default_rng(0).normal(size=(1000, 3)) * 10.0 ** np.arange(-30, 30).repeat(50)[:1000, None]
    assert (checks.unit_vectors(v, "v") == v / np.linalg.norm(v, axis=-1, keepdims=True)).all()
    for bad, says in (
        ([0, 0, 0], "v 1 is zero"),
        ([0, np.nan, 1], "v 1 has NaN"),
        ([np.inf, 0, 0], "v 1 has NaN or inf"),
    ):
        with pytest.raises(InputError, match=says):
            checks.unit_vectors(np.array([[1.0, 0, 0], bad]), "v")


class Tensor:
    """An array of another library. Open3D's takes a microsecond for each number through DLPack."""

    def __init__(self, array, numpy=True):
        self.array = array
        if numpy:
            self.numpy = lambda: array

    def __dlpack__(self, **options):
        assert not hasattr(self, "numpy"), "the slow way"
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


def test_arrays_of_libraries_are_views():
    array = np.arange(12.0).reshape(4, 3)
    for tensor in (Tensor(array), Tensor(array, numpy=False)):
        assert np.shares_memory(checks.as_array(tensor, "points"), array)
        assert (checks.points(tensor, "points") == array).all()


def test_tensors_of_open3d():
    core = pytest.importorskip("open3d.core", exc_type=ImportError)
    array = np.random.default_rng(0).uniform(-1, 1, (50, 3)).astype(np.float32)
    tensor = core.Tensor(array)
    found = checks.as_array(tensor, "points")
    assert np.shares_memory(found, tensor.numpy()) and (found == array).all()
