"""Fields of the reference: "names : type – text", and for NamedTuples the comments beside their fields."""

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


def _separate(app, doctree):
    """Turn "name (type) -- text" of Sphinx into "name : type – text", since types contain brackets: (n, 3) float."""
    for content in doctree.findall(nodes.field_list):
        for entries in content.findall(nodes.bullet_list):
            _join_equal(entries)
        for paragraph in content.findall(nodes.paragraph):
            _set_separators(paragraph)


def _join_equal(entries: nodes.bullet_list) -> None:
    """Join parameters with the same type and text: docstrings write "origins, directions : ..." once."""
    last = None
    for item in list(entries):
        paragraph = item[0] if len(item) == 1 else None
        if last is not None and paragraph is not None and _text_of(paragraph) == _text_of(last) != "":
            end = _end_of_names(last)
            last[end:end] = [nodes.Text(", "), paragraph[0].deepcopy()]
            entries.remove(item)
        else:
            last = paragraph


def _end_of_names(paragraph) -> int:
    return next((k for k, node in enumerate(paragraph) if node == " ("), len(paragraph))


def _text_of(paragraph) -> str:
    """What follows the names."""
    return "".join(node.astext() for node in paragraph[_end_of_names(paragraph) :])


def _set_separators(paragraph) -> None:
    texts = [node for node in paragraph.children if isinstance(node, nodes.Text)]
    begin = next((node for node in texts if node == " ("), None)
    dash = next((node for node in texts if node == " -- "), None)
    if begin is not None and type(paragraph[paragraph.index(begin) - 1]) is type(paragraph[0]):
        ends = [
            node for node in texts if node == ")" and (dash is None or paragraph.index(node) < paragraph.index(dash))
        ]
        if ends:
            paragraph.replace(begin, nodes.Text(" : "))
            paragraph.remove(ends[0])
    if dash is not None:  # smartquotes keep hyphens, because of options
        paragraph.replace(dash, nodes.Text(" \N{EN DASH} "))


def setup(app):
    app.connect("autodoc-process-docstring", _append_fields)
    app.connect("doctree-read", _separate)
    return {"parallel_read_safe": True}
