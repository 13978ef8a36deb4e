"""Signals that end the command: one line on standard error, the exit code 128 + signal, and nothing half written.

Before a command begins, and after it has ended, a signal ends the process at once, since there is nothing to undo.
While it works, a signal raises KeyboardInterrupt, so that files are completed or removed, and processes are ended.

The module imports almost nothing, so that signals are handled a few milliseconds after Python has started.
"""

import _signal as signal  # `signal` adds enumerations, whose import takes longer than all else here
import os
import sys

_NAMES = {getattr(signal, name): name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)}
_CODE = 128  # plus the signal: the exit code by convention
_PATIENCE = 3  # signals until a process that is tidying up ends at once


class _State:
    def __init__(self) -> None:
        self.received = list[int]()
        self.is_working = False


_state = _State()


def catch_signals() -> None:
    """Handle signals from now on, except those that whoever started this process ignores, as `nohup` does."""
    for number in _NAMES:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _receive)
    if hasattr(signal, "pthread_kill"):
        sys.unraisablehook = _raise_again


def set_working(works: bool) -> None:
    """State whether a command is at work."""
    _state.is_working = works


def interruption() -> tuple[str, int] | None:
    """(line, exit code) if a signal has been received."""
    if not _state.received:
        return None
    name = _NAMES[_state.received[0]]
    return "interrupted" if name == "SIGINT" else f"ended by {name}", _CODE + _state.received[0]


def _receive(number: int, frame: object) -> None:
    _state.received.append(number)
    if not _state.is_working or len(_state.received) >= _PATIENCE:
        line, code = interruption() or ("", _CODE)
        try:
            os.write(2, f"antumbra: {line}\n".encode())
        finally:
            os._exit(code)
    if len(_state.received) == 1:  # later ones would end the tidying up
        raise KeyboardInterrupt


def _raise_again(ignored: "sys.UnraisableHookArgs") -> None:
    """Repeat a signal whose exception was lost, because a destructor or a callback of the garbage collector ran."""
    if not (_state.received and isinstance(ignored.exc_value, KeyboardInterrupt)):
        sys.__unraisablehook__(ignored)
        return
    from threading import Timer, main_thread

    again = Timer(0.01, signal.pthread_kill, (main_thread().ident, _state.received.pop()))
    again.daemon = True
    again.start()
