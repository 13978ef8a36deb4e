"""Lights, and the one form in which kernels know them all: a patch seen from a receiver."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..checks import vector
from ..errors import InputError

FIXED, DIRECTIONAL, SPHERE = 0, 1, 2


class LightPatch(NamedTuple):
    """A light in the recentred frame of a scene, float64; `antumbra.query.samples.patch_at` places it for a receiver.

    Seen from a receiver, every light is a flat patch: its points are base + a u + b v, with (a, b) from the light's
    `domain`. A point is a patch without extent; a distant light's patch moves along with the receiver; a sphere's
    patch is the disk in which the receiver's tangent cone touches it.
    """

    kind: int  # FIXED, DIRECTIONAL or SPHERE
    base: np.ndarray  # (3,): corner or centre; DIRECTIONAL: from the receiver to the patch's centre
    u: np.ndarray  # (3,) edge or radius
    v: np.ndarray  # (3,)
    radius: float  # of a SPHERE


@dataclass(frozen=True, eq=False)
class Light:
    """What all lights have.

    intensity : float
        Candela along the light's axis (lux for a distant light); only shading uses it.
    colour : (3,) float
        Linear RGB; only shading uses it.
    """

    intensity: float = field(default=1.0, kw_only=True)
    colour: tuple[float, float, float] = field(default=(1.0, 1.0, 1.0), kw_only=True)

    domain = "point"
    """Where (a, b) live: "square" [0, 1]^2, "disk" of radius 1, or "point" (0, 0)."""

    def patch(self, origin, reach: float) -> LightPatch:
        """The light in the frame whose zero is at world position `origin`; no distance in the scene reaches `reach`."""
        raise NotImplementedError

    def area(self) -> float:
        """Area of the emitter in square world units; 0 for points and distant lights."""
        return 0.0

    def _check(self) -> None:
        name = type(self).__name__
        if not (np.isfinite(self.intensity) and self.intensity >= 0):
            raise InputError(f"{name} intensity is {self.intensity!r}; it must be finite and not negative")
        vector(self.colour, f"{name} colour")


def _fixed(base, u=(0, 0, 0), v=(0, 0, 0), origin=(0, 0, 0)) -> LightPatch:
    return LightPatch(FIXED, base - np.asarray(origin, np.float64), np.asarray(u, float), np.asarray(v, float), 0.0)


@dataclass(frozen=True, eq=False)
class PointLight(Light):
    """A point at `position` ((3,), world)."""

    position: np.ndarray

    def __post_init__(self):
        object.__setattr__(self, "position", vector(self.position, "PointLight position"))
        self._check()

    def patch(self, origin, reach):
        return _fixed(self.position, origin=origin)


@dataclass(frozen=True, eq=False)
class QuadLight(Light):
    """A parallelogram corner + a u + b v, 0 <= a, b <= 1 (all (3,), world); seen from both sides."""

    corner: np.ndarray
    u: np.ndarray
    v: np.ndarray
    domain = "square"

    def __post_init__(self):
        for name in ("corner", "u", "v"):
            object.__setattr__(self, name, vector(getattr(self, name), f"QuadLight {name}"))
        self._check()
        if not self.area() > 0.0:
            raise InputError("QuadLight has no area (u and v are parallel or zero); use PointLight for a point")

    def area(self):
        return float(np.linalg.norm(np.cross(self.u, self.v)))

    def patch(self, origin, reach):
        return _fixed(self.corner, self.u, self.v, origin)


@dataclass(frozen=True, eq=False)
class DiskLight(Light):
    """A disk around `center` ((3,), world) with `normal` ((3,), any length) and `radius` > 0; seen from both sides."""

    center: np.ndarray
    normal: np.ndarray
    radius: float
    domain = "disk"

    def __post_init__(self):
        object.__setattr__(self, "center", vector(self.center, "DiskLight center"))
        object.__setattr__(self, "normal", _unit(self.normal, "DiskLight normal"))
        _check_radius(self)
        self._check()

    def area(self):
        return float(np.pi * self.radius**2)

    def patch(self, origin, reach):
        u, v = tangents(self.normal)
        return _fixed(self.center, u * self.radius, v * self.radius, origin)


@dataclass(frozen=True, eq=False)
class SphereLight(Light):
    """A sphere around `center` ((3,), world) with `radius` > 0.

    A receiver samples the disk in which its tangent cone touches the sphere, which covers exactly the directions in
    which the sphere is seen. From inside the sphere it is the great disk facing the receiver.
    """

    center: np.ndarray
    radius: float
    domain = "disk"

    def __post_init__(self):
        object.__setattr__(self, "center", vector(self.center, "SphereLight center"))
        _check_radius(self)
        self._check()

    def area(self):
        return float(4.0 * np.pi * self.radius**2)

    def patch(self, origin, reach):
        return _fixed(self.center, origin=origin)._replace(kind=SPHERE, radius=float(self.radius))


@dataclass(frozen=True, eq=False)
class DirectionalLight(Light):
    """A distant disk such as the sun.

    direction : (3,) float, any length
        From the light *into* the scene, as glTF has it.
    angular_diameter : float
        Degrees, 0 <= angular_diameter < 180; the sun's 0.53 by default, 0 for parallel rays.
    """

    direction: np.ndarray
    angular_diameter: float = 0.53
    domain = "disk"

    def __post_init__(self):
        object.__setattr__(self, "direction", _unit(self.direction, "DirectionalLight direction"))
        if not 0.0 <= self.angular_diameter < 180.0:
            raise InputError(
                f"DirectionalLight angular_diameter is {self.angular_diameter!r}; 0 to 180 degrees, please"
            )
        self._check()

    def patch(self, origin, reach):
        u, v = tangents(self.direction)
        radius = reach * np.tan(np.radians(self.angular_diameter) / 2.0)
        return LightPatch(DIRECTIONAL, -self.direction * reach, u * radius, v * radius, 0.0)


def tangents(n) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to the unit vector n and each other [Duff et al. 2017]."""
    s = np.copysign(1.0, n[2])
    a = -1.0 / (s + n[2])
    b = n[0] * n[1] * a
    return np.array([1.0 + s * n[0] * n[0] * a, s * b, -s * n[0]]), np.array([b, s + n[1] * n[1] * a, -n[1]])


def _unit(value, what):
    v = vector(value, what)
    length = np.linalg.norm(v)
    if not length > 0.0:
        raise InputError(f"{what} is zero; give it a direction")
    return v / length


def _check_radius(light):
    if not (np.isfinite(light.radius) and light.radius > 0.0):
        raise InputError(f"{type(light).__name__} radius is {light.radius!r}; it must be finite and positive")
