"""The default picture of a scene: the framed geometry, the room that encloses the camera, and the lights."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.elementary import atan, cos, sin, tan
from ..kernels.small_matrices import dot, length, product
from .camera import AZIMUTH, Camera, axes, fitted_axes, fitted_camera, orthographic_camera
from .lights import DirectionalLight, Light, SphereLight
from .scene_bounds import corners_of, corners_within, detail_box
from .sky import Sky

# --- Rooms: halls, patios, streets under a sky dome -------------------------------------------------------------------


class Room(NamedTuple):
    """A room enclosed by the scene, and the camera that shows it from inside."""

    middle: NDArray[np.float64]  # (3,) float64, world: a point in free space
    eye: NDArray[np.float64]  # (3,) float64, world
    target: NDArray[np.float64]  # (3,) float64, world
    vfov: float  # degrees; with `points`, horizontal in a portrait picture
    open: bool  # whether much of the sky is visible from the middle
    height: float  # from the middle up to the ceiling; 0.0 without one
    points: NDArray[np.float64] | None = None  # (k, 3) float64, world: framed content of a closed box; None: its walls
    planes: NDArray[np.float64] | None = None  # (m, 4) float64, world: faces of the closed box, see `exit_distance`

    def way(self, start: np.ndarray, along: np.ndarray) -> float:
        """Ray parameter at which the ray start + t along leaves the closed box; inf without a box."""
        return np.inf if self.planes is None else exit_distance(self.planes, start, along)


def exit_distance(planes: np.ndarray, start: np.ndarray, along: np.ndarray) -> float:
    """Ray parameter at which start + t along leaves the convex set n . x + d <= 0; planes: (m, 4) rows (n, d)."""
    distance, rate = -(dot(planes[:, :3], start) + planes[:, 3]), dot(planes[:, :3], along)
    return float((distance[rate > 0.0] / rate[rate > 0.0]).min())


# --- The framed geometry and the lights -------------------------------------------------------------------------------


KINDS = "perspective", "orthographic", "top", "panoramic"

_SUN_AZIMUTH = np.radians(-70.0)  # relative to the viewer; left is negative
_SUN_ELEVATION, _LOW_SUN = np.radians(48.0), np.radians(28.0)
_FLAT = 0.2  # height of the scene relative to its width, below which the low sun shows its relief
_SUN_WIDTH = 1.5  # degrees; slightly softer than the sun's 0.53
_SUN, _BRIGHT_SUN, _SUN_COLOUR = 4.5, 6.0, (1.0, 0.95, 0.87)  # the bright one is low
_INSIDE = 1e-3  # gap between an orthographic camera in a closed box and its content, in picture heights
_LAMP_HEIGHT = 0.8  # of the lamp over the middle, relative to the ceiling's
_LAMP_REACH = 0.6  # limit of this height, relative to the distance from eye to target: lights the walls of a shaft too
_LAMP_BACK = 0.5  # shift of the lamp from the middle towards the eye, relative to their distance
_LAMP_RADIUS = 0.15  # relative to the lamp's height over the middle


class DefaultView(NamedTuple):
    """The geometry that a default picture shows."""

    points: NDArray[np.float64]  # (k, 3) float64, world
    up: str
    room: Room | None  # shown from inside; None: `points` are shown from outside
    bounds: NDArray[np.float64]  # (2, 3) world: of the scene, which a store also has

    def camera(self, width: int, height: int) -> Camera:
        """The default camera for a size in pixels."""
        if self.room is not None:
            return Camera(self.room.eye, self.room.target, axes(self.up)[1], self._lens(width, height), width, height)
        return fitted_camera(self.points, self.up, width, height)

    def _lens(self, width: int, height: int) -> float:
        """The vertical field of view in a room, degrees."""
        assert self.room is not None
        if self.room.points is None or width >= height:
            return self.room.vfov
        return float(2.0 * np.degrees(atan(tan(np.radians(self.room.vfov) / 2.0) * height / width)))

    def other_camera(self, kind: str, width: int, height: int) -> Camera:
        """The default camera of another kind in `KINDS`; "top" is orthographic and looks straight down."""
        if kind == "panoramic":
            camera = self.camera(width, height)
            if self.room is not None:
                middle = self.room.middle
                camera = Camera(middle, middle + camera.axes[2], camera.up, width=width, height=height)
            return camera.panoramic()
        in_box = self.room is not None and self.room.points is not None
        gap = _INSIDE if in_box else 1.0
        return orthographic_camera(self.points, self.up, width, height, kind == "top", gap)

    def sun(self) -> DirectionalLight:
        """A sun to the left of the default camera, slightly behind it; lower over terrain and towns, which are flat."""
        right, upward, towards = axes(self.up)
        along, height, across = np.abs(dot(axes(self.up), self.bounds[1] - self.bounds[0]))
        flat = self.room is None and 0.0 < height < _FLAT * (along + across) / 2.0
        elevation, intensity = (_LOW_SUN, _BRIGHT_SUN) if flat else (_SUN_ELEVATION, _SUN)
        azimuth = AZIMUTH + _SUN_AZIMUTH
        horizontal = sin(azimuth) * right + cos(azimuth) * towards
        direction = cos(elevation) * horizontal + sin(elevation) * upward
        return DirectionalLight(-direction, _SUN_WIDTH, intensity=intensity, colour=_SUN_COLOUR)

    def lights(self) -> list[Light]:
        """Sun and sky; in a closed room, a lamp below the ceiling and the sky."""
        if self.room is None or self.room.open:
            return [self.sun(), Sky(up=self.up)]
        room = self.room
        height = min(_LAMP_HEIGHT * room.height, _LAMP_REACH * float(length(room.target - room.eye)))
        middle = room.middle + _LAMP_BACK * (room.eye - room.middle) + height * axes(self.up)[1]
        distance = max(height, float(length(room.target - middle)))
        return [SphereLight(middle, _LAMP_RADIUS * height, intensity=np.pi * distance**2), Sky(up=self.up)]


def view_of_bounds(bounds: np.ndarray, up: str) -> DefaultView:
    """The default view of a scene from its bounds alone."""
    return DefaultView(corners_of(bounds), up, None, bounds)


def framed_points(faces: NDArray[np.float64], up: str) -> NDArray[np.float64]:
    """(k, 3) float64, world: the few corners of a sample of faces, (m, 3, 3), on which cameras from outside depend.

    A camera of any size that fits them is the one that fits `corners_within` the detail box of the sample.
    """
    points = np.unique(corners_within(faces, detail_box(faces)), axis=0)
    chosen = [points.argmin(0), points.argmax(0)]
    x, y, z = product(points - (points.min(0) + points.max(0)) / 2.0, np.stack(fitted_axes(points, up), 1)).T
    chosen += [_convex_hull(across, z) for across in (x, y)]
    return np.asarray(points[np.unique(np.concatenate(chosen))])


def _convex_hull(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.intp]:
    """(h,): the numbers of points in the plane at the corners of their convex hull."""
    order = np.lexsort((y, x))
    left, right = order[0], order[-1]
    found, waiting = [left, right], [(left, right, order), (right, left, order)]
    while waiting:
        a, b, points = waiting.pop()
        beyond = (x[b] - x[a]) * (y[points] - y[a]) - (y[b] - y[a]) * (x[points] - x[a])
        points, beyond = points[beyond > 0.0], beyond[beyond > 0.0]
        if len(points):
            farthest = points[np.argmax(beyond)]
            found.append(farthest)
            waiting += [(a, farthest, points), (farthest, b, points)]
    return np.array(found)


def missing_skies(lights: list[Light], up: str) -> list[Light]:
    """The skies to add to a scene's own lights: one that matches the brightest sun, if there is a sun but no sky."""
    suns = [light for light in lights if isinstance(light, DirectionalLight)]
    if not suns or any(isinstance(light, Sky) for light in lights):
        return []
    return [Sky(up=up, intensity=max(light.intensity for light in suns) / _SUN)]
