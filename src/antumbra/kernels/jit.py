"""The decorators of compiled functions. Numba is imported only if something must be compiled.

- `kernel` marks a function that Python or other kernels call.
- `inlined` marks a function that LLVM must inline into its callers.
- `formula` marks an inlined function that Python may call too.
- `overload` gives a plain function its meaning inside kernels, by the types of its arguments.

A call from Python finds machine code by the kinds of its arguments (`marshalling`). It looks among the code that this
process has loaded, then in packs and in the user's cache (`toolchain.kernel_cache`). If there is none, Numba compiles
the kernel (`toolchain.compiling`).

The types of the fields of NamedTuples that kernels take (`F32Ptr`, `F32x16`, ...) are for readers. At run time each is
`Any`. A pointer is an address that `simd.ptr` makes of an array. ``F32x4`` and its like are the vectors of `simd`.
Numbers are ``int`` (int64), ``np.float32`` and so on.
"""

import functools
import importlib
import threading
import types
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

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


_lock = threading.RLock()


class Above(NamedTuple):
    """Functions of modules that import this one. `antumbra.kernels` sets them."""

    find: Callable | None  # `loading.find`: (kernel, key) -> function of packed words
    type_of_function: Callable | None  # `compiling.type_of_function`: inlined function -> Numba's type
    type_of_global: Callable | None  # `compiling.type_of_global`: value -> Numba's type


above = Above(None, None, None)  # `antumbra.kernels` replaces this when it is imported


class inlined:
    """Decorator of small functions on hot paths: LLVM inlines them always. Only kernels call them."""

    forced = True

    def __init__(self, function):
        self.py_func = function
        functools.update_wrapper(self, function)

    @property
    def name(self) -> str:
        return f"{self.py_func.__module__}:{self.py_func.__qualname__}"

    @property
    def _numba_type_(self):
        """Numba reads this attribute for the type of a global."""
        return above.type_of_function(self)

    def __call__(self, *arguments):
        raise TypeError(f"{self.__qualname__} is inlined; only kernels can call it")


class formula(inlined):
    """Decorator of inlined functions of plain arithmetic. Python may call them too, on numbers and on arrays."""

    def __call__(self, *arguments):
        return self.py_func(*arguments)


class kernel(inlined):
    """Decorator of compiled functions, which are kept on disk and run without the GIL.

    Division follows IEEE 754. There is no fast-math and no allocation.

    Arguments are C-contiguous or strided arrays of the machine's byte order, numbers, booleans, None, tuples and
    NamedTuples of them, and `arguments.Packed`. The result is a number, a boolean, None, or a tuple of them.

    Raises
    ------
    TypeError
        On an argument of another kind.
    RuntimeError
        If the kernel raises.
    """

    forced = False

    def __init__(self, function):
        super().__init__(function)
        self.found: dict[Key, Callable] = {}
        self._codes: dict[str, Callable] = {}  # by the text of a key, which is the same for a `Packed` and its value
        code = function.__code__
        self._names = code.co_varnames[: code.co_argcount]
        self._defaults = dict(zip(self._names[::-1], (function.__defaults__ or ())[::-1]))

    def __call__(self, *arguments, **by_name):
        if len(arguments) != len(self._names):
            arguments = self._completed(arguments, by_name)
        key, values = flatten(arguments)
        code = self.found.get(key) or self._find(key)
        return code(struct_of(key).pack(*values))

    def _completed(self, arguments, by_name):
        """All arguments, including those given by name or by default."""
        by_name_or_default = self._defaults | by_name
        try:
            remaining = tuple(by_name_or_default.pop(name) for name in self._names[len(arguments) :])
        except KeyError as error:
            raise TypeError(f"{self.__qualname__}() needs the argument {error}") from None
        if len(arguments) + len(remaining) != len(self._names) or by_name.keys() - self._names[len(arguments) :]:
            raise TypeError(f"{self.__qualname__}() takes the arguments {', '.join(self._names)}")
        return arguments + remaining

    def _find(self, key):
        with _lock:
            text = text_of(key)
            code = self._codes.get(text)
            if code is None:
                code = self._codes[text] = above.find(self, text)
            self.found[key] = code
        return code


class _Choices(NamedTuple):
    """The meanings of a plain function in kernels: functions that `overload` gave."""

    homes: tuple[str, ...]  # modules whose meanings are for any types
    given: list  # the meanings from these modules
    guests: list  # meanings from other modules, for their own NamedTuples


_CHOICES = "_antumbra_choices"


def overloaded(*modules: str):
    """Decorator of a plain function whose meanings in kernels are in other modules, named relative to its package.

    The modules are imported before the function is compiled or digested, so both steps always know the same meanings.
    """

    def add(stub):
        package = stub.__module__.rpartition(".")[0]
        setattr(stub, _CHOICES, _Choices(tuple(f"{package}.{module}" for module in modules), [], []))
        return stub

    return add


def overload(stub: types.FunctionType):
    """Decorator of a meaning of `stub` in kernels: a function of Numba's types that returns a function, or None.

    It does the same as ``numba.extending.overload``, without importing Numba. A module is a guest if it is neither the
    stub's own nor named by the stub's `overloaded`. A guest's meaning is for NamedTuples that the guest itself defines,
    and returns None for all other types. Only kernels that take such a tuple, or name its class, depend on the guest.
    """

    def add(function):
        choices = _choices(stub) or vars(stub).setdefault(_CHOICES, _Choices((stub.__module__,), [], []))
        at_home = function.__module__ in (stub.__module__, *choices.homes)
        (choices.given if at_home else choices.guests).append(function)
        return function

    return add


def _choices(stub) -> _Choices | None:
    return vars(stub).get(_CHOICES) if isinstance(stub, types.FunctionType) else None


def overloads(stub) -> list:
    """The meanings that the stub's module, and the modules that it names, gave by `overload`; else an empty list."""
    choices = _choices(stub)
    if choices is None:
        return []
    for module in choices.homes:
        importlib.import_module(module)
    return choices.given


def guest_overloads(stub) -> list:
    """The meanings that guests gave by `overload`."""
    choices = _choices(stub)
    return choices.guests if choices else []


class Intrinsic:
    """A placeholder for a name in a module that imports Numba, until a kernel that uses the name is compiled."""

    def __init__(self, module: str, name: str):
        self.module, self.name = module, name

    def __repr__(self):
        return f"{self.module}.{self.name}"

    @property
    def _numba_type_(self):
        return above.type_of_global(getattr(importlib.import_module(self.module), self.name))

    @property
    def __doc__(self):
        return getattr(importlib.import_module(self.module), self.name).__doc__
