"""Argument checks for the public API: each function returns the value in one form, or raises an `InputError`."""

import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import InputError
from .wording import counted

T = TypeVar("T")

_LONGEST = 60  # maximum characters of a value in a message
_NO_NUMBERS = str, bytes, bytearray, bool, np.bool_, complex, np.complexfloating, np.datetime64, np.timedelta64
_ENDS = {"()": "lie between {} and {}", "[)": "be at least {} and below {}", "[]": "be a number from {} to {}"}
"""Intervals in the words of messages."""


def spelling_hint(name: object, known: Iterable[str]) -> str:
    """``"did you mean 'x'? "`` if a known name is similar to `name`, else an empty string; for unknown-name errors."""
    text, names = str(name), list(known)
    matches = get_close_matches(text, names, 1, 0.6) or [each for each in names if each.lower() == text.lower()][:1]
    return f"did you mean {matches[0]!r}? " if matches else ""


def quoted(value: object) -> str:
    """The repr of a wrong value for a message, on one line and truncated."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # of another library's object, or of an integer with thousands of digits
        text = f"a {type(value).__name__}"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


# --- Numbers ----------------------------------------------------------------------------------------------------------


def is_number(value: object) -> bool:
    """Whether a value may be a single real number. Strings, booleans and arrays with axes are not."""
    return not isinstance(value, _NO_NUMBERS) and getattr(value, "ndim", 0) == 0


def whole_number(value: Any, what: str, low: int, high: int) -> int:
    """Convert `value` to an int; InputError naming `what` unless it is a whole number in [`low`, `high`]."""
    if type(value) is int and low <= value <= high:
        return value
    if is_number(value):
        with suppress(TypeError, ValueError, ArithmeticError):
            integer = int(value)
            if integer == value and low <= integer <= high:
                return integer
    raise InputError(f"{what} is {quoted(value)}; it must be a whole number from {low} to {high}")


def number(value: Any, what: str, low: float = -np.inf, high: float = np.inf, ends: str = "()") -> float:
    """Convert `value` to a float; InputError naming `what` unless it lies between `low` and `high`.

    ends : whether the limits are allowed, in interval notation: ``"()"``, ``"(]"``, ``"[)"`` or ``"[]"``
    """
    x = float("nan")
    if is_number(value):
        with suppress(TypeError, ValueError, OverflowError):
            x = float(value)
    if low < x < high or (x == low and ends[0] == "[") or (x == high and ends[1] == "]"):
        return x
    if np.isinf(high):
        requirement = "be a number" if ends[1] == "]" else "be a finite number"
        requirement += "" if np.isinf(low) else f" {'above' if ends[0] == '(' else 'of at least'} {low:g}"
    else:
        requirement = _ENDS[ends].format(f"{low:g}", f"{high:g}")
    raise InputError(f"{what} is {quoted(value)}; it must {requirement}")


def byte_count(value: Any, what: str, low: int, high: int = 1 << 60) -> int:
    """`whole_number` for a number of bytes, with a message in units such as ``100M``, like the command line."""
    with suppress(InputError):
        return whole_number(value, what, low, high)
    shown_value = _in_units(int(value)) if isinstance(value, int) and 0 <= value < 1 << 70 else quoted(value)
    raise InputError(
        f"{what} is {shown_value}; it must be a number of bytes from {_in_units(low)} to {_in_units(high)}"
    )


def _in_units(n: int) -> str:
    for unit, size in (("T", 1 << 40), ("G", 1 << 30), ("M", 1 << 20), ("k", 1 << 10)):
        if n >= size:
            return f"{n / size:,.0f}{unit}" if n >= 1000 * size else f"{n / size:.4g}{unit}"
    return str(n)


# --- Strings and objects ----------------------------------------------------------------------------------------------


def flag(value: Any, what: str) -> bool:
    """`value` as a bool; InputError naming `what` unless it is True or False."""
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    raise InputError(f"{what} is {quoted(value)}; it must be True or False")


def choice(value: Any, what: str, names: Iterable[str | None]) -> Any:
    """`value` if it is one of `names`; otherwise an InputError that names `what` and all of them."""
    known = list(names)
    if type(value) is str and value in known:
        return value
    if any(value is None if name is None else isinstance(value, str) and value == name for name in known):
        return value
    words = ["None" if name is None else f'"{name}"' for name in known]
    hint = spelling_hint(value, filter(None, known)) if isinstance(value, str) else ""
    raise InputError(f"{what} is {quoted(value)}; {hint}it must be {alternatives(words)}")


def alternatives(words: Sequence[str]) -> str:
    """Words as text: a, b or c."""
    return " or ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def text(value: Any, what: str) -> str:
    """`value` if it is a str; otherwise an InputError that names `what`."""
    if isinstance(value, str):
        return value
    raise InputError(f"{what} is {quoted(value)}; it must be a string")


def checked_instance(value: object, kind: type[T], what: str, cure: str = "") -> T:
    """`value` if it is an instance of `kind`; otherwise an InputError that names `what`, the kind and the cure."""
    if isinstance(value, kind):
        return value
    name = f"an antumbra.{kind.__name__}" if kind.__module__.startswith("antumbra.") else f"a {kind.__name__}"
    raise InputError(f"{what} must be {name}, not {type(value).__name__}{f'; {cure}' if cure else ''}")


def items(value: Any, kind: type[T], what: str, cure: str = "") -> list[T]:
    """A list of instances of `kind`, from one or several; otherwise an InputError as from `checked_instance`."""
    if isinstance(value, kind):
        return [value]
    parts = parts_of(value)
    if parts is None:
        return [checked_instance(value, kind, what, cure)]
    return [checked_instance(each, kind, what, cure) for each in parts]


def parts_of(value: Any) -> list[Any] | None:
    """The items of an iterable as a list; None for strings and for values that are not iterable."""
    if isinstance(value, (str, bytes)):
        return None
    try:
        return list(value)
    except TypeError:
        return None


def path_of(value: Any, what: str) -> Path:
    """`value` as a `Path`; InputError naming `what` unless it is a string or a path that the system accepts."""
    try:
        name = os.fspath(value)
    except TypeError:
        name = None
    if not isinstance(name, str):
        raise InputError(f"{what} is {quoted(value)}; it must be a string or a path")
    if not name or "\0" in name:
        raise InputError(f"{what} is {quoted(name)}; name a file or a folder")
    return Path(name)


# --- Arrays -----------------------------------------------------------------------------------------------------------


def as_array(value: Any, what: str, *, strided: bool = False) -> NDArray[Any]:
    """Numbers in the form that kernels take, from an array of any layout, type and library in host memory.

    The array is C-contiguous, in the byte order of this machine, and float32, float64 or an integer: float16 becomes
    float32, while long double and Python numbers in object arrays become float64. It is `value` itself, or a view of
    it, where nothing has to change.

    Arrays are converted by their ``numpy()``, or else through DLPack, which takes Open3D a second for a million rays.

    strided : True: the layout may stay as it is, such as that of a broadcast array

    Raises
    ------
    InputError
        If `value` is not numbers (bool is not), or has masked ones.
    """
    is_usual = type(value) is np.ndarray and (value.dtype is _F64 or value.dtype is _F32)
    array = value if is_usual else _native_array(value, what)
    return array if strided or array.flags.c_contiguous else np.asarray(array, order="C")


def _native_array(value: Any, what: str) -> NDArray[Any]:
    """`as_array` in any layout."""
    array = value if type(value) is np.ndarray else _plain_array(value, what)
    dtype = array.dtype
    if dtype.kind not in "fiu":
        return _numbers_of(array, value, what)
    if not dtype.isnative or (dtype.kind == "f" and dtype.itemsize not in (4, 8)):
        with np.errstate(over="ignore"):  # of long doubles, which become infinite
            return array.astype(_NATIVE.get((dtype.kind, dtype.itemsize), dtype.newbyteorder("=")))
    return array


_F32, _F64 = np.dtype(np.float32), np.dtype(np.float64)  # in the byte order of this machine
_NATIVE: dict[tuple[str, int], np.dtype[Any]] = {
    ("f", size): np.dtype(np.float32 if size < 8 else np.float64) for size in (2, 4, 8, 10, 12, 16)
}
"""(kind, bytes) -> the type in which kernels take numbers."""


def _plain_array(value: Any, what: str) -> NDArray[Any]:
    """A value as an array of NumPy itself; an array of None if it is none."""
    mask = getattr(value, "mask", None) if isinstance(value, np.ndarray) else None  # of numpy.ma, slow to import
    if mask is not None and (count := int(np.count_nonzero(mask))):
        raise InputError(
            f"{what} have {counted(count, 'masked number')}; leave these rows out, or fill them: array.filled(0.0)"
        )
    if not isinstance(value, np.ndarray):
        value = _of_library(value, what)
    try:
        return np.asarray(value)
    except (TypeError, ValueError, OverflowError):
        return np.asarray(None)


def _numbers_of(array: NDArray[Any], value: Any, what: str) -> NDArray[np.float64]:
    """(...) float64 from an object array of real numbers; InputError for anything else."""
    if array.dtype == object and array.ndim and all(map(is_number, array.flat)):
        with suppress(TypeError, ValueError, OverflowError):
            return np.array([float(each) for each in array.flat]).reshape(array.shape)
    if hasattr(value, "__cuda_array_interface__"):
        raise InputError(
            f"{what}: the array is on a card, from which this plan or scene takes none; copy it to the host"
        )
    kind = f"{array.dtype}" if isinstance(value, np.ndarray) else quoted(value)
    raise InputError(f"{what} must be numbers (float32 or float64), not {kind}")


def _of_library(value: Any, what: str) -> Any:
    if hasattr(value, "numpy") and not isinstance(value, type):
        with suppress(Exception):  # e.g. torch tensors on another device, for which DLPack has the better message
            return value.numpy()
    if not hasattr(value, "__dlpack__"):
        return value
    try:
        return np.from_dlpack(value)
    except (BufferError, RuntimeError, TypeError) as error:
        raise InputError(f"{what} cannot be read through DLPack ({error}); copy it to host memory first") from None


def rows_of(value: Any, what: str, length: int, ndim: int | None = None) -> NDArray[Any]:
    """`value` as numbers (..., `length`), with `ndim` axes if given; otherwise an InputError that names `what`."""
    array = as_array(value, what)
    if array.shape[-1:] != (length,) or ndim not in (None, array.ndim):
        shape = f"({'...' if ndim is None else 'n'}, {length})"
        raise InputError(f"{what} must be numbers {shape}, not {array.dtype} {array.shape}")
    return array


def vector(value: Any, what: str) -> NDArray[np.float64]:
    """Convert `value` to (3,) float64; InputError naming `what` unless it is three finite numbers."""
    try:
        v = as_array(value, what).astype(np.float64)
    except InputError:
        raise InputError(f"{what} must be three numbers, not {quoted(value)}") from None
    if v.shape != (3,) or not np.isfinite(v).all():
        raise InputError(f"{what} must be three finite numbers, not {quoted(value)}")
    return v


def points(value: Any, what: str, first: int = 0) -> NDArray[np.float64]:
    """Convert `value` to (m, 3) float64; InputError naming `what` unless all numbers are finite.

    first : number of the first row, for the message
    """
    array = as_array(value, what).astype(np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{what} must have shape (m, 3), not {array.shape}")
    finite = np.isfinite(array)
    if not finite.all():
        raise InputError(f"{what} hold NaN or infinity (row {first + np.argmin(finite.all(1))})")
    return array


def unit_vectors(vectors: NDArray[Any], what: str, cure: str = "", first: int = 0) -> NDArray[np.float64]:
    """(..., 3) float64: finite vectors normalised, even those whose squared length overflows or underflows.

    first : number of the first one, for the message

    Raises
    ------
    InputError
        If a vector is zero, NaN or infinite. The message names its index, and the cure.
    """
    v = np.asarray(vectors, np.float64)
    largest = np.abs(v).max(-1, keepdims=True)
    good = np.isfinite(largest[..., 0]) & (largest[..., 0] > 0.0)
    if not good.all():
        at = np.argmin(good.reshape(-1))
        problem = "is zero" if np.isfinite(largest.reshape(-1)[at]) else "has NaN or infinity"
        where = "" if v.ndim == 1 else f" {first + at}"
        raise InputError(f"{what}{where} {problem}; {cure or 'give it a direction'}")
    v = np.ldexp(v, -np.frexp(largest)[1])  # by a power of two, which does not change the result
    unit: NDArray[np.float64] = v / np.linalg.norm(v, axis=-1, keepdims=True)
    return unit


def listed(value: Any, what: str, count: int) -> list[Any]:
    """The items of a value of `count` items, such as a pair; otherwise an InputError that names `what`."""
    parts = parts_of(value)
    if parts is None or len(parts) != count:
        raise InputError(f"{what} is {quoted(value)}; it must be {counted(count, 'value')}")
    return parts
