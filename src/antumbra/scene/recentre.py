"""Where a scene's frame has its zero."""

import numpy as np

MAX_EXTENT = 1e18
"""Widest scene, in its own units: areas of its boxes stay finite in float32."""


def frame_origin(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """World position ((3,) float64) of the zero of the frame for the bounds `lower`, `upper` ((3,) float64).

    The middle of the bounds, moved to a whole number of steps g above `lower`, where g is the power of two
    2**20 times below the widest extent. So the frame moves along exactly with a scene that is moved by
    an offset that float64 adds exactly (metres of a map grid, say); its float32 coordinates stay the same.
    """
    extent = (upper - lower).max()
    if not extent > 1e-200:
        return lower.copy()
    exponent = int(np.frexp(extent)[1]) - 1  # floor(log2(extent))
    step = np.ldexp(1.0, exponent - 20)
    return lower + np.round((upper - lower) / 2.0 / step) * step
