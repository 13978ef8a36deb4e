"""Many point lights as one light, whose samples are the lights of a list."""

from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError
from .lights import LIST, MAX_SPP, Light, LightPatch

N_SETS = 16  # sample sets of a query, one for each pixel of a 4x4 block


@dataclass(frozen=True, eq=False)
class PointLights(Light):
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
    interleave: bool = field(default=False, kw_only=True)
    indirect: bool = field(default=False, kw_only=True)
    nearest: float = field(default=0.0, kw_only=True)
    domain = "list"

    def __post_init__(self):
        positions = _rows(self.positions, None, 3, "positions")
        k = len(positions)
        most = MAX_SPP * (N_SETS if self.interleave else 1)
        if not 1 <= k <= most:
            cure = "drop some" if self.interleave or k < 1 or k > MAX_SPP * N_SETS else "set interleave=True"
            cure = "give at least one" if k < 1 else cure
            raise InputError(f"PointLights has {k} lights; a receiver asks at most {most} of them: {cure}")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "intensities", _rows(self.intensities, k, 1, "intensities")[:, 0])
        object.__setattr__(self, "colours", _rows(self.colours, k, 3, "colours"))
        if (self.intensities < 0).any():
            raise InputError("PointLights intensities must not be negative")
        if self.normals is not None:
            normals = _rows(self.normals, k, 3, "normals")
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            if not (length > 0).all():
                raise InputError("PointLights normals hold zero vectors; leave normals out for lights all around")
            object.__setattr__(self, "normals", normals / length)
        if not (np.isfinite(self.nearest) and self.nearest >= 0.0):
            raise InputError(f"PointLights nearest is {self.nearest!r}; it must be finite and not negative")
        self._check()

    def samples(self, spp):
        k = len(self.positions)
        return -(-k // N_SETS) if self.interleave else k

    def patch(self, origin, reach):
        u, v, w = np.eye(3)
        return LightPatch(LIST, -np.asarray(origin, np.float64), u, v, w, 0.0)

    @property
    def sets(self) -> np.ndarray:
        """(16, n) int: the light of each sample of each set. Without `interleave`, each set has all k lights."""
        k = len(self.positions)
        if not self.interleave:
            return np.broadcast_to(np.arange(k), (N_SETS, k))
        order = np.argsort(_z_order(self.positions), kind="stable")
        dealt = np.arange(N_SETS * self.samples(0)) % k
        return order[dealt].reshape(-1, N_SETS).T  # neighbours in space go to different sets

    def weights(self) -> np.ndarray:
        """(16, n, 3) float64: the weight of each sample of each set, in candela of red, green and blue."""
        candela = self.intensity * self.intensities[:, None] * self.colours * np.asarray(self.colour)
        times = np.bincount(self.sets.ravel(), minlength=len(candela))
        return (N_SETS / times[:, None] * candela)[self.sets]


def _z_order(positions: np.ndarray) -> np.ndarray:
    """(k,) int64: the position of each point on a space-filling curve through their bounding box."""
    lower, extent = positions.min(0), np.ptp(positions, axis=0).max()
    cells = ((positions - lower) * (1023.0 / extent if extent > 0.0 else 0.0)).astype(np.int64)
    bits = np.arange(10)
    spread = (cells[:, :, None] >> bits & 1) << (3 * bits + np.arange(3)[:, None])
    return spread.sum((1, 2))


def _rows(value, k, width, what) -> np.ndarray:
    """`value` as (k, width) float64. One value for all lights is repeated. k None allows any number of rows."""
    try:
        array = np.asarray(value, np.float64)
        if width == 1:
            array = array[..., None]
        if k is not None:
            array = np.broadcast_to(array, (k, width))
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.ndim != 2 or array.shape[1] != width or not np.isfinite(array).all():
        shape = "(k, 3)" if width == 3 else "(k,)"
        lights = "" if k is None else f" for {k} lights"
        raise InputError(f"PointLights {what} must be finite numbers of shape {shape}{lights}, not {np.shape(value)}")
    return np.ascontiguousarray(array)
