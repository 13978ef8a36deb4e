"""Where the light of interpolated normals ends: before the next faces turn away from it. See docs/design/shading.md."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined
from ..kernels.predicate.filters import dot


class Facing(NamedTuple):
    """The normals at the pixels of a picture, for kernels."""

    normal: np.ndarray  # (H, W, 3) float32: the normals that shade
    geometric: np.ndarray  # (H, W, 3) float32
    bend: np.ndarray  # (H, W) float32: `ShadingNormals.bend`; not read if not `soft`
    soft: bool  # whether the two normals differ


def facing_of(gbuffer, shading) -> Facing:
    """The normals of a G-buffer; `shading`: its ShadingNormals, or None."""
    if shading is None:
        return Facing(gbuffer.normal, gbuffer.normal, gbuffer.depth, False)
    return Facing(shading.normal, gbuffer.normal, shading.bend, True)


@inlined
def softened(g, n, bend, w):
    """The factor for light along w, with geometric normal g, shading normal n, and `ShadingNormals.bend`.

    Light below the geometric surface gives nothing. Towards the height `bend` above the horizon of n it fades, by the
    polynomial of Chiang et al. [2019]. So it has ended where the next faces turn away from the light.
    """
    height = dot(n, w) / np.sqrt(dot(w, w))
    if not (dot(g, w) > 0.0 and height > bend):
        return 0.0
    share = (height - bend) / bend if height < 2.0 * bend else 1.0  # Eq. (2)
    return share * (1.0 + share * (1.0 - share))
