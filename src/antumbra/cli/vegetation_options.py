"""``--trees``: a file of plants that commands add to a scene, with its options as a query.

``trees.gpkg?height=h&radius=r&transmittance=0.3``; twelve shares for the months are separated by slashes, as in the
transmittance of a scene.
"""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple
from urllib.parse import parse_qsl

import numpy as np
import typer

from ..base import wings
from ..base.checks import spelling_hint
from ..base.errors import InputError
from ..scene.materials import MONTHS

if TYPE_CHECKING:
    from .. import Sensors
    from ..engine.scene import AnyScene

VegetationOption = Annotated[
    str | None,
    typer.Option(
        "--trees",
        help="Points or outlines of trees, such as FILE?height=COLUMN&radius=5, with a column or a number for "
        "height, radius, base, crown_base and trunk_radius. transmittance=SHARE of the light passes through a crown; "
        "give twelve for the months, JAN/FEB/.../DEC. Also shape=cone, id, layer. Sensors lie on the scene without its "
        "trees.",
        metavar="FILE[?OPTIONS]",
        show_default=False,
    ),
]

_NUMBERS = "height", "radius", "base", "crown_base", "trunk_radius"  # or names of columns
_TEXTS = "shape", "id", "layer"
_SHARE = "transmittance"


class VegetationSpec(NamedTuple):
    """A file of plants and the keywords of `antumbra.from_trees`."""

    path: Path
    keywords: dict[str, Any]

    def check_solid(self, why: str) -> None:
        """Raise an InputError if crowns let light pass and a command supports only solid ones; `why`: the reason."""
        if _SHARE in self.keywords:
            raise InputError(f"--trees {self.path.name}: {why}; leave {_SHARE} out")

    def digest(self) -> str:
        """A digest of the file and the options."""
        with self.path.open("rb") as stream:
            contents = hashlib.file_digest(stream, "sha256").hexdigest()
        return hashlib.sha256(f"{contents} {self.keywords}".encode(), usedforsecurity=False).hexdigest()


def parse_vegetation(text: str | None) -> VegetationSpec | None:
    """The file and the options of the text of ``--trees``; None without a text.

    Raises
    ------
    InputError
        If the file is missing or has another suffix, or an option is unknown, empty or repeated.
    """
    if text is None:
        return None
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
    return VegetationSpec(wings.named(wings.VEGETATION_FILE)(file), keywords)


def add_vegetation(scene: "AnyScene", spec: VegetationSpec | None) -> "AnyScene":
    """A scene with the plants of a file; the scene itself if there are none."""
    if spec is None:
        return scene
    from .. import from_trees

    return from_trees(spec.path, scene=scene, **spec.keywords)


def sensors_below_plants(
    text: str, bare: "AnyScene", scene: "AnyScene", threads: int | None = None, areas: Any = None
) -> "Sensors":
    """The sensors that a text names on a scene without vegetation, for the scene with it.

    bare, scene : without and with vegetation, whose faces follow all others
    """
    from .. import sensors_of

    sensors: Sensors = below_plants(sensors_of(text, bare, threads, areas), bare, scene)
    return sensors


def below_plants(sensors: Any, bare: "AnyScene", scene: "AnyScene") -> Any:
    """Sensors, perhaps described, on a scene without vegetation, for the scene with it."""
    if getattr(sensors, "corners", None) is None or scene is bare:
        return sensors
    of_trees = np.full((scene.n_triangles - len(sensors.corners), 3), -1)
    return replace(sensors, corners=np.concatenate([sensors.corners, of_trees]))


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
