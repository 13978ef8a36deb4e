"""A curved earth with refraction: copies of a scene that sink with the square of the distance from an observer.

A straight line over the copy stands for a line over the earth that bends with the air, as in the viewsheds of GIS
programs: a point at a horizontal distance d sinks by (1 - k) d^2 / (2 R).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...checks import number
from ...engine.scene import AnyScene, Scene
from ..sensors import Sensors, corners_of

EARTH_RADIUS = 6_371_000.0
REFRACTION = 0.13
_SAG = 1e-3  # world units: how far an edge may lie above the curve between its ends


class Earth(NamedTuple):
    """A curved earth.

    drop : float
        (1 - k) / (2 R), per world unit.
    up : int
        The axis that points up.
    """

    drop: float
    up: int

    @property
    def longest(self) -> float:
        """The longest edge that stays whole: its middle lies drop * length^2 / 4 above the curve."""
        return 2.0 * np.sqrt(_SAG / self.drop)

    def sunk(self, points: np.ndarray, observer: np.ndarray) -> np.ndarray:
        """(..., 3) float64: points, lowered for an observer."""
        out = points.copy()
        away = np.delete(points - observer, self.up, -1)
        out[..., self.up] -= self.drop * (away * away).sum(-1)
        return out

    def tilted(self, normals: np.ndarray, points: np.ndarray, observer: np.ndarray) -> np.ndarray:
        """(n, 3) float64: the normals of lowered surfaces, of any length."""
        away = points - observer
        away[:, self.up] = 0.0
        return normals + 2.0 * self.drop * normals[:, self.up, None] * away


def earth_of(scene: AnyScene, refraction, radius) -> Earth:
    """A checked `Earth`."""
    k = number(refraction, "refraction", -1.0, 1.0)
    return Earth((1.0 - k) / (2.0 * number(radius, "earth_radius", 0.0, np.inf)), "xyz".index(scene.up))


class CurvedScene:
    """A scene on a curved earth, as observers see it. Long edges are divided, for both faces at them alike."""

    def __init__(self, scene: AnyScene, earth: Earth, time: float):
        self.scene, self.earth, self.corners = scene, earth, divided(corners_of(scene, time), earth.longest)

    def seen_from(self, observer: np.ndarray) -> Scene:
        """The copy for an observer ((3,) world)."""
        return Scene.from_arrays(self.earth.sunk(self.corners, observer), name=self.scene.name, up=self.scene.up)

    def sensors(self, sensors: Sensors, observer: np.ndarray) -> Sensors:
        """The sensors of the copy. Those on faces are lifted by the most that a face may lie above the curve."""
        at, normals = self.earth.sunk(sensors.points, observer), sensors.normals
        if normals is not None:
            normals = self.earth.tilted(normals, sensors.points, observer)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            if sensors.faces is not None:
                at[sensors.faces >= 0] += (_SAG * normals)[sensors.faces >= 0]
        return replace(sensors, points=at, normals=normals)


def divided(corners: np.ndarray, longest: float) -> np.ndarray:
    """(m, 3, 3): triangles without edges longer than `longest`; each longer one is halved, the longest of a face first.

    Faces at an edge halve it at the same point, because halving depends on the edge alone.
    """
    done = []
    while len(corners):
        lengths = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=2)
        k = lengths.argmax(1)
        long = lengths[np.arange(len(k)), k] > longest
        done.append(corners[~long])
        corners, k = corners[long], k[long]
        row = np.arange(len(k))
        a, b, c = (corners[row, (k + shift) % 3] for shift in range(3))
        middle = (a + b) / 2.0
        corners = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    return np.concatenate([np.empty((0, 3, 3)), *done])
