"""``antumbra merge``: the results of a command from the shards of several processes."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Json, Quiet


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
    from ..jobs.engines import read_job

    command = read_job(folders[0]).command
    more = [word for folder in folders for word in ("--merge", str(folder))]
    words = [*command, *more, *(["--json"] * json), *(["--quiet"] * quiet)]
    code = context.find_root().command.main(words, prog_name="antumbra", standalone_mode=False)
    return code if isinstance(code, int) else 0
