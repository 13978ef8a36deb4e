"""Field docstrings of NamedTuples for ``help``, taken from the comments beside the fields in the source."""

import inspect
import re
from pathlib import Path

_FIELD = re.compile(r"^    (\w+): .*?  # (.+)$", re.MULTILINE)


def describe(cls: type) -> None:
    """Set the docstring of each field of a NamedTuple to its comment. Without the source, this has no effect."""
    cls = next(each for each in cls.__mro__ if "_fields" in vars(each))
    try:
        source = Path(inspect.getfile(cls)).read_text(encoding="utf-8")
    except (OSError, TypeError):
        return
    body = source.partition(f"\nclass {cls.__name__}(")[2].partition("\nclass ")[0]
    for field, comment in _FIELD.findall(body):
        if field in cls._fields:  # type: ignore[attr-defined]
            getattr(cls, field).__doc__ = comment
