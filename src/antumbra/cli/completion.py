"""Completion of values in the shell: scenes, plans, rules, cameras, lights and sensors.

The names are those of the registries, which are imported only to complete a word.
"""

import os
from collections.abc import Callable, Iterator

from ..base.wings import RULES, named
from .arguments import CAMERA_KINDS, LIGHT_FORMS

_SENSORS = "face", "vertex", "grid:", "raster:"
_LAST = "+"  # separates the methods of a plan


def completing_words() -> list[str]:
    """The words of the command line that a shell completes; none outside completion."""
    words = (os.environ.get(name, "") for name in ("COMP_WORDS", "_TYPER_COMPLETE_ARGS"))
    return [word for text in words for word in text.split()] if "_ANTUMBRA_COMPLETE" in os.environ else []


def _scenes(word: str) -> Iterator[str]:
    from ..examples import EXAMPLES
    from ..generate.procedural_scenes import PROCEDURAL

    yield from (f"example:{name}" for name in EXAMPLES)
    yield from (f"procedural:{name}" for name in PROCEDURAL)


def _plans(word: str) -> Iterator[str]:
    from ..engine.method_registry import KINDS, listed_methods

    start, plus, _ = word.rpartition(_LAST)
    yield from (start + plus + name for field in KINDS for name in listed_methods(field))


def _rules(word: str) -> Iterator[str]:
    yield from named(RULES)


_NAMES: dict[str, Callable[[str], Iterator[str]]] = {
    "scene": _scenes,
    "plan": _plans,
    "rule": _rules,
    "camera": lambda word: iter(CAMERA_KINDS),
    "light": lambda word: (f"{kind}:" for kind in LIGHT_FORMS),
    "sensors": lambda word: iter(_SENSORS),
}
"""Name of a parameter -> the names with which its value may begin."""


def completion_of(parameter: str) -> Callable[[str], list[str]] | None:
    """The function that completes the value of a parameter from its beginning; None: the shell does, as for files."""
    names = _NAMES.get(parameter)
    return None if names is None else lambda incomplete: [n for n in names(incomplete) if n.startswith(incomplete)]
