"""Coordinates that float32 has rounded before they were read, such as metres of a map grid in STL, PLY and glTF files.

Float32 has 24 bits, so northings of UTM have a spacing of half a metre. Files say what precision they store, not
whether the coordinates needed more, but the numbers show both: rounded ones use the last bit as often as not.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

COARSE = 1e-5
"""Spacing of float32 numbers, as a share of the size of the scene, above which rounding is noted."""

_ODD = 0.1  # share of numbers that use the last bit, from which on they were rounded


def rounding_notes(
    file: str, bounds: NDArray[np.float64], sample: Callable[[], NDArray[np.floating]], cure: str = ""
) -> list[str]:
    """A note if coordinates were rounded to steps above `COARSE` of their extent.

    Parameters
    ----------
    file : str
    bounds : (2, 3) float64
        Lower and upper corner.
    sample : function
        Some of the coordinates, (..., 3). It is called only if their magnitude allows such steps.
    cure : str, optional
        What to do about it.
    """
    size = float((bounds[1] - bounds[0]).max())
    with np.errstate(over="ignore"):
        steps = np.spacing(np.abs(bounds).max(0).astype(np.float32)).astype(np.float64)
    coarse = np.flatnonzero(np.isfinite(steps) & (steps > COARSE * size))
    if not len(coarse) or not size > 0.0:
        return []
    points = sample().reshape(-1, 3)
    rounded = [axis for axis in coarse.tolist() if _is_rounded(points[:, axis])]
    if not rounded:
        return []
    step = steps[rounded].max()
    return [
        f"{file}: its coordinates, up to {np.abs(bounds[:, rounded]).max():.7g}, were rounded to steps of {step:.3g} "
        f"by float32; {cure or 'export it in float64, or nearer to the origin'}"
    ]


def _is_rounded(values: NDArray[np.floating]) -> bool:
    """Whether numbers are those of float32, and use its last bit."""
    single = values.astype(np.float32)
    distinct = np.unique(single)
    return bool((single == values).all() and (distinct.view(np.uint32) & 1).mean() >= _ODD)
