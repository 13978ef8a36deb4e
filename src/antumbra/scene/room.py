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
    planes: np.ndarray | None = None  # (m, 4) float64, world, see `way_out`: of the closed box that it is in

    def way(self, start: np.ndarray, along: np.ndarray) -> float:
        """How many times `along` leads from a point in a closed box to this box; inf without one."""
        return np.inf if self.planes is None else way_out(self.planes, start, along)


def way_out(planes: np.ndarray, start: np.ndarray, along: np.ndarray) -> float:
    """How many times `along` ((3,) float64) leads from a point inside planes ((m, 4): n x + d <= 0 inside) to them."""
    left, rate = -(planes[:, :3] @ start + planes[:, 3]), planes[:, :3] @ along
    return float((left[rate > 0.0] / rate[rate > 0.0]).min())
