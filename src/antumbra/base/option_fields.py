"""Options as dataclass fields, from which signatures, docstrings, CLI options, records and digests are derived.

A field is declared by `option`, with its default, its check and its CLI options; its docstring follows it::

    spp: int = option(16, WholeNumber(1, 1024), "Shadow rays per pixel and light.")
    \"\"\"Shadow rays per pixel and light, 1 to 1024.\"\"\"
"""

import inspect
import re
import sys
import textwrap
from collections.abc import Callable
from dataclasses import MISSING, Field, field, fields
from functools import partial, wraps
from types import UnionType
from typing import Any, Concatenate, NamedTuple, ParamSpec, Protocol, TypeAlias, TypeVar

from .checks import choice, number, whole_number
from .field_docs import field_texts

_T = TypeVar("_T")
_K = TypeVar("_K", bound=type)
_P = ParamSpec("_P")
_Q = ParamSpec("_Q")
_R = TypeVar("_R")
_S = TypeVar("_S")
Given: TypeAlias = Callable[_P, dict[str, Any]]
"""The first parameter of functions with `with_keywords`: returns the fields that a call sets. P: those of the class."""

_WIDTH = 116  # of parameter descriptions, as in other docstrings


class Check(Protocol):
    """Function of (value, name) that returns the normalised value, or raises an InputError with the option's name."""

    def __call__(self, value: Any, what: str, /) -> Any: ...


class CommandOption(NamedTuple):
    """A CLI option of commands that sets an option field."""

    help: str
    panel: str | None = None  # title of its group in the help
    kind: Any = None  # type of the CLI value, such as a StrEnum, whose "none" is None; None: the type of the field
    start: Any = MISSING  # default on the command line; MISSING: the default of the field
    note: str = ""  # meaning of a default of None
    metavar: str | None = None
    hides_limit: bool = False  # whether the help omits the upper limit of a number
    commands: tuple[str, ...] = ()  # names of the commands that have it; empty: all that take the options
    name: str = ""  # its own name if several CLI options set the field; "": the name of the field
    is_value: bool = True  # whether the CLI value is the value of the field; otherwise the command computes that


class Option(NamedTuple):
    """The metadata of an option field, besides its type, its default and its docstring."""

    check: Check
    cli_options: tuple[CommandOption, ...] = ()
    decides: bool = True  # whether the result depends on it
    doc_type: str = ""  # the type in docstrings; "": that of the annotation
    origin: type | None = None  # class with the docstring of an option of several classes


def option(
    default: _T, check: Check, help: str = "", *, more: tuple[CommandOption, ...] = (), decides: bool = True,
    doc_type: str = "", **cli: Any,
) -> _T:  # fmt: skip
    """A dataclass field with an `Option`.

    help, cli : of its `CommandOption`; "": the command line does not have it
    more : further CLI options that set the field
    """
    first = (CommandOption(help, **cli),) if help else ()
    metadata = {"option": Option(check, first + more, decides, doc_type)}
    declared: Any = field(default=default, metadata=metadata)
    return declared  # type: ignore[no-any-return]  # type checkers see the default


def same_option(options: type, name: str, default: Any = MISSING, **cli: Any) -> Any:
    """A field like that of another class, with its docstring, unless another follows, and its first CLI option.

    default : instead of the other's
    cli : changes to the `CommandOption`
    """
    original = next(each for each in fields(options) if each.name == name)
    option, start = option_of(original), original.default if default is MISSING else default
    first = option.cli_options[0]._replace(**{"start": MISSING, "commands": (), **cli})
    return field(default=start, metadata={"option": option._replace(cli_options=(first,), origin=options)})


class Choice(NamedTuple):
    """Check of a name."""

    names: tuple[str | None, ...]

    def __call__(self, value: Any, what: str) -> str | None:
        name: str | None = choice(value, what, self.names)
        return name


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
    optional: bool = False  # whether None is valid

    def __call__(self, value: Any, what: str) -> float | None:
        if value is None and self.optional:
            return None
        return number(value, f"{what} ({self.unit})" if self.unit else what, self.low, self.high, self.ends)


def optional(check: Check) -> Check:
    """A check that also allows None."""
    return lambda value, what: None if value is None else check(value, what)


def unchecked(value: Any, what: str) -> Any:
    """No check: the function that receives the value checks it."""
    return value


def option_of(field: Field[Any]) -> Option:
    """The `Option` of a field."""
    option: Option = field.metadata["option"]
    return option


def check_fields(options: Any) -> None:
    """Check all fields of frozen options, and replace their values by the normalised ones."""
    for each in fields(options):
        value = option_of(each).check(getattr(options, each.name), each.name)
        object.__setattr__(options, each.name, value)


def field_values(options: Any) -> dict[str, Any]:
    """Name -> value of all options, in the order of the fields."""
    return {each.name: getattr(options, each.name) for each in fields(options)}


def deciding_fields(options: Any) -> dict[str, Any]:
    """Name -> value of the options on which the result depends, for digests."""
    return {each.name: getattr(options, each.name) for each in fields(options) if option_of(each).decides}


