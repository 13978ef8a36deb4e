"""The appearance of the triangles that a picture sees: that of the scene, or rows of a store for these triangles only.

Textures of stores are decoded when a picture needs them, within the limit on memory, and stay for the next pictures.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.sources.source_protocols import Memory
from ..query.shadow_query import Surfaces
from ..scene.appearance import Appearance
from ..scene.materials import Texture, pbr_of
from ..scene.scene_data import LookReader, SceneData
from ..scene.triangles import Triangles
from .render_options import PBR, RenderOptions

_CURE = "the textures of this picture; render without textures"


class SeenAppearance(NamedTuple):
    """An appearance, and how triangles and pixels index it."""

    appearance: Appearance
    of_triangles: NDArray[np.integer] | None  # rows of triangles; None: that of each triangle has its number
    is_varied: bool  # whether some face of the scene shows a texture, or colours of its corners

    def rows(self, triangles: Triangles) -> NDArray[np.integer]:
        """(n,): the rows of triangles."""
        return np.arange(len(triangles.face_id)) if self.of_triangles is None else self.of_triangles

    def of_pixels(self, surfaces: Surfaces) -> NDArray[np.int32]:
        """(H, W): the rows of pixels; -1: background."""
        return surfaces.gbuffer.face if self.of_triangles is None else surfaces.ids


def seen_appearance(
    scene: SceneData, memory: Memory | None, triangles: Triangles, options: RenderOptions, threads: int
) -> SeenAppearance | None:
    """The appearance of triangles that pixels see; None if all faces of the scene have plain colours.

    Raises
    ------
    InputError
        If the looks of a store are damaged, or if their textures do not fit in memory.
    """
    if (looks := scene.stored_looks) is None:
        if (whole := scene.appearance) is None:
            return None
        return SeenAppearance(whole, triangles.face_id, bool(whole.textured.any()) or whole.colours is not None)
    assert memory is not None
    memory.make_room(looks.row_bytes() * len(triangles.face_id), _CURE)
    appearance = looks.of(triangles.face_id)
    _make_room_for_textures(looks, appearance, memory, options, threads)
    return SeenAppearance(appearance, None, looks.is_varied)


def _make_room_for_textures(
    looks: LookReader, appearance: Appearance, memory: Memory, options: RenderOptions, threads: int
) -> None:
    """Free memory for the textures that a picture decodes."""
    shown = _textures(appearance, options)
    size = looks.decoding_bytes(shown, threads)
    if size and not memory.has_room(size):
        size -= looks.forget(shown)
    memory.make_room(max(size, 0), _CURE, stays=True)


def _textures(appearance: Appearance, options: RenderOptions) -> list[Texture]:
    """The textures of the materials that faces have."""
    seen = [appearance.materials[k] for k in np.unique(appearance.material_of_face).tolist() if k >= 0]
    found = [each.texture for each in seen if each.texture is not None] if options.textures else []
    maps = [of.texture for each in seen for of in pbr_of(each).maps] if options.materials == PBR else []
    return list(dict.fromkeys([*found, *maps]))
