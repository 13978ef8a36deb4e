"""The cases of studies: what the tests of all studies need to know of one.

They stand in the test folder of the study, in a module ``study_case.py`` with a constant `CASE`, and are found there.
"""

import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import antumbra as at
from repository import ROOT

TESTS = ROOT / "tests"


class StudyCase(NamedTuple):
    """A call of a study's function, and the words of its command, that suit any scene."""

    function: str  # public name
    keywords: dict[str, Any]  # of the call, besides the scene: constants
    exact: Callable[[Any], dict[str, Any]]  # of the result: what neither the unit of the scene nor a turn changes
    close: Callable[[Any, float], dict[str, Any]]  # (result, metres of a unit) -> what changes by rounding: in metres
    points: str = ""  # parameter that takes points
    command: str = ""
    words: tuple[str, ...] = ()  # of the command, besides the scene and --up; with an output
    outputs: tuple[str, ...] = ()  # words instead, with a file of each suffix; several files may follow one option
    numbers: tuple[str, ...] = ()  # of the answer in JSON that do not depend on the up axis
    methods: dict[str, dict[str, Any]] = {}  # noqa: RUF012 - a constant; method of a class of the result -> keywords

    def call(self, scene: Any, **more: Any) -> Any:
        """The result for a scene."""
        return getattr(at, self.function)(scene, **(self.keywords | more))

    def call_with(self, points: np.ndarray) -> Callable[[Any], Any]:
        """A call with these points."""
        return lambda scene: self.call(scene, **{self.points: points})

    def words_without(self, option: str) -> tuple[str, ...]:
        """The words without an option and its value."""
        place = self.words.index(option) if option in self.words else len(self.words)
        return self.words[:place] + self.words[place + 2 :]


def study_cases(folder: Path = TESTS) -> list[StudyCase]:
    """The cases of all studies that have one."""
    return [runpy.run_path(str(path))["CASE"] for path in sorted(folder.rglob("study_case.py"))]
