"""The decorators of compiled functions. Numba is imported only if something must be compiled.

`kernel` marks a function that Python or other kernels call, `inlined` one that LLVM must inline into its callers, and
`overload` gives a plain function its meaning inside kernels, by the types of its arguments.

A call from Python finds machine code by the kinds of its arguments (`arguments.py`), in what this process has loaded,
then in packs and the user's cache (`loading.py`); else Numba compiles it (`compiling.py`).
"""

import functools
import importlib
import threading
import types
from collections.abc import Callable
from typing import NamedTuple

from .arguments import Key, flatten, struct_of

_lock = threading.RLock()


class Above(NamedTuple):
    """What stands above this module and has answers for it; `antumbra.kernels` names it."""

    find: Callable | None  # (kernel, key) -> function of packed words: `loading.find`
    type_of_function: Callable | None  # of an inlined function -> Numba's type: `compiling.type_of_function`
    type_of_global: Callable | None  # of a value -> Numba's type: `compiling.type_of_global`


above = Above(None, None, None)  # until `antumbra.kernels` says so, which is imported before


class inlined:
    """Decorator of small functions on hot paths: LLVM must inline them, whatever it thinks. Only kernels call them."""

    forced = True

    def __init__(self, function):
        self.py_func = function
        functools.update_wrapper(self, function)

    @property
    def name(self) -> str:
        return f"{self.py_func.__module__}:{self.py_func.__qualname__}"

    @property
    def _numba_type_(self):
        """Numba asks for the type of a global by this name."""
        return above.type_of_function(self)

    def __call__(self, *arguments):
        raise TypeError(f"{self.__qualname__} is inlined; only kernels can call it")


class kernel(inlined):
    """Decorator of compiled functions: kept on disk, free of the GIL, IEEE division, no fast-math, no allocation.

    Arguments are C-contiguous or strided arrays of the machine's byte order, numbers, booleans, None, and tuples and
    NamedTuples of them. The result is a number, a boolean, None, or a tuple of them.

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
        """The arguments with those that are given by name or by default."""
        given = self._defaults | by_name
        try:
            rest = tuple(given.pop(name) for name in self._names[len(arguments) :])
        except KeyError as error:
            raise TypeError(f"{self.__qualname__}() needs the argument {error}") from None
        if len(arguments) + len(rest) != len(self._names) or by_name.keys() - self._names[len(arguments) :]:
            raise TypeError(f"{self.__qualname__}() takes the arguments {', '.join(self._names)}")
        return arguments + rest

    def _find(self, key):
        with _lock:
            code = self.found.get(key)
            if code is None:
                code = self.found[key] = above.find(self, " ".join(key))
        return code


class _Choices(NamedTuple):
    """What a plain function means in kernels."""

    homes: tuple[str, ...]  # modules that give it meanings for any types
    given: list  # those meanings
    guests: list  # meanings that other modules give it for their own NamedTuples


_CHOICES = "_antumbra_choices"


def overloaded(*modules: str):
    """Decorator of a plain function that other modules, named relative to its package, give its meaning in kernels.

    They are imported before the function is compiled or a key is made, so that both know the same meanings always.
    """

    def add(stub):
        package = stub.__module__.rpartition(".")[0]
        setattr(stub, _CHOICES, _Choices(tuple(f"{package}.{module}" for module in modules), [], []))
        return stub

    return add


def overload(stub: types.FunctionType):
    """Decorator of what `stub` means in kernels: a function of Numba's types that returns a function, or None.

    The same as ``numba.extending.overload``, without importing Numba. A module that is neither the stub's nor named by
    its `overloaded` is a guest: its meaning is for NamedTuples that it defines itself, and returns None for all others.
    A kernel that takes such a tuple, or names its class, depends on the guest; no other kernel does.
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
    """The functions that the stub's module, and those that it names, gave by `overload`; none of other things."""
    choices = _choices(stub)
    if choices is None:
        return []
    for module in choices.homes:
        importlib.import_module(module)
    return choices.given


def guest_overloads(stub) -> list:
    """The functions that guests gave by `overload`."""
    choices = _choices(stub)
    return choices.guests if choices else []


class Intrinsic:
    """Stands for what a module that imports Numba defines, until a kernel that uses it is compiled."""

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
