"""Lights, and their common form for kernels: a patch seen from a receiver."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from ..checks import items, number, quoted, text, unit_vectors, vector, whole_number
from ..errors import InputError

FIXED, DIRECTIONAL, SPHERE, LIST, AMBIENT = 0, 1, 2, 3, 4
"""Kinds of `LightPatch`. The first three are flat, but for lists of distant lights: samples' heights c are 0."""

MAX_INTENSITY = 1e30  # float32 holds it times a colour, over the square of a distance

MAX_SPP = 1024
"""The most samples of a light for one receiver."""

FLAT = np.full(3, -0.0)
"""w of flat patches: for c = 0, c w is -0.0, and x + -0.0 has the bits of x, even for x = -0.0."""

_NO_EXTENT = np.zeros(3)


Vector = Sequence[float] | np.ndarray
"""(3,) float."""

WHITE = 1.0, 1.0, 1.0


class LightPatch(NamedTuple):
    """A light in the recentred frame of a scene, float64; `query.light_samples.patch_at` places it for a receiver.

    Seen from a receiver, every light is a patch with the points base + a u + b v + c w. (a, b, c) is from the light's
    `domain`.

    - A point light is a patch without extent.
    - A distant light's patch moves along with the receiver.
    - A sphere's patch is the disk in which the receiver's tangent cone touches the sphere.
    - Ambient light's patch is the hemisphere around the receiver's normal.
    - A list of lights is a patch whose samples are the lights. A list of distant lights moves along, too.
    """

    kind: int  # FIXED, DIRECTIONAL, SPHERE, LIST or AMBIENT
    base: np.ndarray  # (3,) corner or centre; DIRECTIONAL: from the receiver to the patch's centre
    u: np.ndarray  # (3,) edge or radius
    v: np.ndarray  # (3,) edge or radius
    w: np.ndarray  # (3,) FLAT, unless the kind is AMBIENT or `is_list`
    radius: float  # of a SPHERE, or of an AMBIENT hemisphere


@dataclass(frozen=True, eq=False)
class Light:
    """The base class of all lights.

    intensity : float
        0 to 1e30: candela along the light's axis, or lux for a distant light. Only shading uses it. A surface gets
        lux: candela over the square of a distance, with the scene's unit taken as metres.
    colour : (3,) float
        Linear RGB. Only shading uses it.
    """

    intensity: float = field(default=1.0, kw_only=True)
    colour: Vector = field(default=WHITE, kw_only=True)

    name = ""
    """The name in a file, or that `named` gave; empty: none. Channels of EXR files have it."""

    domain = "point"
    """The domain of (a, b, c). With c = 0: "square" [0, 1]^2, "disk" of radius 1, or "point" (0, 0). Else: "hemisphere"
    above the disk, or "list" of the light's own samples."""

    def named(self, name: str) -> Self:
        """A copy of this light with a name."""
        made = copy(self)
        object.__setattr__(made, "name", text(name, "name"))
        return made

    def samples(self, spp: int) -> int:
        """The samples of this light for each receiver of a query with `spp`."""
        return spp

    def upright(self, up: str) -> "Light":
        """This light in a scene whose axis `up` points up. Only a `Sky` without an axis of its own changes."""
        return self

    def patch(self, origin, reach: float) -> LightPatch:
        """The light in the frame whose zero is at world position `origin`; scene distances are below `reach`."""
        raise NotImplementedError

    def area(self) -> float:
        """Area of the emitter in square world units; 0 for points and distant lights."""
        return 0.0

    def _check(self) -> None:
        name = type(self).__name__
        number(self.intensity, f"{name} intensity", 0.0, MAX_INTENSITY, "[]")
        vector(self.colour, f"{name} colour")

    def __post_init__(self):
        self._check()


def _fixed(base, u=_NO_EXTENT, v=_NO_EXTENT, origin=(0, 0, 0)) -> LightPatch:
    return LightPatch(FIXED, base - np.asarray(origin, np.float64), u, v, FLAT, 0.0)


@dataclass(frozen=True, eq=False)
class PointLight(Light):
    """A point at `position` ((3,), world).

    At a distance d a surface gets intensity cos(theta) / d^2, theta being the angle to its normal.
    """

    position: np.ndarray

    if TYPE_CHECKING:  # any three numbers will do

        def __init__(self, position: Vector, *, intensity: float = 1.0, colour: Vector = WHITE) -> None: ...

    def __post_init__(self):
        object.__setattr__(self, "position", vector(self.position, "PointLight position"))
        check_place(self.position, "PointLight position")
        self._check()

    def patch(self, origin, reach):
        return _fixed(self.position, origin=origin)


