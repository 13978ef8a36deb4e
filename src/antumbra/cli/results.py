"""Commands of ``antumbra bench``: their options --quick and --output, and the files of their results."""

import inspect
import json
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import InputError
from ..output import checked_output, replacing
from . import report
from .arguments import check_plot
from .failures import say
from .outputs import writes_folder
from .record import Record

OutputOption = Annotated[
    Path | None,
    typer.Option(
        help="Write the tables (.md, .json) and plots (.png) to a folder too.",
        metavar="FOLDER",
        show_default=False,
        callback=writes_folder(),
    ),
]
_ELSEWHERE = "output", "json", "quiet"  # options that change no result


class Results:
    """The results of one run of a bench: what is printed, and files in the folder of --output, if it is given."""

    def __init__(self, name: str, command: str, folder: Path | None, as_json: bool, quiet: bool):
        self.name, self.command = name, command
        self._folder, self._json, self._quiet = folder, as_json, quiet
        self._draws = folder is not None and find_spec("matplotlib") is not None

    def plots(self, asked: Path | None) -> list[Path]:
        """The files for the plot: `asked`, from --plot, and one in the folder.

        Raises
        ------
        InputError
            If `asked` cannot be written, or Matplotlib is missing for it.
        """
        if asked is not None:
            check_plot(asked)
        own = self._folder / f"{self.name}.png" if self._folder and self._draws else None
        return [path for path in (asked, own) if path is not None]

    def pictures(self) -> Path | None:
        """The folder for further pictures; None if they cannot be drawn, or without --output."""
        return self._folder if self._draws else None

    @contextmanager
    def told(self, answer: dict) -> Iterator[None]:
        """Print the JSON object, or the tables that the block prints. Both are written to the folder."""
        record = Record(None if self._json or self._quiet else sys.stdout)
        with redirect_stdout(record):
            yield
        if self._folder is not None:
            self._write(self._folder, record, answer)
        if self._json:
            report.print_json(answer)

    def _write(self, folder: Path, record: Record, answer: dict) -> None:
        from .about import about

        header = {"command": self.command, "date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", **about()}
        text = json.dumps(report.plain({"about": header, **answer}), allow_nan=False, indent=1) + "\n"
        top = Record(None)
        top.keep_fields((name, str(value)) for name, value in header.items())
        tables = f"# antumbra bench {self.name}\n\n{top.markdown()}\n{record.markdown()}"
        for suffix, content in ((".json", text), (".md", tables)):
            with replacing(folder / f"{self.name}{suffix}") as temporary:
                temporary.write_text(content, encoding="utf-8")
        if not self._draws:
            say(f"no plots in {folder}, because matplotlib is missing: pip install 'antumbra[plot]'")


def benchmark(**quick: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator of a command ``f(results, ...)`` of ``antumbra bench``. It adds the options --quick and --output.

    quick : option -> its value with --quick. Options that the user gives keep their values.
    """

    def wrap(command: Callable[..., None]) -> Callable[..., None]:
        def run(context: typer.Context, quick: bool, output: Path | None, **given) -> None:
            if quick:
                given |= {name: value for name, value in found.quick.items() if not _is_given(context, name)}
            name = context.command.name or ""
            with made_folder(output):
                command(Results(name, _command_line(context), output, given["json"], given["quiet"]), **given)

        found: Any = run
        found.quick = dict(quick)
        found.__doc__, found.__name__ = command.__doc__, command.__name__
        found.__signature__ = inspect.Signature(_parameters(command, quick))
        found.__annotations__ = {p.name: p.annotation for p in found.__signature__.parameters.values()}
        return found

    return wrap


@contextmanager
def made_folder(folder: Path | None) -> Iterator[None]:
    """Make a folder, and remove it if it is empty at the end. None: there is no folder.

    Raises
    ------
    InputError
        If it cannot be made, or nothing can be written in it.
    """
    if folder is None:
        yield
        return
    if made := not folder.exists():
        _make(folder)
    try:
        checked_output(folder / "results.md", (".md",))
        yield
    finally:
        if made:
            with suppress(OSError):  # it has files
                folder.rmdir()


def _make(folder: Path) -> None:
    try:
        folder.mkdir()
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another folder") from None


def _parameters(command: Callable[..., None], quick: dict[str, Any]) -> list[inspect.Parameter]:
    """The parameters that Typer sees: those of the command but `results`, and the new ones before --json."""
    _, *own = inspect.signature(command).parameters.values()
    values = ((name, value if isinstance(value, list) else [value]) for name, value in quick.items())
    shorter = " ".join(f"--{name.replace('_', '-')} {each}" for name, several in values for each in several)
    option = Annotated[bool, typer.Option("--quick", help=f"Measure less, as with {shorter}.")]
    keyword = inspect.Parameter.KEYWORD_ONLY
    new = [
        inspect.Parameter("quick", keyword, default=False, annotation=option),
        inspect.Parameter("output", keyword, default=None, annotation=OutputOption),
    ]
    at = next(i for i, p in enumerate(own) if p.name == "json")
    own = [p.replace(kind=keyword) for p in own]
    return [inspect.Parameter("context", keyword, annotation=typer.Context), *own[:at], *new, *own[at:]]


def _is_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name != "DEFAULT"


def _command_line(context: typer.Context) -> str:
    """The command as users type it, without the options that change no result."""
    words = ["antumbra", "bench", context.command.name or ""]
    for parameter in context.command.params:
        name = parameter.name or ""
        if not _is_given(context, name) or name in _ELSEWHERE:
            continue
        value = context.params[name]
        if value is True:
            words.append(parameter.opts[0])
        else:
            for each in value if isinstance(value, (list, tuple)) else (value,):
                words += [parameter.opts[0], str(each)]
    return shlex.join(words)
