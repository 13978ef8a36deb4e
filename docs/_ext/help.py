"""``{command-help} render``: what ``antumbra render --help`` explains, in lists that fit the width of any screen.

Each option has an anchor and a link to itself, such as cli/render.html#spp. Without a command, the program's commands
are listed, and linked to their pages.
"""

import re
from functools import cache
from typing import NamedTuple

import typer
from docutils import nodes
from sphinx import addnodes
from sphinx.util.docutils import SphinxDirective

from antumbra.cli.app import program
from antumbra.cli.command_help import MAIN

SHOWN = 2
"""Examples that come first, as in the help of ``-h``."""

_WIDE = 10_000  # columns, so that each option and each paragraph is one line
_NAME = re.compile(r"(?:-\w, )?--([\w-]+)")  # at the beginning of an option
_OPTION = re.compile(r"(?<![\w-])--([a-z][\w-]+)")
_LIMITS = re.compile(r"((?:\s+\[[^][]+\])+)$")


@cache
def help_text(*command: str) -> str:
    """What ``antumbra COMMAND --help`` prints, in a terminal of any width."""
    group = typer.main.get_command(program(frozenset(command[:1])))
    context = typer.Context(group, info_name="antumbra", terminal_width=_WIDE, **group.context_settings)
    for name in command:
        child = context.command.get_command(context, name)
        if child is None:
            raise LookupError(name)
        context = typer.Context(child, info_name=name, parent=context, **child.context_settings)
    return re.sub(r"\x1b\[\d*m", "", context.get_help()).rstrip()


def records_of(lines: list[str]) -> list[tuple[str, str]]:
    """(name, text) of each line in two columns; a line that is indented further continues the text of the last one."""
    records = list[tuple[str, str]]()
    first = len(lines[0]) - len(lines[0].lstrip())
    for line in lines:
        if line[: first + 1].isspace() and records:
            records[-1] = records[-1][0], f"{records[-1][1]} {line.strip()}".strip()
        else:
            name, _, text = re.sub(r"\s{2,}", "\t", line.strip(), count=1).partition("\t")
            records.append((name, text))
    return records


class Parts(NamedTuple):
    """The parts of a command's help, in the order of its page."""

    first: list[str]  # the text, with two examples, and the main options
    details: list[str]  # how values are written, and more examples
    last: list[str]  # all other options


def ordered(parts: list[str]) -> Parts:
    """The parts of a command's help in an order that shows first what the command does, an example and its options."""
    texts = [part for part in parts if part.startswith(" ")]
    groups = [part for part in parts if not part.startswith(" ")]
    main = [part for part in groups if part.partition(":")[0] in MAIN]
    titled = next((k for k, part in enumerate(texts) if "\n" in part), len(texts))
    first, details = texts[:titled], []
    for part in texts[titled:]:
        title, *lines = part.split("\n")
        if title.strip() != "Examples":
            details.append(part)
            continue
        first.insert(1, "\n".join([title, *lines[:SHOWN]]))
        details += ["\n".join(["  More examples", *lines[SHOWN:]])] if len(lines) > SHOWN else []
    return Parts([*first, *main], details, [part for part in groups if part not in main])


