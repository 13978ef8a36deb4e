"""Options that the commands of jobs share: sensors, and files of results."""

from pathlib import Path
from typing import Annotated

import typer

SensorsOption = Annotated[
    str,
    typer.Option(
        help="Where to ask: face, vertex, grid:SPACING on every surface, raster:SPACING[+HEIGHT|@HEIGHT], or a file of "
        "points (.csv, .parquet, .npy, .npz).",
    ),
]
OutputsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        help="Where to write; may be repeated: .csv, .parquet, .json, .npz, .png, .glb or .tif.",
        show_default=False,
    ),
]
ColumnOption = Annotated[
    str | None,
    typer.Option(help="Column that a picture or model shows.  [default: the first]", show_default=False),
]
