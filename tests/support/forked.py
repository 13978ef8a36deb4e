"""Work in child processes, and what a scene answers there."""

import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

import antumbra as at

SECONDS = 120  # a child that waits for longer is killed: it waits forever
LAMP = at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2))


def answers(scene: at.Scene | at.PagedScene | at.Engine) -> list[np.ndarray]:
    """What a scene or an engine answers to rays and points."""
    rng = np.random.default_rng(2)
    points, directions = rng.uniform((-6, 0.1, -4), (6, 5, 4), (2000, 3)), rng.normal(size=(2000, 3))
    engine = scene if isinstance(scene, at.Engine) else scene.engine
    receivers = at.Receivers.in_space(points[:100], engine.data.origin)
    hit = engine.closest_hit(points, directions)
    found = [engine.occluded(points, directions), hit.face, hit.t, engine.visibility(receivers, [LAMP], spp=16).bits]
    assert 0 < found[0].mean() < 1
    return found


def same(one: list[np.ndarray], other: list[np.ndarray]) -> None:
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def in_child(work: Callable[[], object]) -> object:
    """The result of a function in a forked child. AssertionError if it fails, or waits forever."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(SECONDS)
            data = pickle.dumps(work())
            with open(write, "wb") as pipe:
                pipe.write(data)
            code = 0
        finally:
            os._exit(code)
    os.close(write)
    with open(read, "rb") as pipe:
        data = pipe.read()
    _, status = os.waitpid(child, 0)
    assert status == 0, f"the child ended with status {status}"
    return pickle.loads(data)


@contextmanager
def held_elsewhere(lock: threading.Lock) -> Iterator[None]:
    """Another thread holds a lock in this block."""
    held, done = threading.Event(), threading.Event()

    def hold() -> None:
        with lock:
            held.set()
            done.wait()

    thread = threading.Thread(target=hold)
    thread.start()
    held.wait()
    try:
        yield
    finally:
        done.set()
        thread.join()
