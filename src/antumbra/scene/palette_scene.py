"""Scenes with palette colours, as generators return and format writers take them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class PaletteScene(NamedTuple):
    """Indexed triangles with palette colours, a camera and a light: metres, +Y up, right-handed."""

    vertices: NDArray[np.float32]  # (v, 3) float32
    faces: NDArray[np.int32]  # (f, 3) int32, counter-clockwise seen from outside
    colour: NDArray[np.uint8]  # (f,) uint8, palette indices
    palette: NDArray[np.float32]  # (256, 3) float32, linear
    camera: dict[str, Any]  # position, target, up: (3,) tuples of float; vfov: degrees
    light: dict[str, Any]  # a quad: corner, u, v: (3,) tuples of float
