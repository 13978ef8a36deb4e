"""What a file format of scenes is: how it is read and written, and what is lost."""

from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from ..base.checks import quoted
from ..base.errors import InputError
from ..scene.palette_scene import PaletteScene
from ..scene.scene_data import SceneData
from ..scene.terrain import StreamedTerrain
from ..scene.units import LengthUnit


class ReadOptions(NamedTuple):
    """Options of reading a scene; `antumbra.load` documents them."""

    up: str | None = None  # the axis that points up; None: that of the format, or a guess
    lod: str | None = None  # level of detail
    instances: bool | None = None  # whether copies of meshes stay instances; None: if that saves much memory
    cutouts: bool = True  # False: all faces are solid
    crs: str | None = None  # instead of that of the file; to which footprints in degrees are projected
    unit: LengthUnit | None = None  # of the coordinates, if no CRS names it
    animation: str | None = None  # the clip of a glTF file that plays; None: all at once
    streamed: bool = False  # for a store: meshes become `StreamedData`


Reader: TypeAlias = Callable[[Any, ReadOptions], SceneData]
"""(path, or an object that the format takes; options) -> the data of a scene."""

Writer: TypeAlias = Callable[[PaletteScene, str, Path], list[Path]]
"""(scene, name of its mesh, path) -> the files written."""

Tile: TypeAlias = tuple[Any, Mapping[str, Any]]
"""A path or an object that the format takes, and options of reading by name: "up", "unit", and those of the format."""

Stream: TypeAlias = Callable[[Sequence[Tile]], StreamedTerrain]
"""Tiles of one surface -> the surface, read piece by piece."""


class Contents(Enum):
    """What a file holds."""

    MESHES = 1
    CITY = 2
    HEIGHTS = 3
    FOOTPRINTS = 4


class Format(NamedTuple):
    """A file format of scenes."""

    name: str  # in the list of formats
    suffixes: tuple[str, ...]  # in lower case; () for a folder
    read: Reader
    write: Writer | None  # None: scenes are not exported to this format
    extra: str | None  # of this package, which installs what some files or all need
    lost: str  # what reading or writing leaves out
    contents: Contents = Contents.MESHES
    stream: Stream | None = None  # None: files are read whole
    reproject: Callable[[str, bool], str] | None = (
        None  # (CRS, whether the file names its own) -> the command that does
    )
    takes: Callable[[Any], bool] | None = None  # whether its reader and its stream also take this object of a library
    by_url: bool = False  # whether its reader also takes URLs, and checks the path


def check_z_up(up: str | None, name: str) -> None:
    """Raise an InputError if another up axis is given than that of geographic data."""
    if up not in (None, "z"):
        raise InputError(f"{name}: has z up, as all geographic data; up is {quoted(up)}, leave it out")
