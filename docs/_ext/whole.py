"""Writes ``antumbra.md`` beside the pages: all in one Markdown file, for reading offline and for language models.

Generated parts are written out: help of commands, docstrings, tables of registries, and programs of the gallery.
"""

import importlib
import inspect
import re
from pathlib import Path

import gallery
import paper_code
import raised
import registries
from help import help_text

NAME = "antumbra.md"
PAPERS = Path(__file__).resolve().parents[1] / "papers"
ROLE = re.compile(r"\{(?:func|class|meth|exc)\}(?=`)")
PICTURE = re.compile(r"!\[([^]]*)\]\([^)]*\)")
CARD = re.compile(r"^:(?:::.*|[\w-]+:.*)\n", re.MULTILINE)  # its fences and options; its text stays
FENCE = re.compile(r"^```\{([\w-]+)\}(.*?)\n(.*?)^```\n?", re.MULTILINE | re.DOTALL)


def whole(pages: list[tuple[str, str]]) -> str:
    """All pages, (name, Markdown), below headings of their addresses."""
    parts = ["# Antumbra: all pages\n"]
    for name, text in pages:
        text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
        text = PICTURE.sub(r"(Picture: \1)", ROLE.sub("", CARD.sub("", FENCE.sub(_written_out, text))))
        parts.append(f"<!-- {name}.html -->\n\n{text.strip()}\n")
    return "\n".join(parts)


def _written_out(match: re.Match[str]) -> str:
    """A directive as plain Markdown; directives that only show something become nothing."""
    writer = _WRITERS.get(match[1])
    text = writer(match[2].strip(), match[3]) if writer else ""
    return f"{text}\n" if text else ""


def _help(argument: str, _: str) -> str:
    return f"```text\n{help_text(*argument.split())}\n```"


def _documented(_: str, content: str) -> str:
    """The signatures and docstrings that autodoc shows."""
    names = re.findall(r"^\.\. auto(?:function|class|exception):: ([\w.]+)", content, re.MULTILINE)
    return "\n".join(map(_docstring, names))


def _docstring(name: str) -> str:
    thing = importlib.import_module("antumbra")
    for part in name.split(".")[1:]:
        thing = getattr(thing, part, None) or importlib.import_module(f"{thing.__name__}.{part}")
    lines = [f"### {name}\n", "```text", f"{name}{_signature(thing)}\n", inspect.getdoc(thing) or ""]
    if inspect.isclass(thing):
        members = {n: getattr(thing, n) for n, m in vars(thing).items() if n[0] != "_" and inspect.isroutine(m)}
        lines += [f"\n{name}.{n}{_signature(each)}\n\n{inspect.getdoc(each)}" for n, each in members.items()]
    return "\n".join([*lines, "```\n"])


def _signature(thing) -> str:
    """Parameters and defaults without annotations, since docstrings state types."""
    try:
        signature = inspect.signature(thing)
    except (TypeError, ValueError):
        return ""
    plain = [each.replace(annotation=each.empty) for each in signature.parameters.values()]
    return str(signature.replace(parameters=plain, return_annotation=signature.empty))


def _table(columns: list[str], rows: list[list[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)


def _image(_: str, content: str) -> str:
    alt = re.search(r":alt: (.*)", content)
    return f"(Picture: {alt[1]})" if alt else ""


def _programs(programs) -> str:
    return "\n".join(f"### {each.title}\n\n{each.caption}\n\n```\n{each.code}\n```\n" for each in programs)


def _included(name: str, _: str) -> str:
    """A part of a paper's page."""
    return FENCE.sub(_written_out, (PAPERS / name).read_text(encoding="utf-8"))


_WRITERS = {
    "command-help": _help,
    "eval-rst": _documented,
    "scene-formats": lambda *_: _table(["format", "suffixes", "use", "extra", "lost"], registries.format_rows()),
    "methods": lambda *_: _table(["name", "kind", "what it does", "paper"], registries.method_rows()),
    "raised": lambda _, content: _table(["call", "error", "fix"], raised.rows_of(content.splitlines())),
    "image": _image,
    "include": _included,
    "paper-code": lambda folder, _: paper_code.sections(folder),
    "glossary": lambda _, content: content,
    "gallery": lambda *_: _programs(gallery.programs()),
    "examples": lambda *_: _programs(gallery.examples()),
}


def _in_order(app, name: str, found: dict[str, None]) -> dict[str, None]:
    """The pages in the order of the tables of contents."""
    if name not in found:
        found[name] = None
        for each in app.env.toctree_includes.get(name, []):
            _in_order(app, each, found)
    return found


def _write(app, exception) -> None:
    if exception is None and app.builder.format == "html":
        paths = {name: Path(app.env.doc2path(name)) for name in _in_order(app, app.config.root_doc, {})}
        pages = [(name, path.read_text(encoding="utf-8")) for name, path in paths.items() if path.suffix == ".md"]
        (Path(app.outdir) / NAME).write_text(whole(pages), encoding="utf-8")


def setup(app):
    app.connect("build-finished", _write)
    return {"parallel_read_safe": True}
