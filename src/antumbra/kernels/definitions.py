"""Digests of definitions, read from the source of a module. The module is not imported, as it may import Numba.

The digest of a name covers the statements that define it. It also covers, recursively, the definitions of all names in
these statements, in other modules of the package too. What a decorator registers for a class, such as the code of an
iterator, is part of the class. Comments and docstrings do not count.
"""

import ast
import sys
from functools import cache
from hashlib import blake2b
from importlib.util import find_spec, resolve_name
from pathlib import Path

SIMD = "antumbra.kernels.simd"
_IMPLIED = (f"{SIMD}.vectors",)
"""Numba learns from this module the meaning of ``a + b`` for vectors. No kernel names them."""


class _Module:
    """The top-level statements of a module, by the names that they define."""

    def __init__(self, name: str):
        tree = ast.parse(_source(name))
        self.statements: dict[str, list[ast.stmt]] = {}
        self.imported: dict[str, tuple[str, str]] = {}  # name here: (module, name there)
        code = (node for node in tree.body if not isinstance(node, ast.Import | ast.ImportFrom) and not _is_text(node))
        self.all = [_without_docstrings(node) for node in code]
        for node in tree.body:
            if isinstance(node, ast.ImportFrom) and node.level:
                module = resolve_name("." * node.level + (node.module or ""), name.rpartition(".")[0])
                self.imported |= {alias.asname or alias.name: (module, alias.name) for alias in node.names}
        for node in self.all:
            for defined in _defined(node):
                self.statements.setdefault(defined, []).append(node)


def _source(name: str) -> str:
    module = sys.modules.get(name)
    spec = module.__spec__ if module else find_spec(name)
    if spec is None or spec.origin is None:
        raise ImportError(f"the source of {name} is missing")
    return Path(spec.origin).read_text(encoding="utf-8")


def _is_text(node: ast.stmt) -> bool:
    """Is it a docstring, of the module or of the constant above it?"""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _without_docstrings(node: ast.stmt) -> ast.stmt:
    for inner in ast.walk(node):
        body = getattr(inner, "body", None)
        if isinstance(body, list):
            inner.body = [s for s in body if not _is_text(s)]
    return node


def _defined(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        calls = (call for call in node.decorator_list if isinstance(call, ast.Call))
        return [node.name, *(arg.id for call in calls for arg in call.args if isinstance(arg, ast.Name))]
    return [n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]


_module = cache(_Module)


def _collect(module: str, name: str, found: dict[tuple[str, str], str]) -> None:
    """Add to `found` the statements that define a name, and the definitions of all names in them."""
    if (module, name) in found:
        return
    known = _module(module)
    if name in known.imported:
        _collect(*known.imported[name], found)
        return
    statements = known.statements.get(name, [])
    found[module, name] = "\n".join(ast.dump(node) for node in statements)
    for node in statements:
        for inner in ast.walk(node):
            if isinstance(inner, ast.Name) and (inner.id in known.statements or inner.id in known.imported):
                _collect(module, inner.id, found)


@cache
def digest(module: str, name: str) -> str:
    """Digest of a name's definition in a module."""
    found: dict[tuple[str, str], str] = {}
    _collect(module, name, found)
    text = repr([module, name, *sorted(found.items())]) + "".join(map(module_digest, _IMPLIED))
    return blake2b(text.encode(), digest_size=16).hexdigest()


@cache
def module_digest(module: str) -> str:
    """Digest of all statements of a module."""
    text = "\n".join(ast.dump(node) for node in _module(module).all)
    return blake2b(text.encode(), digest_size=16).hexdigest()
