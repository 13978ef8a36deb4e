"""Many distant lights as one light: the suns of a year, or the patches of a sky."""

from dataclasses import dataclass, field

import numpy as np

from ..checks import unit_vectors
from .light_list import LightList, rows
from .lights import DIRECTIONAL, LightPatch, check_distance


@dataclass(frozen=True, eq=False, repr=False)
class DirectionalLights(LightList):
    """A list of k distant lights without extent, sampled as one light.

    Without `interleave`, each receiver samples all lights: sample s is light s. With it, the lights are dealt to the 16
    sample sets, as in `PointLights`. Neighbours in the list should be neighbours in the sky: 16 in a row share work.

    directions : (k, 3) float, any length
        From the lights *into* the scene, as in `DirectionalLight`.
    intensities : float or (k,) float
        Lux of each light, times `intensity`.
    colours : (3,) or (k, 3) float
        Linear RGB of each light, times `colour`.
    interleave : bool
        Whether each receiver samples one set only. At most 1024 lights without it, 16 x 1024 with it.
    """

    directions: np.ndarray
    intensities: np.ndarray = field(default_factory=lambda: np.ones(()))
    colours: np.ndarray = field(default_factory=lambda: np.ones(3))

    def __post_init__(self):
        directions = rows(self.directions, None, 3, "DirectionalLights directions")
        object.__setattr__(self, "directions", unit_vectors(directions, "the direction of light"))
        self._check_list()

    @property
    def points(self) -> np.ndarray:
        """(k, 3) float64: unit vectors towards the lights, the samples (a, b, c)."""
        return -self.directions

    def patch(self, origin, reach):
        check_distance(reach, "DirectionalLights", "make the scene smaller")
        u, v, w = reach * np.eye(3)
        return LightPatch(DIRECTIONAL, np.zeros(3), u, v, w, 0.0)
