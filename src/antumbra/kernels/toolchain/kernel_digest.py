"""Kernel digests, over a kernel's code and all functions and constants that it reaches.

A *part* is a function that Numba compiles or calls: a kernel, an inlined function, or an overload and its callees. The
digest of a part covers its bytecode, its defaults, and the values of the globals and closure variables that it names,
but not line numbers, comments or docstrings. The digest of a kernel covers all parts that it reaches, and the fields of
its arguments' classes.

Since Numba compiles bytecode, the digest changes exactly when Numba's input changes. It depends on Python's version,
but not on paths or times. A value of an unknown kind is an error, because its changes would go unnoticed.

Definitions in source. Modules that import Numba are not imported to compute a digest; their definitions are read from
source. The digest of a name covers the statements that define it and, recursively, the definitions of all names in
these statements, in any module of the package. Whatever a decorator registers for a class, such as the code of an
iterator, is part of the class. Comments and docstrings are ignored.
"""

import ast
import dis
import sys
import types
from collections.abc import Iterable, Iterator
from functools import cache
from hashlib import blake2b
from importlib.util import find_spec, resolve_name
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..jit import Intrinsic, guest_overloads, inlined, overloads
from ..marshalling import class_of

# --- Definitions read from source -------------------------------------------------------------------------------------


SIMD = "antumbra.kernels.simd"
_IMPLIED = (f"{SIMD}.vectors",)
"""Modules that register ``a + b`` etc. for vectors with Numba. Kernels depend on them without naming them."""


class _Module:
    """The top-level statements of a module, by the names they define."""

    def __init__(self, name: str) -> None:
        tree = ast.parse(_source(name))
        self.statements: dict[str, list[ast.stmt]] = {}
        self.imported: dict[str, tuple[str, str]] = {}  # name here: (module, name there)
        code = (
            node for node in tree.body if not isinstance(node, ast.Import | ast.ImportFrom) and not _is_docstring(node)
        )
        self.all = [_without_docstrings(node) for node in code]
        for node in tree.body:
            if isinstance(node, ast.ImportFrom) and node.level:
                module = resolve_name("." * node.level + (node.module or ""), name.rpartition(".")[0])
                self.imported |= {alias.asname or alias.name: (module, alias.name) for alias in node.names}
        for node in self.all:
            for defined in _defined_names(node):
                self.statements.setdefault(defined, []).append(node)


def _source(name: str) -> str:
    module = sys.modules.get(name)
    spec = module.__spec__ if module else find_spec(name)
    if spec is None or spec.origin is None:
        raise ImportError(f"the source of {name} is missing")
    return Path(spec.origin).read_text(encoding="utf-8")


def _is_docstring(node: ast.stmt) -> bool:
    """Whether a statement is a docstring, of the module or of the constant above it."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _without_docstrings(node: ast.stmt) -> ast.stmt:
    inner: Any
    for inner in ast.walk(node):
        body = getattr(inner, "body", None)
        if isinstance(body, list):
            inner.body = [s for s in body if not _is_docstring(s)]
    return node


def _defined_names(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        calls = (call for call in node.decorator_list if isinstance(call, ast.Call))
        return [node.name, *(arg.id for call in calls for arg in call.args if isinstance(arg, ast.Name))]
    return [n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]


_module = cache(_Module)


def _collect_definitions(module: str, name: str, definitions: dict[tuple[str, str], str]) -> None:
    """Add to `definitions` the statements that define a name, and the definitions of all names in them."""
    if (module, name) in definitions:
        return
    defining = _module(module)
    if name in defining.imported:
        _collect_definitions(*defining.imported[name], definitions)
        return
    definitions[module, name], names = _definition(module, name)
    for inner in names:
        _collect_definitions(module, inner, definitions)


@cache
def _definition(module: str, name: str) -> tuple[str, list[str]]:
    """The statements that define a name, as text, and the names in them that the module defines or imports."""
    defining = _module(module)
    statements = defining.statements.get(name, [])
    names = {inner.id: None for node in statements for inner in ast.walk(node) if isinstance(inner, ast.Name)}
    known = [inner for inner in names if inner in defining.statements or inner in defining.imported]
    return "\n".join(ast.dump(node) for node in statements), known


@cache
def definition_digest(module: str, name: str) -> str:
    """Digest of a name's definition in a module."""
    definitions: dict[tuple[str, str], str] = {}
    _collect_definitions(module, name, definitions)
    text = repr([module, name, *sorted(definitions.items())]) + "".join(map(module_digest, _IMPLIED))
    return blake2b(text.encode(), digest_size=16).hexdigest()


@cache
def module_digest(module: str) -> str:
    """Digest of all statements of a module."""
    text = "\n".join(ast.dump(node) for node in _module(module).all)
    return blake2b(text.encode(), digest_size=16).hexdigest()


# --- Digests of kernels -----------------------------------------------------------------------------------------------


