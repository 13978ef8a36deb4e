"""What the viewer shows: a scene at a time, its editable lights, and the page frame that scales the scene.

In the page, every scene is centred at zero and twenty units wide, since browsers have float32 and a far plane. Nothing
here knows a browser.
"""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import NamedTuple

import numpy as np

from ..checks import instance, number
from ..engine.scene import AnyScene, Scene
from ..errors import InputError
from ..jobs.dataset.dataset_layers import has_centre, towards_centre
from ..jobs.sun.location import Place, checked_place
from ..jobs.sun.sun_positions import directions_of, solar_angles, zone_of
from ..picture.frame import Frame
from ..picture.image_files import frame_exposure
from ..picture.renderer import Renderer
from ..scene.camera import Camera, axes, bounding_sphere
from ..scene.lights import (
    DirectionalLight,
    DiskLight,
    Light,
    PointLight,
    QuadLight,
    SphereLight,
    check_lights,
    light_names,
    tangents,
)

# ---------------------------------------------------------------------------------------------------------------------
# The frame of the page: the scene around zero and twenty units wide, for browsers have float32 and a far plane.


RADIUS = 10.0
"""Radius of a scene's bounding sphere in the page."""

_NEAR = 0.25  # share of the way to its target at which a camera within the scene gets its pivot


class Pose(NamedTuple):
    """A camera of the page."""

    position: np.ndarray  # (3,) float64, page
    target: np.ndarray  # (3,) float64, page; any point on the view axis
    up: np.ndarray  # (3,) float64
    vfov: float  # radians
    width: int  # pixels
    height: int


class PageFrame(NamedTuple):
    """The map between world and page; axes keep their directions."""

    centre: np.ndarray  # (3,) float64, world
    scale: float  # page units in a world unit
    up: np.ndarray  # (3,) float64
    half: np.ndarray  # (3,) float64, page: half of the size of the scene's bounds

    @classmethod
    def of(cls, scene) -> "PageFrame":
        """The page_frame on which a scene is shown as a whole."""
        centre, radius = bounding_sphere(scene.bounds)
        scale = RADIUS / radius
        return cls(centre, scale, axes(scene.up)[1], np.ptp(scene.bounds, axis=0) * scale / 2.0)

    def to_page(self, world: np.ndarray) -> np.ndarray:
        return (np.asarray(world, np.float64) - self.centre) * self.scale

    def to_world(self, page: np.ndarray) -> np.ndarray:
        return np.asarray(page, np.float64) / self.scale + self.centre

    def camera(self, pose: Pose) -> Camera:
        """The camera in the world."""
        position, target = self.to_world(pose.position), self.to_world(pose.target)
        return Camera(position, target, pose.up, np.degrees(pose.vfov), pose.width, pose.height)

    def pose(self, camera: Camera) -> Pose:
        """The camera in the page."""
        position, target = self.to_page(camera.position), self.to_page(camera.target)
        return Pose(position, target, camera.up, float(np.radians(camera.vfov)), camera.width, camera.height)

    def first_pose(self, camera: Camera) -> Pose:
        """The pose of a camera around whose target the user turns. Within the scene, the target comes near."""
        pose = self.pose(camera)
        inside = bool((np.abs(pose.position) < self.half).all())
        return pose._replace(target=pose.position + _NEAR * (pose.target - pose.position)) if inside else pose


def rotation_matrix(wxyz: np.ndarray) -> np.ndarray:
    """(3, 3) float64: the rotation matrix of a unit quaternion. Its columns are a camera's right, down and forward."""
    w, x, y, z = np.asarray(wxyz, np.float64)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


# --- Lights that a user moves, turns and switches off -----------------------------------------------------------------


FAR = RADIUS
"""Distance of the handles of suns from the middle of the page."""

_ROUND = np.linspace(0.0, 2.0 * np.pi, 33)


class EditableLight(NamedTuple):
    """A light of the page."""

    name: str
    light: Light
    on: bool = True


def handle_position(light: Light, page_frame: PageFrame) -> np.ndarray | None:
    """(3,) float64, page: the place of the light's handle; None: it has none, as light from everywhere."""
    if not has_centre(light):
        return None
    (direction,), end = towards_centre(light, page_frame.centre[None])
    return FAR * direction if np.isinf(end) else page_frame.to_page(page_frame.centre + direction)


