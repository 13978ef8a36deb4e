"""Point, area and distant lights, ambient occlusion, and `LightPatch`, their common form for kernels."""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import items, number, quoted, text, unit_vectors, vector, whole_number
from ..base.errors import InputError
from ..kernels.elementary import tan

FIXED, DIRECTIONAL, SPHERE, LIST, AMBIENT = 0, 1, 2, 3, 4
"""Kinds of `LightPatch`. The first three are flat (c = 0 for all samples), except lists of distant lights."""

MAX_INTENSITY = 1e30  # float32 holds it times a colour, divided by a squared distance

MAX_SPP = 1024
"""The maximum number of samples of a light per receiver."""

FLAT = np.full(3, -0.0)
"""w of flat patches: for c = 0, c w is -0.0, and x + -0.0 preserves the bits of x, even for x = -0.0."""

_NO_EXTENT = np.zeros(3)


Vector = Sequence[float] | np.ndarray
"""(3,) float."""

WHITE = 1.0, 1.0, 1.0


class LightPatch(NamedTuple):
    """A light in the recentred frame of a scene, float64; `query.light_samples.patch_at` places it for a receiver.

    From a receiver, every light is a patch of points base + a u + b v + c w, with (a, b, c) from the light's `domain`.

    - A point light is a patch without extent.
    - A distant light's patch moves with the receiver.
    - A sphere's patch is the disk bounded by the circle in which the receiver's tangent cone touches the sphere.
    - The patch of ambient light is the hemisphere around the receiver's normal.
    - A light list is a patch whose samples are the lights. The patch of a list of distant lights moves with the
      receiver, too.
    """

    kind: int  # FIXED, DIRECTIONAL, SPHERE, LIST or AMBIENT
    base: np.ndarray  # (3,) corner or centre; DIRECTIONAL: from the receiver to the patch's centre
    u: np.ndarray  # (3,) edge or radius
    v: np.ndarray  # (3,) edge or radius
    w: np.ndarray  # (3,) FLAT, except for AMBIENT and `is_list`
    radius: float  # of a SPHERE, or of an AMBIENT hemisphere


@dataclass(frozen=True, eq=False)
class Light:
    """The base class of all lights.

    intensity : float
        0 to 1e30: candela along the light's axis, or lux for a distant light. Only shading uses it. A surface receives
        lux: candela divided by the squared distance, with scene units taken as metres.
    colour : (3,) float
        Linear RGB. Only shading uses it.
    """

    intensity: float = field(default=1.0, kw_only=True)
    colour: Vector = field(default=WHITE, kw_only=True)

    name = ""
    """The name from the file or from `named`; "": none. EXR channels are named after it."""

    domain = "point"
    """The domain of (a, b, c). With c = 0: "square" [0, 1]^2, "disk" of radius 1, or "point" (0, 0). Otherwise:
    "hemisphere" above the disk, or "list" of the light's own samples."""

    def named(self, name: str) -> Self:
        """A copy of this light with a name."""
        light = copy(self)
        object.__setattr__(light, "name", text(name, "name"))
        return light

    def samples(self, spp: int) -> int:
        """The number of samples of this light per receiver, in a query with `spp`."""
        return spp

    def upright(self, up: str) -> "Light":
        """This light in a scene whose up axis is `up`. Only a `Sky` without an explicit axis changes."""
        return self

    def drawn(self, seed: int) -> "Light":
        """This light, with what it draws itself drawn for a seed. Only lists change: skies, and interleaved lists."""
        return self

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        """The light in the frame whose origin is at world position `origin`; scene distances are below `reach`."""
        raise NotImplementedError

    def area(self) -> float:
        """Area of the emitter in square world units; 0 for points and distant lights."""
        return 0.0

    def _check(self) -> None:
        name = type(self).__name__
        number(self.intensity, f"{name} intensity", 0.0, MAX_INTENSITY, "[]")
        vector(self.colour, f"{name} colour")

    def __post_init__(self) -> None:
        self._check()


def _fixed_patch(
    base: NDArray[np.float64],
    u: NDArray[np.float64] = _NO_EXTENT,
    v: NDArray[np.float64] = _NO_EXTENT,
    origin: ArrayLike = (0, 0, 0),
) -> LightPatch:
    return LightPatch(FIXED, base - np.asarray(origin, np.float64), u, v, FLAT, 0.0)


