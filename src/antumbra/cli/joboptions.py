"""Options that the commands of jobs share: sensors, and files of results."""

from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from .arguments import parse_point
from .outputs import tables

SENSORS_HELP = (
    "Where to ask: face, vertex, grid:SPACING on every surface, raster:SPACING[+HEIGHT|@HEIGHT], raster:FILE.tif (its "
    "cells), or a file of points (.csv, .parquet, .npy, .npz)."
)
SensorsOption = Annotated[str, typer.Option(help=SENSORS_HELP)]
OutputsOption = Annotated[list[Path] | None, tables("Where to write", "--output", "-o")]
ColumnOption = Annotated[
    str | None,
    typer.Option(help="Column that a picture or model shows.  [default: the first]", show_default=False),
]
PlanOption = Annotated[
    str | None, typer.Option(help="Methods; see antumbra plans.  [default: auto]", show_default=False)
]

# The place of a scene on Earth
CrsOption = Annotated[
    str | None, typer.Option(help="A CRS, such as EPSG:28992.  [default: the file's]", show_default=False)
]
DegreesOption = Annotated[float | None, typer.Option(help="Degrees, WGS 84.", show_default=False)]
NorthOption = Annotated[
    float | None,
    typer.Option(
        help="True north, degrees clockwise from +Y (+Z up) or -Z (+Y up).  [default: by the CRS, or 0]",
        show_default=False,
    ),
]
TimezoneOption = Annotated[
    str | None,
    typer.Option(
        help="Europe/Amsterdam, UTC or +01:00.  [default: the whole hour of the longitude]", show_default=False
    ),
]


def points_or_file(given: list[str] | None, file: Path | None, one: str, many: str):
    """The sensors of a repeated option X,Y,Z, or of a file; None if there are neither."""
    if given and file is not None:
        raise InputError(f"{one} and {many} exclude each other; give one of them")
    if given:
        from ..jobs.sensors import point_sensors

        return point_sensors([parse_point(text, one) for text in given])
    if file is None:
        return None
    from ..jobs.readsensors import SUFFIXES, read_points

    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"{many} is {str(file)!r}; it must be a {', '.join(SUFFIXES)} file")
    return read_points(file)
