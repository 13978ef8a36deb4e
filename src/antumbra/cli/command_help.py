"""The help of commands: ``-h`` lists the main options on one line each, ``--help`` explains all of them, in groups.

Help is plain text without Rich, whose import takes long; a terminal shows its titles in bold.
"""

import re
import sys
import textwrap
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from ..base.command_registry import COMMANDS
from .command_parsing import ParsedOnce
from .console import BOLD, is_coloured, styled

PANELS: dict[str, tuple[str, ...]] = {
    "Arguments": (),
    "Options": (),
    "Picture": ("camera", "size", "preset"),
    "Light": ("light", "sky", "ao", "vpl", "exposure"),
    "Output": ("output", "html", "json", "quiet"),
    "Map": ("map", "sheet", "column"),
    "Quality": (),
    "Animation": ("frames", "fps", "overwrite", "camera_path"),
    "Scene": ("up", "trees"),
    "Place": ("crs", "latitude", "longitude", "north", "timezone", "curvature", "refraction", "earth_radius"),
    "Speed": ("plan", "explain_plan", "srdh_rays"),
    "Machines": ("shard", "ray", "merge"),
}
"""Title -> its parameters, besides those that name a title themselves. All others are listed under "Options"."""

MAIN = "Arguments", "Options", "Picture", "Light", "Output"
"""The titles that -h lists."""

_WIDEST = 28  # most columns for the names of options in the help of -h
_LEAST = 12  # least number of options that are grouped
_SHORT = "-h"
_NAMES = {
    "path": "FILE",
    "Path": "FILE",
    "str": "TEXT",
    "int": "N",
    "int range": "N",
    "float": "NUMBER",
    "float range": "NUMBER",
}
"""Type of Python -> the name of such a value in help."""
_VALUES = {
    "plan": "PLAN",
    "sensors": "SENSORS",
    "column": "NAME",
    "crs": "CRS",
    "timezone": "ZONE",
    "step": "MINUTES",
    "time": "SECONDS",
    **dict.fromkeys(("north", "latitude", "longitude"), "DEGREES"),
    **dict.fromkeys(("host", "allow_host"), "HOST"),
    **dict.fromkeys(("object", "culler"), "NAME"),
    **dict.fromkeys(("spacing", "eye_height", "earth_radius", "hub_height", "rotor", "radius"), "LENGTH"),
    **dict.fromkeys(("min_distance", "max_distance"), "LENGTH"),
}
"""Option -> the name of its value in the help of every command."""


