"""Options that name files or folders to write. Each is checked while the command line is read, before any work.

An option says what it writes where it is declared: ``typer.Option(..., callback=writes(".png"))``. So no command can
forget the check. What depends on other arguments, such as a name by default, is checked by the command.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import typer

from ..errors import InputError

TABLES = ".csv", ".parquet", ".json", ".npz", ".png", ".glb", ".tif"
"""Suffixes of tables: those of `jobs.formats.WRITERS`, which is slow to import."""

_GIVEN = "antumbra.outputs"  # in the context of the command: the outputs so far


def writes(*suffixes: str | Callable[[], Any]) -> Callable:
    """The callback of an option that names a file, or several.

    suffixes : in lower case, or a function that gives some: it can import modules that are slow to import
    """

    def allowed() -> list[str]:
        return [suffix for each in suffixes for suffix in ([each] if isinstance(each, str) else each())]

    def check(path: Path) -> None:
        from ..output import checked_output

        checked_output(path, allowed())

    return _callback(check, allowed)


def tables(about: str, *names: str, suffixes: Sequence[str] = TABLES, **more: Any) -> Any:
    """An option, which may be repeated, of files of a table. Its help lists what it takes.

    about : what the files hold; names : of the option
    """
    listed = f"{', '.join(suffixes[:-1])} or {suffixes[-1]}"
    help = f"{about}; may be repeated: {listed}."
    return typer.Option(*names, help=help, show_default=False, callback=writes(*suffixes), **more)


def writes_folder() -> Callable:
    """The callback of an option that names a folder to write in, which is made if it is missing."""

    def check(path: Path) -> None:
        from ..output import checked_folder

        checked_folder(path)

    return _callback(check, list)


def pictures() -> list[str]:
    """Suffixes of pictures."""
    from ..picture.image_files import IMAGE_SUFFIXES

    return list(IMAGE_SUFFIXES)


def films() -> list[str]:
    """Suffixes of films."""
    from ..picture.image_files import FILM_SUFFIXES

    return list(FILM_SUFFIXES)


def _callback(check: Callable[[Path], None], allowed: Callable[[], list[str]]) -> Callable:
    def run(context: typer.Context, value: Any) -> Any:
        if value is not None and not context.resilient_parsing:
            for path in value if isinstance(value, (list, tuple)) else [value]:
                check(path)
                _once(context, path)
        return value

    written: Any = run
    written.writes = allowed  # for tests
    return run


def _once(context: typer.Context, path: Path) -> None:
    """Raise an InputError if two options, or one option twice, name the same file."""
    given, real = context.meta.setdefault(_GIVEN, set()), os.path.realpath(path)
    if real in given:
        raise InputError(f"{path}: is named twice; give each output a name of its own")
    given.add(real)
