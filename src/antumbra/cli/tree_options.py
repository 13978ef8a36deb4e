"""``--trees``: a file of trees that commands add to a scene, with its options as a query.

``trees.gpkg?height=h&radius=r&transmittance=0.3``; twelve shares for the months are separated by slashes, as in the
transmittance of a scene.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple
from urllib.parse import parse_qsl

import typer

from ..checks import spelling_hint
from ..errors import InputError
from ..formats.gis.tree_table import checked_tree_file
from ..scene.materials import MONTHS

if TYPE_CHECKING:
    from ..engine.scene import AnyScene

TreesOption = Annotated[
    str | None,
    typer.Option(
        "--trees",
        help="Points or outlines of trees: FILE?height=COLUMN&radius=COLUMN&transmittance=SHARE, where SHARE of the "
        "light passes through a crown, or JAN/FEB/.../DEC, and each column may be a number; also shape=cone, base, "
        "crown_base, trunk_radius, id, layer. Sensors lie on the scene without its trees.",
        metavar="FILE[?OPTIONS]",
        show_default=False,
    ),
]

_NUMBERS = "height", "radius", "base", "crown_base", "trunk_radius"  # or names of columns
_TEXTS = "shape", "id", "layer"
_SHARE = "transmittance"


class TreeSpec(NamedTuple):
    """A file of trees and the keywords of `antumbra.from_trees`."""

    path: Path
    keywords: dict[str, Any]


def parse_trees(text: str) -> TreeSpec:
    """The file and the options of the text of ``--trees``.

    Raises
    ------
    InputError
        If the file is missing or has another suffix, or an option is unknown, empty or repeated.
    """
    file, _, query = text.partition("?")
    keywords: dict[str, Any] = {}
    allowed = (*_NUMBERS, _SHARE, *_TEXTS)
    for name, value in parse_qsl(query, keep_blank_values=True):
        if name not in allowed:
            hint = spelling_hint(name, allowed)
            raise InputError(f"--trees {text}: {name!r} is unknown; {hint}use {', '.join(allowed)}")
        if not value or name in keywords:
            raise InputError(f"--trees {text}: {name} is empty or repeated; write FILE?{name}=VALUE")
        keywords[name] = _shares(value) if name == _SHARE else value if name in _TEXTS else _number_or_text(value)
    return TreeSpec(checked_tree_file(file), keywords)


def add_trees(scene: "AnyScene", spec: TreeSpec | None) -> "AnyScene":
    """A scene with the trees of a file; the scene itself if there are none."""
    if spec is None:
        return scene
    from ..engine.tree_scenes import from_trees

    return from_trees(spec.path, scene=scene, **spec.keywords)


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _shares(text: str) -> Any:
    """A share, red, green and blue, or twelve of these; or the name of a column."""
    months = [[_number_or_text(each) for each in month.split(",")] for month in text.split("/")]
    values = [month[0] if len(month) == 1 else month for month in months]
    if len(values) not in (1, len(MONTHS)):
        raise InputError(f"transmittance of --trees is {text!r}; write SHARE, a column, or JAN/FEB/.../DEC")
    return values[0] if len(values) == 1 else values
