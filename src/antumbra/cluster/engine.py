"""The engine that hands a job's units to a Ray cluster."""

import os
import re
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..extras import import_extra
from ..jobs.executors import Units, numbered
from ..progress import LOG
from .inputs import input_of

if TYPE_CHECKING:
    from .crew import Log

_STORE = 256 << 20  # bytes of the object store of a local cluster
_PATIENCE = 5.0  # seconds until a head node answers
_PLACE = re.compile(r"\[?([^\[\]]+)\]?:(\d{1,5})")  # HOST:PORT


class Cluster:
    """Does the units of a job on the nodes of a Ray cluster, and writes the files that they send.

    folder : where units are kept that are no results
    address : "local": a cluster of this machine alone; "auto", or HOST:PORT: one that runs
    prepare : begins the job on a node, see `node.Prepare`
    inputs : the files that the job reads, by names that `prepare` knows
    plan : whose kernels are compiled before the first unit
    say : tells the user a line; None: by the logger ``antumbra``
    """

    def __init__(
        self, folder: Path, address: str, prepare, inputs: dict[str, Path], plan: str | None = None,
        say: Callable[[str], None] | None = None,
    ):  # fmt: skip
        import_extra("ray", "a cluster", "ray")
        self.folder, self.address, self._say = folder, address, say or LOG.info
        self._prepare, self._inputs, self._plan = prepare, inputs, plan
        self.log: Log | None = None  # of the last job

    def finish(self, job: Sequence[Units]) -> bool:
        from .crew import Crew
        from .node import NodeJob

        todo = []
        for number, units, k in numbered(job):
            if units.done(k):
                units.found(k)
            else:
                todo.append(number)
        if todo:
            inputs = {name: input_of(path) for name, path in self._inputs.items()}
            sent = NodeJob(self._prepare, inputs, self._plan, self.folder.name)
            with connected(self.address) as ray:
                crew = Crew(ray, job, sent, self._say)
                crew.do(todo)
                self.log = crew.log
        return True

    def end(self, job: Sequence[Units]) -> None:
        for units in job:
            units.clear()


@contextmanager
def connected(address: str) -> Iterator:
    """The module ``ray``, connected to a cluster. A connection that exists already is used, and stays.

    Raises
    ------
    InputError
        If Ray is missing, or there is no cluster at the address, also where a connection exists.
    """
    ray = import_extra("ray", "a cluster", "ray")
    if "://" in address:
        raise InputError(f"--ray is {address!r}; run the command on a node of the cluster, with --ray auto")
    if address not in ("auto", "local"):
        _check_place(ray, address)
    if ray.is_initialized():
        yield ray
        return
    own = {}
    if address == "local":
        own = {"num_cpus": os.cpu_count(), "include_dashboard": False, "object_store_memory": _STORE}
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        ray.init(address=address, log_to_driver=False, logging_level="ERROR", **own)
    except (ConnectionError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(f"--ray {address}: cannot be reached ({reason}); look at: ray status") from None
    try:
        yield ray
    finally:
        ray.shutdown()


def _check_place(ray, address: str) -> None:
    """Raise InputError unless something listens at HOST:PORT. Ray itself tries for more than half a minute."""
    match = _PLACE.fullmatch(address.strip())
    if match is None or not 0 < int(match[2]) < 65536:
        raise InputError(f"--ray is {address!r}; write auto, local, or HOST:PORT of the head node")
    hosts = [match[1]]
    if match[1] in ("localhost", "127.0.0.1"):
        hosts.append(ray.util.get_node_ip_address())  # as Ray itself reads it
    reason = ""
    for host in hosts:
        try:
            socket.create_connection((host, int(match[2])), _PATIENCE).close()
            return
        except OSError as error:
            reason = error.strerror or str(error)
    raise InputError(f"--ray {address}: cannot be reached ({reason}); look at: ray status")
