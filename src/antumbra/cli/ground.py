"""The ground that catches shadows in pictures of ``antumbra render``: whether there is one, and at which height."""

from typing import TYPE_CHECKING

from ..checks import number
from ..errors import InputError

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..scene.camera import Camera

WORDS = "auto", "on", "off"
_FARTHEST = 1e30


def parse_ground(text: str) -> str | float:
    """Parse one of `WORDS`, or a height."""
    word = text.strip()
    if word in WORDS:
        return word
    try:
        return number(float(word), "--ground", -_FARTHEST, _FARTHEST)
    except ValueError as error:  # an InputError is one
        raise InputError(f"--ground is {text!r}; it must be auto, on, off or a height such as -1.5") from error


def ground_of(asked: str | float, scene: "AnyScene", camera: "Camera", time: float | None) -> float | None:
    """The height of the ground for `Renderer.render`; None: there is none.

    asked : from `parse_ground`
    time : seconds; None: the ground is for all moments of an animation
    """
    from ..engine.scene import Scene

    if asked == "off":
        return None
    if asked == "auto" and not _suits(scene, camera):
        return None
    if not isinstance(scene, Scene):
        raise InputError(f"--ground {asked}: {scene.name} is in a store, which has no ground; leave it out")
    return scene.ground_height(time) if isinstance(asked, str) else asked


def _suits(scene: "AnyScene", camera: "Camera") -> bool:
    """Whether a picture shows a scene in memory from outside.

    A scene may have a ground of its own: then its shadows go on beyond it.
    """
    from ..engine.scene import Scene

    if not isinstance(scene, Scene) or camera.projection == "panoramic":
        return False
    if ((camera.position > scene.bounds[0]) & (camera.position < scene.bounds[1])).all():
        return False
    try:
        return scene.view.room is None
    except InputError:  # a moment of the animation has no triangles: its frame shows the error
        return False