@dataclass(frozen=True, eq=False)
class PointLight(Light):
    """A point light.

    A surface at distance d receives intensity cos(theta) / d^2, where theta is the angle to its normal.

    position : (3,) float
        In world coordinates.

    Examples
    --------
    >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]], up="z")
    >>> lamp = at.PointLight((1, 1, 3), intensity=100, colour=(1, 0.9, 0.7))
    >>> at.visibility(roof, [[1, 1, 0], [3, 3, 0]], lamp).fraction
    array([0., 1.], dtype=float32)
    """

    position: np.ndarray

    if TYPE_CHECKING:  # any three numbers will do

        def __init__(self, position: Vector, *, intensity: float = 1.0, colour: Vector = WHITE) -> None: ...

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", vector(self.position, "PointLight position"))
        check_place(self.position, "PointLight position")
        self._check()

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        return _fixed_patch(self.position, origin=origin)


@dataclass(frozen=True, eq=False)
class QuadLight(Light):
    """A two-sided parallelogram light: all points corner + a u + b v with 0 <= a, b <= 1.

    Its radiance is intensity / area in all directions. Its parts below a surface's horizon do not contribute.

    corner : (3,) float
        In world coordinates.
    u, v : (3,) float
        The two edges that begin at the corner.

    Examples
    --------
    >>> window = at.QuadLight((0, 1, 3), (2, 0, 0), (0, 0, 1.5), intensity=500)
    >>> window.area()
    3.0
    """

    corner: np.ndarray
    u: np.ndarray
    v: np.ndarray
    domain = "square"

    if TYPE_CHECKING:  # any three numbers will do

        def __init__(
            self, corner: Vector, u: Vector, v: Vector, *, intensity: float = 1.0, colour: Vector = WHITE
        ) -> None: ...

    def __post_init__(self) -> None:
        for name in ("corner", "u", "v"):
            object.__setattr__(self, name, vector(getattr(self, name), f"QuadLight {name}"))
        for at in (self.corner, self.corner + self.u, self.corner + self.v, self.corner + self.u + self.v):
            check_place(at, "QuadLight corner")
        self._check()
        if not self.area() > 0.0:
            raise InputError("QuadLight has no area (u and v are parallel or zero); use PointLight for a point")

    def area(self) -> float:
        return float(np.linalg.norm(np.cross(self.u, self.v)))

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        return _fixed_patch(self.corner, self.u, self.v, origin)


@dataclass(frozen=True, eq=False)
class DiskLight(Light):
    """A two-sided disk light.

    Its radiance is intensity / area in all directions. Its parts below a surface's horizon do not contribute.

    center : (3,) float
        In world coordinates.
    normal : (3,) float
        Of any length.
    radius : float
        In world units, greater than 0.

    Examples
    --------
    >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]], up="z")
    >>> lamp = at.DiskLight((1, 1, 3), normal=(0, 0, -1), radius=0.5, intensity=100)
    >>> at.visibility(roof, [[1, 1, 0], [2.5, 2.5, 0], [4, 4, 0]], lamp, spp=64).fraction
    array([0.     , 0.53125, 1.     ], dtype=float32)
    """

    center: np.ndarray
    normal: np.ndarray
    radius: float
    domain = "disk"

    if TYPE_CHECKING:  # any three numbers will do

        def __init__(
            self,
            center: Vector,
            normal: Vector,
            radius: float,
            *,
            intensity: float = 1.0,
            colour: Vector = WHITE,
        ) -> None: ...

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", vector(self.center, "DiskLight center"))
        object.__setattr__(self, "normal", unit_vectors(vector(self.normal, "DiskLight normal"), "DiskLight normal"))
        _check_round(self)
        self._check()

    def area(self) -> float:
        return float(np.pi * self.radius**2)

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        u, v = tangents(self.normal)
        return _fixed_patch(self.center, u * self.radius, v * self.radius, origin)