def move_light(light: Light, page_frame: PageFrame, to: np.ndarray) -> Light:
    """The light with its handle at a place ((3,), page). A sun then shines from there to the middle of the page."""
    if isinstance(light, DirectionalLight):
        return replace(light, direction=-np.asarray(to, np.float64)).named(light.name) if np.any(to) else light
    world = page_frame.to_world(to)
    if isinstance(light, QuadLight):
        return replace(light, corner=world - (light.u + light.v) / 2.0).named(light.name)
    if isinstance(light, PointLight):
        return replace(light, position=world).named(light.name)
    if isinstance(light, DiskLight | SphereLight):
        return replace(light, center=world).named(light.name)
    return light


def light_outline(light: Light, page_frame: PageFrame) -> np.ndarray:
    """(k, 2, 3) float64, page: lines that show the extent of a light; none for a point."""
    if isinstance(light, QuadLight):
        a, b = light.corner + light.u, light.corner + light.v
        ring = np.stack([light.corner, a, a + light.v, b, light.corner])
        return _lines(page_frame.to_page(ring))
    if isinstance(light, DiskLight):
        return _lines(page_frame.to_page(_ring(light.center, light.radius, light.normal)))
    if isinstance(light, SphereLight):
        rings = [_lines(page_frame.to_page(_ring(light.center, light.radius, axis))) for axis in np.eye(3)]
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


def aim_sun_light(light: DirectionalLight, bearing: float, elevation: float, up: str) -> Light:
    """The sun moved to a bearing and an elevation, in degrees; the inverse of `sun_angles`."""
    (towards,) = directions_of([elevation], [bearing], up)
    return replace(light, direction=-towards).named(light.name)


def _ring(centre: np.ndarray, radius: float, normal: np.ndarray) -> np.ndarray:
    u, v = tangents(np.asarray(normal, np.float64))
    return centre + radius * (np.cos(_ROUND)[:, None] * u + np.sin(_ROUND)[:, None] * v)


def _lines(points: np.ndarray) -> np.ndarray:
    """(k - 1, 2, 3): the lines between k points in a row."""
    return np.stack([points[:-1], points[1:]], 1)


# --- What a page shows: a scene at a time, its lights, and how it is looked at ----------------------------------------


SHADED, BOX_TESTS, LIGHT_SHARE = "picture", "box tests", "seen: "
"""Kinds of pictures: shaded; the work of a plan; the share of a light that is seen (followed by the light's name)."""

STEPS_PLAN = "bsah+single"


class DisplayOptions(NamedTuple):
    """How a page shows the scene."""

    show: str = SHADED  # PICTURE, STEPS, or SEEN and the name of a light
    plan: str = STEPS_PLAN  # of STEPS
    stops: float = 0.0  # of exposure, beyond the automatic one


