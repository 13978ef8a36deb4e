"""The default camera and light for a scene without its own."""

import numpy as np

from .camera import Camera
from .lights import QuadLight

VFOV = 45.0
_MARGIN = 1.08  # around the points that a fitted camera shows
_FLAT = 0.2  # height of a box, as a share of its width, below which it is flat
STEEP = np.radians(50.0)  # elevation of the camera for flat boxes
AZIMUTH, ELEVATION = np.radians(35.0), np.radians(25.0)


def axes(up: str) -> np.ndarray:
    """The right, up and towards-the-viewer axes ((3, 3) float64 rows) of a scene with up axis "y" or "z"."""
    if up == "z":
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return np.eye(3)


def default_camera(bounds: np.ndarray, up: str, width: int, height: int, turn: float = 0.0) -> Camera:
    """A three-quarter view from a little above, which shows the bounding sphere of `bounds` ((2, 3), world).

    turn : radians around the up axis, counter-clockwise seen from above
    """
    right, upward, towards = axes(up)
    centre, radius = bounding_sphere(bounds)
    half = np.arctan(np.tan(np.radians(VFOV) / 2.0) * min(1.0, width / height))
    distance = 1.02 * radius / np.sin(half)
    flat = np.sin(AZIMUTH + turn) * right + np.cos(AZIMUTH + turn) * towards
    position = centre + distance * (np.cos(ELEVATION) * flat + np.sin(ELEVATION) * upward)
    return Camera(position, centre, upward, VFOV, width, height)


def fitted_camera(points: np.ndarray, up: str, width: int, height: int) -> Camera:
    """The default camera's direction of view, as near as it shows all `points` ((n, 3), world), with a small margin.

    Points in a flat box are seen from higher up.
    """
    sideways, above, back = _frame(points, up)
    middle = (points.min(0) + points.max(0)) / 2.0
    x, y, z = ((points - middle) @ np.stack([sideways, above, back], 1)).T
    tangent = np.tan(np.radians(VFOV) / 2.0) / _MARGIN
    distance = 1e-6 * max(float(np.abs(middle).max()), 1.0)
    for across, slope in ((x, tangent * width / height), (y, tangent)):
        distance = max(distance, ((across + slope * z).max() + (slope * z - across).max()) / (2.0 * slope))
    target = middle + _centre(x, distance - z) * sideways + _centre(y, distance - z) * above
    return Camera(target + distance * back, target, axes(up)[1], VFOV, width, height)


def orthographic_camera(
    points: np.ndarray, up: str, width: int, height: int, from_above: bool = False, gap: float = 1.0
) -> Camera:
    """An orthographic camera that shows all `points` ((n, 3), world), with a small margin.

    It looks as `fitted_camera` does, or straight down: then -z is up in the picture, or +y if z points up. Its rays
    begin before the nearest point, by `gap` times the height of the picture.
    """
    right, upward, towards = axes(up)
    sideways, above, back = (right, -towards, upward) if from_above else _frame(points, up)
    middle = (points.min(0) + points.max(0)) / 2.0
    x, y, z = ((points - middle) @ np.stack([sideways, above, back], 1)).T
    extent = _MARGIN * max(np.ptp(y), np.ptp(x) * height / width, 1e-6 * max(float(np.abs(middle).max()), 1.0))
    target = middle + (x.min() + x.max()) / 2.0 * sideways + (y.min() + y.max()) / 2.0 * above
    position = target + (z.max() + gap * extent) * back
    return Camera(position, target, above, width=width, height=height, projection="orthographic", extent=extent)


def _frame(points: np.ndarray, up: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The unit vectors to the right, upwards and back of a fitted camera."""
    right, upward, towards = axes(up)
    level = np.sin(AZIMUTH) * right + np.cos(AZIMUTH) * towards
    size = np.ptp(points, axis=0)
    elevation = STEEP if size @ upward < _FLAT * size.max() else ELEVATION
    back = np.cos(elevation) * level + np.sin(elevation) * upward
    sideways = np.cross(upward, back) / np.linalg.norm(np.cross(upward, back))
    return sideways, np.cross(back, sideways), back


def _centre(across: np.ndarray, depth: np.ndarray) -> float:
    """Where a camera sees points as far to one side as to the other; `depth`: their distances along the view."""
    low, high = float(across.min()), float(across.max())
    for _ in range(40):
        middle = (low + high) / 2.0
        seen = (across - middle) / depth
        low, high = (middle, high) if seen.max() > -seen.min() else (low, middle)
    return (low + high) / 2.0


def default_light(bounds: np.ndarray, up: str) -> QuadLight:
    """A square light above the bounding sphere of `bounds`, to the viewer's left, as wide as the sphere's radius.

    Under its intensity, a white surface at the centre that faces the light looks white.
    """
    right, upward, towards = axes(up)
    centre, radius = bounding_sphere(bounds)
    middle = centre + radius * (1.6 * upward - 0.6 * right + 0.4 * towards)
    u, v = radius * right, radius * towards  # u x v points down
    distance = np.linalg.norm(middle - centre)
    return QuadLight(corner=middle - (u + v) / 2.0, u=u, v=v, intensity=float(np.pi * distance**2))


def bounding_sphere(bounds) -> tuple[np.ndarray, float]:
    """(centre, radius) of the sphere around `bounds` ((2, 3), world); a radius of zero becomes 1."""
    lower, upper = bounds
    radius = float(np.linalg.norm(upper - lower)) / 2.0
    return lower + (upper - lower) / 2.0, radius if radius > 0.0 else 1.0
