"""The cameras and lights of a data set: explicit ones, cameras on an orbit, and random ones from a seed.

A random camera or light depends only on the scene, the seed and its number.
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.checks import items
from ..base.errors import InputError
from ..base.wording import counted
from ..engine.measured_scenes import check_degrees
from ..engine.scene import AnyScene
from ..kernels.elementary import asin, atan, cos, sin, tan
from ..kernels.small_matrices import length
from ..scene.camera import AZIMUTH, Camera, axes, bounding_sphere, default_camera
from ..scene.default_picture import Room
from ..scene.lights import DirectionalLight, Light, SphereLight, check_lights
from ..scene.triangles import Hit
from ..work.scene_records import Record, camera_record
from .dataset_options import MOST_FRAMES, MOST_LIGHTS, PER_FRAME, DatasetOptions

# --- Random and orbit views -------------------------------------------------------------------------------------------


TRIES = 512
"""Maximum number of positions tried for a camera or a light."""

VFOV = 60.0
_BACK, _WIDEST = 0.9, 75.0  # orbit in a closed box: fraction of the distance to the box, and maximum vfov in degrees
_CAMERA, _LIGHT = 1, 2  # streams of random numbers
_PROBE = 16  # rays across and down a candidate view
MIN_HIT_SHARE = 0.25  # minimum share of a view's rays that hit surfaces
_LEAST_CLEAR = 0.01  # minimum clearance around a camera, in radii of the bounds
_MARGINS = 0.0, 0.5  # margins around the bounds, in their radii: positions in the scene, and around it
_LEAST_FACES = 8  # minimum number of faces that a view's rays hit, in scenes of many faces
_ELEVATION = np.radians(10.0), np.radians(80.0)  # of suns
_MANY, _ENOUGH = 1000, 100_000  # minimum faces for which bounds are computed from face centres, and maximum used
_MOST_FACES = 2.0, 98.0  # percentiles of face centres
_MORE = 0.1  # enlargement of the bounds on each side, in widths
LIGHT_SIZES = 0.01, 0.05
"""Least and greatest radius of a sphere light, in radii of the bounds."""

SEES_LITTLE, IN_A_WALL = "see little", "are in or at a wall"


class SamplingRegion(NamedTuple):
    """The region from which positions are sampled, and the ray tests that validate them."""

    scene: AnyScene
    time: float  # seconds
    threads: int | None
    bounds: np.ndarray  # (2, 3) float64, world: bounds of the part of the scene with most of its faces

    @property
    def radius(self) -> float:
        return bounding_sphere(self.bounds)[1]

    def box(self, margin: float) -> np.ndarray:
        """(2, 3) float64: the bounds, enlarged by `margin` on all sides except the bottom."""
        upward = axes(self.scene.up)[1]
        return self.bounds + margin * np.stack([upward - 1.0, np.ones(3)])

    def nearest(self, position: np.ndarray, directions: np.ndarray) -> tuple[Hit, np.ndarray]:
        """The nearest face along each direction, and whether it is hit from behind."""
        scene, time, threads = self[:3]
        first = scene.closest_hit(position, directions, time=time, threads=threads)
        front = scene.closest_hit(position, directions, time=time, cull_faces="back", threads=threads)
        return first, (first.face >= 0) & (first.face != front.face)

    def walled(self, position: np.ndarray, clear: float) -> bool:
        """Whether a surface is nearer than `clear`, or most surfaces around are hit from behind."""
        hit, back = self.nearest(position, _AROUND)
        return bool(hit.t.min() < clear or 2 * back.sum() > (hit.face >= 0).sum())


def sampling_region(scene: AnyScene, time: float, threads: int | None) -> SamplingRegion:
    """The `SamplingRegion` of a scene. Its bounds leave out large surroundings of few faces, such as a plain.

    They contain all face centres but 2 % on each side, enlarged by a tenth. For scenes of few faces, they are the
    scene's bounds.
    """
    if scene.n_triangles < _MANY:
        return SamplingRegion(scene, time, threads, scene.bounds)
    sample = scene.data.every(-(-scene.n_triangles // _ENOUGH), time, threads)
    centres = sample.mean(axis=1, dtype=np.float64) + scene.origin
    lower, upper = np.percentile(centres, _MOST_FACES, axis=0, method="nearest")
    margin = _MORE * (upper - lower)
    return SamplingRegion(scene, time, threads, np.clip(np.stack([lower - margin, upper + margin]), *scene.bounds))


def orbit_camera(region: SamplingRegion, k: int, n: int, size: tuple[int, int]) -> Camera:
    """Camera k of n cameras around the scene at equal angles, each of which shows its bounding sphere.

    In a closed box, such as a sky box, they surround its contents, if necessary closer and with a wider lens. In a box
    too tight for this, they look at the centre of the room, from most of the distance to its surroundings.
    """
    scene, turn = region.scene, 2.0 * np.pi * k / n
    room = scene.view.room
    if room is None or room.planes is None:
        return default_camera(scene.bounds, scene.up, *size, turn)
    if room.points is None:
        return _across(region, room, turn, size)
    bounds = np.stack([room.points.min(0), room.points.max(0)])
    camera = default_camera(bounds, scene.up, *size, turn)
    back = camera.position - camera.target
    share = _BACK * room.way(camera.target, back)
    if share >= 1.0:
        return camera
    radius, distance = bounding_sphere(bounds)[1], share * float(length(back))
    half = atan(tan(asin(min(1.02 * radius / distance, 1.0))) / min(1.0, size[0] / size[1]))
    vfov = min(2.0 * float(np.degrees(half)), _WIDEST)
    return Camera(camera.target + share * back, camera.target, camera.up, vfov, *size)


def _across(region: SamplingRegion, room: Room, turn: float, size: tuple[int, int]) -> Camera:
    """A camera that looks horizontally at the centre of a room; `turn`: radians around the up axis."""
    right, upward, towards = axes(region.scene.up)
    back = sin(AZIMUTH + turn) * right + cos(AZIMUTH + turn) * towards
    free = min(float(region.nearest(room.middle, back[None])[0].t[0]), room.way(room.middle, back))
    return Camera(room.middle + _BACK * free * back, room.middle, upward, VFOV, *size)


def random_camera(region: SamplingRegion, seed: int, k: int, size: tuple[int, int]) -> Camera:
    """A camera that looks at a point in the bounds of the region.

    Positions inside the bounds and around them are tried alternately. Of a grid of the camera's rays, at least a
    quarter hit surfaces, they hit several faces, and most of these from the front. No surface is nearer than 1 % of the
    bounds' radius, so the camera does not stand in a wall.

    Raises
    ------
    InputError
        If `TRIES` tries find no such view.
    """
    rng, faults = np.random.default_rng([seed, _CAMERA, k]), Counter[str]()
    radius, upward = region.radius, axes(region.scene.up)[1]
    for i in range(TRIES):
        margin = _MARGINS[(k + i) % len(_MARGINS)]
        position, target = rng.uniform(*region.box(margin * radius)), rng.uniform(*region.bounds)
        try:
            camera = Camera(position, target, upward, VFOV, *size)
        except InputError:  # straight up or down
            continue
        fault = _fault(region, camera, radius)
        if fault is None:
            return camera
        faults[fault] += 1
    raise _none(region, f"view for random camera {k}", faults, "give cameras instead (--camera)")


def random_light(region: SamplingRegion, seed: int, k: int) -> Light:
    """A sun 10 to 80 degrees above the horizon if k is even; a sphere in free space in the scene if k is odd.

    Raises
    ------
    InputError
        If `TRIES` tries find no free space.
    """
    rng = np.random.default_rng([seed, _LIGHT, k])
    if k % 2 == 0:
        return random_sun(region, rng)
    radius, faults = region.radius, Counter[str]()
    for _ in range(TRIES):
        centre, size = rng.uniform(*region.box(0.0)), radius * rng.uniform(*LIGHT_SIZES)
        if not region.walled(centre, size):
            return SphereLight(centre, size, intensity=float(np.pi * (radius / 2.0) ** 2))
        faults[IN_A_WALL] += 1
    raise _none(region, f"place for random light {k}", faults, "give lights instead (--light)")


def random_sun(region: SamplingRegion, rng: np.random.Generator) -> DirectionalLight:
    """A sun 10 to 80 degrees above the horizon."""
    right, upward, towards = axes(region.scene.up)
    azimuth, elevation = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*_ELEVATION)
    flat = sin(azimuth) * right + cos(azimuth) * towards
    return DirectionalLight(-(cos(elevation) * flat + sin(elevation) * upward), intensity=float(np.pi))


def _fault(region: SamplingRegion, camera: Camera, radius: float) -> str | None:
    rays = camera.resized(_PROBE, _PROBE).rays(region.scene.origin)
    across = np.arange(_PROBE) + 0.5
    directions = rays.corner + across[:, None] * rays.dx + across[:, None, None] * rays.dy
    hit, back = region.nearest(camera.position, directions)
    hits = hit.face >= 0
    if hits.mean() < MIN_HIT_SHARE or len(np.unique(hit.face[hits])) < min(_LEAST_FACES, region.scene.n_triangles // 8):
        return SEES_LITTLE
    if 2 * back.sum() > hits.sum() or region.walled(camera.position, _LEAST_CLEAR * radius):
        return IN_A_WALL
    return None


def _none(region: SamplingRegion, what: str, faults: Counter[str], cure: str) -> InputError:
    counts = ", ".join(f"{n} {fault}" for fault, n in faults.items())
    return InputError(f"{region.scene.name}: no {what} in {TRIES} tries ({counts}); {cure}")


def _sphere(n: int) -> np.ndarray:
    """(n, 3) float64: evenly spread directions, on a Fibonacci spiral."""
    i = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * i / n, np.pi * (3.0 - np.sqrt(5.0)) * i
    flat = np.sqrt(1.0 - z * z)
    return np.stack([flat * cos(turn), flat * sin(turn), z], axis=-1)


_AROUND = _sphere(64)

# --- Camera and light sets --------------------------------------------------------------------------------------------


class CameraSet(NamedTuple):
    """The cameras: first the explicit ones, then an orbit, then random ones."""

    explicit: list[Camera]
    orbit: int  # number of cameras around the scene
    random: int  # number of random cameras
    seed: int
    size: tuple[int, int]  # width, height of orbit and random cameras

    @property
    def total(self) -> int:
        return len(self.explicit) + self.orbit + self.random

    def camera(self, region: SamplingRegion, k: int) -> tuple[str, Camera]:
        """The kind of camera k, "given", "orbit" or "random"; and the camera."""
        if k < len(self.explicit):
            return "given", self.explicit[k]
        k -= len(self.explicit)
        if k < self.orbit:
            return "orbit", orbit_camera(region, k, self.orbit, self.size)
        return "random", random_camera(region, self.seed, k - self.orbit, self.size)

    def record(self) -> Record:
        """The settings that determine the cameras."""
        cameras = [camera_record(camera) for camera in self.explicit]
        return {"given": cameras, "orbit": self.orbit, "random": self.random, "size": list(self.size)}


def camera_set(scene: AnyScene, cameras: Sequence[Camera] | None, options: DatasetOptions, time: float) -> CameraSet:
    """A checked `CameraSet`. By default, it has the scene's own cameras, or its default camera."""
    orbit, random, size = options.orbit, options.random, options.size
    if cameras is None and (orbit or random):
        cameras = []
    elif cameras is None:
        cameras = [scene.camera(i, time).resized(*size) for i in range(len(scene.cameras))]
        cameras = cameras or [scene.default_camera(*size)]
    given = items(cameras, Camera, "a camera")
    check_degrees(scene, np.array([camera.position for camera in given]).reshape(-1, 3), "cameras")
    views = CameraSet(given, orbit, random, options.seed, size)
    if not 1 <= views.total <= MOST_FRAMES:
        raise InputError(
            f"{counted(views.total, 'camera')}; a data set has 1 to {MOST_FRAMES:,}, give cameras, orbit or random"
        )
    return views


class LightSet(NamedTuple):
    """The lights: first those of all frames, then random ones that each frame draws for itself."""

    fixed: list[Light]
    drawn: int  # number of lights drawn per frame

    @property
    def total(self) -> int:
        return len(self.fixed) + self.drawn


def light_set(region: SamplingRegion, lights: Sequence[Light] | Light | None, options: DatasetOptions) -> LightSet:
    """The explicit lights, then random ones; by default, the scene's default lights."""
    random, scene, per_frame = options.random_lights, region.scene, options.lights_per == PER_FRAME
    if lights is None:
        lights = [] if random else scene.default_lights(region.time)
    explicit_lights = items(lights, Light, "a light", "give an antumbra.PointLight, QuadLight, ... or a list of them")
    shared = [] if per_frame else [random_light(region, options.seed, k) for k in range(random)]
    fixed = check_lights(explicit_lights + shared, scene.up) if explicit_lights or shared or not random else []
    found = LightSet(fixed, random if per_frame else 0)
    if found.total > MOST_LIGHTS:
        raise InputError(f"{counted(found.total, 'light')}; a data set has at most {MOST_LIGHTS}, each is a layer")
    return found
