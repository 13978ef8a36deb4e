"""Perspective, orthographic and panoramic cameras, the rays through their pixels, and automatic framing.

`CameraRays` parametrises the rays of a perspective camera, which kernels evaluate. `ExplicitRays` evaluates the rays of
orthographic and panoramic cameras up front. The framing functions supply the default camera and light for scenes that
have none of their own.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import choice, number, vector, whole_number
from ..base.errors import InputError
from ..kernels.elementary import atan, atan2, cos, sin, tan
from ..kernels.small_matrices import dot, length, product
from .lights import QuadLight, Vector
from .scene_bounds import flush_to_zero

# --- Explicit rays of orthographic and panoramic cameras --------------------------------------------------------------


class ExplicitRays(NamedTuple):
    """The rays of an orthographic or panoramic camera, in the recentred frame of a scene.

    Each ray is computed in float64 and rounded once to float32, so that every method traces the same rays. Directions
    have unit length, so t is a distance.
    """

    origin: NDArray[np.float64]  # (3,) float64, recentred
    axes: NDArray[np.float64]  # (3, 3) float64: unit vectors right and down in the picture, and towards its centre
    width: int  # pixels
    height: int
    extent: float | None  # height of an orthographic picture in world units; None: panoramic

    def through(
        self, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Origins and directions, (..., 3) float32 each, of the rays through picture positions.

        x, y : (...) float64, pixels right and down from the upper left corner; broadcast against each other
        """
        if self.extent is None:
            directions = self._around(x, y)
            return _everywhere(self.origin, directions.shape), directions
        x, y = np.broadcast_arrays(x, y)
        pixel = self.extent / self.height
        across, down = (x - self.width / 2.0) * pixel, (y - self.height / 2.0) * pixel
        origins = self.origin + across[..., None] * self.axes[0] + down[..., None] * self.axes[1]
        return origins.astype(np.float32), _everywhere(self.axes[2], origins.shape)

    def directions(self, x: np.ndarray, y: np.ndarray) -> NDArray[np.float32]:
        """(..., 3) float32: the directions alone; see `through`."""
        return self.through(x, y)[1]

    def places(self, offsets: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, 2) float64: picture positions of points, the inverse of `through`; NaN for points behind the camera.

        offsets : (k, 3) float64, points minus `origin`
        """
        across, down, ahead = product(offsets, self.axes.T).T
        if self.extent is None:
            heading, pitch = atan2(across, ahead), atan2(down, np.sqrt(across * across + ahead * ahead))
            return np.stack([heading / (2.0 * np.pi) + 0.5, pitch / np.pi + 0.5], 1) * (self.width, self.height)
        places = np.stack([across, down], 1) * (self.height / self.extent) + (self.width / 2.0, self.height / 2.0)
        places[ahead <= 0.0] = np.nan
        return places

    def _around(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float32]:
        """Directions of a panorama."""
        heading = (np.asarray(x, np.float64) / self.width - 0.5) * (2.0 * np.pi)
        pitch = (np.asarray(y, np.float64) / self.height - 0.5) * np.pi
        horizontal = sin(heading)[..., None] * self.axes[0] + cos(heading)[..., None] * self.axes[2]
        out: NDArray[np.float32] = (cos(pitch)[..., None] * horizontal + sin(pitch)[..., None] * self.axes[1]).astype(
            np.float32
        )
        return out


def _everywhere(vector: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float32]:
    return np.broadcast_to(vector.astype(np.float32), shape)


# --- Cameras, and the rays through their pixels -----------------------------------------------------------------------


MAX_SIZE = 32768  # pixels along each side
PROJECTIONS = "perspective", "orthographic", "panoramic"
_FARTHEST = 1e30  # float32 holds all differences of coordinates below this


class CameraRays(NamedTuple):
    """A perspective camera's rays for kernels, in the recentred frame of a scene.

    The ray of pixel (x, y), x right and y down, starts at ``origin``. Its direction is
    ``float32(corner + (x + 0.5) * dx + (y + 0.5) * dy)``, evaluated in float64 in that order, component by component.
    The direction's component along the view axis is 1, so t is the depth.
    """

    origin: NDArray[np.float32]  # (3,) float32, recentred
    corner: NDArray[np.float64]  # (3,) float64, direction to the image's upper left corner
    dx: NDArray[np.float64]  # (3,) float64, one pixel to the right
    dy: NDArray[np.float64]  # (3,) float64, one pixel down
    width: int  # pixels
    height: int

    def directions(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
        """(..., 3) float32: approximate ray directions through picture positions, (...) float32 pixels right and down.

        They are evaluated in float32, so they may differ in the last bits from the directions that kernels trace.
        """
        corner, dx, dy = (part.astype(np.float32) for part in (self.corner, self.dx, self.dy))
        out: NDArray[np.float32] = corner + x[..., None] * dx + y[..., None] * dy
        return out


class Camera:
    """A camera at ``position`` that looks at ``target``, in right-handed world space.

    Parameters
    ----------
    position, target, up : (3,) float, world space
    vfov : float
        Vertical field of view of a perspective camera in degrees, 0 < vfov < 180.
    width, height : int
        Picture size in pixels, 1 to 32768.
    projection : "perspective", "orthographic" or "panoramic"
        Orthographic: all rays are parallel and start in the plane through `position`. Panoramic: rays from `position`
        in all directions, as an equirectangular map centred on the heading of `target`. `up` is the zenith, so the
        horizon is level. The picture should be twice as wide as high; any other aspect ratio stretches it.
    extent : float or None
        Height of an orthographic picture in world units; None for other projections.

    Raises
    ------
    InputError
        On non-finite or huge numbers, a target at the position, ``up`` along the view, sizes out of range, an unknown
        projection, a missing extent, or an extent for a projection that takes none.

    Examples
    --------
    >>> camera = at.Camera((0, 1.7, 8), (0, 1, 0), vfov=60, width=64, height=48)
    >>> camera.resized(640, 480)
    Camera(position=(0, 1.7, 8), target=(0, 1, 0), up=(0, 1, 0), vfov=60, width=640, height=480)
    """

    def __init__(
        self,
        position: Vector,
        target: Vector,
        up: Vector = (0.0, 1.0, 0.0),
        vfov: float = 60.0,
        width: int = 1024,
        height: int = 1024,
        *,
        projection: str = "perspective",
        extent: float | None = None,
    ) -> None:
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
        if not length(view) > 0.0:
            raise InputError("camera target is at the camera position; move one of them")
        right = np.cross(view, self.up)
        if length(right) <= 1e-9 * length(view) * length(self.up):
            raise InputError("camera up is along the view direction (or zero); choose another up")
        choice(projection, "camera projection", PROJECTIONS)
        if (projection == "orthographic") != (extent is not None):
            raise InputError("camera extent is the height of an orthographic picture; give both or neither")
        self.projection: str = projection
        self.extent = None if extent is None else number(extent, "camera extent", 0.0, _FARTHEST)

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera with another picture size."""
        return Camera(
            self.position,
            self.target,
            self.up,
            self.vfov,
            width,
            height,
            projection=self.projection,
            extent=self.extent,
        )

    def panoramic(self) -> "Camera":
        """A panoramic camera at the same position, centred on the heading of this camera."""
        place = self.position
        return Camera(
            place, place + self.axes[2], self.up, width=self.width, height=self.height, projection="panoramic"
        )

    @property
    def listed(self) -> bool:
        """Whether the camera is not perspective: its rays are explicit, and only ray tracing finds its surfaces."""
        return self.projection != "perspective"

    @property
    def axes(self) -> NDArray[np.float64]:
        """(3, 3) float64: unit vectors right and down in the picture, and along the view, as rows."""
        view = self.target - self.position
        view = view / length(view)
        right = np.cross(view, self.up)
        right = right / length(right)
        return np.stack([right, np.cross(view, right), view])

    @property
    def frame(self) -> np.ndarray:
        """As `axes`, but a panorama has a level horizon: down points away from the zenith."""
        if self.projection != "panoramic":
            return self.axes
        right, zenith = self.axes[0], self.up / length(self.up)
        return np.stack([right, -zenith, np.cross(zenith, right)])

    def view(self, origin: ArrayLike) -> "CameraRays | ExplicitRays":
        """The pixels' rays in the frame whose origin is at world position ``origin`` ((3,) float64)."""
        if not self.listed:
            return self.rays(origin)
        position = flush_to_zero(self.position - np.asarray(origin, np.float64))
        return ExplicitRays(position, self.frame, self.width, self.height, self.extent)

    def rays(self, origin: ArrayLike) -> CameraRays:
        """As `view`, for a perspective camera. Raises InputError for other projections."""
        if self.listed:
            raise InputError(f"this needs a perspective camera, and the camera is {self.projection}; give another one")
        right, down, view = self.axes
        half = tan(np.radians(self.vfov) / 2.0)
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


