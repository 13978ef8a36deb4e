"""What other packages announce is added once, whoever asks, and however many ask at once."""

from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import EntryPoint
from threading import Barrier
from types import SimpleNamespace

import pytest

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


def test_plugins_that_fail_are_reported_once_and_do_not_stop_others(monkeypatch):
    """The plan `auto` tries all plugins; it must not fail because one of them does."""
    called = []

    def broken():
        raise ImportError("no such module")

    points = {
        "bad": SimpleNamespace(value="bad:add", load=broken),
        "good": SimpleNamespace(value="good:add", load=lambda: lambda: called.append("good")),
        "own": SimpleNamespace(value="antumbra.own:add", load=lambda: lambda: called.append("own")),
    }
    monkeypatch.setattr(extras, "plugins_of", lambda group: points)
    monkeypatch.setattr(extras, "_added", set())
    monkeypatch.setattr(extras, "_tried", set())
    with pytest.warns(RuntimeWarning, match=r"plugin 'bad' \(bad:add\) cannot be loaded.*no such module") as warned:
        extras.try_plugins("tried")
    extras.try_plugins("tried")
    assert called == ["good"] and len(warned) == 1
    with pytest.raises(ImportError, match="no such module"):  # whoever needs a plugin learns why it is missing
        extras.load_plugins("tried")
    del points["bad"]
    extras.load_plugins("tried")
    assert called == ["good", "own"]


def test_packages_that_choose_the_same_name_are_both_found(monkeypatch):
    points = [EntryPoint("shadows", f"{package}:add", "a test's") for package in ("one", "two")]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [*points, EntryPoint("a", "b:c", group)])
    found = extras.plugins_of.__wrapped__("a test's")
    assert {name: point.value for name, point in found.items()} == {
        "a": "b:c",
        "shadows": "one:add",
        "shadows (two:add)": "two:add",
    }


def test_commands_come_by_name():
    found = extras.plugins_of("antumbra.bench")
    assert list(found) == sorted(found) and {"srdh", "multi-frusta"} <= set(found)
