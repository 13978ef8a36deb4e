"""Conversion of sRGB to linear light."""

import numpy as np


def srgb_to_linear(value) -> np.ndarray:
    """Convert sRGB in [0, 1] to linear light (IEC 61966-2-1), float64."""
    value = np.asarray(value, np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


BYTE_TO_LINEAR = srgb_to_linear(np.arange(256) / 255.0)
