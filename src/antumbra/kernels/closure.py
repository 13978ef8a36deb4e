"""The digest of a kernel: of its code, and of all functions and constants that it reaches.

A *part* is a function that Numba compiles or calls: a kernel, an inlined function, or an overload and its callees. The
digest of a part covers its bytecode, its defaults, and the values of the globals and closure variables that it names.
It covers no line numbers, comments or docstrings. The digest of a kernel covers all parts that it reaches, and the
fields of its arguments' classes.

Numba compiles bytecode. So the digest changes when Numba's input changes, and only then. It depends on Python's
version, and on no path or time. A value of an unknown kind is an error, because its changes would go unnoticed.
"""

import dis
import sys
import types
from collections.abc import Iterable, Iterator
from functools import cache
from hashlib import blake2b
from typing import NamedTuple

import numpy as np

from . import definitions
from .arguments import class_of
from .jit import Intrinsic, guest_overloads, inlined, overloads

_FOREIGN = "numba", "numpy", "math", "builtins", "operator", "functools", "llvmlite", "typing", "itertools"
_PLAIN = int, float, complex, str, bytes, bool, type(None), type(...), np.generic, np.dtype, range, slice
_LOAD_GLOBAL, _EXTENDED = dis.opmap["LOAD_GLOBAL"], dis.opmap["EXTENDED_ARG"]
_PYTHON = f"{sys.implementation.name} {sys.version_info[0]}.{sys.version_info[1]}"


