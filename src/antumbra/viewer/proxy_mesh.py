"""The proxy mesh that the browser shows while the camera moves: simplified triangles with baked light, as GLB."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..baking.surface_meter import Meter, MeterSettings, ReceiverPoints
from ..formats.gltf.gltf_writer import GltfWriter
from ..picture.image_files import roll_off
from ..picture.shading import SIDEWAYS
from ..query.query_bounds import morton_codes
from ..scene.triangles import Triangles
from .viewer_model import Model

# --- GLB file whose colours the browser shows unchanged ---------------------------------------------------------------


# viser leaves the tone mapping of three.js, a fit of ACES, enabled for all materials. These are its constants.
_INTO = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
_OUT = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
_DARKER = 0.6


def glb_of(corners: NDArray[np.floating[Any]], colours: NDArray[np.float32]) -> bytes:
    """A GLB file of triangles with separate colours of their two sides.

    corners : (n, 3, 3), at least one; stored as float32
    colours : (2, n, 3) float32, linear, in [0, 1]: of the front and of the back
    """
    both = np.concatenate([corners, corners[:, ::-1]]).reshape(-1, 3)
    rgb = np.repeat(before_aces(colours).reshape(-1, 3), 3, axis=0)
    writer = GltfWriter()
    primitive = writer.primitive(both, colours=rgb, material=writer.add("materials", writer.make_unlit({})))
    writer.add_root({"mesh": writer.add("meshes", {"primitives": [primitive]})})
    return writer.glb()


def before_aces(colours: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """(..., 3) float64: the linear colours that three.js maps to `colours`; the inverse of its ACES curve."""
    y = np.clip(np.asarray(colours, np.float64) @ np.linalg.inv(_OUT).T, 0.0, 0.99)
    # y = (x (x + p) - q) / (x (r x + s) + t), solved for x
    p, q, r, s, t = 0.0245786, 0.000090537, 0.983729, 0.4329510, 0.238081
    a, b, c = 1.0 - r * y, p - s * y, -q - t * y
    x = (-b + np.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    return np.maximum(x @ np.linalg.inv(_INTO).T, 0.0) * _DARKER


# --- Simplified mesh with baked light ---------------------------------------------------------------------------------


MOST = 100_000
"""Most triangles of the proxy mesh, each of which is sent once per side."""

_SPP = 8  # rays per light
_BATCH = 1 << 14  # receivers between two checks
_FINER = 1.25  # factor between successive sizes
_SHORTEST = 1e-3  # shortest edge of subdivided faces, as a share of the longest edge
_MIXED = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64).astype(np.int64)
"""Odd factors that hash three numbers into one, with few collisions."""


class ProxyMesh(NamedTuple):
    """The triangles of a proxy mesh, and the points where their light is measured."""

    corners: NDArray[np.float32]  # (n, 3, 3), recentred frame
    points: NDArray[np.float64]  # (n, 3), world: on the face that the triangle represents
    normals: NDArray[np.float64]  # (n, 3), unit
    faces: NDArray[np.int64]  # (n,): that face


def proxy_mesh(triangles: Triangles, most: int = MOST) -> ProxyMesh:
    """At most `most` triangles: small faces are merged, then large ones subdivided."""
    corners = triangles.vertices
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    length = np.linalg.norm(across, axis=1)
    faces = np.flatnonzero(length > 0.0)
    if not len(faces):
        return ProxyMesh(corners[:0], np.empty((0, 3)), np.empty((0, 3)), faces)
    simplified, faces = (corners[faces], faces) if len(faces) <= most else _clustered(corners, faces, most // 2)
    # Light is measured on the original face, because a simplified piece may lie inside a wall.
    both = np.concatenate([simplified, corners[faces]], 2)
    both, faces = _subdivided(both, faces, most)
    points = both[:, :, 3:].astype(np.float64).mean(1) + triangles.origin
    order = np.argsort(morton_codes(points - points.mean(0)), kind="stable")
    faces = faces[order]
    return ProxyMesh(both[order, :, :3], points[order], across[faces] / length[faces, None], faces)


def _subdivided(corners: np.ndarray, faces: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Faces split into four repeatedly until their edges are short: the pieces (m, 3, k) and their faces (m,).

    corners : (n, 3, k); the first three coordinates determine edge lengths
    """
    longest = np.linalg.norm(np.roll(corners[..., :3], 1, 1) - corners[..., :3], axis=2).max(1)
    size = float(longest.max())

    def times(edge: float) -> Any:
        return np.ceil(np.log2(np.maximum(longest / edge, 1.0)))

    while size > _SHORTEST * longest.max() and (4.0 ** times(size / _FINER)).sum() <= most:
        size /= _FINER
    remaining, done = times(size), []
    while len(corners):
        last = remaining <= 0
        done.append((corners[last], faces[last]))
        a, b, c = corners[~last].swapaxes(0, 1)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        four = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(each, 1) for each in four])
        faces, remaining = np.tile(faces[~last], 4), np.tile(remaining[~last] - 1, 4)
    return np.concatenate([pieces for pieces, _ in done]), np.concatenate([owner for _, owner in done])


def _clustered(corners: np.ndarray, faces: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertex clustering [Rossignac and Borrel 1993] on a grid as coarse as necessary.

    Corners move to the centres of their cells. Degenerate and duplicate triangles are removed.
    """
    lower, extent = corners.min((0, 1)), float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    cells = 1024.0
    while True:
        at = np.floor((corners[faces] - lower) * (cells / extent)).astype(np.int64)
        keys = (at[..., 0] << 42) | (at[..., 1] << 21) | at[..., 2]
        a, b, c = keys.T
        proper = np.flatnonzero((a != b) & (b != c) & (c != a))
        _, first = np.unique(np.sort(keys[proper], 1) @ _MIXED, return_index=True)
        if len(first) <= most:
            chosen = proper[first]
            return ((at[chosen] + 0.5) * (extent / cells) + lower).astype(np.float32), faces[chosen]
        cells /= max(_FINER, (len(first) / most) ** 0.5)


def proxy_light(model: Model, pieces: ProxyMesh, check: Callable[..., None] = lambda *_: None) -> NDArray[np.float32]:
    """(2, n, 3) float32: the irradiance on the front and back of each triangle.

    check : called between batches; it may raise an exception to end the work
    """
    lights, n = [lamp.light for lamp in model.active_lights], len(pieces.points)
    settings = MeterSettings("light", lights, _SPP, "larcher-pillichshammer", model.plan, model.time, model.threads)
    meter = Meter(model.scene, settings, 2 * n)
    out = np.zeros((2, n, 3), np.float32)
    for side, sign in enumerate((1.0, -1.0)):
        for start in range(0, n, _BATCH):
            check()
            part = slice(start, start + _BATCH)
            receivers = ReceiverPoints(pieces.points[part], sign * pieces.normals[part])
            out[side, part] = meter.values(receivers)
    return out


def proxy_colours(
    light: NDArray[np.float32], normals: NDArray[np.float64], base: NDArray[np.float32], model: Model
) -> NDArray[np.float32]:
    """(2, n, 3) float32, linear, in [0, 1]: the screen colours of triangles in this light, as in pictures.

    light : (2, n, 3) float32, irradiance of fronts and backs
    normals : (n, 3), of the fronts; base : (n, 3) float32, base colours
    """
    upwards = normals @ model.page_frame.up
    ambient = (SIDEWAYS + (1.0 - SIDEWAYS) * np.stack([upwards, -upwards]))[..., None] * model.ambient
    return roll_off((light + ambient) * base * ((model.exposure or 1.0) / np.pi)).astype(np.float32)
