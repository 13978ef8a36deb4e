"""A function of this package on a cluster: the Python side of ``--ray``."""

import inspect
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from ..checks import path_of, quoted, text
from ..engine.scene_loading import load
from ..errors import InputError
from ..files import temporary_folder
from ..jobs.executors import UnitCollector
from .engine import Cluster
from .named import files_in, with_files

_OUTPUTS = "output", "matrix", "folder"


def run(function: Callable, scene, *args, address: str = "local", **kwargs) -> Any:
    """Call a function of this package on a Ray cluster (needs ``antumbra[ray]``).

    Each node opens the scene by its path, or fetches the file once to its disk, and does parts of the work. The result
    equals that of ``function(load(scene), *args, **kwargs)``.

    Parameters
    ----------
    function : function
        `antumbra.sun_hours`, `antumbra.visibility_matrix`, `antumbra.bake` or `antumbra.dataset`.
    scene : str or path-like
        The path of the scene.
    *args, **kwargs
        The other arguments, without `keep` and `threads`: each node uses all of its cores.
    address : str
        "local": a cluster of this machine alone. "auto", or HOST:PORT: a cluster that runs.

    Raises
    ------
    InputError
        If Ray is missing, there is no such cluster, or an argument is wrong.

    Examples
    --------
    >>> table = at.cluster.run(at.sun_hours, "city.glb", days="year:2026", address="auto")  # doctest: +SKIP
    """
    if not inspect.isfunction(function) or "keep" not in inspect.signature(function).parameters:
        name = getattr(function, "__name__", quoted(function))
        raise InputError(f"{name} has no parts; use sun_hours, visibility_matrix, bake or dataset")
    scene = path_of(scene, "scene")
    text(address, "address")
    home = function.__module__, function.__name__
    with temporary_folder() as folder:
        prepare = partial(_prepare, home, args, kwargs)
        plan = None if kwargs.get("plan") is None else str(kwargs["plan"])
        engine = Cluster(folder / "parts", address, prepare, files_in(_named(function, scene, args, kwargs)), plan)
        return function(_opened(function, scene), *args, keep=engine, **kwargs)


def _named(function: Callable, scene, args, kwargs) -> dict[str, Any]:
    """The arguments of a call by their names."""
    try:
        return dict(inspect.signature(function).bind(scene, *args, **kwargs).arguments)
    except TypeError as error:
        raise InputError(f"{function.__name__}: {error}; see its documentation") from None


def _opened(function: Callable, scene):
    """The scene as a function takes it: `bake` keeps what else is in the file."""
    return scene if function.__name__ == "bake" else load(scene)


def _prepare(home: tuple[str, str], args, kwargs, paths: dict[str, str], threads: int, engine: UnitCollector) -> None:
    """Begin the call on a node. Its results go to the current folder."""
    function = getattr(import_module(home[0]), home[1])
    named = _named(function, Path(), args, kwargs)
    named |= with_files(named, paths)
    named["scene"] = _opened(function, named["scene"])
    for name in _OUTPUTS:
        if named.get(name) is not None:
            named[name] = Path(named[name]).name
    function(**named, threads=threads, keep=engine)
