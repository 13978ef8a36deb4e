"""Optional packages and plugins.

An optional package is imported on demand; if it is missing, the error names the extra that installs it. A plugin is a
function that another package declares under an entry point, as in pyproject.toml, and that adds to a registry.
"""

import importlib
from functools import cache
from threading import RLock
from types import ModuleType
from typing import TYPE_CHECKING

from .errors import InputError
from .forks import hold_during_fork

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

# --- Optional packages ------------------------------------------------------------------------------------------------


EXTRAS = {
    "jit": "compiling kernels: in a clone, of plugins, and on processors without a kernel library",
    "sun": "positions of the sun, weather files and clear skies",
    "gis": "rasters, footprints, CityJSON, Parquet, and coordinate reference systems",
    "bake": "textures by antumbra bake",
    "meshes": "unusual PLY files, such as polygons with texture coordinates",
    "exr": "reading and writing .exr files, which data sets consist of",
    "sparse": "visibility matrices as scipy.sparse arrays",
    "compressed": "glTF files compressed with Draco or meshopt, and KTX2 textures",
    "plot": "map sheets, and plots by antumbra compare and antumbra bench",
    "video": ".mp4 and .webm files",
    "view": "the interactive page of antumbra view",
    "ray": "jobs on several machines",
    "all": "all of these",
}
"""The extras for users, and what each is for. The others are for developers."""


class MissingPackage(InputError):
    """An optional package is not installed."""


def import_extra(package: str, what: str, extra: str) -> ModuleType:
    """Import an optional package.

    Parameters
    ----------
    package : str
        Name of the module.
    what : str
        The option or function that needs it, for the error message.
    extra : str
        The extra of this package that installs it.

    Raises
    ------
    MissingPackage
        If it is not installed.
    """
    try:
        return importlib.import_module(package)
    except ImportError:
        name = package.partition(".")[0]
        raise MissingPackage(f"{what} needs {name}: pip install 'antumbra[{extra}]'") from None


# --- Plugins ----------------------------------------------------------------------------------------------------------


_lock = RLock()
hold_during_fork(_lock)
_added: set[str] = set()


@cache
def plugins_of(group: str) -> "dict[str, EntryPoint]":
    """The entry points of a group by name, sorted by name."""
    from importlib.metadata import entry_points  # slow to import

    return {point.name: point for point in sorted(entry_points(group=group))}


def load_plugins(group: str) -> None:
    """Call every function declared under a group of entry points, once per process."""
    with _lock:
        if group in _added:
            return
        _added.add(group)  # first, since a plugin may look up the registry while it adds to it
        try:
            for point in plugins_of(group).values():
                point.load()()
        except BaseException:
            _added.discard(group)  # so that the next call raises it again
            raise