class Model:
    """The state of a page. Whatever changes it is a method here, and none of it knows a browser.

    Parameters
    ----------
    scene : Scene or PagedScene
    lights : list of lights, one light, or None
        None: ``scene.default_lights(time)``; they follow the animation until a user moves them.
    camera : Camera or None
        The first view. None: the scene's first camera, or ``scene.default_camera()``.
    time : float
        Seconds.
    plan, threads, max_memory
        As in `antumbra.render`.
    place : Place or None
        Where on Earth the scene lies; then the sun can follow a date and an hour.
    """

    def __init__(
        self, scene: AnyScene, lights: Sequence[Light] | Light | None = None, camera: Camera | None = None,
        time: float = 0.0, *, plan=None, threads: int | None = None, max_memory: int | None = None,
        place: Place | None = None,
    ):  # fmt: skip
        if camera is not None:
            instance(camera, Camera, "camera")
        if place is not None:
            place = checked_place(instance(place, Place, "place"))
        self.scene, self.page_frame, self.place, self.threads = scene, PageFrame.of(scene), place, threads
        self.renderer = Renderer(scene, plan, threads, max_memory=max_memory)
        self.plan, self.time, self.display = plan, scene.clamped(time), DisplayOptions()
        self._given = None if lights is None else check_lights(lights, scene.up)
        self._found: tuple[float, dict[str, Light]] | None = None  # the lights of a time, where nobody moved them
        self._moved: dict[str, Light] = {}
        self._off: set[str] = set()
        self._camera = camera
        self.last_camera: Camera | None = None  # the camera of the browser that moved last
        self._exposure: float | None = None
        self.ambient = np.zeros(3, np.float32)  # irradiance, as in the latest frame

    @property
    def lamps(self) -> list[EditableLight]:
        """All lights, at the time and where the user moved them."""
        if self._found is None or self._found[0] != self.time:
            lights = self.scene.default_lights(self.time) if self._given is None else self._given
            self._found = self.time, dict(zip(light_names(lights), lights))
        return [
            EditableLight(name, self._moved.get(name, light), name not in self._off)
            for name, light in self._found[1].items()
        ]

    def lamp(self, name: str) -> EditableLight:
        """The light of a name."""
        for lamp in self.lamps:
            if lamp.name == name:
                return lamp
        raise InputError(f"there is no light {name!r}; there are {', '.join(lamp.name for lamp in self.lamps)}")

    @property
    def shining(self) -> list[EditableLight]:
        """The lights that are on; never none: without any, the first one with intensity 0."""
        lamps = self.lamps
        on = [lamp for lamp in lamps if lamp.on and not self._has_set(lamp)]
        return on or [lamps[0]._replace(light=replace(lamps[0].light, intensity=0.0), on=False)]

    @property
    def sun(self) -> EditableLight | None:
        """The sun: the brightest distant light."""
        suns = [lamp for lamp in self.lamps if isinstance(lamp.light, DirectionalLight)]
        return max(suns, key=lambda lamp: lamp.light.intensity, default=None)

    @property
    def in_memory(self) -> bool:
        """Whether the triangles are in memory, so that there can be a stand-in."""
        return isinstance(self.scene, Scene)

    def first_camera(self, width: int, height: int) -> Camera:
        """The camera with which a page begins."""
        if self._camera is not None:
            return self._camera.resized(width, height)
        if self.scene.cameras:
            return self.scene.camera(0, self.time).resized(width, height)
        return self.scene.default_camera(width, height)

    def update_from(self, frame: Frame) -> None:
        """Take over the exposure of the first frame, so that nothing flickers, and the ambient light of each one."""
        if self._exposure is None:
            self._exposure = frame_exposure(frame)
        if frame.ambient is not None:
            self.ambient = frame.ambient

    @property
    def exposure(self) -> float | None:
        """The exposure of all pictures, from the first one on; None before it."""
        return None if self._exposure is None else self._exposure * 2.0**self.display.stops

    def reset_exposure(self) -> None:
        """Let the next picture choose the exposure."""
        self._exposure, self.display = None, self.display._replace(stops=0.0)

    def go_to(self, time: float) -> None:
        """Show the scene at a time, in seconds."""
        self.time = self.scene.clamped(time)

    def switch(self, name: str, on: bool) -> None:
        """Switch a light on or off."""
        self.lamp(name)
        (self._off.discard if on else self._off.add)(name)

    def move(self, name: str, to: np.ndarray) -> None:
        """Move a light so that its handle is at a place ((3,), page)."""
        self._moved[name] = move_light(self.lamp(name).light, self.page_frame, to)

    def aim_sun(self, bearing: float, elevation: float) -> None:
        """Move the sun to a bearing, clockwise from the scene's north axis, and an elevation, in degrees."""
        lamp = self.sun
        if lamp is None:
            raise InputError("the scene has no sun; give one by --light sun:DX,DY,DZ")
        bearing, elevation = number(bearing, "the bearing", -np.inf, np.inf), float(np.clip(elevation, -90.0, 90.0))
        assert isinstance(lamp.light, DirectionalLight)
        self._moved[lamp.name] = aim_sun_light(lamp.light, bearing, elevation, self.scene.up)

    def aim_sun_at(self, day: str, hour: float) -> tuple[float, float]:
        """Move the sun to where it stands on a day ("2026-06-21") at an hour of the wall clock.

        Returns the bearing and the elevation, in degrees.
        """
        if self.place is None:
            raise InputError("the place of the scene is unknown; give --latitude and --longitude, or --crs")
        try:
            midnight = datetime.fromisoformat(day).replace(tzinfo=zone_of(self.place))
        except ValueError:
            raise InputError(f"the day is {day[:30]!r}; write one such as 2026-06-21") from None
        instant = np.array([round(midnight.timestamp() + 3600.0 * hour)], "datetime64[s]")
        altitude, azimuth = solar_angles(self.place, instant)
        bearing, elevation = float(azimuth[0] + self.place.north) % 360.0, float(altitude[0])
        self.aim_sun(bearing, elevation)
        return bearing, elevation

    def _has_set(self, lamp: EditableLight) -> bool:
        """Whether the user moved this sun below the horizon. Distant lights of a file may shine from anywhere."""
        sun = lamp.light
        return (
            lamp.name in self._moved and isinstance(sun, DirectionalLight) and sun_angles(sun, self.scene.up)[1] <= 0.0
        )
