"""Terminal output: answers on standard output, as tables or JSON; progress and errors on standard error.

A `Record` also collects the output as Markdown. `guarded` turns exceptions into one line and an exit code.
"""

import io
import json
import logging
import os
import re
import select
import shutil
import sys
import textwrap
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Self, TextIO

import typer

from ..base.errors import InputError, UnavailableError, one_line
from ..base.progress import LOG, progress_listener, split_progress
from ..picture.picture_records import plain
from .interruption import interruption

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID
    from rich.table import Table

    from ..techniques.srdh.representative_rays import SrdhRays


# --- Output as Markdown -----------------------------------------------------------------------------------------------


_ESCAPED = str.maketrans({c: f"\\{c}" for c in "\\|*<>`[]"})


class Record(io.TextIOBase):
    """A stream for standard output that also collects the output as Markdown.

    `print_table` and `print_fields` pass it tables and fields. A line just before a table becomes its caption.

    stream : the stream to which all text is passed on; None: nowhere
    """

    def __init__(self, stream: TextIO | None):
        self.stream = stream
        self._blocks: list[str] = []
        self._text = ""  # printed since the last block

    def write(self, text: str) -> int:
        self._text += text
        if self.stream is not None:
            self.stream.write(text)
        return len(text)

    def flush(self) -> None:
        if self.stream is not None:
            self.stream.flush()

    def isatty(self) -> bool:
        return self.stream is not None and self.stream.isatty()

    def keep_table(self, headers: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[int] = ()) -> None:
        """Add a table. Columns in `right` hold numbers."""
        self._end_text(caption=True)
        marks = ["---:" if i in right else "---" for i in range(len(headers))]
        lines = [[escaped(h) for h in headers], marks, *([escaped(cell) for cell in row] for row in rows)]
        self._blocks.append("\n".join(f"| {' | '.join(line)} |" for line in lines))

    def keep_fields(self, rows: Iterable[tuple[str, str]]) -> None:
        """Add names and values as a list."""
        self._end_text()
        self._blocks.append("\n".join(f"- **{escaped(name)}**: {escaped(value)}" for name, value in rows))

    def markdown(self) -> str:
        """Everything collected so far."""
        self._end_text()
        return "\n\n".join(self._blocks) + "\n"

    def _end_text(self, caption: bool = False) -> None:
        lines = [escaped(line.strip()) for line in self._text.splitlines() if line.strip()]
        self._text = ""
        if caption and lines:
            lines[-1] = f"**{lines[-1]}**"
        self._blocks += lines


def escaped(text: str) -> str:
    """Text as one line of Markdown, with special characters escaped."""
    return " ".join(text.translate(_ESCAPED).split())


# --- Answers on standard output: tables for people, one JSON object for programs --------------------------------------


def print_json(answer: dict[str, Any]) -> None:
    """Print one JSON object on one line, and flush it. Infinity and NaN become null."""
    sys.stdout.write(json.dumps(plain(answer), allow_nan=False) + "\n")
    sys.stdout.flush()


def print_fields(rows: Iterable[tuple[str, str]]) -> None:
    """Print names and values, one pair per line."""
    rows = list(rows)
    if isinstance(sys.stdout, Record):
        sys.stdout.keep_fields(rows)
    if _print_plainly(rows):
        return
    from rich.table import Table

    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="bold")
    grid.add_column(overflow="fold")
    _print_rows(grid, rows)


def _print_plainly(rows: list[tuple[str, str]]) -> bool:
    """Print fields without Rich, whose import takes long. False: the output is a terminal, or has wide characters."""
    out = sys.stdout.stream if isinstance(sys.stdout, Record) else sys.stdout
    if out is None or out.isatty() or not all(text.isascii() and text.isprintable() for row in rows for text in row):
        return False
    indent = max((len(name) for name, _ in rows), default=0) + 2
    width = shutil.get_terminal_size().columns - indent
    if width < 20:
        return False
    for name, value in rows:
        for k, line in enumerate(textwrap.wrap(value, width, break_on_hyphens=False) or [""]):
            out.write(f"{name if k == 0 else '':{indent}}{line}".rstrip() + "\n")
    return True


