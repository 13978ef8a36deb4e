"""The workers of a cluster, one on each node: who does what, and what happens if one is lost."""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from time import monotonic
from typing import Any, NamedTuple

from ..errors import InputError
from ..files import atomic_output
from ..jobs.executors import Units, numbered
from ..progress import report_progress
from .inputs import piece_of
from .node import Node, NodeJob, signature

_AHEAD = 2  # units that a worker has: one that it does, and the next one
_TRIES = 4  # losses of a unit with its worker, or of workers of a node, until nobody tries again
_POLL, _LOOK = 0.2, 2.0  # seconds between two looks at results, and at the nodes of the cluster
_PATIENCE = 120.0  # seconds without any worker


class Log(NamedTuple):
    """What a crew did, for measurements. Times are those of `time.monotonic`, or seconds."""

    ready: dict[str, float]  # node -> when its worker was ready
    seconds: dict[int, float]  # unit -> how long a node took
    written: list[float]  # when the files of each unit had been written


class Worker:
    """A worker, or one that is being started."""

    def __init__(self, node: str, host: str, actor):
        self.node, self.host, self.actor = node, host, actor
        self.ready, self.lost = False, False
        self.flying = 0  # calls whose answer has not come


class Crew:
    """Does units of a job on the nodes of a cluster.

    ray : the module, connected
    say : tells the user a line
    """

    def __init__(self, ray, job: Sequence[Units], sent: NodeJob, say: Callable[[str], None]):
        self._ray, self._job, self._sent, self._say = ray, job, sent, say
        self._units = [(units, k) for _, units, k in numbered(job)]
        self._todo = deque[int]()
        self._flying: dict[Any, tuple[Worker, int | None]] = {}  # call -> who does it, and the unit; None: begin
        self._workers: dict[str, Worker] = {}
        self._losses: Counter[str] = Counter()  # by node
        self._tries: Counter[int] = Counter()  # by unit
        self._looked = -_LOOK
        self._reader = self._read = None
        self.log = Log({}, {}, [])

    def do(self, numbers: Sequence[int]) -> None:
        """Do the units of these numbers."""
        self._todo.extend(numbers)
        missing, since = set(numbers), monotonic()
        self._serve_inputs()
        try:
            with report_progress(f"{self._job[0].what or 'frames'}, on a cluster") as progress:
                while missing:
                    self._look_for_nodes()
                    self._hand_out()
                    if self._workers:
                        since = monotonic()
                    elif monotonic() - since > _PATIENCE:
                        raise InputError("no node of the cluster has a free core; look at: ray status")
                    for number in self._heard():
                        missing.discard(number)
                        progress(len(numbers) - len(missing), len(numbers))
        finally:
            self._dismiss()

    def _serve_inputs(self) -> None:
        """Start a process beside this one that reads inputs for nodes that lack them."""
        if not self._sent.inputs:
            return
        remote, here = self._ray.remote(_Reader), self._ray.get_runtime_context().get_node_id()
        self._reader = remote.options(num_cpus=0, scheduling_strategy=on_node(self._ray, here)).remote()

    def _look_for_nodes(self) -> None:
        """Start a worker on each node that has none."""
        if monotonic() - self._looked < _LOOK:
            return
        self._looked = monotonic()
        for node in self._ray.nodes():
            name, cores = node["NodeID"], int(node["Resources"].get("CPU", 0))
            if node["Alive"] and cores and name not in self._workers and self._losses[name] < _TRIES:
                actor = self._ray.remote(Node).options(
                    num_cpus=cores, max_restarts=0, scheduling_strategy=on_node(self._ray, name)
                )
                worker = Worker(name, node["NodeManagerHostname"], actor.remote(cores))
                self._workers[name] = worker
                self._call(worker, worker.actor.begin.remote(self._sent, _Remote(self._reader)), None)

    def _hand_out(self) -> None:
        for worker in self._workers.values():
            while worker.ready and worker.flying < _AHEAD and self._todo:
                number = self._todo.popleft()
                self._call(worker, worker.actor.do.remote(number), number)

    def _call(self, worker: Worker, call, number: int | None) -> None:
        worker.flying += 1
        self._flying[call] = worker, number

    def _heard(self) -> list[int]:
        """The units whose results have come; they are written."""
        if not self._flying:
            self._ray.wait([self._ray.put(0)], timeout=_POLL)
            return []
        ready, _ = self._ray.wait(list(self._flying), num_returns=1, timeout=_POLL)
        done = []
        for call in ready:
            worker, number = self._flying[call]
            answer = self._answer(call, worker)
            if worker.lost:
                continue
            del self._flying[call]
            worker.flying -= 1
            if number is None:
                self._check(worker, answer)
            else:
                self._write(number, answer.files, worker)
                self.log.seconds[number] = answer.seconds
                self.log.written.append(monotonic())
                done.append(number)
        return done

    def _answer(self, call, worker: Worker):
        """The answer of a call; if its worker is lost, what it had goes to others."""
        errors = self._ray.exceptions
        try:
            return self._ray.get(call)
        except errors.RayTaskError as error:
            cause = error.cause
            raise cause if isinstance(cause, Exception) else error from None
        except (errors.RayActorError, errors.WorkerCrashedError, errors.ObjectLostError, errors.NodeDiedError):
            self._lose(worker)

    def _lose(self, worker: Worker) -> None:
        worker.lost = True
        self._workers.pop(worker.node, None)
        self._losses[worker.node] += 1
        with suppress(Exception):
            self._ray.kill(worker.actor)
        lost = [number for who, number in self._flying.values() if who is worker and number is not None]
        self._flying = {call: held for call, held in self._flying.items() if held[0] is not worker}
        self._todo.extendleft(reversed(lost))
        self._tries.update(lost[:1])  # the others were only waiting
        self._looked = -_LOOK
        self._say(f"note: the worker on {worker.host} was lost; {len(lost)} parts are done again")
        often = [number for number in lost if self._tries[number] >= _TRIES]
        if often:
            raise InputError(f"part {often[0]} was lost {_TRIES} times with its worker; do the nodes lack memory?")

    def _check(self, worker: Worker, told) -> None:
        if told != signature(self._job):
            raise InputError(
                f"{worker.host} would do other work than this machine; install the same version of antumbra there"
            )
        worker.ready = True
        self.log.ready[worker.node] = monotonic()

    def _write(self, number: int, files: dict[str, bytes], worker: Worker) -> None:
        units, k = self._units[number]
        root = units.root
        assert root is not None
        for name, data in files.items():
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_output(path) as temporary:
                temporary.write_bytes(data)
        if not files:
            units.do(k)  # it fails here as it failed there, and the user hears why
        elif not units.done(k):
            raise InputError(f"{worker.host} sent a part of other work ({next(iter(files))}); run the command again")
        else:
            units.found(k)

    def _dismiss(self) -> None:
        """End all workers."""
        with suppress(Exception):
            leaving = [worker.actor.leave.remote() for worker in self._workers.values() if not worker.flying]
            self._ray.wait(leaving, num_returns=len(leaving), timeout=5.0) if leaving else None
        for actor in [*(worker.actor for worker in self._workers.values()), *([self._reader] if self._reader else [])]:
            with suppress(Exception):
                self._ray.kill(actor)


def on_node(ray, node: str):
    """The strategy that places an actor on a node."""
    return ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(node, soft=False)


class _Reader:
    """Reads files of the driver's machine for others."""

    def piece(self, path: str, offset: int) -> bytes:
        return piece_of(path, offset)


class _Remote:
    """A function that asks a `_Reader` in another process."""

    def __init__(self, reader):
        self._reader = reader

    def __call__(self, path: str, offset: int) -> bytes:
        import ray

        return ray.get(self._reader.piece.remote(path, offset))
