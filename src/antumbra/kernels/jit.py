"""The decorators of compiled functions. Numba is imported only if something must be compiled.

- `kernel` marks a function called by Python or by other kernels.
- `inlined` marks a function that LLVM must inline into its callers.
- `formula` marks an inlined function that Python can call too.
- `overload` implements a plain function inside kernels, by the types of its arguments.

A call from Python selects machine code by the kinds of its arguments (`marshalling`): first among the code loaded into
this process, then in packs and the user's cache (`toolchain.kernel_cache`). If there is none, Numba compiles the kernel
(`toolchain.compiling`).

The field types of NamedTuples that kernels take (`F32Ptr`, `F32x16`, ...) are for readers; at run time each is `Any`. A
pointer is an address, made from an array by `simd.ptr`. ``F32x4`` etc. are the vectors of `simd`. Numbers are ``int``
(int64), ``np.float32`` and so on.
"""

import functools
import importlib
import threading
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeAlias, TypeVar

from ..base.forks import hold_during_fork
from .marshalling import Key, flatten, struct_of, text_of

# --- Types of the fields of kernel arguments --------------------------------------------------------------------------


BoolPtr: TypeAlias = Any
F32Ptr: TypeAlias = Any
F64Ptr: TypeAlias = Any
I8Ptr: TypeAlias = Any
I32Ptr: TypeAlias = Any
I64Ptr: TypeAlias = Any
U8Ptr: TypeAlias = Any
U64Ptr: TypeAlias = Any
F32x4: TypeAlias = Any
F32x8: TypeAlias = Any
F32x16: TypeAlias = Any
F32Lanes: TypeAlias = Any  # F32x8 or F32x16: the same functions take both
F32OrLanes: TypeAlias = Any  # np.float32 or F32x16: the same functions take both

# --- Decorators -------------------------------------------------------------------------------------------------------


_F = TypeVar("_F", bound=Callable[..., Any])

_lock = threading.RLock()
hold_during_fork(_lock)  # LLVM cannot go on with code that was being linked


class ToolchainHooks(NamedTuple):
    """Functions of the toolchain, which imports this module. Set by `antumbra.kernels`."""

    find: Callable[
        ["kernel", str], Callable[[bytes], Any]
    ]  # `kernel_cache.find`: (kernel, key) -> function of packed words
    type_of_function: Callable[["inlined"], Any]  # `compiling.type_of_function`: inlined function -> Numba's type
    type_of_global: Callable[[object], Any]  # `compiling.type_of_global`: value -> Numba's type


def _unset(*arguments: Any) -> Any:
    raise RuntimeError("import antumbra.kernels first")


hooks = ToolchainHooks(_unset, _unset, _unset)  # replaced when `antumbra.kernels` is imported


class inlined:
    """Decorator of small functions on hot paths, which LLVM always inlines. Only kernels can call them."""

    forced = True

    __qualname__: str

    def __init__(self, function: Callable[..., Any]) -> None:
        self.py_func: Any = function  # a function = function
        functools.update_wrapper(self, function)

    @property
    def name(self) -> str:
        return f"{self.py_func.__module__}:{self.py_func.__qualname__}"

    @property
    def _numba_type_(self) -> Any:
        """The type of this object as a global, read by Numba."""
        return hooks.type_of_function(self)

    def __call__(self, *arguments: Any) -> Any:
        raise TypeError(f"{self.__qualname__} is inlined; only kernels can call it")


class formula(inlined):
    """Decorator of inlined functions of plain arithmetic. Python can call them too, on numbers and arrays."""

    def __call__(self, *arguments: Any) -> Any:
        return self.py_func(*arguments)


