"""The rays of orthographic and panoramic cameras, listed one by one."""

from typing import NamedTuple

import numpy as np


class ListedRays(NamedTuple):
    """The rays of an orthographic or panoramic camera, in the recentred frame of a scene.

    Each ray is computed in float64 and rounded once to float32, so every method traces the same rays. Directions have
    unit length, so t is a distance.
    """

    origin: np.ndarray  # (3,) float64, recentred
    axes: np.ndarray  # (3, 3) float64: unit vectors to the right and down in the picture, and towards its middle
    width: int  # pixels
    height: int
    extent: float | None  # height of an orthographic picture in world units; None: panoramic

    def through(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions, (..., 3) float32 each, of the rays through places of the picture.

        x, y : (...) float64, pixels right and down from the upper left corner; they broadcast
        """
        if self.extent is None:
            directions = self._around(x, y)
            return _everywhere(self.origin, directions.shape), directions
        x, y = np.broadcast_arrays(x, y)
        pixel = self.extent / self.height
        across, below = (x - self.width / 2.0) * pixel, (y - self.height / 2.0) * pixel
        origins = self.origin + across[..., None] * self.axes[0] + below[..., None] * self.axes[1]
        return origins.astype(np.float32), _everywhere(self.axes[2], origins.shape)

    def directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(..., 3) float32: the directions alone; see `through`."""
        return self.through(x, y)[1]

    def places(self, away: np.ndarray) -> np.ndarray:
        """(k, 2) float64: where rays through points cross the picture, the inverse of `through`; NaN behind the camera.

        away : (k, 3) float64, points minus `origin`
        """
        across, below, ahead = (away @ self.axes.T).T
        if self.extent is None:
            turn, sink = np.arctan2(across, ahead), np.arctan2(below, np.hypot(across, ahead))
            return np.stack([turn / (2.0 * np.pi) + 0.5, sink / np.pi + 0.5], 1) * (self.width, self.height)
        flat = np.stack([across, below], 1) * (self.height / self.extent) + (self.width / 2.0, self.height / 2.0)
        flat[ahead <= 0.0] = np.nan
        return flat

    def _around(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Directions of a panorama."""
        turn = (np.asarray(x, np.float64) / self.width - 0.5) * (2.0 * np.pi)
        sink = (np.asarray(y, np.float64) / self.height - 0.5) * np.pi
        flat = np.sin(turn)[..., None] * self.axes[0] + np.cos(turn)[..., None] * self.axes[2]
        return (np.cos(sink)[..., None] * flat + np.sin(sink)[..., None] * self.axes[1]).astype(np.float32)


def _everywhere(vector: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return np.broadcast_to(vector.astype(np.float32), shape)
