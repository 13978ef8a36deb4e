"""Clusters whose nodes and workers fail: the bytes of the whole, or an end in words from which the command resumes."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack

import pytest

import antumbra as at
from antumbra.cluster import ray_workers, worker_pool
from antumbra.cluster.worker_pool import WorkerPool, WorkerState
from ray_nodes import CITY, FRAMES, started, worker_pids

ray = pytest.importorskip("ray", reason="tests of clusters need Ray: pip install 'antumbra[ray]'")
pytestmark = pytest.mark.cluster

BUILD = "build", CITY, "-o", "a.antumbra"


def stop_workers(count):
    for pid in worker_pids(count)[:count]:
        os.kill(pid, signal.SIGSTOP)


def test_idle_workers_repeat_the_parts_of_a_stopped_one(disturbed, monkeypatch):
    monkeypatch.setattr(worker_pool, "_SILENCE", 1e9)
    disturbed(FRAMES, lambda: stop_workers(1))


def test_workers_stay_for_all_stages_of_a_build(same, monkeypatch):
    finish, done = WorkerPool._finish_unit, []

    def finish_unit(pool, number, answer, worker):
        finish(pool, number, answer, worker)
        done.append((number, worker.node, worker.actor))

    monkeypatch.setattr(WorkerPool, "_finish_unit", finish_unit)
    same(*BUILD)
    assert {number for number, _, _ in done} == {0, 1, 2}  # to read, to sort, to make chunks
    assert len({actor for _, _, actor in done}) == len({node for _, node, _ in done})


def test_copies_of_an_earlier_stage_do_not_count(same, monkeypatch):
    monkeypatch.setattr(worker_pool, "_LONG", -1.0)  # the idle worker repeats the only part of each stage at once
    assign, begin_again, stale = WorkerPool._assign, WorkerPool._begin_again, []

    def assign_to_both(pool):
        if [each.step for each in pool._workers.values()] == [WorkerState.WORK] * 2:
            assign(pool)

    def counted(pool):
        begin_again(pool)
        stale.extend(call for call in pool._pending.values() if call.is_stale)

    monkeypatch.setattr(WorkerPool, "_assign", assign_to_both)
    monkeypatch.setattr(WorkerPool, "_begin_again", counted)
    assert "Unhandled" not in same(*BUILD, "-q").err
    assert len(stale) >= 2


def test_a_worker_that_is_lost_between_stages_is_replaced(same, monkeypatch):
    do, stages = WorkerPool.do, []

    def kill_and_do(pool, work, numbers):
        if stages:
            for pid in worker_pids(1):
                os.kill(pid, signal.SIGKILL)
        stages.append(numbers)
        do(pool, work, numbers)

    monkeypatch.setattr(WorkerPool, "do", kill_and_do)
    assert "was lost (its process has ended)" in same(*BUILD).err
    assert stages == [[0], [1], [2]]


@pytest.mark.parametrize(
    "cause, limits",
    [
        ("no answer for 1 s", {"_SILENCE": 1.0, "_PING": 0.2}),
        ("a part took longer than 2 s", {"_SILENCE": 1e9, "_LONG": 2.0, "_LONG_TIMES": 0.0}),
    ],
)
def test_stopped_workers_are_replaced(disturbed, monkeypatch, cause, limits):
    for name, value in limits.items():
        monkeypatch.setattr(worker_pool, name, value)
    told = disturbed(FRAMES, lambda: stop_workers(2))
    assert f"was lost ({cause})" in told.err


@pytest.fixture
def held(nodes):
    """Holds the cores of so many nodes."""

    class Holder:
        def is_there(self):
            return True

    holders = []

    def hold(count):
        holders.extend(ray.remote(num_cpus=1)(Holder).remote() for _ in range(count))
        assert all(ray.get([holder.is_there.remote() for holder in holders]))  # each has its core

    yield hold
    for holder in holders:
        ray.kill(holder)
    while ray.available_resources().get("CPU", 0) < 2:
        time.sleep(0.1)


def test_cores_held_by_others_are_waited_for_by_name(cli, monkeypatch, nodes, held):
    monkeypatch.setattr(worker_pool, "_PLACEMENT", 10.0)
    monkeypatch.setattr(worker_pool, "_HINT", 0.5)
    held(2)
    done = cli(*FRAMES, "--ray", nodes.cluster.address)
    assert done.code == 75 and done.err.count("note: waiting for 1 core of ") == 2
    last = done.err.splitlines()[-1]
    assert last.startswith("antumbra: waiting for 1 core of ") and ", 0 free; " in last
    assert last.endswith("; 0 of 12 parts are done; the same command resumes from there")


def test_a_node_whose_cores_are_held_leaves_the_work_to_the_rest(same, monkeypatch, held):
    monkeypatch.setattr(worker_pool, "_HINT", 0.0)
    held(1)
    assert same(*FRAMES).err.count("note: waiting for 1 core of ") >= 1


BAD = {
    "another version": (
        {"__init__.py": "", "version.py": "VERSION = '0.9'"},
        f"has antumbra 0.9, and this machine {at.__version__}; install the same version there",
    ),
    "no package": (
        {"__init__.py": "raise ModuleNotFoundError(name='antumbra')"},
        f"lacks antumbra; pip install 'antumbra[ray]=={at.__version__}' there",
    ),
    "a missing dependency": (
        {"__init__.py": "import no_such_package"},
        "cannot import antumbra (No module named 'no_such_package'); repair it there",
    ),
}


def test_bad_nodes_are_put_aside_by_name_and_cause(same, tmp_path, nodes):
    with ExitStack() as stack:
        added = {}
        for fault, (files, _) in BAD.items():
            (tmp_path / fault / "antumbra").mkdir(parents=True)
            for name, text in files.items():
                (tmp_path / fault / "antumbra" / name).write_text(text)
            added[fault] = stack.enter_context(nodes.another(PYTHONPATH=str(tmp_path / fault)))
        told = same(*FRAMES)
        records = {each["node"]: each.get("error") for each in ray_workers.survey(ray)}
    for fault, node in added.items():
        name = f"{socket.gethostname()} ({node.node_ip_address}, node {node.node_id[:8]})"
        assert f"note: put aside: {name} {BAD[fault][1]}" in told.err
        assert records.pop(name).startswith(BAD[fault][1])
    assert len(records) == 3 and not any(records.values())


def test_a_cluster_without_a_fit_node_is_never_tried_again(cli, monkeypatch, nodes):
    monkeypatch.setattr(ray_workers, "VERSION", "9.9")
    done = cli(*FRAMES, "--ray", nodes.cluster.address, "-q")
    assert done.code == 2 and "no node can do the work: " in done.err
    assert f"has antumbra {at.__version__}, and this machine 9.9; install the same version" in done.err


def test_a_head_that_only_its_own_machine_reaches_is_refused(cli):
    if ray.util.get_node_ip_address().startswith("127."):
        pytest.skip("this machine has no address but 127.0.0.1: NOT checked")
    with socket.socket() as head:
        head.bind(("127.0.0.1", 0))
        head.listen()
        address = f"127.0.0.1:{head.getsockname()[1]}"
        for given in (address, address.replace("127.0.0.1", "localhost")):
            failed = cli(*FRAMES, "--ray", given)
            assert failed.code == 2 and "alone, where no other machine can reach it; start it with" in failed.err


def test_the_head_that_ray_finds_is_checked_too(cli, monkeypatch):
    with socket.socket() as head:
        head.bind(("127.0.0.1", 0))
        monkeypatch.setenv("RAY_ADDRESS", f"127.0.0.1:{head.getsockname()[1]}")  # nothing listens
        failed = cli(*FRAMES, "--ray", "auto")
    assert failed.code == 75 and "--ray auto: cannot be reached (" in failed.err


# --- Commands of their own process


SCRIPT = """
import sys
from antumbra.cli import main
from antumbra.cluster import worker_pool
worker_pool._HEAD_SILENCE = 6.0
sys.exit(main())
"""


@pytest.fixture
def command(tmp_path):
    """Runs a command, and a function once its first frames are written; returns the process and its output."""

    def run(disturb, *words, workers=1):
        with subprocess.Popen(
            [sys.executable, "-c", SCRIPT, *map(str, words)], cwd=tmp_path, text=True, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        ) as process:  # fmt: skip
            while len(list(tmp_path.glob("f.*.png"))) < 2 and process.poll() is None:
                time.sleep(0.05)
            worker_pids(workers)
            assert process.poll() is None, process.communicate()
            disturb()
            out, err = process.communicate(timeout=60)
        return process.returncode, out, err

    return run


def frames(size):
    return ("render", CITY, "--size", size, "--frames", "0:399", "-o", "f.###.png", "--spp", 4, "--exposure", 1)


def test_standard_output_is_json_when_a_node_dies(command, nodes):
    code, out, err = command(nodes.remove, *frames(80), "--ray", nodes.cluster.address, "--json", workers=2)
    assert code == 0, err
    assert all(isinstance(json.loads(line), dict) for line in out.splitlines()) and out
    assert "was lost (its process has ended)" in err


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_a_command_without_its_head_ends_in_words(command, end):
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 80 << 20, "include_dashboard": False}
    cluster = started(lambda: Cluster(initialize_head=True, connect=False, head_node_args=node))
    (head,) = cluster.head_node.all_processes["gcs_server"]
    try:
        code, out, err = command(
            lambda: head.process.send_signal(end), *frames(300), "--ray", cluster.address, "--json"
        )
    finally:
        head.process.send_signal(signal.SIGCONT)
        cluster.shutdown()
    assert code == 75, err
    assert json.loads(out.splitlines()[-1])["error"].startswith("the head of the cluster has not answered for 6 s; ")
    assert err.splitlines()[-1].endswith(" of 400 parts are done; the same command resumes from there")
