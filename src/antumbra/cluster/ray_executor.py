"""The executor that distributes units over a Ray cluster, and `run`, which calls a function with it."""

import atexit
import inspect
import os
import re
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from functools import partial
from importlib import import_module
from os import PathLike
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from ..base.checks import path_of, quoted, text
from ..base.errors import InputError, UnavailableError
from ..base.extras import import_extra
from ..base.files import temporary_folder
from ..base.progress import LOG
from ..base.wording import some_of
from ..engine.scene_loading import load
from ..work.executors import UnitCollector, UnitCount, Units, numbered
from .node_files import files_in, input_of, with_files
from .own_stdout import own_stdout

# --- The executor -----------------------------------------------------------------------------------------------------


if TYPE_CHECKING:
    from .ray_workers import Prepare
    from .worker_pool import Log, WorkerPool

_STORE = 256 << 20  # bytes of the object store of a local cluster
_TIMEOUT = 5.0  # seconds in which a head node answers
_ASKING = "asking the head of the cluster"  # name of a thread
_HOST_PORT = re.compile(r"\[?([^\[\]]+)\]?:(\d{1,5})")  # HOST:PORT


class Cluster(UnitCount):
    """Runs the units of some work on the nodes of a Ray cluster, and writes the files they return.

    Workers are kept from `prepare`, which runs a stage, to `finish` or `close`.

    folder : folder for intermediate units
    address : "local": a cluster of this machine alone; "auto" or HOST:PORT: a running cluster
    prepare : starts the work on a node, see `ray_workers.Prepare`
    inputs : the files that the work reads, by the names that `prepare` uses
    plan : plan whose kernels are compiled before the first unit
    say : function that prints a line for the user; None: logs it to ``antumbra``
    resume : what an abnormal end tells the user about the parts that are done; empty: nothing, since they are lost
    """

    def __init__(
        self,
        folder: Path,
        address: str,
        prepare: "Prepare",
        inputs: dict[str, Path],
        plan: str | None = None,
        say: Callable[[str], None] | None = None,
        resume: str = "",
    ):
        import_extra("ray", "a cluster", "ray")
        self.folder, self.address, self._say, self._resume = folder, address, say or LOG.warning, resume
        self._prepare, self._inputs, self._plan = prepare, inputs, plan
        self.log: Log | None = None  # of the last run
        self._pool: WorkerPool | None = None
        self._kept = ExitStack()  # ends the workers, then the connection

    def finish(self, work: Sequence[Units]) -> bool:
        try:
            return self.prepare(work)
        finally:
            self.close()

    def prepare(self, work: Sequence[Units]) -> bool:
        todo = []
        for number, units, k in numbered(work):
            if units.done(k):
                units.found(k)
            else:
                todo.append(number)
        if todo:
            pool = self._pool = self._pool or self._started_pool()
            try:
                pool.do(work, todo)
            except BaseException as error:
                self.close()
                total = sum(map(len, work))
                self._explain(error, f"{some_of(total - pool.n_missing, total, 'part', 'are')} done; {self._resume}")
                raise
        self.add(sum(map(len, work)), len(todo))
        return True

    def close(self) -> None:
        """Stop the workers."""
        self._pool = None
        self._kept.close()

    def _started_pool(self) -> "WorkerPool":
        from .ray_workers import NodeWork
        from .worker_pool import WorkerPool

        inputs = {name: input_of(path) for name, path in self._inputs.items()}
        node_work = NodeWork(self._prepare, inputs, self._plan, self.folder.name)
        pool = WorkerPool(self._kept.enter_context(connected(self.address)), node_work, self._say)
        self._kept.callback(pool.end)
        self.log = pool.log
        return pool

    def _explain(self, error: BaseException, state: str) -> None:
        """Add to an abnormal end how to resume; what has no line for the user gets a line of its own."""
        if not self._resume:
            return
        for kind in (InputError, UnavailableError):
            if isinstance(error, kind):
                raise kind(f"{error}; {state}") from error
        self._say(f"note: {state}")

    def end(self, work: Sequence[Units]) -> None:
        for units in work:
            units.clear()


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """The module ``ray``, connected to a cluster. An existing connection is reused and kept.

    What Ray itself prints goes to standard error, since standard output may be JSON.

    Raises
    ------
    InputError
        If Ray is missing, or no machine can reach the address, even if a connection exists.
    UnavailableError
        If nothing answers at the address.
    """
    ray = import_extra("ray", "a cluster", "ray")
    if "://" in address:
        raise InputError(f"--ray is {address!r}; run the command on a node of the cluster, with --ray auto")
    if address != "local":
        _check_address(ray, address)
    with own_stdout():
        if ray.is_initialized():
            yield ray
            return
        _connect(ray, address)
        try:
            yield ray
        finally:
            _disconnect(ray)


