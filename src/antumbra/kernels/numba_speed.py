"""Numba's front end, faster while kernels are compiled.

Numba types and lowers in Python. For kernels of many small functions, most of that time answers repeated questions. The
changes here alter no answer of Numba. All of them are undone afterwards, so other uses of Numba do not change. A change
that does not fit the installed version is left out.
"""

import gc
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

from numba.core import event, ir
from numba.core.types import functions


@contextmanager
def faster() -> Iterator[None]:
    """Within the context, Numba compiles faster. Call it under Numba's compiler lock."""
    with ExitStack() as changes:
        changes.enter_context(_without_collection())
        for owner, name, value in _CHANGES:
            with suppress(AttributeError):
                changes.enter_context(_changed(owner, name, value))
        yield


@contextmanager
def _changed(owner, name: str, value) -> Iterator[None]:
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


@contextmanager
def _without_collection() -> Iterator[None]:
    """Turn off garbage collection, which takes a seventh of all time: Numba makes many long-lived objects."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


_remembered: dict = {}
_resolve = functions.BaseFunction.get_call_type


def _remembered_call_type(self, context, args, kws):
    """The result type of a builtin function, asked once for each list of argument types."""
    if kws:
        return _resolve(self, context, args, kws)
    question = (id(self), len(self.templates), tuple(args))
    known = _remembered.get(question)
    if known is None:
        known = _remembered[question] = self, _resolve(self, context, args, kws)  # keeps `self` and its id alive
    return known[1]


_LEAVES = {str, int, float, bool, type(None), ir.Loc}


def _variables(values, found: list) -> list:
    """Append the variables among `values` to `found`. Values that hold no variables are skipped."""
    for value in values:
        kind = type(value)
        if kind is ir.Var:
            found.append(value)
        elif kind in _LEAVES:
            continue
        elif kind is list or kind is tuple:
            _variables(value, found)
        elif kind is dict:
            _variables(value.values(), found)
        elif isinstance(value, ir.Inst):
            found += value.list_vars()
        elif isinstance(value, ir.Var):
            found.append(value)
    return found


def _list_vars(self):
    return _variables(vars(self).values(), [])


_CHANGES = (
    (event, "broadcast", lambda event: None),  # no listener needs Numba's events
    (functions.BaseFunction, "get_call_type", _remembered_call_type),
    (ir.Stmt, "list_vars", _list_vars),
    (ir.Expr, "list_vars", _list_vars),
)
