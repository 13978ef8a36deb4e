"""Work split among processes: the options --shard, --ray and --merge, the folder of shards, and ``antumbra merge``."""

import re
from contextvars import ContextVar
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InputError
from . import console
from .options import Json, Quiet

# ---------------------------------------------------------------------------------------------------------------------
# ``--shard``, ``--ray`` and ``merge``: the engine that a command asks for, and the folder where it keeps shards.


if TYPE_CHECKING:
    from ..jobs.executors import Executor, ShardIndex, UnitCollector

ShardOption = Annotated[
    str | None,
    typer.Option(
        "--shard",
        help="Do shard I of N only, 0 to N-1; other processes do the others, and antumbra merge joins them.",
        metavar="I/N",
        show_default=False,
    ),
]
RayOption = Annotated[
    str | None,
    typer.Option(
        "--ray",
        help="Work on the nodes of a Ray cluster: auto or HOST:PORT; local: of this machine.",
        metavar="ADDRESS|local",
        show_default=False,
    ),
]
MergeOption = Annotated[list[Path] | None, typer.Option("--merge", hidden=True)]  # from ``antumbra merge``

command_line: ContextVar[tuple[str, ...]] = ContextVar("words", default=())
"""The words of the command line."""

_SHARD = re.compile(r"(\d{1,9})/(\d{1,9})")
_NUMBER = re.compile(r"[^0-9A-Za-z]*#+$")  # that of a frame, at the end of a name
node_engine: ContextVar["UnitCollector | None"] = ContextVar("asked", default=None)
"""The engine of a command that begins on a node of a cluster."""

_OUTPUTS = "output", "city_output", "matrix", "sparse", "counts"
_LEFT_OUT = "sheet", "html"  # pictures of a whole job
_VALUED = "--ray", "--shard", "--merge", "--threads"  # options that change no result, with a value
_FLAGS = "--json", "--quiet", "-q", "--debug"


def parse_shard(text: str | None) -> "ShardIndex | None":
    """The shard that ``--shard`` names; None: there is none."""
    from ..jobs.executors import ShardIndex

    if text is None:
        return None
    match = _SHARD.fullmatch(text.strip())
    index, of = (int(n) for n in match.groups()) if match else (0, 0)
    if not index < of:
        raise InputError(f"--shard is {text!r}; write I/N with I from 0 and below N, such as 0/4")
    return ShardIndex(index, of)


def shards_folder(output: Path) -> Path:
    """The folder of shards beside an output."""
    stem = output.name.removesuffix(output.suffix)
    return output.with_name(f"{_NUMBER.sub('', stem) or 'frames'}.shards")


def command_words() -> list[str]:
    """The words of the command that decide its results."""
    words, remaining = [], iter(command_line.get())
    for word in remaining:
        name = word.partition("=")[0]
        if name in _VALUED:
            if "=" not in word:
                next(remaining, None)
        elif word not in _FLAGS:
            words.append(word)
    return words


def engine_for(args: Any, output: Path) -> "Executor | None":
    """The engine that the options --shard, --ray and --merge ask for; None if there are none.

    given : arguments with the fields `shard`, `ray` and `merge`
    output : a file or a folder; shards are kept beside it
    """
    from ..jobs.executors import ShardExecutor
    from ..jobs.work_parts import ShardMerge

    share, folder = parse_shard(args.shard), shards_folder(output)
    if (collector := node_engine.get()) is not None:
        return collector
    if args.merge:
        return ShardMerge(folder, args.merge)
    if args.ray is not None:
        from ..cluster.node_files import files_in
        from ..cluster.ray_executor import Cluster

        if share is not None:
            raise InputError("--ray makes shards of its own; leave it or --shard out")
        prepare = partial(begin, type(args).home, replace(args, json=False, quiet=True, ray=None))
        plan = getattr(args, "plan", None)
        say = (lambda line: None) if args.quiet else None
        return Cluster(folder, args.ray, prepare, files_in(vars(args)), plan, say)
    return None if share is None else ShardExecutor(folder, share, command_words())


def begin(home: tuple[str, str], args: Any, paths: dict[str, str], threads: int, engine: "UnitCollector") -> None:
    """Begin a command on a node of a cluster: the engine gets its units. Results have their names, in this folder.

    home : module and name of the command
    paths : field -> the path of its file on this node
    """
    from ..cluster.node_files import with_files

    changed: dict[str, Any] = {name: None for name in _LEFT_OUT if hasattr(args, name)}
    for name in _OUTPUTS:
        value = getattr(args, name, None)
        if value is not None:
            changed[name] = [Path(path.name) for path in value] if isinstance(value, list) else Path(value.name)
    changed |= with_files(vars(args), paths)
    token = node_engine.set(engine)
    try:
        command = getattr(import_module(home[0]), home[1]).command
        command(replace(args, threads=args.threads or threads, **changed))
    finally:
        node_engine.reset(token)


def report_shard(shard: "Executor | None", args: Any, seconds: float) -> int:
    """Say what a shard did, which wrote no results; return the exit code."""
    from ..jobs.executors import ShardExecutor

    if not isinstance(shard, ShardExecutor):  # on a node of a cluster
        return 0
    if args.json:
        answer = {"shard": str(shard.share), "folder": str(shard.folder), "parts": shard.units, "done": shard.did}
        console.print_json({**answer, "seconds": seconds})
    elif not args.quiet:
        before = f", {shard.units - shard.did:,} were done before" if shard.did < shard.units else ""
        rows = [("shard", f"{shard.share}: {shard.units:,} parts{before}"), ("time", console.duration(seconds))]
        console.print_fields([*rows, ("next", f"when all shards are done: antumbra merge {shard.folder}")])
    return 0


# --- ``antumbra merge``: the results of a command from the shards of several processes --------------------------------


def merge(
    context: typer.Context,
    folders: Annotated[list[Path], typer.Argument(help="Folders NAME.shards that --shard made.", metavar="FOLDER...")],
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Join the shards of a command: write the files that it writes without --shard, byte by byte.

    Each FOLDER says which command made it. The same command runs once more, in the current folder, and takes what the
    shards found instead of tracing rays. A shard that is missing, doubled, stale, or of another command is an error
    that names it, and no file is written then.

    \b
    Examples
      antumbra merge city.shards
      antumbra merge node1/city.shards node2/city.shards
    """
    from ..jobs.executors import read_job

    command = read_job(folders[0]).command
    more = [word for folder in folders for word in ("--merge", str(folder))]
    words = [*command, *more, *(["--json"] * json), *(["--quiet"] * quiet)]
    code = context.find_root().command.main(words, prog_name="antumbra", standalone_mode=False)
    return code if isinstance(code, int) else 0
