"""The link from `Scene` to the ray queries, which import scenes and not the other way round.

The package registers the function with `use`. ``ask(scene, any_hit, rays, time, cull_faces, threads)`` gives (...) bool
if `any_hit`, else a `Hit`. `rays` are the first five arguments of `Scene.occluded`.
"""

from collections.abc import Callable

_finders: list[Callable[[], Callable]] = []


def use(finder: Callable[[], Callable]) -> None:
    """Let ``finder()`` return the function behind `ask`. Each query calls it."""
    _finders[:] = [finder]


def ask(*arguments):
    """Answer a query by the registered function."""
    return _finders[0]()(*arguments)
