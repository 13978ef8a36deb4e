"""The anti-aliasing of a frame: the pixels at edges of its image and of what belongs to it are mixed."""

import numpy as np

from ..picture.morphological_antialiasing import mixture
from ..query.gbuffer import PictureSurfaces
from ..query.shadow_query import Surfaces
from .frame import Ground
from .state import FrameState, edge_colours


def antialias(
    state: FrameState, surfaces: Surfaces, seen: PictureSurfaces, pictures: list[np.ndarray], ground: Ground | None
) -> np.ndarray:
    """Mix the pixels at edges of pictures with those across. Returns (H, W) float32: the share that shows surfaces."""
    coverage = (surfaces.ids >= 0).astype(np.float32)
    mixed, free = mixture(seen, edge_colours(state), state.threads), np.float32(1.0) - coverage[..., None]
    for each in [coverage, *pictures]:
        mixed.mix(each)
    if ground is not None:
        kept, whole = mixed.of(free * ground.share), mixed.of(free)
        share = np.divide(kept, whole, out=np.ones_like(kept), where=whole > 0.0)
        ground.share.reshape(-1, 3)[mixed.pixels] = share
    state.clock.lap("shade")
    return coverage
