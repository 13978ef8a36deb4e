"""Options as annotated dataclass fields, from which signatures, docstrings and CLI options are derived.

Each field carries an `Option`: its check, its description, and its CLI options. Records and digests are derived from
the same fields.
"""

import inspect
import textwrap
from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from functools import wraps
from typing import Any, ForwardRef, NamedTuple, TypeVar

from ..checks import flag, number, whole_number

Check = Callable[[Any, str], Any]
"""Function of (value, name) that returns the normalised value, or raises an InputError with the option's name."""

_K = TypeVar("_K", bound=type)
_WIDTH = 116  # of parameter descriptions, as in other docstrings


class CommandOption(NamedTuple):
    """A CLI option of commands that sets an option field."""

    help: str
    panel: str = "Quality"  # title of its group in the help
    kind: Any = None  # type of the CLI value, such as a StrEnum, whose "none" is None; None: the type of the field
    start: Any = MISSING  # default on the command line; MISSING: the default of the field
    note: str = ""  # meaning of a default of None
    metavar: str | None = None
    commands: tuple[str, ...] = ("render", "compare")
    name: str = ""  # its own name if several CLI options set the field; "": the name of the field
    literal: bool = True  # whether the CLI value is the value of the field; otherwise the command computes that


class Option(NamedTuple):
    """The metadata of an option field, besides its type and its default."""

    check: Check
    kind: str  # the type in docstrings
    text: str  # the description in docstrings
    words: tuple[CommandOption, ...] = ()  # CLI options
    decides: bool = True  # whether the picture depends on it


class WholeNumber(NamedTuple):
    """Check of a whole number."""

    low: int
    high: int
    optional: bool = False  # whether None is valid

    def __call__(self, value: Any, what: str) -> int | None:
        return None if value is None and self.optional else whole_number(value, what, self.low, self.high)


class RealNumber(NamedTuple):
    """Check of a number."""

    low: float
    high: float
    ends: str = "()"  # as in `checks.number`
    unit: str = ""

    def __call__(self, value: Any, what: str) -> float:
        return number(value, f"{what} ({self.unit})" if self.unit else what, self.low, self.high, self.ends)


def optional_flag(value: Any, what: str) -> bool | None:
    """Check of True, False or None."""
    return None if value is None else flag(value, what)


def unchecked(value: Any, what: str) -> Any:
    """No check: the function that receives the value checks it."""
    return value


def option_of(field: Field[Any]) -> Option:
    """The `Option` of a field."""
    annotation: Any = field.type
    option: Option = annotation.__metadata__[0]
    return option


def type_of(field: Field[Any]) -> Any:
    """The type of a field; a string if the annotation is one."""
    annotation: Any = field.type
    kind = annotation.__origin__
    return kind.__forward_arg__ if isinstance(kind, ForwardRef) else kind


def check_fields(options: Any) -> None:
    """Check all fields of frozen options, and replace their values by the normalised ones."""
    for field in fields(options):
        value = option_of(field).check(getattr(options, field.name), field.name)
        object.__setattr__(options, field.name, value)


def field_values(options: Any) -> dict[str, Any]:
    """Name -> value of all options, in the order of the fields."""
    return {field.name: getattr(options, field.name) for field in fields(options)}


def deciding_fields(options: Any) -> dict[str, Any]:
    """Name -> value of the options on which the picture depends, for digests."""
    return {field.name: getattr(options, field.name) for field in fields(options) if option_of(field).decides}


def split_keywords(keywords: dict[str, Any], kind: type) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split keywords into those that are fields of a class, and all others."""
    names = {field.name for field in fields(kind)}
    of_kind = {name: value for name, value in keywords.items() if name in names}
    return of_kind, {name: value for name, value in keywords.items() if name not in names}


def describe_fields(kind: _K) -> _K:
    """Class decorator: append the fields to the docstring's parameters."""
    kind.__doc__ = _doc_with_fields(kind.__doc__, kind)
    return kind


def with_keywords(kind: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: replace ``**keywords`` by the fields of `kind`, in a function's signature and docstring.

    Unknown keywords raise a TypeError, as for any function.
    """
    names = {field.name for field in fields(kind)}

    def wrap(function: Callable[..., Any]) -> Any:
        parameters = [p for p in inspect.signature(function).parameters.values() if p.kind is not p.VAR_KEYWORD]
        known = names | {parameter.name for parameter in parameters}

        @wraps(function)
        def run(*args: Any, **keywords: Any) -> Any:
            if not keywords.keys() <= known:
                unknown = min(keywords.keys() - known)
                raise TypeError(f"{function.__name__}() got an unexpected keyword argument {unknown!r}")
            return function(*args, **keywords)

        wrapper: Any = run
        wrapper.__doc__ = _doc_with_fields(function.__doc__, kind)
        wrapper.__signature__ = inspect.signature(function).replace(parameters=[*parameters, *_parameters(kind)])
        return wrapper

    return wrap


def _parameters(kind: type) -> list[inspect.Parameter]:
    """The fields of a class as keyword-only parameters."""
    keyword = inspect.Parameter.KEYWORD_ONLY
    return [inspect.Parameter(f.name, keyword, default=f.default, annotation=type_of(f)) for f in fields(kind)]


def _doc_with_fields(doc: str | None, kind: type) -> str | None:
    """Append the fields of a class to a docstring's section Parameters. None without docstrings (-OO)."""
    if doc is None:
        return None
    lines = inspect.cleandoc(doc).splitlines()
    start = lines.index("Parameters") + 2
    end = next((i for i in range(start, len(lines)) if not lines[i]), len(lines))
    return "\n".join([*lines[:end], *map(_field_doc, fields(kind)), *lines[end:]])


def _field_doc(field: Field[Any]) -> str:
    """A field as a parameter in a NumPy docstring."""
    option = option_of(field)
    text = textwrap.fill(" ".join(option.text.split()), _WIDTH, break_long_words=False, break_on_hyphens=False)
    return f"{field.name} : {option.kind}\n{textwrap.indent(text, '    ')}"