def _connect(ray: Any, address: str) -> None:
    options: dict[str, Any] = {}
    if address == "local":
        options = {"num_cpus": os.cpu_count(), "include_dashboard": False, "object_store_memory": _STORE}
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        ray.init(address=address, log_to_driver=False, logging_level="ERROR", **options)
    except ConnectionError as error:
        raise _unreachable(address, str(error)) from None
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(f"--ray {address}: cannot be used ({reason}); look at: ray status") from None


def _disconnect(ray: Any) -> None:
    """Disconnect if the head answers. Otherwise Ray would wait for it without end, now or when the process exits."""
    head = Thread(target=ray.nodes, name=_ASKING, daemon=True)
    head.start()
    head.join(_TIMEOUT)
    if head.is_alive():
        atexit.unregister(ray.shutdown)
    else:
        with redirect_stdout(sys.stderr):  # Ray prints messages that it has held back
            ray.shutdown()


def is_waiting_for_head() -> bool:
    """Whether Ray still waits for a head that is lost. A process that ends regularly would then crash in Ray."""
    return any(thread.name == _ASKING for thread in threading.enumerate())


def _unreachable(address: str, reason: str) -> UnavailableError:
    return UnavailableError(
        f"--ray {address}: cannot be reached ({' '.join(reason.split())[:160]}); look at: ray status"
    )


def _check_address(ray: Any, address: str) -> None:
    """Raise an error unless the head node accepts connections. Ray itself retries for more than half a minute.

    Ray connects to the machine's own address where the head's is 127.0.0.1, and waits without end if only the latter
    accepts connections.
    """
    given = address
    if address == "auto":
        with suppress(Exception):  # Ray has no public function that returns the address
            given = ray._private.services.get_ray_address_from_environment("auto", None)
        if given in ("auto", None):  # there is no cluster, as `_connect` finds
            return
    match = _HOST_PORT.fullmatch(given.strip())
    if match is None or not 0 < int(match[2]) < 65536:
        raise InputError(f"--ray is {given!r}; write auto, local, or HOST:PORT of the head node")
    host, port = match[1], int(match[2])
    is_loopback = host in ("localhost", "::1") or host.startswith("127.")
    reason = _refusal(ray.util.get_node_ip_address() if is_loopback else host, port)
    if reason and is_loopback and not _refusal(host, port):
        raise InputError(
            f"--ray {address}: the head listens on {host} alone, where no other machine can reach it; start it with "
            "ray start --head --node-ip-address=ADDRESS"
        )
    if reason:
        raise _unreachable(address, reason)


def _refusal(host: str, port: int) -> str:
    """Why a connection to a port is refused; empty if it is accepted."""
    try:
        socket.create_connection((host, port), _TIMEOUT).close()
    except OSError as error:
        return error.strerror or str(error)
    return ""


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
        If Ray is missing, or an argument is invalid.
    UnavailableError
        If there is no such cluster, it has no free cores, or it loses workers again and again.

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
