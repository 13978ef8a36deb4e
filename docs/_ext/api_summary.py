"""Tables of names in the reference: what each is, in one line, and a link to its description.

The table on top of a page has its names, or those of the pages below it. Rows of names on other pages have the anchors
of these names and of their members, so that an address such as api/scenes.html#antumbra.Scene leads to the row that
links to the page of the class. Members that are documented apart from their class have rows of their own.

``{names} api/scenes`` is a table of all names, with all members, on the pages below one.
"""

import inspect
import re
from importlib import import_module

import registries
from docutils import nodes
from sphinx.util.docutils import SphinxDirective

FOLDER = "api/"
_SENTENCE = re.compile(r".*?[\w)\]`]\.(?=\s+[A-Z`\[]|$)", re.DOTALL)
_TYPE = re.compile(r"(?:\([^)]*\)|int|bool)[\w., ]*: (?=\w)")  # "(n,) float32: ", which begins some docstrings


def summary_of(name: str) -> str:
    """The first sentence of the docstring of a documented name, without the type of a result that begins it."""
    thing = import_module("antumbra")
    for part in name.split(".")[1:]:
        thing = getattr(thing, part, None) or import_module(f"{thing.__name__}.{part}")
    if isinstance(thing, int):
        return f"Constant, {thing}."
    text = " ".join((inspect.getdoc(thing) or "").partition("\n\n")[0].split())
    match = _SENTENCE.match(text)
    sentence = (match[0] if match else text).replace("``", "`")
    sentence = sentence[begin.end() :] if (begin := _TYPE.match(sentence)) else sentence
    return sentence[:1].upper() + sentence[1:]


def short(name: str, objects) -> str:
    """A name as users write it, such as ``at.load``; of what they do not import by name, the class and its member."""
    parts = name.split(".")
    public = parts[1] in import_module(parts[0]).__all__
    return ".".join(["at", *parts[1:]] if public else parts[-1 - is_member(name, objects) :])


def names_of(objects, pages: list[str]) -> list[str]:
    """The names that some pages document, in their order."""
    documented = [(name, each) for name, each in objects.items() if each.docname in pages and not each.aliased]
    found = [(pages.index(each.docname), name) for name, each in documented]
    return [name for _, name in sorted(found, key=lambda each: each[0])]


def is_member(name: str, objects) -> bool:
    """Whether a name is an attribute of a documented class."""
    owner = objects.get(name.rpartition(".")[0])
    return owner is not None and owner.objtype in ("class", "exception")


def add_tables(app, doctree, page: str) -> None:
    """Insert the table below the title of a page of the reference, and those of all names."""
    objects, below = app.env.domains["py"].objects, app.env.toctree_includes
    for place in list(doctree.findall(AllNames)):
        names = names_of(objects, below[place["page"]])
        place.replace_self(_table(app, page, [(name, None) for name in names]))
    if not page.startswith(FOLDER):
        return
    pages = below.get(page, [])
    names = names_of(objects, pages or [page])
    shown = [name for name in names if not (pages and is_member(name, objects) and name.rpartition(".")[0] in names)]
    if len(shown) < 2:
        return
    rows = []
    for name in shown:
        members = [each for each in names if each.rpartition(".")[0] == name and is_member(each, objects)]
        rows.append((name, [objects[each].node_id for each in (name, *members)] if pages else None))
    next(doctree.findall(nodes.section)).insert(1, _table(app, page, rows))


def _table(app, page: str, rows: list[tuple[str, list[str] | None]]) -> nodes.table:
    """A table on a page, with a row for each name, and the anchors of this row."""
    objects = app.env.domains["py"].objects
    cells = [[f"`{short(name, objects)}`", summary_of(name)] for name, _ in rows]
    table = registries.table(["name", "what it is"], cells)
    table["classes"].append("summary")
    for (name, anchors), row in zip(rows, table.findall(lambda node: isinstance(node.parent, nodes.tbody))):
        entry = objects[name]
        address = app.builder.get_relative_uri(page, entry.docname) if entry.docname != page else ""
        link = nodes.reference("", "", internal=True, refuri=f"{address}#{entry.node_id}")
        literal = next(row.findall(nodes.literal))
        literal.replace_self(link)
        link += literal
        if anchors:
            link.parent.insert(0, nodes.inline(ids=anchors))
    return table


class AllNames(nodes.General, nodes.Element):
    """The place of a table of all names below a page."""


class Names(SphinxDirective):
    """A table of all names on the pages below one."""

    required_arguments = 1

    def run(self):
        return [AllNames("", page=self.arguments[0])]


def setup(app):
    app.add_node(AllNames)
    app.add_directive("names", Names)
    app.connect("doctree-resolved", add_tables)
    return {"parallel_read_safe": True}
