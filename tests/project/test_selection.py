"""No test is in no run, and the default run calls everything once; see ``tests/support/selection.py``."""

import os
import re
import subprocess
import sys

import pytest

import antumbra as at
from antumbra.base.command_registry import COMMANDS
from antumbra.engine.plan import covering_plans
from antumbra.engine.scene_reading import SCENE_SUFFIXES
from missing_packages import missing
from repository import ROOT
from selection import COLLECTED, DEFAULT, OTHERS, covering, matcher, rules

FILES = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "tests").rglob("test_*.py"))


@pytest.fixture
def default(pytestconfig) -> set[str]:
    """Ids of the tests of the default run."""
    if DEFAULT not in pytestconfig.stash:
        pytest.skip("the selection is NOT checked where only some files are collected: pytest -m volume")
    return pytestconfig.stash[DEFAULT]


@pytest.fixture
def sources(default) -> str:
    """The files of which some test is in the default run."""
    return "\n".join((ROOT / file).read_text() for file in sorted({each.partition("::")[0] for each in default}))


def test_each_file_has_tests_in_some_run(default, pytestconfig):
    collected = {item.nodeid.partition("::")[0] for item in pytestconfig.stash[COLLECTED]}
    lacking = [file for file in FILES if file not in collected and "importorskip(" not in (ROOT / file).read_text()]
    assert lacking == [] and len(collected) > 0.9 * len(FILES)


def test_continuous_integration_runs_each_marker():
    runs = (ROOT / ".ci" / "run").read_text() + (ROOT / ".github" / "workflows" / "nightly.yml").read_text()
    asked = " ".join(re.findall(r"-m '?([^'\n]*)'?", runs))
    assert {"volume", *OTHERS} <= set(re.findall(r"\w+", re.sub(r"not \w+", "", asked)))


@pytest.mark.parametrize("plan", covering_plans(), ids=str)
def test_each_plan_is_compared_with_the_oracle(plan, default):
    ids = [each for each in default if each.startswith("tests/contract/test_exactness.py::")]
    assert any(re.search(rf"[\[-]{re.escape(str(plan))}[\]-]", each) for each in ids)


def test_each_format_is_read(default):
    read = "tests/formats/test_format_registry.py::test_every_format_is_read"
    assert {f"{read}[{suffix}]" for suffix in SCENE_SUFFIXES} <= default and len(SCENE_SUFFIXES) > 5


def test_each_public_name_occurs(sources):
    assert [name for name in at.__all__ if not re.search(rf"\b{name}\b", sources)] == []


def test_each_command_runs(sources):
    assert len(COMMANDS) > 15
    assert [name for name in COMMANDS if not re.search(rf"""["'\[ ]{name}["'\], ]""", sources)] == []


def test_names_of_the_list_are_whole_words():
    whole, each = rules("# why\na/test_b.py::test_c\neach d  # why\ne/*_f\n")
    assert (whole, each) == (["a/test_b.py::test_c", "e/*_f"], ["d"])
    found = matcher(whole)
    assert found.match("tests/a/test_b.py::test_c") and found.match("tests/a/test_b.py::test_c[1]")
    assert found.match("tests/e/g_f/test_h.py::test_i")
    assert not found.match("tests/a/test_b.py::test_cd") and not found.match("tests/a/test_b.py")


def test_a_covering_selection_has_each_value():
    all_pairs = [{"plan": plan, "scene": scene} for plan in "abcd" for scene in "xy"]
    kept = [all_pairs[index] for index in covering(all_pairs)]
    assert len(kept) == 4
    assert {each["plan"] for each in kept} == set("abcd") and {each["scene"] for each in kept} == set("xy")


def test_only_what_cannot_be_imported_excuses_a_failure():
    assert missing("E   a plot needs nosuchpackage: pip install 'antumbra[plot]'") == "nosuchpackage"
    assert missing("E   ModuleNotFoundError: No module named 'nosuchpackage.part'") == "nosuchpackage"
    assert missing("E   a matrix needs numpy: pip install 'antumbra[jit]'") is None
    assert missing("E   assert 1 == 2") is None


TESTS = """
import pytest

def test_a():
    pass

@pytest.mark.parametrize("what", ["b c"])
def test_b(what):
    assert what == ""

def test_c():
    import nosuchpackage
"""
WITHOUT_THE_PACKAGE = """
import pytest

pytest.importorskip("nosuchpackage")

def test_d():
    pass

@pytest.mark.slow
def test_e():
    pass
"""


def test_a_run_says_what_to_do(tmp_path):
    (tmp_path / "test_some.py").write_text(TESTS)
    (tmp_path / "test_other.py").write_text(WITHOUT_THE_PACKAGE)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    command = [sys.executable, "-m", "pytest", "-p", "missing_packages", "-p", "selection", "-p", "outcomes"]
    env = {**os.environ, "PYTHONPATH": str(ROOT / "tests" / "support")}

    def out(*options: str) -> str:
        return subprocess.run([*command, *options], cwd=tmp_path, env=env, capture_output=True, text=True).stdout

    first = out("-m", "not slow")
    assert "1 failed, 1 passed, 2 skipped" in first, first
    assert "    1  needs nosuchpackage, which is not installed" in first
    assert "pytest -n 0 -m '' 'test_some.py::test_b[b c]'" in first
    second = out("--skipped")
    assert "2 skipped, 2 deselected" in second, second
    (tmp_path / "nosuchpackage.py").touch()
    third = out("--skipped")
    assert "2 passed, 3 deselected" in third, third
