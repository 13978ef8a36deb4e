"""The workers of a cluster, one per node, and the pool that assigns units to them and replaces lost ones.

`survey` lists the resources of each node, for ``antumbra doctor``.
"""

import os
import platform
import shutil
import tempfile
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from time import monotonic, perf_counter
from typing import Any, NamedTuple

from ..base.errors import InputError
from ..base.files import atomic_output, file_lock, temporary_folder
from ..base.progress import ignore_progress, progress_listener, report_progress
from ..engine.plan import DEFAULT_PLAN, parse_plan
from ..engine.precompilation import compile_missing, missing_of
from ..kernels.toolchain import kernel_manifest
from ..kernels.toolchain.kernel_cache import user_cache
from ..version import VERSION
from ..work.executors import UnitCollector, Units, numbered
from ..work.warm_ups import all_examples
from .node_files import Input, local_path, piece_of, user_temporary_folder

# --- The worker of a node: one process with all its cores, which opens the scene once and does units of some work -----


Prepare = Callable[[dict[str, str], int, UnitCollector], Any]
"""prepare(paths of inputs by name, threads, executor): start some work and pass its units to the executor."""


class NodeWork(NamedTuple):
    """Some work, as sent to nodes."""

    prepare: Prepare
    inputs: dict[str, Input]
    plan: str | None
    folder: str  # name of the folder of units


class UnitResult(NamedTuple):
    """The result of a unit."""

    files: dict[str, bytes]  # by their names below the root; empty if the unit failed
    seconds: float


def signature(work: Sequence[Units]) -> list[tuple[int, list[str]]]:
    """The identity of some work: numbers of units, and file names, which contain digests."""
    return [(len(units), units.files(0) if len(units) else []) for units in work]


class Node:
    """The worker of a node. It writes files to its own folder and sends them from there."""

    def __init__(self, threads: int):
        self._threads, self._resources = threads, ExitStack()
        self.folder = self._resources.enter_context(
            temporary_folder()
        )  # that of a killed worker is removed by the next one
        self._units: list[tuple[Units, int]] = []

    def begin(self, work: NodeWork, read: Callable[[str, int], bytes]) -> list[tuple[int, list[str]]]:
        """Open the inputs, compile missing kernels, and prepare the work; return its `signature`.

        read : reads a piece of a file on the driver, see `node_files.local_path`
        """
        with progress_listener(ignore_progress):
            paths = {name: local_path(each, read, None) for name, each in work.inputs.items()}
            os.chdir(self.folder)  # results have relative paths
            precompile_plan_kernels(work.plan)
            collector = UnitCollector(Path(work.folder))
            work.prepare(paths, self._threads, collector)
        self._units = [(units, k) for _, units, k in numbered(collector.work)]
        return signature(collector.work)

    def do(self, number: int) -> UnitResult:
        """Do a unit."""
        units, k = self._units[number]
        start = perf_counter()
        with progress_listener(ignore_progress):
            units.do(k)
        assert units.root is not None
        files = {name: units.root / name for name in units.files(k)}
        if not all(path.exists() for path in files.values()):
            return UnitResult({}, perf_counter() - start)
        contents = {name: path.read_bytes() for name, path in files.items()}
        for path in files.values():
            path.unlink()
        return UnitResult(contents, perf_counter() - start)

    def leave(self) -> None:
        """Remove the worker's files."""
        os.chdir(tempfile.gettempdir())
        self._resources.close()


def precompile_plan_kernels(plan: str | None) -> None:
    """Compile the missing kernels of a plan on this machine. Its other workers wait for them."""
    kernels = {each for example in all_examples([parse_plan(plan or DEFAULT_PLAN)]) for each in example.kernels or ()}
    if missing_of(kernels):
        with file_lock(user_temporary_folder() / "warm.lock"):
            if missing := missing_of(kernels):
                compile_missing(missing)


# --- The pool of workers ----------------------------------------------------------------------------------------------


_AHEAD = 2  # units assigned to a worker: the current one and the next
_TRIES = 4  # losses of a unit with its worker, or of workers on a node, before giving up
_POLL, _SCAN = 0.2, 2.0  # seconds between checks for results and for nodes
_PATIENCE = 120.0  # seconds to wait for the first worker


class Log(NamedTuple):
    """The history of a pool, for measurements. Times are from `time.monotonic`; durations are in seconds."""

    ready: dict[str, float]  # node -> time at which its worker was ready
    seconds: dict[int, float]  # unit -> duration on its node
    written: list[float]  # times at which the files of units were written


