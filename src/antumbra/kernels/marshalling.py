"""Marshalling: arguments and results of kernels as 8-byte words.

A *key* lists the kinds of the arguments: one token for each scalar, array, None, and start or end of a tuple. The key
selects the machine code and the packing of the values.

A value that many calls take, such as a tree, can be flattened once to a `Packed`, which kernels accept in its place.
Calls take microseconds, so keys are hashed and compared quickly: all tokens of a `Packed` are one string.
"""

import ctypes
import struct
import sys
from collections.abc import Callable, Iterator
from functools import cache, reduce
from importlib import import_module
from typing import Any

import numpy as np

Key = tuple[str, ...]
"""Tokens. Those of a `Packed` are one string in braces."""


@cache
def _group_of(key: Key) -> str:
    """The tokens of a key as one. Equal groups are one object, so that comparing them takes no time."""
    return f"{{{text_of(key)}}}"


SCALARS = {
    "b": "?7x", "f": "f4x", "d": "d",
    "i1": "q", "i2": "q", "i4": "q", "i": "q", "u1": "Q", "u2": "Q", "u4": "Q", "u": "Q",
}  # fmt: skip
"""The format by which `struct` packs a scalar into a word, for each token."""

_TOKENS: dict[type, str] = {
    bool: "b", np.bool_: "b", int: "i", float: "d",
    np.int8: "i1", np.int16: "i2", np.int32: "i4", np.int64: "i",
    np.uint8: "u1", np.uint16: "u2", np.uint32: "u4", np.uint64: "u",
    np.float32: "f", np.float64: "d",
}  # fmt: skip
NONE, END = "n", ")"
_FOREIGN = ">" if sys.byteorder == "little" else "<"


_classes: dict[str, type] = {}


@cache
def _opening(cls: type) -> str:
    """The token that starts a tuple of a class, or of the one whose place it takes (`base.fetched_fields`)."""
    cls = getattr(cls, "_plain", cls)
    if cls is tuple:
        return "("
    name = f"{cls.__module__}:{cls.__qualname__}"
    _classes[name] = cls
    return f"{name}("


def class_of(name: str) -> type:
    """The class named ``module:qualname``."""
    return _classes.get(name) or import_object(name)


def import_object(name: str) -> Any:
    """The object named ``module:qualname``."""
    module, _, qualname = name.partition(":")
    return reduce(getattr, qualname.split("."), import_module(module))


def _array_token(array: np.ndarray) -> str:
    dtype, flags = array.dtype, array.flags
    if dtype.kind not in "biuf" or dtype.str[0] == _FOREIGN:
        raise TypeError(f"a kernel cannot take arrays of {dtype}")
    if not flags.aligned:
        raise TypeError("a kernel cannot take arrays whose elements are not aligned")
    layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
    return f"{'A' if flags.writeable else 'R'}[{dtype.str[1:]},{array.ndim},{layout}]"


_array_tokens: dict[tuple[np.dtype[Any], int, int], str] = {}  # by everything that `_array_token` reads


def _address_in_header(array: np.ndarray) -> int:
    """The address of an array's first element, from the first field of NumPy's ABI; eight times as fast as by NumPy."""
    return _word_at(id(array) + _HEADER).value


def _address_by_numpy(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])


_word_at, _HEADER = ctypes.c_size_t.from_address, object.__basicsize__
_probe = np.zeros(3)[1:]
address_of = _address_in_header if _address_in_header(_probe) == _address_by_numpy(_probe) else _address_by_numpy
"""The address of an array's first element."""


def is_array(token: str) -> bool:
    """Whether a token is of an array."""
    return token[1:2] == "["


def array_parts(token: str) -> tuple[str, int, str, bool]:
    """(dtype, number of dimensions, layout, writeable) of an array's token."""
    dtype, ndim, layout = token[2:-1].split(",")
    return dtype, int(ndim), layout, token[0] == "A"


def flatten(arguments: tuple[Any, ...]) -> tuple[Key, list[Any]]:
    """The key of arguments, and their flat values. Those of an array are its address, shape and strides."""
    key: list[str] = []
    values: list[Any] = []
    for argument in arguments:
        if type(argument) is Packed:
            key.append(argument.group)
            values.append(argument.words)
        else:
            _flatten(argument, key, values)
    return tuple(key), values


