"""Shows the notebooks of docs/notebooks/ as pages: their text, code and stored output, and links to run them."""

import json
import re
from html import escape
from pathlib import Path

from myst_parser.parsers.sphinx_ import MystParser

SUFFIX = ".ipynb"
_BADGE = re.compile(r"\[!\[(Open in Colab)\]\([^)]*\)\]\(([^)]*)\)")


class NotebookParser(MystParser):
    """Reads a notebook as Markdown."""

    supported = ("notebook",)

    def parse(self, inputstring, document):
        name = Path(document.settings.env.doc2path(document.settings.env.docname)).name
        super().parse(page_of(json.loads(inputstring), name), document)


def page_of(notebook: dict, name: str) -> str:
    """The page of a notebook, as Markdown."""
    parts = []
    for cell in notebook["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "code":
            parts += [f"```python\n{text}\n```", *map(_shown, cell["outputs"])]
        else:
            parts.append(_BADGE.sub(rf"[\1](\2), or {{download}}`download {name} <{name}>`.", text))
    return "\n\n".join(parts) + "\n"


def _shown(output: dict) -> str:
    """The output of a cell: HTML if it has some, else its picture, else its text."""
    data = {kind: "".join(content) for kind, content in output.get("data", {}).items()}
    if html := data.get("text/html"):
        return _raw(f'<div class="table-wrapper shown">{html}</div>')
    if picture := data.get("image/png"):
        alt = escape(data.get("text/plain", ""), quote=True)
        return _raw(f'<img class="output" alt="{alt}" src="data:image/png;base64,{"".join(picture.split())}">')
    return f"```text\n{data.get('text/plain') or ''.join(output.get('text', ''))}\n```"


def _raw(html: str) -> str:
    return f"````{{raw}} html\n{html}\n````"


def setup(app):
    app.add_source_suffix(SUFFIX, NotebookParser.supported[0])
    app.add_source_parser(NotebookParser)
    return {"parallel_read_safe": True}