_FOREIGN = "numba", "numpy", "math", "builtins", "operator", "functools", "llvmlite", "typing", "itertools"
_PLAIN = int, float, complex, str, bytes, bool, type(None), type(...), np.generic, np.dtype, range, slice
_LOAD_GLOBAL, _EXTENDED = dis.opmap["LOAD_GLOBAL"], dis.opmap["EXTENDED_ARG"]
_PYTHON = f"{sys.implementation.name} {sys.version_info[0]}.{sys.version_info[1]}"


class _DigestPart:
    """One function's contribution to a digest.

    text : the bytes to digest
    reached : the functions that the function names
    homes : the modules of the NamedTuples that it names
    """

    def __init__(self, function: types.FunctionType) -> None:
        self.text: list[bytes] = [f"{function.__module__}:{function.__qualname__}".encode()]
        self.reached: list[Any] = []  # functions
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
            self._add(name, definition_digest(value.module, value.name))
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

    def _function(self, name: str, value: Any) -> None:
        module = getattr(value, "__module__", None) or "numpy"
        self._add(name, "function", module, getattr(value, "__qualname__", value.__name__))
        if isinstance(value, types.FunctionType) and module.partition(".")[0] not in _FOREIGN:
            self.reached += [value, *overloads(value)]

    def _numba(self, name: str, value: object) -> None:
        """Add an object of Numba. Intrinsics and compiled functions are represented by their Python functions."""
        function = getattr(value, "py_func", getattr(value, "_defn", None))
        self._add(name, _name_of(type(value)), "" if function else str(value))
        self.reached += [function] if isinstance(function, types.FunctionType) else []

    def _module(self, name: str, value: types.ModuleType) -> None:
        """Add a module: its name and the attributes that the function may name; of foreign modules, only the name."""
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
    """The globals that a code object names. Attributes of the same names are not counted."""
    names, extension = set(), 0
    for operation, argument in zip(code.co_code[::2], code.co_code[1::2]):
        argument |= extension
        extension = argument << 8 if operation == _EXTENDED else 0
        if operation == _LOAD_GLOBAL:
            names.add(code.co_names[argument >> 1])  # the lowest bit is a flag for calls
    return names


def _name_of(cls: type) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def class_text(cls: type) -> tuple[str, object, str]:
    """A class as kernels see it: its name, and the fields and defaults of a NamedTuple."""
    return _name_of(cls), getattr(cls, "_fields", None), repr(getattr(cls, "_field_defaults", None))


class _PartDigest(NamedTuple):
    """The cached digest of a `_DigestPart`."""

    digest: bytes
    reached: list[types.FunctionType]
    homes: set[str]


_parts: dict[types.FunctionType, _PartDigest] = {}


def _part(function: types.FunctionType) -> _PartDigest:
    cached = _parts.get(function)
    if cached is None:
        part = _DigestPart(function)
        digest = blake2b(digest_size=16)
        for text in part.text:
            digest.update(len(text).to_bytes(4, "little") + text)
        cached = _parts[function] = _PartDigest(digest.digest(), part.reached, part.homes)
    return cached


def reachable_functions(function: types.FunctionType, homes: Iterable[str] = ()) -> list[types.FunctionType]:
    """All functions that a function reaches, including itself.

    homes : modules of the argument classes, whose guest overloads are included
    """
    functions, todo, homes, stubs = {function}, [function], set(homes), []
    while todo:
        known = _part(todo.pop())
        stubs += [callee for callee in known.reached if guest_overloads(callee)]
        homes |= known.homes
        guests = [guest for stub in stubs for guest in guest_overloads(stub) if guest.__module__ in homes]
        new: dict[Any, None] = dict.fromkeys(callee for callee in (*known.reached, *guests) if callee not in functions)
        functions.update(new)
        todo += new
    return list(functions)


@cache
def _closure_digest(function: types.FunctionType, homes: frozenset[str]) -> bytes:
    return b"".join(sorted(_part(f).digest for f in reachable_functions(function, homes)))


def kernel_digest(kernel: inlined, key: str) -> str:
    """The key of a kernel's machine code for the argument kinds of `key`: 32 digits, identical for all processors."""
    digest = blake2b(f"{_PYTHON}\n{kernel.name}\n{key}\n".encode(), digest_size=16)
    for cls in _classes_of(key.split()):
        digest.update(repr(class_text(cls)).encode())
    digest.update(module_digest("antumbra.kernels.marshalling").encode())
    digest.update(_closure_digest(kernel.py_func, homes_of(key)))
    return digest.hexdigest()


def homes_of(key: str) -> frozenset[str]:
    """The modules that define the classes of a kernel's arguments."""
    return frozenset(cls.__module__ for cls in _classes_of(key.split()))


def _classes_of(tokens: Iterable[str]) -> Iterator[type]:
    for token in tokens:
        if token.endswith("(") and token != "(":
            yield class_of(token[:-1])
