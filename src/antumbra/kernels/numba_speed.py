"""Numba's front end, faster while kernels are compiled.

Numba types and lowers in Python. For kernels of many small functions, most of that time goes into questions that were
asked before. No change here alters an answer of Numba. All of them are taken back afterwards, so nobody else's use of
Numba changes. A change that does not fit the installed version is left out.
"""

import gc
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

from numba.core import event, ir
from numba.core.types import functions


@contextmanager
def faster() -> Iterator[None]:
    """Within, Numba compiles faster. Under its compiler lock."""
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
    """Numba makes many objects that live on: to look through them is a seventh of all time."""
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
    """A builtin function is asked once what it returns for arguments of some types."""
    if kws:
        return _resolve(self, context, args, kws)
    question = (id(self), len(self.templates), tuple(args))
    known = _remembered.get(question)
    if known is None:
        known = _remembered[question] = self, _resolve(self, context, args, kws)  # `self` lives as long as its id
    return known[1]


_LEAVES = {str, int, float, bool, type(None), ir.Loc}


def _variables(values, found: list) -> list:
    """The variables among values, without looking into what can hold none."""
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
    (event, "broadcast", lambda event: None),  # nobody listens to what Numba announces
    (functions.BaseFunction, "get_call_type", _remembered_call_type),
    (ir.Stmt, "list_vars", _list_vars),
    (ir.Expr, "list_vars", _list_vars),
)