def print_table(
    headers: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[int] = (), width: int | None = None
) -> None:
    """Print a table with headers. Columns in `right` hold numbers. `width`: minimum width in characters."""
    from rich import box
    from rich.table import Table

    rows = list(rows)
    if isinstance(sys.stdout, Record):
        sys.stdout.keep_table(headers, rows, right)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, header in enumerate(headers):
        table.add_column(header, justify="right" if i in right else "left", overflow="fold")
    _print_rows(table, rows, width)


def vector(values: Iterable[float]) -> str:
    """Three numbers as text."""
    return "(" + ", ".join(f"{float(v):.7g}" for v in values) + ")"


def srdh_rays_fields(rays: "SrdhRays") -> dict[str, Any]:
    """`SrdhRays` as names and values."""
    return {name: getattr(rays, name) for name in ("size", "spp", "bounce", "last_frame")}


def _print_rows(table: "Table", rows: Iterable[Sequence[str]], width: int | None = None) -> None:
    from rich.console import Console
    from rich.text import Text

    out = sys.stdout.stream if isinstance(sys.stdout, Record) else sys.stdout
    if out is None:
        return
    for row in rows:
        table.add_row(*(Text(_encodable(cell)) for cell in row))
    terminal = Console(highlight=False, file=out)
    Console(highlight=False, file=out, width=max(width or 0, terminal.width)).print(table)


