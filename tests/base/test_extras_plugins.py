"""What other packages announce is added once, whoever asks, and however many ask at once."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

from antumbra.base import extras


class Point:
    """An entry point whose function takes its time."""

    def __init__(self):
        self.calls = 0

    def load(self):
        def add():
            before = self.calls
            extras.load_plugins("a test's")  # looking something up while adding asks again
            self.calls = before + 1

        return add


def test_threads_that_ask_at_once_add_once(monkeypatch):
    point, start = Point(), Barrier(8)
    monkeypatch.setattr(extras, "plugins_of", lambda group: {"one": point} if group == "a test's" else {})

    def ask(_):
        start.wait()
        extras.load_plugins("a test's")
        return point.calls

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(ask, range(8))) == [1] * 8


def test_commands_come_by_name():
    found = extras.plugins_of("antumbra.bench")
    assert list(found) == sorted(found) and {"srdh", "multi-frusta"} <= set(found)