def split_keywords(keywords: dict[str, Any], kind: type) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split keywords into those that are fields of a class, and all others."""
    names = {each.name for each in fields(kind)}
    of_kind = {name: value for name, value in keywords.items() if name in names}
    return of_kind, {name: value for name, value in keywords.items() if name not in names}


def describe_fields(kind: _K) -> _K:
    """Class decorator: append the fields to the docstring's parameters."""
    kind.__doc__ = _doc_with_fields(kind.__doc__, kind)
    return kind


def with_keywords(
    kind: Callable[_P, Any], positional: int
) -> Callable[[Callable[Concatenate[Given[_P], _Q], _R]], Callable[_Q, _R]]:
    """Decorator: replace ``*args, **keywords`` by the fields of `kind`, in a function's type, signature and docstring.

    The function's first parameter, `Given`, ties the fields to `kind` for type checkers, and is dropped::

        @with_keywords(BakeKeywords, 1)
        def bake(given: Given[P], scene, up="y", *args: P.args, **keywords: P.kwargs):
            options = BakeKeywords(**given(*args, **keywords))

    positional : number of the function's own parameters that need no name; all others are keyword-only

    Unknown keywords raise a TypeError, as for any function.
    """

    def wrap(function: Callable[..., Any]) -> Any:
        return _with_fields(function, partial(function, dict), 0, positional, kind)

    return wrap


def method_with_keywords(
    kind: Callable[_P, Any], positional: int
) -> Callable[[Callable[Concatenate[_S, Given[_P], _Q], _R]], Callable[Concatenate[_S, _Q], _R]]:
    """`with_keywords` for a method, whose second parameter is `Given`; `positional` does not count ``self``."""

    def wrap(method: Callable[..., Any]) -> Any:
        return _with_fields(method, lambda self, *a, **k: method(self, dict, *a, **k), 1, positional + 1, kind)

    return wrap


def _with_fields(
    function: Callable[..., Any], call: Callable[..., Any], given: int, positional: int, kind: Any
) -> Callable[..., Any]:
    """A function that runs `call`, with the parameters of `function`, except that at index `given`, and the fields."""
    own = list(inspect.signature(function).parameters.values())[:-2]  # without *args and **keywords
    del own[given]
    own[positional:] = [each.replace(kind=each.KEYWORD_ONLY) for each in own[positional:]]
    known = {each.name for each in own} | {each.name for each in fields(kind)}

    @wraps(function)
    def run(*args: Any, **keywords: Any) -> Any:
        if not keywords.keys() <= known:
            unknown = min(keywords.keys() - known)
            raise TypeError(f"{function.__name__}() got an unexpected keyword argument {unknown!r}")
        if len(args) > positional:
            takes = f"{positional} positional argument{'s' * (positional != 1)}"
            raise TypeError(f"{function.__name__}() takes {takes} but {len(args)} were given")
        return call(*args, **keywords)

    wrapper: Any = run
    wrapper.__doc__ = _doc_with_fields(function.__doc__, kind)
    wrapper.__signature__ = inspect.signature(function).replace(parameters=[*own, *_parameters(kind)])
    return run


def _parameters(kind: type) -> list[inspect.Parameter]:
    """The fields of a class as keyword-only parameters."""
    keyword = inspect.Parameter.KEYWORD_ONLY
    return [inspect.Parameter(f.name, keyword, default=f.default, annotation=f.type) for f in fields(kind)]


def _doc_with_fields(doc: str | None, kind: type) -> str | None:
    """Append the fields of a class to a docstring's section Parameters."""
    if doc is None or sys.flags.optimize >= 2:  # -OO removes docstrings, and dataclasses make up others
        return doc
    lines, texts = inspect.cleandoc(doc).splitlines(), field_texts(kind)
    start = lines.index("Parameters") + 2
    end = next((i for i in range(start, len(lines)) if not lines[i]), len(lines))
    return "\n".join([*lines[:end], *(_field_doc(each, texts) for each in fields(kind)), *lines[end:]])


def _field_doc(field: Field[Any], texts: dict[str, str]) -> str:
    """A field as a parameter in a NumPy docstring."""
    origin = option_of(field).origin
    text = texts.get(field.name) or (field_texts(origin).get(field.name, "") if origin else "")
    text = textwrap.fill(text, _WIDTH, break_long_words=False, break_on_hyphens=False)
    return f"{field.name} : {type_text(field)}\n{textwrap.indent(text, '    ')}"


def type_text(field: Field[Any]) -> str:
    """The type of a field in docstrings: ``int or None``, ``str, Plan or None``, or the names of a choice."""
    option, annotation = option_of(field), field.type
    if option.doc_type:
        return option.doc_type
    if isinstance(option.check, Choice):
        words = ["None" if name is None else f'"{name}"' for name in option.check.names]
    else:
        text = str(annotation) if isinstance(annotation, (str, UnionType)) else annotation.__name__
        words = re.sub(r"(\w+\.)+", "", text).split(" | ")
    return " or ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
