"""The worker of a node, the probe that precedes it, and `survey`, which lists the nodes for ``antumbra doctor``."""

import os
import platform
import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from ..base.files import file_lock, temporary_folder
from ..base.progress import ignore_progress, progress_listener
from ..engine.plan import DEFAULT_PLAN, parse_plan
from ..engine.precompilation import compile_missing, missing_of
from ..kernels.toolchain import kernel_manifest
from ..kernels.toolchain.kernel_cache import user_cache
from ..version import VERSION
from ..work.estimates import Estimate
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
    left: tuple[int, ...] = ()  # units of each kind that are not done, for estimates; empty: none are wanted


class Beginning(NamedTuple):
    """The answer of a worker that has opened the scene."""

    signature: list[tuple[int, list[str]]]
    estimates: list[Estimate | None]  # of each kind of units; empty: they were not wanted


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
        self._paths: dict[str, str] | None = None  # of the inputs
        self._units: list[tuple[Units, int]] = []

    def begin(self, work: NodeWork, read: Callable[[str, int], bytes]) -> Beginning:
        """Open the inputs, compile missing kernels, and prepare the work or its next stage.

        read : reads a piece of a file on the driver, see `node_files.local_path`
        """
        with progress_listener(ignore_progress):
            if self._paths is None:
                self._paths = {name: local_path(each, read, None) for name, each in work.inputs.items()}
                os.chdir(self.folder)  # results have relative paths
                precompile_plan_kernels(work.plan)
            collector = UnitCollector(Path(work.folder))
            work.prepare(self._paths, self._threads, collector)
            estimates = [units.estimate(left) for units, left in zip(collector.work, work.left)]
        self._units = [(units, k) for _, units, k in numbered(collector.work)]
        return Beginning(signature(collector.work), estimates)

    def is_there(self) -> bool:
        """True: an answer means that the worker has its cores, and that its process runs."""
        return True

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


# --- Before a node gets a worker --------------------------------------------------------------------------------------


def probe() -> Callable[[], tuple[str | None, str]]:
    """A function for a node: (version of the package there, why it cannot be imported).

    It is local, so that it is sent as code: a node without the package could not look it up.
    """

    def version_there() -> tuple[str | None, str]:
        try:
            from antumbra import version
        except ModuleNotFoundError as error:
            return None, "" if error.name == "antumbra" else str(error)
        except Exception as error:
            return None, f"{type(error).__name__}: {error}"
        return version.VERSION, ""

    return version_there


def fault_of(version: str | None, reason: str) -> str:
    """Why a node with this answer of a `probe` cannot do work of this machine; empty if it can."""
    if version == VERSION:
        return ""
    if version is not None:
        return f"has antumbra {version}, and this machine {VERSION}; install the same version there"
    cure = f"pip install 'antumbra[ray]=={VERSION}'"
    return f"cannot import antumbra ({reason}); repair it there: {cure}" if reason else f"lacks antumbra; {cure} there"


# --- Nodes and the files of the driver --------------------------------------------------------------------------------


def name_of(node: dict[str, Any]) -> str:
    """A node by its host, its address and the start of its id, as in Ray's own lists."""
    return f"{node['NodeManagerHostname']} ({node['NodeManagerAddress']}, node {node['NodeID'][:8]})"


def on_node(ray: Any, node: str) -> Any:
    """The strategy that places an actor on a node."""
    return ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(node, soft=False)


class Reader:
    """Reads files on the driver's machine for other nodes."""

    def piece(self, path: str, offset: int) -> bytes:
        return piece_of(path, offset)


class RemoteReader:
    """A function that calls a `Reader` in another process."""

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
    """The resources of each node, sorted by host; "error" for nodes that do not answer or cannot import the package."""
    found = dict[Any, dict[str, Any]]()
    asked = dict[Any, Any]()  # call for the resources -> the call of the probe
    for node in ray.nodes():
        if node["Alive"]:
            there = {"num_cpus": 0, "max_retries": 0, "scheduling_strategy": on_node(ray, node["NodeID"])}
            probed = ray.remote(probe()).options(**there).remote()
            call = ray.remote(about_node).options(**there).remote()
            cores = int(node["Resources"].get("CPU", 0))
            found[call] = {"node": name_of(node), "host": node["NodeManagerHostname"], "cores": cores}
            asked[call] = probed
    ready, late = ray.wait(list(found), num_returns=len(found), timeout=seconds)
    for call in late:
        found[call]["error"] = f"no answer in {seconds:g} s"
    for call in ready:
        try:
            found[call] = ray.get(call) | found[call]
        except ray.exceptions.RayError as error:
            found[call]["error"] = _cause(ray, asked[call]) or " ".join(str(error).split())[:160]
    return sorted(found.values(), key=lambda each: each["node"])


def _cause(ray: Any, probed: Any) -> str:
    """Why a node with this call of a `probe` cannot import the package; empty if it can."""
    try:
        return fault_of(*ray.get(probed, timeout=1.0))
    except ray.exceptions.RayError:
        return ""