class Program(ParsedOnce, TyperGroup):
    """The program, whose help lists its commands in groups."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        super().format_help(ctx, _with_bold_titles(formatter))

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        groups: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command = COMMANDS.get(name)
            line = self.commands[name].get_short_help_str(80) if command is None else command.help
            groups.setdefault(command.group if command else "Research", []).append((name, line))
        width = max(map(len, self.list_commands(ctx)))
        for title, rows in groups.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), line) for name, line in rows])


class HelpfulCommand(ParsedOnce, TyperCommand):
    """A command, whose help groups its options if there are many."""

    def get_help_option_names(self, ctx: Any) -> list[str]:
        return ["--help"]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        words = args[: args.index("--")] if "--" in args else args
        if _SHORT in words and not ctx.resilient_parsing:
            print(self.short_help_text(ctx))
            raise typer.Exit
        return super().parse_args(ctx, args)

    def get_params(self, ctx: Any) -> list[Any]:
        params = super().get_params(ctx)
        for param in params:
            _name_value(param, ctx)
            if param.name == "help":
                param.help = f"Explain all options; {_SHORT} lists the main ones."
        return params

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        return [re.sub(r"[{}]", "", piece).replace("......", "...") for piece in super().collect_usage_pieces(ctx)]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        super().format_help(ctx, _with_bold_titles(formatter))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        for title, params in self._sections(ctx).items():
            with formatter.section(title):
                formatter.write_dl([(names, _with_words(text)) for names, text in self._records(params, ctx)])

    def short_help_text(self, ctx: Any) -> str:
        """The text of ``-h``: usage, summary, and a line for each of the main options."""
        formatter = _with_bold_titles(ctx.make_formatter())
        self.format_usage(ctx, formatter)
        formatter.write_paragraph()
        text = self.help or ""
        with formatter.indentation():
            formatter.write_text(text.partition("\n\n")[0])
            formatter.write("".join(f"\n  {line}" for line in _examples(text)[:2]) + "\n")
        for title, params in self._sections(ctx).items():
            if title in MAIN:
                with formatter.section(title):
                    _write_lines(formatter, self._records(params, ctx))
        formatter.write(f"\nAll options: {ctx.command_path} --help\n")
        return str(formatter.getvalue()).rstrip("\n")

    def _sections(self, ctx: Any) -> dict[str, list[Any]]:
        """Title -> its parameters, in the order of the help."""
        params = self.get_params(ctx)
        grouped = sum(param.param_type_name == "option" for param in params) >= _LEAST
        sections: dict[str, list[Any]] = {title: [] for title in PANELS}
        for param in params:
            sections[_title(param) if grouped or param.param_type_name == "argument" else "Options"].append(param)
        if [param.name for param in sections["Options"]] == ["help"]:
            sections["Output"] += sections.pop("Options")
        return {title: params for title, params in sections.items() if params}

    def _records(self, params: list[Any], ctx: Any) -> list[tuple[str, str]]:
        """The names, and the help, of parameters that are not hidden; arguments without their types."""
        records = [(param.param_type_name, param.get_help_record(ctx)) for param in params]
        return [
            (names.partition(" ")[0] if kind == "argument" else names, text)
            for kind, (names, text) in ((kind, record) for kind, record in records if record is not None)
        ]


def _title(param: Any) -> str:
    if param.param_type_name == "argument":
        return "Arguments"
    panel = getattr(param, "rich_help_panel", None)
    return panel or next((title for title, names in PANELS.items() if param.name in names), "Options")


def _name_value(param: Any, ctx: Any) -> None:
    """Let the help of a parameter name its value as users know it, rather than by a type of Python."""
    if param.metavar is not None or getattr(param, "is_flag", False) or not hasattr(param, "display_type"):
        return
    kind = str(param.display_type(ctx) or "").strip("<>[]{}")
    name = kind.removeprefix("list[").removesuffix("]").removesuffix(" range")
    param.metavar = _VALUES.get(param.name) or _NAMES.get(name, name if "|" in name else None)


def _with_words(text: str) -> str:
    """The help of an option, with limits in words, 0 to 9 for 0<=x<=9, whole numbers, and one pair of brackets."""
    text = re.sub(r"\]\s+\[(?=[^][]*\]$)", "; ", text)
    text = re.sub(r"(\[default: -?\d+)\.0\b", r"\1", text)
    text = re.sub(r"([-\d.e+]+)<=x<=([-\d.e+]+)", r"\1 to \2", text)
    return re.sub(r"\bx>=([-\d.e+]+)", r"at least \1", text)


def _examples(text: str) -> list[str]:
    """The examples in the text of a command."""
    return re.findall(r"^ +(antumbra .*)$", text, re.M)


# --- Layout -----------------------------------------------------------------------------------------------------------


def _with_bold_titles(formatter: Any) -> Any:
    """A formatter of help whose titles are bold in a terminal."""
    bold = is_coloured(sys.stdout)

    def write_heading(heading: str) -> None:
        formatter.write(" " * formatter.current_indent + styled(f"{heading}:", BOLD, bold) + "\n")

    formatter.write_heading = write_heading
    return formatter


def _write_lines(formatter: Any, records: list[tuple[str, str]]) -> None:
    """Write options on a line each: their names, and the beginning of their help."""
    column = min(max(len(names) for names, _ in records), _WIDEST)
    for names, text in records:
        room = formatter.width - 4 - max(column, len(names))
        formatter.write(f"  {names:{column}}  {_cut(_first_sentence(text), room)}\n")


def _first_sentence(text: str) -> str:
    """The first sentence of an option's help, without its default and limits."""
    text = re.sub(r"\s+\[[^][]*\]$", "", " ".join(text.split()))
    return re.split(r"(?<=[a-z0-9)])\. ", text)[0].rstrip(".")


def _cut(text: str, room: int) -> str:
    """A text that fits, cut after a clause or an item of a list if there is one."""
    short = textwrap.shorten(text, room, placeholder=" …")
    if short == text:
        return text
    clause = max(short.rfind(mark) for mark in (", ", "; ", ": "))
    return f"{short[: clause + 1]} …" if clause > 0 else short
