"""Errors on the command line: one line on standard error, and an exit code."""

import json
import logging
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import typer

from ..errors import InputError, one_line

UNFORESEEN, BAD_INPUT, INTERRUPTED = 1, 2, 130

# Typer does not export the base class of its usage errors, and its module depends on Typer's version.
_UsageError: Any = typer.BadParameter.__mro__[1]


def guarded(run: Callable[[list[str]], object], arguments: list[str]) -> int:
    """Run ``run(arguments)`` and return its exit code. Any exception becomes one line on standard error.

    With ``--json`` it is a JSON object on standard output too: {"error": line}.

    ``--debug`` may stand anywhere, because users add it to a command that has just failed.
    """
    _prepare_streams()
    before = arguments[: arguments.index("--")] if "--" in arguments else arguments
    debug = "--debug" in before or os.environ.get("ANTUMBRA_DEBUG", "") not in ("", "0")
    arguments = [a for a in before if a != "--debug"] + arguments[len(before) :]
    try:
        with _log_lines():
            code = run(arguments)
        sys.stdout.flush()
        code = code if isinstance(code, int) else 0
        if code == INTERRUPTED:
            raise KeyboardInterrupt
        return code
    except BrokenPipeError:  # the reader of the output has ended
        _drop_output()
        return UNFORESEEN
    except BaseException as error:
        if isinstance(error, SystemExit):
            raise
        if debug and not isinstance(error, (_UsageError, KeyboardInterrupt, typer.Abort)):
            raise
        if isinstance(error, OSError):
            _drop_output()
        line, code = explained(error)
        say(line)
        if "--json" in before:
            with suppress(OSError, ValueError):
                print(json.dumps({"error": line}), flush=True)
        return code


def _drop_output() -> None:
    """Drop buffered standard output if it cannot be written.

    Otherwise Python would flush it at exit, print an error, and change the exit code.
    """
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def explained(error: BaseException) -> tuple[str, int]:
    """(one line about an exception, exit code)."""
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        return "interrupted", INTERRUPTED
    if isinstance(error, InputError):
        return str(error), BAD_INPUT
    if isinstance(error, _UsageError):
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "antumbra"
        return f"{_usage(error)}; see {command} --help", BAD_INPUT
    if isinstance(error, MemoryError):
        return "not enough memory; take a smaller --size, fewer --spp or a smaller scene", UNFORESEEN
    if isinstance(error, OSError):  # such as standard output on a full disk
        return f"the system reports: {error}", UNFORESEEN
    reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"unexpected {reason}; this is a bug, --debug shows where", UNFORESEEN


class _LogLines(logging.Handler):
    """Records of a logger as lines on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        say(record.getMessage())


@contextmanager
def _log_lines() -> Iterator[None]:
    """Say what the library logs: warnings, and progress where `progress.ProgressDisplay` asks for it."""
    log, lines = logging.getLogger("antumbra"), _LogLines()
    log.addHandler(lines)
    try:
        yield
    finally:
        log.removeHandler(lines)


# What Typer says of values, by the words of pydantic -> what this package says.
_WORDS = (
    (r"Value error, .* is not one of (.*)", r"it must be one of \1"),
    (r"Input should be a valid integer.*", "it must be a whole number"),
    (r"Input should be a valid number.*", "it must be a number"),
    (r"Input should be a finite number.*", "it must be a finite number"),
    (r"Input should be greater than or equal to (.*)", r"it must be at least \1"),
    (r"Input should be less than or equal to (.*)", r"it must be at most \1"),
)


def _usage(error) -> str:
    """An error of Typer about a value, in the words of other errors: ``--spp is 'x'; it must be a whole number``."""
    said = error.format_message().rstrip(".")
    option = next((o for o in getattr(getattr(error, "param", None), "opts", ()) if o.startswith("--")), None)
    for pattern, words in _WORDS:
        found = re.fullmatch(pattern, str(getattr(error, "message", "")).rstrip("."))
        if found and option:
            return f"{option}{_given(error)}; {found.expand(words)}"
    return said


def _given(error) -> str:
    """`` is 'x'`` of the value that pydantic refused; nothing if it is not known."""
    try:
        return f" is {error.__cause__.errors()[0]['input']!r}"
    except (AttributeError, IndexError, KeyError, TypeError):
        return ""


def say(line: str) -> None:
    """Print a line on standard error."""
    text = " ".join(one_line(line).split())
    with suppress(OSError, ValueError):
        print("antumbra:", text, file=sys.stderr, flush=True)


def _prepare_streams() -> None:
    """Make writing to the standard streams safe.

    A stream may be closed, and file names may have characters that the terminal's encoding lacks.
    """
    for name in ("stdout", "stderr"):
        stream: Any = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - as long as the process
        else:
            with suppress(AttributeError, OSError, ValueError):
                stream.reconfigure(errors="backslashreplace")
