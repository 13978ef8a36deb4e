"""The files that arguments name: by a path, or in a text such as ``city.json?lod=2.2`` or ``raster:dem.tif+1.6``."""

from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from ..jobs.sensor_files import raster_file

INPUTS = "scene", "sensors", "targets", "areas", "epw", "sky"
"""Arguments of jobs, on the command line or in Python, that may name a file or a folder to read."""


def files_in(named: Mapping[str, Any]) -> dict[str, Path]:
    """The files and folders that arguments name, if they exist, by the names of the arguments."""
    found = {name: _path_in(named.get(name)) for name in INPUTS}
    return {name: Path(path) for name, path in found.items() if path and Path(path).exists()}


def with_files(named: Mapping[str, Any], paths: Mapping[str, str]) -> dict[str, Any]:
    """The arguments that name files, with other paths of these files.

    paths : argument -> path
    """
    return {
        name: value.replace(_path_in(value), paths[name], 1) if isinstance(value, str) else Path(paths[name])
        for name, value in named.items()
        if name in paths
    }


def _path_in(value: Any) -> str:
    """The path in an argument; empty: it is neither a path nor a text."""
    if isinstance(value, str):
        return raster_file(value) or value.partition("?")[0]
    return fspath(value) if isinstance(value, PathLike) else ""
