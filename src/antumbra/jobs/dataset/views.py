"""The cameras and lights that a data set is asked for."""

from collections.abc import Sequence
from typing import NamedTuple

from ...checks import items, listed, whole_number
from ...engine.scene import AnyScene
from ...errors import InputError
from ...scene.camera import MAX_SIZE, Camera
from ...scene.lights import Light, check_lights
from .drawn import Place, orbit_camera, random_camera, random_light
from .manifest import camera_record

MOST_FRAMES = 10_000_000
MOST_LIGHTS = 1000
_MOST_SEED = 2**63 - 1


class Views(NamedTuple):
    """The cameras: first the given ones, then an orbit, then random ones."""

    given: list[Camera]
    orbit: int  # number of cameras around the scene
    random: int  # number of cameras drawn from the seed
    seed: int
    size: tuple[int, int]  # width, height of the cameras that are not given

    @property
    def total(self) -> int:
        return len(self.given) + self.orbit + self.random

    def camera(self, place: Place, k: int) -> tuple[str, Camera]:
        """Camera k, and how it was made: "given", "orbit" or "random"."""
        if k < len(self.given):
            return "given", self.given[k]
        k -= len(self.given)
        if k < self.orbit:
            return "orbit", orbit_camera(place, k, self.orbit, self.size)
        return "random", random_camera(place, self.seed, k - self.orbit, self.size)

    def record(self) -> dict:
        """What decides the cameras, for the settings."""
        given = [camera_record(camera) for camera in self.given]
        return {"given": given, "orbit": self.orbit, "random": self.random, "size": list(self.size)}


def views_of(scene: AnyScene, cameras: Sequence[Camera] | None, orbit, random, seed, size, time: float) -> Views:
    """The checked `Views`. If nothing is asked for, they are the scene's own cameras, or its default camera."""
    orbit = whole_number(orbit, "orbit", 0, MOST_FRAMES)
    random = whole_number(random, "random", 0, MOST_FRAMES)
    seed = whole_number(seed, "seed", 0, _MOST_SEED)
    width, height = listed(size, "size (width, height)", 2)
    size = whole_number(width, "picture width", 1, MAX_SIZE), whole_number(height, "picture height", 1, MAX_SIZE)
    if cameras is None:
        own = [] if orbit or random else [scene.camera(i, time).resized(*size) for i in range(len(scene.cameras))]
        cameras = own if own or orbit or random else [scene.default_camera(*size)]
    cameras = items(cameras, Camera, "a camera")
    views = Views(cameras, orbit, random, seed, size)
    if not 1 <= views.total <= MOST_FRAMES:
        raise InputError(f"{views.total} cameras; a data set has 1 to {MOST_FRAMES:,}, give cameras, orbit or random")
    return views


def lights_of(place: Place, lights: Sequence[Light] | Light | None, random, seed) -> list[Light]:
    """The given lights, then random ones. If nothing is asked for: the scene's default lights."""
    random, scene = whole_number(random, "random_lights", 0, MOST_LIGHTS), place.scene
    if lights is None:
        lights = [] if random else scene.default_lights(place.time)
    given = items(lights, Light, "a light", "give an antumbra.PointLight, QuadLight, ... or a list of them")
    found = check_lights(given + [random_light(place, seed, k) for k in range(random)], scene.up)
    if len(found) > MOST_LIGHTS:
        raise InputError(f"{len(found)} lights; a data set has at most {MOST_LIGHTS}, each is a layer")
    return found
