"""Types in the signatures of the reference, where they are short and all their names are public or of another library.

Arrays are `numpy.ndarray` or `ArrayLike`: docstrings state shapes, dtypes and arguments. Long types
and `Any` are left out.
"""

import ast
import inspect
import re
from typing import get_args

from numpy.typing import ArrayLike
from sphinx.util.inspect import stringify_signature
from sphinx.util.nodes import make_refnode
from sphinx.util.typing import stringify_annotation

import antumbra

LONGEST = 60  # characters of a type, without modules

BUILTIN = {"None", "bool", "bytes", "complex", "dict", "float", "int", "list", "object", "set", "slice", "str", "tuple"}

PLACES = {
    "Any": "typing.Any",
    "ArrayLike": "numpy.typing.ArrayLike",
    "NDArray": "numpy.ndarray",
    "ndarray": "numpy.ndarray",
    "Callable": "collections.abc.Callable",
    "Iterable": "collections.abc.Iterable",
    "Iterator": "collections.abc.Iterator",
    "Mapping": "collections.abc.Mapping",
    "Sequence": "collections.abc.Sequence",
    "Path": "pathlib.Path",
    "PathLike": "os.PathLike",
    "date": "datetime.date",
    "datetime": "datetime.datetime",
    "DataFrame": "pandas.DataFrame",
    "GeoDataFrame": "geopandas.GeoDataFrame",
    "csr_array": "scipy.sparse.csr_array",
}
"""Name -> where it is described; `docs/_inventories` has the addresses."""

WHOLE = {"collections.abc.Callable", "numpy.ndarray", "os.PathLike"}  # their parameters are left out

_ARRAY = set(get_args(ArrayLike))
_SCENE = "AnyScene"  # beside all that at.load takes: SceneLike
_MODULES = re.compile(r"\b[a-z]\w*\.")  # which the page does not show


class _Names(ast.NodeTransformer):
    """Replaces names by where they are described.

    Raises
    ------
    LookupError
        If a name is neither public nor known.
    """

    def visit_Name(self, node):
        return ast.Name(_place(node.id))

    def visit_Attribute(self, node):
        return ast.Name(_place(node.attr))

    def visit_Subscript(self, node):
        value = self.visit(node.value)
        return value if value.id in WHOLE else ast.Subscript(value, self.visit(node.slice))


def _place(name: str) -> str:
    if name in BUILTIN or name == "SceneLike":
        return name
    return f"antumbra.{name}" if name in antumbra.__all__ else PLACES[name]


def written(annotation: object) -> str:
    """A type as a signature shows it; empty if it is not shown.

    annotation : a type, or the text of one
    """
    if annotation is inspect.Parameter.empty:
        return ""
    parts = get_args(annotation) if set(get_args(annotation)) >= _ARRAY else (annotation,)
    texts = [each if isinstance(each, str) else stringify_annotation(each, "fully-qualified") for each in parts]
    if len(parts) > 1:
        texts = [*(text for text, part in zip(texts, parts, strict=True) if part not in _ARRAY), "ArrayLike"]
    options = " | ".join(texts).split(" | ")
    if any(each.rpartition(".")[2] == "Any" for each in options):
        return "SceneLike" if any(each.rpartition(".")[2] == _SCENE for each in options) else ""
    options.sort(key="None".__eq__)  # None comes last
    try:
        text = ast.unparse(_Names().visit(ast.parse(" | ".join(options), mode="eval")))
    except (LookupError, SyntaxError):
        return ""
    return text if len(_MODULES.sub("", text)) <= LONGEST else ""


def add_types(app, what, name, obj, options, signature, returned):
    """The signature of a function, method or class with types."""
    if not signature or what not in ("function", "method", "class", "exception"):
        return None
    try:
        known = inspect.signature(obj)
    except (TypeError, ValueError):
        return None
    parameters = list(known.parameters.values())
    if what == "method" and parameters and parameters[0].name == "self":
        parameters = parameters[1:]
    shown = [
        each.replace(annotation=text if (text := written(each.annotation)) else inspect.Parameter.empty)
        for each in parameters
    ]
    result = written(known.return_annotation) if what in ("function", "method") else ""
    result = "" if result == "None" else result
    return stringify_signature(known.replace(parameters=shown, return_annotation=inspect.Signature.empty)), result


def link_scenes(app, env, node, content):
    """`SceneLike` leads to `antumbra.load`, which lists what a scene may be."""
    if node.get("reftarget") != "SceneLike":
        return None
    entry = env.domains["py"].objects["antumbra.load"]
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, content)


def setup(app):
    app.connect("autodoc-process-signature", add_types)
    app.connect("missing-reference", link_scenes)
    return {"parallel_read_safe": True}