def _flatten(x: Any, key: list[str], values: list[Any]) -> None:
    kind: Any = type(x)
    if kind is Packed:
        key.append(x.group)
        values.append(x.words)
    elif kind is np.ndarray:
        what = x.dtype, x.ndim, x.flags.num
        token = _array_tokens.get(what)
        if token is None:
            token = _array_tokens[what] = _array_token(x)
        key.append(token)
        values.append(address_of(x))
        values += x.shape
        values += x.strides
    elif kind in _TOKENS:
        key.append(_TOKENS[kind])
        values.append(x)
    elif isinstance(x, tuple):
        key.append(_opening(kind))
        for item in x:
            _flatten(item, key, values)
        key.append(END)
    elif x is None:
        key.append(NONE)
    else:
        raise TypeError(f"a kernel cannot take {kind.__module__}.{kind.__qualname__}")


class ArgumentForm:
    """The packing of values of known kinds.

    example : a value of these kinds: a scalar, an array, or a tuple of them
    """

    __slots__ = ("_group", "_pack")

    def __init__(self, example: object) -> None:
        key, _ = flatten((example,))
        self._group, self._pack = _group_of(key), struct_of(key).pack

    def pack(self, *values: Any) -> "Packed":
        """A `Packed` of flat values; those of an array are its address, shape and strides. Arrays must outlive it."""
        return Packed(self._group, self._pack(*values))

    def of_words(self, words: bytes, owners: object) -> "Packed":
        """A `Packed` of values that are packed already; owners: the arrays, which it keeps alive."""
        return Packed(self._group, words, owners)


class Packed:
    """A kernel argument that is already flattened.

    group : its tokens, as one
    words : its packed values
    value : the original value, or its arrays, if they must be kept alive
    """

    __slots__ = ("group", "value", "words")

    def __init__(self, group: str, words: bytes, value: object = None) -> None:
        self.group, self.words, self.value = group, words, value


def packed(value: object) -> Packed:
    """A value, flattened. It keeps the value's arrays alive, which kernels read and write as usual."""
    key, values = flatten((value,))
    return Packed(_group_of(key), struct_of(key).pack(*values), value)


def text_of(key: Key) -> str:
    """All tokens of a key as text, which is the same for a `Packed` and for its value."""
    return " ".join(key).translate(_WITHOUT_BRACES)


_WITHOUT_BRACES = str.maketrans("", "", "{}")


def argument_count(text: str) -> int:
    """The number of arguments in the text of a key; tuples count once."""
    depth = count = 0
    for token in text.split():
        count += depth == 0
        depth += token.endswith("(") - (token == ")")
    return count


@cache
def struct_of(key: Key) -> struct.Struct:
    """The packing of a key's values."""
    return struct.Struct("<" + "".join(map(_packing, key)))


def _packing(token: str) -> str:
    if token[0] == "{":
        return f"{struct_of(tuple(token[1:-1].split())).size}s"
    if is_array(token):
        return "Q" + "qq" * array_parts(token)[1]
    return SCALARS.get(token, "")


Spec = str | list[Any]
"""The kind of a result: a scalar's token, `NONE`, or [class name (None for a plain tuple), specs of the items]."""


class ResultReader:
    """Builds a kernel's result from the words that it wrote."""

    def __init__(self, spec: Spec) -> None:
        self._struct = struct.Struct("<" + "".join(_forms(spec)))
        self._build = _builder(spec)
        self.size = max(self._struct.size, 8)

    def __call__(self, memory: "ctypes.Array[ctypes.c_char]") -> object:
        return self._build(iter(self._struct.unpack_from(memory)))


def _forms(spec: Spec) -> Iterator[str]:
    if isinstance(spec, str):
        yield SCALARS.get(spec, "")
    else:
        for item in spec[1]:
            yield from _forms(item)


def _builder(spec: Spec) -> Callable[[Iterator[Any]], Any]:
    if isinstance(spec, str):
        return (lambda words: None) if spec == NONE else next
    parts = [_builder(item) for item in spec[1]]
    if spec[0] is None:
        return lambda words: tuple(part(words) for part in parts)
    cls = class_of(spec[0])
    return lambda words: cls(*(part(words) for part in parts))
