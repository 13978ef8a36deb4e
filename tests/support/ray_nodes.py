"""A Ray cluster of two nodes on this machine, shared by all tests of a session, and jobs that are compared on it."""

import os
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

CITY = "procedural:city?triangles=3000"
FRAMES = ("render", CITY, "--size", "40", "--frames", "0:11", "-o", "f.##.png", "--spp", 4, "--exposure", 1)
_MEMORY = 80 << 20  # bytes of a node's object store


def started(start):
    """What `start` starts. Ray waits half a minute for a node, and a machine with other work may take longer."""
    for _ in range(3):
        try:
            return start()
        except Exception as error:
            failed = error
    raise failed


class Nodes:
    """A cluster of nodes with one core each."""

    def __init__(self, ray):
        from ray.cluster_utils import Cluster

        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
        head = {"num_cpus": 0, "object_store_memory": _MEMORY, "include_dashboard": False}
        self.cluster = started(lambda: Cluster(initialize_head=True, connect=False, head_node_args=head))
        self.nodes = [self.add(), self.add()]
        ray.init(address=self.cluster.address, log_to_driver=False, logging_level="ERROR")

    def add(self, **environment):
        words = {"num_cpus": 1, "object_store_memory": _MEMORY, "env_vars": environment}
        return started(lambda: self.cluster.add_node(**words))

    def remove(self):
        """Kill a node, with all of its processes."""
        self.cluster.remove_node(self.nodes.pop(), allow_graceful=False)

    @contextmanager
    def another(self, **environment):
        """One more node, with these variables."""
        node = self.add(**environment)
        try:
            yield node
        finally:
            self.cluster.remove_node(node)

    def replace_missing(self):
        while len(self.nodes) < 2:
            self.nodes.append(self.add())
        self.cluster.wait_for_nodes()


@pytest.fixture(scope="session")
def made():
    reason = "tests of clusters need Ray: pip install 'antumbra[ray]'"
    ray = pytest.importorskip("ray", reason=reason)
    nodes = Nodes(ray)
    yield nodes
    ray.shutdown()
    nodes.cluster.shutdown()


@pytest.fixture
def nodes(made):
    made.replace_missing()
    return made


def contents(folder) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}


@pytest.fixture
def same(cli, tmp_path, monkeypatch, nodes):
    """Runs a command whole and on the cluster; both must write the same bytes, and nothing else."""

    def run(*words, prepare=None):
        for folder, more in (("whole", ()), ("ray", ("--ray", nodes.cluster.address))):
            (tmp_path / folder).mkdir()
            monkeypatch.chdir(tmp_path / folder)
            if prepare is not None:
                prepare()
            done = cli(*words, *more)
            assert done.code == 0, done
        whole = contents(tmp_path / "whole")
        assert whole and contents(tmp_path / "ray") == whole
        return done

    return run


def _parent(pid: int) -> int:
    """The process that started another one; 0: it has ended."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


def _is_ours(pid: int) -> bool:
    """Whether this process has started another one, itself or through others: tests may run beside it."""
    while pid > 1 and pid != os.getpid():
        pid = _parent(pid)
    return pid > 1


def worker_pids(count: int = 0) -> list[int]:
    """The processes of the workers of this process's clusters; waits until there are `count`."""
    for _ in range(300):
        if len(found := _workers()) >= count:
            break
        time.sleep(0.1)
    return found


def _workers() -> list[int]:
    """Workers by the names that Ray gives them."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                words = (folder / "cmdline").read_bytes().replace(b"\0", b" ").strip()
            except OSError:
                continue
            if words.startswith(b"ray::Node") and _is_ours(int(folder.name)):
                found.append(int(folder.name))
    return found


@pytest.fixture
def disturbed(same, monkeypatch):
    """Runs a job whole and on a cluster, and a function after three parts; returns what the command printed."""
    from antumbra.cluster.worker_pool import WorkerPool

    finish, done = WorkerPool._finish_unit, []

    def run(words, disturb):
        def finish_unit(pool, number, answer, worker):
            finish(pool, number, answer, worker)
            done.append(number)
            if len(done) == 3:
                disturb()

        monkeypatch.setattr(WorkerPool, "_finish_unit", finish_unit)
        told = same(*words)
        assert sorted(set(done)) == list(range(12))
        return told

    return run
