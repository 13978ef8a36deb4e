"""Shows the comments beside the fields of a NamedTuple, where this project describes them, and dashes in all fields."""

import ast
import inspect
import io
import textwrap
import tokenize

from docutils import nodes


def field_comments(cls: type) -> dict[str, str]:
    """Field -> the comment on the lines of its definition; "" where there is none."""
    cls = next(each for each in cls.__mro__ if "_fields" in vars(each))  # a subclass may add properties
    source = textwrap.dedent(inspect.getsource(cls))
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    comments = {t.start[0]: t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT}
    found = {}
    for node in ast.parse(source).body[0].body:
        if isinstance(node, ast.AnnAssign):
            lines = range(node.lineno, node.end_lineno + 1)
            found[node.target.id] = " ".join(comments[n] for n in lines if n in comments)
    return found


def is_named_tuple(obj) -> bool:
    return isinstance(obj, type) and issubclass(obj, tuple) and hasattr(obj, "_fields")


def _append_fields(app, what, name, obj, options, lines):
    if is_named_tuple(obj):
        lines.append("")
        lines.extend(f":ivar {field}: {text}" for field, text in field_comments(obj).items())


def _set_dashes(app, doctree):
    """Sphinx writes "name (type) -- text", and leaves the dash to smartquotes, which here keep hyphens of options."""
    for content in doctree.findall(nodes.field_list):
        for text in list(content.findall(nodes.Text)):
            if text == " -- ":
                text.parent.replace(text, nodes.Text(" \N{EN DASH} "))


def setup(app):
    app.connect("autodoc-process-docstring", _append_fields)
    app.connect("doctree-read", _set_dashes)
    return {"parallel_read_safe": True}
