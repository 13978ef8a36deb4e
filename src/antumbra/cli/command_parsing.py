"""Parsing of command lines: each option once, unless it is a list; values are converted late."""

import os
from collections.abc import Callable
from contextvars import ContextVar
from enum import Enum
from pathlib import Path
from typing import Any

from ..base.errors import InputError
from .console import broken_pipes
from .interruption import set_working

parsed_words: ContextVar[tuple[str, ...]] = ContextVar("words", default=())
"""The words of the command in one form, whatever the order of its options and the spelling of their values."""


class ParsedOnce:
    """A command that refuses an option given twice, and converts only values that need it.

    Typer keeps the last value of an option that takes one, and imports pydantic to convert values, which is slow.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        given, _, order = self.make_parser(ctx).parse_args(args=list(args))  # type: ignore[attr-defined]
        for param in order:
            if param.param_type_name == "option" and not param.multiple and order.count(param) > 1:
                raise InputError(_repeated(param))
        parsed_words.set((ctx.info_name, *_words_of(self.params, given)))  # type: ignore[attr-defined]
        rest: list[str] = super().parse_args(ctx, args)  # type: ignore[misc]
        return rest

    def make_context(self, *words: Any, **more: Any) -> Any:
        with broken_pipes():
            return super().make_context(*words, **more)  # type: ignore[misc]

    def invoke(self, ctx: Any) -> Any:
        set_working(True)
        with broken_pipes():
            return super().invoke(ctx)  # type: ignore[misc]

    def get_params(self, ctx: Any) -> list[Any]:
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if "process_value" not in vars(param):
                param.process_value = _late_conversion(param)
        return params


def _repeated(param: Any) -> str:
    """The error about an option that is given twice and is not a list."""
    if param.secondary_opts:
        return f"{param.opts[0]} or {param.secondary_opts[0]} is given twice; decide for one of them"
    return f"{param.opts[0]} is given twice; {'once is enough' if param.is_flag else 'it takes one value'}"


def _words_of(params: list[Any], given: dict[str, Any]) -> list[str]:
    """The words of a command: its arguments, then its options in the order of the help, without those at their default.

    given : name of a parameter -> its text, or texts
    """
    arguments, options = list[str](), list[str]()
    for param in params:
        value, default = given.get(param.name), param.default
        texts = [_normal(param, each) for each in (value if isinstance(value, (list, tuple)) else [value])]
        if value is None or texts == [_normal(param, default.value if isinstance(default, Enum) else default)]:
            continue
        if param.param_type_name == "argument":
            arguments += texts
        elif param.is_flag:
            options.append((param.opts if value else param.secondary_opts)[0])
        else:
            options += [f"{param.opts[0]}={text}" for text in texts]
    return arguments + options


def _normal(param: Any, value: Any) -> str:
    """The text of a value, in one spelling."""
    kind = str(getattr(getattr(param, "type_descriptor", None), "annotation", None) or getattr(param, "type", ""))
    text = str(value)
    try:
        if kind in ("<class 'int'>", "<class 'float'>", "INT", "FLOAT"):  # of new and old Typers
            return repr(float(text)).removesuffix(".0")
    except ValueError:
        return text  # the error follows
    return os.path.normpath(text) if Path.__name__ in kind else text


def _late_conversion(param: Any) -> Callable[[Any, Any], Any]:
    """The `process_value` of a parameter that takes its default, and text that is to remain text, as they are."""
    convert, default = param.process_value, param.default
    is_choice = (
        type(getattr(param, "type", None)).__name__ == "Choice"
    )  # older Typers: an enumeration's default is text
    is_text = getattr(getattr(param, "type_descriptor", None), "annotation", None) is str
    is_list = param.multiple or param.nargs != 1

    def process_value(context: Any, value: Any) -> Any:
        is_default = value is default and not is_choice and not (value is None and param.required)
        if not is_default and not (is_text and isinstance(value, str)):
            return convert(context, value)
        value = () if is_list and value is None else value
        return value if param.callback is None else param.callback(context, param, value)

    return process_value
