"""Cameras: perspective, orthographic and panoramic, the rays through their pixels, and the camera that frames a scene.

`CameraRays` are computed in kernels; `ExplicitRays` list the rays of orthographic and panoramic cameras. The framing
functions give the default camera and light of a scene without its own.
"""

from typing import NamedTuple

import numpy as np

from ..checks import choice, number, vector, whole_number
from ..errors import InputError
from .lights import QuadLight
from .scene_bounds import flush_to_zero

# --- The rays of orthographic and panoramic cameras, listed one by one ------------------------------------------------


class ExplicitRays(NamedTuple):
    """The rays of an orthographic or panoramic camera, in the recentred frame of a scene.

    Each ray is computed in float64 and rounded once to float32, so every method traces the same rays. Directions have
    unit length, so t is a distance.
    """

    origin: np.ndarray  # (3,) float64, recentred
    axes: np.ndarray  # (3, 3) float64: unit vectors to the right and down in the picture, and towards its middle
    width: int  # pixels
    height: int
    extent: float | None  # height of an orthographic picture in world units; None: panoramic

    def through(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions, (..., 3) float32 each, of the rays through places of the picture.

        x, y : (...) float64, pixels right and down from the upper left corner; they broadcast
        """
        if self.extent is None:
            directions = self._around(x, y)
            return _everywhere(self.origin, directions.shape), directions
        x, y = np.broadcast_arrays(x, y)
        pixel = self.extent / self.height
        across, below = (x - self.width / 2.0) * pixel, (y - self.height / 2.0) * pixel
        origins = self.origin + across[..., None] * self.axes[0] + below[..., None] * self.axes[1]
        return origins.astype(np.float32), _everywhere(self.axes[2], origins.shape)

    def directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(..., 3) float32: the directions alone; see `through`."""
        return self.through(x, y)[1]

    def places(self, away: np.ndarray) -> np.ndarray:
        """(k, 2) float64: where rays through points cross the picture, the inverse of `through`; NaN behind the camera.

        away : (k, 3) float64, points minus `origin`
        """
        across, below, ahead = (away @ self.axes.T).T
        if self.extent is None:
            turn, sink = np.arctan2(across, ahead), np.arctan2(below, np.hypot(across, ahead))
            return np.stack([turn / (2.0 * np.pi) + 0.5, sink / np.pi + 0.5], 1) * (self.width, self.height)
        flat = np.stack([across, below], 1) * (self.height / self.extent) + (self.width / 2.0, self.height / 2.0)
        flat[ahead <= 0.0] = np.nan
        return flat

    def _around(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Directions of a panorama."""
        turn = (np.asarray(x, np.float64) / self.width - 0.5) * (2.0 * np.pi)
        sink = (np.asarray(y, np.float64) / self.height - 0.5) * np.pi
        flat = np.sin(turn)[..., None] * self.axes[0] + np.cos(turn)[..., None] * self.axes[2]
        return (np.cos(sink)[..., None] * flat + np.sin(sink)[..., None] * self.axes[1]).astype(np.float32)


def _everywhere(vector: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return np.broadcast_to(vector.astype(np.float32), shape)


# --- Cameras, and the rays through their pixels -----------------------------------------------------------------------


MAX_SIZE = 32768  # pixels, each way
PROJECTIONS = "perspective", "orthographic", "panoramic"
_FARTHEST = 1e30  # float32 holds all differences of coordinates below this


class CameraRays(NamedTuple):
    """A perspective camera's rays for kernels, in the recentred frame of a scene.

    The ray of pixel (x, y), x right and y down, starts at ``origin``. Its direction is
    ``float32(corner + (x + 0.5) * dx + (y + 0.5) * dy)``, evaluated in float64 in that order, component by component.
    The direction's component along the view axis is 1, so t is the depth.
    """

    origin: np.ndarray  # (3,) float32, recentred
    corner: np.ndarray  # (3,) float64, direction to the image's upper left corner
    dx: np.ndarray  # (3,) float64, one pixel to the right
    dy: np.ndarray  # (3,) float64, one pixel down
    width: int  # pixels
    height: int

    def directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(..., 3) float32: about the directions through places of the picture, (...) float32 pixels right and down."""
        corner, dx, dy = (part.astype(np.float32) for part in (self.corner, self.dx, self.dy))
        return corner + x[..., None] * dx + y[..., None] * dy


class Camera:
    """A camera in world space, right-handed. It looks from ``position`` to ``target``.

    Parameters
    ----------
    position, target, up : (3,) float, world space
    vfov : float
        Vertical field of view in degrees, 0 < vfov < 180, of a perspective camera.
    width, height : int
        Picture size in pixels, 1 to 32768.
    projection : "perspective", "orthographic" or "panoramic"
        Orthographic: all rays are parallel, and start in the plane through `position`. Panoramic: rays into all
        directions from `position`, as an equirectangular map. The heading of `target` is in its middle, and `up` is the
        zenith, so the horizon is level. Its picture is twice as wide as high, or stretched.
    extent : float or None
        Height of an orthographic picture in world units; None for other projections.

    Raises
    ------
    InputError
        On non-finite or huge numbers, a target at the position, ``up`` along the view, or sizes out of range. If the
        projection is unknown, or has no extent or needs none.
    """

    def __init__(
        self, position, target, up=(0.0, 1.0, 0.0), vfov=60.0, width=1024, height=1024, *, projection="perspective",
        extent=None,
    ):  # fmt: skip
        self.position = vector(position, "camera position")
        self.target = vector(target, "camera target")
        self.up = vector(up, "camera up")
        self.vfov = number(vfov, "camera vfov (degrees)", 0.0, 180.0)
        self.width = whole_number(width, "picture width", 1, MAX_SIZE)
        self.height = whole_number(height, "picture height", 1, MAX_SIZE)
        for name in ("position", "target", "up"):
            if np.abs(getattr(self, name)).max() > _FARTHEST:
                raise InputError(f"camera {name} is {getattr(self, name)}; nothing may be beyond {_FARTHEST:g}")
        view = self.target - self.position
        if not np.linalg.norm(view) > 0.0:
            raise InputError("camera target is at the camera position; move one of them")
        right = np.cross(view, self.up)
        if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(view) * np.linalg.norm(self.up):
            raise InputError("camera up is along the view direction (or zero); choose another up")
        choice(projection, "camera projection", PROJECTIONS)
        if (projection == "orthographic") != (extent is not None):
            raise InputError("camera extent is the height of an orthographic picture; give both or neither")
        self.projection: str = projection
        self.extent = None if extent is None else number(extent, "camera extent", 0.0, _FARTHEST)

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera with another picture size."""
        return Camera(
            self.position, self.target, self.up, self.vfov, width, height, projection=self.projection,
            extent=self.extent,
        )  # fmt: skip

    def panoramic(self) -> "Camera":
        """A panoramic camera at the same place, whose middle is the heading of this camera."""
        place = self.position
        return Camera(
            place, place + self.axes[2], self.up, width=self.width, height=self.height, projection="panoramic"
        )

    @property
    def listed(self) -> bool:
        """Whether the camera is not perspective: its rays are listed one by one, and found by tracing alone."""
        return self.projection != "perspective"

    @property
    def axes(self) -> np.ndarray:
        """(3, 3) float64: unit vectors to the right and down in the picture, and along the view, in rows."""
        view = self.target - self.position
        view = view / np.linalg.norm(view)
        right = np.cross(view, self.up)
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(view, right), view])

    @property
    def frame(self) -> np.ndarray:
        """As `axes`; of a panorama, whose horizon is level, down is away from the zenith."""
        if self.projection != "panoramic":
            return self.axes
        right, zenith = self.axes[0], self.up / np.linalg.norm(self.up)
        return np.stack([right, -zenith, np.cross(zenith, right)])

    def view(self, origin) -> "CameraRays | ExplicitRays":
        """The pixels' rays in the frame whose zero is at world position ``origin`` ((3,) float64)."""
        if not self.listed:
            return self.rays(origin)
        position = flush_to_zero(self.position - np.asarray(origin, np.float64))
        return ExplicitRays(position, self.frame, self.width, self.height, self.extent)

    def rays(self, origin) -> CameraRays:
        """As `view`, of a perspective camera. Raises InputError for other projections."""
        if self.listed:
            raise InputError(f"this needs a perspective camera, and the camera is {self.projection}; give another one")
        right, down, view = self.axes
        half = np.tan(np.radians(self.vfov) / 2.0)
        dx = right * (2.0 * half / self.height)
        dy = down * (2.0 * half / self.height)
        corner = view - dx * (self.width / 2.0) - dy * (self.height / 2.0)
        position = flush_to_zero(self.position - np.asarray(origin, np.float64)).astype(np.float32)
        return CameraRays(position, corner, dx, dy, self.width, self.height)

    def __repr__(self) -> str:
        p, t, u = (", ".join(f"{c:g}" for c in v) for v in (self.position, self.target, self.up))
        more = f", projection={self.projection!r}" if self.listed else ""
        more += "" if self.extent is None else f", extent={self.extent:g}"
        return (
            f"Camera(position=({p}), target=({t}), up=({u}), vfov={self.vfov:g}, "
            f"width={self.width}, height={self.height}{more})"
        )


# --- The default camera and light for a scene without its own ---------------------------------------------------------


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
