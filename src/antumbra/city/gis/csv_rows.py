"""Checks of CSV files that would be read without an error, but wrongly: decimal commas, and repeated columns."""

from collections.abc import Sequence

from ...base.errors import InputError
from ...base.wording import counted


def check_header(names: Sequence[str], file: str) -> None:
    """Raise an InputError if two columns have the same name."""
    twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if twice is not None:
        raise InputError(f"{file}: has two columns {twice!r}; rename one")


def check_fields(count: int, expected: int, line: int, file: str) -> None:
    """Raise an InputError if a line has more fields than the header, as lines with decimal commas have."""
    if count > expected:
        raise InputError(
            f"{file}, line {line}: has {counted(count, 'field')}, and the header {expected}; write decimal points, not "
            "commas, and quote texts with commas"
        )
