"""The recentred frame of a scene: its zero, and which coordinates it holds."""

import numpy as np

MAX_EXTENT = 1e18
"""Largest extent of a scene, in its own units. Areas of its boxes stay finite in float32."""


MIN_EXTENT = 2.0**-100
"""Least extent of a scene with more than one point, in its own units."""

NEAREST = 2.0**-110
"""Coordinates in the frame are 0 or of at least this magnitude, so that the tracers' error bounds cover underflow."""


def settled(local: np.ndarray) -> np.ndarray:
    """Coordinates in a frame, with those below NEAREST set to 0."""
    return np.where(np.abs(local) < NEAREST, local.dtype.type(0.0), local)


def frame_origin(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """World position ((3,) float64) of the zero of the frame for the bounds `lower`, `upper` ((3,) float64).

    The origin is the middle of the bounds, rounded to a whole number of steps above `lower`. The step is 2**-20
    times the largest power of two not above the widest extent. If a scene moves by an offset that float64 adds
    exactly, such as metres of a map grid, the frame moves by the same offset. The scene's float32 coordinates stay
    the same.
    """
    extent = (upper - lower).max()
    if not extent > 1e-200:
        return lower.copy()
    exponent = int(np.frexp(extent)[1]) - 1  # floor(log2(extent))
    step = np.ldexp(1.0, exponent - 20)
    return lower + np.round((upper - lower) / 2.0 / step) * step