@dataclass(frozen=True, eq=False)
class SphereLight(Light):
    """A light with the shape of a sphere.

    It emits `intensity` in every direction: its radiance is intensity / (pi radius^2). A surface from which the whole
    sphere is visible, with its centre at distance d, receives intensity cos(theta) / d^2, as from a point light.

    A receiver samples the disk bounded by the circle in which its tangent cone touches the sphere. This disk covers
    exactly the directions in which the sphere is visible. Inside the sphere, the receiver samples the great disk that
    faces it.

    center : (3,) float
        In world coordinates.
    radius : float
        In world units, greater than 0.

    Examples
    --------
    >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]], up="z")
    >>> lamp = at.SphereLight((1, 1, 3), radius=0.5, intensity=100)
    >>> at.visibility(roof, [[1, 1, 0], [2.5, 2.5, 0], [4, 4, 0]], lamp, spp=64).fraction
    array([0.     , 0.53125, 1.     ], dtype=float32)
    """

    center: np.ndarray
    radius: float
    domain = "disk"

    if TYPE_CHECKING:  # any three numbers will do

        def __init__(
            self, center: Vector, radius: float, *, intensity: float = 1.0, colour: Vector = WHITE
        ) -> None: ...

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", vector(self.center, "SphereLight center"))
        _check_round(self)
        self._check()

    def area(self) -> float:
        return float(4.0 * np.pi * self.radius**2)

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        return _fixed_patch(self.center, origin=origin)._replace(kind=SPHERE, radius=float(self.radius))


_FARTHEST = 2.0**125  # sums of two such coordinates, and differences of these sums, are finite in float32


@dataclass(frozen=True, eq=False)
class DirectionalLight(Light):
    """A distant disk light such as the sun.

    The disk has uniform radiance. `intensity` is the irradiance, in lux, of a surface that faces it: the radiance times
    pi sin^2(angular_diameter / 2). A surface from which the whole disk is visible receives intensity cos(theta),
    independent of the diameter; theta is the angle between its normal and the direction to the centre of the disk.

    direction : (3,) float, any length
        From the light *into* the scene, as in glTF.
    angular_diameter : float
        In degrees, 0 <= angular_diameter < 180. The default is the sun's 0.53; 0 gives parallel rays.

    Examples
    --------
    >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]], up="z")
    >>> sun = at.DirectionalLight((1, 0, -1), intensity=80_000)
    >>> at.visibility(roof, [[2, 1, 0], [0, 1, 0]], sun, spp=16).fraction
    array([0., 1.], dtype=float32)
    """

    direction: np.ndarray
    angular_diameter: float = 0.53
    domain = "disk"

    if TYPE_CHECKING:  # any three numbers will do

        def __init__(
            self,
            direction: Vector,
            angular_diameter: float = 0.53,
            *,
            intensity: float = 1.0,
            colour: Vector = WHITE,
        ) -> None: ...

    def __post_init__(self) -> None:
        what = "DirectionalLight direction"
        object.__setattr__(self, "direction", unit_vectors(vector(self.direction, what), what))
        number(self.angular_diameter, "DirectionalLight angular_diameter (degrees)", 0.0, 180.0, "[)")
        self._check()

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        u, v = tangents(self.direction)
        radius = reach * tan(np.radians(self.angular_diameter) / 2.0)
        cure = f"make the scene or angular_diameter ({self.angular_diameter!r}) smaller"
        check_distance(np.hypot(reach, radius), "DirectionalLight", cure)
        return LightPatch(DIRECTIONAL, -self.direction * reach, u * radius, v * radius, FLAT, 0.0)


@dataclass(frozen=True, eq=False)
class AmbientOcclusion(Light):
    """Ambient occlusion: each receiver samples the hemisphere around its normal, up to a distance of `radius`.

    Directions are cosine-weighted [Malley's method], so the fraction of unoccluded directions is the fraction of a
    uniform sky's irradiance that arrives. In a picture, it scales the ambient light, as do `intensity` and `colour`; it
    emits no light itself. Receivers need normals.

    radius : float or None
        In world units. Blockers farther away do not count. None or infinity: all blockers count.
    spp : int or None
        Samples per receiver, 1 to 1024. None: as many as for the query's other lights.

    Examples
    --------
    >>> temple = at.examples.temple()
    >>> places = [[0, 0, 0], [0, 0, 14], [0, 0, 30]]  # inside, in front, and far away
    >>> at.visibility(temple, places, at.AmbientOcclusion(), normals=[0, 1, 0], spp=256).fraction.round(2)
    array([0.  , 0.78, 0.98], dtype=float32)
    """

    radius: float | None = None
    spp: int | None = None
    domain = "hemisphere"

    def __post_init__(self) -> None:
        if self.radius is not None:
            number(self.radius, "AmbientOcclusion radius", 0.0, np.inf, "(]")
        if self.spp is not None:
            object.__setattr__(self, "spp", whole_number(self.spp, "AmbientOcclusion spp", 1, MAX_SPP))
        self._check()

    def samples(self, spp: int) -> int:
        return spp if self.spp is None else self.spp

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        radius = reach if self.radius is None else min(float(self.radius), reach)
        return LightPatch(AMBIENT, np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), radius)


