"""The state of a viewer page: a scene at a time, its editable lights, and the page frame that scales the scene.

In the page, every scene is centred at the origin and twenty units wide, because browsers have float32 precision and a
far plane. This module is independent of the browser.
"""

import shlex
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import checked_instance, number
from ..base.errors import InputError
from ..datasets.dataset_layers import has_centre, towards_centre
from ..engine.scene import AnyScene, is_outside
from ..picture.frame import Frame
from ..picture.image_files import LUMINANCE, PERCENTILE, frame_exposure, percentiles
from ..picture.render_options import EngineOptions
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
from ..sun.location import Place, checked_place
from ..sun.sun_positions import directions_of, solar_angles, zone_of

# --- The frame of the page --------------------------------------------------------------------------------------------


RADIUS = 10.0
"""Radius of a scene's bounding sphere in the page."""

_PIVOT = 0.25  # pivot of a camera inside the scene, as a share of the distance to its target


class Pose(NamedTuple):
    """A camera in page units."""

    position: NDArray[np.float64]  # (3,), page
    target: NDArray[np.float64]  # (3,), page; any point on the view axis
    up: NDArray[np.float64]  # (3,)
    vfov: float  # radians
    width: int  # pixels
    height: int


class PageFrame(NamedTuple):
    """The map between world and page units. It does not rotate."""

    centre: NDArray[np.float64]  # (3,), world
    scale: float  # page units per world unit
    up: NDArray[np.float64]  # (3,)
    half: NDArray[np.float64]  # (3,), page: half the size of the scene's bounds

    @classmethod
    def of(cls, scene: AnyScene) -> "PageFrame":
        """The frame that fits a whole scene."""
        centre, radius = bounding_sphere(scene.bounds)
        scale = RADIUS / radius
        return cls(centre, scale, axes(scene.up)[1], np.ptp(scene.bounds, axis=0) * scale / 2.0)

    def to_page(self, world: ArrayLike) -> NDArray[np.float64]:
        page: NDArray[np.float64] = (np.asarray(world, np.float64) - self.centre) * self.scale
        return page

    def to_world(self, page: ArrayLike) -> NDArray[np.float64]:
        world: NDArray[np.float64] = np.asarray(page, np.float64) / self.scale + self.centre
        return world

    def camera(self, pose: Pose) -> Camera:
        """The camera in the world."""
        position, target = self.to_world(pose.position), self.to_world(pose.target)
        return Camera(position, target, pose.up, np.degrees(pose.vfov), pose.width, pose.height)

    def pose(self, camera: Camera) -> Pose:
        """The camera in the page."""
        position, target = self.to_page(camera.position), self.to_page(camera.target)
        return Pose(position, target, camera.up, float(np.radians(camera.vfov)), camera.width, camera.height)

    def first_pose(self, camera: Camera) -> Pose:
        """The initial pose of a camera, which orbits its target. Inside the scene, the target is moved closer."""
        pose = self.pose(camera)
        inside = bool((np.abs(pose.position) < self.half).all())
        return pose._replace(target=pose.position + _PIVOT * (pose.target - pose.position)) if inside else pose


def rotation_matrix(wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) float64: the rotation matrix of a unit quaternion. Its columns are a camera's right, down and forward."""
    w, x, y, z = np.asarray(wxyz, np.float64)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


# --- Editable lights --------------------------------------------------------------------------------------------------


FAR = RADIUS
"""Distance of sun handles from the centre of the page."""

_ROUND = np.linspace(0.0, 2.0 * np.pi, 33)


class EditableLight(NamedTuple):
    """A light of the page."""

    name: str
    light: Light
    on: bool = True


def handle_position(light: Light, page_frame: PageFrame) -> NDArray[np.float64] | None:
    """(3,) float64, page: the position of the light's handle; None for lights without a centre, such as skies."""
    if not has_centre(light):
        return None
    (direction,), end = towards_centre(light, page_frame.centre[None])
    return FAR * direction if np.isinf(end) else page_frame.to_page(page_frame.centre + direction)


