"""Work split among processes: the options --shard, --ray and --merge, shard folders, and ``antumbra merge``."""

import os
import re
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from ..base.errors import InputError
from ..base.remote_files import without_urls
from ..base.wording import counted
from ..work.result_summary import duration
from . import console
from .command_parsing import parsed_words
from .options import Json, Quiet, outputs_of

# --- The options and their executors ----------------------------------------------------------------------------------


if TYPE_CHECKING:
    from ..cluster.ray_workers import Prepare
    from ..work.executors import Executor, ShardIndex

ShardOption = Annotated[
    str | None,
    typer.Option(
        "--shard",
        help="Do only shard I of N, 0 to N-1; other processes do the rest, and antumbra merge joins them. auto or "
        "auto/N: the scheduler's I, of SLURM arrays and indexed jobs of Kubernetes.",
        metavar="I/N|auto",
        show_default=False,
    ),
]
RayOption = Annotated[
    str | None,
    typer.Option(
        "--ray",
        help="Run on a Ray cluster: auto, HOST:PORT, or local (this machine alone).",
        metavar="ADDRESS|local",
        show_default=False,
    ),
]
MergeOption = Annotated[list[Path] | None, typer.Option("--merge", hidden=True)]  # from ``antumbra merge``

_Arguments = TypeVar("_Arguments")

_SHARD = re.compile(r"(\d{1,9}|auto)/(\d{1,9})")
_SCHEDULERS = (
    ("SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_COUNT", "SLURM_ARRAY_TASK_MIN"),
    ("JOB_COMPLETION_INDEX", "", ""),
)
"""Variables of schedulers: the number of a task, the number of tasks, and the first task; empty: there is none."""
_NUMBER = re.compile(r"[^0-9A-Za-z]*#+$")  # frame number at the end of a name
_NEUTRAL = "--ray", "--shard", "--merge", "--threads", "--json", "--quiet"  # options that do not affect results


def parse_shard(text: str | None) -> "ShardIndex | None":
    """The shard that ``--shard`` names; None without the option."""
    from ..work.executors import ShardIndex

    if text is None:
        return None
    match = _SHARD.fullmatch(text.strip())
    if text.strip() == "auto" or (match and match[1] == "auto"):
        return ShardIndex(*_scheduled(match[2] if match else None))
    index, of = (int(n) for n in match.groups()) if match else (0, 0)
    if not index < of:
        raise InputError(f"--shard is {text!r}; write I/N with 0 <= I < N, such as 0/4, or auto")
    return ShardIndex(index, of)


def _scheduled(number: str | None) -> tuple[int, int]:
    """(I, N) of this task of a scheduler; `number`: N, whose tasks count from 0. None: that of the scheduler."""
    name, count, first = next((names for names in _SCHEDULERS if names[0] in os.environ), ("", "", ""))
    if not name:
        raise InputError(f"--shard is auto, and none of {', '.join(n for n, *_ in _SCHEDULERS)} is set; write I/N")
    index, of = _variable(name), _variable(count) if number is None and count else int(number or 0)
    if not of:
        raise InputError(f"--shard is auto, and {name} has no number of tasks; write auto/N")
    if number is None and first in os.environ:
        index -= _variable(first)
    if not 0 <= index < of:
        raise InputError(
            f"--shard is auto, and {name} is task {_variable(name)} of {of}; number the tasks 0 to {of - 1}"
        )
    return index, of


def _variable(name: str) -> int:
    value = os.environ.get(name, "")
    if not value.isdecimal():
        raise InputError(f"{name} is {value!r}; it must be a whole number")
    return int(value)


def shards_folder(output: Path) -> Path:
    """The shard folder next to an output."""
    from ..work.executors import SHARDS

    stem = output.name.removesuffix(output.suffix)
    return output.with_name(f"{_NUMBER.sub('', stem) or 'frames'}{SHARDS}")


