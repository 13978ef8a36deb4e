"""A small scene as the tools of the web compress it: `tests/data/compressed/make.py` writes the files."""

import numpy as np

from gltf_files import Gltf

PACKED = {
    "ext.glb": ["-c", "-kn"],
    "khr.glb": ["-cc", "-kn", "-ce", "khr", "-vpf", "-vtf"],
    "instances.glb": ["-cc", "-mi"],  # of the garden at rest
    "fallback.gltf": ["-cf", "-kn"],
}
"""File -> the options of gltfpack that make it of the garden."""

STEPS = 12
COPIES = np.array([[0, 0, 0], [3, 0, 1], [-2, 0.5, 4]], np.float32)
TIMES = np.array([0, 1, 2], np.float32)
TURNS = np.array([[0, 0, 0, 1], [0, 0.5**0.5, 0, 0.5**0.5], [0, 1, 0, 0]], np.float32)


def hill(steps: int = STEPS) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(positions (v, 3), unit normals (v, 3), colours (v, 4), all float32; faces (f, 3) uint16) of a bumpy square."""
    x, z = (c.reshape(-1) for c in np.meshgrid(*[np.linspace(-1, 1, steps + 1)] * 2, indexing="ij"))
    y = 0.3 * np.cos(3 * x) * np.sin(2 * z)
    slope = np.stack([0.9 * np.sin(3 * x) * np.sin(2 * z), np.ones_like(x), -0.6 * np.cos(3 * x) * np.cos(2 * z)], 1)
    colours = np.stack([(x + 1) / 2, (z + 1) / 2, 0.25 + 0 * x, 1 + 0 * x], 1)
    corner = (np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)).reshape(-1, 1)
    faces = corner + np.array([[0, 1, steps + 2], [0, steps + 2, steps + 1]])[:, None]
    normals = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    f32 = [np.asarray(values, np.float32) for values in (np.stack([x, y, z], 1), normals, colours)]
    return *f32, faces.reshape(-1, 3).astype(np.uint16)


def garden(at_rest: bool = False) -> Gltf:
    """A hill at three places, one of which turns unless the garden is at rest."""
    positions, normals, colours, faces = hill()
    made = Gltf()
    bounds = {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
    attributes = {
        "POSITION": made.accessor(positions, **bounds),
        "NORMAL": made.accessor(normals),
        "COLOR_0": made.accessor(colours),
    }
    primitive = {"attributes": attributes, "indices": made.accessor(faces.reshape(-1))}
    mesh = made.mesh(primitive)
    for i, place in enumerate(COPIES):
        node = made.node(mesh=mesh, name=f"hill {i}", translation=place.tolist())
    if not at_rest:
        made.animate(node, "rotation", TIMES, TURNS)
    return made


def leaf(opaque: bool = False) -> np.ndarray:
    """(16, 24, 4) uint8: green, with two holes that consist of blocks of 4 x 4 texels."""
    pixels = np.full((16, 24, 4), (40, 160, 60, 255), np.uint8)
    if not opaque:
        pixels[4:12, 4:8] = pixels[8:12, 16:20] = (40, 160, 60, 0)
    return pixels
