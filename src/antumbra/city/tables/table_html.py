"""What notebooks show of a table: a picture of its first numbers, and its first rows, which a click on a head sorts."""

import base64
import io
from html import escape
from typing import Any

from ...base.errors import InputError
from ...base.wording import counted
from .false_colours import false_colours
from .table_pages import rows_table

MOST_ROWS = 100
"""Rows that are listed."""

_WIDTH = 420  # pixels of the picture
_SIDES = "display: flex; flex-wrap: wrap; gap: 1em; align-items: flex-start"
_CELLS = "white-space: nowrap"
_BOX = "max-height: 24em; max-width: 100%; overflow: auto; flex: 1 1 24em"
_SORT = (
    "const t=this.closest('table'),b=t.tBodies[0],k=this.cellIndex,up=this.dataset.up=-(this.dataset.up||-1),"
    "n=s=>parseFloat(s.replaceAll(',',''));"
    "b.append(...[...b.rows].sort((p,q)=>{const x=p.cells[k].textContent,y=q.cells[k].textContent;"
    "return up*(n(x)-n(y)||x.localeCompare(y))}))"
)


def table_html(table: Any) -> str:
    """A table as HTML. Pages that run no scripts show it without sorting."""
    rows = rows_table(table, MOST_ROWS)
    style = ["text-align: right" if k in rows.right else "text-align: left" for k in range(len(rows.headers))]
    heads = (
        f'<th style="{each}; cursor: pointer" title="Sort" onclick="{escape(_SORT)}">{escape(name)}</th>'
        for each, name in zip(style, rows.headers)
    )
    lines = ([f'<td style="{each}">{escape(cell)}</td>' for each, cell in zip(style, row)] for row in rows.rows)
    body = "".join(f"<tr>{''.join(line)}</tr>" for line in lines)
    left_out = len(table) - len(rows.rows)
    caption = f"{counted(len(table), 'row')}{f', the first {MOST_ROWS} of which are listed' if left_out else ''}"
    listed = f"<caption>{caption}</caption><thead><tr>{''.join(heads)}</tr></thead><tbody>{body}</tbody>"
    box = f'<div style="{_BOX}"><table style="{_CELLS}">{listed}</table></div>'
    return f'<div style="{_SIDES}">{_picture(table)}{box}</div>'


def _picture(table: Any) -> str:
    """The picture of the first column of numbers; empty if there is none, or no scene."""
    from PIL import Image

    name = next((name for name, column in table.columns.items() if column.values.dtype.kind in "fiub"), None)
    if name is None or table.scene is None or not len(table):
        return ""
    try:
        image, file = Image.fromarray(false_colours(table, name)), io.BytesIO()
    except InputError:  # of scenes that no picture shows
        return ""
    image.resize((_WIDTH, round(image.height * _WIDTH / image.width)), Image.Resampling.LANCZOS).save(file, "PNG")
    data = base64.b64encode(file.getvalue()).decode()
    return f'<img alt="{escape(name)}" src="data:image/png;base64,{data}">'
