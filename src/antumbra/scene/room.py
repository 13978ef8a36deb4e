"""The room that a scene encloses, if it is one: halls, streets below a painted sky, patios."""

from typing import NamedTuple

import numpy as np


class Room(NamedTuple):
    """A room, and the camera that shows it from inside."""

    middle: np.ndarray  # (3,) float64, world: a point in the air
    eye: np.ndarray  # (3,) float64, world
    target: np.ndarray  # (3,) float64, world
    vfov: float  # degrees; with `points`, across a picture that is higher than wide
    open: bool  # whether much of the sky is seen from the middle
    height: float  # from the middle up to the ceiling; 0.0 without one
    points: np.ndarray | None = None  # (k, 3) float64, world: what it shows from inside a closed box; None: its walls
