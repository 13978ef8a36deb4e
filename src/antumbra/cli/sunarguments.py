"""The command-line arguments of ``antumbra sun``."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ..plan import DEFAULT_PLAN
from .joboptions import (
    SENSORS_HELP,
    ColumnOption,
    CrsOption,
    DegreesOption,
    NorthOption,
    OutputsOption,
    TimezoneOption,
)
from .options import SCENE_HELP, Json, MaxMemoryOption, Quiet, Threads, UpOption
from .outputs import writes
from .sharing import MergeOption, RayOption, ShardOption


class By(StrEnum):
    month = "month"
    hour = "hour"


@dataclass(frozen=True)
class SunArguments:
    """The arguments of the command line: each field is an argument or an option."""

    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")]
    sensors: Annotated[
        str | None, typer.Option(help=SENSORS_HELP + "  [default: face; in areas raster:0.5]", show_default=False)
    ] = None
    days: Annotated[
        str | None,
        typer.Option(
            help="2026-06-21, 2026-03-21:2026-09-21, year:2026, or several with commas.  [default: those of the rule "
            "or of the EPW file]",
            metavar="DAYS",
            show_default=False,
        ),
    ] = None
    step: Annotated[
        float | None,
        typer.Option(
            help="Minutes that each sun stands for.  [default: 60, or those of the rule]",
            metavar="MINUTES",
            show_default=False,
        ),
    ] = None
    rule: Annotated[
        str | None, typer.Option(help="A daylight rule: br209-windows, en17037-medium, ...", show_default=False)
    ] = None
    areas: Annotated[
        Path | None,
        typer.Option(
            help="GeoJSON polygons of gardens or other areas of the ground, for br209-amenity.",
            metavar="FILE",
            show_default=False,
        ),
    ] = None
    epw: Annotated[
        Path | None,
        typer.Option(help="Weather file: place, days, direct and diffuse radiation.", metavar="FILE"),
    ] = None
    crs: CrsOption = None
    latitude: DegreesOption = None
    longitude: DegreesOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    energy: Annotated[bool, typer.Option("--energy", help="Add the energy of direct light under a clear sky.")] = False
    sky: Annotated[
        int, typer.Option(help="Add the sky-view factor, by so many directions.", min=0, max=16384, metavar="N")
    ] = 0
    by: Annotated[list[By] | None, typer.Option(help="Hours for each month or hour; may be repeated.")] = None
    samples: Annotated[int, typer.Option(help="Points on the sun's disk; 1: its centre.", min=1, max=64)] = 1
    output: OutputsOption = None
    column: ColumnOption = None
    city_output: Annotated[
        Path | None,
        typer.Option(
            help="A copy of a CityJSON file, .json or .jsonl, with the results as attributes.",
            metavar="FILE",
            callback=writes(".json", ".jsonl"),
        ),
    ] = None
    matrix: Annotated[
        Path | None,
        typer.Option(help="A .npy file of the bits of each sensor and sun.", metavar="FILE", callback=writes(".npy")),
    ] = None
    plan: Annotated[str, typer.Option(help="Methods to use; see antumbra plans.")] = DEFAULT_PLAN
    threads: Threads = None
    max_memory: MaxMemoryOption = None
    up: UpOption = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None
    json: Json = False
    quiet: Quiet = False