class _Part:
    """One function's share of a digest.

    text : the bytes to digest
    reached : the functions that the function names
    homes : the modules of the NamedTuples that it names
    """

    def __init__(self, function: types.FunctionType):
        self.text: list[bytes] = [f"{function.__module__}:{function.__qualname__}".encode()]
        self.reached: list[types.FunctionType] = []
        self.homes: set[str] = set()
        self._globals: set[str] = set()
        self._attributes: set[str] = set()
        self._code(function.__code__, function.__doc__)
        self._value("defaults", (function.__defaults__, function.__kwdefaults__))
        cells = dict(zip(function.__code__.co_freevars, function.__closure__ or ()))
        for name in sorted(self._globals | cells.keys()):
            if name in cells:
                self._value(name, cells[name].cell_contents)
            elif name in function.__globals__:
                self._value(name, function.__globals__[name])

    def _add(self, *things: object) -> None:
        self.text.append(repr(things).encode())

    def _code(self, code: types.CodeType, doc: str | None) -> None:
        self._add(code.co_code, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        self._add(code.co_argcount, code.co_kwonlyargcount, code.co_flags, code.co_exceptiontable)
        self._globals |= _globals_of(code)
        self._attributes.update(code.co_names)
        for i, constant in enumerate(code.co_consts):
            if isinstance(constant, types.CodeType):
                self._code(constant, None)
            elif not (i == 0 and doc is not None and isinstance(constant, str)):
                self._value("constant", constant)

    def _value(self, name: str, value: object) -> None:
        if isinstance(value, inlined):
            self._add(name, "part", value.forced)
            self.reached.append(value.py_func)
        elif isinstance(value, Intrinsic):
            self._add(name, definitions.digest(value.module, value.name))
        elif isinstance(value, types.FunctionType | types.BuiltinFunctionType | np.ufunc):
            self._function(name, value)
        elif isinstance(value, types.ModuleType):
            self._module(name, value)
        elif isinstance(value, np.ndarray):
            self._add(name, value.dtype.str, value.shape, value.strides, value.tobytes())
        elif isinstance(value, tuple | list):
            self._add(name, _name_of(type(value)), getattr(value, "_fields", None), len(value))
            for item in value:
                self._value(name, item)
        elif isinstance(value, frozenset):
            self._add(name, sorted(map(repr, value)))
        elif isinstance(value, type):
            self._class(name, value)
        elif isinstance(value, _PLAIN):
            self._add(name, _name_of(type(value)), value)
        elif type(value).__module__.partition(".")[0] in ("numba", "llvmlite", "typing"):
            self._numba(name, value)
        else:
            raise TypeError(f"kernels cannot name {name}, a {_name_of(type(value))}: changes of it would go unnoticed")

    def _function(self, name, value) -> None:
        module = getattr(value, "__module__", None) or "numpy"
        self._add(name, "function", module, getattr(value, "__qualname__", value.__name__))
        if isinstance(value, types.FunctionType) and module.partition(".")[0] not in _FOREIGN:
            self.reached += [value, *overloads(value)]

    def _numba(self, name: str, value: object) -> None:
        """Add an object of Numba. An intrinsic or a function that Numba compiles counts by its Python function."""
        function = getattr(value, "py_func", getattr(value, "_defn", None))
        self._add(name, _name_of(type(value)), "" if function else str(value))
        self.reached += [function] if isinstance(function, types.FunctionType) else []

    def _module(self, name: str, value: types.ModuleType) -> None:
        """Add a module: its name, and the attributes that the function may name. Foreign modules count by name."""
        self._add(name, "module", value.__name__)
        if value.__name__.partition(".")[0] not in _FOREIGN:
            for attribute in sorted(self._attributes & vars(value).keys()):
                self._value(attribute, vars(value)[attribute])

    def _class(self, name: str, value: type) -> None:
        self._add(name, "class", *class_text(value))
        self.homes.add(value.__module__)
        if value.__module__.partition(".")[0] not in _FOREIGN and not hasattr(value, "_fields"):
            raise TypeError(f"kernels cannot name the class {_name_of(value)}: only NamedTuples")


def _globals_of(code: types.CodeType) -> set[str]:
    """The globals that a code object names. Attributes may have the same names, and do not count."""
    found, more = set(), 0
    for operation, argument in zip(code.co_code[::2], code.co_code[1::2]):
        argument |= more
        more = argument << 8 if operation == _EXTENDED else 0
        if operation == _LOAD_GLOBAL:
            found.add(code.co_names[argument >> 1])  # the lowest bit is a flag for calls
    return found


def _name_of(cls: type) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def class_text(cls: type) -> tuple:
    """A class as kernels see it: its name, and a NamedTuple's fields and defaults."""
    return _name_of(cls), getattr(cls, "_fields", None), repr(getattr(cls, "_field_defaults", None))


class _Known(NamedTuple):
    """The result of a `_Part`, cached."""

    digest: bytes
    reached: list[types.FunctionType]
    homes: set[str]


_parts: dict[types.FunctionType, _Known] = {}


def _part(function: types.FunctionType) -> _Known:
    found = _parts.get(function)
    if found is None:
        made = _Part(function)
        digest = blake2b(digest_size=16)
        for text in made.text:
            digest.update(len(text).to_bytes(4, "little") + text)
        found = _parts[function] = _Known(digest.digest(), made.reached, made.homes)
    return found


def reached(function: types.FunctionType, homes: Iterable[str] = ()) -> list[types.FunctionType]:
    """All functions that a function reaches, itself included.

    homes : modules of the argument classes; the guest overloads of these modules count
    """
    seen, todo, homes, stubs = {function}, [function], set(homes), []
    while todo:
        known = _part(todo.pop())
        stubs += [callee for callee in known.reached if guest_overloads(callee)]
        homes |= known.homes
        guests = [guest for stub in stubs for guest in guest_overloads(stub) if guest.__module__ in homes]
        new = dict.fromkeys(callee for callee in (*known.reached, *guests) if callee not in seen)
        seen.update(new)
        todo += new
    return list(seen)


@cache
def _closure(function: types.FunctionType, homes: frozenset[str]) -> bytes:
    return b"".join(sorted(_part(f).digest for f in reached(function, homes)))


def kernel_digest(kernel: inlined, key: str) -> str:
    """The name of a kernel's machine code for the argument kinds of `key`: 32 digits, the same for all processors."""
    digest = blake2b(f"{_PYTHON}\n{kernel.name}\n{key}\n".encode(), digest_size=16)
    for cls in _classes_of(key.split()):
        digest.update(repr(class_text(cls)).encode())
    digest.update(definitions.module_digest("antumbra.kernels.arguments").encode())
    digest.update(_closure(kernel.py_func, homes_of(key)))
    return digest.hexdigest()


def homes_of(key: str) -> frozenset[str]:
    """The modules that define the classes of a kernel's arguments."""
    return frozenset(cls.__module__ for cls in _classes_of(key.split()))


def _classes_of(tokens: Iterable[str]) -> Iterator[type]:
    for token in tokens:
        if token.endswith("(") and token != "(":
            yield class_of(token[:-1])