class kernel(inlined):
    """Decorator of compiled functions, which are cached on disk and run without the GIL.

    Division follows IEEE 754. Fast-math and allocation are not available.

    Arguments are C-contiguous or strided arrays in native byte order, numbers, booleans, None, tuples and NamedTuples
    of these, and `marshalling.Packed`. The result is a number, a boolean, None, or a tuple of these.

    Raises
    ------
    TypeError
        If an argument is of another kind.
    RuntimeError
        If the kernel raises.
    """

    forced = False

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._functions: dict[Key, tuple[Callable[[bytes], Any], Callable[..., bytes]]] = {}  # and how to pack values
        self._codes: dict[
            str, Callable[[bytes], Any]
        ] = {}  # by the text of a key, which is the same for a `Packed` and its value
        code = function.__code__
        self._names = code.co_varnames[: code.co_argcount]
        self._defaults = dict(zip(self._names[::-1], (function.__defaults__ or ())[::-1]))

    def __call__(self, *arguments: Any, **by_name: Any) -> Any:
        if len(arguments) != len(self._names):
            arguments = self._completed(arguments, by_name)
        key, values = flatten(arguments)
        code, pack = self._functions.get(key) or self._find(key)
        return code(pack(*values))

    def of_words(self, key: Key, words: bytes) -> Any:
        """Call with arguments that are packed already, in microseconds less; `key`: the groups of each `Packed`."""
        code, _ = self._functions.get(key) or self._find(key)
        return code(words)

    def _completed(self, arguments: tuple[Any, ...], by_name: dict[str, Any]) -> tuple[Any, ...]:
        """All arguments, including those passed by name or by default."""
        values_by_name = self._defaults | by_name
        try:
            remaining = tuple(values_by_name.pop(name) for name in self._names[len(arguments) :])
        except KeyError as error:
            raise TypeError(f"{self.__qualname__}() needs the argument {error}") from None
        if len(arguments) + len(remaining) != len(self._names) or by_name.keys() - self._names[len(arguments) :]:
            raise TypeError(f"{self.__qualname__}() takes the arguments {', '.join(self._names)}")
        return arguments + remaining

    def _find(self, key: Key) -> tuple[Callable[[bytes], Any], Callable[..., bytes]]:
        with _lock:
            text = text_of(key)
            _called.add(self)
            for calls in _recordings:
                calls.add((self.name, text))
            code = self._codes.get(text)
            if code is None:
                code = self._codes[text] = hooks.find(self, text)
            found = self._functions[key] = code, struct_of(key).pack
        return found


_called: set[kernel] = set()  # kernels that Python has called
_recordings: list[set[tuple[str, str]]] = []  # of the blocks of `recorded_calls`


@contextmanager
def recorded_calls() -> Iterator[set[tuple[str, str]]]:
    """Record the kernels that Python calls in this block: (name, kinds of arguments)."""
    found = set[tuple[str, str]]()
    with _lock:
        for each in _called:
            each._functions.clear()  # so that the next call with each key passes `_find`
        _recordings.append(found)
    try:
        yield found
    finally:
        with _lock:
            _recordings[:] = [calls for calls in _recordings if calls is not found]


class _Choices(NamedTuple):
    """The implementations of a plain function in kernels, registered by `overload`."""

    homes: tuple[str, ...]  # modules whose implementations are for any types
    local: list[Callable[..., Any]]  # the implementations from these modules
    guests: list[Callable[..., Any]]  # implementations from other modules, for their own NamedTuples


_CHOICES = "_antumbra_choices"


def overloaded(*modules: str) -> Callable[[_F], _F]:
    """Decorator of a plain function with implementations in other modules, named relative to its package.

    The modules are imported before the function is compiled or digested, so both steps see the same implementations.
    """

    def add(stub: _F) -> _F:
        package = stub.__module__.rpartition(".")[0]
        setattr(stub, _CHOICES, _Choices(tuple(f"{package}.{module}" for module in modules), [], []))
        return stub

    return add


def overload(stub: Callable[..., Any]) -> Callable[[_F], _F]:
    """Decorator of an implementation of `stub` in kernels: a function of Numba's types that returns a function or None.

    It does the same as ``numba.extending.overload`` without importing Numba. A module is a guest if it is neither the
    stub's own nor named by the stub's `overloaded`. A guest's implementation is for NamedTuples that the guest itself
    defines, and must return None for all other types. Only kernels that take such a tuple, or name its class, depend on
    the guest.
    """

    def add(function: _F) -> _F:
        choices = _choices(stub) or vars(stub).setdefault(_CHOICES, _Choices((stub.__module__,), [], []))
        at_home = function.__module__ in (stub.__module__, *choices.homes)
        (choices.local if at_home else choices.guests).append(function)
        return function

    return add


def _choices(stub: object) -> _Choices | None:
    return vars(stub).get(_CHOICES) if isinstance(stub, types.FunctionType) else None


def overloads(stub: object) -> list[Callable[..., Any]]:
    """The implementations of a stub from its own module and from the modules that `overloaded` names; else none."""
    choices = _choices(stub)
    if choices is None:
        return []
    for module in choices.homes:
        importlib.import_module(module)
    return choices.local


def guest_overloads(stub: object) -> list[Callable[..., Any]]:
    """The implementations of a stub from guest modules."""
    choices = _choices(stub)
    return choices.guests if choices else []


class Intrinsic:
    """A placeholder for a name in a module that imports Numba, resolved when a kernel that uses it is compiled."""

    def __init__(self, module: str, name: str) -> None:
        self.module, self.name = module, name

    def __repr__(self) -> str:
        return f"{self.module}.{self.name}"

    @property
    def _numba_type_(self) -> Any:
        return hooks.type_of_global(getattr(importlib.import_module(self.module), self.name))

    @property
    def __doc__(self) -> Any:  # type: ignore[override]
        return getattr(importlib.import_module(self.module), self.name).__doc__
