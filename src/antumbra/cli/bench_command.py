"""``antumbra bench``: repeat the measurements of the papers, with the published figures beside ours.

Its commands are the functions under the entry point ``antumbra.bench``, and ``all``, which runs them. `antumbra.papers`
registers some, and other packages can add more; they are looked up when the command is used. `benchmark` gives a
command the options --quick and --output, which ``all`` passes on, and `Results` writes its tables and plots.
"""

import gc
import inspect
import json
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from time import monotonic
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ..errors import InputError
from ..extras import plugins_of
from ..files import atomic_output, checked_output
from . import console
from .arguments import check_plot
from .console import UNFORESEEN, Record, explained, say
from .options import Quiet, writes_folder

# --- Options --quick and --output, and result files -------------------------------------------------------------------


OutputOption = Annotated[
    Path | None,
    typer.Option(
        help="Also write the tables (.md, .json) and plots (.png) to a folder.",
        metavar="FOLDER",
        show_default=False,
        callback=writes_folder(),
    ),
]
_NEUTRAL = "output", "json", "quiet"  # options that do not affect results


class Results:
    """The results of a benchmark run: printed, and written to the folder of --output, if any."""

    def __init__(self, name: str, command: str, folder: Path | None, as_json: bool, quiet: bool):
        self.name, self.command = name, command
        self._folder, self._json, self._quiet = folder, as_json, quiet
        self._draws = folder is not None and find_spec("matplotlib") is not None

    def plots(self, plot: Path | None) -> list[Path]:
        """The files to draw the plot to: `plot`, from --plot, and one in the folder of --output.

        Raises
        ------
        InputError
            If `plot` cannot be written, or Matplotlib is missing.
        """
        if plot is not None:
            check_plot(plot)
        extra = self._folder / f"{self.name}.png" if self._folder and self._draws else None
        return [path for path in (plot, extra) if path is not None]

    def pictures(self) -> Path | None:
        """The folder for further pictures; None without --output or Matplotlib."""
        return self._folder if self._draws else None

    @contextmanager
    def told(self, answer: dict[str, Any]) -> Iterator[None]:
        """Print the JSON object, or the tables printed by the block; write both to the folder."""
        record = Record(None if self._json or self._quiet else sys.stdout)
        with redirect_stdout(record):
            yield
        if self._folder is not None:
            self._write(self._folder, record, answer)
        if self._json:
            console.print_json(answer)

    def _write(self, folder: Path, record: Record, answer: dict[str, Any]) -> None:
        from .installation_commands import about

        header = {"command": self.command, "date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", **about()}
        text = json.dumps(console.plain({"about": header, **answer}), allow_nan=False, indent=1) + "\n"
        top = Record(None)
        top.keep_fields((name, str(value)) for name, value in header.items())
        tables = f"# antumbra bench {self.name}\n\n{top.markdown()}\n{record.markdown()}"
        for suffix, content in ((".json", text), (".md", tables)):
            with atomic_output(folder / f"{self.name}{suffix}") as temporary:
                temporary.write_text(content, encoding="utf-8")
        if not self._draws:
            say(f"no plots in {folder}, because matplotlib is missing: pip install 'antumbra[plot]'")