def _encodable(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode()  # file names may not be valid Unicode


# --- Colours in terminals ---------------------------------------------------------------------------------------------


BOLD, RED, YELLOW = "1", "31", "33"
"""ANSI styles."""


def is_coloured(stream: TextIO | None) -> bool:
    """Whether a stream is a terminal that shows colours. NO_COLOR turns them off."""
    if stream is None or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return False
    with suppress(AttributeError, ValueError):  # a closed stream
        return stream.isatty()
    return False


def styled(text: str, style: str, coloured: bool = True) -> str:
    """Text in a style."""
    return f"\033[{style}m{text}\033[0m" if coloured else text


# --- Progress of operations that take longer than a second ------------------------------------------------------------


DELAY = 1.0


class ProgressDisplay:
    """A progress line on standard error while the block runs longer than `delay` seconds.

    A timer starts the line, so it appears even during a single long call (reading a file, building a BVH). If standard
    error is not a terminal, lines mark the start and end of long work instead. Warnings are printed as notes. `quiet`
    suppresses all of them.
    """

    def __init__(self, quiet: bool = False, delay: float = DELAY):
        self._lock = threading.Lock()
        self._text, self._done, self._total = "", 0, 0
        self._bar: Progress | None = None
        self._quiet, self._closed = quiet, quiet or not sys.stderr.isatty()
        self._heard: AbstractContextManager[None] | None = None
        self._notes = _notes(quiet)
        self._timer = None if self._closed else threading.Timer(delay, self._start)

    def __enter__(self) -> Self:
        self._heard = _logged() if self._closed and not self._quiet else progress_listener(self.say)
        self._heard.__enter__()
        self._notes.__enter__()
        if self._timer is not None:
            self._timer.daemon = True
            self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._timer is not None:
            self._timer.cancel()
        if self._heard is not None:
            self._heard.__exit__(None, None, None)
        self._notes.__exit__(None, None, None)
        with self._lock:
            self._closed = True
            if self._bar is not None:
                self._bar.stop()

    def say(self, text: str, done: int = 0, total: int = 0) -> None:
        """Show the current operation and its progress. `total` 0: unknown."""
        self._text, self._done, self._total = text, done, total
        with self._lock:
            if self._bar is not None:
                self._update(self._bar)

    def parts(self, text: str, count: int, index: int = 0, of: int = 1) -> Callable[[int, int], object]:
        """A function ``progress(done, total)`` for `count` consecutive runs; `done` restarts in each run.

        The runs together make up part `index` of `of` parts.
        """
        progress = split_progress(lambda done, total: self.say(text, done, total), count, index, of)
        assert progress is not None
        return progress

    def _start(self) -> None:
        from rich import progress as bars
        from rich.console import Console

        text = bars.TextColumn("{task.description}", markup=False)
        left = bars.TimeRemainingColumn(elapsed_when_finished=True)
        columns = bars.SpinnerColumn(), text, bars.BarColumn(), bars.TaskProgressColumn(), left
        with self._lock:
            if not self._closed:
                self._bar = bars.Progress(*columns, console=Console(stderr=True), transient=True)
                self._task: TaskID = self._bar.add_task(self._text)
                self._update(self._bar)
                self._bar.start()

    def _update(self, bar: "Progress") -> None:
        bar.update(self._task, description=self._text, completed=self._done, total=self._total or None)


@contextmanager
def _notes(quiet: bool) -> Iterator[None]:
    """Print warnings for the user as lines, each once; other warnings as ever."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if quiet else "once", UserWarning)
        show = warnings.showwarning

        def show_note(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, UserWarning):
                say(f"note: {message}", YELLOW)
            else:
                show(message, category, *where, **more)

        warnings.showwarning = show_note
        yield


@contextmanager
def _logged() -> Iterator[None]:
    """Let the library log its progress."""
    before = LOG.level
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.setLevel(before)


# --- Errors: one line on standard error, and an exit code -------------------------------------------------------------


UNFORESEEN, BAD_INPUT, INTERRUPTED, NO_READER = 1, 2, 130, 141  # the last two: 128 + SIGINT, 128 + SIGPIPE
TRY_AGAIN = 75  # EX_TEMPFAIL of sysexits.h

# Typer does not export the base class of its usage errors, whose module depends on Typer's version.
_UsageError: Any = typer.BadParameter.__mro__[1]


def guarded(run: Callable[[list[str]], object], arguments: list[str]) -> int:
    """Run ``run(arguments)`` and return its exit code. Any exception becomes one line on standard error.

    With ``--json`` the line is also a JSON object on standard output: {"error": line}.

    ``--debug`` is accepted anywhere, because users append it to a command that has just failed.
    """
    _prepare_streams()
    before = arguments[: arguments.index("--")] if "--" in arguments else arguments
    debug = "--debug" in before or os.environ.get("ANTUMBRA_DEBUG", "") not in ("", "0")
    arguments = [a for a in before if a != "--debug"] + arguments[len(before) :]
    try:
        with _log_lines(), _note_lines("--quiet" in before or "-q" in before):
            code = run(arguments)
        sys.stdout.flush()
        code = code if isinstance(code, int) else 0
        if code == INTERRUPTED:
            raise KeyboardInterrupt
        return code
    except BaseException as error:
        if isinstance(error, PipeError):
            error = error.error
        if isinstance(error, BrokenPipeError) and _reader_is_gone():
            _drop_output()
            return NO_READER
        ended = interruption()  # a library may have turned its exception into another one
        if isinstance(error, SystemExit) and not ended:
            raise
        if debug and not ended and not isinstance(error, (_UsageError, KeyboardInterrupt, typer.Abort)):
            raise
        if isinstance(error, OSError):
            _drop_output()
        line, code = ended or explained(error)
        say(line, RED)
        if "--json" in before:
            with suppress(OSError, ValueError):
                print(json.dumps({"error": line}), flush=True)
        return code


class PipeError(Exception):
    """A BrokenPipeError of any pipe, which Typer would turn into a silent exit."""

    def __init__(self, error: BrokenPipeError):
        super().__init__(error)
        self.error = error


@contextmanager
def broken_pipes() -> Iterator[None]:
    """Raise `PipeError` instead of BrokenPipeError."""
    try:
        yield
    except BrokenPipeError as error:
        raise PipeError(error) from error


def _reader_is_gone() -> bool:
    """Whether the reader of standard output has exited, rather than that of another pipe."""
    try:
        number = sys.stdout.fileno()
    except (AttributeError, OSError, ValueError):  # a stream in memory
        return False
    if not hasattr(select, "poll"):  # Windows
        return True
    poll = select.poll()
    poll.register(number, select.POLLOUT)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))


def _drop_output() -> None:
    """Discard buffered standard output if it cannot be written.

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
    if isinstance(error, UnavailableError):
        return str(error), TRY_AGAIN
    if isinstance(error, _UsageError):
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "antumbra"
        usage = _usage(error)
        return f"{usage}{'' if usage.endswith('?') else ';'} see {command} --help", BAD_INPUT
    if isinstance(error, MemoryError):
        return "not enough memory; reduce --size or --spp, or use a smaller scene", UNFORESEEN
    if isinstance(error, OSError):  # such as standard output on a full disk
        return f"the system reports: {error}", UNFORESEEN
    reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"unexpected {reason}; this is a bug, --debug shows where", UNFORESEEN


class _LogLines(logging.Handler):
    """Prints log records as lines on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        say(record.getMessage())


@contextmanager
def _log_lines() -> Iterator[None]:
    """Print what the library logs: warnings, and progress while `ProgressDisplay` enables it."""
    log, lines = logging.getLogger("antumbra"), _LogLines()
    log.addHandler(lines)
    try:
        yield
    finally:
        log.removeHandler(lines)


@contextmanager
def _note_lines(quiet: bool) -> Iterator[None]:
    """Print what the library warns of as lines on standard error, unless `quiet`."""
    before = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
        if issubclass(category, UserWarning):
            say(f"note: {message}", YELLOW)
        else:
            before(message, category, *rest, **more)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if quiet else "always", UserWarning)  # also where Python makes them errors
        warnings.showwarning = show
        yield


# Typer's messages about values, in pydantic's wording -> this package's messages.
_WORDS = (
    (r"Value error, .* is not one of (.*)", r"it must be one of \1"),
    (r"Input should be a valid integer.*", "it must be a whole number"),
    (r"Input should be a valid number.*", "it must be a number"),
    (r"Input should be a finite number.*", "it must be a finite number"),
    (r"Input should be greater than or equal to (.*)", r"it must be at least \1"),
    (r"Input should be less than or equal to (.*)", r"it must be at most \1"),
)


# Typer's messages about words -> this package's messages.
_USES = (
    (r"Missing argument 'SCENE'.*", "SCENE is missing, such as model.glb or example:town"),
    (r"Missing (?:option|argument|parameter) '([^']*)'.*", r"\1 is missing"),
    (r"No such command '?([^']*?)'?", r"there is no command \1"),
    (r"No such command '([^']*)'\. Did you mean '([^']*)'.*", r"there is no command \1; did you mean \2?"),
    (r"Missing command", r"name a command"),
    (r"Option '([^']*)' requires an argument", r"\1 lacks its value"),
    (r"Option '([^']*)' requires (\d+) arguments", r"\1 takes \2 values"),
    (r"Got unexpected extra argument(?:s|\(s\))? \((.*)\)", r"\1: unexpected; options begin with --"),
)


def _usage(error: Any) -> str:
    """Typer's error about a value, worded like other errors: ``--spp is 'x'; it must be a whole number``."""
    if (name := getattr(error, "option_name", None)) and hasattr(error, "possibilities"):
        similar = error.possibilities or ()
        options = {each.lstrip("-"): each for each in similar}  # dashes are alike in all of them
        likely = [each for each in similar if each.startswith(name)]
        likely = likely or [options[each] for each in get_close_matches(name.lstrip("-"), options, 1)]
        hint = f"; did you mean {likely[0]}?" if likely else ""
        return f"there is no option {name}{hint}"
    message: str = error.format_message().rstrip(".")
    for pattern, words in _USES:
        if match := re.fullmatch(pattern, message):
            return match.expand(words)
    option = next((o for o in getattr(getattr(error, "param", None), "opts", ()) if o.startswith("--")), None)
    for pattern, words in _WORDS:
        match = re.fullmatch(pattern, str(getattr(error, "message", "")).rstrip("."))
        if match and option:
            return f"{option}{_given(error)}; {match.expand(words)}"
    return message


def _given(error: Any) -> str:
    """`` is 'x'`` for the value that pydantic rejected; empty if unknown."""
    try:
        return f" is {error.__cause__.errors()[0]['input']!r}"
    except (AttributeError, IndexError, KeyError, TypeError):
        return ""


def say(line: str, style: str = "") -> None:
    """Print a line on standard error. In a terminal, its beginning has a style."""
    text = " ".join(one_line(line).split())
    with suppress(OSError, ValueError):
        print(styled("antumbra:", style, bool(style) and is_coloured(sys.stderr)), text, file=sys.stderr, flush=True)


def _prepare_streams() -> None:
    """Make writing to the standard streams safe.

    A stream may be closed, and file names may contain characters that the terminal's encoding lacks.
    """
    for name in ("stdout", "stderr"):
        stream: Any = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - open until the process exits
        else:
            with suppress(AttributeError, OSError, ValueError):
                stream.reconfigure(errors="backslashreplace")