def move_light(light: Light, page_frame: PageFrame, to: NDArray[np.float64]) -> Light:
    """The light with its handle at a position ((3,), page). A sun shines from there to the centre of the page."""
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


def light_outline(light: Light, page_frame: PageFrame) -> NDArray[np.float64]:
    """(k, 2, 3) float64, page: the outline of a light; empty for a point light."""
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
    """(bearing clockwise from the scene's north axis, 0 to 360; elevation) of a sun, in degrees.

    The north axis is +Y if +Z is up, and -Z if +Y is up; east is +X.
    """
    east, height, south = axes(up) @ -light.direction
    return float(np.degrees(np.arctan2(east, -south)) % 360.0), float(np.degrees(np.arcsin(np.clip(height, -1.0, 1.0))))


def aim_sun_light(light: DirectionalLight, bearing: float, elevation: float, up: str) -> Light:
    """The sun at a bearing and an elevation, in degrees; the inverse of `sun_angles`."""
    (towards,) = directions_of([elevation], [bearing], up)
    return replace(light, direction=-towards).named(light.name)


def _ring(centre: NDArray[np.float64], radius: float, normal: NDArray[np.float64]) -> NDArray[np.float64]:
    u, v = tangents(np.asarray(normal, np.float64))
    ring: NDArray[np.float64] = centre + radius * (np.cos(_ROUND)[:, None] * u + np.sin(_ROUND)[:, None] * v)
    return ring