# --- Automatic framing: the default camera and light of a scene without its own ---------------------------------------


VFOV = 45.0
_MARGIN = 1.08  # around the points that a fitted camera shows
_FLAT = 0.2  # a box whose height is a smaller share of its width counts as flat
STEEP = np.radians(50.0)  # elevation of the camera for flat boxes
AZIMUTH, ELEVATION = np.radians(35.0), np.radians(25.0)


def axes(up: str) -> np.ndarray:
    """The right, up and towards-the-viewer axes ((3, 3) float64 rows) of a scene with up axis "y" or "z"."""
    if up == "z":
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return np.eye(3)


def default_camera(bounds: np.ndarray, up: str, width: int, height: int, turn: float = 0.0) -> Camera:
    """A three-quarter view from slightly above that fits the bounding sphere of `bounds` ((2, 3), world).

    turn : radians around the up axis, counter-clockwise seen from above
    """
    right, upward, towards = axes(up)
    centre, radius = bounding_sphere(bounds)
    half = atan(tan(np.radians(VFOV) / 2.0) * min(1.0, width / height))
    distance = 1.02 * radius / sin(half)
    horizontal = sin(AZIMUTH + turn) * right + cos(AZIMUTH + turn) * towards
    position = centre + distance * (cos(ELEVATION) * horizontal + sin(ELEVATION) * upward)
    return Camera(position, centre, upward, VFOV, width, height)


