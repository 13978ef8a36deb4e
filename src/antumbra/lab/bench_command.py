"""``antumbra bench``: repeat the measurements of the papers, with the published figures beside ours.

Its commands are the functions under the entry point ``antumbra.bench``, and ``all``, which runs them. `lab.papers`
registers some, and other packages can add more; they are looked up when the command is used. `benchmark` runs a
command, and prints and writes the `BenchResult` that it returns.
"""

import gc
import inspect
import json
import shlex
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from importlib.util import find_spec
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_type_hints

import typer
from typer.core import TyperGroup

from ..base.errors import InputError
from ..base.extras import plugins_of
from ..base.files import atomic_output, checked_output
from ..cli import console
from ..cli.arguments import check_plot
from ..cli.command_help import HelpfulCommand
from ..cli.console import UNFORESEEN, ProgressDisplay, Record, explained, say
from ..cli.options import Json, Quiet, writes_folder
from ..picture.picture_records import plain
from ..work.result_summary import duration

if TYPE_CHECKING:
    from .bench_parts import BenchParts

# --- One benchmark: its options, its run and its results --------------------------------------------------------------


OutputOption = Annotated[
    Path | None,
    typer.Option(
        help="Also write the tables (.md, .json) and plots (.png) to a folder. It keeps what has been measured: a run "
        "that ended early resumes, and tables measured alone are joined.",
        metavar="FOLDER",
        show_default=False,
        callback=writes_folder(),
    ),
]
FreshOption = Annotated[bool, typer.Option("--fresh", help="Measure again what the output folder already has.")]
_NEUTRAL = "output", "fresh", "json", "quiet"  # options that do not affect results


class BenchResult(NamedTuple):
    """What a benchmark measured."""

    answer: dict[str, Any]  # fields of the JSON object
    print_tables: Callable[[], None]  # prints the tables by `console`
    write_plot: Callable[[Path], None] | None = None  # writes the plot to a .png file
    same_bits: bool | None = None  # whether all methods return the same bits; None: not compared
    write_comparison: Callable[[Path], None] | None = None  # draws the paper's values beside ours to a .png file


class BenchRun:
    """A run of a benchmark: shows its progress, and prints and writes its result."""

    def __init__(self, name: str, context: typer.Context):
        options = context.params
        self.name, self._quick = name, options["quick"]
        self._command, self._of_part = _command_line(context), _command_line(context, "table")
        self._folder, self._json, self._quiet = options["output"], options["json"], options["quiet"]
        self.silent, self._fresh = self._json or self._quiet, options["fresh"]
        self._draws = self._folder is not None and find_spec("matplotlib") is not None
        self._display = ProgressDisplay(self._quiet)
        self._parts: BenchParts | None = None

    def say(self, text: str) -> None:
        """Show the current operation."""
        self._display.say(text)

    def pictures(self) -> Path | None:
        """The folder for further pictures; None without --output or Matplotlib."""
        return self._folder if self._draws else None

    def parts(
        self,
        settings: Mapping[str, Mapping[str, Any]],
        rows: Iterable[type] = (),
        tables: Collection[str] | None = None,
    ) -> "BenchParts":
        """The parts of this benchmark, stored in its output folder; see `BenchParts`."""
        from .bench_parts import BenchParts

        folder = None if self._folder is None else self._folder / f"{self.name}.parts"
        every = {table: {**each, "quick": self._quick} for table, each in settings.items()}
        self._parts = BenchParts(every, rows, tables or None, folder=folder, fresh=self._fresh, command=self._of_part)
        return self._parts

    def finish(self, measure: Callable[[], BenchResult], plot: Path | None) -> None:
        """Measure, and print and write the result. `plot`: a further file for the plot.

        Raises
        ------
        InputError
            If `plot` cannot be written, or Matplotlib is missing.
        """
        if plot is not None:
            check_plot(plot)
        from ..kernels.jit import recorded_calls
        from .bench_conditions import collected_laps, conditions, joined_digests, kernel_digests, summary_of

        with self._display, collected_laps() as laps, recorded_calls() as calls:
            result = measure()
            self._draw(result, plot)
        parts = [] if self._parts is None else self._parts.conditions()
        spreads = [*laps.spreads, *(spread for part in parts for spread in part.spreads)]
        joined = self._parts is not None and self._folder is not None
        answer: dict[str, Any] = {"about": conditions(self._of_part if joined else self._command, self._quick)}
        if self._parts is not None:
            answer["tables"] = self._parts.of_tables()
            if self._parts.resumed and not self._quiet:
                say(f"parts measured before: {self._parts.resumed}; --fresh measures them again")
        answer |= {"spread": summary_of(spreads), **result.answer}
        record, same = Record(None if self.silent else sys.stdout), result.same_bits
        with redirect_stdout(record):
            result.print_tables()
            if same is not None:
                answer["same_bits"] = same
                verdict = "the same by all methods" if same else "DIFFER: please report this"
                console.print_fields([("bits", verdict)])
        answer["kernels"] = joined_digests([*(part.kernels for part in parts), kernel_digests(calls)])
        if self._folder is not None:
            self._write(self._folder, record, answer)
        if self._json:
            console.print_json(answer)

    def _draw(self, result: BenchResult, plot: Path | None) -> None:
        """Draw the plots to the folder, and to the file `plot`."""
        folder = self._folder if self._draws else None
        pictures = [(plot, result.write_plot)]
        if folder is not None:
            pictures.append((folder / f"{self.name}.png", result.write_plot))
            pictures.append((folder / f"{self.name}-comparison.png", result.write_comparison))
        for path, write in pictures:
            if path is not None and write is not None:
                write(path)

    def _write(self, folder: Path, record: Record, answer: dict[str, Any]) -> None:
        text = json.dumps(plain(answer), allow_nan=False, indent=1) + "\n"
        top = Record(None)
        top.keep_fields((name, str(value)) for name, value in answer["about"].items())
        tables = f"# antumbra bench {self.name}\n\n{top.markdown()}\n{record.markdown()}"
        for suffix, content in ((".json", text), (".md", tables)):
            with atomic_output(folder / f"{self.name}{suffix}") as temporary:
                temporary.write_text(content, encoding="utf-8")
        if not self._draws:
            say(f"no plots in {folder}, because matplotlib is missing: pip install 'antumbra[plot]'")


