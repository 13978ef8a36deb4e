"""Options that name files or folders to write. Each is checked while the command line is read, before any work.

An option says what it writes where it is declared: ``typer.Option(..., callback=writes(".png"))``. So no command can
forget the check. What depends on other arguments, such as a name by default, is checked by the command.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from ..errors import InputError

_GIVEN = "antumbra.outputs"  # in the context of the command: the outputs so far


def writes(*suffixes: str | Callable[[], Any]) -> Callable:
    """The callback of an option that names a file, or several.

    suffixes : in lower case, or a function that gives some: it can import modules that are slow to import
    """

    def check(path: Path) -> None:
        from ..output import checked_output

        allowed: list[str] = []
        for each in suffixes:
            allowed += [each] if isinstance(each, str) else each()
        checked_output(path, allowed)

    return _callback(check)


def writes_folder() -> Callable:
    """The callback of an option that names a folder to write in, which is made if it is missing."""

    def check(path: Path) -> None:
        from ..output import checked_folder

        checked_folder(path)

    return _callback(check)


def tables() -> list[str]:
    """Suffixes of tables."""
    from ..jobs.formats import WRITERS

    return list(WRITERS)


def pictures() -> list[str]:
    """Suffixes of pictures."""
    from ..image.save import SUFFIXES

    return list(SUFFIXES)


def films() -> list[str]:
    """Suffixes of films."""
    from ..image.film import SUFFIXES

    return list(SUFFIXES)


def _callback(check: Callable[[Path], None]) -> Callable:
    def run(context: typer.Context, value: Any) -> Any:
        if value is not None and not context.resilient_parsing:
            for path in value if isinstance(value, (list, tuple)) else [value]:
                check(path)
                _once(context, path)
        return value

    written: Any = run
    written.writes = True  # for tests
    return run


def _once(context: typer.Context, path: Path) -> None:
    """Raise an InputError if two options, or one option twice, name the same file."""
    given, real = context.meta.setdefault(_GIVEN, set()), os.path.realpath(path)
    if real in given:
        raise InputError(f"{path}: is named twice; give each output a name of its own")
    given.add(real)
