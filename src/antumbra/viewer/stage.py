"""The frame of the page: the scene around zero and twenty units wide, for browsers have float32 and a far plane."""

from typing import NamedTuple

import numpy as np

from ..scene.camera import Camera, axes, bounding_sphere

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


class Stage(NamedTuple):
    """The map between world and page; axes keep their directions."""

    centre: np.ndarray  # (3,) float64, world
    scale: float  # page units in a world unit
    up: np.ndarray  # (3,) float64
    half: np.ndarray  # (3,) float64, page: half of the size of the scene's bounds

    @classmethod
    def of(cls, scene) -> "Stage":
        """The stage on which a scene is shown as a whole."""
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


def turned(wxyz: np.ndarray) -> np.ndarray:
    """(3, 3) float64: the rotation matrix of a unit quaternion. Its columns are a camera's right, down and forward."""
    w, x, y, z = np.asarray(wxyz, np.float64)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
