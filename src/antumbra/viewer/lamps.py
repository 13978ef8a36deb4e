"""Lights that a user moves, turns and switches off."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..jobs.dataset.dataset_layers import has_centre, towards_centre
from ..jobs.sun.sun_positions import directions_of
from ..scene.camera import axes
from ..scene.lights import DirectionalLight, DiskLight, Light, PointLight, QuadLight, SphereLight, tangents
from .stage import RADIUS, Stage

FAR = RADIUS
"""Distance of the handles of suns from the middle of the page."""

_ROUND = np.linspace(0.0, 2.0 * np.pi, 33)


class Lamp(NamedTuple):
    """A light of the page."""

    name: str
    light: Light
    on: bool = True


def handle(light: Light, stage: Stage) -> np.ndarray | None:
    """(3,) float64, page: the place of the light's handle; None: it has none, as light from everywhere."""
    if not has_centre(light):
        return None
    (direction,), end = towards_centre(light, stage.centre[None])
    return FAR * direction if np.isinf(end) else stage.to_page(stage.centre + direction)


def moved(light: Light, stage: Stage, to: np.ndarray) -> Light:
    """The light with its handle at a place ((3,), page). A sun then shines from there to the middle of the page."""
    if isinstance(light, DirectionalLight):
        return replace(light, direction=-np.asarray(to, np.float64)).named(light.name) if np.any(to) else light
    world = stage.to_world(to)
    if isinstance(light, QuadLight):
        return replace(light, corner=world - (light.u + light.v) / 2.0).named(light.name)
    if isinstance(light, PointLight):
        return replace(light, position=world).named(light.name)
    if isinstance(light, DiskLight | SphereLight):
        return replace(light, center=world).named(light.name)
    return light


def outline(light: Light, stage: Stage) -> np.ndarray:
    """(k, 2, 3) float64, page: lines that show the extent of a light; none for a point."""
    if isinstance(light, QuadLight):
        a, b = light.corner + light.u, light.corner + light.v
        ring = np.stack([light.corner, a, a + light.v, b, light.corner])
        return _lines(stage.to_page(ring))
    if isinstance(light, DiskLight):
        return _lines(stage.to_page(_ring(light.center, light.radius, light.normal)))
    if isinstance(light, SphereLight):
        rings = [_lines(stage.to_page(_ring(light.center, light.radius, axis))) for axis in np.eye(3)]
        return np.concatenate(rings)
    if isinstance(light, DirectionalLight):
        return np.stack([-FAR * light.direction, -0.8 * FAR * light.direction])[None]
    return np.empty((0, 2, 3))


def sun_angles(light: DirectionalLight, up: str) -> tuple[float, float]:
    """(bearing clockwise from the scene's north axis, 0 to 360; elevation), degrees, of the place of a sun.

    The north axis is +Y if +Z is up, and -Z if +Y is up; east is +X.
    """
    east, height, south = axes(up) @ -light.direction
    return float(np.degrees(np.arctan2(east, -south)) % 360.0), float(np.degrees(np.arcsin(np.clip(height, -1.0, 1.0))))


def sun_at(light: DirectionalLight, bearing: float, elevation: float, up: str) -> Light:
    """The sun moved to a bearing and an elevation, in degrees; the inverse of `sun_angles`."""
    (towards,) = directions_of([elevation], [bearing], up)
    return replace(light, direction=-towards).named(light.name)


def _ring(centre: np.ndarray, radius: float, normal: np.ndarray) -> np.ndarray:
    u, v = tangents(np.asarray(normal, np.float64))
    return centre + radius * (np.cos(_ROUND)[:, None] * u + np.sin(_ROUND)[:, None] * v)


def _lines(points: np.ndarray) -> np.ndarray:
    """(k - 1, 2, 3): the lines between k points in a row."""
    return np.stack([points[:-1], points[1:]], 1)
