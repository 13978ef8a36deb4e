"""The pool that assigns units to the workers of a cluster, watches them, and replaces lost ones.

A node passes through the states of `WorkerState`. Whatever takes too long has a deadline: a node whose cores others
hold is waited for while the rest work, a worker that has stopped is replaced, the last units are repeated on idle
workers, and a node that cannot do the work is put aside by name and cause. The first copy of a unit counts; all are
equal.
"""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import Enum
from statistics import median
from threading import Event, Thread
from time import monotonic, sleep
from typing import Any, NamedTuple

from ..base.errors import InputError, UnavailableError
from ..base.files import atomic_output
from ..base.progress import report_progress
from ..base.wording import counted
from ..work.estimates import Estimate, tell_estimate
from ..work.executors import Units, numbered
from .ray_workers import Node, NodeWork, Reader, RemoteReader, fault_of, name_of, on_node, probe, signature

_AHEAD = 2  # units assigned to a worker: the current one and the next
_TRIES = 4  # losses of a unit with its worker, or of workers on a node, before giving up
_POLL, _SCAN, _PING = 0.2, 2.0, 5.0  # seconds between checks for results, for nodes, and of workers
_HINT = 5.0  # seconds before the user is told what a node waits for
_PLACEMENT = 120.0  # seconds to wait for the first worker
_SILENCE = 60.0  # seconds without an answer after which a worker counts as stopped
_HEAD_SILENCE = 40.0  # the same of the head; after a minute, Ray ends the process
_LONG, _LONG_TIMES = 120.0, 10.0  # a unit is late after these seconds and so many medians; each repeat has twice these
_CAUSES = 3  # nodes named in an error


class Log(NamedTuple):
    """The history of a pool, for measurements. Times are from `time.monotonic`; durations are in seconds."""

    ready: dict[str, float]  # node -> time at which its worker was ready
    seconds: dict[int, float]  # unit -> duration on its node
    written: list[float]  # times at which the files of units were written


class WorkerState(Enum):
    """What a worker is doing."""

    PROBE = "the node is asked for its version"
    PLACE = "the worker waits for its cores"
    BEGIN = "the worker opens the scene"
    WORK = "the worker does units"


_PLACED = WorkerState.BEGIN, WorkerState.WORK  # with its cores


class NodeWorker:
    """A worker, running or starting."""

    def __init__(self, node: str, name: str, cores: int, now: float):
        self.node, self.name, self.cores = node, name, cores
        self.actor: Any = None
        self.step, self.lost = WorkerState.PROBE, False
        self.since = self.heard = now  # start of the step, or of the current unit; the last answer
        self.asked: float | None = None  # time of a check that it runs, until it is answered
        self.queue: list[int] = []  # units assigned to it; the first one is current


class _Call(NamedTuple):
    """A call whose result is awaited."""

    worker: NodeWorker
    number: int | None = None  # of a unit; None: the step of the worker, or a check
    is_check: bool = False
    is_stale: bool = False  # of an earlier stage: its result does not count, and it may fail, since its files are gone


class _Aside(NamedTuple):
    """A node that gets no worker any more."""

    name: str
    cause: str
    is_final: bool  # whether another run would find the same cause


class _Head:
    """Lists the nodes in a thread of its own, because Ray blocks while the head of the cluster does not answer."""

    def __init__(self, ray: Any):
        self._ray, self._wake, self._ended = ray, Event(), False
        self.nodes: list[dict[str, Any]] | None = None  # the latest listing, until it is taken
        self.free: dict[str, int] = {}  # node -> free cores
        self.heard = monotonic()
        Thread(target=self._run, name="nodes of the cluster", daemon=True).start()

    def take(self) -> list[dict[str, Any]]:
        """The nodes, once per listing."""
        nodes, self.nodes = self.nodes, None
        return nodes or []

    def list_again(self) -> None:
        self.nodes = None
        self._wake.set()

    def end(self) -> None:
        self._ended = True
        self._wake.set()

    def _run(self) -> None:
        with suppress(Exception):  # of a connection that has ended
            while not self._ended:
                self._wake.clear()
                nodes = self._ray.nodes()
                with suppress(AttributeError):  # Ray has no public function
                    per_node = self._ray._private.state.available_resources_per_node()
                    self.free = {node: int(resources.get("CPU", 0)) for node, resources in per_node.items()}
                self.nodes, self.heard = nodes, monotonic()
                self._wake.wait(_SCAN)