def check_distance(distance: float, name: str, cure: str) -> None:
    """Raise InputError unless float32 holds coordinates this far away."""
    if not distance < _FARTHEST:
        raise InputError(f"{name} would be {distance:.1e} away, which float32 does not hold; {cure}")


def is_list(patch: LightPatch) -> bool:
    """Whether a patch represents a light list, near or distant."""
    return patch.kind == LIST or (patch.kind == DIRECTIONAL and bool(patch.w.any()))


def is_indirect(light: Light) -> bool:
    """Whether a light represents bounced light."""
    return bool(getattr(light, "indirect", False))


def tangents(n: NDArray[np.float64]) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors orthogonal to the unit vector n and to each other [Duff et al. 2017]."""
    s = np.copysign(1.0, n[2])
    a = -1.0 / (s + n[2])
    b = n[0] * n[1] * a
    return np.array([1.0 + s * n[0] * n[0] * a, s * b, -s * n[0]]), np.array([b, s + n[1] * n[1] * a, -n[1]])


def check_place(at: np.ndarray, what: str) -> None:
    """Raise InputError unless float32 can represent world positions ((..., 3) float64), and sums with them."""
    in_range = np.abs(at) < _FARTHEST
    if not in_range.all():
        first = at.reshape(-1, 3)[np.argmin(in_range.all(-1).reshape(-1))]
        problem = (
            "has NaN or infinity" if not np.isfinite(first).all() else f"is beyond {_FARTHEST:.1e}; move it nearer"
        )
        raise InputError(f"{what} {quoted(first.tolist())} {problem}")


def _check_round(light: "DiskLight | SphereLight") -> None:
    name = type(light).__name__
    number(light.radius, f"{name} radius", 0.0, _FARTHEST)
    for at in (light.center, light.center - light.radius, light.center + light.radius):
        check_place(at, f"{name} center, or a point at its radius:")


_KINDS = {
    "PointLight": "point",
    "QuadLight": "quad",
    "DiskLight": "disk",
    "SphereLight": "sphere",
    "DirectionalLight": "sun",
    "PointLights": "points",
    "DirectionalLights": "suns",
    "AmbientOcclusion": "ambient",
}


def light_names(lights: Sequence[Light]) -> list[str]:
    """A unique name for each light: its own or its kind ("sun"), numbered where names repeat ("sun2").

    The names are valid in EXR channel names: dots, which would separate layers, become underscores.
    """
    names: list[str] = []
    for light in lights:
        stem = light.name or _KINDS.get(type(light).__name__, type(light).__name__)
        stem = "".join(c if c.isalnum() or c in "-_" else "_" for c in stem)[:40] or "light"
        suffixes = ["", *(str(k) for k in range(2, len(lights) + 2))]
        names.append(next(stem + k for k in suffixes if stem + k not in names))
    return names


def check_lights(lights: Light | Iterable[Light], up: str) -> list[Light]:
    """The lights of a scene as a list. Raises InputError on anything else, and on the bare base class.

    up : the scene's up axis, for lights that follow it, such as a `Sky`
    """
    lights = items(lights, Light, "a light", "give an antumbra.PointLight, QuadLight, ... or a list of them")
    if not lights:
        raise InputError("no lights; give at least one, for example scene.default_light()")
    if Light in map(type, lights):
        raise InputError("antumbra.Light is the base class of lights; give a PointLight, a QuadLight, ...")
    return [light.upright(up) for light in lights]