@dataclass(frozen=True, eq=False)
class QuadLight(Light):
    """A parallelogram corner + a u + b v, 0 <= a, b <= 1 (all (3,), world). It shines to both sides.

    Its radiance is intensity / area, the same in all directions. What lies below a surface's horizon does not count.
    """

    corner: np.ndarray
    u: np.ndarray
    v: np.ndarray
    domain = "square"

    if TYPE_CHECKING:  # any three numbers will do

        def __init__(
            self, corner: Vector, u: Vector, v: Vector, *, intensity: float = 1.0, colour: Vector = WHITE
        ) -> None: ...

    def __post_init__(self):
        for name in ("corner", "u", "v"):
            object.__setattr__(self, name, vector(getattr(self, name), f"QuadLight {name}"))
        for at in (self.corner, self.corner + self.u, self.corner + self.v, self.corner + self.u + self.v):
            check_place(at, "QuadLight corner")
        self._check()
        if not self.area() > 0.0:
            raise InputError("QuadLight has no area (u and v are parallel or zero); use PointLight for a point")

    def area(self):
        return float(np.linalg.norm(np.cross(self.u, self.v)))

    def patch(self, origin, reach):
        return _fixed(self.corner, self.u, self.v, origin)


@dataclass(frozen=True, eq=False)
class DiskLight(Light):
    """A disk around `center` ((3,), world) with `normal` ((3,), any length) and `radius` > 0; shines to both sides.

    Its radiance is intensity / area, the same in all directions. What lies below a surface's horizon does not count.
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

    def __post_init__(self):
        object.__setattr__(self, "center", vector(self.center, "DiskLight center"))
        object.__setattr__(self, "normal", unit_vectors(vector(self.normal, "DiskLight normal"), "DiskLight normal"))
        _check_round(self)
        self._check()

    def area(self):
        return float(np.pi * self.radius**2)

    def patch(self, origin, reach):
        u, v = tangents(self.normal)
        return _fixed(self.center, u * self.radius, v * self.radius, origin)


@dataclass(frozen=True, eq=False)
class SphereLight(Light):
    """A sphere around `center` ((3,), world) with `radius` > 0.

    It shines with `intensity` in every direction: its radiance is intensity / (pi radius^2). A surface that sees all of
    it, with its centre at a distance d, gets intensity cos(theta) / d^2, as from a point.

    A receiver samples the disk in which its tangent cone touches the sphere. The disk covers exactly the directions
    in which the receiver sees the sphere. For a receiver inside the sphere, it is the great disk facing the receiver.
    """

    center: np.ndarray
    radius: float
    domain = "disk"

    if TYPE_CHECKING:  # any three numbers will do

        def __init__(
            self, center: Vector, radius: float, *, intensity: float = 1.0, colour: Vector = WHITE
        ) -> None: ...

    def __post_init__(self):
        object.__setattr__(self, "center", vector(self.center, "SphereLight center"))
        _check_round(self)
        self._check()

    def area(self):
        return float(4.0 * np.pi * self.radius**2)

    def patch(self, origin, reach):
        return _fixed(self.center, origin=origin)._replace(kind=SPHERE, radius=float(self.radius))


_FARTHEST = 2.0**125  # as for coordinates: sums of two, and differences of such sums, are finite


@dataclass(frozen=True, eq=False)
class DirectionalLight(Light):
    """A distant disk such as the sun.

    The disk has the same radiance everywhere. `intensity` is the irradiance, in lux, of a surface that faces it: the
    radiance times pi sin^2(angular_diameter / 2). A surface that sees all of it gets intensity cos(theta), whatever the
    diameter is; theta is the angle between its normal and the middle of the disk.

    direction : (3,) float, any length
        From the light *into* the scene, as in glTF.
    angular_diameter : float
        Degrees, 0 <= angular_diameter < 180. The default is the sun's 0.53; 0 gives parallel rays.
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

    def __post_init__(self):
        what = "DirectionalLight direction"
        object.__setattr__(self, "direction", unit_vectors(vector(self.direction, what), what))
        number(self.angular_diameter, "DirectionalLight angular_diameter (degrees)", 0.0, 180.0, "[)")
        self._check()

    def patch(self, origin, reach):
        u, v = tangents(self.direction)
        radius = reach * np.tan(np.radians(self.angular_diameter) / 2.0)
        cure = f"make the scene or angular_diameter ({self.angular_diameter!r}) smaller"
        check_distance(np.hypot(reach, radius), "DirectionalLight", cure)
        return LightPatch(DIRECTIONAL, -self.direction * reach, u * radius, v * radius, FLAT, 0.0)


