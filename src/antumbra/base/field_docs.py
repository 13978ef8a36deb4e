"""Descriptions of fields for ``help``, from the source: comments in NamedTuples, and docstrings in dataclasses."""

import inspect
import re
from pathlib import Path

_FIELD = re.compile(r"^    (\w+): .*?  # (.+)$", re.MULTILINE)
_DOCUMENTED = re.compile(r'^    (\w+): .*(?:\n(?: {8}| {4}\)).*)*\n    """((?:.|\n)*?)"""', re.MULTILINE)


def describe(cls: type) -> None:
    """Set the docstring of each field of a NamedTuple to its comment. Without the source, this has no effect."""
    cls = next(each for each in cls.__mro__ if "_fields" in vars(each))
    for field, comment in _FIELD.findall(_body(cls)):
        if field in cls._fields:  # type: ignore[attr-defined]
            getattr(cls, field).__doc__ = comment


def field_texts(cls: type) -> dict[str, str]:
    """Name -> docstring of each field of a dataclass and its bases, on one line. Empty without the source."""
    documented = [pair for each in reversed(cls.__mro__) for pair in _DOCUMENTED.findall(_body(each))]
    return {name: " ".join(text.split()) for name, text in documented}


def _body(cls: type) -> str:
    """The source of a class without its header; empty if it cannot be read."""
    try:
        source = Path(inspect.getfile(cls)).read_text(encoding="utf-8")
    except (OSError, TypeError):
        return ""
    after = re.split(rf"^class {cls.__name__}\b.*\n", source, maxsplit=1, flags=re.MULTILINE)[-1]
    return after.partition("\nclass ")[0]
