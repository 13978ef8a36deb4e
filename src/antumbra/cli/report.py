"""Prints answers on standard output: tables for people, or one JSON object for programs.

While a `Record` is standard output, tables are kept as Markdown too.
"""

import hashlib
import json
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import fields

from .record import Record


def print_json(answer: dict) -> None:
    """Print one JSON object on one line, and flush it. Infinity and NaN become null."""
    sys.stdout.write(json.dumps(plain(answer), allow_nan=False) + "\n")
    sys.stdout.flush()


def print_fields(rows: Iterable[tuple[str, str]]) -> None:
    """Print names and values, one below the other."""
    from rich.table import Table

    rows = list(rows)
    if isinstance(sys.stdout, Record):
        sys.stdout.keep_fields(rows)
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="bold")
    grid.add_column(overflow="fold")
    _print_rows(grid, rows)


def print_table(
    headers: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[int] = (), width: int | None = None
) -> None:
    """Print a table with headers. Columns in `right` hold numbers. `width` is the least number of characters a line."""
    from rich import box
    from rich.table import Table

    rows = list(rows)
    if isinstance(sys.stdout, Record):
        sys.stdout.keep_table(headers, rows, right)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, header in enumerate(headers):
        table.add_column(header, justify="right" if i in right else "left", overflow="fold")
    _print_rows(table, rows, width)


def duration(seconds: float) -> str:
    """Seconds as text: 12 ms, 3.45 s, 12 min, 1.5 h."""
    if seconds >= 600.0:
        return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
    return f"{seconds:.2f} s" if seconds >= 1.0 else f"{1000.0 * seconds:.3g} ms"


def size_in_memory(n: int) -> str:
    """Bytes as text: 12.3 MB."""
    return f"{n / 1e6:,.1f} MB"


def vector(values) -> str:
    """Three numbers as text."""
    return "(" + ", ".join(f"{float(v):.7g}" for v in values) + ")"


def light_fields(light) -> dict:
    """A light as names and values. A list of lights has only the number of its lights, a sky a digest of its map."""
    from ..scene.sky import Sky

    kind = {"type": type(light).__name__, **({"name": light.name} if light.name else {})}
    if isinstance(light, Sky):
        digest = hashlib.sha256(light.map.tobytes()).hexdigest()[:16]
        own = {name: getattr(light, name) for name in ("intensity", "colour", "up", "turn", "count")}
        return {**kind, "map": digest, **own}
    if light.domain == "list":
        return {**kind, "count": len(light.points), "interleave": light.interleave}
    return {**kind, **{f.name: getattr(light, f.name) for f in fields(light)}}


def camera_fields(camera) -> dict:
    """A camera as names and values."""
    other = ("projection", "extent") if camera.listed else ()
    return {name: getattr(camera, name) for name in ("position", "target", "up", "vfov", "width", "height", *other)}


def srdh_rays_fields(rays) -> dict:
    """`SrdhRays` from the command line as names and values."""
    return {name: getattr(rays, name) for name in ("size", "spp", "bounce", "last_frame")}


def _print_rows(table, rows, width: int | None = None) -> None:
    from rich.console import Console
    from rich.text import Text

    out = sys.stdout.shown if isinstance(sys.stdout, Record) else sys.stdout
    if out is None:
        return
    for row in rows:
        table.add_row(*(Text(_encodable(cell)) for cell in row))
    terminal = Console(highlight=False, file=out)
    Console(highlight=False, file=out, width=max(width or 0, terminal.width)).print(table)


def _encodable(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode()  # file names may not be valid Unicode


def plain(value):
    """A value in the types of JSON: arrays and tuples become lists, infinite numbers and NaN become None."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)
