"""The link from scenes to what answers questions about them, which imports scenes and not the other way round.

The package registers functions with `use`:

- ``ask(scene, any_hit, rays, targets, time, cull_faces, threads)`` gives (...) bool if `any_hit`, else a `Hit`. `rays`
  are the first five arguments of `Scene.occluded`, and `targets` is its argument of this name.
- ``room_of(scene, outside)`` gives the `Room` that a scene encloses, or None. `outside` is a camera that shows it.
"""

from collections.abc import Callable
from typing import Any

_finders: dict[str, Callable[[], Callable]] = {}


def use(name: str, finder: Callable[[], Callable]) -> None:
    """Let ``finder()`` return the function of this name. Each question calls it."""
    _finders[name] = finder


def answer(name: str, *arguments) -> Any:
    """Answer a question by the registered function."""
    return _finders[name]()(*arguments)
