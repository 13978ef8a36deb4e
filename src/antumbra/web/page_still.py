"""The still of a page: a small picture of its first view, which it shows until its rays are ready."""

import io
from dataclasses import replace
from datetime import datetime

import numpy as np

from ..base.errors import InputError
from ..engine.scene import AnyScene
from ..picture.image_files import frame_exposure, screen_picture
from ..picture.renderer import render
from ..scene.camera import Camera
from ..scene.lights import DirectionalLight, Light
from ..sun.location import Place
from ..sun.sun_positions import directions_of, instant_of, solar_angles, zone_of
from .page_look import SUN_WIDTH, picture_lights

SIZE = 960, 480  # wider than most windows, which show its middle at their height
SAMPLES = 16  # of each light for a pixel
LOWEST = 8.0  # degrees: pages dim the day while the sun is lower, and then have no still
_QUALITY = 70


def still_of(scene: AnyScene, view: Camera, when: datetime, place: Place | None, time: float) -> bytes:
    """A WebP file of the view by the lights that the page opens with; empty without pvlib, or while the sun is low."""
    lights = picture_lights(scene, time, place)
    if place is not None:
        found = _with_sun(lights, when, place, scene.up)
        if found is None:
            return b""
        lights = found
    frame = render(scene, view.resized(*SIZE), lights, spp=SAMPLES, time=time, progress=False)
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(screen_picture(frame, frame_exposure(frame))).save(file, "WEBP", quality=_QUALITY, method=6)
    return file.getvalue()


def _with_sun(lights: list[Light], when: datetime, place: Place, up: str) -> list[Light] | None:
    """The lights, the first sun among them where it stands at a local time; None if that is unknown or low."""
    try:
        second = int(instant_of(when, zone_of(place)).timestamp())
        altitude, azimuth = solar_angles(place, np.array([second], "datetime64[s]"))
    except InputError:  # pvlib is missing, or clocks skip this time
        return None
    if altitude[0] < LOWEST:
        return None
    (away,) = directions_of(altitude, azimuth + place.north, up)
    sun = next(light for light in lights if isinstance(light, DirectionalLight))
    moved = replace(sun, direction=-away, angular_diameter=SUN_WIDTH)
    return [moved if light is sun else light for light in lights]
