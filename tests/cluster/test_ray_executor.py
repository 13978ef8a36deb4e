"""A real Ray cluster of several nodes on this machine: the bytes of the whole, also when workers and nodes are killed.

pytest -n 0 -m cluster
"""

import os
import signal
import socket
import time
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest
import rasterio

import antumbra as at
from antumbra.work import estimates
from ray_nodes import CITY, FRAMES, worker_pids

ray = pytest.importorskip("ray", reason="tests of clusters need Ray: pip install 'antumbra[ray]'")
pytestmark = pytest.mark.cluster

JOBS = {
    "sun": (
        "sun",
        CITY,
        "--latitude",
        52,
        "--longitude",
        4.36,
        "--days",
        "2026-03-21",
        "--sky-view",
        16,
        "-o",
        "a.csv",
    ),
    "partitions": (
        *("sun", CITY, "--latitude", 52, "--longitude", 4.36, "--days", "2026-03-21", "--step", 120),
        *("--sensors", "raster:2", "-o", "a.parquets"),
    ),
    "bake": ("bake", CITY, "-o", "a.glb", "--spp", 4),
    "matrix": ("matrix", CITY, "--sensors", "face", "-o", "a.npy"),
    "picture": ("render", CITY, "--size", "80x100", "--preset", "final", "--spp", 4, "-o", "a.exr"),
    "frames": FRAMES,
    "store": ("build", CITY, "-o", "a.antumbra"),
    "data set": ("dataset", CITY, "-o", "set", "--random", 5, "--random-lights", 1, "--size", "24x24", "--spp", 2),
}


@pytest.mark.parametrize("job", JOBS)
def test_every_job_has_the_bytes_of_the_whole(same, job):
    same(*JOBS[job], "-q")


def test_a_worker_tells_before_the_work_what_its_parts_take(same, monkeypatch):
    monkeypatch.setattr(estimates, "_LONG", 0.0)
    told = same("sun", CITY, *JOBS["sun"][2:8], "--step", 240, "--sensors", "raster:0.25", "-o", "a.parquets")
    (line,) = [line for line in told.err.splitlines() if "more parts take" in line]
    assert " of one worker, " in line and " on disk (estimated from a sample of 2,048)" in line


def test_results_that_do_not_fit_here_are_refused_once_a_worker_has_sampled_them(cli, monkeypatch, tmp_path, nodes):
    monkeypatch.chdir(tmp_path)
    usage = namedtuple("usage", "total used free")
    words = ("sun", CITY, *JOBS["sun"][2:8], "--step", 240, "--sensors", "raster:0.25", "-o", "a.parquets")
    monkeypatch.setattr(estimates.shutil, "disk_usage", lambda folder: usage(0, 0, 70_000))
    done = cli(*words, "--ray", nodes.cluster.address)
    assert done.code == 2 and "more parts of the suns" in done.err and "its disk has 70.0 kB left" in done.err, done
    assert len(list(tmp_path.rglob("*.parquet"))) < 15, "of 20; other workers do not wait for the sample"


def test_files_that_other_arguments_name(same):
    """A raster in the command's folder; and folders whose names are those of methods, which are no inputs."""

    def prepare():
        place = rasterio.transform.from_origin(-20.0, 20.0, 10.0, 10.0)
        with rasterio.open("dem.tif", "w", "GTiff", 4, 4, 1, dtype="float32", transform=place) as file:
            file.write(np.zeros((1, 4, 4), np.float32))
        Path("auto").mkdir()

    days = "--latitude", 52, "--longitude", 4.36, "--days", "2026-03-21"
    same("sun", CITY, *days, "--sensors", "raster:dem.tif+1.6", "-o", "a.csv", "-q", prepare=prepare)


def test_a_killed_worker_is_replaced(disturbed, nodes):
    killed = []

    def kill():
        killed.extend(worker_pids()[:1])
        os.kill(killed[0], signal.SIGKILL)

    disturbed(FRAMES, kill)
    assert killed


def test_a_killed_node_leaves_its_parts_to_others(disturbed, nodes):
    disturbed(FRAMES, nodes.remove)
    assert len(nodes.nodes) == 1


def test_all_nodes_killed_and_a_new_one(disturbed, nodes):
    def kill():
        nodes.remove()
        nodes.remove()
        nodes.nodes.append(nodes.add())

    disturbed(FRAMES, kill)


def test_nothing_is_left_running(nodes, same):
    same("render", CITY, "--size", "80x100", "-o", "a.png", "-q")
    for _ in range(100):
        if not worker_pids() and ray.available_resources().get("CPU") == 2.0:
            break
        time.sleep(0.1)
    assert not worker_pids() and ray.available_resources()["CPU"] == 2.0


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
