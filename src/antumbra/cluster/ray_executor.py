"""The executor that distributes units over a Ray cluster, and `run`, which calls a function with it."""

import inspect
import os
import re
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.checks import path_of, quoted, text
from ..base.errors import InputError
from ..base.extras import import_extra
from ..base.files import temporary_folder
from ..base.progress import LOG
from ..engine.scene_loading import load
from ..work.executors import UnitCollector, Units, numbered
from .node_files import files_in, input_of, with_files

# --- The executor -----------------------------------------------------------------------------------------------------


if TYPE_CHECKING:
    from .ray_workers import Log, Prepare

_STORE = 256 << 20  # bytes of the object store of a local cluster
_TIMEOUT = 5.0  # seconds to connect to a head node
_HOST_PORT = re.compile(r"\[?([^\[\]]+)\]?:(\d{1,5})")  # HOST:PORT


class Cluster:
    """Runs the units of some work on the nodes of a Ray cluster, and writes the files they return.

    folder : folder for intermediate units
    address : "local": a cluster of this machine alone; "auto" or HOST:PORT: a running cluster
    prepare : starts the work on a node, see `ray_workers.Prepare`
    inputs : the files that the work reads, by the names that `prepare` uses
    plan : plan whose kernels are compiled before the first unit
    say : function that prints a line for the user; None: logs it to ``antumbra``
    """

    def __init__(
        self,
        folder: Path,
        address: str,
        prepare: "Prepare",
        inputs: dict[str, Path],
        plan: str | None = None,
        say: Callable[[str], None] | None = None,
    ):
        import_extra("ray", "a cluster", "ray")
        self.folder, self.address, self._say = folder, address, say or LOG.info
        self._prepare, self._inputs, self._plan = prepare, inputs, plan
        self.log: Log | None = None  # of the last run

    def finish(self, work: Sequence[Units]) -> bool:
        from .ray_workers import NodeWork, WorkerPool

        todo = []
        for number, units, k in numbered(work):
            if units.done(k):
                units.found(k)
            else:
                todo.append(number)
        if todo:
            inputs = {name: input_of(path) for name, path in self._inputs.items()}
            node_work = NodeWork(self._prepare, inputs, self._plan, self.folder.name)
            with connected(self.address) as ray:
                pool = WorkerPool(ray, work, node_work, self._say)
                pool.do(todo)
                self.log = pool.log
        return True

    def end(self, work: Sequence[Units]) -> None:
        for units in work:
            units.clear()


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """The module ``ray``, connected to a cluster. An existing connection is reused and kept.

    Raises
    ------
    InputError
        If Ray is missing, or there is no cluster at the address, even if a connection exists.
    """
    ray = import_extra("ray", "a cluster", "ray")
    if "://" in address:
        raise InputError(f"--ray is {address!r}; run the command on a node of the cluster, with --ray auto")
    if address not in ("auto", "local"):
        _check_address(ray, address)
    if ray.is_initialized():
        yield ray
        return
    options: dict[str, Any] = {}
    if address == "local":
        options = {"num_cpus": os.cpu_count(), "include_dashboard": False, "object_store_memory": _STORE}
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        ray.init(address=address, log_to_driver=False, logging_level="ERROR", **options)
    except (ConnectionError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(f"--ray {address}: cannot be reached ({reason}); look at: ray status") from None
    try:
        yield ray
    finally:
        ray.shutdown()


def _check_address(ray: Any, address: str) -> None:
    """Raise InputError unless HOST:PORT accepts connections. Ray itself retries for more than half a minute."""
    match = _HOST_PORT.fullmatch(address.strip())
    if match is None or not 0 < int(match[2]) < 65536:
        raise InputError(f"--ray is {address!r}; write auto, local, or HOST:PORT of the head node")
    hosts = [match[1]]
    if match[1] in ("localhost", "127.0.0.1"):
        hosts.append(ray.util.get_node_ip_address())  # as Ray resolves it
    reason = ""
    for host in hosts:
        try:
            socket.create_connection((host, int(match[2])), _TIMEOUT).close()
            return
        except OSError as error:
            reason = error.strerror or str(error)
    raise InputError(f"--ray {address}: cannot be reached ({reason}); look at: ray status")


# --- `run`, the Python counterpart of ``--ray`` -----------------------------------------------------------------------


_OUTPUTS = "output", "matrix", "folder"


def run(
    function: Callable[..., Any], scene: str | PathLike[str], *args: Any, address: str = "local", **kwargs: Any
) -> Any:
    """Call a function of this package on a Ray cluster (needs ``antumbra[ray]``).

    Each node opens the scene by its path, or fetches the file once to its disk, and does part of the work. The result
    equals that of ``function(load(scene), *args, **kwargs)``.

    Parameters
    ----------
    function : function
        One with the argument `keep`, such as `antumbra.sun_hours` or `antumbra.viewshed`.
    scene : str or path-like
        The path of the scene.
    *args, **kwargs
        The other arguments, except `keep` and `threads`: each node uses all its cores.
    address : str
        "local": a cluster of this machine alone. "auto" or HOST:PORT: a running cluster.

    Raises
    ------
    InputError
        If Ray is missing, there is no such cluster, or an argument is invalid.

    Examples
    --------
    >>> table = at.cluster.run(at.sun_hours, "city.glb", days="year:2026", address="auto")  # doctest: +SKIP
    """
    if not inspect.isfunction(function) or "keep" not in inspect.signature(function).parameters:
        name = getattr(function, "__name__", quoted(function))
        raise InputError(f"{name} cannot be distributed; use a function with the argument keep, such as sun_hours")
    scene = path_of(scene, "scene")
    text(address, "address")
    home = function.__module__, function.__name__
    with temporary_folder() as folder:
        prepare = partial(prepare_call, home, args, kwargs)
        plan = None if kwargs.get("plan") is None else str(kwargs["plan"])
        executor = Cluster(
            folder / "parts", address, prepare, files_in(named_arguments(function, scene, args, kwargs)), plan
        )
        return function(_opened(function, scene), *args, keep=executor, **kwargs)


def named_arguments(
    function: Callable[..., Any], scene: str | PathLike[str], args: tuple[Any, ...], kwargs: dict[str, Any]
) -> dict[str, Any]:
    """The arguments of a call by name."""
    try:
        return dict(inspect.signature(function).bind(scene, *args, **kwargs).arguments)
    except TypeError as error:
        raise InputError(f"{function.__name__}: {error}; see its documentation") from None


def _opened(function: Callable[..., Any], scene: str | PathLike[str]) -> Any:
    """The scene as a function expects it: `bake` takes the path, since it keeps everything else in the file."""
    return scene if function.__name__ == "bake" else load(scene)


def prepare_call(
    home: tuple[str, str],
    args: tuple[Any, ...],
    kwargs: dict[str, Any],
    paths: dict[str, str],
    threads: int,
    executor: UnitCollector,
) -> None:
    """Start the call on a node. Its results go to the current folder."""
    function = getattr(import_module(home[0]), home[1])
    named = named_arguments(function, Path(), args, kwargs)
    named |= with_files(named, paths)
    named["scene"] = _opened(function, named["scene"])
    for name in _OUTPUTS:
        if named.get(name) is not None:
            named[name] = Path(named[name]).name
    function(**named, threads=threads, keep=executor)
