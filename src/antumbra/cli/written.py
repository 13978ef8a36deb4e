"""Options of commands that are made of the fields of `RenderOptions` and `EngineOptions`."""

from collections.abc import Iterator
from dataclasses import MISSING, Field, field, fields, make_dataclass
from enum import Enum
from typing import Annotated, Any, NamedTuple

import typer

from ..rendering.keywords import Whole, Words, option_of, type_of
from ..rendering.options import RenderKeywords


class Written(NamedTuple):
    """An option of a command."""

    name: str  # of the parameter
    field: Field  # what it sets
    words: Words

    @property
    def start(self) -> Any:
        """The value if nothing is written."""
        return self.field.default if self.words.start is MISSING else self.words.start

    @property
    def kind(self) -> Any:
        """The type of the text."""
        return type_of(self.field) if self.words.kind is None else self.words.kind

    def option(self, start: Any) -> Any:
        """What Typer is told of it."""
        flag, words, check = f"--{self.name.replace('_', '-')}", self.words, option_of(self.field).check
        switch = self.kind in (bool, bool | None)
        low, high = check[:2] if isinstance(check, Whole) and words.kind is None else (None, None)
        return typer.Option(
            f"{flag}/--no-{flag[2:]}" if switch and start is not False else flag,
            help=words.help + (f"  [default: {words.note}]" if start is None and words.note else ""),
            metavar=words.metavar,
            min=low,
            max=high,
            show_default=start is not None,
            rich_help_panel=words.panel,
        )


def all_written(kind: type = RenderKeywords) -> Iterator[Written]:
    """All options of commands that set the fields of a class."""
    for each in fields(kind):
        for words in option_of(each).words:
            yield Written(words.name or each.name, each, words)


def written(name: str, start: Any = None) -> Any:
    """The option of a name for an annotation: ``spp: Annotated[int, written("spp", 16)] = 16``."""
    return next(each for each in all_written() if each.name == name).option(start)


def arguments_of(command: str, kind: type = RenderKeywords, **starts: Any) -> Any:
    """A base class for the arguments of a command, see `options.takes`: a field for each option that it has.

    starts : values if nothing is written, where the command has others
    """
    start = lambda each: starts.get(each.name, each.start)
    own = [each for each in all_written(kind) if command in each.words.commands]
    made = [(each.name, Annotated[each.kind, each.option(start(each))], field(default=start(each))) for each in own]
    return make_dataclass(f"Options of {command}", made, frozen=True, kw_only=True)


def literal(given: Any, kind: type) -> dict[str, Any]:
    """Name -> value of the fields of a class whose options say the value itself, and were written or have a default."""
    found = {each.name: getattr(given, each.name) for each in all_written(kind) if each.words.literal}
    return {name: _value(word) for name, word in found.items() if word is not None}


def _value(word: Any) -> Any:
    """The value for Python of a word."""
    value = word.value if isinstance(word, Enum) else word
    return None if isinstance(word, Enum) and value == "none" else value
