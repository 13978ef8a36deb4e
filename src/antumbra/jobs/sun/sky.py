"""The sky-view factor: the share of a uniform sky's light that arrives at a sensor."""

import numpy as np

from ...plan import Plan
from ...scene.any_scene import AnyScene
from ..sensors import Sensors
from .hours import Asked, answer, ask
from .positions import Suns
from .tally import Tally


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
    return share_of_sky(answer(asked_sky(scene, sensors, count, plan, threads)))


def asked_sky(scene: AnyScene, sensors: Sensors, count: int, plan, threads) -> Asked:
    """The directions of the sky as suns, whose energy is that of a uniform sky."""
    towards = sky_directions(count, scene.up)
    zeros, times = np.zeros(count), np.zeros(count, "datetime64[s]")
    suns = Suns(times, times, np.ones(count), towards, zeros, zeros)
    energy = np.full(count, 1.0 if sensors.normals is None else 2.0) / count
    return ask(scene, sensors, suns, np.empty((count, 0), np.int64), 1, energy=energy, plan=plan, threads=threads)


def share_of_sky(tally: Tally) -> np.ndarray:
    """(n,) float64 in [0, 1]: the sky-view factor, from the sums over the directions of `asked_sky`."""
    return np.minimum(tally.energy, 1.0)
