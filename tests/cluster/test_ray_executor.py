"""A real Ray cluster of several nodes on this machine: the bytes of the whole, also when workers and nodes are killed.

pytest -n 0 -m cluster
"""

import os
import signal
import socket
from pathlib import Path

import numpy as np
import pytest
import rasterio

import antumbra as at

ray = pytest.importorskip("ray", reason="tests of clusters need Ray: pip install 'antumbra[ray]'")
pytestmark = pytest.mark.cluster

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

    def __init__(self):
        from ray.cluster_utils import Cluster

        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
        head = {"num_cpus": 0, "object_store_memory": _MEMORY, "include_dashboard": False}
        self.cluster = started(lambda: Cluster(initialize_head=True, connect=False, head_node_args=head))
        self.nodes = [self.add(), self.add()]
        ray.init(address=self.cluster.address, log_to_driver=False, logging_level="ERROR")

    def add(self):
        return started(lambda: self.cluster.add_node(num_cpus=1, object_store_memory=_MEMORY))

    def remove(self):
        """Kill a node, with all of its processes."""
        self.cluster.remove_node(self.nodes.pop(), allow_graceful=False)

    def replace_missing(self):
        while len(self.nodes) < 2:
            self.nodes.append(self.add())
        self.cluster.wait_for_nodes()


@pytest.fixture(scope="module")
def made():
    nodes = Nodes()
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


JOBS = {
    "sun": ("sun", CITY, "--latitude", 52, "--longitude", 4.36, "--days", "2026-03-21", "--sky", 16, "-o", "a.csv"),
    "bake": ("bake", CITY, "-o", "a.glb", "--spp", 4),
    "matrix": ("matrix", CITY, "--sensors", "face", "-o", "a.npy"),
    "picture": ("render", CITY, "--size", "80x100", "--preset", "final", "--spp", 4, "-o", "a.exr"),
    "frames": FRAMES,
    "data set": ("dataset", CITY, "-o", "set", "--random", 5, "--random-lights", 1, "--size", "24x24", "--spp", 2),
}


@pytest.mark.parametrize("job", JOBS)
def test_every_job_has_the_bytes_of_the_whole(same, job):
    same(*JOBS[job], "-q")


def test_files_that_other_arguments_name(same):
    """A raster in the command's folder; and folders whose names are those of methods, which are no inputs."""

    def prepare():
        place = rasterio.transform.from_origin(-20.0, 20.0, 10.0, 10.0)
        with rasterio.open("dem.tif", "w", "GTiff", 4, 4, 1, dtype="float32", transform=place) as file:
            file.write(np.zeros((1, 4, 4), np.float32))
        Path("auto").mkdir()

    days = "--latitude", 52, "--longitude", 4.36, "--days", "2026-03-21"
    same("sun", CITY, *days, "--sensors", "raster:dem.tif+1.6", "-o", "a.csv", "-q", prepare=prepare)


class Disturbing:
    """Calls a function when some parts are done."""

    def __init__(self, disturb, after=3):
        self.disturb, self.after, self.totals = disturb, after, set()

    def __call__(self, what, done, total):
        if "cluster" in what:
            self.totals.add(done)
            if done >= self.after and self.disturb is not None:
                disturb, self.disturb = self.disturb, None
                disturb()


def on_a_disturbed_cluster(same, monkeypatch, disturb) -> Disturbing:
    from antumbra.cli import console

    heard = Disturbing(disturb)
    monkeypatch.setattr(console.ProgressDisplay, "say", lambda self, *said: heard(*said, *[0] * (3 - len(said))))
    told = same(*FRAMES, "-q")
    assert heard.disturb is None, "nothing was killed"
    assert max(heard.totals) == 12
    heard.told = told
    return heard


def test_a_killed_worker_is_replaced(same, monkeypatch, nodes):
    killed = []

    def kill():
        killed.extend(_actor_pids(nodes)[:1])
        os.kill(killed[0], signal.SIGKILL)

    on_a_disturbed_cluster(same, monkeypatch, kill)
    assert killed


def test_a_killed_node_leaves_its_parts_to_others(same, monkeypatch, nodes):
    on_a_disturbed_cluster(same, monkeypatch, nodes.remove)
    assert len(nodes.nodes) == 1


def test_all_nodes_killed_and_a_new_one(same, monkeypatch, nodes):
    def kill():
        nodes.remove()
        nodes.remove()
        nodes.nodes.append(nodes.add())

    on_a_disturbed_cluster(same, monkeypatch, kill)