class WorkerPool:
    """Runs units of some work on the nodes of a cluster, one worker per node, which stay until `end`.

    ray : the module, connected
    say : function that prints a line for the user
    """

    def __init__(self, ray: Any, node_work: NodeWork, say: Callable[[str], None]):
        self._ray, self._node_work, self._say = ray, node_work, say
        self._work: Sequence[Units] = ()
        self._units: list[tuple[Units, int]] = []
        self._todo, self._missing = deque[int](), set[int]()
        self._pending: dict[Any, _Call] = {}
        self._workers: dict[str, NodeWorker] = {}
        self._aside: dict[str, _Aside] = {}  # by node
        self._losses: Counter[str] = Counter()  # by node
        self._tries: Counter[int] = Counter()  # losses by unit
        self._late: Counter[int] = Counter()  # missed deadlines by unit
        self._hinted: set[str] = set()  # nodes
        self._seconds: list[float] = []  # durations of units of the current work
        self._reader, self._head = self._started_reader(), _Head(ray)
        self._now = self._placed = 0.0  # seconds, for deadlines; of the last look at which a worker had its cores
        self.log = Log({}, {}, [])

    def do(self, work: Sequence[Units], numbers: Sequence[int]) -> None:
        """Run the units of some work with these numbers. Earlier stages, if any, precede it in `work`.

        Raises
        ------
        InputError
            If a unit cannot be done, or no node can do the work.
        UnavailableError
            If the head does not answer, no node has free cores, or workers are lost again and again.
        """
        self._work, self._units = work, [(units, k) for _, units, k in numbered(work)]
        self._todo, self._missing, self._seconds = deque(numbers), set(numbers), []
        self._node_work = self._node_work._replace(left=self._left())
        self._begin_again()
        with report_progress(f"{work[0].what or 'frames'}, on a cluster") as progress:
            last = monotonic()
            while self._missing:
                self._start_workers()
                self._assign()
                if self._collect():
                    progress(len(numbers) - len(self._missing), len(numbers))
                # Deadlines do not run while this process is held up, such as by writing to a slow disk.
                self._now, last = self._now + min(monotonic() - last, 1.0), monotonic()
                self._watch()

    def end(self) -> None:
        """Stop all workers."""
        self._head.end()
        self._stop_workers()

    @property
    def n_missing(self) -> int:
        """The number of units that are not done."""
        return len(self._missing)

    # --- Steps of a worker

    def _started_reader(self) -> Any:
        """A process on this node that reads inputs for nodes without them; None: there are no inputs."""
        if not self._node_work.inputs:
            return None
        remote, here = self._ray.remote(Reader), self._ray.get_runtime_context().get_node_id()
        return remote.options(num_cpus=0, scheduling_strategy=on_node(self._ray, here)).remote()

    def _begin_again(self) -> None:
        """Let the workers of an earlier stage prepare the current one, once they have ended what they are doing."""
        placed = [worker for worker in self._workers.values() if worker.step in _PLACED]
        self._pending = {call: entry._replace(is_stale=entry.worker in placed) for call, entry in self._pending.items()}
        for worker in placed:
            worker.queue, worker.asked, worker.heard = [], None, self._now
            self._begin(worker)

    def _begin(self, worker: NodeWorker) -> None:
        worker.step, worker.since = WorkerState.BEGIN, self._now
        self._pending[worker.actor.begin.remote(self._node_work, RemoteReader(self._reader))] = _Call(worker)
        self._node_work = self._node_work._replace(left=())  # the first worker samples

    def _start_workers(self) -> None:
        """Start a worker on each node without one, once per listing of the nodes."""
        able = {
            node["NodeID"]: (name_of(node), int(node["Resources"]["CPU"]))
            for node in self._head.take()
            if node["Alive"] and node["Resources"].get("CPU", 0) >= 1
        }
        for node, (name, cores) in able.items():
            if node not in self._workers and node not in self._aside:
                worker = self._workers[node] = NodeWorker(node, name, cores, self._now)
                ask = self._ray.remote(probe()).options(
                    num_cpus=0, max_retries=0, scheduling_strategy=on_node(self._ray, node)
                )
                self._pending[ask.remote()] = _Call(worker)
        if able and not self._workers:
            self._give_up([self._aside[node] for node in able])

    def _enter_next(self, worker: NodeWorker, answer: Any) -> None:
        """Go on with a worker whose step has ended with this answer."""
        if worker.step is WorkerState.PROBE:
            if fault := fault_of(*answer):
                return self._put_aside(worker, fault, is_final=True)
            actor = self._ray.remote(concurrency_groups={"watch": 1})(Node).options(
                num_cpus=worker.cores, max_restarts=0, scheduling_strategy=on_node(self._ray, worker.node)
            )
            worker.actor = actor.remote(worker.cores)
            worker.step, worker.since = WorkerState.PLACE, self._now
            self._pending[worker.actor.is_there.remote()] = _Call(worker)
        elif worker.step is WorkerState.PLACE:
            self._begin(worker)
        elif answer.signature != signature(self._work):
            self._put_aside(worker, "would do different work; install the same packages there as here", is_final=True)
        else:
            self._tell_estimates(answer.estimates)
            worker.step, worker.since = WorkerState.WORK, self._now
            self.log.ready[worker.node] = monotonic()

    def _left(self) -> tuple[int, ...]:
        """The number of units of each kind that are not done."""
        numbers, total = list[int](), 0
        for units in self._work:
            numbers.append(sum(number in self._missing for number in range(total, total + len(units))))
            total += len(units)
        return tuple(numbers)

    def _tell_estimates(self, estimates: Sequence[Estimate | None]) -> None:
        """Tell what a worker has judged by a sample. InputError if the results do not fit on the disk here."""
        for units, estimate, left in zip(self._work, estimates, self._left()):
            if estimate is not None:
                tell_estimate(units.what, units.root, estimate, left, " of one worker")

    # --- Units

    def _assign(self) -> None:
        for worker in [each for each in self._workers.values() if each.step is WorkerState.WORK]:
            while len(worker.queue) < _AHEAD and self._todo:
                self._hand_out(worker, self._todo.popleft())
            if not worker.queue and (number := self._repeatable()) is not None:
                self._hand_out(worker, number)

    def _hand_out(self, worker: NodeWorker, number: int) -> None:
        if not worker.queue:
            worker.since = self._now
        worker.queue.append(number)
        self._pending[worker.actor.do.remote(number)] = _Call(worker, number)

    def _repeatable(self) -> int | None:
        """A unit of a busy worker for an idle one: one that waits, else one that has run for longer than usual."""
        copies = Counter(number for worker in self._workers.values() for number in worker.queue)
        waiting = [number for worker in self._workers.values() for number in worker.queue[1:]]
        usual = median(self._seconds or [_LONG])
        slow = [
            worker.queue[0]
            for worker in sorted(self._workers.values(), key=lambda each: each.since)
            if worker.queue and self._now - worker.since > usual
        ]
        return next((each for each in (*waiting, *slow) if copies[each] == 1 and each in self._missing), None)

    def _collect(self) -> bool:
        """Take results that have arrived; return whether units are done."""
        if not self._pending:
            sleep(_POLL)
            return False
        before = len(self._missing)
        self._ray.wait(list(self._pending), num_returns=1, timeout=_POLL)
        ready, _ = self._ray.wait(list(self._pending), num_returns=len(self._pending), timeout=0)
        for call in ready:
            if not self._missing:  # what is left are copies: the next stage drops them
                break
            if call not in self._pending:  # of a worker that was lost a moment ago
                continue
            worker, number, is_check, is_stale = self._pending[call]
            if is_stale:
                del self._pending[call]
                with suppress(Exception):  # Ray reports errors that are never read
                    self._ray.get(call)
                continue
            answer = self._answer(call, worker)
            if worker.lost:
                continue
            del self._pending[call]
            worker.heard = self._now
            if is_check:
                worker.asked = None
            elif number is None:
                self._enter_next(worker, answer)
            else:
                worker.since = self._now
                worker.queue.remove(number)
                self._finish_unit(number, answer, worker)
        return len(self._missing) < before

    def _finish_unit(self, number: int, answer: Any, worker: NodeWorker) -> None:
        self.log.seconds.setdefault(number, answer.seconds)
        self._seconds.append(answer.seconds)
        if number in self._missing:
            self._write(number, answer.files, worker)
            self.log.written.append(monotonic())
            self._missing.remove(number)

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
                f"{worker.name} sent a part of different work ({next(iter(files))}); run the command again"
            )
        else:
            units.found(k)

    # --- What can go wrong

    def _answer(self, call: Any, worker: NodeWorker) -> Any:
        """The result of a call. If its worker is lost or its node is unfit, requeue its units."""
        errors = self._ray.exceptions
        try:
            return self._ray.get(call)
        except errors.RayTaskError as error:
            cause = error.cause if isinstance(error.cause, Exception) else error
            if worker.step is WorkerState.WORK and isinstance(cause, InputError):
                raise cause from None  # of the unit, on any node
            text = str(cause) if isinstance(cause, InputError) else f"{type(cause).__name__}: {cause}"
            self._put_aside(worker, f"failed ({text})", is_final=not isinstance(cause, (OSError, MemoryError)))
        except errors.RayError as error:
            self._drop(
                worker, "its machine is out of memory" if "low on memory" in str(error) else "its process has ended"
            )

    def _watch(self) -> None:
        """Replace workers that have stopped or are late, and raise UnavailableError if nothing can go on."""
        if monotonic() - self._head.heard > _HEAD_SILENCE:
            raise UnavailableError(f"the head of the cluster has not answered for {_HEAD_SILENCE:.0f} s")
        for worker in list(self._workers.values()):
            seconds = self._now - worker.since
            if worker.step is WorkerState.PROBE and seconds > _PLACEMENT:
                self._put_aside(worker, f"has started no process for {_PLACEMENT:.0f} s")
            elif worker.step is WorkerState.PLACE and seconds > _HINT and worker.node not in self._hinted:
                self._hinted.add(worker.node)
                self._say(f"note: {self._wait_of(worker)}")
            elif worker.step in _PLACED:
                self._check(worker)
        if any(worker.step in _PLACED for worker in self._workers.values()):
            self._placed = self._now
        elif self._now - self._placed > _PLACEMENT:
            waits = [self._wait_of(worker) for worker in self._workers.values()]
            raise UnavailableError(
                "; ".join(waits[:_CAUSES]) or "no node of the cluster has cores; look at: ray status"
            )

    def _wait_of(self, worker: NodeWorker) -> str:
        if worker.step is WorkerState.PROBE:
            return f"waiting for a process on {worker.name}"
        cores = f"{worker.cores} core{'s' * (worker.cores != 1)}"
        return f"waiting for {cores} of {worker.name}, {self._head.free.get(worker.node, 0)} free"

    def _check(self, worker: NodeWorker) -> None:
        """Ask a worker whether it runs, and drop it if it is silent or late."""
        if worker.asked is None and self._now - worker.heard > _PING:
            worker.asked = self._now
            call = worker.actor.is_there.options(concurrency_group="watch").remote()
            self._pending[call] = _Call(worker, is_check=True)
        if worker.asked is not None and self._now - worker.asked > _SILENCE:
            self._drop(worker, f"no answer for {_SILENCE:.0f} s")
        elif worker.queue and self._seconds:
            number = worker.queue[0]
            allowed = max(_LONG, _LONG_TIMES * median(self._seconds)) * 2 ** self._late[number]
            if self._now - worker.since > allowed:
                self._late[number] += 1
                self._drop(worker, f"a part took longer than {allowed:.0f} s")

    def _drop(self, worker: NodeWorker, cause: str) -> None:
        """Requeue the units of a lost worker. Its node gets another one, unless it has lost several."""
        self._losses[worker.node] += 1
        current = [number for number in worker.queue[:1] if number in self._missing]
        self._tries.update(current)  # the others had not started
        if self._losses[worker.node] >= _TRIES:
            return self._put_aside(worker, f"has lost {_TRIES} workers, the last one because {cause}")
        n_lost = self._remove(worker)
        self._say(f"note: the worker on {worker.name} was lost ({cause}); repeating {counted(n_lost, 'part')}")
        if current and self._tries[current[0]] >= _TRIES:
            raise UnavailableError(
                f"part {current[0]} was lost {_TRIES} times, the last time on {worker.name} ({cause}); "
                "the nodes may lack memory"
            )

    def _put_aside(self, worker: NodeWorker, cause: str, is_final: bool = False) -> None:
        """Give a node no more work."""
        self._remove(worker)
        self._aside[worker.node] = _Aside(worker.name, cause, is_final)
        self._say(f"note: put aside: {worker.name} {cause}")

    def _remove(self, worker: NodeWorker) -> int:
        """Remove a worker; return the number of units that are queued again."""
        worker.lost = True
        self._workers.pop(worker.node, None)
        with suppress(Exception):
            self._ray.kill(worker.actor)
        self._pending = {call: entry for call, entry in self._pending.items() if entry.worker is not worker}
        elsewhere = {number for each in self._workers.values() for number in each.queue}
        lost = [number for number in worker.queue if number in self._missing and number not in elsewhere]
        self._todo.extendleft(reversed(lost))
        self._head.list_again()
        return len(lost)

    def _give_up(self, aside: list[_Aside]) -> None:
        causes = "; ".join(f"{each.name} {each.cause}" for each in aside[:_CAUSES])
        more = f"; and {len(aside) - _CAUSES} more" if len(aside) > _CAUSES else ""
        error = InputError if all(each.is_final for each in aside) else UnavailableError
        raise error(f"no node can do the work: {causes}{more}")

    def _stop_workers(self) -> None:
        """Stop all workers. Without its head, the cluster ends them itself, and Ray would wait for it."""
        if monotonic() - self._head.heard > _HEAD_SILENCE:
            return
        actors = [worker.actor for worker in self._workers.values() if worker.actor is not None]
        with suppress(Exception):
            idle = [
                each.actor.leave.remote()
                for each in self._workers.values()
                if each.step is WorkerState.WORK and not each.queue
            ]
            self._ray.wait(idle, num_returns=len(idle), timeout=5.0) if idle else None
        for actor in [*actors, *([self._reader] if self._reader else [])]:
            with suppress(Exception):
                self._ray.kill(actor)
