"""The default picture of a scene: the geometry that it frames, the room that encloses the camera, and its lights."""

from typing import NamedTuple

import numpy as np

from .camera import AZIMUTH, Camera, axes, fitted_camera, orthographic_camera
from .lights import DirectionalLight, Light, SphereLight
from .scene_bounds import corners_of
from .sky import Sky

# --- The room that a scene encloses, if it is one: halls, streets below a painted sky, patios -------------------------


class Room(NamedTuple):
    """A room, and the camera that shows it from inside."""

    middle: np.ndarray  # (3,) float64, world: a point in the air
    eye: np.ndarray  # (3,) float64, world
    target: np.ndarray  # (3,) float64, world
    vfov: float  # degrees; with `points`, across a picture that is higher than wide
    open: bool  # whether much of the sky is seen from the middle
    height: float  # from the middle up to the ceiling; 0.0 without one
    points: np.ndarray | None = None  # (k, 3) float64, world: what it shows from inside a closed box; None: its walls
    planes: np.ndarray | None = None  # (m, 4) float64, world, see `way_out`: of the closed box that it is in

    def way(self, start: np.ndarray, along: np.ndarray) -> float:
        """How many times `along` leads from a point in a closed box to this box; inf without one."""
        return np.inf if self.planes is None else way_out(self.planes, start, along)


def way_out(planes: np.ndarray, start: np.ndarray, along: np.ndarray) -> float:
    """How many times `along` ((3,) float64) leads from a point inside planes ((m, 4): n x + d <= 0 inside) to them."""
    left, rate = -(planes[:, :3] @ start + planes[:, 3]), planes[:, :3] @ along
    return float((left[rate > 0.0] / rate[rate > 0.0]).min())


# --- What the default picture of a scene shows, and the light in it ---------------------------------------------------


KINDS = "perspective", "orthographic", "top", "panoramic"

_SUN_ELEVATION, _SUN_AZIMUTH = np.radians(48.0), np.radians(-70.0)  # the azimuth is from the viewer, to the left
_SUN_WIDTH = 1.5  # degrees; a little softer than the sun's 0.53
_SUN, _SUN_COLOUR = 4.5, (1.0, 0.95, 0.87)
_INSIDE = 1e-3  # how near to its content an orthographic camera in a closed box is, as a share of the picture's height
_LAMP_HEIGHT = 0.8  # share of the way from a room's middle to its ceiling, ...
_LAMP_REACH = (
    0.6  # ... but at most this share of the way from the eye to the target: in a shaft it lights the walls too
)
_LAMP_BACK = 0.5  # share of the way from the middle to the eye
_LAMP_RADIUS = 0.15  # share of the lamp's height over the middle


class DefaultView(NamedTuple):
    """The geometry that a default picture shows."""

    points: np.ndarray  # (k, 3) float64, world
    up: str
    room: Room | None  # shown from inside; None: `points` are shown from outside

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
        return float(2.0 * np.degrees(np.arctan(np.tan(np.radians(self.room.vfov) / 2.0) * height / width)))

    def other_camera(self, kind: str, width: int, height: int) -> Camera:
        """The default camera of another kind in `KINDS`; "top" is an orthographic one that looks straight down."""
        if kind == "panoramic":
            camera = self.camera(width, height)
            if self.room is not None:
                middle = self.room.middle
                camera = Camera(middle, middle + camera.axes[2], camera.up, width=width, height=height)
            return camera.panoramic()
        wrapped = self.room is not None and self.room.points is not None
        gap = _INSIDE if wrapped else 1.0
        return orthographic_camera(self.points, self.up, width, height, kind == "top", gap)

    def lights(self) -> list[Light]:
        """Sun and sky; in a closed room a lamp below the ceiling."""
        if self.room is None or self.room.open:
            return [sun(self.up), Sky(up=self.up)]
        room = self.room
        height = min(_LAMP_HEIGHT * room.height, _LAMP_REACH * float(np.linalg.norm(room.target - room.eye)))
        middle = room.middle + _LAMP_BACK * (room.eye - room.middle) + height * axes(self.up)[1]
        distance = max(height, float(np.linalg.norm(room.target - middle)))
        return [SphereLight(middle, _LAMP_RADIUS * height, intensity=np.pi * distance**2), Sky(up=self.up)]


def view_of_box(bounds: np.ndarray, up: str) -> DefaultView:
    """The view of a scene of which only the bounds are known."""
    return DefaultView(corners_of(bounds), up, None)


def skies_with(lights: list[Light], up: str) -> list[Light]:
    """The skies that a scene's own lights lack: one for the brightest sun, if there is no sky."""
    suns = [light for light in lights if isinstance(light, DirectionalLight)]
    if not suns or any(isinstance(light, Sky) for light in lights):
        return []
    return [Sky(up=up, intensity=max(light.intensity for light in suns) / _SUN)]


def sun(up: str) -> DirectionalLight:
    """A sun to the left of the default camera, a little behind it."""
    right, upward, towards = axes(up)
    azimuth = AZIMUTH + _SUN_AZIMUTH
    flat = np.sin(azimuth) * right + np.cos(azimuth) * towards
    direction = np.cos(_SUN_ELEVATION) * flat + np.sin(_SUN_ELEVATION) * upward
    return DirectionalLight(-direction, _SUN_WIDTH, intensity=_SUN, colour=_SUN_COLOUR)
