"""Many point lights as one light, whose samples are the lights of a list."""

from dataclasses import dataclass, field

import numpy as np

from ..checks import flag, number, unit_vectors
from .light_list import LightList, rows
from .lights import LIST, LightPatch, check_place


@dataclass(frozen=True, eq=False, repr=False)
class PointLights(LightList):
    """A list of k point lights, sampled as one light, such as virtual point lights of instant radiosity [Keller 1997].

    Without `interleave`, each receiver samples all lights: sample s is light s. With it, the lights are dealt to the 16
    sample sets, so that each set is spread over all of them. A receiver samples the lights of its own set only, with 16
    times fewer rays. Shading weighs a light by 16 over the number of sets that it is in. So the mean over a block of
    4x4 pixels is the sum of all lights (Sec. 6.1 of the multi-frusta paper). The estimate is unbiased, and its noise is
    a pattern of 4x4 pixels.

    positions : (k, 3) float
        In world units.
    intensities : float or (k,) float
        Candela of each light, times `intensity`. With normals, it is the intensity along the normal.
    colours : (3,) or (k, 3) float
        Linear RGB of each light, times `colour`.
    normals : (3,) or (k, 3) float, or None
        Normals of lights on a surface. They shine into the normal's half-space, by the cosine. None: all around.
    interleave : bool
        Whether each receiver samples one set only. At most 1024 lights without it, 16 x 1024 with it.
    indirect : bool
        The lights stand for bounced light, so a picture gets no other ambient light.
    nearest : float
        Least distance in shading, in world units. Lights that stand for an area are too bright for receivers next to
        them, since 1 / distance^2 has a pole. The clamp darkens corners a little.
    """

    positions: np.ndarray
    intensities: np.ndarray = field(default_factory=lambda: np.ones(()))
    colours: np.ndarray = field(default_factory=lambda: np.ones(3))
    normals: np.ndarray | None = None
    indirect: bool = field(default=False, kw_only=True)
    nearest: float = field(default=0.0, kw_only=True)

    def __post_init__(self):
        object.__setattr__(self, "positions", rows(self.positions, None, 3, "PointLights positions"))
        if self.normals is not None:
            normals = rows(self.normals, len(self.positions), 3, "PointLights normals")
            cure = "leave normals out for lights all around"
            object.__setattr__(self, "normals", unit_vectors(normals, "the normal of light", cure))
        check_place(self.positions, "PointLights positions")
        flag(self.indirect, "PointLights indirect")
        number(self.nearest, "PointLights nearest", 0.0, np.inf, "[)")
        self._check_list()

    @property
    def points(self):
        return self.positions

    def patch(self, origin, reach):
        u, v, w = np.eye(3)
        return LightPatch(LIST, -np.asarray(origin, np.float64), u, v, w, 0.0)
