"""Choose the tests of a run: the default run, ``-m volume``, and ``--skipped``.

``tests/volume.txt`` lists what the default run leaves out. Two kinds of tests are part of both: property tests try few
examples by default and all of them at volume, and of functions that the list marks with ``each``, the default run keeps
a few combinations of parameters in which each value occurs.
"""

import itertools
import re
from pathlib import Path

import pytest
from hypothesis import is_hypothesis_test

from strength import load_profile

FOLDER = Path(__file__).parents[1]
LIST = FOLDER / "volume.txt"
FOLDERS = {"tests/lab/papers/": "papers", "tests/benchmarks/": "programs"}  # markers of whole folders
OTHERS = "slow", "papers", "programs", "cluster"  # markers of tests with runs of their own
SKIPPED = "antumbra/skipped"  # key in pytest's cache: the tests and files that the last run skipped
MARKERS = "antumbra/markers"  # the same: its -m
COLLECTED = pytest.StashKey[list[pytest.Item]]()  # all tests, before any is left out
DEFAULT = pytest.StashKey[set[str]]()  # ids of those of the default run


def rules(text: str) -> tuple[list[str], list[str]]:
    """The names in the list: of tests that are left out, and of functions that keep each value of each parameter."""
    lines = [line.partition("#")[0].strip() for line in text.splitlines()]
    each = [line.removeprefix("each ").strip() for line in lines if line.startswith("each ")]
    return [line for line in lines if line and not line.startswith("each ")], each


def matcher(names: list[str]) -> re.Pattern[str]:
    """Matches tests with one of these names, or in folders, files and functions with one; * stands for anything."""
    joined = "|".join(".*".join(map(re.escape, name.split("*"))) for name in names)
    return re.compile(rf"(?:tests/)?(?:{joined or '(?!)'})(?:$|/|::|\[)")


def covering(combinations: list[dict[str, str]]) -> set[int]:
    """Indices of a few combinations in which each value of each parameter occurs, chosen greedily."""
    pairs = [set(each.items()) for each in combinations]
    kept, missing = set(), set().union(*pairs)
    while missing:
        best = max(range(len(pairs)), key=lambda index: (len(pairs[index] & missing), -index))
        kept.add(best)
        missing -= pairs[best]
    return kept or {0}


def left_out(items: list[pytest.Item], text: str) -> list[pytest.Item]:
    """The tests that a list leaves out of the default run."""
    whole, each = map(matcher, rules(text))
    out = [item for item in items if whole.match(item.nodeid)]
    functions: dict[str, list[pytest.Item]] = {}
    for item in items:
        if each.match(item.nodeid) and not whole.match(item.nodeid):
            functions.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for group in functions.values():
        kept = covering([_values(item) for item in group])
        out += [item for index, item in enumerate(group) if index not in kept]
    return out


def _values(item: pytest.Item) -> dict[str, str]:
    """Parameter -> its value."""
    return {name: str(value) for name, value in item.callspec.params.items()} if hasattr(item, "callspec") else {}


def unused(items: list[pytest.Item], text: str) -> list[str]:
    """Names in the list that no test has, though its file was collected."""
    files = {item.nodeid.partition("::")[0] for item in items}
    ids = [item.nodeid for item in items]
    found = []
    for name in itertools.chain(*rules(text)):
        pattern, file = matcher([name]), f"tests/{name.partition('::')[0]}"
        if (file in files or not (FOLDER.parent / file).exists()) and not any(map(pattern.match, ids)):
            found.append(name)
    return found


def is_default(config: pytest.Config) -> bool:
    """Whether this run leaves out the tests at volume, so that property tests try few examples."""
    return re.search(r"not\s+volume", config.option.markexpr) is not None


def is_whole(config: pytest.Config) -> bool:
    """Whether all tests are collected, not those of some files."""
    return config.args_source is pytest.Config.ArgsSource.TESTPATHS


def pytest_addoption(parser):
    parser.addoption("--skipped", action="store_true", help="run what the last run skipped, with that run's -m")


def pytest_configure(config):
    if config.option.skipped:  # of a file that could not be imported, the tests that the last run wanted
        config.option.markexpr = config.cache.get(MARKERS, "")
    if not config.getoption("--hypothesis-profile"):
        load_profile("default" if is_default(config) else "volume")


@pytest.hookimpl(tryfirst=True)  # before pytest applies -m
def pytest_collection_modifyitems(config, items):
    for item in items:
        for folder, marker in FOLDERS.items():
            if item.nodeid.startswith(folder):
                item.add_marker(marker)
    text = LIST.read_text()
    regular = [item for item in items if not any(map(item.get_closest_marker, OTHERS))]
    out = left_out(regular, text)
    for item in out:
        item.add_marker(pytest.mark.volume)
    default = {item.nodeid for item in regular if not item.get_closest_marker("volume")}
    if not is_default(config):
        for item in regular:
            if is_hypothesis_test(getattr(item, "function", None)):
                item.add_marker(pytest.mark.volume)
    if is_whole(config):
        if names := unused(regular, text):
            raise pytest.UsageError(f"{LIST.name} names no test: {', '.join(names)}")
        config.stash[COLLECTED], config.stash[DEFAULT] = list(items), default
    if config.option.skipped:
        skipped = config.cache.get(SKIPPED, [])
        files, ids = {each for each in skipped if "::" not in each}, set(skipped)
        chosen = [item for item in items if item.nodeid in ids or item.nodeid.partition("::")[0] in files]
        config.hook.pytest_deselected(items=[item for item in items if item not in set(chosen)])
        items[:] = chosen
