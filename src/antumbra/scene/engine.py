"""What answers the rays that a `Scene` is asked: it is above scenes, so the package names it here.

``ask(scene, any_hit, rays, time, cull_faces, threads)`` gives (...) bool if `any_hit`, else a `Hit`. `rays` are the
first five arguments of `Scene.occluded`.
"""

from collections.abc import Callable

_finders: list[Callable[[], Callable]] = []


def use(finder: Callable[[], Callable]) -> None:
    """Let ``finder()`` give the function `ask`; it is called when the first ray is asked."""
    _finders[:] = [finder]


def ask(*arguments):
    """Hand the question on."""
    return _finders[0]()(*arguments)