def _lines(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k - 1, 2, 3): the lines between k consecutive points."""
    return np.stack([points[:-1], points[1:]], 1)


# --- The model --------------------------------------------------------------------------------------------------------


SHADED, BOX_TESTS, LIGHT_SHARE = "picture", "box tests", "seen: "
"""Kinds of pictures: shaded; box tests of a plan; visible share of a light (followed by the light's name)."""

STEPS_PLAN = "bsah+single"


_HIGHLIGHT = 1.6  # most light, as a multiple of white, of all but the brightest surfaces, so that these keep shades
_LOWERED = 0.7  # least share of the automatic exposure, which shows surfaces in the shade
_STEADY = 0.5  # stops that the exposure may be off after a change of the lights, to avoid flicker


def metered_exposure(frame: Frame) -> float:
    """The automatic exposure of a frame, lowered a little where the sun shines into a shady place.

    Pictures of the viewer have no bounced light, so a sunlit floor is farther from the shade than in `render`.
    """
    exposure = frame_exposure(frame)
    luminance = frame.image[frame.mask] @ LUMINANCE
    luminance = luminance[np.isfinite(luminance) & (luminance > 0.0)]
    if not len(luminance):
        return exposure
    high = max(float(percentiles(luminance, (PERCENTILE,))[0]), 1e-30)
    return float(np.clip(_HIGHLIGHT / high, _LOWERED * exposure, exposure))


class DisplayOptions(NamedTuple):
    """Options for the pictures of a page."""

    show: str = SHADED  # SHADED, BOX_TESTS, or LIGHT_SHARE and the name of a light
    plan: str = STEPS_PLAN  # plan of box-test pictures
    stops: float = 0.0  # exposure relative to the automatic one, in stops


class Model:
    """The state of a page, independent of the browser. Methods make all changes.

    Parameters
    ----------
    scene : Scene or PagedScene
    lights : list of lights, one light, or None
        None: ``scene.default_lights(time)``. Lights follow the animation until the user moves them.
    camera : Camera or None
        The first view. None: the scene's first camera, or ``scene.default_camera()``.
    time : float
        Seconds.
    engine : EngineOptions or None
        None: the defaults.
    place : Place or None
        Location of the scene on Earth, which lets the sun follow a date and time.
    """

    def __init__(
        self,
        scene: AnyScene,
        lights: Sequence[Light] | Light | None = None,
        camera: Camera | None = None,
        time: float = 0.0,
        *,
        engine: EngineOptions | None = None,
        place: Place | None = None,
    ):
        engine = engine or EngineOptions()
        if camera is not None:
            checked_instance(camera, Camera, "camera")
        if place is not None:
            place = checked_place(checked_instance(place, Place, "place"))
        self.scene, self.page_frame, self.place, self.threads = scene, PageFrame.of(scene), place, engine.threads
        self.renderer = Renderer(scene, engine.plan, engine.threads, engine.gbuffer, engine.max_memory, engine.device)
        self.plan, self.time, self.display = engine.plan, scene.clamped(time), DisplayOptions()
        self._initial_lights = None if lights is None else check_lights(lights, scene.up)
        self._default_lights: tuple[float, dict[str, Light]] | None = None  # the unmoved lights at a time
        self._moved: dict[str, Light] = {}
        self._off: set[str] = set()
        self._camera = camera
        self.last_camera: Camera | None = None  # camera of the browser that moved last
        self._exposure: float | None = None
        self.light_changes = 0  # counts changes of the lights
        self._metered = -1  # `light_changes` for which the exposure was last metered
        self.source = shlex.quote(scene.name)  # the scene as words of a command
        self.ambient = np.zeros(3, np.float32)  # irradiance of the latest frame

    @property
    def editable_lights(self) -> list[EditableLight]:
        """All lights at the current time, as moved by the user."""
        if self._default_lights is None or self._default_lights[0] != self.time:
            lights = self.scene.default_lights(self.time) if self._initial_lights is None else self._initial_lights
            self._default_lights = self.time, dict(zip(light_names(lights), lights))
        return [
            EditableLight(name, self._moved.get(name, light), name not in self._off)
            for name, light in self._default_lights[1].items()
        ]

    def editable_light(self, name: str) -> EditableLight:
        """The light of this name."""
        for lamp in self.editable_lights:
            if lamp.name == name:
                return lamp
        raise InputError(
            f"there is no light {name!r}; there are {', '.join(lamp.name for lamp in self.editable_lights)}"
        )

    @property
    def active_lights(self) -> list[EditableLight]:
        """The lights that are on. If all are off: the first light, with intensity 0."""
        lamps = self.editable_lights
        on = [lamp for lamp in lamps if lamp.on and not self.has_set(lamp)]
        return on or [lamps[0]._replace(light=replace(lamps[0].light, intensity=0.0), on=False)]

    @property
    def sun(self) -> EditableLight | None:
        """The sun: the brightest distant light."""
        suns = [lamp for lamp in self.editable_lights if isinstance(lamp.light, DirectionalLight)]
        return max(suns, key=lambda lamp: lamp.light.intensity, default=None)

    @property
    def follows_sun(self) -> bool:
        """Whether the sun is that of a date: the place is known, and nobody else has given lights."""
        return (
            self.place is not None and self.sun is not None and self._initial_lights is None and not self.scene.lights
        )

    @property
    def in_memory(self) -> bool:
        """Whether the triangles are in memory, as the proxy mesh requires."""
        return self.scene.data.resident

    def text_of(self, position: NDArray[np.float64]) -> str:
        """A position with its unit, rounded to between a thousandth and a ten-thousandth of the scene's size."""
        size = 2.0 * RADIUS / self.page_frame.scale
        decimals = max(0, 3 - int(np.floor(np.log10(size))))
        place = ", ".join(f"{c + 0.0:.{decimals}f}" for c in np.round(position, decimals))
        return f"{place} {self.scene.unit.name}"

    def first_camera(self, width: int, height: int) -> Camera:
        """The camera of a new page. Upright pages show as much from side to side as square ones."""
        if self._camera is None and not self.scene.cameras:
            return self.scene.default_camera(width, height)
        camera = (self._camera or self.scene.camera(0, self.time)).resized(width, height)
        if height <= width:
            return camera
        slope = np.tan(np.radians(camera.vfov) / 2.0) * height / width
        vfov = float(np.degrees(2.0 * np.arctan(slope)))
        return Camera(camera.position, camera.target, camera.up, vfov, width, height)

    def ground(self, camera: Camera) -> float | bool:
        """The height of the ground on which shadows show, as in pictures of `antumbra render`; False: there is none."""
        return self.scene.ground_height(self.time) if is_outside(self.scene, camera) else False

    def update_from(self, frame: Frame, light_changes: int) -> None:
        """Adopt the ambient light of a frame, and its exposure if it is the first one or the lights differ much.

        light_changes : when the frame was begun; lights may change while it is traced
        """
        if self._exposure is None or self._metered != light_changes:
            exposure, self._metered = metered_exposure(frame), light_changes
            if self._exposure is None or abs(np.log2(exposure / self._exposure)) > _STEADY:
                self._exposure = exposure
        if frame.ambient is not None:
            self.ambient = frame.ambient

    @property
    def exposure(self) -> float | None:
        """The exposure of all pictures; None before the first one."""
        return None if self._exposure is None else self._exposure * 2.0**self.display.stops

    def reset_exposure(self) -> None:
        """Let the next picture set the exposure."""
        self._exposure, self.display = None, self.display._replace(stops=0.0)

    def go_to(self, time: float) -> None:
        """Show the scene at a time, in seconds."""
        self.time = self.scene.clamped(time)
        self.light_changes += 1

    def switch(self, name: str, on: bool) -> None:
        """Switch a light on or off."""
        self.editable_light(name)
        (self._off.discard if on else self._off.add)(name)
        self.light_changes += 1

    def move(self, name: str, to: NDArray[np.float64]) -> None:
        """Move the handle of a light to a position ((3,), page)."""
        self._moved[name] = move_light(self.editable_light(name).light, self.page_frame, to)
        self.light_changes += 1

    def aim_sun(self, bearing: float, elevation: float) -> None:
        """Move the sun to a bearing, clockwise from the scene's north axis, and an elevation, in degrees."""
        lamp = self.sun
        if lamp is None:
            raise InputError("the scene has no sun; add one with --light sun:DX,DY,DZ")
        bearing, elevation = number(bearing, "the bearing", -np.inf, np.inf), float(np.clip(elevation, -90.0, 90.0))
        assert isinstance(lamp.light, DirectionalLight)
        self._moved[lamp.name] = aim_sun_light(lamp.light, bearing, elevation, self.scene.up)
        self.light_changes += 1

    def aim_sun_at(self, day: str, hour: float) -> tuple[float, float]:
        """Move the sun to its position on a day ("2026-06-21") at an hour of local time.

        Returns the bearing and the elevation, in degrees.
        """
        (bearing,), (elevation,) = self._solar_angles(day, [hour])
        self.aim_sun(float(bearing), float(elevation))
        return float(bearing), float(elevation)

    def _solar_angles(self, day: str, hours: Sequence[float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) bearings, 0 to 360, and (n,) elevations of the sun, in degrees, at hours of local time."""
        if self.place is None:
            raise InputError("the location of the scene is unknown; give --latitude and --longitude, or --crs")
        try:
            midnight = datetime.fromisoformat(day).replace(tzinfo=None)
        except ValueError:
            raise InputError(f"the day is {day[:30]!r}; write one such as 2026-06-21") from None
        zone = zone_of(self.place)
        local = [(midnight + timedelta(hours=hour)).replace(tzinfo=zone) for hour in hours]  # also while clocks change
        instants = np.array([round(each.timestamp()) for each in local], "datetime64[s]")
        altitude, azimuth = solar_angles(self.place, instants)
        return (azimuth + self.place.north) % 360.0, altitude

    def daylight(self, day: str, step: float) -> list[float]:
        """The hours of a day, `step` apart, at which the sun is above the horizon. InputError as by `aim_sun_at`."""
        hours = np.arange(0.0, 24.0, step).tolist()
        return [hour for hour, elevation in zip(hours, self._solar_angles(day, hours)[1]) if elevation > 0.0]

    @property
    def has_default_lights(self) -> bool:
        """Whether the lights are those of the scene, as a command without lights has them."""
        return self._initial_lights is None and not self._moved and not self._off

    def has_set(self, lamp: EditableLight) -> bool:
        """Whether the user moved this sun below the horizon. Distant lights from files may shine from anywhere."""
        sun = lamp.light
        return (
            lamp.name in self._moved and isinstance(sun, DirectionalLight) and sun_angles(sun, self.scene.up)[1] <= 0.0
        )