def fitted_camera(points: np.ndarray, up: str, width: int, height: int) -> Camera:
    """A camera with the default view direction, as close as fits all `points` ((n, 3), world) with a small margin.

    Points in a flat box are viewed from higher up.
    """
    sideways, upwards, back = fitted_axes(points, up)
    middle = (points.min(0) + points.max(0)) / 2.0
    x, y, z = product(points - middle, np.stack([sideways, upwards, back], 1)).T
    tangent = tan(np.radians(VFOV) / 2.0) / _MARGIN
    distance = 1e-6 * max(float(np.abs(middle).max()), 1.0)
    for across, slope in ((x, tangent * width / height), (y, tangent)):
        distance = max(distance, ((across + slope * z).max() + (slope * z - across).max()) / (2.0 * slope))
    target = middle + _centre(x, distance - z) * sideways + _centre(y, distance - z) * upwards
    return Camera(target + distance * back, target, axes(up)[1], VFOV, width, height)


def orthographic_camera(
    points: np.ndarray, up: str, width: int, height: int, from_above: bool = False, gap: float = 1.0
) -> Camera:
    """An orthographic camera that fits all `points` ((n, 3), world) with a small margin.

    It has the view direction of `fitted_camera`, or looks straight down; then the top of the picture is -z, or +y if z
    points up. Its rays start `gap` picture heights in front of the nearest point.
    """
    right, upward, towards = axes(up)
    sideways, upwards, back = (right, -towards, upward) if from_above else fitted_axes(points, up)
    middle = (points.min(0) + points.max(0)) / 2.0
    x, y, z = product(points - middle, np.stack([sideways, upwards, back], 1)).T
    extent = _MARGIN * max(np.ptp(y), np.ptp(x) * height / width, 1e-6 * max(float(np.abs(middle).max()), 1.0))
    target = middle + (x.min() + x.max()) / 2.0 * sideways + (y.min() + y.max()) / 2.0 * upwards
    position = target + (z.max() + gap * extent) * back
    return Camera(position, target, upwards, width=width, height=height, projection="orthographic", extent=extent)


def fitted_axes(points: np.ndarray, up: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The right, up and backward unit vectors of a fitted camera."""
    right, upward, towards = axes(up)
    level = sin(AZIMUTH) * right + cos(AZIMUTH) * towards
    size = np.ptp(points, axis=0)
    elevation = STEEP if dot(size, upward) < _FLAT * size.max() else ELEVATION
    back = cos(elevation) * level + sin(elevation) * upward
    sideways = np.cross(upward, back) / length(np.cross(upward, back))
    return sideways, np.cross(back, sideways), back


def _centre(across: np.ndarray, depth: np.ndarray) -> float:
    """The camera offset that centres the points in the picture; `depth` holds their distances along the view."""
    low, high = float(across.min()), float(across.max())
    for _ in range(40):
        middle = (low + high) / 2.0
        slopes = (across - middle) / depth
        low, high = (middle, high) if slopes.max() > -slopes.min() else (low, middle)
    return (low + high) / 2.0


def default_light(bounds: np.ndarray, up: str) -> QuadLight:
    """A square light above the bounding sphere of `bounds`, to the viewer's left, as wide as the sphere's radius.

    Its intensity makes a white surface at the centre that faces the light appear white.
    """
    right, upward, towards = axes(up)
    centre, radius = bounding_sphere(bounds)
    middle = centre + radius * (1.6 * upward - 0.6 * right + 0.4 * towards)
    u, v = radius * right, radius * towards  # u x v points down
    distance = length(middle - centre)
    return QuadLight(corner=middle - (u + v) / 2.0, u=u, v=v, intensity=float(np.pi * distance**2))


def bounding_sphere(bounds: NDArray[np.float64]) -> tuple[np.ndarray, float]:
    """(centre, radius) of the sphere around `bounds` ((2, 3), world); a zero radius becomes 1."""
    lower, upper = bounds
    radius = float(length(upper - lower)) / 2.0
    return lower + (upper - lower) / 2.0, radius if radius > 0.0 else 1.0