def _actor_pids(nodes) -> list[int]:
    """The processes of workers of this cluster, by the names that Ray gives them."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                words = (folder / "cmdline").read_bytes().replace(b"\0", b" ").strip()
            except OSError:
                continue
            if words.startswith(b"ray::Node"):
                found.append(int(folder.name))
    return found


def test_nothing_is_left_running(nodes, same):
    same("render", CITY, "--size", "80x100", "-o", "a.png", "-q")
    for _ in range(100):
        if not _actor_pids(nodes) and ray.available_resources().get("CPU") == 2.0:
            break
        ray.wait([ray.put(0)], timeout=0.1)
    assert not _actor_pids(nodes) and ray.available_resources()["CPU"] == 2.0


def test_a_scene_that_nodes_lack_is_fetched_once(cli, tmp_path, monkeypatch, nodes):
    from antumbra.cluster import node_files

    scene = at.procedural("city", triangles=3000)
    at.build_store(scene, tmp_path / "city.antumbra")
    wanted = node_files.input_of(tmp_path / "city.antumbra")
    asked = []

    def read(path, offset):
        asked.append(offset)
        return node_files.piece_of(path, offset)

    assert node_files.local_path(wanted, read) == wanted.path and not asked  # by path
    elsewhere = wanted._replace(path=str(tmp_path / "gone" / "city.antumbra"))
    monkeypatch.setattr(node_files, "PIECE", 1 << 16)
    found = node_files.local_path(elsewhere, lambda _, offset: read(wanted.path, offset), tmp_path / "kept")
    assert Path(found).read_bytes() == (tmp_path / "city.antumbra").read_bytes() and len(asked) > 2
    before = len(asked)
    assert node_files.local_path(elsewhere, read, tmp_path / "kept") == found and len(asked) == before
    with pytest.raises(at.InputError, match="changed while it was fetched"):
        node_files.local_path(elsewhere._replace(sha256="0" * 64), lambda _, o: read(wanted.path, o), tmp_path / "kept")
    with pytest.raises(at.InputError, match="names other files"):
        node_files.local_path(elsewhere._replace(path="/nowhere/a.gltf"), read, tmp_path / "kept")


def test_python(tmp_path, nodes):
    at.build_store(at.procedural("city", triangles=3000), tmp_path / "city.antumbra")
    asked = {"days": "2026-06-21", "place": at.Place(52.0, 4.36), "step": 120}
    sensors = at.raster_sensors(at.load(tmp_path / "city.antumbra"), 8.0)
    table = at.cluster.run(at.sun_hours, tmp_path / "city.antumbra", sensors, address=nodes.cluster.address, **asked)
    whole = at.sun_hours(at.load(tmp_path / "city.antumbra"), sensors, **asked)
    assert np.array_equal(table["sun_hours"], whole["sun_hours"]) and table["sun_hours"].max() > 0


def test_a_part_that_cannot_be_done_is_an_error_here(cli, tmp_path, nodes):
    (tmp_path / "moving").mkdir()
    square = np.array([[-2, 0, -2], [2, 0, -2], [2, 0, 2], [-2, 0, 2]], np.float32)
    moments = np.stack([np.concatenate([square, 0.3 * square + np.float32((k / 4, 1, 0))]) for k in range(3)])
    moments[1, 5, 1] = np.nan
    np.save(tmp_path / "moving" / "frames.npy", moments)
    np.save(tmp_path / "moving" / "faces.npy", np.array([[2, 1, 0], [3, 2, 0], [6, 5, 4], [7, 6, 4]], np.int32))
    (tmp_path / "moving" / "info.json").write_text('{"times": [0.0, 1.0, 2.0]}')
    words = (
        "moving",
        "--size",
        16,
        "--frames",
        "0:2",
        "--fps",
        1,
        "--camera",
        "0,6,0.1:0,0,0",
        "--light",
        "point:0,4,0",
        "-o",
        "f.#.png",
        "-q",
    )
    done = cli("render", *words, "--ray", nodes.cluster.address)
    assert done.code == 2 and "frame 1:" in done.err
    assert sorted(path.name for path in tmp_path.glob("f.*")) == ["f.0.png", "f.2.png"]


def test_the_doctor_names_the_nodes(nodes):
    from antumbra.cluster.ray_workers import survey

    found = survey(ray)
    assert sorted(node["cores"] for node in found) == [0, 1, 1]
    assert all(node["antumbra"] == at.__version__ and node["room"] > 0 for node in found)


def test_bad_addresses(cli):
    cli(*FRAMES, "--shard", "0/2", "--ray", "local").refused("--ray", "--shard")
    failed = cli(*FRAMES, "--ray", "head")
    assert failed.code == 2 and "--ray is 'head'; write auto, local, or HOST:PORT" in failed.err


def test_an_address_where_nothing_listens(cli):
    """The command ends at once. Ray itself tries for a long time, and writes warnings of its own."""
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))  # nobody else gets this port, and it does not listen
        failed = cli(*FRAMES, "--ray", f"127.0.0.1:{bound.getsockname()[1]}")
    assert failed.code == 75 and "cannot be reached (" in failed.err.splitlines()[-1]
    assert all(line.startswith("antumbra: ") for line in failed.err.splitlines())