def benchmark(**quick: Any) -> Callable[[Callable[..., BenchResult]], Callable[..., None]]:
    """Decorator of a command ``f(run, options)`` of ``antumbra bench``: `run` is a `BenchRun`.

    `options` is a NamedTuple whose annotated fields become the options of the command, followed by --quick, --output,
    --fresh, --json and --quiet. Its field `plot`, if any, is a further file for the plot.

    quick : option -> its value with --quick, unless the user sets it
    """

    def wrap(command: Callable[..., BenchResult]) -> Any:
        options = inspect.signature(command).parameters["options"].annotation

        def run(
            context: typer.Context, quick: bool, output: Path | None, fresh: bool, json: bool, quiet: bool, **given: Any
        ) -> None:
            if quick:
                given |= {name: value for name, value in wrapper.quick.items() if not _is_given(context, name)}
            with results_folder(output):
                bench = BenchRun(context.command.name or "", context)
                bench.finish(lambda: command(bench, options(**given)), given.get("plot"))

        wrapper: Any = run
        wrapper.quick = dict(quick)
        wrapper.__doc__, wrapper.__name__ = command.__doc__, command.__name__
        wrapper.__signature__ = inspect.Signature(_parameters(options, quick))
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


def _parameters(options: Any, quick: dict[str, Any]) -> list[inspect.Parameter]:
    """The parameters for Typer: the fields of the NamedTuple `options`, between the context and the common options."""
    values = ((name, value if isinstance(value, list) else [value]) for name, value in quick.items())
    shorter = " ".join(f"--{name.replace('_', '-')} {each}" for name, several in values for each in several)
    quick_option = Annotated[bool, typer.Option("--quick", help=f"Measure less, as with {shorter}.")]
    types = {"context": typer.Context, **get_type_hints(options, include_extras=True), "quick": quick_option}
    types |= {"output": OutputOption, "fresh": FreshOption, "json": Json, "quiet": Quiet}
    defaults = {
        "quick": False,
        "output": None,
        "fresh": False,
        "json": False,
        "quiet": False,
        **options._field_defaults,
    }
    keyword, none = inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.empty
    return [inspect.Parameter(n, keyword, default=defaults.get(n, none), annotation=t) for n, t in types.items()]


def _is_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name != "DEFAULT"


def _command_line(context: typer.Context, *without: str) -> str:
    """The command as typed, without options that do not affect results, and without some others."""
    words = ["antumbra", "bench", context.command.name or ""]
    for parameter in context.command.params:
        name = parameter.name or ""
        if not _is_given(context, name) or name in (*_NEUTRAL, *without):
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

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Whole summaries: Click would end them at the full stop of "et al."."""
        texts = {name: self.get_command(ctx, name).help or "" for name in self.list_commands(ctx)}
        with formatter.section("Commands"):
            formatter.write_dl([(name, text.partition("\n\n")[0]) for name, text in texts.items()])


class BenchCommand(HelpfulCommand):
    """A command of ``antumbra bench``."""


def _loaded(name: str) -> Any:
    """The registered command of this name."""
    alone = typer.Typer(rich_markup_mode=None, add_completion=False)
    alone.command(name, cls=BenchCommand)(plugins_of(_GROUP)[name].load())
    return typer.main.get_command(alone)


app = typer.Typer(cls=_EntryPointGroup, help="Repeat the measurements of the papers.", rich_markup_mode=None)


@app.callback()
def _bench() -> None:
    """Reproduce the tables and plots of the papers on this machine, beside the published figures."""


@app.command("all", cls=BenchCommand)
def all_(
    quick: Annotated[bool, typer.Option("--quick", help="Measure less: ten minutes in all on two cores.")] = False,
    output: OutputOption = None,
    fresh: FreshOption = False,
    quiet: Quiet = False,
) -> int:
    """Run all other benchmarks, one after the other.

    If one fails, a line on standard error gives the reason, the others still run, and the exit code is 1. After Ctrl-C,
    the files of finished benchmarks remain, and the same command resumes.

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
                start, failed = monotonic(), _run(name, quick, output, fresh, quiet)
                took[name] = "failed after " * failed + duration(monotonic() - start)
                gc.collect()  # free the scenes of this benchmark before the next one
        finally:
            if not quiet:
                console.print_fields(took.items())
    return UNFORESEEN if any(text.startswith("failed") for text in took.values()) else 0


def _run(name: str, quick: bool, output: Path | None, fresh: bool, quiet: bool) -> bool:
    """Run a benchmark. If it fails, print the reason and return True."""
    try:
        command = _loaded(name)
        options = {
            "quick": ["--quick"] * quick,
            "output": ["--output", str(output)] if output else [],
            "fresh": ["--fresh"] * fresh,
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
