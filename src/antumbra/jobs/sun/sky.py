"""The sky-view factor: the share of a uniform sky's light that arrives at a sensor."""

import numpy as np

from ...plan import Plan
from ...scene.any_scene import AnyScene
from ..sensors import Sensors
from .hours import answer, ask
from .positions import Suns


def sky_directions(count: int, up: str) -> np.ndarray:
    """(count, 3) float64: unit vectors to points of equal share of the sky, on a spiral (Vogel's, lifted)."""
    i = np.arange(count)
    height, angle = (i + 0.5) / count, i * np.pi * (3.0 - np.sqrt(5.0))
    width = np.sqrt(1.0 - height * height)
    east, north = width * np.cos(angle), width * np.sin(angle)
    return np.stack([east, north, height] if up == "z" else [east, height, -north], axis=1)


def sky_view(
    scene: AnyScene, sensors: Sensors, count: int = 512, *, plan: str | Plan | None = None, threads: int | None = None
) -> np.ndarray:
    """(n,) float64 in [0, 1]: the sky-view factor of each sensor.

    It is the sum of the cosines to open directions over the sum that an open horizontal plane has. So a free wall has
    0.5. Sensors without normals count all directions alike. Directions below the horizon belong to the ground.

    count : directions of the sky
    """
    towards = sky_directions(count, scene.up)
    zeros, times = np.zeros(count), np.zeros(count, "datetime64[s]")
    suns = Suns(times, times, np.ones(count), towards, zeros, zeros)
    energy = np.full(count, 1.0 if sensors.normals is None else 2.0) / count
    asked = ask(scene, sensors, suns, np.empty((count, 0), np.int64), 1, energy=energy, plan=plan, threads=threads)
    return np.minimum(answer(asked).energy, 1.0)
