"""A summary on top of each page of the reference: its names, or those of the pages below it, and what each is.

Rows of names on other pages have the anchors of these names and of their members, so that an address such as
api/scenes.html#antumbra.Scene leads to the row that links to the page of the class. Members that are documented apart
from their class have rows of their own.
"""

import inspect
import re
from importlib import import_module

import registries
from docutils import nodes

FOLDER = "api/"
_SENTENCE = re.compile(r".*?[\w)\]`]\.(?=\s+[A-Z`\[]|$)", re.DOTALL)


def summary_of(name: str) -> str:
    """The first sentence of the docstring of a documented name."""
    thing = import_module("antumbra")
    for part in name.split(".")[1:]:
        thing = getattr(thing, part, None) or import_module(f"{thing.__name__}.{part}")
    text = " ".join((inspect.getdoc(thing) or "").partition("\n\n")[0].split())
    match = _SENTENCE.match(text)
    return (match[0] if match else text).replace("``", "`")


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


def add_summary(app, doctree, page: str) -> None:
    """Insert the table below the title of a page."""
    if not page.startswith(FOLDER):
        return
    objects, below = app.env.domains["py"].objects, app.env.toctree_includes.get(page, [])
    names = names_of(objects, below or [page])
    shown = [name for name in names if not (below and is_member(name, objects) and name.rpartition(".")[0] in names)]
    if len(shown) < 2:
        return
    rows = [[f"`{short(each, objects)}`", summary_of(each)] for each in shown]
    table = registries.table(["name", "what it is"], rows)
    table["classes"].append("summary")
    for name, row in zip(shown, table.findall(lambda node: isinstance(node.parent, nodes.tbody))):
        entry = objects[name]
        address = app.builder.get_relative_uri(page, entry.docname) if entry.docname != page else ""
        link = nodes.reference("", "", internal=True, refuri=f"{address}#{entry.node_id}")
        literal = next(row.findall(nodes.literal))
        literal.replace_self(link)
        link += literal
        if below:
            members = [each for each in names if each.rpartition(".")[0] == name and is_member(each, objects)]
            link.parent.insert(0, nodes.inline(ids=[objects[each].node_id for each in (name, *members)]))
    section = next(doctree.findall(nodes.section))
    section.insert(1, table)


def setup(app):
    app.connect("doctree-resolved", add_summary)
    return {"parallel_read_safe": True}
