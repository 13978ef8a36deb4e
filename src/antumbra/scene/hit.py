"""The answer to closest-hit rays."""

from typing import NamedTuple

import numpy as np


class Hit(NamedTuple):
    """Nearest hits of rays; leading shape (...) as the rays had."""

    t: np.ndarray  # (...) float64, in lengths of the direction; inf on a miss
    face: np.ndarray  # (...) int32, index of the face in the scene; -1 on a miss
    u: np.ndarray  # (...) float32, weight of the face's second corner; 0 on a miss
    v: np.ndarray  # (...) float32, weight of its third corner; 0 on a miss
