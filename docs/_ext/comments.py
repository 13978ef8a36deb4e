"""Leaves HTML comments, such as the sources of numbers, out of the pages."""

from docutils import nodes


def drop_comments(app, doctree):
    """Remove the comments of a page."""
    for node in list(doctree.findall(nodes.raw)):
        text = node.astext().strip()
        if text.startswith("<!--") and text.endswith("-->"):
            node.parent.remove(node)


def setup(app):
    app.connect("doctree-read", drop_comments)
    return {"parallel_read_safe": True}
