"""Opens the scene of a command, and shows the loader's notes."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ..errors import InputError
from ..scene.scene_data import group_notes
from .arguments import SceneSpec
from .failures import say

if TYPE_CHECKING:
    from ..engine.scene import AnyScene

_MOST_NOTES = 5


def open_scene(spec: SceneSpec, up: str | None = None, quiet: bool = False, crs: str | None = None) -> "AnyScene":
    """The scene that a `SceneSpec` names, with a CRS. The loader's notes appear on standard error."""
    if spec.path is None:
        from .. import procedural

        if up is not None or crs is not None:
            raise InputError("--up and --crs belong to files; procedural scenes have +Y up and no CRS, leave them out")
        return procedural(spec.name, triangles=spec.triangles, seed=spec.seed)
    from .. import load
    from ..store.store_format import STORE_SUFFIX

    if up is not None and spec.path.suffix.lower() == STORE_SUFFIX:
        raise InputError(f"{spec.path.name}: a store has its own up axis; leave --up out")
    with quietly():  # the notes are printed below
        scene = load(spec.path, up=up, lod=spec.lod, cutouts=spec.cutouts, crs=crs)
    if not quiet:
        notes = group_notes(scene.notes, "antumbra info shows all")
        for note in notes[:_MOST_NOTES]:
            say(f"note: {note}")
        if len(notes) > _MOST_NOTES:
            say(f"note: and {len(notes) - _MOST_NOTES} other kinds; antumbra info shows all of them")
    return scene


@contextmanager
def quietly() -> Iterator[None]:
    """Hide the loader's notes, which are warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def limit_memory(scene: "AnyScene", max_memory: int | None) -> None:
    """Limit the memory of all questions to a scene in a store; InputError if the scene is in memory."""
    from ..engine.paged_scene import PagedScene

    if isinstance(scene, PagedScene):
        scene.max_memory = max_memory
    elif max_memory is not None:
        raise InputError(f"--max-memory is for scenes in a store, and {scene.name} is in memory; leave it out")


def in_memory(scene: "AnyScene") -> "AnyScene":
    """The scene; InputError if it is in a store."""
    from ..engine.paged_scene import PagedScene

    if isinstance(scene, PagedScene):
        raise scene.refusal()
    return scene
