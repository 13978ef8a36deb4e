"""Pages of results: one HTML file that holds its pictures, and needs nothing else."""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

_STYLE = """
:root { background: #1e1e22; color: #ececec; color-scheme: dark; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 1400px; padding: 0 1.5em; }
h1 { font-size: 1.6em; } h2 { font-size: 1.15em; margin-top: 2em; }
.panels { display: flex; flex-wrap: wrap; gap: 1.2em; }
figure { flex: 1 1 300px; margin: 0; }
figcaption span { color: #a0a0a6; display: block; }
img { display: block; max-width: 100%; width: 100%; }
.bar { margin: 1.2em 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; }
th, td { border-bottom: 1px solid #8884; padding: 0.25em 1em 0.25em 0; text-align: left; vertical-align: top; }
td { overflow-wrap: anywhere; }
table.numbers td, table.numbers th + th { font-variant-numeric: tabular-nums; text-align: right; white-space: nowrap; }
small { color: #a0a0a6; display: inline-block; min-width: 4em; }
tr.sum { font-weight: bold; }
.bad { color: #f66; font-weight: bold; }
pre { overflow-x: auto; padding: 0.8em 1em; background: #8882; }
"""


def save(title: str, parts: Iterable[str], path: Path) -> None:
    """Write a page of these parts, which are HTML, whole or not at all."""
    from ..output import replacing

    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    head += f"<title>{escape(title)}</title><style>{_STYLE}</style>"
    body = [f"<h1>{escape(title)}</h1>", *parts]
    text = "\n".join(["<!doctype html>", f'<html lang="en"><head>{head}</head><body>', *body, "</body></html>", ""])
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def embedded(rgb) -> str:
    """A picture, (H, W, 3) uint8 sRGB, as the address of an image."""
    from ..picture.image_files import png_bytes

    return "data:image/png;base64," + b64encode(png_bytes(rgb)).decode("ascii")


def table(headers: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]]) -> str:
    """A table of numbers; the cells are HTML, the names of rows and columns are text."""
    head = "".join(f"<th>{escape(header)}" for header in headers)
    body = "\n".join(
        f"<tr{' class=sum' if name == 'total' else ''}><th>{escape(name)}{''.join(f'<td>{cell}' for cell in cells)}"
        for name, cells in rows
    )
    return f"<div class=scroll><table class=numbers><thead><tr>{head}</thead>\n<tbody>\n{body}\n</table></div>"


def pairs(rows: Iterable[tuple[str, str]]) -> str:
    """A table of names and values."""
    body = "\n".join(f"<tr><th>{escape(name)}<td>{escape(value)}" for name, value in rows)
    return f"<table>\n{body}\n</table>"
