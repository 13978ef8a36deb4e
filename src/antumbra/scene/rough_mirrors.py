"""Directions in which rough surfaces mirror light: GGX lobes around the mirror direction."""

import numpy as np
from numpy.typing import NDArray

from ..kernels.elementary import cos, sin

ROUGHNESSES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""The roughnesses for which skies are blurred and traced; between them, radiance is interpolated."""

LEAST_ALPHA = 0.002
"""The least squared roughness: a narrower lobe would slip between the samples of lights."""


def mirror_cone(roughness: float, square: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) float64: unit vectors around the z axis in which a surface seen along this axis mirrors it.

    Half vectors are distributed as GGX [Walter et al. 2007]; light from below the surface is left out.

    square : (..., 2), points of the unit square
    """
    alpha2 = max(roughness * roughness, LEAST_ALPHA) ** 2
    u = square[..., 0] / (1.0 + alpha2)  # half vectors of at most 45 degrees
    cosine2 = (1.0 - u) / (1.0 + (alpha2 - 1.0) * u)
    height, angle = np.maximum(2.0 * cosine2 - 1.0, 0.0), 2.0 * np.pi * square[..., 1]
    width = np.sqrt(np.maximum(1.0 - height * height, 0.0))
    return np.stack([width * cos(angle), width * sin(angle), height], -1)
