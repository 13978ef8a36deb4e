"""The room on a disk that a build takes."""

import shutil
from pathlib import Path

from ..errors import InputError

TRIANGLE_BYTES = 130
"""Bytes on the disk for each triangle, at most: 75 of the store, and 55 of temporary files."""


def check_space(folder: Path, file: str, triangles: int, written: int = 0) -> None:
    """Raise an InputError if a folder has no room to build a store of so many triangles.

    written : bytes of temporary files that are there already
    """
    try:
        free = shutil.disk_usage(folder).free
    except OSError:  # some file systems do not tell
        return
    need = TRIANGLE_BYTES * triangles - written
    if need > free:
        raise InputError(
            f"{file}: {triangles:,} triangles take about {need / 1e9:,.1f} GB while they are built, and "
            f"{folder} has {free / 1e9:,.1f} GB left; free some, or choose another place"
        )
