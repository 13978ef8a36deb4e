"""The cameras and lights of a data set: given, on an orbit, or drawn from a seed.

A random camera or light depends only on the scene, the seed and its number.
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...checks import items, listed, whole_number
from ...engine.paged_scene import PagedScene
from ...engine.scene import AnyScene
from ...errors import InputError
from ...scene.camera import AZIMUTH, MAX_SIZE, Camera, axes, bounding_sphere, default_camera
from ...scene.default_picture import Room
from ...scene.lights import DirectionalLight, Light, SphereLight, check_lights
from ...scene.triangles import Hit
from ..scene_records import camera_record

# --- Cameras and lights that a data set draws from its seed. Number k depends on the scene, the seed and k alone ------


TRIES = 512
"""Places that are tried for a camera or a light."""

VFOV = 60.0
_BACK, _WIDEST = 0.9, 75.0  # of an orbit in a closed box: share of the way to it, and degrees
_CAMERA, _LIGHT = 1, 2  # streams of random numbers
_PROBE = 16  # rays across and down a view that is tried
_LEAST_SEEN = 0.25  # of a view's rays
_LEAST_CLEAR = 0.01  # of the radius, around a camera
_MARGINS = 0.0, 0.5  # of the radius, around the bounds: places in the scene, and around it
_LEAST_FACES = 8  # that a view's rays meet, in scenes of many faces
_ELEVATION = np.radians(10.0), np.radians(80.0)  # of suns
_MANY, _ENOUGH = 1000, 100_000  # faces from which the bounds are found, and faces that are looked at
_MOST_FACES = 2.0, 98.0  # percentiles
_MORE = 0.1  # of the width, on each side
_SIZES = 0.01, 0.05  # radius of a sphere light, of the radius

SEES_LITTLE, IN_A_WALL = "see little", "are in or at a wall"


class SamplingRegion(NamedTuple):
    """Where places are drawn, and the rays that judge them."""

    scene: AnyScene
    time: float  # seconds
    threads: int | None
    bounds: np.ndarray  # (2, 3) float64, world: the part of the scene that most faces are in

    @property
    def radius(self) -> float:
        return bounding_sphere(self.bounds)[1]

    def box(self, margin: float) -> np.ndarray:
        """(2, 3) float64: the bounds, `margin` wider on all sides but the lower one."""
        upward = axes(self.scene.up)[1]
        return self.bounds + margin * np.stack([upward - 1.0, np.ones(3)])

    def nearest(self, position: np.ndarray, directions: np.ndarray) -> tuple[Hit, np.ndarray]:
        """The nearest face along each direction, and whether its back is seen."""
        ask = lambda side: self.scene.closest_hit(
            position, directions, time=self.time, cull_faces=side, threads=self.threads
        )
        first = ask(None)
        return first, (first.face >= 0) & (first.face != ask("back").face)

    def walled(self, position: np.ndarray, clear: float) -> bool:
        """Whether a surface is nearer than `clear`, or most of the surfaces around show their backs."""
        hit, back = self.nearest(position, _AROUND)
        return bool(hit.t.min() < clear or 2 * back.sum() > (hit.face >= 0).sum())


def sampling_region(scene: AnyScene, time: float, threads: int | None) -> SamplingRegion:
    """The `Place` of a scene. A plain around a town, of few faces, is left out of its bounds.

    The bounds hold the centres of all faces but 2 % on each side, and a tenth more. A scene of few faces has its own
    bounds, and so has a store.
    """
    if scene.n_triangles < _MANY or isinstance(scene, PagedScene):
        return SamplingRegion(scene, time, threads, scene.bounds)
    triangles = scene.triangles(time, threads)
    some = triangles.vertices[:: -(-len(triangles.vertices) // _ENOUGH)]
    centres = some.mean(axis=1, dtype=np.float64) + triangles.origin
    lower, upper = np.percentile(centres, _MOST_FACES, axis=0, method="nearest")
    more = _MORE * (upper - lower)
    return SamplingRegion(scene, time, threads, np.clip(np.stack([lower - more, upper + more]), *scene.bounds))


def orbit_camera(place: SamplingRegion, k: int, n: int, size: tuple[int, int]) -> Camera:
    """Camera k of n that stand around the scene at equal angles, and show its bounding sphere.

    In a closed box, such as a sky box, they stand around what it encloses, if necessary nearer and with a wider lens.
    In a box that is too tight for this, they look at the middle of the room, from most of the way to what is around it.
    """
    scene, turn = place.scene, 2.0 * np.pi * k / n
    room = scene.view.room
    if room is None or room.planes is None:
        return default_camera(scene.bounds, scene.up, *size, turn)
    if room.points is None:
        return _across(place, room, turn, size)
    bounds = np.stack([room.points.min(0), room.points.max(0)])
    camera = default_camera(bounds, scene.up, *size, turn)
    back = camera.position - camera.target
    share = _BACK * room.way(camera.target, back)
    if share >= 1.0:
        return camera
    radius, distance = bounding_sphere(bounds)[1], share * float(np.linalg.norm(back))
    half = np.arctan(np.tan(np.arcsin(min(1.02 * radius / distance, 1.0))) / min(1.0, size[0] / size[1]))
    vfov = min(2.0 * float(np.degrees(half)), _WIDEST)
    return Camera(camera.target + share * back, camera.target, camera.up, vfov, *size)


def _across(place: SamplingRegion, room: Room, turn: float, size: tuple[int, int]) -> Camera:
    """A camera that looks at the middle of a room, level; `turn`: radians around the up axis."""
    right, upward, towards = axes(place.scene.up)
    back = np.sin(AZIMUTH + turn) * right + np.cos(AZIMUTH + turn) * towards
    free = min(float(place.nearest(room.middle, back[None])[0].t[0]), room.way(room.middle, back))
    return Camera(room.middle + _BACK * free * back, room.middle, upward, VFOV, *size)


def random_camera(place: SamplingRegion, seed: int, k: int, size: tuple[int, int]) -> Camera:
    """A camera that looks at a point in the bounds of the place.

    Places in the bounds and around them are tried by turns. At least a quarter of a grid of the camera's rays meet
    surfaces, several faces of them, and most of these show their fronts. No surface is nearer than 1 % of the bounds'
    radius. So the camera stands in no wall.

    Raises
    ------
    InputError
        If there is no such view in `TRIES` tries.
    """
    rng, faults = np.random.default_rng([seed, _CAMERA, k]), Counter[str]()
    radius, upward = place.radius, axes(place.scene.up)[1]
    for i in range(TRIES):
        margin = _MARGINS[(k + i) % len(_MARGINS)]
        position, target = rng.uniform(*place.box(margin * radius)), rng.uniform(*place.bounds)
        try:
            camera = Camera(position, target, upward, VFOV, *size)
        except InputError:  # straight up or down
            continue
        fault = _fault(place, camera, radius)
        if fault is None:
            return camera
        faults[fault] += 1
    raise _none(place, f"view for random camera {k}", faults, "give cameras instead (--camera)")


def random_light(place: SamplingRegion, seed: int, k: int) -> Light:
    """A sun 10 to 80 degrees above the horizon if k is even; a sphere in free space in the scene if k is odd.

    Raises
    ------
    InputError
        If there is no free space in `TRIES` tries.
    """
    rng = np.random.default_rng([seed, _LIGHT, k])
    right, upward, towards = axes(place.scene.up)
    if k % 2 == 0:
        azimuth, elevation = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*_ELEVATION)
        flat = np.sin(azimuth) * right + np.cos(azimuth) * towards
        return DirectionalLight(-(np.cos(elevation) * flat + np.sin(elevation) * upward), intensity=float(np.pi))
    radius, faults = place.radius, Counter[str]()
    for _ in range(TRIES):
        centre, size = rng.uniform(*place.box(0.0)), radius * rng.uniform(*_SIZES)
        if not place.walled(centre, size):
            return SphereLight(centre, size, intensity=float(np.pi * (radius / 2.0) ** 2))
        faults[IN_A_WALL] += 1
    raise _none(place, f"place for random light {k}", faults, "give lights instead (--light)")


def _fault(place: SamplingRegion, camera: Camera, radius: float) -> str | None:
    rays = camera.resized(_PROBE, _PROBE).rays(place.scene.origin)
    across = np.arange(_PROBE) + 0.5
    directions = rays.corner + across[:, None] * rays.dx + across[:, None, None] * rays.dy
    hit, back = place.nearest(camera.position, directions)
    hits = hit.face >= 0
    if hits.mean() < _LEAST_SEEN or len(np.unique(hit.face[hits])) < min(_LEAST_FACES, place.scene.n_triangles // 8):
        return SEES_LITTLE
    if 2 * back.sum() > hits.sum() or place.walled(camera.position, _LEAST_CLEAR * radius):
        return IN_A_WALL
    return None


def _none(place: SamplingRegion, what: str, faults: Counter[str], cure: str) -> InputError:
    counts = ", ".join(f"{n} {fault}" for fault, n in faults.items())
    return InputError(f"{place.scene.name}: no {what} in {TRIES} tries ({counts}); {cure}")


def _sphere(n: int) -> np.ndarray:
    """(n, 3) float64: directions spread evenly, on a Fibonacci spiral."""
    i = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * i / n, np.pi * (3.0 - np.sqrt(5.0)) * i
    flat = np.sqrt(1.0 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)


_AROUND = _sphere(64)

# --- The cameras and lights that a data set is asked for --------------------------------------------------------------


MOST_FRAMES = 10_000_000
MOST_LIGHTS = 1000
_MOST_SEED = 2**63 - 1


class CameraSet(NamedTuple):
    """The cameras: first the given ones, then an orbit, then random ones."""

    given: list[Camera]
    orbit: int  # number of cameras around the scene
    random: int  # number of cameras drawn from the seed
    seed: int
    size: tuple[int, int]  # width, height of the cameras that are not given

    @property
    def total(self) -> int:
        return len(self.given) + self.orbit + self.random

    def camera(self, place: SamplingRegion, k: int) -> tuple[str, Camera]:
        """Camera k, and how it was made: "given", "orbit" or "random"."""
        if k < len(self.given):
            return "given", self.given[k]
        k -= len(self.given)
        if k < self.orbit:
            return "orbit", orbit_camera(place, k, self.orbit, self.size)
        return "random", random_camera(place, self.seed, k - self.orbit, self.size)

    def record(self) -> dict:
        """What decides the cameras, for the settings."""
        cameras = [camera_record(camera) for camera in self.given]
        return {"given": cameras, "orbit": self.orbit, "random": self.random, "size": list(self.size)}


def camera_set(scene: AnyScene, cameras: Sequence[Camera] | None, orbit, random, seed, size, time: float) -> CameraSet:
    """The checked `Views`. If nothing is asked for, they are the scene's own cameras, or its default camera."""
    orbit = whole_number(orbit, "orbit", 0, MOST_FRAMES)
    random = whole_number(random, "random", 0, MOST_FRAMES)
    seed = whole_number(seed, "seed", 0, _MOST_SEED)
    width, height = listed(size, "size (width, height)", 2)
    size = whole_number(width, "picture width", 1, MAX_SIZE), whole_number(height, "picture height", 1, MAX_SIZE)
    if cameras is None:
        scene_cameras = (
            [] if orbit or random else [scene.camera(i, time).resized(*size) for i in range(len(scene.cameras))]
        )
        cameras = scene_cameras if scene_cameras or orbit or random else [scene.default_camera(*size)]
    cameras = items(cameras, Camera, "a camera")
    views = CameraSet(cameras, orbit, random, seed, size)
    if not 1 <= views.total <= MOST_FRAMES:
        raise InputError(f"{views.total} cameras; a data set has 1 to {MOST_FRAMES:,}, give cameras, orbit or random")
    return views


def lights_of(place: SamplingRegion, lights: Sequence[Light] | Light | None, random, seed) -> list[Light]:
    """The given lights, then random ones. If nothing is asked for: the scene's default lights."""
    random, scene = whole_number(random, "random_lights", 0, MOST_LIGHTS), place.scene
    if lights is None:
        lights = [] if random else scene.default_lights(place.time)
    explicit_lights = items(lights, Light, "a light", "give an antumbra.PointLight, QuadLight, ... or a list of them")
    all_lights = check_lights(explicit_lights + [random_light(place, seed, k) for k in range(random)], scene.up)
    if len(all_lights) > MOST_LIGHTS:
        raise InputError(f"{len(all_lights)} lights; a data set has at most {MOST_LIGHTS}, each is a layer")
    return all_lights