@dataclass(frozen=True, eq=False)
class AmbientOcclusion(Light):
    """Light from everywhere: each receiver samples the hemisphere around its normal, to a distance of `radius`.

    Directions are cosine-weighted [Malley's method]. So the fraction of open directions is the fraction of a uniform
    sky's irradiance that arrives. In a picture it scales the ambient light, as do `intensity` and `colour`. It does not
    shine by itself. Points without normals cannot sample it.

    radius : float or None
        World units. Blockers farther away do not count. None or infinity: all blockers count.
    spp : int or None
        Samples for each receiver, 1 to 1024. None: as many as for the query's other lights.
    """

    radius: float | None = None
    spp: int | None = None
    domain = "hemisphere"

    def __post_init__(self):
        if self.radius is not None:
            number(self.radius, "AmbientOcclusion radius", 0.0, np.inf, "(]")
        if self.spp is not None:
            object.__setattr__(self, "spp", whole_number(self.spp, "AmbientOcclusion spp", 1, MAX_SPP))
        self._check()

    def samples(self, spp):
        return spp if self.spp is None else self.spp

    def patch(self, origin, reach):
        radius = reach if self.radius is None else min(float(self.radius), reach)
        return LightPatch(AMBIENT, np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), radius)


def check_distance(distance: float, name: str, cure: str) -> None:
    """Raise InputError unless float32 holds coordinates this far away."""
    if not distance < _FARTHEST:
        raise InputError(f"{name} would be {distance:.1e} away, which float32 does not hold; {cure}")


def is_list(patch: LightPatch) -> bool:
    """Are the samples of a patch the lights of a list, near or distant?"""
    return patch.kind == LIST or (patch.kind == DIRECTIONAL and bool(patch.w.any()))


def is_bounced(light: Light) -> bool:
    """Whether a light stands for light that surfaces reflect."""
    return bool(getattr(light, "indirect", False))


def tangents(n) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to the unit vector n and each other [Duff et al. 2017]."""
    s = np.copysign(1.0, n[2])
    a = -1.0 / (s + n[2])
    b = n[0] * n[1] * a
    return np.array([1.0 + s * n[0] * n[0] * a, s * b, -s * n[0]]), np.array([b, s + n[1] * n[1] * a, -n[1]])


def check_place(at: np.ndarray, what: str) -> None:
    """Raise InputError unless float32 holds a world position ((..., 3) float64), and all sums with it."""
    near = np.abs(at) < _FARTHEST
    if not near.all():
        first = at.reshape(-1, 3)[np.argmin(near.all(-1).reshape(-1))]
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
    "PointLight": "point", "QuadLight": "quad", "DiskLight": "disk", "SphereLight": "sphere", "DirectionalLight": "sun",
    "PointLights": "points", "DirectionalLights": "suns", "AmbientOcclusion": "ambient",
}  # fmt: skip


def light_names(lights: Sequence[Light]) -> list[str]:
    """A name for each light, all different: its own, or its kind ("sun"), and a number where names repeat ("sun2").

    They can stand in the names of an EXR's channels: dots, which would make layers, become underscores.
    """
    found: list[str] = []
    for light in lights:
        wanted = light.name or _KINDS.get(type(light).__name__, type(light).__name__)
        wanted = "".join(c if c.isalnum() or c in "-_" else "_" for c in wanted)[:40] or "light"
        numbers = ["", *(str(k) for k in range(2, len(lights) + 2))]
        found.append(next(wanted + k for k in numbers if wanted + k not in found))
    return found


def check_lights(lights, up: str) -> list[Light]:
    """The lights of a scene as a list. Raises InputError on anything that is no light, such as the bare base class.

    up : the scene's axis that points up, for lights such as a `Sky` that follow it
    """
    lights = items(lights, Light, "a light", "give an antumbra.PointLight, QuadLight, ... or a list of them")
    if not lights:
        raise InputError("no lights; give at least one, for example scene.default_light()")
    if any(type(light) is Light for light in lights):
        raise InputError("antumbra.Light is the base class of lights; give a PointLight, a QuadLight, ...")
    return [light.upright(up) for light in lights]
