"""Light lists: many point lights or distant lights sampled as one light, with one sample per list entry.

With interleaved sampling, the entries are distributed over 16 sample sets, one for each pixel of a 4x4 block, and each
receiver tests one set only (Sec. 6.1 of the multi-frusta paper).
"""

from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, flag, number, unit_vectors
from ..base.errors import InputError
from ..base.wording import counted
from .lights import DIRECTIONAL, LIST, MAX_SPP, Light, LightPatch, check_distance, check_place

# --- The common base of light lists -----------------------------------------------------------------------------------


N_SETS = 16  # sample sets of a query, one for each pixel of a 4x4 block


@dataclass(frozen=True, eq=False, repr=False)
class LightList(Light):
    """The base class of light lists. Subclasses have the fields `intensities` and `colours`, one entry per light.

    interleave : bool
        Whether the lights are distributed over the 16 sample sets, so that each receiver samples one set only.
    """

    interleave: bool = field(default=False, kw_only=True)
    domain = "list"
    seed = 0  # not a field: pictures and queries set it by `drawn`

    if TYPE_CHECKING:  # fields of the subclasses

        @property
        def intensities(self) -> np.ndarray: ...

        @property
        def colours(self) -> np.ndarray: ...

    @property
    def points(self) -> NDArray[np.float64]:
        """(k, 3) float64: the samples (a, b, c) of all lights."""
        raise NotImplementedError

    def __repr__(self) -> str:
        suffix = ", interleave=True" if self.interleave else ""
        return f"{type(self).__name__}({counted(len(self.points), 'light')}, intensity={self.intensity:g}{suffix})"

    def samples(self, spp: int) -> int:
        k = len(self.points)
        return -(-k // N_SETS) if self.interleave else k

    def drawn(self, seed: int) -> Light:
        if not seed:
            return self
        light = copy(self)
        object.__setattr__(light, "seed", seed)
        return light

    @property
    def sets(self) -> NDArray[np.int64]:
        """(16, n) int: the light of each sample of each set. Without `interleave`, each set contains all k lights.

        A seed permutes the sets, so that over many seeds each receiver tests each light equally often.
        """
        k = len(self.points)
        if not self.interleave:
            return np.broadcast_to(np.arange(k), (N_SETS, k))
        order = np.argsort(_z_order(self.points), kind="stable")
        ranks = np.arange(N_SETS * self.samples(0)) % k
        sets = order[ranks].reshape(-1, N_SETS).T  # neighbours in space go to different sets
        return np.random.default_rng(self.seed).permutation(sets) if self.seed else sets

    def weights(self) -> NDArray[np.float64]:
        """(16, n, 3) float64: the weight of each sample of each set, its intensity in red, green and blue."""
        powers = self.intensity * self.intensities[:, None] * self.colours * np.asarray(self.colour)
        counts = np.bincount(self.sets.ravel(), minlength=len(powers))
        out: NDArray[np.float64] = (N_SETS / counts[:, None] * powers)[self.sets]
        return out

    def _check_list(self) -> None:
        name, k = type(self).__name__, len(self.points)
        flag(self.interleave, f"{name} interleave")
        limit = MAX_SPP * (N_SETS if self.interleave else 1)
        if not 1 <= k <= limit:
            cure = "drop some" if self.interleave or k < 1 or k > MAX_SPP * N_SETS else "set interleave=True"
            cure = "give at least one" if k < 1 else cure
            raise InputError(f"{name} has {counted(k, 'light')}; at most {limit} are allowed: {cure}")
        object.__setattr__(self, "intensities", rows(self.intensities, k, 1, f"{name} intensities")[:, 0])
        object.__setattr__(self, "colours", rows(self.colours, k, 3, f"{name} colours"))
        if (self.intensities < 0).any():
            raise InputError(f"{name} intensities must not be negative")
        self._check()


def without_interleave(light: Light) -> Light:
    """The light without interleaved sampling, for receivers that form no 4x4 blocks: each tests all list entries."""
    return replace(light, interleave=False) if isinstance(light, LightList) and light.interleave else light


def _z_order(positions: np.ndarray) -> NDArray[np.int64]:
    """(k,) int64: the position of each point on the Morton curve through the bounding box of all points."""
    lower, extent = positions.min(0), np.ptp(positions, axis=0).max()
    cells = ((positions - lower) * (1023.0 / extent if extent > 0.0 else 0.0)).astype(np.int64)
    bits = np.arange(10)
    spread = (cells[:, :, None] >> bits & 1) << (3 * bits + np.arange(3)[:, None])
    out: NDArray[np.int64] = spread.sum((1, 2))
    return out


def rows(value: ArrayLike, k: int | None, width: int, what: str) -> NDArray[np.float64]:
    """`value` as (k, width) float64; a single value is repeated for all lights. k None allows any number of rows."""
    values = as_array(value, what).astype(
        np.float64
    )  # a copy: later changes to the caller's array must not change the light
    array = values[..., None] if width == 1 else values
    if k is not None:
        with suppress(ValueError):  # shapes that do not fit are rejected below
            array = np.broadcast_to(array, (k, width))
    if array.ndim != 2 or array.shape[1] != width or (k is not None and len(array) != k):
        shape = "(k, 3)" if width == 3 else "(k,)"
        lights = "" if k is None else f" for {counted(k, 'light')}"
        raise InputError(f"{what} must be finite numbers of shape {shape}{lights}, not {values.shape}")
    finite = np.isfinite(array).all(1)
    if not finite.all():
        raise InputError(f"{what} hold NaN or infinity (light {np.argmin(finite)})")
    return np.ascontiguousarray(array)


# --- Point light lists ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class PointLights(LightList):
    """A list of k point lights sampled as one light, such as virtual point lights of instant radiosity [Keller 1997].

    Without `interleave`, each receiver samples all lights: sample s is light s. With it, the lights are distributed
    over the 16 sample sets so that each set covers the whole list, and a receiver samples its own set only, with 16
    times fewer rays. Shading weights a light by 16 over the number of sets that contain it, so the mean over a block of
    4x4 pixels is the sum over all lights (Sec. 6.1 of the multi-frusta paper). The estimate is unbiased; its noise is a
    pattern of 4x4 pixels.

    positions : (k, 3) float
        In world units.
    intensities : float or (k,) float
        Candela of each light, times `intensity`. With normals, this is the intensity along the normal.
    colours : (3,) or (k, 3) float
        Linear RGB of each light, times `colour`.
    normals : (3,) or (k, 3) float, or None
        Normals of lights on a surface, which emit into the normal's half-space with a cosine falloff. None: the lights
        shine in all directions.
    interleave : bool
        Whether each receiver samples one set only. The limit is 1024 lights without it, 16 x 1024 with it.
    indirect : bool
        Whether the lights represent bounced light; a picture then gets no other ambient light.
    nearest : float
        Minimum distance used in shading, in world units. Lights that represent an area are too bright for receivers
        close to them, since 1 / distance^2 has a pole. The clamp darkens corners slightly.

    Examples
    --------
    >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]], up="z")
    >>> lamps = at.PointLights([[1, 1, 3], [1, 1, 0.5], [6, 6, 3]])
    >>> at.visibility(roof, [[1, 1, 0]], lamps).seen_samples
    array([[False,  True,  True]])
    """

    positions: np.ndarray
    intensities: np.ndarray = field(default_factory=lambda: np.ones(()))
    colours: np.ndarray = field(default_factory=lambda: np.ones(3))
    normals: np.ndarray | None = None
    indirect: bool = field(default=False, kw_only=True)
    nearest: float = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
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
    def points(self) -> NDArray[np.float64]:
        return self.positions

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        u, v, w = np.eye(3)
        return LightPatch(LIST, -np.asarray(origin, np.float64), u, v, w, 0.0)


# --- Distant light lists, such as the suns of a year or the patches of a sky ------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class DirectionalLights(LightList):
    """A list of k distant lights without extent, sampled as one light.

    Without `interleave`, each receiver samples all lights: sample s is light s. With it, the lights are distributed
    over the 16 sample sets, as in `PointLights`. List lights that are close together in the sky next to each other:
    each run of 16 shares work.

    directions : (k, 3) float, any length
        From the lights *into* the scene, as in `DirectionalLight`.
    intensities : float or (k,) float
        Lux of each light, times `intensity`.
    colours : (3,) or (k, 3) float
        Linear RGB of each light, times `colour`.
    interleave : bool
        Whether each receiver samples one set only. The limit is 1024 lights without it, 16 x 1024 with it.

    Examples
    --------
    >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]], up="z")
    >>> suns = at.DirectionalLights([[0, 0, -1], [1, 0, -0.1], [-1, 0, -0.1]])
    >>> at.visibility(roof, [[1, 1, 0]], suns).seen_samples
    array([[False,  True,  True]])
    """

    directions: np.ndarray
    intensities: np.ndarray = field(default_factory=lambda: np.ones(()))
    colours: np.ndarray = field(default_factory=lambda: np.ones(3))

    def __post_init__(self) -> None:
        directions = rows(self.directions, None, 3, "DirectionalLights directions")
        object.__setattr__(self, "directions", unit_vectors(directions, "the direction of light"))
        self._check_list()

    @property
    def points(self) -> NDArray[np.float64]:
        """(k, 3) float64: unit vectors towards the lights, the samples (a, b, c)."""
        return -self.directions

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        check_distance(reach, "DirectionalLights", "make the scene smaller")
        u, v, w = reach * np.eye(3)
        return LightPatch(DIRECTIONAL, np.zeros(3), u, v, w, 0.0)