class NodeWorker:
    """A worker, running or starting."""

    def __init__(self, node: str, host: str, actor: Any):
        self.node, self.host, self.actor = node, host, actor
        self.ready, self.lost = False, False
        self.pending = 0  # calls without a result yet


class WorkerPool:
    """Runs units of some work on the nodes of a cluster, one worker per node.

    ray : the module, connected
    say : function that prints a line for the user
    """

    def __init__(self, ray: Any, work: Sequence[Units], node_work: NodeWork, say: Callable[[str], None]):
        self._ray, self._work, self._node_work, self._say = ray, work, node_work, say
        self._units = [(units, k) for _, units, k in numbered(work)]
        self._todo = deque[int]()
        self._pending: dict[Any, tuple[NodeWorker, int | None]] = {}  # call -> its worker, and the unit; None: begin
        self._workers: dict[str, NodeWorker] = {}
        self._losses: Counter[str] = Counter()  # by node
        self._tries: Counter[int] = Counter()  # by unit
        self._last_scan = -_SCAN
        self._reader = self._read = None
        self.log = Log({}, {}, [])

    def do(self, numbers: Sequence[int]) -> None:
        """Run the units with these numbers."""
        self._todo.extend(numbers)
        missing, since = set(numbers), monotonic()
        self._start_reader()
        try:
            with report_progress(f"{self._work[0].what or 'frames'}, on a cluster") as progress:
                while missing:
                    self._start_workers()
                    self._assign()
                    if self._workers:
                        since = monotonic()
                    elif monotonic() - since > _PATIENCE:
                        raise InputError("no node of the cluster has a free core; look at: ray status")
                    for number in self._collect():
                        missing.discard(number)
                        progress(len(numbers) - len(missing), len(numbers))
        finally:
            self._stop_workers()

    def _start_reader(self) -> None:
        """Start a process on this node that reads inputs for nodes without them."""
        if not self._node_work.inputs:
            return
        remote, here = self._ray.remote(_Reader), self._ray.get_runtime_context().get_node_id()
        self._reader = remote.options(num_cpus=0, scheduling_strategy=on_node(self._ray, here)).remote()

    def _start_workers(self) -> None:
        """Start a worker on each node without one."""
        if monotonic() - self._last_scan < _SCAN:
            return
        self._last_scan = monotonic()
        for node in self._ray.nodes():
            name, cores = node["NodeID"], int(node["Resources"].get("CPU", 0))
            if node["Alive"] and cores and name not in self._workers and self._losses[name] < _TRIES:
                actor = self._ray.remote(Node).options(
                    num_cpus=cores, max_restarts=0, scheduling_strategy=on_node(self._ray, name)
                )
                worker = NodeWorker(name, node["NodeManagerHostname"], actor.remote(cores))
                self._workers[name] = worker
                self._call(worker, worker.actor.begin.remote(self._node_work, _RemoteReader(self._reader)), None)

    def _assign(self) -> None:
        for worker in self._workers.values():
            while worker.ready and worker.pending < _AHEAD and self._todo:
                number = self._todo.popleft()
                self._call(worker, worker.actor.do.remote(number), number)

    def _call(self, worker: NodeWorker, call: Any, number: int | None) -> None:
        worker.pending += 1
        self._pending[call] = worker, number

    def _collect(self) -> list[int]:
        """Write the results that have arrived; return the numbers of their units."""
        if not self._pending:
            self._ray.wait([self._ray.put(0)], timeout=_POLL)
            return []
        ready, _ = self._ray.wait(list(self._pending), num_returns=1, timeout=_POLL)
        done = []
        for call in ready:
            worker, number = self._pending[call]
            answer = self._answer(call, worker)
            if worker.lost:
                continue
            del self._pending[call]
            worker.pending -= 1
            if number is None:
                self._check(worker, answer)
            else:
                self._write(number, answer.files, worker)
                self.log.seconds[number] = answer.seconds
                self.log.written.append(monotonic())
                done.append(number)
        return done

    def _answer(self, call: Any, worker: NodeWorker) -> Any:
        """The result of a call. If its worker is lost, requeue its units."""
        errors = self._ray.exceptions
        try:
            return self._ray.get(call)
        except errors.RayTaskError as error:
            cause = error.cause
            raise cause if isinstance(cause, Exception) else error from None
        except (errors.RayActorError, errors.WorkerCrashedError, errors.ObjectLostError, errors.NodeDiedError):
            self._drop(worker)

    def _drop(self, worker: NodeWorker) -> None:
        worker.lost = True
        self._workers.pop(worker.node, None)
        self._losses[worker.node] += 1
        with suppress(Exception):
            self._ray.kill(worker.actor)
        lost = [number for owner, number in self._pending.values() if owner is worker and number is not None]
        self._pending = {call: entry for call, entry in self._pending.items() if entry[0] is not worker}
        self._todo.extendleft(reversed(lost))
        self._tries.update(lost[:1])  # the others had not started
        self._last_scan = -_SCAN
        self._say(f"note: the worker on {worker.host} was lost; repeating {len(lost)} parts")
        often = [number for number in lost if self._tries[number] >= _TRIES]
        if often:
            raise InputError(f"part {often[0]} was lost {_TRIES} times with its worker; the nodes may lack memory")

    def _check(self, worker: NodeWorker, answer: list[tuple[int, list[str]]]) -> None:
        if answer != signature(self._work):
            raise InputError(
                f"{worker.host} would do different work than this machine; install the same version of antumbra there"
            )
        worker.ready = True
        self.log.ready[worker.node] = monotonic()

    def _write(self, number: int, files: dict[str, bytes], worker: NodeWorker) -> None:
        units, k = self._units[number]
        root = units.root
        assert root is not None
        for name, data in files.items():
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_output(path) as temporary:
                temporary.write_bytes(data)
        if not files:
            units.do(k)  # fails here as on the node, which shows the error to the user
        elif not units.done(k):
            raise InputError(
                f"{worker.host} sent a part of different work ({next(iter(files))}); run the command again"
            )
        else:
            units.found(k)

    def _stop_workers(self) -> None:
        """Stop all workers."""
        with suppress(Exception):
            leaving = [worker.actor.leave.remote() for worker in self._workers.values() if not worker.pending]
            self._ray.wait(leaving, num_returns=len(leaving), timeout=5.0) if leaving else None
        for actor in [*(worker.actor for worker in self._workers.values()), *([self._reader] if self._reader else [])]:
            with suppress(Exception):
                self._ray.kill(actor)


