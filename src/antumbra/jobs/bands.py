"""A picture whose rays are traced in bands of rows, by any engine."""

from collections.abc import Sequence

from ..picture.frame import Frame
from ..picture.render_options import RenderOptions
from ..picture.renderer import Renderer
from ..picture.row_bands import BAND, band_array_names, joined_bits
from ..scene.camera import Camera
from ..scene.lights import Light
from .engines import Engine
from .parts import Parts, about_parts


def render_bands(
    renderer: Renderer, camera: Camera, lights: Sequence[Light], options: RenderOptions, engine: Engine, scene: str,
    settings: dict,
) -> Frame | None:  # fmt: skip
    """The frame of `Renderer.render`, whose rays an engine traces; None if it leaves bands to others.

    scene, settings : the digest of the scene, and all that the bits depend on besides it, as JSON can hold them
    """
    request = renderer.request(camera, lights, options)
    rows = None

    def band(first: int, last: int):
        nonlocal rows
        rows = rows or renderer.rows(request)
        return rows.band(first, last)

    about = about_parts("picture", scene, settings)
    parts = Parts("bands of the picture", camera.height, BAND, band, engine.folder, about)
    if not engine.finish([parts]):
        return None
    frame = renderer.from_rows(request, joined_bits(parts.joined(band_array_names(request))))
    engine.end([parts])  # the bits are in memory
    return frame