class CommandHelp(SphinxDirective):
    """The help of a command, or of the program itself without an argument."""

    optional_arguments = 2

    def run(self):
        try:
            usage, *parts = help_text(*self.arguments).split("\n\n")
        except LookupError as error:
            raise self.error(f"no command {error}") from None
        self.prefix = "-".join([*self.arguments[1:], ""])  # of anchors: subcommands share a page
        names = re.findall(rf"^  {_NAME.pattern}", "\n".join(parts), re.MULTILINE)
        self.anchors = {name: f"{self.prefix}{name}" for name in names}
        command = usage.removeprefix("Usage: ")
        found = [nodes.paragraph("", "", nodes.literal("", command), classes=["usage"])]
        parts = ordered(parts) if self.arguments else Parts(parts, [], [])
        for part in parts.first:
            found += self._shown(part)
        if parts.details:
            section = nodes.section(ids=[f"{self.prefix}details"])
            section += nodes.title("", "Details")
            for part in parts.details:
                section += self._shown(part)
            found.append(section)
        for part in parts.last:
            found += self._shown(part)
        if len(self.arguments) < 2:
            return found
        section = nodes.section(ids=[self.prefix.rstrip("-")])
        section += [nodes.title("", f"antumbra {' '.join(self.arguments)}"), *found]
        return [section]

    def _shown(self, part: str) -> list[nodes.Node]:
        return self._paragraphs(part) if part.startswith(" ") else [self._group(part)]

    def _paragraphs(self, part: str) -> list[nodes.Node]:
        """A part of the description: a paragraph, or lines below a title, such as examples."""
        title, *lines = [line.removeprefix("  ") for line in part.split("\n")]
        if not lines or not all(line.startswith(" ") for line in lines):
            return [nodes.paragraph("", "", *self._words(line.strip())) for line in (title, *lines)]
        records = records_of(lines)
        if any(text for _, text in records):
            return [nodes.rubric("", title), self._list(records)]
        code = "\n".join(line.strip() for line in lines)
        language = "sh" if code.startswith("antumbra") else "text"
        return [nodes.rubric("", title), nodes.literal_block(code, code, language=language)]

    def _group(self, part: str) -> nodes.section:
        """A group of options, or of commands."""
        title, *lines = part.split("\n")
        name = title.removesuffix(":")
        section = nodes.section(ids=[f"{self.prefix}{nodes.make_id(name)}-group"])
        records = records_of(lines)
        if name == "Commands":  # whole sentences, where the list of a terminal ends at the first full stop
            records = [(each, help_text(*self.arguments, each).split("\n\n")[1].strip()) for each, _ in records]
            self.anchors |= {each: each for each, _ in records}
        section += [nodes.title("", name), self._list(records)]
        return section

    def _list(self, records: list[tuple[str, str]]) -> nodes.definition_list:
        items = [nodes.definition_list_item("", self._term(name), self._meaning(text)) for name, text in records]
        return nodes.definition_list("", *items, classes=["options"])

    def _term(self, names: str) -> nodes.term:
        literal, match = nodes.literal("", names), _NAME.match(names)
        if match:
            anchor = self.anchors[match[1]]
            return nodes.term("", "", nodes.reference("", "", literal, refuri=f"#{anchor}"), ids=[anchor])
        if names in self.anchors:  # a subcommand, which has a section below
            return nodes.term("", "", nodes.reference("", "", literal, refuri=f"#{names}"))
        if not self.arguments and names.islower():
            page = {"refdomain": "std", "reftype": "doc", "reftarget": f"/cli/{names}", "refexplicit": True}
            return nodes.term("", "", addnodes.pending_xref("", literal, refdoc=self.env.docname, **page))
        return nodes.term("", "", literal)

    def _meaning(self, text: str) -> nodes.definition:
        """The help of an option, with its default and limits set apart."""
        limits = _LIMITS.search(text)
        paragraph = nodes.paragraph("", "", *self._words(_LIMITS.sub("", text)))
        if limits:
            words = "; ".join(re.findall(r"\[([^][]+)\]", limits[1]))
            paragraph += [nodes.Text(" "), nodes.inline("", words, classes=["limits"])]
        return nodes.definition("", paragraph)

    def _words(self, text: str) -> list[nodes.Node]:
        """A text in which options of this command are links."""
        parts, end = list[nodes.Node](), 0
        for match in _OPTION.finditer(text):
            literal = nodes.literal("", match[0], classes=["option"])
            anchor = self.anchors.get(match[1])
            link = literal if anchor is None else nodes.reference("", "", literal, refuri=f"#{anchor}")
            parts += [nodes.Text(text[end : match.start()]), link]
            end = match.end()
        return [*parts, nodes.Text(text[end:])]


def setup(app):
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True}
