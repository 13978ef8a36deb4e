"""Links of code such as ``[`at.render`](api.md)`` lead to the description of that name, on whichever page it is.

In plain Markdown, they lead to the page that lists the pages of the reference. Pages that docstrings name by their
file, such as docs/design/shading.md, become links too.
"""

import re

from docutils import nodes
from sphinx import addnodes
from sphinx.util import logging

PAGE = "api"
_FILE = re.compile(r"\bdocs/([\w/-]+)\.md\b")
LOG = logging.getLogger(__name__)


def resolve(app, doctree, page):
    """Replace the address of each link to the reference whose text is the name of a public thing."""
    objects = app.env.domains["py"].objects
    for link in doctree.findall(lambda node: isinstance(node, (nodes.reference, addnodes.pending_xref))):
        name, target = link.astext(), link.get("refuri", link.get("reftarget", ""))
        if not name.startswith("at.") or target.rpartition("/")[2] not in (f"{PAGE}.html", PAGE, f"{PAGE}.md"):
            continue
        entry = objects.get("antumbra" + name[2:])
        if entry is None:
            LOG.warning("%s is linked to the reference, which does not describe it", name, location=link)
        else:
            link["refuri"] = f"{app.builder.get_relative_uri(page, entry.docname)}#{entry.node_id}"


def link_notes(app, what, name, obj, options, lines):
    """Replace the files of pages in a docstring by links with the titles of these pages."""
    lines[:] = [_FILE.sub(r":doc:`/\1`", line) for line in lines]


def setup(app):
    app.connect("autodoc-process-docstring", link_notes)
    app.connect("doctree-resolved", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
