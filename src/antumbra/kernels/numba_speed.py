"""What makes Numba's front end faster in a process that only compiles kernels.

Numba types and lowers in Python. For kernels of many small functions, most of that time goes into questions that were
asked before. No change here alters an answer of Numba. They are made only in processes that compile (`worker.py`), so
nobody else's use of Numba changes. A change that does not fit the installed version is left out.
"""

from contextlib import suppress

from numba.core import event, ir
from numba.core.types import functions


def make_faster() -> None:
    """Apply all changes."""
    for change in _no_events, _remembered_calls, _plain_list_vars:
        with suppress(AttributeError):
            change()


def _no_events() -> None:
    """Nobody listens to what Numba announces."""
    assert event.broadcast
    event.broadcast = lambda event: None


def _remembered_calls() -> None:
    """A builtin function is asked once what it returns for arguments of some types."""
    resolve = functions.Function.get_call_type

    def get_call_type(self, context, args, kws):
        if kws:
            return resolve(self, context, args, kws)
        known = vars(self).setdefault("_remembered", {})
        key = (len(self.templates), tuple(args))
        signature = known.get(key)
        if signature is None:
            signature = known[key] = resolve(self, context, args, kws)
        return signature

    functions.Function.get_call_type = get_call_type


_LEAVES = {str, int, float, bool, type(None), ir.Loc}


def _plain_list_vars() -> None:
    """The variables of a statement, found without looking into what can hold none."""
    for cls in (ir.Stmt, ir.Expr):
        assert "list_vars" in vars(cls)
        cls.list_vars = lambda self: _variables(list(vars(self).values()), [])


def _variables(values, found: list) -> list:
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