def benchmark(**quick: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator of a command ``f(results, ...)`` of ``antumbra bench`` that adds --quick and --output.

    quick : option -> its value with --quick, unless the user sets it
    """

    def wrap(command: Callable[..., None]) -> Any:
        def run(context: typer.Context, quick: bool, output: Path | None, **values: Any) -> None:
            if quick:
                values |= {name: value for name, value in wrapper.quick.items() if not _is_given(context, name)}
            name = context.command.name or ""
            with results_folder(output):
                command(Results(name, _command_line(context), output, values["json"], values["quiet"]), **values)

        wrapper: Any = run
        wrapper.quick = dict(quick)
        wrapper.__doc__, wrapper.__name__ = command.__doc__, command.__name__
        wrapper.__signature__ = inspect.Signature(_parameters(command, quick))
        wrapper.__annotations__ = {p.name: p.annotation for p in wrapper.__signature__.parameters.values()}
        return wrapper

    return wrap


@contextmanager
def results_folder(folder: Path | None) -> Iterator[None]:
    """Create a folder if it is missing, and then remove it again if it stays empty. None: no folder.

    Raises
    ------
    InputError
        If the folder cannot be created or written to.
    """
    if folder is None:
        yield
        return
    if is_new := not folder.exists():
        _make(folder)
    try:
        checked_output(folder / "results.md", (".md",))
        yield
    finally:
        if is_new:
            with suppress(OSError):  # it is not empty
                folder.rmdir()


def _make(folder: Path) -> None:
    try:
        folder.mkdir()
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another folder") from None


def _parameters(command: Callable[..., None], quick: dict[str, Any]) -> list[inspect.Parameter]:
    """The parameters for Typer: those of the command without `results`, and the new ones before --json."""
    _, *parameters = inspect.signature(command).parameters.values()
    values = ((name, value if isinstance(value, list) else [value]) for name, value in quick.items())
    shorter = " ".join(f"--{name.replace('_', '-')} {each}" for name, several in values for each in several)
    option = Annotated[bool, typer.Option("--quick", help=f"Measure less, as with {shorter}.")]
    keyword = inspect.Parameter.KEYWORD_ONLY
    new = [
        inspect.Parameter("quick", keyword, default=False, annotation=option),
        inspect.Parameter("output", keyword, default=None, annotation=OutputOption),
    ]
    at = next(i for i, p in enumerate(parameters) if p.name == "json")
    parameters = [p.replace(kind=keyword) for p in parameters]
    return [inspect.Parameter("context", keyword, annotation=typer.Context), *parameters[:at], *new, *parameters[at:]]


def _is_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name != "DEFAULT"


def _command_line(context: typer.Context) -> str:
    """The command as typed, without options that do not affect results."""
    words = ["antumbra", "bench", context.command.name or ""]
    for parameter in context.command.params:
        name = parameter.name or ""
        if not _is_given(context, name) or name in _NEUTRAL:
            continue
        value = context.params[name]
        if value is True:
            words.append(parameter.opts[0])
        else:
            for each in value if isinstance(value, (list, tuple)) else (value,):
                words += [parameter.opts[0], str(each)]
    return shlex.join(words)


# --- The commands of ``antumbra bench`` -------------------------------------------------------------------------------


_GROUP = "antumbra.bench"


class _EntryPointGroup(TyperGroup):
    """A command group that looks its commands up among the entry points when it is used."""

    def list_commands(self, ctx: Any) -> list[str]:
        return [*super().list_commands(ctx), *plugins_of(_GROUP)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        return _loaded(cmd_name) if cmd_name in plugins_of(_GROUP) else super().get_command(ctx, cmd_name)


def _loaded(name: str) -> Any:
    """The registered command of this name."""
    alone = typer.Typer(rich_markup_mode=None, add_completion=False)
    alone.command(name)(plugins_of(_GROUP)[name].load())
    return typer.main.get_command(alone)


app = typer.Typer(cls=_EntryPointGroup, help="Measure what the papers measured.", rich_markup_mode=None)


@app.callback()
def _bench() -> None:
    """Reproduce the tables and plots of the papers on this machine, beside the published figures."""


@app.command("all")
def all_(
    quick: Annotated[bool, typer.Option("--quick", help="Measure less: ten minutes in all on two cores.")] = False,
    output: OutputOption = None,
    quiet: Quiet = False,
) -> int:
    """Run all other benchmarks, one after the other.

    If one fails, a line on standard error gives the reason, the others still run, and the exit code is 1. After Ctrl-C,
    the files of finished benchmarks remain.

    \b
    Examples
      antumbra bench all --quick --output results
    """
    took: dict[str, str] = {}
    names = list(plugins_of(_GROUP))
    with results_folder(output):
        try:
            for k, name in enumerate(names, 1):
                if not quiet:
                    print(f"== antumbra bench {name} ({k} of {len(names)})\n", flush=True)
                start, failed = monotonic(), _run(name, quick, output, quiet)
                took[name] = "failed after " * failed + console.duration(monotonic() - start)
                gc.collect()  # free the scenes of this benchmark before the next one
        finally:
            if not quiet:
                console.print_fields(took.items())
    return UNFORESEEN if any(text.startswith("failed") for text in took.values()) else 0


def _run(name: str, quick: bool, output: Path | None, quiet: bool) -> bool:
    """Run a benchmark. If it fails, print the reason and return True."""
    try:
        command = _loaded(name)
        options = {
            "quick": ["--quick"] * quick,
            "output": ["--output", str(output)] if output else [],
            "quiet": ["--quiet"] * quiet,
        }
        words = [word for parameter in command.params for word in options.get(parameter.name or "", [])]
        with command.make_context(f"antumbra bench {name}", words) as context:
            command.invoke(context)
    except (BrokenPipeError, typer.Abort):
        raise
    except Exception as error:
        say(f"antumbra bench {name} failed: {explained(error)[0]}")
        return True
    return False