def command_words() -> list[str]:
    """The words of the command that determine the results."""
    return [word for word in parsed_words.get() if word.partition("=")[0] not in _NEUTRAL]


def executor_for(
    args: Any, output: Path, start: "Prepare", inputs: Mapping[str, Any], plan: str | None
) -> "Executor | None":
    """The executor for the options --shard, --ray and --merge; None without them.

    args : arguments with the fields `shard`, `ray`, `merge` and `quiet`
    output : a file or folder; shards are stored next to it
    start : starts the work on a node of a cluster
    inputs : name -> value of all arguments and options, some of which name files
    plan : plan whose kernels nodes compile first; None: the default
    """
    from ..work.executors import ShardExecutor
    from ..work.work_parts import ShardMerge

    share, folder = parse_shard(args.shard), shards_folder(output)
    if args.merge:
        return ShardMerge(folder, args.merge)
    if args.ray is not None:
        from ..cluster.node_files import files_in
        from ..cluster.ray_executor import Cluster

        if share is not None:
            raise InputError("--ray splits the work itself; leave it or --shard out")
        say = (lambda line: None) if args.quiet else None
        return Cluster(folder, args.ray, start, files_in(inputs), plan, say, "the same command resumes from there")
    return None if share is None else ShardExecutor(folder, share, command_words())


def for_node(args: _Arguments, paths: Mapping[str, str]) -> _Arguments:
    """Arguments for a node of a cluster, whose results go to its current folder.

    paths : name of an argument -> path of its file on the node
    """
    from ..cluster.node_files import with_files

    given: Any = args
    values = {name: getattr(given, name) for name in outputs_of(type(given))}
    outputs = {name: [Path(path.name) for path in value] if isinstance(value, list) else Path(value.name)
               for name, value in values.items() if value is not None}  # fmt: skip
    changed: _Arguments = replace(given, **outputs | with_files(vars(given), paths))
    return changed


def report_shard(shard: "Executor | None", args: Any, seconds: float) -> int:
    """Report what a shard did, since it wrote no results; return the exit code."""
    from ..work.executors import ShardExecutor

    assert isinstance(shard, ShardExecutor)  # all others finish the work
    if args.json:
        answer = {"shard": str(shard.share), "folder": str(shard.folder), "parts": shard.units, "done": shard.did}
        console.print_json({**answer, "seconds": seconds})
    elif not args.quiet:
        before = f", {shard.units - shard.did:,} were already done" if shard.did < shard.units else ""
        rows = [("shard", f"{shard.share}: {counted(shard.units, 'part')}{before}"), ("time", duration(seconds))]
        console.print_fields([*rows, ("next", f"when all shards are done: antumbra merge {shard.folder}")])
    return 0


# --- ``antumbra merge`` -----------------------------------------------------------------------------------------------


def merge(
    context: typer.Context,
    folders: Annotated[list[Path], typer.Argument(help="Folders NAME.shards written by --shard.", metavar="FOLDER...")],
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Join the shards of a command.

    It writes the files that the command would have written without --shard, byte for byte. Each FOLDER records its
    command, which runs again in the current folder, with the results of the shards instead of traced rays. If a shard
    is missing, duplicated, stale, or from another command, an error names it, and no file is written. While shards are
    missing, the exit code is 75: try again.

    \b
    Examples
      antumbra merge city.shards
      antumbra merge node1/city.shards node2/city.shards
    """
    from ..work.executors import read_shard_record

    command = read_shard_record(folders[0]).command
    more = [word for folder in folders for word in ("--merge", str(folder))]
    words = [*command, *more, *(["--json"] * json), *(["--quiet"] * quiet)]
    again = f"as the record in {folders[0]} says; if you wrote it, repeat its command with {shlex.join(more)}"
    with without_urls(again):
        code = context.find_root().command.main(words, prog_name="antumbra", standalone_mode=False)
    return code if isinstance(code, int) else 0
