"""Optional packages and plugins.

An optional package is imported on demand; if it is missing, the error names the extra that installs it. A plugin is a
function that another package declares under an entry point, as in pyproject.toml, and that adds to a registry.
"""

import importlib
import warnings
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
    "jit": "compiling kernels: in a clone, for plugins, and on platforms without a wheel of their own",
    "sun": "sun positions, weather files and clear skies",
    "gis": "rasters, footprints, CityJSON, Parquet, and coordinate reference systems",
    "cloud": "stores at URLs and in object storage",
    "xarray": "results as xarray Datasets and in Zarr",
    "bake": "baking textures",
    "meshes": "unusual PLY files, such as polygons with texture coordinates",
    "exr": "reading and writing .exr files, such as data sets",
    "sparse": "visibility matrices as scipy.sparse arrays",
    "compressed": "glTF files compressed with Draco or meshopt, and KTX2 textures",
    "plot": "map sheets, and the plots of antumbra compare and antumbra bench",
    "video": ".mp4 and .webm files",
    "view": "the interactive page of antumbra view",
    "ray": "jobs on several machines",
    "opencl": "Intel and AMD graphics cards; NVIDIA cards only need their driver",
    "all": "everything above",
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
_added: set[tuple[str, str]] = set()  # (group, name) of the entry points whose functions have been called
_tried: set[str] = set()  # groups

METHODS = "antumbra.methods"
"""The group of entry points that add to `engine.method_registry`."""


@cache
def plugins_of(group: str) -> "dict[str, EntryPoint]":
    """The entry points of a group by name, sorted by name; where packages use the same name, with their values."""
    from importlib.metadata import entry_points  # slow to import

    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=group)):
        found[point.name if point.name not in found else f"{point.name} ({point.value})"] = point
    return found


def load_plugins(group: str) -> None:
    """Call every function declared under a group of entry points, once per process."""
    with _lock:
        for name, point in plugins_of(group).items():
            _add(group, name, point)


def try_plugins(group: str) -> None:
    """Call the functions that other packages declare under a group, once per process; warn of those that fail.

    For functions that can do without plugins. `load_plugins` raises what they raise.
    """
    if group in _tried:
        return
    with _lock:
        _tried.add(group)
        for name, point in plugins_of(group).items():
            if point.value.partition(".")[0] == __name__.partition(".")[0]:
                continue
            try:
                _add(group, name, point)
            except Exception as error:
                message = f"plugin {name!r} ({point.value}) cannot be loaded, so it is ignored: {error}"
                warnings.warn(message, RuntimeWarning, stacklevel=2)


def _add(group: str, name: str, point: "EntryPoint") -> None:
    """Call the function of an entry point unless it has been called."""
    if (group, name) in _added:
        return
    _added.add((group, name))  # first, since a plugin may look up the registry while it adds to it
    try:
        point.load()()
    except BaseException:
        _added.discard((group, name))  # so that the next call raises it again
        raise