def on_node(ray: Any, node: str) -> Any:
    """The strategy that places an actor on a node."""
    return ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(node, soft=False)


class _Reader:
    """Reads files on the driver's machine for other nodes."""

    def piece(self, path: str, offset: int) -> bytes:
        return piece_of(path, offset)


class _RemoteReader:
    """A function that calls a `_Reader` in another process."""

    def __init__(self, reader: Any):
        self._reader = reader

    def __call__(self, path: str, offset: int) -> bytes:
        import ray

        piece: bytes = ray.get(self._reader.piece.remote(path, offset))
        return piece


# --- Resources of the nodes, for ``antumbra doctor`` ------------------------------------------------------------------


def about_node() -> dict[str, Any]:
    """The resources of this machine: cores, memory and disk space in GiB, package version, missing kernels."""
    kernels = kernel_manifest.read_manifests(kernel_manifest.MANIFEST).kernels
    facts: dict[str, Any] = {"host": platform.node(), "cores": os.cpu_count(), "memory": _memory()}
    facts |= {"room": shutil.disk_usage(tempfile.gettempdir()).free / 2**30, "antumbra": VERSION}
    return {**facts, "missing": len(missing_of(kernels)), "cache": str(user_cache().path)}


def _memory() -> float | None:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    except (AttributeError, OSError, ValueError):  # not on Windows
        return None


def survey(ray: Any, seconds: float = 60.0) -> list[dict[str, Any]]:
    """The resources of each node, sorted by host; "error" for nodes that do not answer."""
    ask = ray.remote(about_node)
    calls = {}
    for node in ray.nodes():
        if node["Alive"]:
            call = ask.options(num_cpus=0, max_retries=0, scheduling_strategy=on_node(ray, node["NodeID"])).remote()
            calls[call] = node["NodeManagerHostname"], int(node["Resources"].get("CPU", 0))
    ready, late = ray.wait(list(calls), num_returns=len(calls), timeout=seconds)
    records = [{"host": calls[call][0], "error": f"no answer in {seconds:g} s"} for call in late]
    for call in ready:
        host, cores = calls[call]
        try:
            records.append({**ray.get(call), "cores": cores})
        except ray.exceptions.RayError as error:
            records.append({"host": host, "error": " ".join(str(error).split())[:160]})
    return sorted(records, key=lambda each: each["host"])
