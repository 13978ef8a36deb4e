"""One small scene in several frames, which quarter turns take into each other: signed permutations, exact in floats."""

from typing import NamedTuple

import numpy as np

import antumbra as at
from baked_files import box, grid


class Turned(NamedTuple):
    """A frame of the scene, and its turn from the first one."""

    up: str
    matrix: np.ndarray  # (3, 3): a vector of the first frame to this one
    around: float = 0.0  # degrees about the up axis, counter-clockwise seen from above

    def of(self, vectors) -> np.ndarray:
        """Vectors ((..., 3)) of the first frame, in this one."""
        return np.asarray(vectors, float) @ self.matrix.T

    def back(self, vectors) -> np.ndarray:
        """Vectors of this frame, in the first one."""
        return np.asarray(vectors, float) @ self.matrix

    @property
    def north(self) -> float:
        """The bearing of the first frame's north, clockwise seen from above."""
        return -self.around


FIRST = Turned("y", np.eye(3))
UPRIGHT = Turned("z", np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))  # +Z is up: the axis -z becomes +y
AROUND = Turned("y", np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), 90.0)  # about the up axis
BOTH = Turned("z", UPRIGHT.matrix @ AROUND.matrix, 90.0)
TURNS = {"upright": UPRIGHT, "around": AROUND, "both": BOTH}


def corners() -> tuple[np.ndarray, np.ndarray]:
    """((v, 3) float32, (f, 3)): a floor with two blocks and a slanted roof, in the first frame.

    Its coordinates are eighths, and its middle is one too. So each frame has the same float32 numbers.
    """
    floor = grid(np.arange(-4.0, 5.0, 2.0), np.arange(-3.0, 4.0, 2.0))
    roof = np.array([[-3, 1.5, -2], [-3, 1.5, 1], [-1, 2.25, -2], [-1, 2.25, 1]], np.float32)
    parts = [
        floor,
        box((1.0, 0.0, -1.5), (2.0, 3.0, 0.5)),
        box((-1.5, 0.125, 1.0), (0.5, 0.75, 2.0)),
        (roof, np.array([[0, 1, 3], [0, 3, 2]])),
    ]
    starts = np.cumsum([0, *(len(points) for points, _ in parts)])
    return np.concatenate([points for points, _ in parts]), np.concatenate(
        [faces.astype(int) + start for (_, faces), start in zip(parts, starts)]
    )


def scene_in(frame: Turned) -> at.Scene:
    points, faces = corners()
    return at.Scene.from_arrays(frame.of(points), faces, [0.5, 0.25, 0.75], up=frame.up, name="blocks")


def camera_in(frame: Turned, size: int = 48) -> at.Camera:
    return at.Camera(frame.of((6, 5, 9)), frame.of((0, 0.5, 0)), frame.of((0, 1, 0)), 40.0, size, size)


def lights_in(frame: Turned) -> list:
    """All sharp lights in a frame."""
    return [make(frame) for make in SHARP.values()]


_MAP = np.random.default_rng(3).uniform(0.0, 1.0, (8, 16, 3))

SHARP = {
    "point": lambda f: at.PointLight(f.of((-2, 5, 3)), intensity=40.0),
    "sun": lambda f: at.DirectionalLight(f.of((1, -2, -1)), 0.0, intensity=2.0),
    "quad": lambda f: at.QuadLight(f.of((-3, 4, 2)), f.of((1, 0, 0)), f.of((0, 1, 1)), intensity=30.0),
    "points": lambda f: at.PointLights(
        f.of([[-2, 5, 3], [3, 4, 3]]), normals=f.of([[0, -1, 0], [0, -1, 0]]), intensities=20.0
    ),
    "suns": lambda f: at.DirectionalLights(f.of([[1, -2, -1], [-1, -3, 0.5], [0.25, -1, 1]])),
    "sky": lambda f: at.Sky(_MAP, up=f.up, turn=f.around, count=64, interleave=False),
    "daylight": lambda f: at.Sky(turn=f.around, count=64, interleave=False),  # it follows the scene
}
"""Lights whose samples turn along: the same rays are traced in each frame."""

SOFT = {
    "wide sun": lambda f: at.DirectionalLight(f.of((1, -2, -1)), 8.0, intensity=2.0),
    "disk": lambda f: at.DiskLight(f.of((-2, 5, 3)), f.of((0, -1, 0)), 1.0, intensity=30.0),
    "sphere": lambda f: at.SphereLight(f.of((-2, 5, 3)), 1.0, intensity=30.0),
    "ambient": lambda f: at.AmbientOcclusion(radius=2.0),
}
"""Lights whose samples lie around an axis of their own. So other rays are traced in each frame, from the same light."""
