"""Forks: a child answers whatever other threads were doing. tests/engine/test_engine.py has threads of one process."""

import ast
import multiprocessing
import os
import pickle
import re
import threading
from pathlib import Path

import pytest

import antumbra
import antumbra as at
from antumbra.kernels import jit
from forked import answers, held_elsewhere, in_child, same
from stores import built

forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")


@pytest.fixture(scope="module")
def atrium():
    return at.procedural("atrium", triangles=3000)


@pytest.fixture(scope="module")
def both(atrium, tmp_path_factory):
    """The scene in memory, and in a store."""
    return {"memory": atrium, "store": at.load(built(tmp_path_factory.mktemp("forks"), atrium).path)}


@forks
@pytest.mark.parametrize("kind", ["memory", "store"])
def test_a_child_and_its_parent_answer_alike(both, kind):
    """The threads that trace, and those that read chunks, are not there in the child."""
    scene = both[kind]
    expected = answers(scene)
    same(in_child(lambda: answers(scene)), expected)
    same(in_child(lambda: in_child(lambda: answers(scene))), expected)
    same(answers(scene), expected)
    fresh = at.Engine(scene)
    same(in_child(lambda: answers(fresh)), expected)  # its trees are built, and its chunks read, in the child
    same(answers(fresh), expected)


@forks
def test_chunks_of_a_store_are_read_in_the_child(both):
    scene = both["store"]
    expected = answers(scene)

    def again():
        scene.engine.source.release()
        return answers(scene)

    same(in_child(again), expected)
    same(again(), expected)


LOCKS = {
    "scene": lambda scene: scene._lock,
    "engine": lambda scene: scene.engine.lock,
    "trees": lambda scene: scene.engine._shared.flat()._lock,
    "ray lists": lambda scene: scene.engine.source.ray_lists._lock,
}


@forks
@pytest.mark.parametrize("asked", [False, True], ids=["new", "asked before"])
@pytest.mark.parametrize("lock", LOCKS)
def test_locks_that_other_threads_held_are_free_in_the_child(atrium, lock, asked):
    scene = at.Scene.of_data(atrium.data)
    if asked:
        answers(scene)
    with held_elsewhere(LOCKS[lock](scene)):
        found = in_child(lambda: answers(scene))
    same(found, answers(atrium))
    same(answers(scene), found)


@forks
def test_the_engine_of_a_store_that_another_thread_asks_is_free_in_the_child(both):
    scene = at.load(both["store"].data.store.path)
    expected = answers(scene)
    with held_elsewhere(scene.engine.lock):
        same(in_child(lambda: answers(scene)), expected)
    same(answers(scene), expected)


@forks
def test_a_fork_waits_for_machine_code_that_another_thread_loads():
    """So the child's lock is free, and its code complete."""
    release = threading.Event()

    def hold():
        with jit._lock:
            held.set()
            release.wait()

    held = threading.Event()
    thread = threading.Thread(target=hold)
    thread.start()
    held.wait()
    threading.Timer(0.2, release.set).start()
    assert in_child(lambda: release.is_set() and jit._lock.acquire(blocking=False))
    thread.join()
    assert jit._lock.acquire(blocking=False)
    jit._lock.release()


@forks
@pytest.mark.parametrize("plan", ["auto", "srdh+single", "bsah+chcrt", "grid32+cones"])
def test_forks_while_other_threads_build_and_trace(atrium, plan):
    engine, stop, failures = at.Engine(atrium, plan, threads=2), threading.Event(), []
    expected = answers(atrium)

    def work():
        while not stop.is_set():
            with engine._shared.flat()._lock:
                engine._shared.clear()
            try:
                same(answers(engine), expected)
            except Exception as error:
                failures.append(error)

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(3):
            same(in_child(lambda: answers(engine)), expected)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    assert not failures


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_pools_of_processes(both, method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"this system has no {method}")
    things = [both["memory"], both["store"], at.Engine(both["memory"], "bsah+multifrusta")]
    expected = answers(both["memory"])
    with multiprocessing.get_context(method).Pool(2) as pool:
        for found in pool.map_async(answers, things * 2).get(timeout=300):
            same(found, expected)


def test_pickles_of_used_scenes_engines_and_stores_answer(both):
    expected = answers(both["memory"])
    for thing in (both["memory"], both["store"], at.Engine(both["memory"], "bsah+single"), at.Engine(both["store"])):
        answers(thing)
        same(answers(pickle.loads(pickle.dumps(thing))), expected)


def test_a_moment_that_fails_leaves_no_triangles_of_another(atrium):
    """The triangles of an earlier moment must not stand for one that cannot be evaluated."""
    trees, calls = at.Engine(atrium)._shared.flat(), []
    first = trees.triangles(0.0, 1)

    class Fails:
        moved = None

        def triangles(self, time, threads):
            calls.append(time)
            raise at.InputError("no such moment")

    trees.data = Fails()
    for _ in range(2):
        with pytest.raises(at.InputError, match="no such moment"):
            trees.triangles(1.0, 1)
    assert calls == [1.0, 1.0] and len(first.vertices)


# --- Every lock has a remedy ------------------------------------------------------------------------------------------


WITHOUT_REMEDY = {
    "cli/console.py": "the progress line of a command, which does not fork",
    "base/forks.py": "it makes them",
    "base/progress.py": "of one piece of work",
    "devices/device.py": "a device refuses to work in a forked process",
    "devices/host/host_device.py": "a device refuses to work in a forked process",
    "store/store_file.py": "only on systems that cannot read at an offset",
    "store/system_resources.py": "an engine that was reading is made again, with its buffers",
    "techniques/chcrt/chc_rt.py": "an engine that was tracing drops its trees, with their states",
    "viewer/gizmos.py": "a viewer belongs to one process",
    "viewer/progressive_pictures.py": "a viewer belongs to one process",
    "viewer/request_guard.py": "a viewer belongs to one process",
}
"""Module with locks -> why they need no remedy after a fork."""


def test_each_lock_has_a_remedy():
    root, found = Path(antumbra.__file__).parent, set()
    for path in root.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if not re.search("Lock|Condition|Semaphore", text):
            continue
        tree = ast.parse(text)
        calls = {ast.unparse(node.func).rpartition(".")[2] for node in ast.walk(tree) if isinstance(node, ast.Call)}
        if calls & {"Lock", "RLock", "Condition", "Semaphore"}:
            name = path.relative_to(root).as_posix()
            found.add(name)
            assert name in WITHOUT_REMEDY or calls & {"hold_during_fork", "renew_after_fork"}, name
    assert WITHOUT_REMEDY.keys() <= found and len(found) > len(WITHOUT_REMEDY) + 5
