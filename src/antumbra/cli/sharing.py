"""``--shard`` and ``merge``: the engine that a command's options ask for, and the folder where it keeps its shards."""

import re
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InputError
from . import report

if TYPE_CHECKING:
    from ..jobs.engines import Engine, Share

ShardOption = Annotated[
    str | None,
    typer.Option(
        "--shard",
        help="Do shard I of N only, 0 to N-1; other processes do the others, and antumbra merge joins them.",
        metavar="I/N",
        show_default=False,
    ),
]
MergeOption = Annotated[list[Path] | None, typer.Option("--merge", hidden=True)]  # from ``antumbra merge``

words: ContextVar[tuple[str, ...]] = ContextVar("words", default=())
"""The words of the command line."""

_SHARD = re.compile(r"(\d{1,9})/(\d{1,9})")
_NUMBER = re.compile(r"[^0-9A-Za-z]*#+$")  # that of a frame, at the end of a name
_VALUED = "--shard", "--merge", "--threads"  # options that change no result, with a value
_FLAGS = "--json", "--quiet", "-q", "--debug"


def parse_shard(text: str | None) -> "Share | None":
    """The shard that ``--shard`` names; None: there is none."""
    from ..jobs.engines import Share

    if text is None:
        return None
    match = _SHARD.fullmatch(text.strip())
    index, of = (int(n) for n in match.groups()) if match else (0, 0)
    if not index < of:
        raise InputError(f"--shard is {text!r}; write I/N with I from 0 and below N, such as 0/4")
    return Share(index, of)


def shards_folder(output: Path) -> Path:
    """The folder of shards beside an output."""
    stem = output.name.removesuffix(output.suffix)
    return output.with_name(f"{_NUMBER.sub('', stem) or 'frames'}.shards")


def command_words() -> list[str]:
    """The words of the command that decide its results."""
    found, rest = [], iter(words.get())
    for word in rest:
        name = word.partition("=")[0]
        if name in _VALUED:
            if "=" not in word:
                next(rest, None)
        elif word not in _FLAGS:
            found.append(word)
    return found


def engine_for(given: Any, output: Path) -> "Engine | None":
    """The engine that the options --shard and --merge ask for; None if there are none.

    given : arguments with the fields `shard` and `merge`
    output : a file or a folder; shards are kept beside it
    """
    from ..jobs.engines import Shard
    from ..jobs.merging import Merge

    share, folder = parse_shard(given.shard), shards_folder(output)
    if given.merge:
        return Merge(folder, given.merge)
    return None if share is None else Shard(folder, share, command_words())


def tell_shard(shard: "Engine | None", given: Any, seconds: float) -> int:
    """Say what a shard did, which wrote no results; return the exit code."""
    from ..jobs.engines import Shard

    assert isinstance(shard, Shard)
    if given.json:
        found = {"shard": str(shard.share), "folder": str(shard.folder), "parts": shard.units, "done": shard.did}
        report.print_json({**found, "seconds": seconds})
    elif not given.quiet:
        before = f", {shard.units - shard.did:,} were done before" if shard.did < shard.units else ""
        rows = [("shard", f"{shard.share}: {shard.units:,} parts{before}"), ("time", report.duration(seconds))]
        report.print_fields([*rows, ("next", f"when all shards are done: antumbra merge {shard.folder}")])
    return 0
