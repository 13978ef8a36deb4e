"""What a page shows: a scene at a time, its lights, and how it is looked at."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import NamedTuple

import numpy as np

from ..checks import instance, number
from ..engine.scene import AnyScene, Scene
from ..errors import InputError
from ..jobs.sun.location import Place, checked_place
from ..jobs.sun.sun_positions import solar_angles, zone_of
from ..picture.frame import Frame
from ..picture.image_files import frame_exposure
from ..picture.renderer import Renderer
from ..scene.camera import Camera
from ..scene.lights import DirectionalLight, Light, check_lights, light_names
from .lamps import Lamp, moved, sun_angles, sun_at
from .stage import Stage

PICTURE, STEPS, SEEN = "picture", "box tests", "seen: "
"""Kinds of pictures: shaded; the work of a plan; the share of a light that is seen (followed by the light's name)."""

STEPS_PLAN = "bsah+single"


class Looks(NamedTuple):
    """How a page shows the scene."""

    show: str = PICTURE  # PICTURE, STEPS, or SEEN and the name of a light
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
        self.scene, self.stage, self.place, self.threads = scene, Stage.of(scene), place, threads
        self.renderer = Renderer(scene, plan, threads, max_memory=max_memory)
        self.plan, self.time, self.looks = plan, scene.clamped(time), Looks()
        self._given = None if lights is None else check_lights(lights, scene.up)
        self._found: tuple[float, dict[str, Light]] | None = None  # the lights of a time, where nobody moved them
        self._moved: dict[str, Light] = {}
        self._off: set[str] = set()
        self._camera = camera
        self.seen_by: Camera | None = None  # the camera of the browser that moved last
        self._exposure: float | None = None
        self.ambient = np.zeros(3, np.float32)  # irradiance, as in the latest frame

    @property
    def lamps(self) -> list[Lamp]:
        """All lights, at the time and where the user moved them."""
        if self._found is None or self._found[0] != self.time:
            own = self.scene.default_lights(self.time) if self._given is None else self._given
            self._found = self.time, dict(zip(light_names(own), own))
        return [
            Lamp(name, self._moved.get(name, light), name not in self._off) for name, light in self._found[1].items()
        ]

    def lamp(self, name: str) -> Lamp:
        """The light of a name."""
        for lamp in self.lamps:
            if lamp.name == name:
                return lamp
        raise InputError(f"there is no light {name!r}; there are {', '.join(lamp.name for lamp in self.lamps)}")

    @property
    def shining(self) -> list[Lamp]:
        """The lights that are on; never none: without any, the first one with intensity 0."""
        found = self.lamps
        on = [lamp for lamp in found if lamp.on and not self._has_set(lamp)]
        return on or [found[0]._replace(light=replace(found[0].light, intensity=0.0), on=False)]

    @property
    def sun(self) -> Lamp | None:
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

    def learn(self, frame: Frame) -> None:
        """Take over the exposure of the first frame, so that nothing flickers, and the ambient light of each one."""
        if self._exposure is None:
            self._exposure = frame_exposure(frame)
        if frame.ambient is not None:
            self.ambient = frame.ambient

    @property
    def exposure(self) -> float | None:
        """The exposure of all pictures, from the first one on; None before it."""
        return None if self._exposure is None else self._exposure * 2.0**self.looks.stops

    def expose_anew(self) -> None:
        """Let the next picture choose the exposure."""
        self._exposure, self.looks = None, self.looks._replace(stops=0.0)

    def go_to(self, time: float) -> None:
        """Show the scene at a time, in seconds."""
        self.time = self.scene.clamped(time)

    def switch(self, name: str, on: bool) -> None:
        """Switch a light on or off."""
        self.lamp(name)
        (self._off.discard if on else self._off.add)(name)

    def move(self, name: str, to: np.ndarray) -> None:
        """Move a light so that its handle is at a place ((3,), page)."""
        self._moved[name] = moved(self.lamp(name).light, self.stage, to)

    def aim_sun(self, bearing: float, elevation: float) -> None:
        """Move the sun to a bearing, clockwise from the scene's north axis, and an elevation, in degrees."""
        lamp = self.sun
        if lamp is None:
            raise InputError("the scene has no sun; give one by --light sun:DX,DY,DZ")
        bearing, elevation = number(bearing, "the bearing", -np.inf, np.inf), float(np.clip(elevation, -90.0, 90.0))
        assert isinstance(lamp.light, DirectionalLight)
        self._moved[lamp.name] = sun_at(lamp.light, bearing, elevation, self.scene.up)

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

    def _has_set(self, lamp: Lamp) -> bool:
        """Whether the user moved this sun below the horizon. Distant lights of a file may shine from anywhere."""
        sun = lamp.light
        return (
            lamp.name in self._moved and isinstance(sun, DirectionalLight) and sun_angles(sun, self.scene.up)[1] <= 0.0
        )
